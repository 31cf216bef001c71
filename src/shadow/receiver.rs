//! From a point that a camera sees to the texel that says whether a light sees it.
//!
//! The point is moved along the normal of its triangle by what the camera's cut and the light's may be off together, and by
//! what the slope makes of a texel, so that a surface does not shade itself: docs/shadows.md. What is left is rounding, which
//! is taken off the depth.

use super::cascades::Cascades;
use super::map::{BOUNDED_LEVELS, CUBE_FACES, MapKind, PageKey, ShadowMap};
use super::soft::Lamp;
use crate::limits::{
    SHADOW_BOUNDED_LEVELS, SHADOW_COLUMN_BITS, SHADOW_LEAST_COSINE, SHADOW_LEVELS, SHADOW_LEVELS_APART,
    SHADOW_MARGIN, SHADOW_MOST_ACROSS, SHADOW_PAGE_SIDE, SHADOW_PAGE_TEXELS, SHADOW_ROUNDING, SHADOW_SIDE,
    SHADOW_SNAP, SHADOW_SOFT_TEXELS, SHADOW_TEXEL_REACH,
};
use crate::scene::View;

/// By how many halvings a texel may be smaller than the scene.
const FINEST: i32 = 48;

/// A point that a camera sees: camera space, world units.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Where it is.
    pub position: [f32; 3],
    /// Unit normal of its triangle, towards the eye.
    pub normal: [f32; 3],
    /// Unit normal that is interpolated, on the same side where both agree.
    pub smooth: [f32; 3],
    /// By how much it may be off the source: the error of what is drawn, and rounding.
    pub error: f32,
}

/// What a receiver looks up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lookup {
    /// Nothing: it faces away, and is dark.
    Dark,
    /// Nothing: there is no map there.
    Lit,
    /// A texel, which shades it where its key is above this one.
    Texel {
        /// The page, counted from [`LightView`]'s anchor of its level.
        page: RelativePage,
        /// The texel in it.
        texel: u32,
        /// Its own key.
        key: u32,
    },
}

/// Where a point lies in a map.
pub struct Place {
    /// The page.
    pub page: RelativePage,
    /// The texel in it.
    pub texel: u32,
    /// Along the map's axis, from the slab's top or from the light.
    pub depth: f32,
}

/// A receiver that was moved, along the light's axes.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// Where it is now, from the light's place, or from the camera where it has none.
    pub at: [f32; 3],
    /// Unit normal of its triangle.
    pub normal: [f32; 3],
    /// Of the angle between the way to the light and the normal along which it was moved; 0 where the triangle faces away.
    pub cosine: f32,
    /// The face that sees it.
    pub face: u8,
    /// The level that it is looked up in.
    pub level: i32,
    /// A texel there, world units.
    pub texel: f32,
    /// From the camera.
    pub distance: f32,
    /// From the light's place.
    pub length: f32,
}

/// A page of a light's map, relative to where the camera is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RelativePage {
    /// Of a cube.
    pub face: u8,
    /// As [`PageKey::level`].
    pub level: i16,
    /// Pages right of the anchor.
    pub x: i32,
    /// Pages down.
    pub y: i32,
    /// Slabs up.
    pub z: i32,
}

/// A level of a parallel map near a camera.
#[derive(Clone, Copy, Debug, Default)]
struct Anchor {
    /// The page and the slab of the camera.
    page: [i64; 3],
    /// Where in them it is, texels right, down and up.
    offset: [f32; 3],
}

/// A light's map as a camera's frame looks it up.
#[derive(Clone, Debug)]
pub struct LightView {
    /// Slot of the light.
    pub light: u32,
    /// How it is projected.
    pub kind: MapKind,
    /// The light's axes in camera space.
    pub axes: [[f32; 3]; 3],
    /// Of one with a position: the camera seen from there, along the axes; else zero.
    pub eye: [f32; 3],
    /// Of a parallel one, by level from [`LightView::first`] on.
    anchors: Vec<Anchor>,
    /// The finest level of a parallel one.
    pub first: i32,
    /// Tangent of half the angle of a pinhole.
    pub tangent: f32,
    /// Near distance of a pinhole.
    pub near: f32,
    /// The square of the distance at which a light ends, rounded up.
    pub reach_squared: f32,
    /// Pixels per unit of tangent or, from a parallel camera, of length.
    pub focal: f32,
    /// The camera is parallel.
    pub orthographic: bool,
    tau: i16,
    /// The light's threshold, texels.
    pub threshold: f32,
    /// Levels by which all texels are larger than a pixel, for want of room.
    pub coarser: i32,
    /// How large the light is.
    pub lamp: Lamp,
    /// Of a parallel map, the levels that are looked up, by distance; else they are chosen by the size of a pixel.
    pub cascades: Option<Cascades>,
}

/// Two to a level: a texel of a parallel map there.
#[inline(always)]
pub fn texel_of(level: i32) -> f32 {
    f32::from_bits(((level + 127) as u32) << 23)
}

/// The binary logarithm of a positive number, rounded down.
pub(super) fn exponent(v: f32) -> i32 {
    (v.to_bits() >> 23) as i32 - 127
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl LightView {
    /// Of a light's map and a view whose cut has errors of up to `pixel_error`, in a scene of some size across.
    pub fn new(
        light: u32,
        map: &ShadowMap,
        view: &View,
        pixel_error: f32,
        scene_size: f64,
        lamp: Lamp,
    ) -> Self {
        let turn = map.axes.transpose() * view.pose.matrix3;
        let row = |k: usize| turn.row(k).as_vec3().to_array();
        let eye = map.axes.transpose() * (view.eye() - map.origin);
        let first =
            (scene_size.max(f64::from(f32::MIN_POSITIVE)).log2().ceil() as i32 - FINEST).clamp(-120, 60);
        let anchor = |level: i32| {
            let texel = ShadowMap::texel(level as i16);
            let page = f64::from(SHADOW_PAGE_SIDE);
            let slab = f64::from(SHADOW_SIDE);
            let at = [eye.x / texel, -eye.y / texel, eye.z / texel];
            let sides = [page, page, slab];
            let index: [f64; 3] = std::array::from_fn(|k| (at[k] / sides[k]).floor());
            Anchor {
                page: index.map(|v| v as i64),
                offset: std::array::from_fn(|k| (at[k] - index[k] * sides[k]) as f32),
            }
        };
        let anchors = if map.parallel() {
            (first..first + SHADOW_LEVELS as i32).map(anchor).collect()
        } else {
            Vec::new()
        };
        Self {
            light,
            kind: map.kind,
            axes: [row(0), row(1), row(2)],
            eye: if map.parallel() { [0.0; 3] } else { eye.as_vec3().to_array() },
            anchors,
            first,
            tangent: map.tangent as f32,
            near: map.near as f32,
            reach_squared: (map.range * map.range * (1.0 + 1e-3)) as f32,
            focal: view.lod_constants().0,
            orthographic: view.orthographic,
            tau: PageKey::tau_of(pixel_error),
            threshold: PageKey::threshold(PageKey::tau_of(pixel_error)),
            coarser: 0,
            lamp,
            cascades: None,
        }
    }

    /// Whether it has no end.
    #[inline(always)]
    pub fn parallel(&self) -> bool {
        self.kind == MapKind::Parallel
    }

    /// The same with all texels larger by so many levels.
    pub fn made_coarser(&self, levels: i32) -> Self {
        Self { coarser: levels, ..self.clone() }
    }

    /// The page of the map that this says.
    pub fn key(&self, page: &RelativePage) -> PageKey {
        let RelativePage { face, level, x, y, z } = *page;
        let base = match self.kind {
            MapKind::Parallel => self.anchors[(i32::from(level) - self.first) as usize].page,
            _ => [0; 3],
        };
        let [x, y, z] = [base[0] + i64::from(x), base[1] + i64::from(y), base[2] + i64::from(z)];
        PageKey { light: self.light, face, level, tau: self.tau, x, y, z }
    }

    /// The column of pages that a device wrote as one number: `column_bits` of `shaders/shadow_mark.wgsl`.
    pub fn column(&self, bits: u32) -> RelativePage {
        let mask = (1 << SHADOW_COLUMN_BITS) - 1;
        let (level, y, x) =
            (bits >> (2 * SHADOW_COLUMN_BITS), bits >> SHADOW_COLUMN_BITS & mask, bits & mask);
        if self.parallel() {
            let [x, y] = [x, y].map(|at| at as i32 - (1 << (SHADOW_COLUMN_BITS - 1)));
            return RelativePage { face: 0, level: (self.first + level as i32) as i16, x, y, z: 0 };
        }
        let (face, level) = (level / SHADOW_BOUNDED_LEVELS, level % SHADOW_BOUNDED_LEVELS);
        RelativePage { face: face as u8, level: level as i16, x: x as i32, y: y as i32, z: 0 }
    }

    /// The same page relative to the camera, if it is of this map and these levels.
    pub fn relative(&self, key: &PageKey) -> Option<RelativePage> {
        let PageKey { light, face, level, tau, x, y, z } = *key;
        if (light, tau) != (self.light, self.tau) {
            return None;
        }
        let base = match self.kind {
            MapKind::Parallel => self.anchors.get(usize::try_from(i32::from(level) - self.first).ok()?)?.page,
            _ => [0; 3],
        };
        let relative = |at: i64, base: i64| i32::try_from(at - base).ok();
        let [x, y, z] = [relative(x, base[0])?, relative(y, base[1])?, relative(z, base[2])?];
        Some(RelativePage { face, level, x, y, z })
    }

    /// How far a point is from the camera, and the size of a pixel there, world units.
    #[inline(always)]
    pub fn pixel(&self, position: &[f32; 3]) -> (f32, f32) {
        let distance = dot(position, position).sqrt();
        (distance, self.pixel_at(distance))
    }

    /// The size of a pixel at a distance from the camera, world units.
    #[inline(always)]
    pub fn pixel_at(&self, distance: f32) -> f32 {
        if self.orthographic { 1.0 / self.focal } else { distance / self.focal }
    }

    /// A point along the light's axes: from the light's place, or from the camera where it has none.
    #[inline(always)]
    pub fn along_axes(&self, position: &[f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| dot(&self.axes[k], position) + self.eye[k])
    }

    /// The level whose texels are as large as a pixel at a point, or up to half as large, or that of its cascade; and a texel
    /// there, world units. `None` where a pinhole sees nothing, and where its light does not reach.
    #[inline(always)]
    fn level(&self, at: &[f32; 3], distance: f32, pixel: f32) -> Option<(i32, f32)> {
        if self.parallel() {
            let level = self.level_of(distance, pixel);
            return Some((level, texel_of(level)));
        }
        let depth = -self.along(self.face(at), 2, at);
        let finest = depth * (2.0 * self.tangent / SHADOW_SIDE as f32);
        if !(depth > 0.0 && finest > 0.0 && dot(at, at) <= self.reach_squared) {
            return None;
        }
        let level = self.coarse(exponent(pixel / finest)).clamp(0, BOUNDED_LEVELS - 1);
        Some((level, finest * texel_of(level)))
    }

    /// Of a parallel map, where the camera is in a level: texels right, down and up from its anchor.
    #[inline(always)]
    pub fn anchor(&self, level: i32) -> Option<[f32; 3]> {
        (self.parallel()).then(|| self.anchors[(level - self.first) as usize].offset)
    }

    /// Of a parallel map, [`Self::anchor`] of each level from [`Self::first`] on.
    pub fn offsets(&self) -> impl Iterator<Item = [f32; 3]> {
        self.anchors.iter().map(|anchor| anchor.offset)
    }

    /// Of a parallel map, the level in which a point at a distance from the camera is looked up, where a pixel is so large.
    #[inline(always)]
    pub fn level_of(&self, distance: f32, pixel: f32) -> i32 {
        match &self.cascades {
            None => self.bounded(self.coarse(exponent(pixel))),
            Some(cascades) => self.cascade_level(cascades, cascades.splits.number(distance)),
        }
    }

    /// The level of a cascade.
    #[inline(always)]
    pub fn cascade_level(&self, cascades: &Cascades, number: usize) -> i32 {
        self.bounded(self.coarse(cascades.levels[number]))
    }

    /// The level of a parallel map whose texels are as large as a pixel, or up to half as large.
    pub(super) fn own_level(&self, pixel: f32) -> i32 {
        self.bounded(exponent(pixel))
    }

    /// The level that stands for one. For want of room not only larger texels are taken, but fewer levels too: each takes a
    /// page at least.
    #[inline(always)]
    fn coarse(&self, level: i32) -> i32 {
        if self.coarser == 0 {
            return level;
        }
        let apart = 1 + self.coarser / SHADOW_LEVELS_APART as i32;
        -(-(level + self.coarser)).div_euclid(apart) * apart
    }

    /// The level of a parallel map that is nearest to this one.
    #[inline(always)]
    pub(super) fn bounded(&self, level: i32) -> i32 {
        level.clamp(self.first, self.first + SHADOW_LEVELS as i32 - 1)
    }

    /// Where a point lies in a level. `None` outside of a spot.
    #[inline(always)]
    pub fn place(&self, at: &[f32; 3], level: i32) -> Option<Place> {
        let side = SHADOW_PAGE_SIDE as f32;
        if self.parallel() {
            let texel = texel_of(level);
            let Anchor { offset, .. } = &self.anchors[(level - self.first) as usize];
            let (x, y, z) = (at[0] / texel + offset[0], offset[1] - at[1] / texel, at[2] / texel + offset[2]);
            let (column, row, slab) =
                ((x / side).floor(), (y / side).floor(), (z / SHADOW_SIDE as f32).floor());
            let page = RelativePage {
                face: 0,
                level: level as i16,
                x: column as i32,
                y: row as i32,
                z: slab as i32,
            };
            let depth = ((slab + 1.0) * SHADOW_SIDE as f32 - z) * texel;
            return Some(Place { page, texel: texel_in(x - column * side, y - row * side), depth });
        }
        let face = self.face(at);
        let depth = -self.along(face, 2, at);
        let texels = (SHADOW_SIDE >> level) as f32;
        let scale = 0.5 * texels / (self.tangent * depth);
        let x = 0.5 * texels + self.along(face, 0, at) * scale;
        let y = 0.5 * texels - self.along(face, 1, at) * scale;
        // The picture of a spot ends with its cone, those of a cube at each other, but for rounding.
        let cube = self.kind == MapKind::Cube;
        if !(depth > self.near && (cube || (x >= 0.0 && x < texels && y >= 0.0 && y < texels))) {
            return None;
        }
        let (x, y) = (x.max(0.0).min(texels.next_down()), y.max(0.0).min(texels.next_down()));
        let (column, row) = ((x / side).floor(), (y / side).floor());
        let page = RelativePage { face, level: level as i16, x: column as i32, y: row as i32, z: 0 };
        Some(Place { page, texel: texel_in(x - column * side, y - row * side), depth })
    }

    /// How far a receiver that is off the source by `own` is moved at most, in a level of such texels.
    #[inline(always)]
    pub fn reach(&self, own: f32, texel: f32) -> f32 {
        // A little more, for the rounding of what is done with it.
        SHADOW_MARGIN * (own + texel * (self.threshold + SHADOW_TEXEL_REACH))
    }

    /// Rounding of a receiver's place at a distance, where a pixel is so large.
    #[inline(always)]
    pub fn rounding(distance: f32, pixel: f32) -> f32 {
        distance * SHADOW_ROUNDING + SHADOW_SNAP * pixel
    }

    /// The columns of pages that a receiver at a point may look up, if it is off the source by up to `error`, each at least
    /// once, and between which heights it may be along the light's axis.
    #[inline(always)]
    pub fn mark(&self, position: &[f32; 3], error: f32, mut want: impl FnMut(RelativePage, [f32; 2])) {
        let (distance, pixel) = self.pixel(position);
        let at = self.along_axes(position);
        let Some((level, texel)) = self.level(&at, distance, pixel) else { return };
        let reach = self.reach(error + Self::rounding(distance, pixel), texel);
        let (wide, heights) = (reach + self.beside() * texel, [at[2] - reach, at[2] + self.above(reach)]);
        // No page lies between two points of a grid that are less than a page apart.
        let side = SHADOW_PAGE_SIDE as f32 * texel;
        let count = (2.0 * wide / side).min(SHADOW_MOST_ACROSS).ceil() as i32 + 1;
        let along = |k: i32| wide * (2.0 * k as f32 / count as f32 - 1.0);
        let depths = if self.parallel() { 0..=0 } else { 0..=count };
        for (x, y) in (0..=count).flat_map(|y| (0..=count).map(move |x| (x, y))) {
            for z in depths.clone() {
                if let Some(place) =
                    self.place(&[at[0] + along(x), at[1] + along(y), at[2] + along(z)], level)
                {
                    want(RelativePage { z: 0, ..place.page }, heights);
                }
            }
        }
    }

    /// How far up a receiver is moved at most, if it is moved no farther than this along its normal.
    #[inline(always)]
    pub fn above(&self, reach: f32) -> f32 {
        if self.soft() { reach / SHADOW_LEAST_COSINE } else { reach }
    }

    /// Texels to the side that rays to the light go in the level of their receiver.
    #[inline(always)]
    pub fn beside(&self) -> f32 {
        if self.soft() { SHADOW_SOFT_TEXELS as f32 } else { 0.0 }
    }

    /// Moves a receiver along its normal, so that the surface that it is on does not shade it. Else whether it is lit: where
    /// there is no map it is, where it faces away it is not.
    #[inline(always)]
    pub fn moved(&self, receiver: &Receiver) -> Result<Moved, bool> {
        let Receiver { position, normal, smooth, error } = receiver;
        let (distance, pixel) = self.pixel(position);
        let at = self.along_axes(position);
        let length = dot(&at, &at).sqrt();
        let parallel = self.parallel();
        let towards = if parallel { [0.0, 0.0, 1.0] } else { at.map(|v| -v / length) };
        // Of a light with a size the least part is enough.
        let size = if parallel { self.lamp.radius } else { self.lamp.radius / length };
        let normals = [normal, smooth].map(|n| std::array::from_fn(|k| dot(&self.axes[k], n)));
        let (normal, facing) = facing(&normals, &towards, size).ok_or(false)?;
        let (level, texel) = self.level(&at, distance, pixel).ok_or(true)?;
        let face = self.face(&at);
        let slope = if facing { slope(self.along(face, 2, &normal)) } else { 1.0 };
        let own = error + Self::rounding(distance, pixel);
        let by = own + (slope * SHADOW_TEXEL_REACH + self.threshold) * texel;
        let cosine = if facing { dot(&normal, &towards) } else { 0.0 };
        // To the middle of a light with a size, so that its shadows stay where they are: as far as along the normal.
        let (by, normal) =
            if self.soft() && cosine >= SHADOW_LEAST_COSINE { (by / cosine, towards) } else { (by, normal) };
        let at = std::array::from_fn(|k| at[k] + by * normal[k]);
        Ok(Moved { at, normal: normals[0], cosine, face, level, texel, distance, length })
    }

    /// What a receiver looks up.
    #[inline(always)]
    pub fn look_up(&self, receiver: &Receiver) -> Lookup {
        let Moved { at, level, texel, distance, length, .. } = match self.moved(receiver) {
            Ok(moved) => moved,
            Err(lit) => return if lit { Lookup::Lit } else { Lookup::Dark },
        };
        // Of a cube it may be on another face now.
        let Some(Place { page, texel: number, depth }) = self.place(&at, level) else {
            return Lookup::Lit;
        };
        let rounding = distance * SHADOW_ROUNDING;
        let key = if self.parallel() {
            // Depths of up to so many texels were rounded in the page.
            let depth = depth - (rounding + texel * (SHADOW_SIDE as f32 * SHADOW_ROUNDING));
            !depth.max(0.0).to_bits()
        } else {
            (self.near / (depth - (rounding + (length + texel) * SHADOW_ROUNDING))).to_bits()
        };
        Lookup::Texel { page, texel: number, key }
    }

    /// The page of a level in which something lies that is right and up of the middle of a face by tangents, of those of its
    /// edge; on another face of a cube, too.
    pub(super) fn page_towards(&self, face: u8, [right, up]: [f32; 2], level: i32) -> Option<RelativePage> {
        if self.kind != MapKind::Cube {
            return None;
        }
        let mut at = [0.0; 3];
        for ((axis, sign), along) in CUBE_FACES[usize::from(face)].into_iter().zip([right, up, -1.0]) {
            at[axis] = sign * along * 2.0 * self.near;
        }
        self.place(&at, level).map(|place| place.page)
    }

    /// The face that sees a point, which is given along the light's axes.
    pub fn face(&self, at: &[f32; 3]) -> u8 {
        if self.kind == MapKind::Cube { face_of(at) } else { 0 }
    }

    /// How far something, along the light's axes, lies to the right, up, or against the sight of a face.
    pub fn along(&self, face: u8, k: usize, v: &[f32; 3]) -> f32 {
        if self.kind != MapKind::Cube {
            return v[k];
        }
        let (axis, sign) = CUBE_FACES[usize::from(face)][k];
        sign * v[axis]
    }
}

/// The normal along which a receiver is moved, of that of its triangle and the interpolated one, and whether it is the
/// triangle's; `None` where it faces away from all of a light of a size, the tangent that it is seen at.
///
/// A cut's triangle may be turned where the source is not: where the two normals disagree, the map decides.
#[inline(always)]
fn facing([normal, smooth]: &[[f32; 3]; 2], towards: &[f32; 3], size: f32) -> Option<([f32; 3], bool)> {
    if dot(normal, towards) > 0.0 {
        return Some((*normal, true));
    }
    (dot(smooth, towards) > -size || dot(normal, towards) > -size).then_some((*smooth, false))
}

/// How fast a surface falls off along a map: the sine of the angle between its normal and the map's axis, of the cosine.
fn slope(cosine: f32) -> f32 {
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

/// The texel of a page at so many texels right and down.
#[inline(always)]
fn texel_in(x: f32, y: f32) -> u32 {
    let last = SHADOW_PAGE_SIDE - 1;
    let texel = (y as u32).min(last) * SHADOW_PAGE_SIDE + (x as u32).min(last);
    debug_assert!((texel as usize) < SHADOW_PAGE_TEXELS);
    texel
}

/// The face of a cube through which a point is seen from its middle.
fn face_of(at: &[f32; 3]) -> u8 {
    let size = at.map(f32::abs);
    let axis = if size[0] >= size[1] && size[0] >= size[2] {
        0
    } else if size[1] >= size[2] {
        1
    } else {
        2
    };
    2 * axis as u8 + u8::from(at[axis] < 0.0)
}
