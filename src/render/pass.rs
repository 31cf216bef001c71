//! The culling and raster stages of a frame on the CPU, in two passes.
//!
//! The first pass draws what the frame before showed, and the nearest batch. The second pass draws the rest in batches: the
//! depth pyramid of what was drawn so far culls the next batch. Without occlusion culling, and where footprints overlap too
//! little for it to pay, the first pass draws everything. An occluded cluster has no pixel, so the image is the same either
//! way. Numbers are given in scene order over what is drawn, so ties are the same, too.

use std::ops::Range;

use rayon::prelude::*;

use super::history::VisibilityHistory;
use super::queue::{Queue, Terms};
use super::renderer::FrameContext;
use super::stats::FrameStats;
use super::visibility_buffer::VisibilityBuffer;
use crate::cpu::cluster_cull::{self, CandidateCluster};
use crate::cpu::hzb::Hzb;
use crate::cpu::node_cull::CandidateGroup;
use crate::cpu::peel::{self, Layers};
use crate::cpu::visibility::{Nearest, Pixel};
use crate::cpu::{instance_cull, node_cull, raster_large, raster_small};
use crate::error::{Error, Result};
use crate::limits::{MAX_VISIBLE, PYRAMID_ABOVE};
use crate::stages::Stage;
use crate::views::{InstanceView, Occluder, Screen, Visible};

/// When instances are deferred. One of a few pixels still has a hierarchy to traverse, and clusters.
pub(super) const INSTANCES: Terms = Terms { overlap: 1.5, each: 1024 };
/// The same for clusters: their rectangles hold about twice the pixels of their triangles.
const CLUSTERS: Terms = Terms { overlap: 3.0, each: 0 };
/// When nothing is deferred.
const AT_ONCE: Terms = Terms { overlap: f64::INFINITY, each: 0 };

/// The state of a frame on its way through the culling and raster stages.
pub(super) struct FramePasses<'a, P> {
    screen: Screen,
    tau: f32,
    views: &'a [InstanceView],
    pixels: &'a mut [P],
    /// Groups that were to be drawn and whose pages are not there.
    absent: Vec<CandidateGroup>,
    /// Clusters that are blended with what is behind them: nothing of them is drawn here.
    blended: Vec<CandidateCluster>,
    /// Rows of the picture drawn to since its pyramid was built; absent before it was.
    drawn_rows: Option<Range<usize>>,
    stats: &'a mut FrameStats,
}

/// What passes leave, in scene order.
pub(super) struct Listed {
    /// The frame's visible list.
    pub(super) list: Vec<CandidateCluster>,
    /// See [`FramePasses::absent`].
    pub(super) absent: Vec<CandidateGroup>,
    /// See [`FramePasses::blended`].
    pub(super) blended: Vec<CandidateCluster>,
}

/// The layers of the clusters of a picture that are blended.
pub(super) fn peel(
    frame_context: &FrameContext<'_>,
    picture: &VisibilityBuffer,
    views: &[InstanceView],
    blended: &[CandidateCluster],
    stats: &mut FrameStats,
) -> Option<Layers> {
    let VisibilityBuffer::Words(words) = picture else { return None };
    if blended.is_empty() {
        return None;
    }
    let FrameContext { screen, options, .. } = frame_context;
    let layers = peel::run(blended, views, screen, words, options.max_layers as usize);
    (stats.layers, stats.layers_left) = (layers.words.len() as u64, layers.left);
    Some(layers)
}

impl<'a, P: Pixel> FramePasses<'a, P> {
    /// Before anything is drawn.
    pub(super) fn new(
        frame_context: &FrameContext<'_>,
        views: &'a [InstanceView],
        pixels: &'a mut [P],
        stats: &'a mut FrameStats,
    ) -> Self {
        let FrameContext { screen, options, .. } = frame_context;
        let (tau, absent, blended) = (options.pixel_error, Vec::new(), Vec::new());
        Self { screen: *screen, tau, views, pixels, absent, blended, drawn_rows: None, stats }
    }

    /// What was found, beside the visible list.
    pub(super) fn listed(mut self, list: Vec<CandidateCluster>) -> Listed {
        self.blended.sort_unstable();
        Listed { list, absent: self.absent, blended: self.blended }
    }

    /// Culls and draws instances over what pixels show, which is `old`, in scene order; returns the list of both. With `hzb`
    /// what is hidden is left out.
    #[cfg(feature = "gpu")]
    pub(super) fn draw_over(
        &mut self,
        old: Vec<CandidateCluster>,
        instances: &[u32],
        hzb: Option<&mut Hzb>,
    ) -> Result<Vec<CandidateCluster>> {
        let new = match hzb {
            Some(hzb) => {
                self.build_pyramid(hzb);
                let unhidden = self.unhidden_instances(instances, hzb);
                self.cull(2, &unhidden, Some(hzb))
            }
            None => self.cull(2, instances, None),
        };
        self.draw(2, old, new)
    }

    /// Culls and draws everything; returns the frame's visible list, in scene order.
    pub(super) fn draw_scene(
        &mut self,
        occlusion: bool,
        hzb: &mut Hzb,
        history: &mut VisibilityHistory,
    ) -> Result<Vec<CandidateCluster>> {
        let terms = if occlusion { INSTANCES } else { AT_ONCE };
        let views = self.views;
        let entries = (0..).zip(views).map(|(i, v)| (v.footprint, i, history.instance(v)));
        let mut instances: Queue<u32> = Queue::new(entries, &self.screen, terms);
        let candidates = self.cull(1, &instances.take(), None);
        let pays = occlusion && triangles(&candidates) > u64::from(PYRAMID_ABOVE);
        let terms = if pays { CLUSTERS } else { AT_ONCE };
        let before = |c: &CandidateCluster| history.cluster(&views[c.visible.instance as usize], c.visible);
        let entries = candidates.iter().map(|c| (c.footprint, *c, before(c)));
        let mut clusters = Queue::new(entries, &self.screen, terms);
        let mut list = self.draw(1, Vec::new(), clusters.take())?;
        let two_passes = !(instances.is_empty() && clusters.is_empty());
        while !(instances.is_empty() && clusters.is_empty()) {
            self.build_pyramid(hzb);
            let mut new = self.unhidden_clusters(&clusters.take(), hzb);
            let unhidden = self.unhidden_instances(&instances.take(), hzb);
            if !unhidden.is_empty() {
                new.append(&mut self.cull(2, &unhidden, Some(hzb)));
            }
            new.sort_unstable();
            list = self.draw(2, list, new)?;
        }
        if two_passes {
            history.note(self.pixels, self.screen.width as usize, &list, views);
        } else {
            history.clear();
        }
        if occlusion && !self.absent.is_empty() {
            self.build_pyramid(hzb);
            self.drop_occluded(hzb);
        }
        Ok(list)
    }

    /// What the picture hides is not missed.
    fn drop_occluded(&mut self, hzb: &Hzb) {
        let (views, screen) = (self.views, &self.screen);
        self.absent = std::mem::take(&mut self.absent)
            .into_par_iter()
            .filter(|at| {
                let view = &views[at.instance as usize];
                let group = &view.mesh.groups[at.group as usize];
                view.footprint(screen, group.center, group.extent).is_some_and(|place| !hzb.hides(&place))
            })
            .collect();
    }

    fn build_pyramid(&mut self, hzb: &mut Hzb) {
        let (width, height) = (self.screen.width as usize, self.screen.height as usize);
        let rows = self.drawn_rows.replace(height..0).unwrap_or(0..height);
        if rows.is_empty() {
            return;
        }
        let count = rows.len();
        self.stats.time(Stage::Hzb, 1, || {
            hzb.build(self.pixels, width, rows);
            ((), (width * count) as u64, (width.div_ceil(2) * count.div_ceil(2)) as u64)
        });
    }

    fn unhidden_clusters(&mut self, later: &[CandidateCluster], hzb: &Hzb) -> Vec<CandidateCluster> {
        let unhidden = cluster_cull::unhidden(later, hzb);
        self.stats.occluded_clusters += (later.len() - unhidden.len()) as u64;
        unhidden
    }

    fn unhidden_instances(&mut self, later: &[u32], hzb: &Hzb) -> Vec<u32> {
        let unhidden = self.stats.time(Stage::InstanceCull, 2, || {
            let unhidden = instance_cull::unhidden(later, self.views, hzb);
            let count = unhidden.len() as u64;
            (unhidden, later.len() as u64, count)
        });
        self.stats.occluded_instances += (later.len() - unhidden.len()) as u64;
        unhidden
    }

    /// Node and cluster culling of instances; survivors in scene order.
    fn cull(&mut self, pass: u8, instances: &[u32], hzb: Option<&Hzb>) -> Vec<CandidateCluster> {
        let (views, screen, tau) = (self.views, &self.screen, self.tau);
        let walk = self.stats.time(Stage::NodeCull, pass, || {
            let walk = node_cull::run(instances, views, screen, tau, hzb);
            let counts = (walk.visited, walk.groups.len() as u64);
            (walk, counts.0, counts.1)
        });
        self.absent.extend(walk.absent);
        let mut candidates = self.stats.time(Stage::ClusterCull, pass, || {
            let mut culled = cluster_cull::run(&walk.groups, views, screen, tau, hzb);
            if !culled.candidates.is_sorted() {
                culled.candidates.par_sort_unstable();
            }
            let count = culled.candidates.len() as u64;
            (culled.candidates, culled.visited, count)
        });
        if views.iter().any(|view| view.materials.any_blended(true)) {
            self.blended.extend(candidates.extract_if(.., |cluster| cluster.is_blended(views)));
        }
        candidates
    }

    /// Draws `new` into what shows `old`, both in scene order; returns both as one list, renumbered. The first
    /// pass starts from background.
    fn draw(
        &mut self,
        pass: u8,
        old: Vec<CandidateCluster>,
        new: Vec<CandidateCluster>,
    ) -> Result<Vec<CandidateCluster>> {
        let count = old.len() + new.len();
        if count > MAX_VISIBLE {
            let message = format!("{count} clusters are visible at once, the most is {MAX_VISIBLE}");
            return Err(Error::TooLarge(message));
        }
        if pass > 1 && new.is_empty() {
            return Ok(old);
        }
        if let Some(rows) = &mut self.drawn_rows {
            for CandidateCluster { footprint, .. } in &new {
                let [_, first, _, last] = footprint.rect.map(usize::from);
                *rows = rows.start.min(first)..rows.end.max(last + 1);
            }
        }
        let (list, numbers_old, numbers) = merge(old, &new);
        if !numbers_old.is_empty() {
            P::renumber(self.pixels, &numbers_old);
        }
        let visible: Vec<Visible> = list.iter().map(|c| c.visible).collect();
        for (stage, large) in [(Stage::RasterSmall, false), (Stage::RasterLarge, true)] {
            let (views, screen, pixels) = (self.views, &self.screen, &mut *self.pixels);
            self.stats.time(stage, pass, || {
                if pass == 1 && !large {
                    pixels.par_chunks_mut(1 << 15).for_each(|chunk| chunk.fill(P::default()));
                }
                let sink = Nearest(P::cells(pixels));
                let mut received = 0;
                let mut chosen = Vec::with_capacity(new.len());
                for (candidate, &number) in new.iter().zip(&numbers) {
                    if candidate.large == large {
                        chosen.push(number);
                        received += u64::from(candidate.triangles);
                    }
                }
                let drawn = if large {
                    raster_large::run(&chosen, &visible, views, screen, &sink)
                } else {
                    raster_small::run(&chosen, &visible, views, screen, &sink)
                };
                ((), received, drawn)
            });
        }
        Ok(list)
    }
}

/// Triangles of the clusters of a list.
pub(super) fn triangles(list: &[CandidateCluster]) -> u64 {
    list.iter().map(|c| u64::from(c.triangles)).sum()
}

/// Merges two lists in scene order; also the numbers that the entries of each get.
fn merge(a: Vec<CandidateCluster>, b: &[CandidateCluster]) -> (Vec<CandidateCluster>, Vec<u32>, Vec<u32>) {
    if a.is_empty() {
        return (b.to_vec(), Vec::new(), (0..b.len() as u32).collect());
    }
    let mut list = Vec::with_capacity(a.len() + b.len());
    let (mut of_a, mut of_b) = (Vec::with_capacity(a.len()), Vec::with_capacity(b.len()));
    while of_a.len() < a.len() || of_b.len() < b.len() {
        let take_a = match (a.get(of_a.len()), b.get(of_b.len())) {
            (Some(x), Some(y)) => x < y,
            (x, _) => x.is_some(),
        };
        let (from, numbers) = if take_a { (&a[..], &mut of_a) } else { (b, &mut of_b) };
        let entry = from[numbers.len()];
        numbers.push(list.len() as u32);
        list.push(entry);
    }
    (list, of_a, of_b)
}
