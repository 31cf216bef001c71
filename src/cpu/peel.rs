//! Blended surfaces in layers: what of them is nearest at each pixel in front of what is opaque, then what lies behind that, and so
//! on (Everitt, "Interactive Order-Independent Transparency", 2001), by the rasterizers that draw all else. Layers are ordered
//! by depth, then by the order of the scene, so that surfaces that coincide all count, whatever the order of submission.

use rayon::prelude::*;

use super::cluster_cull::CandidateCluster;
use super::visibility::{Cell, Pixel, Sink};
use super::{raster_large, raster_small};
use crate::views::{Footprint, InstanceView, Screen, Visible};

/// The layers of a picture, from near to far.
#[derive(Debug, Default)]
pub struct Layers {
    /// The clusters that they show. Words number them.
    pub visible: Vec<Visible>,
    /// Which of them went to the large rasterizer.
    pub large: Vec<bool>,
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

/// Pixels of a side of a tile.
const TILE: usize = 16;

/// Tiles in which a layer showed anything: nothing lies behind it elsewhere.
struct Tiles {
    across: usize,
    shown: Vec<bool>,
}

impl Tiles {
    /// Those of a layer, and how many pixels it shows.
    fn of(words: &[u64], screen: &Screen) -> (Self, u64) {
        let width = screen.width as usize;
        let across = width.div_ceil(TILE);
        let rows = words.par_chunks(width * TILE).map(|rows| {
            let (mut shown, mut count) = (vec![false; across], 0);
            for row in rows.chunks(width) {
                for (tile, words) in shown.iter_mut().zip(row.chunks(TILE)) {
                    let own = words.iter().filter(|word| **word != 0).count() as u64;
                    *tile |= own > 0;
                    count += own;
                }
            }
            (shown, count)
        });
        let rows: Vec<(Vec<bool>, u64)> = rows.collect();
        let count = rows.iter().map(|row| row.1).sum();
        (Self { across, shown: rows.into_iter().flat_map(|row| row.0).collect() }, count)
    }

    /// Whether any of them holds a pixel of a footprint.
    fn meet(&self, footprint: &Footprint) -> bool {
        let [left, top, right, bottom] = footprint.rect.map(|v| usize::from(v) / TILE);
        (top..=bottom).any(|row| self.shown[row * self.across..][left..=right].contains(&true))
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
    let (mut layers, mut left): (Vec<Vec<u64>>, u64) = (Vec::new(), 0);
    for number in 0..=most {
        let mut words = vec![0u64; opaque.len()];
        let before = layers.last().map(Vec::as_slice);
        let sink = Behind { cells: u64::cells(&mut words), before, opaque };
        raster_small::run(&small, &visible, views, screen, &sink);
        raster_large::run(&large, &visible, views, screen, &sink);
        let (tiles, count) = Tiles::of(&words, screen);
        if count == 0 {
            break;
        }
        if number == most {
            left = count;
            break;
        }
        layers.push(words);
        for list in [&mut small, &mut large] {
            list.retain(|number| tiles.meet(&blended[*number as usize].footprint));
        }
    }
    let large = blended.iter().map(|cluster| cluster.large).collect();
    Layers { visible, large, words: layers, left }
}
