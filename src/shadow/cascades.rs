//! Cascades: a few levels of a light's map, each for a range of distances from the camera, as coarse as it takes to hold what
//! is seen there. Ranges and levels come from the frame itself.
//!
//! Lauritzen, Salvi and Lefohn, "Sample Distribution Shadow Maps", I3D 2011.

use super::receiver::{LightView, texel_of};
use crate::limits::{SHADOW_CASCADE_PAGES, SHADOW_CASCADES, SHADOW_PAGE_SIDE};

/// Bits of a distance that say which bin of a histogram it is in: eight bins for each doubling.
const BIN_SHIFT: u32 = 20;
/// Bins for all distances there are.
pub const DISTANCE_BINS: usize = 1 << (31 - BIN_SHIFT);

/// The bin of a distance from the camera.
#[inline(always)]
pub fn bin_of(distance: f32) -> usize {
    (distance.to_bits() >> BIN_SHIFT) as usize % DISTANCE_BINS
}

/// Where cascades begin and end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splits {
    /// Distances from the camera at which each but the first begins, ascending; infinite where there are fewer.
    begins: [f32; SHADOW_CASCADES - 1],
}

impl Splits {
    /// Of the bins that hold anything seen, ascending: each cascade takes as many of them, so that none is spent on what is
    /// empty. Bins grow with the distance, so these are logarithmic splits of what is occupied.
    pub fn new(bins: &[usize]) -> Self {
        let mut begins = [f32::INFINITY; SHADOW_CASCADES - 1];
        let firsts =
            (1..SHADOW_CASCADES).filter_map(|k| bins.get((bins.len() * k).div_ceil(SHADOW_CASCADES)));
        let mut distances: Vec<f32> = firsts.map(|bin| f32::from_bits((*bin as u32) << BIN_SHIFT)).collect();
        distances.dedup();
        begins.iter_mut().zip(distances).for_each(|(begin, distance)| *begin = distance);
        Self { begins }
    }

    /// Which cascade a distance falls into.
    #[inline(always)]
    pub fn number(&self, distance: f32) -> usize {
        let mut number = 0;
        for begin in self.begins {
            number += usize::from(distance >= begin);
        }
        number
    }

    /// Where a cascade begins and ends.
    pub fn range(&self, number: usize) -> [f32; 2] {
        let begin = |k: usize| self.begins.get(k).copied().unwrap_or(f32::INFINITY);
        [if number == 0 { 0.0 } else { begin(number - 1) }, begin(number)]
    }
}

/// The levels of a light that a view looks up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cascades {
    /// Where which.
    pub splits: Splits,
    /// The level of each.
    pub levels: [i32; SHADOW_CASCADES],
}

impl LightView {
    /// The finest level of a parallel map in which a box takes no more pages across and down than a cascade has, but none
    /// that is finer than where a pixel of a size looks it up without cascades. Corners along the light's axes, from the camera.
    pub fn fitting(&self, low: &[f32; 3], high: &[f32; 3], pixel: f32) -> i32 {
        let most = SHADOW_CASCADE_PAGES as f32;
        let fits = |level: &i32| {
            let Some(anchor) = self.anchor(*level) else { return true };
            let inverse = texel_of(-level);
            let page = |texels: f32| (texels / SHADOW_PAGE_SIDE as f32).floor();
            let across = [low[0], high[0]].map(|x| page(x * inverse + anchor[0]));
            let down = [high[1], low[1]].map(|y| page(anchor[1] - y * inverse));
            across[1] - across[0] < most && down[1] - down[0] < most
        };
        let (first, last) = (self.own_level(pixel), self.bounded(i32::MAX));
        (first..=last).find(fits).unwrap_or(last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_share_what_is_occupied() {
        let none = Splits::new(&[]);
        assert_eq!([none.number(0.0), none.number(1e30)], [0, 0]);
        let one = Splits::new(&[bin_of(3.0)]);
        assert_eq!(one.number(3.0), 0);
        // A gap costs nothing: of 2 bins near and 2 far each has a cascade.
        let bins = [1.0, 1.125, 1000.0, 1100.0].map(bin_of);
        let apart = Splits::new(&bins);
        assert_eq!([1.0, 1.2, 500.0, 1000.0, 1100.0].map(|d| apart.number(d)), [0, 1, 1, 2, 3]);
        assert_eq!(apart.range(1)[0], 1.125);
        assert_eq!(apart.range(3)[1], f32::INFINITY);
        // From 1 to 16 in equal steps of the exponent.
        let bins: Vec<usize> = (bin_of(1.0)..bin_of(16.0)).collect();
        let even = Splits::new(&bins);
        assert_eq!((0..4).map(|k| even.range(k)[0]).collect::<Vec<_>>(), [0.0, 2.0, 4.0, 8.0]);
    }
}
