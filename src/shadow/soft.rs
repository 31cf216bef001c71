//! Lights that have a size: rays from a receiver to points of the light, marched through the levels of its map.
//!
//! A ray climbs towards the light and goes to the side, little at first. Its way falls into bands: in each the outermost ray
//! goes as far to the side as in all before, a texel in the first. In a level it goes [`SHADOW_SOFT_TEXELS`] texels to the side
//! at most, then it goes on in the next one, of which texels are twice as large: as the cone of all rays widens, so do the
//! texels that it is compared with. What is wanted of each level are the pages about a receiver.

use std::hash::Hash;

use rustc_hash::{FxHashMap, FxHashSet};

use super::map::{BOUNDED_LEVELS, MapKind, PageKey};
use super::receiver::{LightView, Moved, Receiver, RelativePage, exponent, texel_of};
use crate::limits::{
    SHADOW_BAND_STEPS, SHADOW_LEAN, SHADOW_LEAST_COSINE, SHADOW_NEAREST, SHADOW_PAGE_SIDE, SHADOW_ROUNDING,
    SHADOW_SAMPLES_MAX, SHADOW_SIDE, SHADOW_SOFT_BANDS, SHADOW_SOFT_TEXELS, SHADOW_TEXEL_REACH,
};

/// The angle from one ray to the next about the middle of a light, radians: the golden one, by which no two come to lie side
/// by side (Vogel, "A better way to construct the sunflower head", Mathematical Biosciences 44, 1979).
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Receivers that are told together lie so many texels apart at most.
const TOGETHER: f32 = 64.0;
/// Texels about a receiver that are wanted of coarser levels, besides those that rays go to the side.
const MARGIN: i32 = 4;
/// Texels from one place of a map with a position to the next, of which pages are wanted.
const GRID: i32 = 16;

/// How large a light is, as a view marches towards it.
#[derive(Clone, Debug, Default)]
pub struct Lamp {
    /// [`crate::scene::Light::radius`]; 0 for a sharp one.
    pub radius: f32,
    /// Of a directional light, how high anything reaches along its axis, from the camera, world units.
    pub top: f32,
    /// Points of a disk of radius 1, to which rays go.
    pub points: Vec<[f32; 2]>,
}

impl Lamp {
    /// Of a radius, with so many rays.
    pub fn new(radius: f64, top: f64, samples: u32) -> Self {
        let count = samples.clamp(1, SHADOW_SAMPLES_MAX);
        let point = |k: u32| {
            let (sin, cos) = (f64::from(k) * GOLDEN_ANGLE).sin_cos();
            let away = ((f64::from(k) + 0.5) / f64::from(count)).sqrt();
            [(away * cos) as f32, (away * sin) as f32]
        };
        let points = if radius > 0.0 { (0..count).map(point).collect() } else { Vec::new() };
        Self { radius: radius as f32, top: top as f32, points }
    }
}

/// Where the rays of a receiver begin: along the light's axes.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The receiver, moved.
    pub moved: Moved,
    /// By how much coarser texels raise it, for each world unit that they are larger by.
    raise: f32,
    /// Bands that its rays climb.
    pub bands: u32,
    /// How fast its surface may rise to the side, towards the light: more than its slope.
    lean: f32,
}

/// Receivers that are told together.
#[derive(Clone, Copy, Debug)]
pub struct Bundle {
    /// Of the receivers.
    pub level: i32,
    /// The face that sees them.
    pub face: u8,
    /// Left, bottom, right and top, along the light's axes; of a light with a position, tangents of those of its edge.
    rect: [f32; 4],
    /// The lowest and the highest receiver, as [`LightView::heights`] has them.
    pub heights: [f32; 2],
    /// A texel, as `rect` has it.
    unit: f32,
    /// The smallest and the largest texel, world units.
    texels: [f32; 2],
    /// By how much coarser texels raise rays at most, for each of the receivers' texels.
    raise: f32,
    /// The farthest from the camera.
    distance: f32,
    /// The farthest from the light's place.
    length: f32,
    /// Bands that rays climb, at least and at most.
    pub bands: [u32; 2],
}

impl Bundle {
    /// Takes in others, of the same level and face.
    fn join(&mut self, other: &Self) {
        let least = |a: f32, b: f32| if b < a { b } else { a };
        let most = |a: f32, b: f32| if b > a { b } else { a };
        for k in 0..2 {
            self.rect[k] = least(self.rect[k], other.rect[k]);
            self.rect[k + 2] = most(self.rect[k + 2], other.rect[k + 2]);
        }
        self.heights = [least(self.heights[0], other.heights[0]), most(self.heights[1], other.heights[1])];
        self.texels = [least(self.texels[0], other.texels[0]), most(self.texels[1], other.texels[1])];
        self.raise = most(self.raise, other.raise);
        (self.distance, self.length) = (most(self.distance, other.distance), most(self.length, other.length));
        self.bands = [self.bands[0].min(other.bands[0]), self.bands[1].max(other.bands[1])];
    }
}

/// The part of a ray between two distances to the side, in texels of the receiver's own level, and where in it the map is
/// looked up.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Where it begins.
    pub from: f32,
    /// Where it ends.
    pub to: f32,
}

/// The steps of a ray in a band.
pub fn steps(band: u32) -> impl Iterator<Item = Step> {
    let count = (1 << band).min(SHADOW_BAND_STEPS);
    let [first, last] = span(band);
    let side = (last - first) / count as f32;
    (0..count).map(move |k| Step { from: first + k as f32 * side, to: first + (k + 1) as f32 * side })
}

/// How far to the side the outermost rays are where they come to a band, and where they leave it: texels of their receiver.
pub fn span(band: u32) -> [f32; 2] {
    [texel_of(band as i32), texel_of(band as i32 + 1)]
}

/// By how many levels texels are coarser in a band than those of receivers.
fn coarser(band: u32) -> u32 {
    band.saturating_sub(SHADOW_BAND_STEPS.ilog2())
}

impl LightView {
    /// Whether its shadows are soft.
    pub fn soft(&self) -> bool {
        self.lamp.radius > 0.0
    }

    /// Where the rays of a receiver begin, see [`Self::moved`].
    #[inline(always)]
    pub fn start(&self, receiver: &Receiver) -> Result<Start, bool> {
        let moved = self.moved(receiver)?;
        let cosine = moved.cosine.max(SHADOW_LEAST_COSINE);
        let slope = (1.0 - cosine * cosine).max(0.0).sqrt();
        let raise = (slope * SHADOW_TEXEL_REACH + self.threshold) / cosine;
        let bands = self.bands(&moved);
        let lean = SHADOW_LEAN * (slope / cosine).max(1.0);
        Ok(Start { moved, raise, bands, lean })
    }

    /// How many bands rays climb, until they are above everything, or at the light.
    fn bands(&self, moved: &Moved) -> u32 {
        let radius = self.lamp.radius;
        let (side, most) = if self.parallel() {
            let levels = self.bounded(i32::MAX) - moved.level;
            ((self.lamp.top - moved.at[2]) * radius, levels as u32 + 1 + SHADOW_BAND_STEPS.ilog2())
        } else {
            (radius / SHADOW_NEAREST, SHADOW_SOFT_BANDS)
        };
        // The first band at whose end rays have gone so far to the side.
        let least = 0.5 * side / moved.texel;
        if least > 1.0 {
            (exponent(least) + 2).clamp(1, most.min(SHADOW_SOFT_BANDS) as i32) as u32
        } else {
            1
        }
    }

    /// The level of the map in which rays of receivers in a level are compared in a band.
    pub fn climbed(&self, from: i32, band: u32) -> i32 {
        let level = from + coarser(band) as i32;
        if self.parallel() { level } else { level.min(BOUNDED_LEVELS - 1) }
    }

    /// Where rays are that have gone to the side by so many texels: the part of the way to a light with a position, or how
    /// high they are above their start.
    pub fn risen(&self, start: &Start, side: f32) -> f32 {
        self.way(side * start.moved.texel)
    }

    /// [`Self::risen`], of world units to the side.
    fn way(&self, side: f32) -> f32 {
        let side = side / self.lamp.radius;
        if self.parallel() { side } else { side / (1.0 + side) }
    }

    /// How high a receiver's own surface may be so many texels to the side.
    pub fn ground(&self, start: &Start, side: f32) -> f32 {
        let Start { moved, lean, .. } = start;
        self.along(moved.face, 2, &moved.at) + lean * side * moved.texel
    }

    /// By how much rays are raised in a band, for its coarser texels and for rounding.
    pub fn raised(&self, start: &Start, band: u32) -> f32 {
        let Start { moved, raise, .. } = start;
        let texel = moved.texel * texel_of(coarser(band) as i32);
        let (left, stored) = if self.parallel() {
            (1.0, texel * SHADOW_SIDE as f32 + self.risen(start, span(band)[1]))
        } else {
            // Texels are smaller where the light is nearer.
            (1.0 - self.risen(start, span(band)[0]), moved.length + moved.texel)
        };
        raise * (texel - moved.texel) * left + (moved.distance + stored) * SHADOW_ROUNDING
    }

    /// Receivers as one, if they are in one level of one face and close to each other.
    pub fn bundle(&self, starts: &[Option<Start>]) -> Option<Bundle> {
        let mut starts = starts.iter().flatten();
        let first = starts.next()?;
        let mut bundle = self.single(first);
        for start in starts {
            let Moved { level, face, .. } = start.moved;
            if (level, face) != (first.moved.level, first.moved.face) {
                return None;
            }
            bundle.join(&self.single(start));
        }
        let [x0, y0, x1, y1] = bundle.rect;
        (x1 - x0 <= TOGETHER * bundle.unit && y1 - y0 <= TOGETHER * bundle.unit).then_some(bundle)
    }

    /// One receiver.
    pub fn single(&self, start: &Start) -> Bundle {
        let Start { moved, raise, bands, .. } = start;
        let own = moved.texel * raise.max(0.0);
        let (x, y, height, unit) = if self.parallel() {
            (moved.at[0], moved.at[1], moved.at[2], moved.texel)
        } else {
            let scale = 1.0 / (self.tangent * -self.along(moved.face, 2, &moved.at));
            let [x, y] = [0, 1].map(|k| self.along(moved.face, k, &moved.at) * scale);
            (x, y, self.along(moved.face, 2, &moved.at), 2.0 / (SHADOW_SIDE >> moved.level) as f32)
        };
        Bundle {
            level: moved.level,
            face: moved.face,
            rect: [x, y, x, y],
            heights: [height; 2],
            unit,
            texels: [moved.texel; 2],
            raise: own,
            distance: moved.distance,
            length: moved.length,
            bands: [*bands; 2],
        }
    }

    /// Between which heights rays are in a band: above the camera along the light's axis or, from a light with a position,
    /// less the depth in the face that sees the receivers.
    pub fn heights(&self, bundle: &Bundle, band: u32) -> [f32; 2] {
        let [first, last] = span(band);
        let Bundle { heights: [low, high], texels: [least, most], raise, distance, length, .. } = *bundle;
        let (first, last) = (self.way(first * least), self.way(last * most));
        let texel = texel_of(coarser(band) as i32);
        let raised = raise * texel;
        if self.parallel() {
            let stored = most * texel * SHADOW_SIDE as f32 + last;
            return [low + first, high + last + raised + (distance + stored) * SHADOW_ROUNDING];
        }
        let radius = self.lamp.radius;
        let rounding = (distance + length + most) * SHADOW_ROUNDING;
        [low * (1.0 - first) - first * radius, high * (1.0 - last) + last * radius + raised + rounding]
    }

    /// How high rays of receivers to a light with a position are at least in a band, in whichever face.
    pub fn lowest(&self, bundle: &Bundle, band: u32) -> f32 {
        let way = self.way(span(band)[0] * bundle.texels[0]);
        (way - 1.0) * bundle.length - way * self.lamp.radius
    }

    /// The faces of the map.
    pub fn faces(&self) -> u8 {
        if self.kind == MapKind::Cube { 6 } else { 1 }
    }

    /// The rectangle of texels of a level in which rays are in a band: left, top, right and bottom.
    pub fn beneath(&self, bundle: &Bundle, band: u32, level: i32) -> [f32; 4] {
        // In the coarsest level rays may go farther.
        let reach = texel_of(band as i32 + 1 + bundle.level - level) + 1.0;
        let [x0, y0, x1, y1] = bundle.rect;
        if let Some(anchor) = self.anchor(level) {
            let inverse = texel_of(-level);
            let [x0, x1] = [x0, x1].map(|x| x * inverse + anchor[0]);
            let [y0, y1] = [y1, y0].map(|y| anchor[1] - y * inverse);
            return [x0 - reach, y0 - reach, x1 + reach, y1 + reach];
        }
        let half = 0.5 * (SHADOW_SIDE >> level) as f32;
        [
            half * (1.0 + x0) - reach,
            half * (1.0 - y1) - reach,
            half * (1.0 + x1) + reach,
            half * (1.0 - y0) + reach,
        ]
    }

    /// The slab whose pages rays from a height are compared with in a level of a parallel map: the one that they leave it in.
    /// 0 of other maps, which have none.
    pub fn slab(&self, level: i32, height: f32) -> i32 {
        let Some([_, _, offset]) = self.anchor(level) else { return 0 };
        let texel = texel_of(level);
        let risen = height + SHADOW_SOFT_TEXELS as f32 * texel / self.lamp.radius;
        let at = risen.min(self.lamp.top.max(height)) / texel + offset;
        (at / SHADOW_SIDE as f32).floor() as i32
    }

    /// The pages that are wanted where receivers are in columns of pages, between heights.
    pub fn pages(&self, columns: FxHashMap<RelativePage, [f32; 2]>) -> Vec<PageKey> {
        match (self.kind, self.soft()) {
            (MapKind::Parallel, false) => {
                let slabs = |(page, heights): (&RelativePage, &[f32; 2])| {
                    let level = i32::from(page.level);
                    let offset = self.anchor(level).map_or(0.0, |anchor| anchor[2]);
                    let [low, high] =
                        heights.map(|z| ((z / texel_of(level) + offset) / SHADOW_SIDE as f32).floor() as i32);
                    let page = *page;
                    (low..=high).map(move |z| self.key(&RelativePage { z, ..page }))
                };
                columns.iter().flat_map(slabs).collect()
            }
            (_, false) => columns.keys().map(|page| self.key(page)).collect(),
            (MapKind::Parallel, true) => self.pages_above(columns),
            (_, true) => self.pages_around(columns),
        }
    }

    /// Of a parallel map, the pages of all levels that rays climb.
    fn pages_above(&self, columns: FxHashMap<RelativePage, [f32; 2]>) -> Vec<PageKey> {
        let mut wanted = Vec::new();
        let mut receivers: FxHashMap<PageKey, [f32; 2]> = FxHashMap::default();
        // Of each level, in its turn, columns that were marked, and those that hold receivers of finer levels.
        let mut marked: FxHashMap<i16, Vec<(PageKey, [f32; 2])>> = FxHashMap::default();
        for (page, heights) in &columns {
            marked.entry(page.level).or_default().push((self.key(page), *heights));
        }
        let Some(mut level) = marked.keys().copied().min() else { return wanted };
        loop {
            let mut pages: FxHashMap<PageKey, [f32; 2]> = FxHashMap::default();
            for (key, heights) in &receivers {
                for [x, y] in about(key) {
                    let parent = PageKey { x, y, level, ..*key };
                    join(&mut pages, parent, *heights);
                }
            }
            let mut here: FxHashMap<PageKey, [f32; 2]> = FxHashMap::default();
            for (key, heights) in &receivers {
                let parent = PageKey { x: key.x.div_euclid(2), y: key.y.div_euclid(2), level, ..*key };
                join(&mut here, parent, *heights);
            }
            for (key, heights) in marked.remove(&level).into_iter().flatten() {
                join(&mut pages, key, heights);
                join(&mut here, key, heights);
            }
            let base = self.key(&RelativePage { face: 0, level, x: 0, y: 0, z: 0 }).z;
            for (key, heights) in pages {
                let [low, high] = heights.map(|height| i64::from(self.slab(level.into(), height)));
                wanted.extend((low..=high).map(|z| PageKey { z: base + z, ..key }));
            }
            let climb = SHADOW_SOFT_TEXELS as f32 * texel_of(level.into()) / self.lamp.radius;
            let last = self.bounded(i32::from(level) + 1) == i32::from(level);
            here.retain(|_, heights| !last && heights[0] + climb < self.lamp.top);
            receivers = here;
            if receivers.is_empty() && marked.is_empty() {
                return wanted;
            }
            level += 1;
        }
    }

    /// Of a light with a position, the pages of all levels that rays climb.
    fn pages_around(&self, columns: FxHashMap<RelativePage, [f32; 2]>) -> Vec<PageKey> {
        let mut wanted: FxHashSet<RelativePage> = columns.keys().copied().collect();
        let mut receivers: Vec<RelativePage> = columns.into_keys().collect();
        let mut known: FxHashSet<RelativePage> = wanted.clone();
        while let Some(page) = receivers.pop() {
            let level = page.level + 1;
            if i32::from(level) == BOUNDED_LEVELS {
                continue;
            }
            let half = SHADOW_PAGE_SIDE as i32 / 2;
            let side = half + 2 * (SHADOW_SOFT_TEXELS as i32 + MARGIN);
            let from = [page.x, page.y].map(|at| at * half - SHADOW_SOFT_TEXELS as i32 - MARGIN);
            let grid = || (0..=side / GRID).map(|k| (k * GRID).min(side)).chain([side]);
            for (x, y) in grid().flat_map(|y| grid().map(move |x| (x, y))) {
                if let Some(page) = self.page_at(page.face, level, [from[0] + x, from[1] + y]) {
                    wanted.insert(page);
                }
            }
            let parent = RelativePage { level, x: page.x / 2, y: page.y / 2, ..page };
            if known.insert(parent) {
                receivers.push(parent);
            }
        }
        // Where rays go farther to the side than the coarsest level has texels for.
        let level = BOUNDED_LEVELS as i16 - 1;
        let coarsest = (0..self.faces()).map(|face| RelativePage { face, level, x: 0, y: 0, z: 0 });
        let some = !wanted.is_empty();
        let pages = wanted.into_iter().chain(coarsest.filter(|_| some));
        pages.map(|page| self.key(&page)).collect()
    }

    /// The page at so many texels right and down in a face, which may lie on another face of a cube.
    fn page_at(&self, face: u8, level: i16, at: [i32; 2]) -> Option<RelativePage> {
        let texels = (SHADOW_SIDE >> level) as i32;
        let side = SHADOW_PAGE_SIDE as i32;
        if at.iter().all(|v| (0..texels).contains(v)) {
            return Some(RelativePage { face, level, x: at[0] / side, y: at[1] / side, z: 0 });
        }
        let half = 0.5 * texels as f32;
        let [right, up] = [(at[0] as f32 + 0.5 - half) / half, (half - at[1] as f32 - 0.5) / half];
        // As far away as its own level's depths may be.
        self.page_towards(face, [right, up], level.into())
    }
}

/// The pages of the next level that are wanted for a page of receivers: those within reach of its quarter of its parent.
fn about(key: &PageKey) -> impl Iterator<Item = [i64; 2]> {
    let side = i64::from(SHADOW_PAGE_SIDE);
    let reach = i64::from(SHADOW_SOFT_TEXELS) + i64::from(MARGIN);
    let range = move |at: i64| {
        let first = at * side / 2;
        (first - reach).div_euclid(side)..=(first + side / 2 - 1 + reach).div_euclid(side)
    };
    let (columns, rows) = (range(key.x), range(key.y));
    rows.flat_map(move |y| columns.clone().map(move |x| [x, y]))
}

/// Widens what is known of the heights in a page or a column of them.
pub fn join<K: Eq + Hash>(known: &mut FxHashMap<K, [f32; 2]>, key: K, [low, high]: [f32; 2]) {
    let heights = known.entry(key).or_insert([low, high]);
    *heights = [heights[0].min(low), heights[1].max(high)];
}
