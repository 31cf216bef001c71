//! Points and lines of stage 4, as discs and capsules on the picture: a pixel is covered where its centre is. A disc lies in
//! the depth of its point. A line is a disc for each of its points: of those that cover a pixel the nearest counts, also where
//! a line is seen end on.

use super::lanes::LANES;
use super::triangle::{VERTICES, homogeneous_rows, project};
use super::visibility::Sink;
use crate::model::ClusterGeometry;
use crate::views::{InstanceView, Screen, Stroke};

/// Draws the points or lines of a cluster. Returns how many reached the picture.
#[inline(always)]
pub(super) fn draw<S: Sink>(
    geometry: &ClusterGeometry<'_>,
    view: &InstanceView,
    stroke: &Stroke,
    screen: &Screen,
    payload: u32,
    sink: &S,
) -> u64 {
    let mut drawn = 0;
    if stroke.line {
        for (t, [a, b, _]) in geometry.triangles.iter().enumerate() {
            let ends = [a, b].map(|v| homogeneous(&view.screen, geometry.positions.get(usize::from(v))));
            drawn += u64::from(line(ends, stroke, screen, u64::from(payload - t as u32), sink));
        }
        return drawn;
    }
    let mut vertices = [[0f32; VERTICES]; 3];
    homogeneous_rows(geometry.positions, &view.screen, |first, h| {
        (0..3).for_each(|k| vertices[k][first..first + LANES].copy_from_slice(&h[k].0));
    });
    for (t, [a, ..]) in geometry.triangles.iter().enumerate() {
        let vertex = [0, 1, 2].map(|k| vertices[k][usize::from(a)]);
        drawn += u64::from(point(vertex, stroke, screen, u64::from(payload - t as u32), sink));
    }
    drawn
}

/// Homogeneous screen coordinates of an internal position: in f64, so that what is near the eye of a line between ends that
/// are very far off is where it is.
fn homogeneous(rows: &[[f32; 4]; 3], p: [f32; 3]) -> [f64; 3] {
    rows.map(|row| {
        let [x, y, z, w] = row.map(f64::from);
        x * f64::from(p[0]) + y * f64::from(p[1]) + z * f64::from(p[2]) + w
    })
}

/// First and last pixel of a row or column whose centre lies between two coordinates, or on the first, on the picture; empty
/// when first > last.
#[inline(always)]
fn between(low: f64, high: f64, size: u32) -> (i32, i32) {
    // Conversions of floats saturate, and NaN is 0.
    let first = (low - 0.5).ceil().max(0.0) as i32;
    (first, ((high - 0.5).ceil() - 1.0).min(f64::from(size) - 1.0) as i32)
}

/// What a row of the picture shows of a disc; empty where first > last.
#[inline(always)]
fn across([x, y]: [f64; 2], [rx, ry]: [f64; 2], row: f64) -> (f64, f64) {
    let down = (row - y) / ry;
    let rest = 1.0 - down * down;
    if rest < 0.0 { (f64::INFINITY, f64::NEG_INFINITY) } else { (x - rx * rest.sqrt(), x + rx * rest.sqrt()) }
}

#[inline(always)]
fn point<S: Sink>(h: [f32; 3], stroke: &Stroke, screen: &Screen, low: u64, sink: &S) -> bool {
    let [x, y, value] = project(screen, h);
    // What overflows is nowhere.
    if !(h[2] >= screen.near && h[2] <= screen.far && x.is_finite() && y.is_finite()) {
        return false;
    }
    let [rx, ry] = stroke.radii(screen, h[2]);
    let word = u64::from(screen.key(value)) << 32 | low;
    // Conversions of floats saturate. The pixel that it lies in is covered, however small it is.
    let (column, row) = (x.floor() as i32, y.floor() as i32);
    let (width, height) = (screen.width as i32, screen.height as i32);
    let inside = column >= 0 && column < width && row >= 0 && row < height;
    if rx <= 0.5 && ry <= 0.5 {
        // The centre of no other is as near.
        if inside {
            sink.put(screen.pixel_address(column as usize, row as usize), word);
        }
        return inside;
    }
    let (mut top, mut bottom) = ((y - ry - 0.5).ceil() as i32, (y + ry - 0.5).floor() as i32);
    if inside {
        (top, bottom) = (top.min(row), bottom.max(row));
    }
    let flatness = 1.0 / ry;
    let mut reached = false;
    for j in top.max(0)..=bottom.min(height - 1) {
        let down = (j as f32 + 0.5 - y) * flatness;
        let half = rx * (1.0 - down * down).max(0.0).sqrt();
        let (mut first, mut last) = ((x - half - 0.5).ceil() as i32, (x + half - 0.5).floor() as i32);
        if inside && j == row {
            (first, last) = (first.min(column), last.max(column));
        }
        for i in first.max(0)..=last.min(width - 1) {
            sink.put(screen.pixel_address(i as usize, j as usize), word);
            reached = true;
        }
    }
    reached
}

/// A point of a segment on the picture.
#[derive(Clone, Copy)]
struct End {
    at: [f64; 2],
    value: f64,
    radii: [f64; 2],
}

impl End {
    fn new(h: [f64; 3], stroke: &Stroke, screen: &Screen) -> Self {
        let (scale, value) =
            if screen.orthographic { (1.0, h[2]) } else { (1.0 / h[2], f64::from(screen.near) / h[2]) };
        let radii = stroke.radii(screen, h[2] as f32).map(f64::from);
        Self { at: [h[0] * scale, h[1] * scale], value, radii }
    }
}

/// The part of a segment between the near and the far distance.
fn clipped([a, b]: [[f64; 3]; 2], screen: &Screen) -> Option<[[f64; 3]; 2]> {
    let (near, far) = (f64::from(screen.near), f64::from(screen.far));
    let (mut from, mut to) = (0.0f64, 1.0f64);
    let change = b[2] - a[2];
    for (limit, sign) in [(near, 1.0), (far, -1.0)] {
        if limit.is_infinite() {
            continue;
        }
        let (of_a, of_b) = (sign * (a[2] - limit), sign * (b[2] - limit));
        if of_a < 0.0 && of_b < 0.0 {
            return None;
        }
        let meets = (limit - a[2]) / change;
        if of_a < 0.0 {
            from = from.max(meets);
        } else if of_b < 0.0 {
            to = to.min(meets);
        }
    }
    let mut ends = [from, to].map(|t| std::array::from_fn(|k| a[k] + t * (b[k] - a[k])));
    for end in &mut ends {
        let end: &mut [f64; 3] = end;
        end[2] = end[2].clamp(near, far);
    }
    (from <= to && ends.as_flattened().iter().all(|v| v.is_finite())).then_some(ends)
}

fn line<S: Sink>(ends: [[f64; 3]; 2], stroke: &Stroke, screen: &Screen, low: u64, sink: &S) -> bool {
    let Some(ends) = clipped(ends, screen) else { return false };
    let [mut a, mut b] = ends.map(|h| End::new(h, stroke, screen));
    // From the nearer end on.
    if screen.key(a.value as f32) < screen.key(b.value as f32) {
        (a, b) = (b, a);
    }
    // On a picture so squeezed that discs are round.
    let squeeze = a.radii[0] / a.radii[1];
    let flat = |end: &End| [end.at[0] / squeeze, end.at[1]];
    let (p, q) = (flat(&a), flat(&b));
    let d = [q[0] - p[0], q[1] - p[1]];
    let length = d[0].hypot(d[1]);
    let radii = [a.radii[1], b.radii[1]];
    let sides = sides([p, q], radii, d, length);
    let (low_y, high_y) = [&a, &b].iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), end| {
        (low.min(end.at[1] - end.radii[1]), high.max(end.at[1] + end.radii[1]))
    });
    let (top, bottom) = between(low_y, high_y, screen.height);
    let mut reached = false;
    for y in top..=bottom {
        let row = f64::from(y) + 0.5;
        // The hull of two discs is convex: what a row shows of it lies between the ends of what it shows of their parts.
        let mut range = [&a, &b]
            .iter()
            .map(|end| across(end.at, end.radii, row))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (left, right)| {
                (low.min(left), high.max(right))
            });
        for [from, to] in sides.iter().flatten() {
            if (from[1] <= row) != (to[1] <= row) {
                let x = squeeze * (from[0] + (row - from[1]) / (to[1] - from[1]) * (to[0] - from[0]));
                range = (range.0.min(x), range.1.max(x));
            }
        }
        let (first, last) = between(range.0, range.1, screen.width);
        for x in first..=last {
            let way = [(f64::from(x) + 0.5) / squeeze - p[0], row - p[1]];
            let t = nearest_disc(way, d, length, radii);
            let value = (a.value + t * (b.value - a.value)) as f32;
            let word = u64::from(screen.key(value)) << 32 | low;
            sink.put(screen.pixel_address(x as usize, y as usize), word);
            reached = true;
        }
    }
    // One seen end on may lie between the centres: like a point, it shows in its pixel.
    let [column, row] = a.at.map(|v| v.floor());
    let inside =
        column >= 0.0 && column < f64::from(screen.width) && row >= 0.0 && row < f64::from(screen.height);
    if !reached && inside {
        let word = u64::from(screen.key(a.value as f32)) << 32 | low;
        sink.put(screen.pixel_address(column as usize, row as usize), word);
        reached = true;
    }
    reached
}

/// Where along a segment the first disc lies that covers a point: from 0 at its first end to 1 at its second. Radii shrink
/// linearly, since the first end is the nearer one; the point is given from there.
fn nearest_disc(way: [f64; 2], d: [f64; 2], length: f64, radii: [f64; 2]) -> f64 {
    let widening = (radii[1] - radii[0]) / length;
    let slope = 1.0 - widening * widening;
    // The first disc holds the other, or both are one.
    if slope.is_nan() || slope <= 0.0 {
        return 0.0;
    }
    // The distance from the point of the axis at s is the radius there.
    let along = (way[0] * d[0] + way[1] * d[1]) / length;
    let half = along + radii[0] * widening;
    let rest = way[0] * way[0] + way[1] * way[1] - radii[0] * radii[0];
    let s = (half - (half * half - slope * rest).max(0.0).sqrt()) / slope;
    (s / length).clamp(0.0, 1.0)
}

/// How far along a segment lies what a pixel shows of it: from 0 at its first end to 1 at its second. Where its depth says
/// little, since the ends are as far off, the point of the picture does.
pub(super) fn share_along(
    rows: &[[f32; 4]; 3],
    ends: [[f32; 3]; 2],
    point: [f32; 2],
    distance: f32,
    orthographic: bool,
) -> f32 {
    let ([a, b], distance) = (ends.map(|end| homogeneous(rows, end)), f64::from(distance));
    let change = b[2] - a[2];
    let t = if change.abs() > TELLING * distance.abs() {
        (distance - a[2]) / change
    } else {
        let p = point.map(f64::from);
        // Relative to the point, and the direction of the segment on the picture.
        let from = |h: [f64; 3]| [0, 1].map(|k| h[k] - p[k] * if orthographic { 1.0 } else { h[2] });
        let way = if orthographic {
            [b[0] - a[0], b[1] - a[1]]
        } else {
            [a[2] * b[0] - a[0] * b[2], a[2] * b[1] - a[1] * b[2]]
        };
        let dot = |v: [f64; 2]| v[0] * way[0] + v[1] * way[1];
        let (of_a, of_b) = (dot(from(a)), dot(from(b)));
        of_a / (of_a - of_b)
    };
    // One without length shows its first end.
    if t.is_finite() { t.clamp(0.0, 1.0) as f32 } else { 0.0 }
}

/// Ends that differ more in their distance, relative to it, are told apart by it.
const TELLING: f64 = 1.0e-2;

/// The lines that touch two discs on both sides; none where one holds the other.
fn sides([p, q]: [[f64; 2]; 2], radii: [f64; 2], d: [f64; 2], length: f64) -> Option<[[[f64; 2]; 2]; 2]> {
    let sine = (radii[0] - radii[1]) / length;
    // Also where the length is 0.
    if sine.is_nan() || sine.abs() >= 1.0 {
        return None;
    }
    let along = d.map(|v| v / length);
    let cosine = (1.0 - sine * sine).sqrt();
    Some([1.0, -1.0].map(|side| {
        let normal = [along[0] * sine - side * along[1] * cosine, along[1] * sine + side * along[0] * cosine];
        [(p, radii[0]), (q, radii[1])]
            .map(|(at, radius)| [at[0] + radius * normal[0], at[1] + radius * normal[1]])
    }))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU32;

    use super::*;
    use crate::cpu::visibility::Counter;

    const SIZE: u32 = 64;

    fn screen(orthographic: bool) -> Screen {
        Screen { width: SIZE, height: SIZE, orthographic, near: 0.5, far: 100.0, far_key: 0 }
    }

    fn numbers(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    }

    /// How often each pixel was drawn.
    fn counted(draw: impl FnOnce(&Counter<'_>)) -> Vec<u32> {
        let cells: Vec<AtomicU32> = (0..SIZE * SIZE).map(|_| AtomicU32::new(0)).collect();
        draw(&Counter(&cells));
        cells.into_iter().map(AtomicU32::into_inner).collect()
    }

    /// The pixels that are covered are those whose centres are near enough, each drawn once.
    #[test]
    fn discs_and_capsules_cover_the_pixels_within_their_radius() {
        let mut seed = 7;
        for case in 0..2000 {
            let orthographic = case % 2 == 0;
            let (screen, line) = (screen(orthographic), case % 4 < 2);
            let mut random = |low: f64, high: f64| low + (high - low) * numbers(&mut seed);
            let stroke = Stroke { line, pixels: random(0.0, 9.0) as f32, spread: [0.0; 2] };
            let radius = f64::from(stroke.pixels.max(0.5));
            let ends: [[f32; 3]; 2] = std::array::from_fn(|_| {
                let d = if orthographic { 1.0 } else { random(1.0, 9.0) };
                [random(-20.0, 84.0) * d, random(-20.0, 84.0) * d, d].map(|v| v as f32)
            });
            let counts = counted(|sink| {
                if line {
                    super::line(ends.map(|h| h.map(f64::from)), &stroke, &screen, 1, sink);
                } else {
                    point(ends[0], &stroke, &screen, 1, sink);
                }
            });
            let [p, q] = ends.map(|h| [h[0] / h[2], h[1] / h[2]].map(f64::from));
            let q = if line { q } else { p };
            for (pixel, count) in counts.iter().enumerate() {
                let [column, row] = screen.pixel_of(pixel as u32);
                let at = [f64::from(column) + 0.5, f64::from(row) + 0.5];
                let d = [q[0] - p[0], q[1] - p[1]];
                let way = [at[0] - p[0], at[1] - p[1]];
                let square = d[0] * d[0] + d[1] * d[1];
                let t = if square > 0.0 { (way[0] * d[0] + way[1] * d[1]) / square } else { 0.0 };
                let t = t.clamp(0.0, 1.0);
                let distance = (way[0] - t * d[0]).hypot(way[1] - t * d[1]);
                let own = !line && [f64::from(column), f64::from(row)] == p.map(f64::floor);
                if own || distance < radius - 1e-3 {
                    assert_eq!(*count, 1, "case {case}, pixel {pixel}");
                } else if distance > radius + 1e-3 {
                    assert_eq!(*count, 0, "case {case}, pixel {pixel}");
                }
            }
        }
    }

    #[test]
    fn what_reaches_behind_the_eye_is_cut_off() {
        let screen = screen(false);
        let stroke = Stroke { line: true, pixels: 2.0, spread: [0.0; 2] };
        let drawn = |a: [f32; 3], b: [f32; 3]| {
            counted(|sink| {
                line([a, b].map(|h| h.map(f64::from)), &stroke, &screen, 1, sink);
            })
        };
        // From the middle of the picture towards the eye and past it, to the right.
        let whole = drawn([32.0, 32.0, 1.0], [200.0, -32.0, -1.0]);
        assert!(whole[(32 * SIZE + 32) as usize] == 1 && whole[(32 * SIZE + SIZE - 1) as usize] == 1);
        for (a, b) in [
            ([0.0, 0.0, -1.0], [5.0, 5.0, -2.0]),
            ([0.0, 0.0, 200.0], [9.0, 9.0, 300.0]),
            ([f32::NAN, 0.0, 1.0], [9.0, 9.0, 2.0]),
            ([f32::INFINITY, 0.0, 1.0], [9.0, 9.0, 2.0]),
        ] {
            assert_eq!(drawn(a, b).iter().sum::<u32>(), 0, "{a:?} {b:?}");
            let shown = counted(|sink| {
                point(a, &stroke, &screen, 1, sink);
            });
            assert_eq!(shown.iter().sum::<u32>(), 0, "{a:?}");
        }
        // A very long one ends, and is drawn right.
        let long = drawn([-1.0e30, 32.2, 1.0], [1.0e30, 32.2, 1.0]);
        assert_eq!(long.iter().sum::<u32>(), 4 * SIZE);
    }

    /// Of the discs along a segment that cover a point the first is found: against many of them.
    #[test]
    fn the_first_disc_that_covers_a_point_counts() {
        let mut seed = 3;
        for _ in 0..3000 {
            let mut random = |low: f64, high: f64| low + (high - low) * numbers(&mut seed);
            let d = [random(-9.0, 9.0), random(-9.0, 9.0)];
            let first = random(0.5, 6.0);
            let radii = [first, random(0.5, first + 1.0e-9)];
            let way = [random(-12.0, 20.0), random(-12.0, 12.0)];
            let covers = |t: f64| {
                let radius = radii[0] + t * (radii[1] - radii[0]);
                (way[0] - t * d[0]).hypot(way[1] - t * d[1]) <= radius
            };
            let steps = 2000;
            let first = (0..=steps).map(|i| f64::from(i) / f64::from(steps)).find(|t| covers(*t));
            let Some(first) = first else { continue };
            let found = nearest_disc(way, d, d[0].hypot(d[1]), radii);
            assert!((found - first).abs() <= 1.5 / f64::from(steps), "{found} for {first}");
        }
        assert_eq!(nearest_disc([0.3, 0.1], [0.0, 0.0], 0.0, [2.0, 2.0]), 0.0);
        assert_eq!(nearest_disc([0.3, 0.1], [0.0, 0.0], 0.0, [3.0, 2.0]), 0.0);
    }

    #[test]
    fn lines_that_end_very_far_off_are_where_they_are() {
        let rows = [[100.0, 0.0, 32.0, 64.0], [0.0, -100.0, 32.0, 64.0], [0.0, 0.0, 1.0, 2.0]];
        for far in [1.0f32, 1.0e7, 1.0e12] {
            let [a, b] = [[-far, 0.0, 0.0], [far, 0.0, 0.0]].map(|p| homogeneous(&rows, p));
            let middle: [f64; 3] = std::array::from_fn(|k| (a[k] + b[k]) / 2.0);
            assert_eq!(middle, [64.0, 64.0, 2.0]);
            let at = share_along(&rows, [[-far, 0.0, 0.0], [far, 0.0, 0.0]], [32.0, 32.0], 2.0, false);
            assert!((at - 0.5).abs() < 1e-6);
        }
    }
}
