//! From the visibility buffer to surface points: barycentric coordinates by analysis, interpolated normals and
//! vertex colours, eight pixels of one instance at a time.

use super::lanes::{LANES, Lanes, Vec3x8, apply, cross, normalize};
use super::project::{InstanceView, Screen};
use super::visibility::{Hit, Visible, decode};
use crate::model::{ClusterAddress, ClusterGeometry};

/// A finished visibility buffer with all that is needed to read it.
#[derive(Clone, Copy)]
pub struct Pixels<'a> {
    /// Words, row by row from the top.
    pub words: &'a [u64],
    /// The frame's visible list.
    pub visible: &'a [Visible],
    /// The frame's instances.
    pub views: &'a [InstanceView],
    /// The view.
    pub screen: &'a Screen,
}

/// What eight covered pixels need from memory.
struct Gathered<'a> {
    count: usize,
    /// Index in `views`.
    instance: u32,
    view: &'a InstanceView,
    /// Numbers of the pixels.
    pixels: [u32; LANES],
    hits: [Hit; LANES],
    clusters: [ClusterAddress; LANES],
    positions: [[Lanes; 3]; 3],
    normals: [[u32; LANES]; 3],
    colors: [[u32; LANES]; 3],
}

/// Up to eight surface points of one instance.
pub struct Surfels<'a> {
    /// How many lanes count.
    pub count: usize,
    /// Index of the instance in the frame's list.
    pub instance: u32,
    /// The instance.
    pub view: &'a InstanceView,
    /// Numbers of the pixels, row by row from the top.
    pub pixels: [u32; LANES],
    /// What each pixel shows.
    pub hits: [Hit; LANES],
    /// The cluster of each.
    pub clusters: [ClusterAddress; LANES],
    /// Pixel centres.
    pub point: [Lanes; 2],
    /// Distances along the view axis.
    pub distance: Lanes,
    /// Unit normals, camera space.
    pub normal: Vec3x8,
    /// Vertex colours, linear RGB, of meshes that have them.
    pub color: Option<Vec3x8>,
}

/// Calls `each` for all covered pixels of `range`, in order. Returns how many those are.
#[inline(always)]
pub fn for_each(
    pixels: Pixels<'_>,
    range: std::ops::Range<usize>,
    mut each: impl FnMut(&Surfels<'_>),
) -> u64 {
    let width = pixels.screen.width;
    let Some(first) = pixels.views.first() else { return 0 };
    let zero = Lanes::splat(0.0);
    let nothing = Hit { key: 1, visible: 0, triangle: 0 };
    let mut gathered = Gathered {
        count: 0,
        instance: 0,
        view: first,
        pixels: [0; LANES],
        hits: [nothing; LANES],
        clusters: [ClusterAddress(0); LANES],
        positions: [[zero; 3]; 3],
        normals: [[0; LANES]; 3],
        colors: [[0; LANES]; 3],
    };
    let mut covered = 0;
    let mut cluster: Option<(u32, Visible, ClusterGeometry<'_>)> = None;
    for (pixel, &word) in range.clone().zip(&pixels.words[range]) {
        let Some(hit) = decode(word) else { continue };
        covered += 1;
        let (at, geometry) = match cluster {
            Some((visible, at, geometry)) if visible == hit.visible => (at, geometry),
            _ => {
                let at = pixels.visible[hit.visible as usize];
                let geometry = pixels.views[at.instance as usize].mesh.geometry(at.cluster);
                cluster = Some((hit.visible, at, geometry));
                (at, geometry)
            }
        };
        if gathered.count > 0 && gathered.instance != at.instance {
            each(&gathered.evaluate(pixels.screen, width));
            gathered.count = 0;
        }
        gathered.instance = at.instance;
        gathered.view = &pixels.views[at.instance as usize];
        gathered.push(pixel as u32, hit, at.cluster, &geometry);
        if gathered.count == LANES {
            each(&gathered.evaluate(pixels.screen, width));
            gathered.count = 0;
        }
    }
    if gathered.count > 0 {
        each(&gathered.evaluate(pixels.screen, width));
    }
    covered
}

impl<'a> Gathered<'a> {
    #[inline(always)]
    fn push(&mut self, pixel: u32, hit: Hit, cluster: ClusterAddress, geometry: &ClusterGeometry<'_>) {
        let lane = self.count;
        self.count += 1;
        (self.pixels[lane], self.hits[lane], self.clusters[lane]) = (pixel, hit, cluster);
        let corners = geometry.triangles[hit.triangle as usize];
        for (i, corner) in corners.into_iter().enumerate() {
            let corner = usize::from(corner);
            let p = geometry.positions[corner];
            for k in 0..3 {
                self.positions[i][k].0[lane] = p[k];
            }
            self.normals[i][lane] = geometry.normals[corner];
            if !geometry.colors.is_empty() {
                self.colors[i][lane] = u32::from_le_bytes(geometry.colors[corner]);
            }
        }
    }

    #[inline(always)]
    fn evaluate(&self, screen: &Screen, width: u32) -> Surfels<'a> {
        let view = self.view;
        let mut point = [Lanes::splat(0.5); 2];
        let mut distance = Lanes::splat(1.0);
        for lane in 0..LANES {
            let pixel = self.pixels[lane];
            point[0].0[lane] += (pixel % width) as f32;
            point[1].0[lane] += (pixel / width) as f32;
            distance.0[lane] = screen.distance(self.hits[lane].key);
        }
        let weights = barycentric(view, screen.orthographic, &self.positions, &point);
        let blend = |v: &[Vec3x8; 3]| -> Vec3x8 {
            let mix = |k: usize| weights[0] * v[0][k] + weights[1] * v[1][k] + weights[2] * v[2][k];
            [mix(0), mix(1), mix(2)]
        };
        let normal = if view.material.smooth {
            let corners = [
                decode_normal(&self.normals[0]),
                decode_normal(&self.normals[1]),
                decode_normal(&self.normals[2]),
            ];
            if view.conformal {
                apply(&view.normal, &blend(&corners))
            } else {
                let finish = |n: &Vec3x8| normalize(&apply(&view.normal, n));
                blend(&[finish(&corners[0]), finish(&corners[1]), finish(&corners[2])])
            }
        } else {
            let p = &self.positions;
            let edge = |i: usize| [p[i][0] - p[0][0], p[i][1] - p[0][1], p[i][2] - p[0][2]];
            apply(&view.normal, &normalize(&cross(&edge(1), &edge(2))))
        };
        let color = view.mesh.layout().colors.then(|| {
            blend(&[
                decode_color(&self.colors[0]),
                decode_color(&self.colors[1]),
                decode_color(&self.colors[2]),
            ])
        });
        Surfels {
            count: self.count,
            instance: self.instance,
            view,
            pixels: self.pixels,
            hits: self.hits,
            clusters: self.clusters,
            point,
            distance,
            normal: normalize(&normal),
            color,
        }
    }
}

/// Perspective-correct barycentric coordinates of points of the screen on triangles, also where these reach
/// behind the eye: the solution λ of Σ λᵢ (xᵢ, yᵢ) = p Σ λᵢ dᵢ in homogeneous screen coordinates.
///
/// Points just outside (by snapping) are moved to the nearest edge. After Olano and Greer, "Triangle scan
/// conversion using 2D homogeneous coordinates", Graphics Hardware 1997.
#[inline(always)]
fn barycentric(
    view: &InstanceView,
    orthographic: bool,
    positions: &[Vec3x8; 3],
    point: &[Lanes; 2],
) -> Vec3x8 {
    let row = |r: usize, p: &Vec3x8| {
        let m = &view.screen[r];
        p[0] * m[0] + p[1] * m[1] + p[2] * m[2] + m[3]
    };
    let along = |k: usize| -> Vec3x8 {
        let relative = |p: &Vec3x8| {
            if orthographic { row(k, p) - point[k] } else { row(k, p) - point[k] * row(2, p) }
        };
        [relative(&positions[0]), relative(&positions[1]), relative(&positions[2])]
    };
    let weights = cross(&along(0), &along(1));
    let inverse = Lanes::splat(1.0) / (weights[0] + weights[1] + weights[2]);
    // A degenerate triangle gives NaN here, which `max` turns into 0.
    let held = weights.map(|w| (w * inverse).max(0.0).min(1.0));
    let sum = held[0] + held[1] + held[2];
    let empty = sum - f32::MIN_POSITIVE;
    let inverse = Lanes::splat(1.0) / sum;
    held.map(|w| empty.where_negative(Lanes::splat(1.0 / 3.0), w * inverse))
}

/// [`crate::math::octahedral::decode`], eight at a time.
#[inline(always)]
fn decode_normal(packed: &[u32; LANES]) -> Vec3x8 {
    let (mut x, mut y) = (Lanes::splat(0.0), Lanes::splat(0.0));
    for lane in 0..LANES {
        x.0[lane] = ((packed[lane] << 16) as i32 >> 16) as f32;
        y.0[lane] = (packed[lane] as i32 >> 16) as f32;
    }
    let (x, y) = (x / 32767.0, y / 32767.0);
    let z = -(x.abs() + y.abs() - 1.0);
    let t = (-z).max(0.0);
    let fold = |v: Lanes| v.where_negative(v + t, v - t);
    let v = [fold(x), fold(y), z];
    let inverse = Lanes::splat(1.0) / super::lanes::dot(&v, &v).sqrt();
    [v[0] * inverse, v[1] * inverse, v[2] * inverse]
}

#[inline(always)]
fn decode_color(packed: &[u32; LANES]) -> Vec3x8 {
    let channel = |shift: u32| {
        let mut out = Lanes::splat(0.0);
        for lane in 0..LANES {
            out.0[lane] = (packed[lane] >> shift & 0xff) as i32 as f32;
        }
        out * (1.0 / 255.0)
    };
    [channel(0), channel(8), channel(16)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::octahedral;

    #[test]
    fn eight_normals_decode_as_one() {
        for i in 0..3000u32 {
            let word = i.wrapping_mul(2_654_435_761);
            // The encoder never makes −32768.
            if word as u16 == 0x8000 || word >> 16 == 0x8000 {
                continue;
            }
            let expected = octahedral::decode(word);
            let got = decode_normal(&[word; LANES]);
            for k in 0..3 {
                assert!((got[k].0[3] - expected[k]).abs() < 1e-6, "{word:x}");
            }
        }
    }
}
