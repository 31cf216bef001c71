//! Stage 5. Clusters with large triangles, or that reach the near plane, the far plane or the guard band →
//! visibility buffer.
//!
//! Triangles are clipped, their depth plane is solved in f64 from the homogeneous corners (so it holds for the
//! clipped part too), and rows are filled between the ends that the integer edge functions give by division:
//! no pixel is tested. Very large triangles are set aside and shared out by bands of rows.

use rayon::prelude::*;

use super::clip::{ClipVertex, clip};
use super::project::{InstanceView, Screen};
use super::triangle::{UNIT, edge_bias, pixels, project, snap};
use super::visibility::{Sink, Visible, payload};
use crate::limits::GUARD_BAND;

/// Triangles whose box has more pixels are shared out by bands.
const SHARE_ABOVE: i64 = 1 << 14;
/// Rows of a band.
const BAND: i32 = 16;

/// A triangle ready to be filled.
#[derive(Clone, Debug)]
pub struct Setup {
    corners: [[i32; 2]; 3],
    plane: Plane,
    low: u32,
    rows: (i32, i32),
}

/// The depth value as a function of the screen position, and its range.
#[derive(Clone, Copy, Debug)]
struct Plane {
    c: [f64; 3],
    low: f32,
    high: f32,
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
    let geometry = view.mesh.geometry(at.cluster);
    let points: Vec<[f32; 3]> = geometry.positions.iter().map(|&p| view.homogeneous(p)).collect();
    let mut drawn = 0;
    let mut shared = Vec::new();
    for (t, &[a, b, c]) in geometry.triangles.iter().enumerate() {
        let (b, c) = if view.mirrored { (b, c) } else { (c, b) };
        let corners = [a, b, c].map(|v| points[usize::from(v)]);
        let mut reached = false;
        setup(corners, view.material.double_sided, screen, payload - t as u32, |setup, area| {
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
    let safe = |p: &[f32; 3]| {
        let reach = if screen.orthographic { GUARD_BAND } else { GUARD_BAND * p[2] };
        p[2] >= screen.near && p[0].abs() < reach && p[1].abs() < reach
    };
    let snapped = |p: [f32; 3]| {
        let [x, y, _] = project(screen, p);
        [snap(x), snap(y)]
    };
    // Through the snapped corners where all of them are on the screen: at a covered pixel it is then a mean of
    // their depths, also on a surface seen edge-on.
    let plane_corners = if corners.iter().all(safe) {
        corners.map(|p| {
            let scale = if screen.orthographic { 1.0 } else { p[2] } / UNIT as f32;
            let [x, y] = snapped(p);
            [x as f32 * scale, y as f32 * scale, p[2]]
        })
    } else {
        corners
    };
    let mut plane = None;
    let mut piece = |points: [[i32; 2]; 3]| {
        let [[x0, y0], [x1, y1], [x2, y2]] = points.map(|p| p.map(i64::from));
        let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        if area == 0 || (area < 0 && !double_sided) {
            return;
        }
        let points = if area < 0 { [points[0], points[2], points[1]] } else { points };
        let range = |k: usize, size: u32| {
            let v = points.map(|p| p[k]);
            let (first, last) = pixels(v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]));
            (first.max(0), last.min(size as i32 - 1))
        };
        let (columns, rows) = (range(0, screen.width), range(1, screen.height));
        if columns.0 > columns.1 || rows.0 > rows.1 {
            return;
        }
        let plane = *plane.get_or_insert_with(|| Plane::new(&plane_corners, screen));
        let area = i64::from(columns.1 - columns.0 + 1) * i64::from(rows.1 - rows.0 + 1);
        emit(Setup { corners: points, plane, low, rows }, area);
    };
    if corners.iter().all(safe) {
        piece(corners.map(snapped));
        return;
    }
    let polygon = clip(corners, screen);
    let snap_vertex = |v: &ClipVertex| match v.corner {
        Some(i) => snapped(corners[usize::from(i)]),
        None => {
            let r = if screen.orthographic { 1.0 } else { 1.0 / v.at[2] };
            let guard = f64::from(GUARD_BAND);
            [v.at[0], v.at[1]]
                .map(|c| ((c * r).clamp(-guard, guard) * f64::from(UNIT)).round_ties_even() as i32)
        }
    };
    let points: Vec<[i32; 2]> = polygon.vertices().iter().map(snap_vertex).collect();
    for i in 1..points.len().saturating_sub(1) {
        piece([points[0], points[i], points[i + 1]]);
    }
}

impl Plane {
    /// Solves v = c₀ x + c₁ y + c₂ for the corners: for a pinhole, 1/d is linear on the screen, and
    /// c·(x, y, d) = near at every corner, behind the eye too.
    fn new(corners: &[[f32; 3]; 3], screen: &Screen) -> Self {
        let p = corners.map(|c| c.map(f64::from));
        let near = f64::from(screen.near);
        let rows = if screen.orthographic { p.map(|c| [c[0], c[1], 1.0]) } else { p };
        let right = if screen.orthographic { p.map(|c| c[2]) } else { [near; 3] };
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let minors = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])];
        let determinant: f64 = (0..3).map(|k| rows[0][k] * minors[0][k]).sum();
        let values = corners.iter().filter(|c| c[2] >= screen.near).map(|c| screen.value(c[2]));
        let (mut low, mut high) =
            values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if corners.iter().any(|c| c[2] < screen.near) {
            let nearest = screen.value(screen.near);
            (low, high) = (low.min(nearest), high.max(nearest));
        }
        let c = std::array::from_fn(|k| (0..3).map(|i| right[i] * minors[i][k]).sum::<f64>() / determinant);
        let c = if c.iter().all(|v: &f64| v.is_finite()) { c } else { [0.0, 0.0, f64::from(low)] };
        Self { c, low, high }
    }
}

/// Fills rows `first..=last` of a triangle.
fn fill<S: Sink>(setup: &Setup, first: i32, last: i32, screen: &Screen, sink: &S) {
    let corners = setup.corners.map(|p| p.map(i64::from));
    let unit = i64::from(UNIT);
    let edges: [(i64, i64, i64); 3] = std::array::from_fn(|k| {
        let ([ax, ay], [bx, by]) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
        let (dx, dy) = (bx - ax, by - ay);
        // At the centre of column 0 of row 0, and the steps per column and per row.
        let start = dx * (unit / 2 - ay) - dy * (unit / 2 - ax) + i64::from(edge_bias(dx as i32, dy as i32));
        (start, -dy * unit, dx * unit)
    });
    let far_key = screen.far_key;
    let width = screen.width as usize;
    for row in first..=last {
        let (mut left, mut right) = (0, i64::from(screen.width) - 1);
        for &(start, step_x, step_y) in &edges {
            let e = start + i64::from(row) * step_y;
            if step_x > 0 {
                left = left.max((-e + step_x - 1).div_euclid(step_x));
            } else if step_x < 0 {
                right = right.min(e.div_euclid(-step_x));
            } else if e < 0 {
                right = -1;
            }
        }
        if left > right {
            continue;
        }
        let plane = &setup.plane;
        let base = plane.c[1] * (f64::from(row) + 0.5) + plane.c[2];
        let start = row as usize * width;
        for column in left..=right {
            let value = (base + plane.c[0] * (column as f64 + 0.5)) as f32;
            let key = screen.key(value.max(plane.low).min(plane.high));
            if key >= far_key {
                sink.put(start + column as usize, u64::from(key) << 32 | u64::from(setup.low));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::visibility::Counter;
    use super::*;
    use std::sync::atomic::AtomicU32;

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
    fn the_plane_gives_exact_distances_on_a_slanted_floor() {
        let screen = screen(0.25);
        let point = |x: f32, z: f32| [40.0 * x + 30.5 * z, 20.0 + 10.0 * z, z];
        let plane = Plane::new(&[point(-50.0, -10.0), point(50.0, -10.0), point(0.0, 1000.0)], &screen);
        for row in 11..37 {
            let y = f64::from(row) + 0.5;
            let expected = 20.0 / (y - 10.0);
            let value = plane.c[0] * 30.5 + plane.c[1] * y + plane.c[2];
            assert!((0.25 / value / expected - 1.0).abs() < 1e-12);
        }
    }
}
