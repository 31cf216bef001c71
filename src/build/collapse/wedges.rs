//! Attributes after a collapse: each new value is interpolated on the old faces at their point nearest to the new
//! place. Normals, which are smooth, are the mean of the old faces' values, each extrapolated to the new place: the
//! values that the cost assumes (Hoppe 1999). On scans that leaves a quarter less deviation.

use glam::DVec3;

use super::forms::Forms;
use super::surface::Surface;

/// Barycentric coordinates of the point of a triangle nearest to `p`. Of a triangle without area it is a point of
/// one of its sides or corners.
///
/// Regions after Ericson, "Real-Time Collision Detection" (2005), §5.1.5.
pub fn nearest(p: DVec3, [a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let (ap, bp, cp) = (p - a, p - b, p - c);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

/// The squared distance of a place from a triangle.
pub fn squared_distance(p: DVec3, corners: [DVec3; 3]) -> f64 {
    let at = nearest(p, corners);
    (corners[0] * at[0] + corners[1] * at[1] + corners[2] * at[2]).distance_squared(p)
}

/// The wedges of a collapse: found before it, written after it.
#[derive(Debug, Default)]
pub struct Merge {
    /// Wedges joined by the edge's faces, one at each end.
    pairs: Vec<(u32, u32)>,
    /// Each wedge at either end, and the one it becomes.
    renamed: Vec<(u32, u32)>,
    /// Wedges with new rows, in the order of `rows`.
    changed: Vec<u32>,
    rows: Vec<f32>,
}

impl Merge {
    /// Finds what the wedges of an edge become when it collapses onto `keep` at `position`; `rows` has `stride`
    /// floats for each wedge, of which the first three are a normal. Wedges of a locked point stay as they are.
    pub fn find(
        &mut self,
        surface: &Surface,
        forms: &Forms,
        rows: &[f32],
        stride: usize,
        edge: u32,
        keep: u32,
        position: DVec3,
    ) -> bool {
        if !Forms::pair_wedges(surface, edge, &mut self.pairs) {
            return false;
        }
        let ends = surface.edges[edge as usize].ends;
        let fixed = surface.locked[keep as usize];
        self.renamed.clear();
        self.changed.clear();
        self.rows.clear();
        for end in ends {
            for (f, k) in surface.around(end) {
                let wedge = surface.faces[f].wedges[k];
                if self.renamed.iter().any(|(w, _)| *w == wedge) {
                    continue;
                }
                let pair = self.pairs.iter().find(|(v, w)| *v == wedge || *w == wedge);
                let (v, w) = *pair.unwrap_or(&(wedge, wedge));
                let name = match (fixed, keep == ends[0]) {
                    (true, true) => v,
                    (true, false) => w,
                    (false, _) => v.min(w),
                };
                self.renamed.push((v, name));
                if w != v {
                    self.renamed.push((w, name));
                }
                if !(fixed && (end == keep || pair.is_some())) {
                    self.changed.push(name);
                    self.interpolate(surface, forms, rows, stride, edge, [v, w], position);
                }
            }
        }
        true
    }

    /// Adds the row of two wedges that become one: read off the nearest point of their faces, but for the normal.
    fn interpolate(
        &mut self,
        surface: &Surface,
        forms: &Forms,
        rows: &[f32],
        stride: usize,
        edge: u32,
        wedges: [u32; 2],
        position: DVec3,
    ) {
        let normal = forms
            .best_normal(surface, edge, wedges, position)
            .or_else(|| forms.mean_normal(surface, rows, edge, wedges, position));
        if let Some(normal) = normal.filter(|_| stride == 3) {
            self.rows.extend(normal.as_vec3().to_array());
            return;
        }
        let ends = surface.edges[edge as usize].ends;
        let mut best = f64::INFINITY;
        let mut found = ([wedges[0]; 3], [1.0, 0.0, 0.0]);
        for (f, k) in ends.into_iter().flat_map(|p| surface.around(p)) {
            let face = &surface.faces[f];
            if !wedges.contains(&face.wedges[k]) {
                continue;
            }
            // No point of a face is nearer than its plane.
            let height = forms.plane(f).0.dot(position.extend(1.0));
            if height * height >= best {
                continue;
            }
            let corners = face.points.map(|p| surface.positions[p as usize]);
            let at = nearest(position, corners);
            let d = (corners[0] * at[0] + corners[1] * at[1] + corners[2] * at[2]).distance_squared(position);
            if d < best {
                best = d;
                found = (face.wedges, at);
            }
        }
        let (corners, at) = found;
        let [a, b, c] = corners.map(|w| &rows[w as usize * stride..][..stride]);
        let start = self.rows.len();
        self.rows.extend(
            (0..stride).map(|j| {
                (at[0] * f64::from(a[j]) + at[1] * f64::from(b[j]) + at[2] * f64::from(c[j])) as f32
            }),
        );
        if let Some(row) = self.rows[start..].first_chunk_mut::<3>() {
            if let Some(normal) = normal {
                *row = normal.as_vec3().to_array();
            }
            let size = row.iter().map(|x| x * x).sum::<f32>().sqrt();
            if size > 0.0 && (size - 1.0).abs() > 1.0e-6 {
                row.iter_mut().for_each(|x| *x /= size);
            }
        }
    }

    /// Renames the wedges at a point and writes the new rows.
    pub fn apply(&self, surface: &mut Surface, rows: &mut [f32], stride: usize, point: u32) {
        for (wedge, row) in self.changed.iter().zip(self.rows.chunks_exact(stride.max(1))) {
            rows[*wedge as usize * stride..][..stride].copy_from_slice(row);
        }
        surface.rename_wedges(point, &self.renamed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_points_of_a_triangle() {
        let t = [DVec3::ZERO, DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.0, 2.0, 0.0)];
        for (p, expected) in [
            ([0.5, 0.5, 3.0], [0.5, 0.25, 0.25]),
            ([-1.0, -1.0, 0.0], [1.0, 0.0, 0.0]),
            ([3.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
            ([0.0, 4.0, 1.0], [0.0, 0.0, 1.0]),
            ([1.0, -2.0, 0.0], [0.5, 0.5, 0.0]),
            ([2.0, 2.0, 0.0], [0.0, 0.5, 0.5]),
            ([-3.0, 1.0, 0.0], [0.5, 0.0, 0.5]),
        ] {
            assert_eq!(nearest(DVec3::from_array(p), t), expected, "{p:?}");
        }
        assert_eq!(nearest(DVec3::Z, [DVec3::X; 3]), [1.0, 0.0, 0.0]);
    }
}
