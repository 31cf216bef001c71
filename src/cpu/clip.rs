//! Clipping of triangles against the near plane and the guard band.
//!
//! An edge that a plane cuts is intersected from its smaller to its larger end point (by coordinates), so the
//! two triangles of an edge compute the same new vertex, bit for bit, and nothing cracks. Sutherland and
//! Hodgman, "Reentrant polygon clipping", CACM 17(1), 1974.

use crate::limits::GUARD_BAND;
use crate::math::DoubleSingle;
use crate::views::Screen;

/// A convex polygon in homogeneous screen coordinates: a triangle cut by five planes at most.
#[derive(Clone, Copy, Debug)]
pub struct Polygon {
    vertices: [[f32; 3]; 8],
    count: usize,
}

impl Polygon {
    /// The corners, in the triangle's order.
    pub fn vertices(&self) -> &[[f32; 3]] {
        &self.vertices[..self.count]
    }

    fn push(&mut self, vertex: [f32; 3]) {
        // A convex polygon gains one vertex per plane: 3 + 5 fit.
        self.vertices[self.count] = vertex;
        self.count += 1;
    }

    fn cut(&self, inside: impl Fn(&[f32; 3]) -> DoubleSingle) -> Self {
        let mut out = Self { count: 0, ..*self };
        for i in 0..self.count {
            let (a, b) = (self.vertices[i], self.vertices[(i + 1) % self.count]);
            let (da, db) = (inside(&a), inside(&b));
            if da.high >= 0.0 {
                out.push(a);
            }
            if (da.high >= 0.0) != (db.high >= 0.0) {
                out.push(intersect(a, da, b, db));
            }
        }
        out
    }
}

fn intersect(a: [f32; 3], da: DoubleSingle, b: [f32; 3], db: DoubleSingle) -> [f32; 3] {
    let swap = a.iter().zip(&b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne()).is_some_and(|o| o.is_gt());
    let (a, da, b, db) = if swap { (b, db, a, da) } else { (a, da, b, db) };
    let length = db.minus(da);
    std::array::from_fn(|k| db.times(a[k]).minus(da.times(b[k])).over(length))
}

/// The part of a triangle (homogeneous screen coordinates) at or behind the near plane and inside the guard
/// band.
pub fn clip(corners: [[f32; 3]; 3], screen: &Screen) -> Polygon {
    let [a, b, c] = corners;
    let whole = Polygon { vertices: [a, b, c, c, c, c, c, c], count: 3 };
    let mut polygon = whole.cut(|v| DoubleSingle::sum(v[2], -screen.near));
    let guard =
        |v: &[f32; 3]| DoubleSingle::product(GUARD_BAND, if screen.orthographic { 1.0 } else { v[2] });
    for k in 0..2 {
        polygon = polygon.cut(|v| guard(v).plus(DoubleSingle { high: v[k], low: 0.0 }));
        polygon = polygon.cut(|v| guard(v).plus(DoubleSingle { high: -v[k], low: 0.0 }));
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
        assert_eq!(polygon.vertices(), corners);
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
            let new = |[a, b, c]: [[f32; 3]; 3]| -> Vec<[f32; 3]> {
                // Only the near plane: with more planes other edges meet there.
                let whole = Polygon { vertices: [a, b, c, a, a, a, a, a], count: 3 };
                let cut = whole.cut(|v| DoubleSingle::sum(v[2], -0.5));
                cut.vertices().iter().copied().filter(|v| ![a, b, c].contains(v)).collect()
            };
            let (left, right) = (new([a, b, c]), new([b, a, d]));
            if (a[2] >= 0.5) != (b[2] >= 0.5) {
                cuts += 1;
                assert!(left.iter().any(|v| right.contains(v)), "{left:?} {right:?}");
                // Where the exact cut is, rounded once.
                let t = (f64::from(a[2]) - 0.5) / (f64::from(a[2]) - f64::from(b[2]));
                let exact: [f64; 3] =
                    std::array::from_fn(|k| f64::from(a[k]) + t * (f64::from(b[k]) - f64::from(a[k])));
                let near = |v: &&[f32; 3]| {
                    (0..3).all(|k| (f64::from(v[k]) - exact[k]).abs() <= 1.0e-6 + 1.0e-7 * exact[k].abs())
                };
                assert!(left.iter().any(|v| near(&v)), "{left:?} {exact:?}");
            }
            assert!(clip([a, b, c], &screen()).vertices().len() <= 8);
        }
        assert!(cuts > 500);
    }
}
