//! Stage 7. Visibility buffer → colour: barycentric coordinates by analysis, interpolated normals and vertex
//! colours, then pyrender's reflectance model.
//!
//! The model is glTF's metallic-roughness BRDF as pyrender 0.1.45 evaluates it: f0 = lerp(0.04, base, metal),
//! Schlick's Fresnel, Smith's G with k = (r + 1)²/8, GGX with α = r²; the sum over lights, plus base · ambient,
//! plus emission, times vertex colour, then the power 1/2.2. The background is not gamma-encoded. Emission is
//! applied once (pyrender squares the factor), and back faces keep their normal.

use rayon::prelude::*;

use super::project::{InstanceView, Screen};
use super::triangle::barycentric;
use super::visibility::{Hit, Visible, decode};
use crate::limits::TRIANGLE_BITS;
use crate::math::octahedral;
use crate::scene::{LightKind, Material, Scene, View};

/// Rows per task.
const ROWS: usize = 8;

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

/// What a surface point looks like before lighting.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Unit normal, camera space.
    pub normal: [f32; 3],
    /// Vertex colour, linear RGB; white without vertex colours.
    pub color: [f32; 3],
}

/// Reads samples from pixels; keeps the last triangle, for its neighbours mostly show the same.
pub struct Sampler<'a> {
    pixels: Pixels<'a>,
    last: u32,
    corners: [[f32; 3]; 3],
    normals: [[f32; 3]; 3],
    colors: Option<[[f32; 3]; 3]>,
    view: Option<&'a InstanceView>,
    finished: bool,
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalize(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 { v.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

fn apply(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

fn blend(l: [f32; 3], v: &[[f32; 3]; 3]) -> [f32; 3] {
    std::array::from_fn(|k| l[0] * v[0][k] + l[1] * v[1][k] + l[2] * v[2][k])
}

impl<'a> Sampler<'a> {
    /// A sampler of a frame.
    pub fn new(pixels: Pixels<'a>) -> Self {
        Self {
            pixels,
            last: 0,
            corners: [[0.0; 3]; 3],
            normals: [[0.0; 3]; 3],
            colors: None,
            view: None,
            finished: false,
        }
    }

    fn load(&mut self, hit: Hit) -> &'a InstanceView {
        let name = (hit.visible + 1) << TRIANGLE_BITS | hit.triangle;
        if let Some(view) = self.view
            && self.last == name
        {
            return view;
        }
        let at = self.pixels.visible[hit.visible as usize];
        let view = &self.pixels.views[at.instance as usize];
        let geometry = view.mesh.geometry(at.cluster);
        let corners = geometry.triangles[hit.triangle as usize].map(usize::from);
        let positions = corners.map(|c| geometry.positions[c]);
        self.corners = positions.map(|p| view.homogeneous(p));
        self.finished = !view.material.smooth || !view.conformal;
        if view.material.smooth {
            self.normals = corners.map(|c| octahedral::decode(geometry.normals[c]));
            if !view.conformal {
                self.normals = self.normals.map(|n| normalize(apply(&view.normal, n)));
            }
        } else {
            let edge = |i: usize| -> [f32; 3] { std::array::from_fn(|k| positions[i][k] - positions[0][k]) };
            let (a, b) = (edge(1), edge(2));
            let n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
            self.normals = [normalize(apply(&view.normal, normalize(n))); 3];
        }
        self.colors = (!geometry.colors.is_empty()).then(|| {
            corners.map(|c| std::array::from_fn(|k| f32::from(geometry.colors[c][k]) * (1.0 / 255.0)))
        });
        (self.last, self.view) = (name, Some(view));
        view
    }

    /// The surface that a hit shows at a point of the screen.
    #[inline]
    pub fn sample(&mut self, hit: Hit, point: [f32; 2]) -> (Sample, &'a InstanceView) {
        let view = self.load(hit);
        let l = barycentric(&self.corners, self.pixels.screen.orthographic, point);
        let mut normal = blend(l, &self.normals);
        if !self.finished {
            normal = apply(&view.normal, normal);
        }
        let color = self.colors.map_or([1.0; 3], |c| blend(l, &c));
        (Sample { normal: normalize(normal), color }, view)
    }
}

/// A light in camera space.
#[derive(Clone, Copy, Debug)]
struct ShadeLight {
    /// Towards the light, unit (directional), or its position.
    vector: [f32; 3],
    radiance: [f32; 3],
    /// `None` for directional; 1/range for a point light, 0 without range.
    point: Option<f32>,
}

/// Lights and background of a scene as seen from a view.
#[derive(Clone, Debug)]
pub struct Lighting {
    lights: Vec<ShadeLight>,
    ambient: [f32; 3],
    background: [u8; 3],
}

impl Lighting {
    /// Moves a scene's lights to camera space.
    pub fn new(scene: &Scene, view: &View) -> Self {
        let rotate = view.pose.matrix3.inverse();
        let lights = scene.lights().iter().map(|(_, light)| {
            let (vector, point) = match light.kind {
                LightKind::Directional => ((rotate * light.pose.matrix3.z_axis).normalize_or_zero(), None),
                LightKind::Point { range } => {
                    (rotate * (light.pose.translation - view.eye()), Some(range.map_or(0.0, |r| 1.0 / r)))
                }
            };
            let radiance = light.color.map(|c| c * light.intensity);
            ShadeLight { vector: vector.as_vec3().to_array(), radiance, point }
        });
        let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Self {
            lights: lights.collect(),
            ambient: scene.ambient_light(),
            background: scene.bg_color().map(byte),
        }
    }

    /// The background as it is written.
    pub fn background(&self) -> [u8; 3] {
        self.background
    }
}

/// A material with what does not depend on the pixel worked out.
struct Surface {
    base: [f32; 3],
    diffuse: [f32; 3],
    f0: [f32; 3],
    alpha2: f32,
    k: f32,
    emissive: [f32; 3],
}

impl Surface {
    fn new(material: &Material) -> Self {
        let roughness = material.roughness.clamp(0.04, 1.0);
        let metallic = material.metallic.clamp(0.0, 1.0);
        let base = material.base_color;
        Self {
            base,
            diffuse: base.map(|c| c * 0.96 * (1.0 - metallic)),
            f0: base.map(|c| 0.04 * (1.0 - metallic) + c * metallic),
            alpha2: roughness.powi(4),
            k: (roughness + 1.0) * (roughness + 1.0) / 8.0,
            emissive: material.emissive,
        }
    }

    /// Light reflected to `v`, both unit: pyrender's `compute_brdf`.
    #[inline]
    fn reflect(&self, n: [f32; 3], v: [f32; 3], l: [f32; 3], radiance: [f32; 3]) -> [f32; 3] {
        use std::f32::consts::PI;
        let h = normalize([l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        let nl = dot(n, l).clamp(0.001, 1.0);
        let nv = dot(n, v).abs().clamp(0.001, 1.0);
        let nh = dot(n, h).clamp(0.0, 1.0);
        let vh = dot(v, h).clamp(0.0, 1.0);
        let m = 1.0 - vh;
        let schlick = m * m * m * m * m;
        let g = nv / (nv * (1.0 - self.k) + self.k) * (nl / (nl * (1.0 - self.k) + self.k));
        let denominator = nh * nh * (self.alpha2 - 1.0) + 1.0;
        let d = self.alpha2 / (PI * denominator * denominator);
        let gloss = g * d / (4.0 * nl * nv + 0.001);
        std::array::from_fn(|c| {
            let f = self.f0[c] + (1.0 - self.f0[c]) * schlick;
            nl * radiance[c] * ((1.0 - f) * self.diffuse[c] * (1.0 / PI) + f * gloss)
        })
    }

    fn shade(&self, sample: &Sample, position: [f32; 3], lighting: &Lighting) -> [f32; 3] {
        let v = normalize(position.map(|c| -c));
        let mut color: [f32; 3] =
            std::array::from_fn(|c| self.base[c] * lighting.ambient[c] + self.emissive[c]);
        for light in &lighting.lights {
            let (l, radiance) = match light.point {
                None => (light.vector, light.radiance),
                Some(inverse_range) => {
                    let to: [f32; 3] = std::array::from_fn(|k| light.vector[k] - position[k]);
                    let square = dot(to, to);
                    let q = square * inverse_range * inverse_range;
                    let window = (1.0 - q * q).clamp(0.0, 1.0);
                    (normalize(to), light.radiance.map(|r| r * window / square))
                }
            };
            let out = self.reflect(sample.normal, v, l, radiance);
            color = std::array::from_fn(|c| color[c] + out[c]);
        }
        std::array::from_fn(|c| color[c] * sample.color[c])
    }
}

/// round(255 · c^(1/2.2)), exactly: a table of the 255 values of c where the result steps, entered by the
/// leading bits of c.
struct Gamma {
    steps: [f32; 257],
    first: Vec<u8>,
}

impl Gamma {
    /// Below this everything rounds to 0 or 1.
    const LOW: u32 = 0x3680_0000; // 2⁻¹⁸
    const SHIFT: u32 = 16;
    const ONE: u32 = 0x3f80_0000;

    fn get() -> &'static Self {
        static TABLE: std::sync::OnceLock<Gamma> = std::sync::OnceLock::new();
        TABLE.get_or_init(|| {
            let mut steps = [f32::INFINITY; 257];
            for (k, step) in steps.iter_mut().enumerate().take(256) {
                *step = ((k as f64 - 0.5).max(0.0) / 255.0).powf(2.2) as f32;
            }
            let first = (0..=(Self::ONE - Self::LOW) >> Self::SHIFT).map(|i| {
                let c = if i == 0 { 0.0 } else { f32::from_bits(Self::LOW + (i << Self::SHIFT)) };
                (steps[1..256].partition_point(|s| *s <= c)) as u8
            });
            let first = first.collect();
            Self { steps, first }
        })
    }

    #[inline]
    fn encode(&self, c: f32) -> u8 {
        // NaN (a light at the surface) becomes 0.
        let c = if c > 0.0 { c.min(1.0) } else { 0.0 };
        let entry = c.to_bits().saturating_sub(Self::LOW) >> Self::SHIFT;
        let mut level = usize::from(self.first[entry as usize]);
        while self.steps[level + 1] <= c {
            level += 1;
        }
        level as u8
    }
}

/// Shades every covered pixel into RGB bytes, row by row. Returns the number of covered pixels.
pub fn run(pixels: Pixels<'_>, view: &View, lighting: &Lighting, out: &mut [u8]) -> u64 {
    let width = pixels.screen.width as usize;
    let surfaces: Vec<Surface> = pixels.views.iter().map(|v| Surface::new(&v.material)).collect();
    let gamma = Gamma::get();
    let rays = Rays::new(view);
    out.par_chunks_mut(3 * width * ROWS)
        .zip(pixels.words.par_chunks(width * ROWS))
        .enumerate()
        .map(|(chunk, (out, words))| {
            let mut sampler = Sampler::new(pixels);
            let mut covered = 0;
            for (i, (out, &word)) in out.chunks_exact_mut(3).zip(words).enumerate() {
                let Some(hit) = decode(word) else {
                    out.copy_from_slice(&lighting.background);
                    continue;
                };
                covered += 1;
                let point = [(i % width) as f32 + 0.5, (chunk * ROWS + i / width) as f32 + 0.5];
                let (sample, _) = sampler.sample(hit, point);
                let position = rays.position(point, pixels.screen.distance(hit.key));
                let surface = &surfaces[pixels.visible[hit.visible as usize].instance as usize];
                let color = surface.shade(&sample, position, lighting);
                out.copy_from_slice(&color.map(|c| gamma.encode(c)));
            }
            covered
        })
        .sum()
}

/// From pixels and distances to camera space.
pub struct Rays {
    center: [f32; 2],
    inverse_focal: [f32; 2],
    orthographic: bool,
}

impl Rays {
    /// The rays of a view.
    pub fn new(view: &View) -> Self {
        Self {
            center: view.center.map(|c| c as f32),
            inverse_focal: view.focal.map(|f| (1.0 / f) as f32),
            orthographic: view.orthographic,
        }
    }

    /// The point of camera space at a point of the screen and a distance.
    #[inline]
    pub fn position(&self, point: [f32; 2], distance: f32) -> [f32; 3] {
        let scale = if self.orthographic { 1.0 } else { distance };
        let x = (point[0] - self.center[0]) * self.inverse_focal[0] * scale;
        let y = (self.center[1] - point[1]) * self.inverse_focal[1] * scale;
        [x, y, -distance]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gamma_table_equals_the_power() {
        let gamma = Gamma::get();
        let mut c = 0.0f32;
        while c < 1.2 {
            let exact = f64::from(c.min(1.0)).powf(1.0 / 2.2) * 255.0;
            let got = f64::from(gamma.encode(c));
            assert!((got - exact).abs() <= 0.5 + 1e-4, "{c}: {got} for {exact}");
            c = if c < 1e-6 { c + 1e-8 } else { c * 1.000_37 };
        }
        for (c, byte) in [(f32::NAN, 0), (-1.0, 0), (f32::INFINITY, 255), (1.0, 255), (0.0, 0)] {
            assert_eq!(gamma.encode(c), byte);
        }
    }

    #[test]
    fn reflectance_matches_the_formula_written_out() {
        // One direction, worked out by hand in f64 from pyrender's shader.
        let material =
            Material { base_color: [0.7, 0.65, 0.6], metallic: 0.3, roughness: 0.5, ..Material::default() };
        let (n, v, l) = ([0.0, 0.0, 1.0], normalize([0.3, 0.1, 1.0]), normalize([-0.5, 0.4, 0.8]));
        let got = Surface::new(&material).reflect(n, v, l, [2.0; 3]);
        let d64 = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| f64::from(a[k]) * f64::from(b[k])).sum::<f64>();
        let h = normalize([l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        let (nl, nv, nh, vh) = (d64(n, l), d64(n, v), d64(n, h), d64(v, h));
        for c in 0..3 {
            let (base, metal, r) = (f64::from(material.base_color[c]), 0.3, 0.5f64);
            let f0 = 0.04 * (1.0 - metal) + base * metal;
            let f = f0 + (1.0 - f0) * (1.0 - vh).powi(5);
            let k = (r + 1.0).powi(2) / 8.0;
            let g = nv / (nv * (1.0 - k) + k) * nl / (nl * (1.0 - k) + k);
            let a2 = r.powi(4);
            let d = a2 / (std::f64::consts::PI * (nh * nh * (a2 - 1.0) + 1.0).powi(2));
            let diffuse = (1.0 - f) * base * 0.96 * (1.0 - metal) / std::f64::consts::PI;
            let expected = nl * 2.0 * (diffuse + f * g * d / (4.0 * nl * nv + 0.001));
            assert!((f64::from(got[c]) - expected).abs() < 1e-5, "{c}: {} for {expected}", got[c]);
        }
    }
}
