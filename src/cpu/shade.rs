//! Stage 7. Visibility buffer → colour: barycentric coordinates by analysis, interpolated normals and vertex
//! colours, then pyrender's reflectance model.
//!
//! The model is glTF's metallic-roughness BRDF as pyrender 0.1.45 evaluates it: f0 = lerp(0.04, base, metal),
//! Schlick's Fresnel, Smith's G with k = (r + 1)²/8, GGX with α = r²; the sum over lights, plus base · ambient,
//! plus emission, times vertex colour, then the power 1/2.2 or what else is asked for. The background is written as it
//! is. Emission is applied once (pyrender squares the factor), and back faces keep their normal.

use rayon::prelude::*;

use super::lanes::{Lanes, Vec3x8, dot, minus, normalize, splat3};
use super::output::ROWS;
use super::surface::{Pixels, Surfels, Walk};
use crate::config::Transfer;
use crate::scene::placement::Eye;
use crate::scene::{Falloff, Lighting, Reflectance};

/// Light reflected to `v`, both unit, for light of intensity 1: pyrender's `compute_brdf`.
#[inline(always)]
fn reflect(r: &Reflectance, n: &Vec3x8, v: &Vec3x8, l: &Vec3x8) -> Vec3x8 {
    use std::f32::consts::PI;
    let h = normalize(&[l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
    let nl = dot(n, l).max(0.001).min(1.0);
    let nv = dot(n, v).abs().max(0.001).min(1.0);
    let nh = dot(n, &h).max(0.0).min(1.0);
    let m = -(dot(v, &h).max(0.0).min(1.0) - 1.0);
    let schlick = m * m * m * m * m;
    // The two quotients of G, D and the denominator of the specular term as one.
    let smith = (nv * (1.0 - r.k) + r.k) * (nl * (1.0 - r.k) + r.k);
    let d = nh * nh * (r.alpha2 - 1.0) + 1.0;
    let gloss = nv * nl * r.alpha2 / (smith * (d * d * PI) * (nl * nv * 4.0 + 0.001));
    let mut out = [nl; 3];
    for c in 0..3 {
        let f = schlick * (1.0 - r.f0[c]) + r.f0[c];
        out[c] = nl * (-(f - 1.0) * (r.diffuse[c] * (1.0 / PI)) + f * gloss);
    }
    out
}

#[inline(always)]
fn shade(
    r: &Reflectance,
    surfels: &Surfels<'_>,
    eye: &Eye,
    orthographic: bool,
    lighting: &Lighting,
) -> Vec3x8 {
    let position = position(eye, orthographic, &surfels.point, surfels.distance);
    let v = normalize(&[-position[0], -position[1], -position[2]]);
    let mut color = [Lanes::splat(0.0); 3];
    for c in 0..3 {
        color[c] = Lanes::splat(r.base[c] * lighting.ambient[c] + r.emissive[c]);
    }
    for light in &lighting.lights {
        let (l, falloff) = match light.falloff {
            None => (splat3(light.vector), Lanes::splat(1.0)),
            Some(Falloff { inverse_range, direction, cone_scale, cone_offset }) => {
                let to = minus(&splat3(light.vector), &position);
                let square = dot(&to, &to);
                let q = square * (inverse_range * inverse_range);
                let l = normalize(&to);
                let along = (-dot(&splat3(direction), &l)).max(0.0).min(1.0);
                let cone = (along * cone_scale + cone_offset).max(0.0).min(1.0);
                (l, (-(q * q - 1.0)).max(0.0) / square * (cone * cone))
            }
        };
        let out = reflect(r, &surfels.normal, &v, &l);
        for c in 0..3 {
            color[c] = color[c] + out[c] * falloff * light.radiance[c];
        }
    }
    match &surfels.color {
        Some(tint) => [color[0] * tint[0], color[1] * tint[1], color[2] * tint[2]],
        None => color,
    }
}

/// What shading a row needs.
struct Shader<'a> {
    pixels: Pixels<'a>,
    materials: Vec<Reflectance>,
    lighting: &'a Lighting,
    eye: &'a Eye,
}

impl Shader<'_> {
    #[inline(always)]
    fn run<T: Copy + PartialEq>(
        &self,
        range: std::ops::Range<usize>,
        background: [T; 3],
        written: impl Fn(f32) -> T,
        out: &mut [T],
    ) {
        let start = range.start;
        if background[0] == background[1] && background[1] == background[2] {
            out.fill(background[0]);
        } else {
            out.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&background));
        }
        let Some(mut walk) = Walk::new(self.pixels, range) else { return };
        while let Some(surfels) = walk.step() {
            let material = &self.materials[surfels.instance as usize];
            let orthographic = self.pixels.screen.orthographic;
            let color = shade(material, &surfels, self.eye, orthographic, self.lighting);
            for lane in 0..surfels.count {
                let at = 3 * (surfels.pixels[lane] as usize - start);
                let pixel = &mut out[at..at + 3];
                for c in 0..3 {
                    pixel[c] = written(color[c].0[lane]);
                }
            }
        }
    }

    /// The same with 256-bit vectors. No operation fuses, so the result is the same bit for bit.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn run_avx2<T: Copy + PartialEq>(
        &self,
        range: std::ops::Range<usize>,
        background: [T; 3],
        written: impl Fn(f32) -> T,
        out: &mut [T],
    ) {
        self.run(range, background, written, out)
    }
}

/// Shades every covered pixel into RGB bytes, row by row.
pub fn color(pixels: Pixels<'_>, eye: &Eye, lighting: &Lighting) -> Vec<u8> {
    let encoder = lighting.transfer.encoder();
    run(pixels, eye, lighting, lighting.background, |c| encoder.encode(c))
}

/// The same before it is encoded: RGB in linear light.
pub fn linear(pixels: Pixels<'_>, eye: &Eye, lighting: &Lighting) -> Vec<f32> {
    // NaN and infinity (a light at the surface) become numbers, so that means are.
    run(pixels, eye, lighting, lighting.behind(), |c| if c > 0.0 { c.min(f32::MAX) } else { 0.0 })
}

/// Encodes what [`linear`] makes: the bytes of [`color`].
pub fn encode(light: &[f32], transfer: Transfer) -> Vec<u8> {
    let encoder = transfer.encoder();
    light.par_iter().with_min_len(1 << 14).map(|c| encoder.encode(*c)).collect()
}

fn run<T: Copy + Default + PartialEq + Send + Sync>(
    pixels: Pixels<'_>,
    eye: &Eye,
    lighting: &Lighting,
    background: [T; 3],
    written: impl Fn(f32) -> T + Copy + Sync,
) -> Vec<T> {
    let mut out = vec![T::default(); 3 * pixels.words.len()];
    let width = pixels.screen.width as usize;
    let materials = pixels.views.iter().map(|v| v.material.reflectance()).collect();
    let shader = Shader { pixels, materials, lighting, eye };
    out.par_chunks_mut(3 * width * ROWS).enumerate().for_each(|(chunk, out)| {
        let start = chunk * ROWS * width;
        let range = start..start + out.len() / 3;
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            // SAFETY: the processor has AVX2 and BMI2.
            return unsafe { shader.run_avx2(range, background, written, out) };
        }
        shader.run(range, background, written, out);
    });
    out
}

/// From pixels and distances to camera space.
#[inline(always)]
fn position(eye: &Eye, orthographic: bool, point: &[Lanes; 2], distance: Lanes) -> Vec3x8 {
    let scale = if orthographic { Lanes::splat(1.0) } else { distance };
    let x = (point[0] - eye.center[0]) * eye.inverse_focal[0] * scale;
    let y = -(point[1] - eye.center[1]) * eye.inverse_focal[1] * scale;
    [x, y, -distance]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    #[test]
    fn reflectance_matches_the_formula_written_out() {
        // One direction, worked out by hand in f64 from pyrender's shader.
        let material =
            Material { base_color: [0.7, 0.65, 0.6], metallic: 0.3, roughness: 0.5, ..Material::default() };
        let normalize = |v: [f32; 3]| super::normalize(&v.map(Lanes::splat)).map(|c| c.0[0]);
        let (n, v, l) = ([0.0, 0.0, 1.0], normalize([0.3, 0.1, 1.0]), normalize([-0.5, 0.4, 0.8]));
        let splat = |v: [f32; 3]| v.map(Lanes::splat);
        let got = reflect(&material.reflectance(), &splat(n), &splat(v), &splat(l)).map(|c| 2.0 * c.0[0]);
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
