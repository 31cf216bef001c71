//! Stage 5. Clusters with large triangles, or that reach the near plane, the far plane or the guard band →
//! visibility buffer.
//!
//! Triangles are clipped, and rows are filled between the ends that the integer edge functions give by division: no
//! pixel is tested. Depth is the mean of the corners' depth values by those edge functions, which are exact and none
//! negative, so that its relative error stays small where values differ by orders of magnitude. Very large triangles
//! are set aside and shared out by bands of rows.
//!
//! Alpha-tested clusters come here whatever their size; alpha is tested at each of their pixels.

use rayon::prelude::*;

use super::clip::clip;
use super::material::is_hole;
use super::surface::{self, Pixels};
use super::triangle::{UNIT, edge_bias, pixels, project, snap};
use super::visibility::Sink;
use crate::limits::GUARD_BAND;
use crate::views::{InstanceView, Screen, Visible, decode, payload};

/// Triangles whose box has more pixels are shared out by bands.
const SHARE_ABOVE: i64 = 1 << 14;
/// Rows of a band.
const BAND: i32 = 16;

/// A triangle ready to be filled, with the inside on the right of every edge.
#[derive(Clone, Debug)]
pub struct Setup {
    corners: [[i32; 2]; 3],
    /// Depth values of the corners.
    values: [f32; 3],
    low: u32,
    rows: (i32, i32),
}

/// Draws clusters, given as numbers in the frame's visible list. Returns the triangles that faced the eye and
/// had a pixel to offer.
pub fn run<S: Sink>(
    numbers: &[u32],
    visible: &[Visible],
    views: &[InstanceView],
    screen: &Screen,
    sink: &S,
) -> u64 {
    if views.iter().all(|view| view.materials.alpha_tested_bits() == 0) {
        return draw(numbers, visible, views, screen, sink);
    }
    let (alpha_tested, whole): (Vec<u32>, Vec<u32>) = numbers.iter().partition(|&&number| {
        let Visible { instance, cluster } = visible[number as usize];
        let view = &views[instance as usize];
        view.materials.alpha_tested(view.pages.record(cluster).material)
    });
    let pixels = Pixels { words: &[], visible, views, screen };
    draw(&whole, visible, views, screen, sink)
        + draw(&alpha_tested, visible, views, screen, &AlphaTested { pixels, sink })
}

/// Passes on what the alpha test keeps.
struct AlphaTested<'a, S> {
    pixels: Pixels<'a>,
    sink: &'a S,
}

impl<S: Sink> Sink for AlphaTested<'_, S> {
    fn put(&self, pixel: usize, word: u64) {
        let point = decode(word).map(|hit| surface::one(self.pixels, pixel, hit));
        if !point.as_ref().is_some_and(is_hole) {
            self.sink.put(pixel, word);
        }
    }
}

fn draw<S: Sink>(
    numbers: &[u32],
    visible: &[Visible],
    views: &[InstanceView],
    screen: &Screen,
    sink: &S,
) -> u64 {
    let parts: Vec<(u64, Vec<Setup>)> = numbers
        .par_iter()
        .map(|&number| {
            let at = visible[number as usize];
            let view = &views[at.instance as usize];
            draw_cluster(view, at, payload(number as usize), screen, sink)
        })
        .collect();
    let drawn = parts.iter().map(|p| p.0).sum();
    let bands: Vec<(&Setup, i32)> = parts
        .iter()
        .flat_map(|p| &p.1)
        .flat_map(|setup| (setup.rows.0..=setup.rows.1).step_by(BAND as usize).map(move |row| (setup, row)))
        .collect();
    bands.par_iter().for_each(|&(setup, row)| {
        fill(setup, row, setup.rows.1.min(row + BAND - 1), screen, sink);
    });
    drawn
}

fn draw_cluster<S: Sink>(
    view: &InstanceView,
    at: Visible,
    payload: u32,
    screen: &Screen,
    sink: &S,
) -> (u64, Vec<Setup>) {
    let geometry = view.cluster(at.cluster);
    let double_sided = view.double_sided(view.pages.record(at.cluster).material);
    let points: Vec<[f32; 3]> = geometry.positions.iter().map(|p| view.homogeneous(p)).collect();
    let mut drawn = 0;
    let mut shared = Vec::new();
    for (t, [a, b, c]) in geometry.triangles.iter().enumerate() {
        let (b, c) = if view.mirrored { (b, c) } else { (c, b) };
        let corners = [a, b, c].map(|v| points[usize::from(v)]);
        let mut reached = false;
        setup(corners, double_sided, screen, payload - t as u32, |setup, area| {
            reached = true;
            if area > SHARE_ABOVE {
                shared.push(setup);
            } else {
                fill(&setup, setup.rows.0, setup.rows.1, screen, sink);
            }
        });
        drawn += u64::from(reached);
    }
    (drawn, shared)
}

/// Clips and snaps a triangle and emits its pieces with the pixels of their boxes.
fn setup(
    corners: [[f32; 3]; 3],
    double_sided: bool,
    screen: &Screen,
    low: u32,
    mut emit: impl FnMut(Setup, i64),
) {
    let mut piece = |points: [[f32; 3]; 3]| {
        let [a, mut b, mut c] = points.map(|[x, y, value]| ([snap(x), snap(y)], value));
        let area = doubled_area([a.0, b.0, c.0]);
        if area == 0 || (area < 0 && !double_sided) {
            return;
        }
        if area < 0 {
            (b, c) = (c, b);
        }
        let range = |k: usize, size: u32| {
            let v = [a.0[k], b.0[k], c.0[k]];
            let (first, last) = pixels(v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]));
            (first.max(0), last.min(size as i32 - 1))
        };
        let (columns, rows) = (range(0, screen.width), range(1, screen.height));
        if columns.0 > columns.1 || rows.0 > rows.1 {
            return;
        }
        let area = i64::from(columns.1 - columns.0 + 1) * i64::from(rows.1 - rows.0 + 1);
        emit(Setup { corners: [a.0, b.0, c.0], values: [a.1, b.1, c.1], low, rows }, area);
    };
    let whole = |p: &[f32; 3]| {
        let reach = if screen.orthographic { GUARD_BAND } else { GUARD_BAND * p[2] };
        p[2] >= screen.near && p[0].abs() < reach && p[1].abs() < reach
    };
    if corners.iter().all(whole) {
        piece(corners.map(|p| project(screen, p)));
        return;
    }
    let polygon = clip(corners, screen);
    let points: Vec<[f32; 3]> = polygon.vertices().iter().map(|v| project(screen, *v)).collect();
    for i in 1..points.len().saturating_sub(1) {
        piece([points[0], points[i], points[i + 1]]);
    }
}

/// Twice the area of a snapped triangle, positive with the inside on the right of every edge.
fn doubled_area(corners: [[i32; 2]; 3]) -> i64 {
    let [[x0, y0], [x1, y1], [x2, y2]] = corners.map(|p| p.map(i64::from));
    (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
}

/// Fills rows `first..=last` of a triangle.
fn fill<S: Sink>(setup: &Setup, first: i32, last: i32, screen: &Screen, sink: &S) {
    let corners = setup.corners.map(|p| p.map(i64::from));
    let unit = i64::from(UNIT);
    let edges: [Edge; 3] = std::array::from_fn(|k| {
        let ([ax, ay], [bx, by]) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
        let (dx, dy) = (bx - ax, by - ay);
        let bias = i64::from(edge_bias(dx as i32, dy as i32));
        let start = dx * (unit / 2 - ay) - dy * (unit / 2 - ax) + bias;
        Edge { start, step_x: -dy * unit, step_y: dx * unit, bias }
    });
    let far_key = screen.far_key;
    let values = setup.values;
    let low = values[0].min(values[1]).min(values[2]);
    let high = values[0].max(values[1]).max(values[2]);
    // Integers below 2^53 are exact in f64.
    let inverse = 1.0 / (doubled_area(setup.corners) as f64 as f32);
    let steps = [0, 1, 2].map(|k| edges[k].step_x as f64);
    for row in first..=last {
        let (mut left, mut right) = (0, i64::from(screen.width) - 1);
        let at_row = [0, 1, 2].map(|k| edges[k].start + i64::from(row) * edges[k].step_y);
        for (edge, e) in edges.iter().zip(at_row) {
            if edge.step_x > 0 {
                left = left.max((-e + edge.step_x - 1).div_euclid(edge.step_x));
            } else if edge.step_x < 0 {
                right = right.min(e.div_euclid(-edge.step_x));
            } else if e < 0 {
                right = -1;
            }
        }
        if left > right {
            continue;
        }
        // The weight of each corner is the edge function of the other two.
        let weight = |k: usize| (at_row[k] - edges[k].bias + left * edges[k].step_x) as f64;
        let [mut a, mut b, mut c] = [0, 1, 2].map(weight);
        let start = screen.pixel_address(0, row as usize);
        for pixel in start + left as usize..=start + right as usize {
            let mean = (a as f32 * values[0] + b as f32 * values[1] + c as f32 * values[2]) * inverse;
            let key = screen.key(mean.max(low).min(high));
            if key >= far_key {
                sink.put(pixel, u64::from(key) << 32 | u64::from(setup.low));
            }
            (a, b, c) = (a + steps[0], b + steps[1], c + steps[2]);
        }
    }
}

/// An edge function: its value, biased by the top-left rule, at the centre of column 0 of row 0, and its steps.
struct Edge {
    start: i64,
    step_x: i64,
    step_y: i64,
    bias: i64,
}

#[cfg(test)]
mod tests {
    use super::super::visibility::{Counter, Nearest};
    use super::*;
    use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

    fn counts(triangles: &[[[f32; 3]; 3]], screen: &Screen) -> Vec<u32> {
        let cells: Vec<AtomicU32> = (0..screen.width * screen.height).map(|_| AtomicU32::new(0)).collect();
        for &corners in triangles {
            setup(corners, true, screen, u32::MAX, |s, _| {
                fill(&s, s.rows.0, s.rows.1, screen, &Counter(&cells))
            });
        }
        cells.into_iter().map(AtomicU32::into_inner).collect()
    }

    fn screen(near: f32) -> Screen {
        Screen { width: 61, height: 37, orthographic: false, near, far: f32::INFINITY, far_key: 0 }
    }

    #[test]
    fn a_fan_around_a_point_covers_every_pixel_exactly_once() {
        // The rim lies far outside, partly outside the guard band; the hub on a pixel centre.
        let screen = screen(0.1);
        for hub in [[30.5f32, 18.5], [30.0, 18.0], [17.3, 9.9]] {
            let rim = |i: usize| {
                let a = i as f32 * std::f32::consts::TAU / 11.0;
                [hub[0] + 40_000.0 * a.cos(), hub[1] + 40_000.0 * a.sin(), 1.0]
            };
            let fan: Vec<_> = (0..11).map(|i| [[hub[0], hub[1], 1.0], rim(i), rim((i + 1) % 11)]).collect();
            assert!(counts(&fan, &screen).iter().all(|&c| c == 1));
        }
    }

    #[test]
    fn triangles_through_the_eye_plane_meet_without_cracks() {
        // A floor that passes below the eye, cut by the near plane: in homogeneous form, y = h·f + cy·d.
        let screen = screen(0.25);
        let (f, cx, cy) = (40.0, 30.5, 10.0);
        let point = |x: f32, z: f32| [f * x + cx * z, f * 0.5 + cy * z, z];
        let mut seed = 5u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / 16_777_216.0
        };
        let n = 6;
        let grid: Vec<Vec<[f32; 3]>> = (0..=n)
            .map(|i| {
                (0..=n)
                    .map(|j| {
                        let mut inner = |k: usize| if k == 0 || k == n { 0.0 } else { random() - 0.5 };
                        let (u, v) = (i as f32 + inner(i), j as f32 + inner(j));
                        point((u / n as f32 - 0.5) * 400.0, (v / n as f32 - 0.4) * 200.0)
                    })
                    .collect()
            })
            .collect();
        let mut triangles = Vec::new();
        for i in 0..n {
            for j in 0..n {
                let (a, b, c, d) = (grid[i][j], grid[i + 1][j], grid[i + 1][j + 1], grid[i][j + 1]);
                triangles.push([a, b, c]);
                triangles.push([a, c, d]);
            }
        }
        let cells = counts(&triangles, &screen);
        // Horizon at row 10; the floor's far end at z = 120 lies at 10 + 20/120.
        for (pixel, count) in cells.iter().enumerate() {
            let row = pixel / 61;
            let expected = u32::from(row >= 10);
            assert_eq!(*count, expected, "row {row} column {}", pixel % 61);
        }
    }

    #[test]
    fn distances_on_a_slanted_floor_are_those_of_a_point_within_a_snapped_unit() {
        // From behind the eye to a horizon at row 10, over four orders of magnitude.
        let screen = screen(0.25);
        let point = |x: f32, z: f32| [40.0 * x + 30.5 * z, 20.0 + 10.0 * z, z];
        let cells: Vec<AtomicU64> = (0..screen.width * screen.height).map(|_| AtomicU64::new(0)).collect();
        setup([point(-9000.0, -10.0), point(0.0, 9000.0), point(9000.0, -10.0)], true, &screen, 0, |s, _| {
            fill(&s, s.rows.0, s.rows.1, &screen, &Nearest(&cells));
        });
        for row in 10..37 {
            let word = cells[row * 61 + 30].load(Ordering::Relaxed);
            let distance = screen.distance((word >> 32) as u32);
            let y = row as f32 + 0.5;
            let (near, far) = (20.0 / (y + 1.0 / 128.0 - 10.0), 20.0 / (y - 1.0 / 128.0 - 10.0));
            assert!((near..=far).contains(&distance), "row {row}: {distance} not in {near}..{far}");
        }
    }
}
