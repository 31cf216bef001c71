//! Receivers → how much of a light with a size reaches them: rays to points of the light, marched through the levels of its
//! map. What needs no ray is told first, for eight receivers at once: levels in which everything is below all rays, or above.

use super::lanes::{LANES, Lanes, Vec3x8};
use super::shadow_pages::{LastPage, LightShadow};
use crate::limits::{SHADOW_PAGE_SIDE, SHADOW_SIDE, SHADOW_SOFT_STEP};
use crate::shadow::map::BOUNDED_LEVELS;
use crate::shadow::receiver::{Place, RelativePage, texel_of};
use crate::shadow::soft::{Bundle, Start, span, steps};
use crate::shadow::{LightView, ShadowPage};

/// Nothing is as low as this.
const NOTHING: f32 = f32::NEG_INFINITY;

/// A light, and the pages that were looked up last.
#[derive(Clone, Copy)]
pub struct March<'a, 'l> {
    /// Its maps.
    pub light: &'a LightShadow,
    /// See [`LastPage`].
    pub last: &'l LastPage<'a>,
}

/// Rays from a receiver to eight points of a light.
struct Rays {
    /// Where they begin.
    at: [f32; 3],
    /// Of a directional light what they go to the side for each unit that they rise; else all that they go to the side.
    aside: [Lanes; 3],
}

impl<'a> March<'a, '_> {
    /// How much of the light reaches receivers on pixels, where the light is not behind all of them: `points` are their places
    /// on the picture.
    #[inline(always)]
    pub fn run(&self, starts: &[Option<Start>], lit: &mut Lanes, points: &[Lanes; 2]) {
        let view = &self.light.view;
        let together = view.bundle(starts).map(|bundle| self.undecided(&bundle));
        for (lane, start) in starts.iter().enumerate() {
            let Some(start) = start else { continue };
            let bands = together.unwrap_or_else(|| self.undecided(&view.single(start)));
            let own = self.own(start);
            let next = view.risen(start, 1.0);
            let height = view.along(start.moved.face, 2, &start.moved.at);
            let high = if view.parallel() { height + next } else { height * (1.0 - next) };
            if own > height + view.raised(start, 0) && own <= high {
                lit.0[lane] = 0.0;
                continue;
            }
            if bands == 0 && above_horizon(view, start) && own <= high {
                continue;
            }
            let turn = gradient_noise(points[0].0[lane], points[1].0[lane]);
            lit.0[lane] = self.visible(start, own, bands, turn);
        }
    }

    /// How high what the light sees is where a receiver is, which its rays leave by no more than a texel.
    #[inline(always)]
    fn own(&self, start: &Start) -> f32 {
        let view = &self.light.view;
        let Some(place) = view.place(&start.moved.at, start.moved.level) else { return NOTHING };
        let page = RelativePage { z: view.slab(start.moved.level, start.moved.at[2]), ..place.page };
        read(view, self.last.page(self.light, page), &page, place.texel)
    }

    /// The bands, as bits, in which rays of receivers may hit something.
    fn undecided(&self, bundle: &Bundle) -> u32 {
        let view = &self.light.view;
        let mut undecided = 0;
        // Of the band before, the highest that anything is.
        let mut before = NOTHING;
        for band in 0..bundle.bands[1] {
            let [low, high] = view.heights(bundle, band);
            let level = view.climbed(bundle.level, band);
            let z = view.slab(level, bundle.heights[1]);
            let page = RelativePage { face: bundle.face, level: level as i16, x: 0, y: 0, z };
            let rect = view.beneath(bundle, band, level);
            let (mut low, mut range) = (low, self.range(page, rect, [low, high]));
            if view.faces() > 1 && beyond(&page, rect) {
                (low, range) = (view.lowest(bundle, band), self.farther());
            }
            let [lowest, highest] = range.unwrap_or([NOTHING, f32::INFINITY]);
            let below = highest <= low && before <= low;
            // Where rays end, nothing is above them.
            let above = lowest > high && band + 1 < bundle.bands[0];
            undecided |= u32::from(!(below || above)) << band;
            before = highest;
        }
        undecided
    }

    /// Between which heights everything is in a rectangle of texels of a level, or more than that, where it is all below what
    /// rays there are between, or above; `None` where that is not known.
    fn range(&self, page: RelativePage, rect: [f32; 4], rays: [f32; 2]) -> Option<[f32; 2]> {
        let view = &self.light.view;
        let side = SHADOW_PAGE_SIDE as f32;
        let (mut low, mut high) = (f32::INFINITY, NOTHING);
        let mut rect = rect;
        if !view.parallel() && beyond(&page, rect) {
            // Beyond the border of a spot's map is nothing.
            low = NOTHING;
            let texels = (SHADOW_SIDE >> page.level) as f32;
            if rect[0] >= texels || rect[1] >= texels || rect[2] < 0.0 || rect[3] < 0.0 {
                return Some([NOTHING; 2]);
            }
            rect = rect.map(|v| v.max(0.0).min(texels - 1.0));
        }
        let first = [rect[0], rect[1]].map(|v| (v / side).floor() as i32);
        let last = [rect[2], rect[3]].map(|v| (v / side).floor() as i32);
        for y in first[1]..=last[1] {
            for x in first[0]..=last[0] {
                let page = RelativePage { x, y, ..page };
                let texels = self.last.page(self.light, page)?;
                let within = |v: f32, page: i32| (v - page as f32 * side).max(0.0).min(side - 1.0) as u32;
                let rect = [within(rect[0], x), within(rect[1], y), within(rect[2], x), within(rect[3], y)];
                // Mostly all of a page is below rays, or above.
                let mut range = texels.whole().map(|key| height(view, &page, key));
                if range[1] > rays[0] && range[0] <= rays[1] {
                    range = texels.range(rect).map(|key| height(view, &page, key));
                }
                let [least, most] = range;
                (low, high) = (low.min(least), high.max(most));
            }
        }
        Some([low, high])
    }

    /// Between which heights everything is that any face of a cube sees: no higher, in a face, than by its depth there.
    fn farther(&self) -> Option<[f32; 2]> {
        let view = &self.light.view;
        let level = BOUNDED_LEVELS as i16 - 1;
        let mut high = NOTHING;
        for face in 0..view.faces() {
            let page = RelativePage { face, level, x: 0, y: 0, z: 0 };
            let [_, most] = self.last.page(self.light, page)?.whole();
            let most = height(view, &page, most);
            high = if most > high { most } else { high };
        }
        Some([NOTHING, high])
    }

    /// How much of the light a receiver sees, if its rays hit nothing but in some bands. The points of the light are turned
    /// by a part of a whole turn.
    fn visible(&self, start: &Start, own: f32, bands: u32, turn: f32) -> f32 {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            // SAFETY: the processor has AVX2 and BMI2.
            return unsafe { self.visible_avx2(start, own, bands, turn) };
        }
        self.visible_anywhere(start, own, bands, turn)
    }

    /// The same with 256-bit vectors. No operation fuses, so the result is the same.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn visible_avx2(&self, start: &Start, own: f32, bands: u32, turn: f32) -> f32 {
        self.visible_anywhere(start, own, bands, turn)
    }

    #[inline(always)]
    fn visible_anywhere(&self, start: &Start, own: f32, bands: u32, turn: f32) -> f32 {
        let view = &self.light.view;
        let points = &view.lamp.points;
        let (sin, cos) = (turn * std::f32::consts::TAU).sin_cos();
        let mut dark = 0;
        for points in points.chunks(LANES) {
            let mut disk = [Lanes::splat(0.0); 2];
            for lane in 0..LANES {
                let [x, y] = points[lane.min(points.len() - 1)];
                (disk[0].0[lane], disk[1].0[lane]) = (cos * x - sin * y, sin * x + cos * y);
            }
            let rays = rays(view, start, &disk);
            let blocked = self.blocked(start, own, &rays, bands);
            dark += blocked[..points.len()].iter().filter(|blocked| **blocked).count();
        }
        1.0 - dark as f32 / points.len() as f32
    }

    /// Which rays something is in the way of.
    #[inline(always)]
    fn blocked(&self, start: &Start, own: f32, rays: &Rays, bands: u32) -> [bool; LANES] {
        let view = &self.light.view;
        let mut blocked = below_horizon(view, start, rays);
        // What the map says where rays were last.
        let mut before = Lanes::splat(own);
        let page = |band: u32| {
            let level = view.climbed(start.moved.level, band);
            let z = view.slab(level, start.moved.at[2]);
            RelativePage { face: start.moved.face, level: level as i16, x: 0, y: 0, z }
        };
        for band in 0..start.bands {
            if bands >> band & 1 == 0 {
                continue;
            }
            if band > 0 && bands >> (band - 1) & 1 == 0 {
                let last = steps(band - 1).last().map_or(0.0, |step| 0.5 * (step.from + step.to));
                before = self.sample(page(band - 1), &point(view, start, rays, last)).0;
            }
            let raised = view.raised(start, band);
            // As high as the band before left off, so that nothing is between the two.
            let mut raised_before = view.raised(start, band.saturating_sub(1));
            let level = view.climbed(start.moved.level, band);
            let texel = start.moved.texel * texel_of(level - start.moved.level) * SHADOW_SOFT_STEP;
            let mut entry = None;
            for step in steps(band) {
                let last = band + 1 == start.bands && step.to == span(band)[1];
                let middle = point(view, start, rays, 0.5 * (step.from + step.to));
                let (found, faces) = self.sample(page(band), &middle);
                let from = match entry {
                    Some(from) if faces.is_none() => from,
                    _ => ray_height(view, &point(view, start, rays, step.from), &faces) + raised_before,
                };
                let mut to = ray_height(view, &point(view, start, rays, step.to), &faces) + raised;
                if last {
                    to = Lanes::splat(f32::INFINITY);
                }
                (entry, raised_before) = (Some(to), raised);
                let left = if view.parallel() { 1.0 } else { 1.0 - view.risen(start, step.to) };
                let fall = texel * left.max(0.0);
                let ground = view.ground(start, step.to);
                let mut open = false;
                for lane in 0..LANES {
                    let (c, a) = (found.0[lane], before.0[lane]);
                    let crossed = (c > from.0[lane]) & (c <= to.0[lane]);
                    // It was below, and is above. If that is one surface, it is hit. If the ray comes out from under an edge,
                    // something else begins there: if that is above the receiver, the ray came through it, below the edge,
                    // where the light does not see it.
                    let passed = (a > from.0[lane]) & (c <= from.0[lane]) & ((a - c <= fall) | (c > ground));
                    blocked[lane] |= crossed | passed;
                    open |= !blocked[lane];
                }
                before = found;
                if !open {
                    return blocked;
                }
            }
        }
        blocked
    }

    /// How high what the light sees is where points lie in a level, and the faces of a cube that see them.
    #[inline(always)]
    fn sample(&self, page: RelativePage, at: &Vec3x8) -> (Lanes, Option<[u8; LANES]>) {
        let view = &self.light.view;
        let level = i32::from(page.level);
        let mut out = Lanes::splat(NOTHING);
        let Some(anchor) = view.anchor(level) else {
            let mut faces = [0; LANES];
            for lane in 0..LANES {
                let at = at.map(|c| c.0[lane]);
                faces[lane] = view.face(&at);
                if let Some(Place { page, texel, .. }) = view.place(&at, level) {
                    out.0[lane] = read(view, self.last.page(self.light, page), &page, texel);
                }
            }
            return (out, Some(faces));
        };
        let (side, inverse) = (SHADOW_PAGE_SIDE as f32, texel_of(-level));
        let (x, y) = (at[0] * inverse + anchor[0], -(at[1] * inverse - anchor[1]));
        let (column, row) = ((x * (1.0 / side)).floor(), (y * (1.0 / side)).floor());
        let (right, down) = ((x - column * side).floor(), (y - row * side).floor());
        let number = down.max(0.0).min(side - 1.0) * side + right.max(0.0).min(side - 1.0);
        let at = |lane: usize| RelativePage { x: column.0[lane] as i32, y: row.0[lane] as i32, ..page };
        let mut same = true;
        for lane in 1..LANES {
            same &= (column.0[lane] == column.0[0]) & (row.0[lane] == row.0[0]);
        }
        let of_all = same.then(|| self.last.page(self.light, at(0)));
        for lane in 0..LANES {
            let texels = of_all.unwrap_or_else(|| self.last.page(self.light, at(lane)));
            out.0[lane] = read(view, texels, &at(lane), number.0[lane] as u32);
        }
        (out, None)
    }
}

/// Whether a rectangle of texels reaches beyond a face of a map that has an end.
fn beyond(page: &RelativePage, rect: [f32; 4]) -> bool {
    let texels = (SHADOW_SIDE >> page.level) as f32;
    rect[0] < 0.0 || rect[1] < 0.0 || rect[2] >= texels || rect[3] >= texels
}

/// How high what is seen through a texel is.
#[inline(always)]
fn read(view: &LightView, page: Option<&ShadowPage>, of: &RelativePage, texel: u32) -> f32 {
    debug_assert!(page.is_some(), "a page that is looked up was not marked: {of:?}");
    page.map_or(NOTHING, |page| height(view, of, page.keys()[texel as usize]))
}

/// Of a key of a page, how high that is: above the camera along the light's axis or, from a light with a position, less the
/// depth in the page's face.
#[inline(always)]
fn height(view: &LightView, page: &RelativePage, key: u32) -> f32 {
    let level = i32::from(page.level);
    if key == 0 {
        return NOTHING;
    }
    match view.anchor(level) {
        Some(anchor) => {
            let top = ((page.z + 1) as f32 * SHADOW_SIDE as f32 - anchor[2]) * texel_of(level);
            top - f32::from_bits(!key)
        }
        None => -(view.near / f32::from_bits(key)),
    }
}

/// How high points of rays are, as [`height`] has it.
#[inline(always)]
fn ray_height(view: &LightView, at: &Vec3x8, faces: &Option<[u8; LANES]>) -> Lanes {
    let Some(faces) = faces else { return at[2] };
    let mut out = at[2];
    for lane in 0..LANES {
        out.0[lane] = view.along(faces[lane], 2, &at.map(|c| c.0[lane]));
    }
    out
}

/// Rays from a receiver to points of a disk.
#[inline(always)]
fn rays(view: &LightView, start: &Start, disk: &[Lanes; 2]) -> Rays {
    let (at, radius) = (start.moved.at, view.lamp.radius);
    let [x, y] = [disk[0] * radius, disk[1] * radius];
    let mut aside = [x, y, Lanes::splat(0.0)];
    if !view.parallel() {
        let (right, up) = glam::Vec3::from_array(at).normalize_or(glam::Vec3::Z).any_orthonormal_pair();
        for k in 0..3 {
            aside[k] = x * right[k] + y * up[k];
        }
    }
    Rays { at, aside }
}

/// Where rays are that have gone so far to the side, the outermost ones, in texels of the receiver's level.
#[inline(always)]
fn point(view: &LightView, start: &Start, rays: &Rays, side: f32) -> Vec3x8 {
    let Rays { at, aside } = rays;
    let risen = view.risen(start, side);
    let mut out = *aside;
    if view.parallel() {
        for k in 0..3 {
            out[k] = aside[k] * risen + at[k];
        }
        out[2] = Lanes::splat(at[2] + risen);
    } else {
        let left = 1.0 - risen;
        for k in 0..3 {
            out[k] = aside[k] * risen + at[k] * left;
        }
    }
    out
}

/// Which rays leave a triangle backwards.
#[inline(always)]
fn below_horizon(view: &LightView, start: &Start, rays: &Rays) -> [bool; LANES] {
    let mut below = [false; LANES];
    for (lane, below) in below.iter_mut().enumerate() {
        let mut cosine = 0.0;
        for k in 0..3 {
            let aside = rays.aside[k].0[lane];
            let way = if !view.parallel() {
                aside - rays.at[k]
            } else if k == 2 {
                1.0
            } else {
                aside
            };
            cosine += start.moved.normal[k] * way;
        }
        *below = cosine <= 0.0 || cosine.is_nan();
    }
    below
}

/// Whether all of a light is above the horizon of a receiver's triangle.
fn above_horizon(view: &LightView, start: &Start) -> bool {
    let (at, normal) = (&start.moved.at, &start.moved.normal);
    let along = if view.parallel() {
        normal[2]
    } else {
        -(normal[0] * at[0] + normal[1] * at[1] + normal[2] * at[2])
    };
    along > view.lamp.radius
}

/// Between 0 and 1, evenly over any few neighbouring pixels, and always the same for a place on the picture.
///
/// Jimenez, "Next Generation Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
fn gradient_noise(x: f32, y: f32) -> f32 {
    let wave = 0.067_110_56 * x + 0.005_837_15 * y;
    (52.982_918 * wave.fract()).fract()
}
