//! Surface points and pages of shadow maps → how much of each light reaches them.

use rayon::prelude::*;

use super::lanes::{LANES, Lanes, Vec3x8, along, dot};
use super::output::ROWS;
use super::shadow_mark::{one_level, pixels};
use super::shadow_pages::{LastPage, LightShadow, Shadows};
use super::shadow_soft::March;
use super::surface::{Detail, Pixels, Surfels, Walk, position, receiver_error};
use crate::limits::{SHADOW_PAGE_SIDE, SHADOW_ROUNDING, SHADOW_SIDE, SHADOW_SNAP, SHADOW_TEXEL_REACH};
use crate::scene::palette::{FACING, hash, hue, ramp};
use crate::scene::placement::Eye;
use crate::shadow::receiver::{RelativePage, texel_of};
use crate::shadow::{LightView, Lookup, Receiver, ShadowPage};

/// Levels over which the colours of a debug view go.
const SHOWN_LEVELS: f32 = 8.0;
/// Triangles in a page up to which its colour is that of none.
const FEW_TRIANGLES: f32 = 16.0;
/// How often they double from there to the colour of most: to as many as a page has texels.
const SHOWN_DOUBLINGS: f32 = 10.0;
/// Pages from a frame before.
const KEPT_COLOR: [f32; 3] = [0.3, 0.8, 0.4];
/// Pages that were drawn.
const DRAWN_COLOR: [f32; 3] = [0.95, 0.35, 0.25];
/// Where no page is looked up.
const NO_LOOKUP_COLOR: [f32; 3] = [0.45; 3];

/// A debug view of the shadow maps of a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShadowView {
    /// A colour for each page.
    Pages,
    /// By level: red is the finest of those that are seen, then towards blue.
    Levels,
    /// Green from a frame before, red drawn for this one.
    Kept,
    /// By triangles of the light's cut in the page: blue few, red many.
    Cut,
}

/// Receivers of up to eight pixels, see [`Receiver`].
pub struct Receivers {
    count: usize,
    /// On the picture.
    point: [Lanes; 2],
    position: Vec3x8,
    normal: Vec3x8,
    smooth: Vec3x8,
    error: Lanes,
    distance: Lanes,
}

impl Receivers {
    /// Surface points at places in camera space; none where no shadow falls.
    #[inline(always)]
    pub fn new<D>(
        surfels: &Surfels<'_, D>,
        detail: &Detail,
        at: &Vec3x8,
        orthographic: bool,
    ) -> Option<Self> {
        let view = surfels.view;
        if !view.receives_shadows {
            return None;
        }
        let away = if orthographic { -detail.face[2] } else { dot(&detail.face, at) };
        // Lanes without a pixel have clusters of anything.
        let mut own = Lanes::splat(0.0);
        let mut last = None;
        for lane in 0..surfels.count {
            let cluster = surfels.clusters[lane];
            own.0[lane] = match last {
                Some((known, error)) if known == cluster => error,
                _ => receiver_error(view, cluster),
            };
            last = Some((cluster, own.0[lane]));
        }
        Some(Self {
            count: surfels.count,
            point: surfels.point,
            position: *at,
            normal: turned(&detail.face, -away),
            smooth: turned(&surfels.normal, -away),
            error: own,
            distance: dot(at, at).sqrt(),
        })
    }

    fn one(&self, lane: usize) -> Receiver {
        let of = |v: &Vec3x8| v.map(|c| c.0[lane]);
        let (position, normal, smooth) = (of(&self.position), of(&self.normal), of(&self.smooth));
        Receiver { position, normal, smooth, error: self.error.0[lane] }
    }

    /// How much of a light reaches each: 1, or 0 in its shadow, or, of a light with a size, a part. `last` is of this light.
    #[inline(always)]
    pub fn reached_by<'a>(&self, light: &'a LightShadow, last: &LastPage<'a>) -> Lanes {
        let view = &light.view;
        if view.soft() {
            return self.reached_by_rays(light, last);
        }
        let pixel = pixels(view, self.distance);
        let level = one_level(view, self.distance, pixel);
        match level.and_then(|level| Some((level, view.anchor(level)?))) {
            Some((level, anchor)) => self.in_level(light, level, &anchor, pixel, last),
            None => self.one_by_one(light, last),
        }
    }

    #[inline(never)]
    fn reached_by_rays<'a>(&self, light: &'a LightShadow, last: &LastPage<'a>) -> Lanes {
        let (mut starts, mut lit) = ([None; LANES], Lanes::splat(1.0));
        for lane in 0..self.count {
            match light.view.start(&self.one(lane)) {
                Ok(start) => starts[lane] = Some(start),
                Err(there) => lit.0[lane] = f32::from(u8::from(there)),
            }
        }
        March { light, last }.run(&starts[..self.count], &mut lit, &self.point);
        lit
    }

    fn one_by_one<'a>(&self, light: &'a LightShadow, last: &LastPage<'a>) -> Lanes {
        let mut out = Lanes::splat(1.0);
        for lane in 0..self.count {
            out.0[lane] = match light.view.look_up(&self.one(lane)) {
                Lookup::Lit => 1.0,
                Lookup::Dark => 0.0,
                Lookup::Texel { page, texel, key } => lit(last.page(light, page), texel, key),
            };
        }
        out
    }

    /// [`LightView::look_up`] of receivers that look up one level of a parallel map, operation by operation.
    #[inline(always)]
    fn in_level<'a>(
        &self,
        light: &'a LightShadow,
        level: i32,
        anchor: &[f32; 3],
        pixel: Lanes,
        last: &LastPage<'a>,
    ) -> Lanes {
        let LightView { axes, threshold, .. } = &light.view;
        let (normal, smooth) = (along(&axes[2], &self.normal), along(&axes[2], &self.smooth));
        let texel = texel_of(level);
        // Not above 0, or not a number: the smooth one.
        let pick = |lane: usize| normal.0[lane] > 0.0;
        let mut slope = (-(normal * normal - 1.0)).max(0.0).sqrt();
        let mut chosen = self.normal;
        for lane in 0..LANES {
            slope.0[lane] = if pick(lane) { slope.0[lane] } else { 1.0 };
            for k in 0..3 {
                chosen[k].0[lane] = if pick(lane) { self.normal[k].0[lane] } else { self.smooth[k].0[lane] };
            }
        }
        let own = self.error + (self.distance * SHADOW_ROUNDING + pixel * SHADOW_SNAP);
        let by = own + (slope * SHADOW_TEXEL_REACH + *threshold) * texel;
        // Powers of two: products are what quotients are.
        let inverse = texel_of(-level);
        let right = along(&axes[0], &self.position) + by * along(&axes[0], &chosen);
        let up = along(&axes[1], &self.position) + by * along(&axes[1], &chosen);
        let nearer = along(&axes[2], &self.position) + by * along(&axes[2], &chosen);
        let (x, y, z) =
            (right * inverse + anchor[0], -(up * inverse - anchor[1]), nearer * inverse + anchor[2]);
        let side = SHADOW_PAGE_SIDE as f32;
        let (column, row) = ((x * (1.0 / side)).floor(), (y * (1.0 / side)).floor());
        let slab = (z * (1.0 / SHADOW_SIDE as f32)).floor();
        let depth = ((slab + 1.0) * SHADOW_SIDE as f32 - z) * texel;
        let depth =
            depth - (self.distance * SHADOW_ROUNDING + texel * (SHADOW_SIDE as f32 * SHADOW_ROUNDING));
        let depth = depth.max(0.0);
        // [`texel_in`], as whole numbers.
        let (x, y) = ((x - column * side).floor(), (y - row * side).floor());
        let number = y.max(0.0).min(side - 1.0) * side + x.max(0.0).min(side - 1.0);
        let mut out = Lanes::splat(1.0);
        let page = |lane: usize| RelativePage {
            face: 0,
            level: level as i16,
            x: column.0[lane] as i32,
            y: row.0[lane] as i32,
            z: slab.0[lane] as i32,
        };
        let mut same = true;
        for lane in 1..LANES {
            same &= (column.0[lane] == column.0[0]) & (row.0[lane] == row.0[0]) & (slab.0[lane] == slab.0[0]);
        }
        // Of eight neighbours all mostly fall into one page.
        let of_all = same.then(|| last.page(light, page(0)));
        for lane in 0..self.count {
            out.0[lane] = if pick(lane) || smooth.0[lane] > 0.0 {
                let texels = of_all.unwrap_or_else(|| last.page(light, page(lane)));
                lit(texels, number.0[lane] as u32, !depth.0[lane].to_bits())
            } else {
                0.0
            };
        }
        out
    }
}

/// Vectors, turned where something is negative.
#[inline(always)]
fn turned(v: &Vec3x8, sign: Lanes) -> Vec3x8 {
    let mut out = *v;
    for k in 0..3 {
        out[k] = sign.where_negative(-v[k], v[k]);
    }
    out
}

/// 1 where nothing in a page is nearer to the light.
#[inline(always)]
fn lit(page: Option<&ShadowPage>, texel: u32, key: u32) -> f32 {
    debug_assert!(page.is_some(), "a page that is looked up was not marked");
    if page.is_none_or(|page| page.keys()[texel as usize] <= key) { 1.0 } else { 0.0 }
}

/// A debug view of the first light that throws shadows, in RGB; grey where a pixel looks nothing up, black where nothing is
/// covered.
pub fn view(pixels: Pixels<'_>, eye: &Eye, shadows: &Shadows, what: ShadowView) -> Vec<[u8; 3]> {
    let light = shadows.iter().flatten().next();
    let finest = light.and_then(|light| light.pages.keys().map(|page| page.level).min()).unwrap_or(0);
    let color = |light: &LightShadow, page: RelativePage| match what {
        ShadowView::Pages => {
            let RelativePage { face, level, x, y, z } = page;
            hue(hash([x as u32, y as u32, (z as u32) << 16 ^ (level as u32) << 4 ^ u32::from(face)]))
        }
        ShadowView::Levels => ramp(f32::from(page.level - finest) / SHOWN_LEVELS),
        ShadowView::Kept if light.drawn.contains(&page) => DRAWN_COLOR,
        ShadowView::Kept => KEPT_COLOR,
        ShadowView::Cut => {
            let triangles = light.pages.get(&page).map_or(0, |page| page.triangles());
            ramp(1.0 - ((1.0 + triangles as f32) / FEW_TRIANGLES).log2() / SHOWN_DOUBLINGS)
        }
    };
    let of_lanes = |receivers: &Receivers, lane: usize| match light.map(|light| (light, receivers.one(lane)))
    {
        Some((light, receiver)) => match light.view.look_up(&receiver) {
            Lookup::Texel { page, .. } => color(light, page),
            _ => NO_LOOKUP_COLOR,
        },
        None => NO_LOOKUP_COLOR,
    };
    let mut out = vec![[0; 3]; pixels.words.len()];
    let stretch = (ROWS * pixels.screen.width as usize).max(1);
    out.par_chunks_mut(stretch).enumerate().for_each(|(chunk, out)| {
        let start = chunk * stretch;
        let Some(mut walk) = Walk::new(pixels, start..start + out.len()) else { return };
        while let Some(surfels) = walk.step::<Detail>() {
            let orthographic = pixels.screen.orthographic;
            let at = position(eye, orthographic, &surfels.point, surfels.distance);
            let receivers = Receivers::new(&surfels, &surfels.detail, &at, orthographic);
            for lane in 0..surfels.count {
                let color = receivers.as_ref().map_or(NO_LOOKUP_COLOR, |all| of_lanes(all, lane));
                let facing = FACING[0] + FACING[1] * surfels.normal[2].0[lane].abs();
                out[surfels.pixels[lane] as usize - start] = color.map(|c| (c * facing * 255.0 + 0.5) as u8);
            }
        }
    });
    out
}

/// How much of each light reaches each pixel, row by row: all lights of the first pixel first. 1 where nothing is covered.
pub fn run(pixels: Pixels<'_>, eye: &Eye, shadows: &Shadows) -> Vec<f32> {
    let lights = shadows.len();
    let mut out = vec![1.0; lights * pixels.words.len()];
    let stretch = ROWS * pixels.screen.width as usize;
    out.par_chunks_mut((lights * stretch).max(1)).enumerate().for_each(|(chunk, out)| {
        let start = chunk * stretch;
        let Some(mut walk) = Walk::new(pixels, start..start + out.len() / lights) else { return };
        let last = LastPage::of(Some(shadows));
        while let Some(surfels) = walk.step::<Detail>() {
            let orthographic = pixels.screen.orthographic;
            let at = position(eye, orthographic, &surfels.point, surfels.distance);
            let Some(receivers) = Receivers::new(&surfels, &surfels.detail, &at, orthographic) else {
                continue;
            };
            for (number, light) in shadows.iter().enumerate() {
                let Some(light) = light else { continue };
                let reached = receivers.reached_by(light, &last[number]);
                for lane in 0..surfels.count {
                    out[lights * (surfels.pixels[lane] as usize - start) + number] = reached.0[lane];
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DMat3, DVec3};

    use rustc_hash::{FxHashMap, FxHashSet};

    use super::*;
    use crate::scene::{Camera, Light, Projection};

    use crate::shadow::{Lamp, ShadowMap};

    /// Pages of noise about as deep as receivers: half of what is looked up is dark, if the texel is that of the scalar form.
    fn noise(of: &LightView, receivers: &[Receivers]) -> FxHashMap<RelativePage, Arc<ShadowPage>> {
        let mut pages = FxHashMap::default();
        let all = receivers.iter().flat_map(|eight| (0..eight.count).map(|lane| eight.one(lane)));
        for receiver in all {
            if let Lookup::Texel { page, texel, key } = of.look_up(&receiver) {
                let texels = pages.entry(page).or_insert_with(|| vec![0u32; 1 << 14]);
                // Some exactly as deep, some a bit nearer.
                texels[texel as usize] = key.saturating_add(texel % 3).saturating_sub(1);
            }
        }
        let page = |texels| Arc::new(ShadowPage::new(texels, 0));
        pages.into_iter().map(|(at, texels)| (at, page(texels))).collect()
    }

    #[test]
    fn eight_receivers_look_up_what_one_does() {
        let mut state = 1u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            2.0 * (state >> 8) as f32 / (1u32 << 24) as f32 - 1.0
        };
        let mut outcomes = [0; 2];
        for case in 0..60 {
            let orthographic = case % 3 == 2;
            let projection = match orthographic {
                true => Projection::Orthographic { xmag: None, ymag: 2.0 },
                false => Projection::Perspective { yfov: 0.8, aspect: None },
            };
            let pose =
                [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, -2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
            let view = Camera { projection, znear: 0.05, zfar: None }.view(&pose, 640, 360).unwrap();
            let axis = DVec3::new(random().into(), random().into(), random().into()).normalize();
            let (x, y) = axis.any_orthonormal_pair();
            let light = Light { pose: DAffine3::from_mat3(DMat3::from_cols(x, y, axis)), ..Light::default() };
            let map = ShadowMap::new(&light, 16.0).unwrap();
            let light = LightView::new(0, &map, &view, [1.0, 0.0, 0.3][case % 3], 16.0, Lamp::default())
                .made_coarser(case as i32 % 2);
            let receivers: Vec<Receivers> = (0..50)
                .map(|_| {
                    let mut vector = || [0; 3].map(|_| Lanes([0; LANES].map(|_| random())));
                    let (mut position, normal, mut smooth) = (vector(), vector(), vector());
                    position[2] = position[2] * 0.2 - 3.0;
                    smooth[0].0[3] = f32::NAN;
                    let unit = |v: &Vec3x8| super::super::lanes::normalize(v);
                    Receivers {
                        count: LANES,
                        point: [Lanes::splat(0.0); 2],
                        position,
                        normal: unit(&normal),
                        smooth: unit(&smooth),
                        error: Lanes::splat(1e-3),
                        distance: dot(&position, &position).sqrt(),
                    }
                })
                .collect();
            let pages = noise(&light, &receivers);
            let shadow = LightShadow { pages, drawn: FxHashSet::default(), view: light };
            for eight in &receivers {
                let last = LastPage::default();
                let (together, apart) = (eight.reached_by(&shadow, &last), eight.one_by_one(&shadow, &last));
                assert_eq!(together.0, apart.0);
                together.0.iter().for_each(|lit| outcomes[usize::from(*lit > 0.0)] += 1);
            }
        }
        assert!(outcomes.iter().all(|count| *count > 2000), "{outcomes:?}");
    }
}
