//! Stage 7. Visibility buffer → colour: barycentric coordinates by analysis, interpolated normals and vertex
//! colours, then pyrender's reflectance model.
//!
//! The model is glTF's metallic-roughness BRDF as pyrender 0.1.45 evaluates it: f0 = lerp(0.04, base, metal),
//! Schlick's Fresnel, Smith's G with k = (r + 1)²/8, GGX with α = r²; the sum over lights, plus base · ambient,
//! plus emission, times vertex colour, then the power 1/2.2. The background is not gamma-encoded. Emission is
//! applied once (pyrender squares the factor), and back faces keep their normal.

use rayon::prelude::*;

use super::lanes::{Lanes, Vec3x8, dot, minus, normalize, splat3};
use super::output::ROWS;
use super::surface::{Pixels, Surfels, Walk};
use crate::scene::{LightKind, Material, Scene, View};

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

    /// Light reflected to `v`, both unit, for light of intensity 1: pyrender's `compute_brdf`.
    #[inline(always)]
    fn reflect(&self, n: &Vec3x8, v: &Vec3x8, l: &Vec3x8) -> Vec3x8 {
        use std::f32::consts::PI;
        let h = normalize(&[l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        let nl = dot(n, l).max(0.001).min(1.0);
        let nv = dot(n, v).abs().max(0.001).min(1.0);
        let nh = dot(n, &h).max(0.0).min(1.0);
        let m = -(dot(v, &h).max(0.0).min(1.0) - 1.0);
        let schlick = m * m * m * m * m;
        // The two quotients of G, D and the denominator of the specular term as one.
        let smith = (nv * (1.0 - self.k) + self.k) * (nl * (1.0 - self.k) + self.k);
        let d = nh * nh * (self.alpha2 - 1.0) + 1.0;
        let gloss = nv * nl * self.alpha2 / (smith * (d * d * PI) * (nl * nv * 4.0 + 0.001));
        let mut out = [nl; 3];
        for c in 0..3 {
            let f = schlick * (1.0 - self.f0[c]) + self.f0[c];
            out[c] = nl * (-(f - 1.0) * (self.diffuse[c] * (1.0 / PI)) + f * gloss);
        }
        out
    }

    #[inline(always)]
    fn shade(&self, surfels: &Surfels<'_>, rays: &Rays, lighting: &Lighting) -> Vec3x8 {
        let position = rays.position(&surfels.point, surfels.distance);
        let v = normalize(&[-position[0], -position[1], -position[2]]);
        let mut color = [Lanes::splat(0.0); 3];
        for c in 0..3 {
            color[c] = Lanes::splat(self.base[c] * lighting.ambient[c] + self.emissive[c]);
        }
        for light in &lighting.lights {
            let (l, falloff) = match light.point {
                None => (splat3(light.vector), Lanes::splat(1.0)),
                Some(inverse_range) => {
                    let to = minus(&splat3(light.vector), &position);
                    let square = dot(&to, &to);
                    let q = square * (inverse_range * inverse_range);
                    (normalize(&to), (-(q * q - 1.0)).max(0.0) / square)
                }
            };
            let out = self.reflect(&surfels.normal, &v, &l);
            for c in 0..3 {
                color[c] = color[c] + out[c] * falloff * light.radiance[c];
            }
        }
        match &surfels.color {
            Some(tint) => [color[0] * tint[0], color[1] * tint[1], color[2] * tint[2]],
            None => color,
        }
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
        let level = self.first[entry as usize];
        // An entry spans 1/128 of its value, less than a step of the result: there is one to take at most.
        level + u8::from(self.steps[usize::from(level) + 1] <= c)
    }
}

/// What shading a row needs.
struct Shader<'a> {
    pixels: Pixels<'a>,
    surfaces: Vec<Surface>,
    lighting: &'a Lighting,
    rays: Rays,
    gamma: &'static Gamma,
}

impl Shader<'_> {
    #[inline(always)]
    fn run(&self, range: std::ops::Range<usize>, out: &mut [u8]) -> u64 {
        let start = range.start;
        let background = self.lighting.background;
        if background[0] == background[1] && background[1] == background[2] {
            out.fill(background[0]);
        } else {
            out.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&background));
        }
        let Some(mut walk) = Walk::new(self.pixels, range) else { return 0 };
        while let Some(surfels) = walk.step() {
            let surface = &self.surfaces[surfels.instance as usize];
            let color = surface.shade(&surfels, &self.rays, self.lighting);
            for lane in 0..surfels.count {
                let at = 3 * (surfels.pixels[lane] as usize - start);
                let pixel = &mut out[at..at + 3];
                for c in 0..3 {
                    pixel[c] = self.gamma.encode(color[c].0[lane]);
                }
            }
        }
        walk.covered
    }

    /// The same with 256-bit vectors. No operation fuses, so the result is the same bit for bit.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn run_avx2(&self, range: std::ops::Range<usize>, out: &mut [u8]) -> u64 {
        self.run(range, out)
    }
}

/// Shades every covered pixel into RGB bytes, row by row. Returns the number of covered pixels.
pub fn run(pixels: Pixels<'_>, view: &View, lighting: &Lighting, out: &mut [u8]) -> u64 {
    let width = pixels.screen.width as usize;
    let surfaces = pixels.views.iter().map(|v| Surface::new(&v.material)).collect();
    let shader = Shader { pixels, surfaces, lighting, rays: Rays::new(view), gamma: Gamma::get() };
    out.par_chunks_mut(3 * width * ROWS)
        .enumerate()
        .map(|(chunk, out)| {
            let start = chunk * ROWS * width;
            let range = start..start + out.len() / 3;
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { shader.run_avx2(range, out) };
            }
            shader.run(range, out)
        })
        .sum()
}

/// From pixels and distances to camera space.
struct Rays {
    center: [f32; 2],
    inverse_focal: [f32; 2],
    orthographic: bool,
}

impl Rays {
    fn new(view: &View) -> Self {
        Self {
            center: view.center.map(|c| c as f32),
            inverse_focal: view.focal.map(|f| (1.0 / f) as f32),
            orthographic: view.orthographic,
        }
    }

    #[inline(always)]
    fn position(&self, point: &[Lanes; 2], distance: Lanes) -> Vec3x8 {
        let scale = if self.orthographic { Lanes::splat(1.0) } else { distance };
        let x = (point[0] - self.center[0]) * self.inverse_focal[0] * scale;
        let y = -(point[1] - self.center[1]) * self.inverse_focal[1] * scale;
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
        let normalize = |v: [f32; 3]| super::normalize(&v.map(Lanes::splat)).map(|c| c.0[0]);
        let (n, v, l) = ([0.0, 0.0, 1.0], normalize([0.3, 0.1, 1.0]), normalize([-0.5, 0.4, 0.8]));
        let splat = |v: [f32; 3]| v.map(Lanes::splat);
        let got = Surface::new(&material).reflect(&splat(n), &splat(v), &splat(l)).map(|c| 2.0 * c.0[0]);
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
