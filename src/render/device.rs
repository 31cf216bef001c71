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
use crate::gpu::{Counted, DeviceStage, Drawn, Phase, Renderer, Ways};
use crate::gpu_types;
use crate::model::{ClusterAddress, Dag};
use crate::scene::placement::Eye;
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
    let eye = Eye::new(view);
    let views: Vec<InstanceView> = scene
        .par_iter()
        .filter(|(_, instance)| instance.visible)
        .map(|&(slot, instance)| InstanceView::new(view, &eye, slot, instance))
        .collect();
    let mut instances: Vec<(gpu_types::Instance, &Arc<Dag>)> =
        views.iter().map(|view| (instance_record(view), &view.mesh)).collect();
    let ways = Ways { wide_atomics: options.wide_atomics, occlusion: options.occlusion };
    let constants = view_record(&screen, options.pixel_error);
    let drawn = renderer.draw(&constants, &mut instances, ways, &mut words)?;
    let mut stats = FrameStats::default();
    let on_screen = drawn.instances.iter().map(|&i| &views[i as usize]);
    stats.source_triangles = on_screen.map(|view| view.mesh.source_faces).sum();
    let visible: Vec<Visible> = drawn
        .visible
        .iter()
        .map(|v| Visible { instance: v.instance, cluster: ClusterAddress(v.cluster) })
        .collect();
    let large: Vec<bool> = drawn.visible.iter().map(|v| v.large != 0).collect();
    stats.stages = stages(&drawn, scene.len() as u64, &screen);
    for phase in &drawn.phases {
        stats.occluded_instances += phase.hidden_instances;
    }
    stats.occluded_clusters = drawn.phases.get(1).map_or(0, |second| second.counters.held.into());
    Ok(Rastered { words, views, visible, large, stats })
}

fn stage_of(stage: DeviceStage) -> Stage {
    match stage {
        DeviceStage::InstanceCull => Stage::InstanceCull,
        DeviceStage::NodeCull => Stage::NodeCull,
        DeviceStage::ClusterCull => Stage::ClusterCull,
        DeviceStage::RasterSmall => Stage::RasterSmall,
        DeviceStage::RasterLarge => Stage::RasterLarge,
        DeviceStage::Hzb => Stage::Hzb,
    }
}

/// What each stage received and passed on, and its time by the device's clock.
fn stages(drawn: &Drawn, instances: u64, screen: &Screen) -> Vec<StageStats> {
    let pixels = u64::from(screen.width) * u64::from(screen.height);
    let texels = u64::from(screen.width.div_ceil(2)) * u64::from(screen.height.div_ceil(2));
    let mut out: Vec<StageStats> = Vec::new();
    for &(device_stage, phase, ms) in &drawn.times {
        let pass = match phase {
            Phase::First => 1,
            Phase::Second => 2,
        };
        let stage = stage_of(device_stage);
        if let Some(known) = out.iter_mut().find(|s| s.stage == stage && s.pass == pass) {
            known.ms += ms;
            continue;
        }
        let Some(Counted { starts, visited, groups, clusters, counters, .. }) =
            drawn.phases.get(usize::from(pass) - 1)
        else {
            continue;
        };
        let before = if pass == 2 { drawn.phases[0].groups } else { 0 };
        let (received, passed) = match device_stage {
            DeviceStage::InstanceCull => (instances, *starts),
            // The second phase lists the groups of both.
            DeviceStage::NodeCull => (*visited, groups.saturating_sub(before)),
            DeviceStage::ClusterCull => (counters.visited_clusters.into(), *clusters),
            DeviceStage::RasterSmall => (counters.triangles_small.into(), counters.drawn_small.into()),
            DeviceStage::RasterLarge => (counters.triangles_large.into(), counters.drawn_large.into()),
            DeviceStage::Hzb => (pixels * u64::from(counters.pyramid), texels * u64::from(counters.pyramid)),
        };
        out.push(StageStats { stage, pass, received, passed, ms });
    }
    out
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
        slot: view.slot,
        ..bytemuck::Zeroable::zeroed()
    }
}
