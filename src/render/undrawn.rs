//! What a scene has that no device draws: instances with blended surfaces, points and lines. A device draws all else, then
//! the CPU draws these into the same picture, by its own stages.

use rayon::prelude::*;

use super::pass::{FramePasses, Listed, peel, triangles};
use super::renderer::{FrameContext, Rastered};
use super::stats::FrameStats;
use super::streaming;
use super::visibility_buffer::VisibilityBuffer;
use crate::cpu::cluster_cull::CandidateCluster;
use crate::cpu::hzb::Hzb;
use crate::cpu::instance_cull;
use crate::cpu::visibility::Pixel;
use crate::error::Result;
use crate::scene::Instance;
use crate::stages::Stage;
use crate::views::{Footprint, InstanceView, Visible};

/// Draws the instances that the device left out into what it drew.
pub(super) fn draw(frame_context: &FrameContext<'_>, rastered: &mut Rastered, hzb: &mut Hzb) -> Result<()> {
    let FrameContext { scene, view, eye, screen, resident, .. } = frame_context;
    let left: Vec<(u32, &Instance)> =
        scene.instances().iter().filter(|(_, instance)| instance.needs_cpu()).collect();
    let new = rastered.stats.time(Stage::InstanceCull, 2, || {
        let views = instance_cull::run(&left, view, eye, screen, resident);
        let count = views.len() as u64;
        (views, left.len() as u64, count)
    });
    if !new.is_empty() {
        add(frame_context, rastered, new, hzb)?;
    }
    rastered.picture.measure(screen, &mut rastered.stats);
    Ok(())
}

/// The same of those that are on the screen.
fn add(
    frame_context: &FrameContext<'_>,
    rastered: &mut Rastered,
    new: Vec<InstanceView>,
    hzb: &mut Hzb,
) -> Result<()> {
    rastered.stats.source_triangles += new.iter().map(|view| view.mesh.source_faces).sum::<u64>();
    let (numbers, own) = join(&mut rastered.views, new);
    let Rastered { picture, views, visible, large, layers, needs, stats, .. } = rastered;
    let known = |(at, large): (&Visible, &bool)| {
        let visible = Visible { instance: numbers[at.instance as usize], ..*at };
        let triangles = views[visible.instance as usize].pages.record(at.cluster).triangle_count;
        CandidateCluster { visible, footprint: Footprint::default(), large: *large, triangles }
    };
    let old: Vec<CandidateCluster> = visible.par_iter().zip(&*large).map(known).collect();
    let Listed { list, absent, blended } = match &mut *picture {
        VisibilityBuffer::Words(words) => over(frame_context, views, words, old, &own, hzb, stats)?,
        keys => over(frame_context, views, keys.bits(), old, &own, hzb, stats)?,
    };
    needs.merge(streaming::missed(&absent, views));
    *layers = peel(frame_context, picture, views, &blended, stats);
    *visible = list.iter().map(|cluster| cluster.visible).collect();
    *large = list.iter().map(|cluster| cluster.large).collect();
    stats.triangles = triangles(&list);
    stats.covered_pixels = picture.covered();
    Ok(())
}

/// Adds views to others, in the order of their slots. Returns the numbers that those which were there have now, and those of
/// the new ones.
fn join(views: &mut Vec<InstanceView>, new: Vec<InstanceView>) -> (Vec<u32>, Vec<u32>) {
    let known = views.len();
    let mut all: Vec<(usize, InstanceView)> = views.drain(..).chain(new).enumerate().collect();
    all.sort_by_key(|(_, view)| view.slot);
    let mut numbers = vec![0; all.len()];
    for (number, (before, _)) in (0..).zip(&all) {
        numbers[*before] = number;
    }
    views.extend(all.into_iter().map(|(_, view)| view));
    let own = numbers.split_off(known);
    (numbers, own)
}

/// Culls instances by what pixels show, and draws them over it.
fn over<P: Pixel>(
    frame_context: &FrameContext<'_>,
    views: &[InstanceView],
    pixels: &mut [P],
    old: Vec<CandidateCluster>,
    instances: &[u32],
    hzb: &mut Hzb,
    stats: &mut FrameStats,
) -> Result<Listed> {
    let mut pass = FramePasses::new(frame_context, views, pixels, stats);
    let list = pass.draw_over(old, instances, frame_context.options.occlusion.then_some(hzb))?;
    Ok(pass.listed(list))
}
