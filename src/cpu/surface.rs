//! From the visibility buffer to surface points: barycentric coordinates by analysis, interpolated normals and
//! vertex colours, eight pixels of one instance at a time.

use super::lanes::{LANES, Lanes, Vec3x8, apply, blend, cross, minus, normalize};
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

/// Walks the covered pixels of a range in order, up to eight of one instance at a time.
pub struct Walk<'a> {
    pixels: Pixels<'a>,
    next: usize,
    end: usize,
    /// The cluster of the pixel before: its neighbours mostly show the same.
    last: u32,
    at: Visible,
    geometry: ClusterGeometry<'a>,
    gathered: Gathered<'a>,
}

impl<'a> Walk<'a> {
    /// Starts a walk; `None` where nothing can be covered.
    #[inline(always)]
    pub fn new(pixels: Pixels<'a>, range: std::ops::Range<usize>) -> Option<Self> {
        let at = *pixels.visible.first()?;
        let view = &pixels.views[at.instance as usize];
        let zero = Lanes::splat(0.0);
        let nothing = Hit { key: 1, visible: 0, triangle: 0 };
        let gathered = Gathered {
            count: 0,
            instance: at.instance,
            view,
            pixels: [0; LANES],
            hits: [nothing; LANES],
            clusters: [at.cluster; LANES],
            positions: [[zero; 3]; 3],
            normals: [[0; LANES]; 3],
            colors: [[0; LANES]; 3],
        };
        let geometry = view.pages.geometry(at.cluster);
        Some(Self { pixels, next: range.start, end: range.end, last: 0, at, geometry, gathered })
    }

    /// The next surface points.
    #[inline(always)]
    pub fn step(&mut self) -> Option<Surfels<'a>> {
        self.gathered.count = 0;
        while self.next < self.end {
            let words = self.pixels.words;
            let Some(hit) = decode(words[self.next]) else {
                self.next += 1;
                // Background comes in stretches.
                while self.next + 8 <= self.end && words[self.next..self.next + 8].iter().all(|w| *w == 0) {
                    self.next += 8;
                }
                continue;
            };
            if hit.visible != self.last {
                self.last = hit.visible;
                self.at = self.pixels.visible[hit.visible as usize];
                self.geometry = self.pixels.views[self.at.instance as usize].pages.geometry(self.at.cluster);
            }
            if self.gathered.instance != self.at.instance {
                if self.gathered.count > 0 {
                    break;
                }
                self.gathered.instance = self.at.instance;
                self.gathered.view = &self.pixels.views[self.at.instance as usize];
            }
            self.gathered.push(self.next as u32, hit, self.at.cluster, &self.geometry);
            self.next += 1;
            if self.gathered.count == LANES {
                break;
            }
        }
        if self.gathered.count == 0 {
            return None;
        }
        Some(self.gathered.evaluate(self.pixels.screen))
    }
}

impl<'a> Gathered<'a> {
    #[inline(always)]
    fn push(&mut self, pixel: u32, hit: Hit, cluster: ClusterAddress, geometry: &ClusterGeometry<'_>) {
        let lane = self.count;
        self.count += 1;
        (self.pixels[lane], self.hits[lane], self.clusters[lane]) = (pixel, hit, cluster);
        let corners = geometry.triangles.get(hit.triangle as usize);
        for (i, corner) in corners.into_iter().enumerate() {
            let corner = usize::from(corner);
            let p = geometry.positions.get(corner);
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
    fn evaluate(&self, screen: &Screen) -> Surfels<'a> {
        let (view, width) = (self.view, screen.width);
        let mut point = [Lanes::splat(0.5); 2];
        let mut distance = Lanes::splat(1.0);
        for lane in 0..LANES {
            let pixel = self.pixels[lane];
            point[0].0[lane] += (pixel % width) as f32;
            point[1].0[lane] += (pixel / width) as f32;
            distance.0[lane] = screen.distance(self.hits[lane].key);
        }
        let weights = barycentric(view, screen.orthographic, &self.positions, &point);
        let normal = if view.material.smooth {
            let [a, b, c] = &self.normals;
            let corners = [decode_normal(a), decode_normal(b), decode_normal(c)];
            if view.conformal {
                apply(&view.normal, &blend(&weights, &corners))
            } else {
                let [a, b, c] = &corners;
                let m = &view.normal;
                let turned = [normalize(&apply(m, a)), normalize(&apply(m, b)), normalize(&apply(m, c))];
                blend(&weights, &turned)
            }
        } else {
            let [a, b, c] = &self.positions;
            apply(&view.normal, &normalize(&cross(&minus(b, a), &minus(c, a))))
        };
        let color = if view.mesh.layout().colors {
            let [a, b, c] = &self.colors;
            Some(blend(&weights, &[decode_color(a), decode_color(b), decode_color(c)]))
        } else {
            None
        };
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
    let [a, b, c] = positions;
    let x = along(view, orthographic, 0, [a, b, c], point[0]);
    let y = along(view, orthographic, 1, [a, b, c], point[1]);
    let w = cross(&x, &y);
    let inverse = Lanes::splat(1.0) / (w[0] + w[1] + w[2]);
    // A degenerate triangle gives NaN here, which `max` turns into 0.
    let w0 = (w[0] * inverse).max(0.0).min(1.0);
    let w1 = (w[1] * inverse).max(0.0).min(1.0);
    let w2 = (w[2] * inverse).max(0.0).min(1.0);
    let sum = w0 + w1 + w2;
    let (empty, third) = (sum - f32::MIN_POSITIVE, Lanes::splat(1.0 / 3.0));
    let inverse = Lanes::splat(1.0) / sum;
    [
        empty.where_negative(third, w0 * inverse),
        empty.where_negative(third, w1 * inverse),
        empty.where_negative(third, w2 * inverse),
    ]
}

/// Homogeneous coordinate `k` of three corners, relative to a point of the screen.
#[inline(always)]
fn along(view: &InstanceView, orthographic: bool, k: usize, corners: [&Vec3x8; 3], point: Lanes) -> Vec3x8 {
    let mut out = [point; 3];
    for i in 0..3 {
        let at = row(&view.screen[k], corners[i]);
        out[i] = if orthographic { at - point } else { at - point * row(&view.screen[2], corners[i]) };
    }
    out
}

#[inline(always)]
fn row(m: &[f32; 4], p: &Vec3x8) -> Lanes {
    p[0] * m[0] + p[1] * m[1] + p[2] * m[2] + m[3]
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
    let v = [x.where_negative(x + t, x - t), y.where_negative(y + t, y - t), z];
    let inverse = Lanes::splat(1.0) / super::lanes::dot(&v, &v).sqrt();
    [v[0] * inverse, v[1] * inverse, v[2] * inverse]
}

#[inline(always)]
fn decode_color(packed: &[u32; LANES]) -> Vec3x8 {
    let mut out = [Lanes::splat(0.0); 3];
    for k in 0..3 {
        for lane in 0..LANES {
            out[k].0[lane] = (packed[lane] >> (8 * k) & 0xff) as i32 as f32;
        }
        out[k] = out[k] * (1.0 / 255.0);
    }
    out
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
