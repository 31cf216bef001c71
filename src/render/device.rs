//! The culling and raster stages of a frame on the GPU backend: what goes to the device, and what of its answer the
//! frame keeps.

use std::sync::Arc;

use rayon::prelude::*;

use super::renderer::Rastered;
use super::stages::Stage;
use super::stats::{FrameStats, StageStats};
use crate::config::RenderOptions;
use crate::cpu::project::{InstanceView, Screen};
use crate::cpu::visibility::Visible;
use crate::error::Result;
use crate::gpu::{Drawn, Renderer};
use crate::gpu_types;
use crate::model::{ClusterAddress, Dag};
use crate::scene::{Instance, View};

/// Draws the visible instances of `scene`, slot numbers and entries in scene order, into `words`.
pub(super) fn draw_scene(
    renderer: &mut Renderer,
    scene: &[(u32, &Instance)],
    view: &View,
    screen: Screen,
    options: &RenderOptions,
    mut words: Vec<u64>,
) -> Result<Rastered> {
    let views: Vec<InstanceView> = scene
        .par_iter()
        .filter(|(_, instance)| instance.visible)
        .map(|&(slot, instance)| InstanceView::new(view, slot, instance))
        .collect();
    let mut instances: Vec<(gpu_types::Instance, &Arc<Dag>)> =
        views.iter().map(|view| (instance_record(view), &view.mesh)).collect();
    let constants = view_record(&screen, options.pixel_error);
    let drawn = renderer.draw(&constants, &mut instances, options.wide_atomics, &mut words)?;
    let mut stats = FrameStats::default();
    let on_screen = drawn.instances.iter().map(|&i| &views[i as usize]);
    stats.source_triangles = on_screen.map(|view| view.mesh.source_faces).sum();
    let visible: Vec<Visible> = drawn
        .visible
        .iter()
        .map(|v| Visible { instance: v.instance, cluster: ClusterAddress(v.cluster) })
        .collect();
    let large: Vec<bool> = drawn.visible.iter().map(|v| v.large != 0).collect();
    let triangles = |kind: bool| -> u64 {
        let chosen = visible.iter().zip(&large).filter(|(_, large)| **large == kind);
        chosen.map(|(v, _)| u64::from(views[v.instance as usize].mesh.record(v.cluster).triangle_count)).sum()
    };
    stats.stages = stages(&drawn, scene.len(), [triangles(false), triangles(true)]);
    Ok(Rastered { words, views, visible, large, stats })
}

/// What each stage received and passed on, and its time by the device's clock.
fn stages(drawn: &Drawn, instances: usize, [small, large]: [u64; 2]) -> Vec<StageStats> {
    let counters = &drawn.counters;
    [
        (Stage::InstanceCull, instances as u64, drawn.instances.len() as u64),
        (Stage::NodeCull, drawn.visited, drawn.groups),
        (Stage::ClusterCull, u64::from(counters.visited_clusters), drawn.visible.len() as u64),
        (Stage::RasterSmall, small, u64::from(counters.drawn_small)),
        (Stage::RasterLarge, large, u64::from(counters.drawn_large)),
    ]
    .into_iter()
    .zip(drawn.times)
    .map(|((stage, received, passed), ms)| StageStats { stage, pass: 1, received, passed, ms })
    .collect()
}

fn view_record(screen: &Screen, tau: f32) -> gpu_types::View {
    gpu_types::View {
        width: screen.width,
        height: screen.height,
        orthographic: u32::from(screen.orthographic),
        near: screen.near,
        far: screen.far,
        far_key: screen.far_key,
        tau,
        ..bytemuck::Zeroable::zeroed()
    }
}

/// All but where the mesh lies on the device.
fn instance_record(view: &InstanceView) -> gpu_types::Instance {
    let (center, extent) = view.bounds();
    gpu_types::Instance {
        screen: view.screen,
        object_to_eye: view.lod.object_to_eye,
        center,
        lod_scale: view.lod.scale,
        extent,
        lod_focal: view.lod.focal,
        eye: view.eye,
        lod_near: view.lod.near,
        double_sided: u32::from(view.material.double_sided),
        mirrored: u32::from(view.mirrored),
        ..bytemuck::Zeroable::zeroed()
    }
}
