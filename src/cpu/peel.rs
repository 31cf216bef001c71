//! Blended surfaces in layers: what of them is nearest at each pixel in front of what is opaque, then what lies behind that, and so
//! on (Everitt, "Interactive Order-Independent Transparency", 2001), by the rasterizers that draw all else. Layers are ordered
//! by depth, then by the order of the scene, so that surfaces that coincide all count, whatever the order of submission.

use rayon::prelude::*;

use super::cluster_cull::CandidateCluster;
use super::visibility::{Cell, Pixel, Sink};
use super::{raster_large, raster_small};
use crate::views::{InstanceView, Screen, Visible};

/// The layers of a picture, from near to far.
#[derive(Debug, Default)]
pub struct Layers {
    /// The clusters that they show. Words number them.
    pub visible: Vec<Visible>,
    /// Words of each, row by row.
    pub words: Vec<Vec<u64>>,
    /// Pixels where more lies behind the last.
    pub left: u64,
}

/// Keeps the nearest of what lies behind a layer and in front of what is opaque.
struct Behind<'a, C> {
    cells: &'a [C],
    /// The layer before, if there is one.
    before: Option<&'a [u64]>,
    opaque: &'a [u64],
}

impl<C: Cell> Sink for Behind<'_, C> {
    #[inline(always)]
    fn put(&self, pixel: usize, word: u64) {
        let in_front = word >> 32 > self.opaque[pixel] >> 32;
        if in_front && self.before.is_none_or(|before| word < before[pixel]) {
            self.cells[pixel].raise(word);
        }
    }
}

/// At most so many layers of the blended clusters of a picture, in scene order.
pub fn run(
    blended: &[CandidateCluster],
    views: &[InstanceView],
    screen: &Screen,
    opaque: &[u64],
    most: usize,
) -> Layers {
    let visible: Vec<Visible> = blended.iter().map(|cluster| cluster.visible).collect();
    let (mut small, mut large) = (Vec::new(), Vec::new());
    for (number, cluster) in (0..).zip(blended) {
        if cluster.large { large.push(number) } else { small.push(number) }
    }
    let next = |before: Option<&[u64]>| {
        let mut words = vec![0u64; opaque.len()];
        let sink = Behind { cells: u64::cells(&mut words), before, opaque };
        raster_small::run(&small, &visible, views, screen, &sink);
        raster_large::run(&large, &visible, views, screen, &sink);
        let count = words.par_iter().filter(|word| **word != 0).count() as u64;
        (words, count)
    };
    let mut layers = Layers { visible: visible.clone(), ..Layers::default() };
    for number in 0..=most {
        let (words, count) = next(layers.words.last().map(Vec::as_slice));
        if count == 0 {
            break;
        }
        if number == most {
            layers.left = count;
        } else {
            layers.words.push(words);
        }
    }
    layers
}
