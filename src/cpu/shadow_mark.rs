//! Visibility buffer → the pages of shadow maps that its pixels may look up. Normals are not needed: a receiver is moved by no
//! more than a margin before it looks one up.

use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use super::lanes::{LANES, Lanes, Vec3x8, along, dot};
use super::output::ROWS;
use super::surface::{Pixels, position, receiver_error};
use crate::limits::{SHADOW_MARGIN, SHADOW_PAGE_SIDE, SHADOW_ROUNDING, SHADOW_SNAP, SHADOW_TEXEL_REACH};
use crate::scene::placement::Eye;
use crate::shadow::receiver::{RelativePage, texel_of};
use crate::shadow::soft::join;
use crate::shadow::{Cascades, LightView, PageKey};
use crate::views::{Screen, Visible, decode};

/// The pages that pixels of a frame may want, each at least once, in any order.
pub fn run(marker: &Marker<'_>, lights: &[LightView]) -> FxHashSet<PageKey> {
    let words = marker.words;
    let stretch = (ROWS * marker.columns()).max(1);
    let starts: Vec<usize> = (0..words.len()).step_by(stretch).collect();
    let parts: Vec<Vec<Columns>> = starts
        .par_iter()
        .map(|&start| marker.mark(lights, start, words.len().min(start + stretch)))
        .collect();
    let mut all: Vec<FxHashMap<RelativePage, [f32; 2]>> = vec![FxHashMap::default(); lights.len()];
    for part in parts {
        for (all, found) in all.iter_mut().zip(part) {
            found.pages.into_iter().for_each(|(page, heights)| join(all, page, heights));
        }
    }
    lights.iter().zip(all).flat_map(|(light, columns)| light.pages(columns)).collect()
}

/// Columns of pages of a light that receivers are in, whatever their heights, and between which heights these are.
#[derive(Default)]
struct Columns {
    pages: FxHashMap<RelativePage, [f32; 2]>,
    /// The one that was found last, not in the table yet.
    last: Option<(RelativePage, [f32; 2])>,
}

impl Columns {
    #[inline(always)]
    fn note(&mut self, page: RelativePage, heights: [f32; 2]) {
        match &mut self.last {
            Some((known, [low, high])) if *known == page => {
                (*low, *high) = (low.min(heights[0]), high.max(heights[1]));
            }
            last => {
                if let Some((page, heights)) = last.replace((page, heights)) {
                    join(&mut self.pages, page, heights);
                }
            }
        }
    }

    fn closed(mut self) -> Self {
        if let Some((page, heights)) = self.last.take() {
            join(&mut self.pages, page, heights);
        }
        self
    }
}

/// Pages side by side that are marked for eight receivers together.
const FEW_PAGES: i32 = 3;

/// A frame's pixels as receivers of light.
pub struct Marker<'a> {
    words: &'a [u64],
    screen: &'a Screen,
    eye: &'a Eye,
    /// By how much what is drawn may be off the source, by visible cluster, world units.
    errors: Vec<f32>,
}

/// Receivers side by side.
pub(super) struct Eight {
    /// Which of them there are.
    pub(super) covered: [bool; LANES],
    /// Where, in camera space.
    pub(super) at: Vec3x8,
    /// By how much they may be off the source, world units.
    pub(super) error: Lanes,
}

impl<'a> Marker<'a> {
    /// Of a frame.
    pub fn new(pixels: Pixels<'a>, eye: &'a Eye) -> Self {
        let Pixels { words, visible, views, screen } = pixels;
        let of = |v: &Visible| receiver_error(&views[v.instance as usize], v.cluster);
        Self { words, screen, eye, errors: visible.par_iter().map(of).collect() }
    }

    /// Pixels of a row.
    pub(super) fn columns(&self) -> usize {
        self.screen.width as usize
    }

    /// Rows of pixels.
    pub(super) fn rows(&self) -> usize {
        self.screen.height as usize
    }

    /// Eight pixels of a row from a column on; `None` where they show nothing.
    #[inline(always)]
    pub(super) fn eight(&self, row: usize, column: usize) -> Option<Eight> {
        let columns = self.columns();
        let words = &self.words[row * columns..][column..columns.min(column + LANES)];
        let (mut covered, mut error) = ([false; LANES], Lanes::splat(0.0));
        let (mut distance, mut point) = (Lanes::splat(1.0), Lanes::splat(column as f32 + 0.5));
        for (lane, word) in words.iter().enumerate().filter(|(_, word)| **word != 0) {
            covered[lane] = true;
            point.0[lane] += lane as f32;
            (distance.0[lane], error.0[lane]) = self.receiver(*word);
        }
        let point = [point, Lanes::splat(row as f32 + 0.5)];
        let at = || position(self.eye, self.screen.orthographic, &point, distance);
        covered.contains(&true).then(|| Eight { covered, at: at(), error })
    }

    fn mark(&self, lights: &[LightView], start: usize, end: usize) -> Vec<Columns> {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            // SAFETY: the processor has AVX2 and BMI2.
            return unsafe { self.mark_avx2(lights, start, end) };
        }
        self.mark_anywhere(lights, start, end)
    }

    /// The same with 256-bit vectors. No operation fuses, so the result is the same.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn mark_avx2(&self, lights: &[LightView], start: usize, end: usize) -> Vec<Columns> {
        self.mark_anywhere(lights, start, end)
    }

    #[inline(always)]
    fn mark_anywhere(&self, lights: &[LightView], start: usize, end: usize) -> Vec<Columns> {
        let mut found: Vec<Columns> = lights.iter().map(|_| Columns::default()).collect();
        let width = self.screen.width as usize;
        let places = (start..end)
            .step_by(width)
            .flat_map(|row| (row..row + width).step_by(LANES).map(move |at| (row, at)));
        for (row, first) in places {
            let words = &self.words[first..(row + width).min(first + LANES)];
            let mut point =
                [Lanes::splat((first - row) as f32 + 0.5), Lanes::splat((row / width) as f32 + 0.5)];
            let (mut distance, mut error) = (Lanes::splat(1.0), Lanes::splat(0.0));
            let mut count = LANES;
            if words.len() == LANES && words.iter().all(|word| *word != 0) {
                for lane in 0..LANES {
                    point[0].0[lane] += lane as f32;
                    (distance.0[lane], error.0[lane]) = self.receiver(words[lane]);
                }
            } else {
                // What is covered, close together; the first again behind the last.
                count = 0;
                for (lane, word) in words.iter().enumerate().filter(|(_, word)| **word != 0) {
                    point[0].0[count] = (first - row + lane) as f32 + 0.5;
                    (distance.0[count], error.0[count]) = self.receiver(*word);
                    count += 1;
                }
                if count == 0 {
                    continue;
                }
                for lane in count..LANES {
                    (point[0].0[lane], distance.0[lane]) = (point[0].0[0], distance.0[0]);
                    error.0[lane] = error.0[0];
                }
            }
            let at = position(self.eye, self.screen.orthographic, &point, distance);
            for (light, found) in lights.iter().zip(&mut found) {
                if self.mark_together(light, &at, error, found) {
                    continue;
                }
                for lane in 0..count {
                    let position = at.map(|c| c.0[lane]);
                    light.mark(&position, error.0[lane], |page, heights| found.note(page, heights));
                }
            }
        }
        found.into_iter().map(Columns::closed).collect()
    }

    /// How far away what a word shows is, and by how much it may be off.
    #[inline(always)]
    fn receiver(&self, word: u64) -> (f32, f32) {
        let visible = decode(word).map_or(0, |hit| hit.visible as usize);
        (self.screen.distance((word >> 32) as u32), self.errors[visible])
    }

    /// The columns of eight receivers that lie close together in one level of a map without an end, each at least once. False
    /// where they do not.
    #[inline(always)]
    fn mark_together(&self, light: &LightView, at: &Vec3x8, error: Lanes, found: &mut Columns) -> bool {
        let distance = dot(at, at).sqrt();
        let pixel = pixels(light, distance);
        let Some(level) = one_level(light, distance, pixel) else { return false };
        let Some(anchor) = light.anchor(level) else { return false };
        let (texel, inverse) = (texel_of(level), texel_of(-level));
        let own = error + (distance * SHADOW_ROUNDING + pixel * SHADOW_SNAP);
        let reach = (own * inverse + (light.threshold + SHADOW_TEXEL_REACH)) * SHADOW_MARGIN;
        let wide = reach + light.beside();
        let side = SHADOW_PAGE_SIDE as f32;
        let right = along(&light.axes[0], at) * inverse + anchor[0];
        let down = -(along(&light.axes[1], at) * inverse - anchor[1]);
        let nearer = along(&light.axes[2], at);
        let (left, right) = range(right, wide, side);
        let (top, bottom) = range(down, wide, side);
        if right.wrapping_sub(left) > FEW_PAGES || bottom.wrapping_sub(top) > FEW_PAGES {
            return false;
        }
        let reach = reach * texel;
        let heights = [(nearer - reach).range().0, (nearer + reach * light.above(1.0)).range().1];
        for y in top..=bottom {
            for x in left..=right {
                found.note(RelativePage { face: 0, level: level as i16, x, y, z: 0 }, heights);
            }
        }
        true
    }
}

/// [`LightView::pixel`], of places at distances.
#[inline(always)]
pub(super) fn pixels(light: &LightView, distance: Lanes) -> Lanes {
    if light.orthographic { Lanes::splat(1.0 / light.focal) } else { distance / light.focal }
}

/// [`LightView::level_of`], if it is one for all.
#[inline(always)]
pub(super) fn one_level(light: &LightView, distance: Lanes, pixel: Lanes) -> Option<i32> {
    let one = match &light.cascades {
        None => pixel.in_one_octave(),
        Some(Cascades { splits, .. }) => {
            let (nearest, farthest) = distance.range();
            splits.number(nearest) == splits.number(farthest)
        }
    };
    one.then(|| light.level_of(distance.0[0], pixel.0[0]))
}

/// The first and the last of sides of so many texels that places reach.
#[inline(always)]
fn range(at: Lanes, reach: Lanes, side: f32) -> (i32, i32) {
    let ((low, _), (_, high)) = ((at - reach).range(), (at + reach).range());
    ((low / side).floor() as i32, (high / side).floor() as i32)
}
