//! How much of the light from a white sky glTF's BRDF reflects: what is integrated beforehand, so that image-based lighting
//! costs a pixel a few lookups.
//!
//! With Schlick's Fresnel the specular part is linear in f0: A · f0 + B, two integrals over GGX and Smith's visibility with
//! heights correlated that depend on the view and the roughness (B. Karis, "Real shading in Unreal Engine 4", SIGGRAPH 2013).
//! The diffuse part loses the same Fresnel on the way: (1 − f0) · (1 − C), of which C depends on the view alone. A, B and C
//! together give what a sum over lights from everywhere gives, exactly.

use std::sync::OnceLock;

use rayon::prelude::*;

use crate::threads::once;

/// Entries along each side of the table: roots of cosines to the eye, and roughnesses, from 0 to 1.
pub const ALBEDO_SIDE: usize = 48;
/// Numbers of an entry: A, B and C.
pub const ALBEDO_PARTS: usize = 3;
/// Samples of an integral, outwards and around.
const STEPS: [u32; 2] = [48, 24];
/// The least cosine to the eye with which surfaces are shaded.
const GRAZING: f64 = 0.001;

/// A, B and C, by rows of equal roughness. Made once.
pub fn table() -> &'static [f32] {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    once::<Vec<f32>>(&TABLE, || {
        let part = |at: usize| at as f64 / (ALBEDO_SIDE - 1) as f64;
        let entry = |at: usize| albedo(part(at % ALBEDO_SIDE).powi(2).max(GRAZING), part(at / ALBEDO_SIDE));
        let entries: Vec<[f64; ALBEDO_PARTS]> =
            (0..ALBEDO_SIDE * ALBEDO_SIDE).into_par_iter().map(entry).collect();
        entries.as_flattened().iter().map(|part| *part as f32).collect()
    })
}

/// A, B and C seen at a cosine, by sums over microfacets as they are seen (E. Heitz, "Sampling the GGX distribution
/// of visible normals", JCGT 7:4, 2018), and over directions as Lambert reflects.
fn albedo(nv: f64, roughness: f64) -> [f64; ALBEDO_PARTS] {
    let alpha = roughness * roughness;
    let lambda = |c: f64| 0.5 * ((1.0 + alpha * alpha * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
    let view = [(1.0 - nv * nv).sqrt(), nv];
    // The view where the surface is stretched to a roughness of 1.
    let length = (alpha * view[0]).hypot(view[1]);
    let stretched = [alpha * view[0] / length, view[1] / length];
    let seen = 0.5 * (1.0 + stretched[1]);
    let mut sum = [0.0; ALBEDO_PARTS];
    for i in 0..STEPS[1] {
        // The half on the other side is the same.
        let turn = std::f64::consts::PI * ((f64::from(i) + 0.5) / f64::from(STEPS[1]) - 0.5);
        for j in 0..STEPS[0] {
            // Denser at the rim, where the facets of GGX's tail are.
            let rest = 1.0 - (f64::from(j) + 0.5) / f64::from(STEPS[0]);
            let (part, weight) = (1.0 - rest * rest, 2.0 * rest);
            let (aside, up) = (part.sqrt() * turn.cos(), part.sqrt() * turn.sin());
            let up = (1.0 - seen) * (1.0 - aside * aside).sqrt() + seen * up;
            let along = (1.0 - aside * aside - up * up).max(0.0).sqrt();
            let facet = [
                alpha * (stretched[0] * along - stretched[1] * up),
                alpha * aside,
                (stretched[0] * up + stretched[1] * along).max(0.0),
            ];
            let length = facet.iter().map(|c| c * c).sum::<f64>().sqrt();
            let vh = ((view[0] * facet[0] + view[1] * facet[2]) / length).clamp(0.0, 1.0);
            let nl = 2.0 * vh * facet[2] / length - nv;
            if nl > 0.0 {
                // What light reaches of what is seen.
                let light = weight * (1.0 + lambda(nv)) / (1.0 + lambda(nv) + lambda(nl));
                let schlick = (1.0 - vh).powi(5);
                sum[0] += (1.0 - schlick) * light;
                sum[1] += schlick * light;
            }
            let lv = view[0] * part.sqrt() * turn.sin() + view[1] * (1.0 - part).sqrt();
            sum[2] += weight * (1.0 - (0.5 * (1.0 + lv)).max(0.0).sqrt()).powi(5);
        }
    }
    sum.map(|part| part / f64::from(STEPS[0] * STEPS[1]))
}
