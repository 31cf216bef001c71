//! A frame of which a device ran the first stages, continued by their CPU twins: so that the first stage at which a device
//! goes wrong can be found. See [`RenderOptions::cpu_from`].

use std::collections::BTreeSet;

use super::renderer::FrameContext;
use super::streaming;
use super::visibility_buffer::VisibilityBuffer;
use crate::config::RenderOptions;
use crate::cpu::cluster_cull::{self, CandidateCluster};
use crate::cpu::hzb::Hzb;
use crate::cpu::node_cull::{self, CandidateGroup};
use crate::cpu::visibility::{Nearest, Pixel};
use crate::cpu::{raster_large, raster_small};
use crate::gpu::Drawn;
use crate::model::ClusterAddress;
use crate::stages::Stage;
use crate::stream::Needs;
use crate::views::{Footprint, InstanceView, Visible};

/// Whether a device runs a stage.
pub(super) fn on_device(options: &RenderOptions, stage: Stage) -> bool {
    options.cpu_from.is_none_or(|from| stage < from)
}

/// Slots of the instances that a device found, in scene order.
pub(super) fn slots(from: Stage, drawn: &Drawn) -> Vec<u32> {
    let found: BTreeSet<u32> = match from {
        Stage::NodeCull => drawn.roots.iter().copied().collect(),
        Stage::ClusterCull => drawn.groups.iter().map(|group| group.instance).collect(),
        _ => drawn.visible.iter().map(|visible| visible.instance).collect(),
    };
    found.into_iter().collect()
}

/// Culls from a stage on; the visible list in scene order, and the pages that are missed.
pub(super) fn cull(
    from: Stage,
    frame_context: &FrameContext<'_>,
    drawn: &Drawn,
    views: &[InstanceView],
) -> (Vec<CandidateCluster>, Needs) {
    let (screen, tau) = (&frame_context.screen, frame_context.options.pixel_error);
    let number = |slot: u32| views.partition_point(|view| view.slot < slot) as u32;
    let mut needs = Needs::default();
    let mut groups: Vec<CandidateGroup> = match from {
        Stage::NodeCull => {
            let all: Vec<u32> = (0..views.len() as u32).collect();
            let walk = node_cull::run(&all, views, screen, tau, None::<&Hzb>);
            needs = streaming::missed(&walk.absent, views);
            walk.groups
        }
        _ => drawn
            .groups
            .iter()
            .map(|group| CandidateGroup { instance: number(group.instance), group: group.group })
            .collect(),
    };
    if from < Stage::RasterSmall {
        groups.sort_unstable();
        let mut list = cluster_cull::run(&groups, views, screen, tau, None::<&Hzb>).candidates;
        list.sort_unstable();
        return (list, needs);
    }
    let known = |visible: &crate::gpu_types::VisibleCluster| {
        let (instance, cluster) = (number(visible.instance), ClusterAddress(visible.cluster));
        CandidateCluster {
            visible: Visible { instance, cluster },
            footprint: Footprint::default(),
            large: visible.large != 0,
            triangles: views[instance as usize].pages.record(cluster).triangle_count,
        }
    };
    (drawn.visible.iter().map(known).collect(), needs)
}

/// Draws what a device has not: all, or what goes to the rasterizer of large triangles.
pub(super) fn raster(
    from: Stage,
    frame_context: &FrameContext<'_>,
    views: &[InstanceView],
    list: &[CandidateCluster],
    picture: &mut VisibilityBuffer,
) {
    match picture {
        VisibilityBuffer::Words(words) => draw(from, frame_context, views, list, words),
        keys => draw::<u32>(from, frame_context, views, list, keys.bits()),
    }
}

fn draw<P: Pixel>(
    from: Stage,
    frame_context: &FrameContext<'_>,
    views: &[InstanceView],
    list: &[CandidateCluster],
    pixels: &mut [P],
) {
    let screen = &frame_context.screen;
    if from <= Stage::RasterSmall {
        pixels.fill(P::default());
    }
    let visible: Vec<Visible> = list.iter().map(|candidate| candidate.visible).collect();
    let of = |large: bool| -> Vec<u32> {
        (0..).zip(list).filter(|(_, candidate)| candidate.large == large).map(|(number, _)| number).collect()
    };
    let sink = Nearest(P::cells(pixels));
    if from <= Stage::RasterSmall {
        raster_small::run(&of(false), &visible, views, screen, &sink);
    }
    raster_large::run(&of(true), &visible, views, screen, &sink);
}
