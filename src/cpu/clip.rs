//! Clipping of triangles against the near plane and the guard band.
//!
//! An edge that a plane cuts is intersected from its smaller to its larger end point (by coordinates), so the
//! two triangles of an edge compute the same new vertex, bit for bit, and nothing cracks. Sutherland and
//! Hodgman, "Reentrant polygon clipping", CACM 17(1), 1974.

use super::project::Screen;
use crate::limits::GUARD_BAND;

/// A convex polygon in homogeneous screen coordinates: a triangle cut by five planes at most.
#[derive(Clone, Copy, Debug)]
pub struct Polygon {
    vertices: [[f64; 3]; 8],
    count: usize,
}

impl Polygon {
    /// The corners, in the triangle's order.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices[..self.count]
    }

    fn push(&mut self, vertex: [f64; 3]) {
        // A convex polygon gains one vertex per plane: 3 + 5 fit.
        self.vertices[self.count] = vertex;
        self.count += 1;
    }

    fn cut(&self, inside: impl Fn(&[f64; 3]) -> f64) -> Self {
        let mut out = Self { count: 0, ..*self };
        for i in 0..self.count {
            let (a, b) = (self.vertices[i], self.vertices[(i + 1) % self.count]);
            let (da, db) = (inside(&a), inside(&b));
            if da >= 0.0 {
                out.push(a);
            }
            if (da >= 0.0) != (db >= 0.0) {
                out.push(intersect(a, da, b, db));
            }
        }
        out
    }
}

fn intersect(a: [f64; 3], da: f64, b: [f64; 3], db: f64) -> [f64; 3] {
    let swap = a.iter().zip(&b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne()).is_some_and(|o| o.is_gt());
    let (a, da, b, db) = if swap { (b, db, a, da) } else { (a, da, b, db) };
    let t = da / (da - db);
    std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
}

/// The part of a triangle (homogeneous screen coordinates) at or behind the near plane and inside the guard
/// band.
pub fn clip(corners: [[f32; 3]; 3], screen: &Screen) -> Polygon {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let whole = Polygon { vertices: [a, b, c, c, c, c, c, c], count: 3 };
    let near = f64::from(screen.near);
    let mut polygon = whole.cut(|v| v[2] - near);
    let guard = f64::from(GUARD_BAND);
    let weight = |v: &[f64; 3]| if screen.orthographic { 1.0 } else { v[2] };
    for k in 0..2 {
        polygon = polygon.cut(|v| guard * weight(v) + v[k]);
        polygon = polygon.cut(|v| guard * weight(v) - v[k]);
    }
    polygon
}

#[cfg(test)]
mod tests {
    use super::*;

    fn screen() -> Screen {
        Screen { width: 64, height: 64, orthographic: false, near: 0.5, far: f32::INFINITY, far_key: 0 }
    }

    #[test]
    fn a_triangle_in_front_stays_whole() {
        let corners = [[0.0, 0.0, 1.0], [64.0, 0.0, 1.0], [0.0, 64.0, 1.0]];
        let polygon = clip(corners, &screen());
        assert_eq!(polygon.vertices(), corners.map(|p| p.map(f64::from)));
        assert!(clip(corners.map(|[x, y, _]| [x, y, 0.4]), &screen()).vertices().is_empty());
    }

    #[test]
    fn neighbours_agree_on_the_cut_of_a_shared_edge() {
        let mut seed = 3u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / 8_388_608.0 - 1.0
        };
        let mut cuts = 0;
        for _ in 0..5000 {
            let mut point = || [random() * 1.0e6, random() * 1.0e6, random() * 3.0];
            let (a, b, c, d) = (point(), point(), point(), point());
            let new = |corners: [[f32; 3]; 3]| -> Vec<[f64; 3]> {
                // Only the near plane: with more planes other edges meet there.
                let [a, b, c] = corners.map(|p| p.map(f64::from));
                let whole = Polygon { vertices: [a, b, c, a, a, a, a, a], count: 3 };
                let cut = whole.cut(|v| v[2] - 0.5);
                cut.vertices().iter().copied().filter(|v| ![a, b, c].contains(v)).collect()
            };
            let (left, right) = (new([a, b, c]), new([b, a, d]));
            if (a[2] >= 0.5) != (b[2] >= 0.5) {
                cuts += 1;
                assert!(left.iter().any(|v| right.contains(v)), "{left:?} {right:?}");
            }
            assert!(clip([a, b, c], &screen()).vertices().len() <= 8);
        }
        assert!(cuts > 500);
    }
}
