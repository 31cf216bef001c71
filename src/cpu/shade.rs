//! Stage 7. Visibility buffer → colour: barycentric coordinates by analysis, interpolated normals, UVs and vertex
//! colours, textures, then light.
//!
//! The model is glTF's metallic-roughness BRDF: f0 = lerp(0.04, base, metal), Schlick's Fresnel, GGX with α = r², Smith's
//! visibility with heights correlated (Khronos, glTF 2.0, appendix B), the sum over lights, plus base · ambient ·
//! occlusion, plus emission, plus image-based lighting ([`super::environment`]); or as pyrender 0.1.45 evaluates it: G with k = (r + 1)²/8, back faces with the normals of the
//! front, occlusion and vertex colours times the sum, emission by the square of its factor. The background is written as it is.

use rayon::prelude::*;

use super::environment;
use super::lanes::{LANES, Lanes, Vec3x8, cross, dot, minus, normalize, splat3};
use super::material::Bsdf;
use super::output::ROWS;
use super::shadow_pages::{LastPage, Shadows};
use super::shadow_test::Receivers;
use super::surface::{Detail, Extra, Pixels, Surfels, Walk, position};
use crate::config::{Output, Shading, Transfer};
use crate::limits::{DIELECTRIC_F0, LEAST_COSINE};
use crate::scene::placement::Eye;
use crate::scene::{Falloff, Lighting};
use crate::views::decode;

const PI: f32 = std::f32::consts::PI;

/// Of a surface point, what does not depend on the light.
struct Reflector {
    normal: Vec3x8,
    /// α² of GGX.
    alpha2: Lanes,
    /// k of pyrender's G.
    k: Lanes,
    diffuse: Vec3x8,
    f0: Vec3x8,
    /// Unit, to the eye.
    view: Vec3x8,
    gltf: bool,
}

impl Reflector {
    #[inline(always)]
    fn new(bsdf: &Bsdf, view: Vec3x8, gltf: bool) -> Self {
        let r = bsdf.roughness;
        let (alpha2, k) = ((r * r) * (r * r), (r + 1.0) * (r + 1.0) / 8.0);
        let rest = -(bsdf.metallic - 1.0);
        // pyrender takes what is reflected at right angles off once more.
        let share = if gltf { rest } else { rest * (1.0 - DIELECTRIC_F0) };
        let (mut diffuse, mut f0) = ([rest; 3], [rest; 3]);
        for c in 0..3 {
            diffuse[c] = bsdf.base[c] * share;
            f0[c] = rest * DIELECTRIC_F0 + bsdf.base[c] * bsdf.metallic;
        }
        Self { normal: bsdf.normal, alpha2, k, diffuse, f0, view, gltf }
    }

    /// Light reflected, for light of intensity 1 from `l`, unit.
    #[inline(always)]
    fn reflect(&self, l: &Vec3x8) -> Vec3x8 {
        let Self { normal: n, alpha2, k, diffuse, f0, view: v, gltf } = self;
        let h = normalize(&[l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        let cosine = dot(n, &h);
        let nh = cosine.max(0.0).min(1.0);
        let side = cross(n, &h);
        let m = -(dot(v, &h).max(0.0).min(1.0) - 1.0);
        let schlick = m * m * m * m * m;
        // 1 − (n·h)² is |n × h|², which has no digits to lose where highlights are sharpest (Guy and Agopian, "Physically
        // Based Rendering in Filament").
        let d = cosine.where_negative(Lanes::splat(1.0), dot(&side, &side)) + nh * nh * *alpha2;
        let (nl, gloss);
        if *gltf {
            nl = dot(n, l).max(0.0).min(1.0);
            let nv = dot(n, v).max(LEAST_COSINE).min(1.0);
            let rest = -(*alpha2 - 1.0);
            let heights = nl * (nv * nv * rest + *alpha2).sqrt() + nv * (nl * nl * rest + *alpha2).sqrt();
            gloss = *alpha2 * 0.5 / (d * d * PI * heights);
        } else {
            nl = dot(n, l).max(LEAST_COSINE).min(1.0);
            let nv = dot(n, v).abs().max(LEAST_COSINE).min(1.0);
            let rest = -(*k - 1.0);
            // The two quotients of G, D and the denominator of the specular term as one.
            let smith = (nv * rest + *k) * (nl * rest + *k);
            gloss = nv * nl * *alpha2 / (smith * (d * d * PI) * (nl * nv * 4.0 + LEAST_COSINE));
        }
        let mut out = [nl; 3];
        for c in 0..3 {
            let f = schlick * -(f0[c] - 1.0) + f0[c];
            out[c] = nl * (-(f - 1.0) * (diffuse[c] * (1.0 / PI)) + f * gloss);
        }
        out
    }
}

/// The light of a frame.
#[derive(Clone, Copy)]
pub struct Light<'a> {
    /// All of it.
    pub lighting: &'a Lighting,
    /// What is in the way of lights, if they throw shadows.
    pub shadows: Option<&'a Shadows>,
}

/// Surface points as a frame shades them, and where they are seen from.
struct Seen {
    bsdf: Bsdf,
    /// Camera space.
    position: Vec3x8,
    /// Unit, to the eye.
    view: Vec3x8,
    /// Vertex colours where they multiply what was lit: pyrender's.
    late: Option<Vec3x8>,
}

impl Seen {
    #[inline(always)]
    fn new<D: Extra>(
        mut bsdf: Bsdf,
        surfels: &Surfels<'_, D>,
        eye: &Eye,
        orthographic: bool,
        shading: Shading,
    ) -> Self {
        let late = if shading == Shading::Pyrender { surfels.color } else { None };
        if let (Some(tint), None) = (&surfels.color, &late) {
            for c in 0..3 {
                bsdf.base[c] = bsdf.base[c] * tint[c];
            }
        }
        let position = position(eye, orthographic, &surfels.point, surfels.distance);
        let mut view = normalize(&[-position[0], -position[1], -position[2]]);
        if let (Some(detail), true) = (surfels.detail.detail(), shading != Shading::Pyrender) {
            if orthographic {
                view = splat3([0.0, 0.0, 1.0]);
            }
            let facing = dot(&detail.face, &view);
            for c in 0..3 {
                bsdf.normal[c] = facing.where_negative(-bsdf.normal[c], bsdf.normal[c]);
            }
        }
        Self { bsdf, position, view, late }
    }

    /// The base colour, and that of vertices.
    #[inline(always)]
    fn own_color(&self) -> Vec3x8 {
        let mut color = self.bsdf.base;
        if let Some(tint) = &self.late {
            for c in 0..3 {
                color[c] = color[c] * tint[c];
            }
        }
        color
    }

    /// The normals in the world.
    #[inline(always)]
    fn world_normal(&self, eye: &Eye) -> Vec3x8 {
        let n = &self.bsdf.normal;
        let mut world = *n;
        for c in 0..3 {
            let r = &eye.rotate;
            world[c] = n[0] * r[0][c] + n[1] * r[1][c] + n[2] * r[2][c];
        }
        world
    }
}

/// The light that surface points send to the eye; of each light as much reaches them as `reaches` says of its number.
#[inline(always)]
fn shade(
    seen: Seen,
    eye: &Eye,
    lighting: &Lighting,
    shading: Shading,
    reaches: impl Fn(usize) -> Option<Lanes>,
) -> Vec3x8 {
    if shading == Shading::Normals {
        return seen.world_normal(eye).map(|c| c * 0.5 + 0.5);
    }
    let Seen { bsdf, position, view, late } = seen;
    if shading == Shading::Flat {
        return bsdf.base;
    }
    let gltf = shading == Shading::Gltf;
    let (occlusion, emissive) = (bsdf.occlusion, bsdf.emissive);
    let mut color = [Lanes::splat(0.0); 3];
    for c in 0..3 {
        color[c] = bsdf.base[c] * lighting.ambient[c];
        if gltf {
            color[c] = color[c] * occlusion;
        }
    }
    let reflector = Reflector::new(&bsdf, view, gltf);
    if let (Some(around), true) = (&lighting.environment, gltf) {
        let Reflector { normal, diffuse, f0, view, .. } = &reflector;
        let out = environment::reflect(around, normal, view, bsdf.roughness, diffuse, f0);
        for c in 0..3 {
            color[c] = color[c] + out[c] * occlusion;
        }
    }
    for (number, light) in lighting.lights.iter().enumerate() {
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
        let falloff = reaches(number).map_or(falloff, |reaches| falloff * reaches);
        let out = reflector.reflect(&l);
        for c in 0..3 {
            color[c] = color[c] + out[c] * falloff * light.radiance[c];
        }
    }
    for c in 0..3 {
        if !gltf {
            color[c] = color[c] * occlusion;
        }
        color[c] = bsdf.lit.where_negative(bsdf.base[c], color[c] + emissive[c]);
        if let Some(tint) = &late {
            color[c] = color[c] * tint[c];
        }
    }
    color
}

/// What shading a row needs.
struct Shader<'a> {
    pixels: Pixels<'a>,
    light: Light<'a>,
    eye: &'a Eye,
    output: Output,
}

impl Shader<'_> {
    /// With the detail of each point, or as pyrender shades, without; of materials with textures, too, or of plain ones
    /// alone.
    fn rows<T: Copy + Default + PartialEq + Send + Sync, D: Extra, const TEXTURED: bool>(
        &self,
        background: [T; 3],
        written: impl Fn(f32) -> T + Copy + Sync,
    ) -> Vec<T> {
        let mut out = vec![T::default(); 3 * self.pixels.words.len()];
        let width = self.pixels.screen.width as usize;
        out.par_chunks_mut(3 * width * ROWS).enumerate().for_each(|(chunk, out)| {
            let start = chunk * ROWS * width;
            let range = start..start + out.len() / 3;
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
                // SAFETY: the processor has AVX2 and BMI2.
                return unsafe { self.run_avx2::<T, D, TEXTURED>(range, background, written, out) };
            }
            self.run::<T, D, TEXTURED>(range, background, written, out);
        });
        out
    }

    #[inline(always)]
    fn run<T: Copy + PartialEq, D: Extra, const TEXTURED: bool>(
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
        if !self.output.surface() {
            self.surround(range.clone(), &written, out);
        }
        let Some(mut walk) = Walk::new(self.pixels, range) else { return };
        let last = LastPage::of(self.light.shadows);
        // Known when this is compiled, so that what other ways of shading need is left out.
        let shading = if D::DETAIL { self.light.lighting.shading } else { Shading::Pyrender };
        while let Some(surfels) = walk.step::<D>() {
            let bsdf = match (surfels.view.materials.plain(), surfels.detail.detail()) {
                (None, Some(detail)) if TEXTURED => Bsdf::textured(&surfels, detail, shading),
                (material, _) => {
                    Bsdf::plain(material.unwrap_or_else(|| surfels.view.materials.of(0)), &surfels, shading)
                }
            };
            let orthographic = self.pixels.screen.orthographic;
            let seen = Seen::new(bsdf, &surfels, self.eye, orthographic, shading);
            let color = match self.output {
                Output::BaseColor => seen.bsdf.base,
                Output::ShadingNormal => seen.world_normal(self.eye),
                Output::Orm => [seen.bsdf.occlusion, seen.bsdf.roughness, seen.bsdf.metallic],
                Output::Emissive => seen.bsdf.emissive,
                // Points and lines have their colours, whatever the light.
                _ if surfels.view.stroke.is_some() && shading != Shading::Normals => seen.own_color(),
                _ => {
                    let receivers = match (self.light.shadows, surfels.detail.detail()) {
                        (Some(shadows), Some(detail)) => {
                            Receivers::new(&surfels, detail, &seen.position, orthographic)
                                .map(|all| (all, shadows))
                        }
                        _ => None,
                    };
                    let reaches = |number: usize| {
                        let (receivers, shadows) = receivers.as_ref()?;
                        Some(receivers.reached_by(shadows[number].as_ref()?, &last[number]))
                    };
                    shade(seen, self.eye, self.light.lighting, shading, reaches)
                }
            };
            for lane in 0..surfels.count {
                let at = 3 * (surfels.pixels[lane] as usize - start);
                let pixel = &mut out[at..at + 3];
                for c in 0..3 {
                    pixel[c] = written(color[c].0[lane]);
                }
            }
        }
    }

    /// Where nothing is covered, what lies around.
    #[inline(always)]
    fn surround<T>(&self, range: std::ops::Range<usize>, written: &impl Fn(f32) -> T, out: &mut [T]) {
        let Some(around) = self.light.lighting.environment.as_ref().filter(|around| around.background) else {
            return;
        };
        let Pixels { words, screen, .. } = self.pixels;
        for first in range.clone().step_by(LANES) {
            let pixels = first..(first + LANES).min(range.end);
            if words[pixels.clone()].iter().all(|word| decode(*word).is_some()) {
                continue;
            }
            let mut point = [Lanes::splat(0.5); 2];
            for lane in 0..LANES {
                let [column, row] = screen.pixel_of((first + lane) as u32);
                point[0].0[lane] += column as f32;
                point[1].0[lane] += row as f32;
            }
            let mut direction = position(self.eye, screen.orthographic, &point, Lanes::splat(1.0));
            if screen.orthographic {
                direction = splat3([0.0, 0.0, -1.0]);
            }
            let color = environment::behind(around, &direction);
            for pixel in pixels.filter(|pixel| decode(words[*pixel]).is_none()) {
                let at = 3 * (pixel - range.start);
                for c in 0..3 {
                    out[at + c] = written(color[c].0[pixel - first]);
                }
            }
        }
    }

    /// [`Shader::run`] with 256-bit vectors. No operation fuses, so the result is the same bit for bit.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn run_avx2<T: Copy + PartialEq, D: Extra, const TEXTURED: bool>(
        &self,
        range: std::ops::Range<usize>,
        background: [T; 3],
        written: impl Fn(f32) -> T,
        out: &mut [T],
    ) {
        self.run::<T, D, TEXTURED>(range, background, written, out)
    }
}

/// Shades every covered pixel into RGB bytes, row by row.
pub fn color(pixels: Pixels<'_>, eye: &Eye, light: &Light<'_>) -> Vec<u8> {
    let encoder = light.lighting.transfer.encoder();
    run(pixels, eye, light, Output::Color, light.lighting.background, |c| encoder.encode(c))
}

/// The same before it is encoded: RGB in linear light.
pub fn linear(pixels: Pixels<'_>, eye: &Eye, light: &Light<'_>) -> Vec<f32> {
    // NaN and infinity (a light at the surface) become numbers, so that means are.
    let written = |c: f32| if c > 0.0 { c.min(f32::MAX) } else { 0.0 };
    run(pixels, eye, light, Output::Linear, light.lighting.behind(), written)
}

/// What light meets: one of the arrays that are [`Output::surface`], three numbers for each pixel.
pub fn surface(pixels: Pixels<'_>, eye: &Eye, light: &Light<'_>, output: Output) -> Vec<f32> {
    run(pixels, eye, light, output, [0.0; 3], |c| c)
}

/// Encodes what [`linear`] makes: the bytes of [`color`].
pub fn encode(light: &[f32], transfer: Transfer) -> Vec<u8> {
    let encoder = transfer.encoder();
    light.par_iter().with_min_len(1 << 14).map(|c| encoder.encode(*c)).collect()
}

fn run<T: Copy + Default + PartialEq + Send + Sync>(
    pixels: Pixels<'_>,
    eye: &Eye,
    light: &Light<'_>,
    output: Output,
    background: [T; 3],
    written: impl Fn(f32) -> T + Copy + Sync,
) -> Vec<T> {
    let textured = pixels.views.iter().any(|view| view.materials.plain().is_none());
    let shader = Shader { pixels, light: *light, eye, output };
    match (textured, light.lighting.shading) {
        (true, _) => shader.rows::<T, Detail, true>(background, written),
        (_, Shading::Pyrender) if light.shadows.is_none() => shader.rows::<T, (), false>(background, written),
        // Detail tells back faces from front faces.
        _ => shader.rows::<T, Detail, false>(background, written),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_matches_the_formulas_written_out() {
        // One direction, worked out by hand in f64 from pyrender's shader and from glTF's appendix B.
        let (base, metallic, roughness) = ([0.7, 0.65, 0.6], 0.3, 0.5f32);
        let normalize = |v: [f32; 3]| super::normalize(&v.map(Lanes::splat)).map(|c| c.0[0]);
        let (n, v, l) = ([0.0, 0.0, 1.0], normalize([0.3, 0.1, 1.0]), normalize([-0.5, 0.4, 0.8]));
        let one = Lanes::splat(1.0);
        let bsdf = || Bsdf {
            normal: splat3(n),
            base: splat3(base),
            metallic: Lanes::splat(metallic),
            roughness: Lanes::splat(roughness),
            emissive: splat3([0.0; 3]),
            occlusion: one,
            lit: one,
        };
        let d64 = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| f64::from(a[k]) * f64::from(b[k])).sum::<f64>();
        let h = normalize([l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        let (nl, nv, nh, vh) = (d64(n, l), d64(n, v), d64(n, h), d64(v, h));
        for gltf in [false, true] {
            let got = Reflector::new(&bsdf(), splat3(v), gltf).reflect(&splat3(l)).map(|c| c.0[0]);
            for c in 0..3 {
                let (base, metal, r) = (f64::from(base[c]), 0.3, 0.5f64);
                let f0 = 0.04 * (1.0 - metal) + base * metal;
                let f = f0 + (1.0 - f0) * (1.0 - vh).powi(5);
                let a2 = r.powi(4);
                let d = a2 / (std::f64::consts::PI * (nh * nh * (a2 - 1.0) + 1.0).powi(2));
                let diffuse = (1.0 - f) * base * (1.0 - metal) / std::f64::consts::PI;
                let expected = if gltf {
                    let part = |x: f64, y: f64| x * (a2 + (1.0 - a2) * y * y).sqrt();
                    let visibility = 0.5 / (part(nl, nv) + part(nv, nl));
                    nl * (diffuse + f * visibility * d)
                } else {
                    let k = (r + 1.0).powi(2) / 8.0;
                    let g = nv / (nv * (1.0 - k) + k) * nl / (nl * (1.0 - k) + k);
                    nl * (diffuse * 0.96 + f * g * d / (4.0 * nl * nv + 0.001))
                };
                assert!((f64::from(got[c]) - expected).abs() < 1e-5, "{c}: {} for {expected}", got[c]);
            }
        }
    }

    /// What glTF's appendix B reflects of light of radiance 1 from everywhere, off a white surface.
    fn albedo(metallic: f64, roughness: f64, tilt: f64, directions: &[[f64; 3]]) -> f64 {
        let (v, a2) = ([tilt.sin(), 0.0, tilt.cos()], roughness.powi(4));
        let of = |l: &[f64; 3]| {
            let h: [f64; 3] = std::array::from_fn(|k| l[k] + v[k]);
            let length = h.iter().map(|c| c * c).sum::<f64>().sqrt();
            let (nl, nv, nh) = (l[2], v[2], h[2] / length);
            let vh = (0..3).map(|k| h[k] * v[k]).sum::<f64>() / length;
            let d = a2 / (std::f64::consts::PI * (nh * nh * (a2 - 1.0) + 1.0).powi(2));
            let part = |x: f64, y: f64| x * (a2 + (1.0 - a2) * y * y).sqrt();
            let gloss = d * 0.5 / (part(nl, nv) + part(nv, nl));
            let fresnel = |f0: f64| f0 + (1.0 - f0) * (1.0 - vh).powi(5);
            let dielectric = (1.0 - fresnel(0.04)) / std::f64::consts::PI + fresnel(0.04) * gloss;
            nl * ((1.0 - metallic) * dielectric + metallic * fresnel(1.0) * gloss)
        };
        directions.iter().map(of).sum::<f64>() * std::f64::consts::TAU / directions.len() as f64
    }

    #[test]
    fn as_much_is_reflected_as_gltf_says() {
        let (rows, columns) = (300, 600);
        let directions: Vec<[f64; 3]> = (0..rows * columns)
            .map(|i| {
                let z = (f64::from(i / columns) + 0.5) / f64::from(rows);
                let turn = std::f64::consts::TAU * (f64::from(i % columns) + 0.5) / f64::from(columns);
                let side = (1.0 - z * z).sqrt();
                [side * turn.cos(), side * turn.sin(), z]
            })
            .collect();
        for (metallic, roughness) in [(0.0, 1.0), (0.0, 0.3), (1.0, 0.2), (1.0, 0.5), (1.0, 1.0)] {
            for tilt in [0.0f64, 0.6, 1.2, 1.5] {
                let bsdf = Bsdf {
                    normal: splat3([0.0, 0.0, 1.0]),
                    base: splat3([1.0; 3]),
                    metallic: Lanes::splat(metallic),
                    roughness: Lanes::splat(roughness),
                    emissive: splat3([0.0; 3]),
                    occlusion: Lanes::splat(1.0),
                    lit: Lanes::splat(1.0),
                };
                let view = splat3([tilt.sin() as f32, 0.0, tilt.cos() as f32]);
                let reflector = Reflector::new(&bsdf, view, true);
                let of = |l: &[f64; 3]| f64::from(reflector.reflect(&splat3(l.map(|c| c as f32)))[0].0[0]);
                let sum = directions.iter().map(of).sum::<f64>();
                let got = sum * std::f64::consts::TAU / directions.len() as f64;
                let expected = albedo(metallic.into(), roughness.into(), tilt, &directions);
                assert!(
                    (got - expected).abs() < 1e-3,
                    "{metallic}, {roughness}, {tilt}: {got} for {expected}"
                );
                // Metals give no more than they get. White dielectrics seen from the side do, in glTF's own words.
                assert!(metallic == 0.0 || got < 1.001, "{roughness}, {tilt}: {got}");
            }
        }
    }
}
