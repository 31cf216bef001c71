//! What surface points reflect: the factors of a material, times its textures. `shaders/shared/material.wgsl` does the same
//! operations in the same order.

use super::lanes::{LANES, Lanes, Vec3x8, splat3};
use super::surface::{Detail, Surfels};
use super::texture::{Place, turned};
use crate::config::Shading;
use crate::scene::{Material, Slot, Texture};

/// Eight surface points, with all that light needs.
pub struct Bsdf {
    /// Unit, camera space.
    pub normal: Vec3x8,
    /// Base colour.
    pub base: Vec3x8,
    /// 0 to 1.
    pub metallic: Lanes,
    /// Perceptual, 0.04 to 1.
    pub roughness: Lanes,
    /// Emitted light.
    pub emissive: Vec3x8,
    /// How much of the light from everywhere arrives.
    pub occlusion: Lanes,
    /// Below zero where light does not count.
    pub lit: Lanes,
}

impl Bsdf {
    /// Of a material without textures.
    #[inline(always)]
    pub fn plain<D>(material: &Material, surfels: &Surfels<'_, D>, shading: Shading) -> Self {
        Self {
            normal: surfels.normal,
            base: splat3(material.base_color),
            metallic: Lanes::splat(material.metallic),
            roughness: Lanes::splat(material.shaded_roughness(1.0)),
            emissive: splat3(material.shaded_emission(shading)),
            occlusion: Lanes::splat(1.0),
            lit: Lanes::splat(material.lit()),
        }
    }

    /// Of the materials of an instance, each point by itself.
    #[inline(always)]
    pub fn textured<D>(surfels: &Surfels<'_, D>, detail: &Detail, shading: Shading) -> Self {
        let zero = Lanes::splat(0.0);
        let mut out = Self {
            normal: surfels.normal,
            base: [zero; 3],
            metallic: zero,
            roughness: zero,
            emissive: [zero; 3],
            occlusion: Lanes::splat(1.0),
            lit: Lanes::splat(1.0),
        };
        for lane in 0..surfels.count.min(LANES) {
            let point = Point::new(surfels, detail, lane, shading);
            let Point { material, .. } = point;
            let mut texels = [[0.0; 4]; Slot::COUNT];
            for slot in Slot::ALL {
                texels[slot as usize] = point.sample(slot);
            }
            let of = |slot: Slot| texels[slot as usize];
            let [r, g, b, _] = of(Slot::BaseColor);
            let base = [material.base_color[0] * r, material.base_color[1] * g, material.base_color[2] * b];
            let [_, rough, metal, _] = of(Slot::MetallicRoughness);
            let [r, g, b, _] = of(Slot::Emissive);
            let emission = material.shaded_emission(shading);
            let emissive = [emission[0] * r, emission[1] * g, emission[2] * b];
            let [open, ..] = of(Slot::Occlusion);
            let normal = point.normal(of(Slot::Normal));
            for k in 0..3 {
                out.base[k].0[lane] = base[k];
                out.emissive[k].0[lane] = emissive[k];
                out.normal[k].0[lane] = normal[k];
            }
            out.metallic.0[lane] = between(material.metallic * metal);
            out.roughness.0[lane] = material.shaded_roughness(rough);
            out.lit.0[lane] = material.lit();
            out.occlusion.0[lane] = 1.0 + material.occlusion_strength * (open - 1.0);
        }
        out
    }
}

/// Whether the alpha test drops the first point of a surface.
pub fn is_hole(surfels: &Surfels<'_, Detail>) -> bool {
    // Holes do not depend on how the rest is shaded.
    let point = Point::new(surfels, &surfels.detail, 0, Shading::Gltf);
    let [.., alpha] = point.sample(Slot::BaseColor);
    point.material.alpha_cutoff.is_some_and(|cutoff| point.material.alpha * alpha < cutoff)
}

/// How much of what is behind the first point of a surface it hides, 0 to 1: alpha of its material, of its texture and of the
/// colours of its vertices.
pub fn alpha(surfels: &Surfels<'_, Detail>) -> f32 {
    let point = Point::new(surfels, &surfels.detail, 0, Shading::Gltf);
    let [.., texel] = point.sample(Slot::BaseColor);
    (point.material.alpha * texel * point.vertex_alpha()).clamp(0.0, 1.0)
}

/// One surface point.
struct Point<'a, D> {
    material: &'a Material,
    surfels: &'a Surfels<'a, D>,
    detail: &'a Detail,
    lane: usize,
    shading: Shading,
    corners: [usize; 3],
    /// UV sets, one after the other, of so many vertices each.
    uvs: &'a [[f32; 2]],
    vertices: usize,
}

impl<'a, D> Point<'a, D> {
    #[inline(always)]
    fn new(surfels: &'a Surfels<'a, D>, detail: &'a Detail, lane: usize, shading: Shading) -> Self {
        let (view, cluster) = (surfels.view, surfels.clusters[lane]);
        let geometry = view.cluster(cluster);
        let material = view.materials.of(view.pages.record(cluster).material);
        let corners = geometry.triangles.get(surfels.hits[lane].triangle as usize).map(usize::from);
        let (uvs, vertices) = (geometry.uvs, geometry.positions.len());
        Self { material, surfels, detail, lane, shading, corners, uvs, vertices }
    }

    #[inline(always)]
    fn texture(&self, slot: Slot) -> Option<&'a Texture> {
        self.material.textures[slot as usize].as_ref()
    }

    /// UVs of the corners.
    #[inline(always)]
    fn corner_uvs(&self, texture: &Texture) -> [[f32; 2]; 3] {
        let set = usize::from(texture.uv_set);
        self.corners.map(|corner| self.uvs[set * self.vertices + corner])
    }

    /// What a texture shows; white where there is none.
    #[inline(always)]
    fn sample(&self, slot: Slot) -> [f32; 4] {
        let Some(texture) = self.texture(slot) else { return [1.0; 4] };
        let lane = |v: &Vec3x8| v.each_ref().map(|c| c.0[self.lane]);
        let [a, b, c] = self.corner_uvs(texture);
        let sum = |w: [f32; 3]| [0, 1].map(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k]);
        let uv = sum(lane(&self.detail.weights));
        let change = self.detail.change.each_ref().map(|change| sum(lane(change)));
        texture.sample(texture.image_for(self.shading), &Place::new(&texture.rows, uv, change))
    }

    /// What the colours of the corners have of alpha here; 1 without.
    fn vertex_alpha(&self) -> f32 {
        let format = self.surfels.view.mesh.layout().colors;
        if !format.is_some() {
            return 1.0;
        }
        let geometry = self.surfels.view.cluster(self.surfels.clusters[self.lane]);
        let of = |k: usize| {
            let [.., alpha] =
                format.unpack(&geometry.colors[format.words() * self.corners[k]..][..format.words()]);
            self.detail.weights[k].0[self.lane] * alpha
        };
        of(0) + of(1) + of(2)
    }

    /// The normal, with that of the texture, `texel`, in the frame that the UVs give: its first two axes lie along the rows of the
    /// image and up its columns.
    #[inline(always)]
    fn normal(&self, texel: [f32; 4]) -> [f32; 3] {
        let lane = |v: &Vec3x8| v.each_ref().map(|c| c.0[self.lane]);
        let own = if self.material.smooth { lane(&self.surfels.normal) } else { lane(&self.detail.face) };
        let Some(texture) = self.texture(Slot::Normal) else { return own };
        let rows = texture.rows;
        let [a, b, c] = self.corner_uvs(texture);
        let [s1, t1] = turned(&rows, [b[0] - a[0], b[1] - a[1]]);
        let [s2, t2] = turned(&rows, [c[0] - a[0], c[1] - a[1]]);
        let [a, b, c] = self.detail.corners.each_ref().map(lane);
        let (e1, e2) = (minus(b, a), minus(c, a));
        let turn = if s1 * t2 - s2 * t1 < 0.0 { -1.0 } else { 1.0 };
        let eye = &self.surfels.view.lod.object_to_eye;
        let to_eye = |v: [f32; 3]| [0, 1, 2].map(|k| eye[k][0] * v[0] + eye[k][1] * v[1] + eye[k][2] * v[2]);
        let along = to_eye([0, 1, 2].map(|k| (e1[k] * t2 - e2[k] * t1) * turn));
        let up = to_eye([0, 1, 2].map(|k| (e1[k] * s2 - e2[k] * s1) * turn));
        let part = dot(own, along);
        let Some(tangent) = unit([0, 1, 2].map(|k| along[k] - own[k] * part)) else { return own };
        let side = cross(own, tangent);
        let sign = if self.shading != Shading::Pyrender && dot(side, up) < 0.0 { -1.0 } else { 1.0 };
        let [x, y, z, _] = texel;
        let scale = self.material.normal_scale;
        let (x, y, z) = ((2.0 * x - 1.0) * scale, (2.0 * y - 1.0) * scale * sign, 2.0 * z - 1.0);
        unit([0, 1, 2].map(|k| tangent[k] * x + side[k] * y + own[k] * z)).unwrap_or(own)
    }
}

/// Between 0 and 1.
fn between(v: f32) -> f32 {
    let above = if v > 0.0 { v } else { 0.0 };
    if above < 1.0 { above } else { 1.0 }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// The unit vector, if there is one.
fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = dot(v, v).sqrt();
    (length >= f32::MIN_POSITIVE).then(|| {
        let inverse = 1.0 / length;
        v.map(|c| c * inverse)
    })
}
