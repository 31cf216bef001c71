//! The culling and raster stages of a frame on the GPU backend: what goes to the device, and what of its answer the
//! frame keeps.

use rayon::prelude::*;

use super::renderer::Rastered;
use super::stages::Stage;
use super::stats::{FrameStats, StageStats};
use crate::config::RenderOptions;
use crate::cpu::project::{InstanceView, Screen, mesh_bounds};
use crate::cpu::visibility::Visible;
use crate::error::Result;
use crate::gpu::{Context, Counted, DeviceStage, Drawn, Phase, Renderer, Ways};
use crate::gpu_types::{self, Placed, VisibleCluster};
use crate::model::ClusterAddress;
use crate::scene::placement::Eye;
use crate::scene::{Instance, Scene, View};

/// A device and what it knows of the scene drawn last.
#[derive(Debug)]
pub(super) struct Device {
    renderer: Renderer,
    /// The scene, and its clock then.
    known: Option<(u64, u64)>,
}

impl Device {
    /// On the best device there is.
    pub(super) fn new() -> Result<Self> {
        Ok(Self { renderer: Renderer::new()?, known: None })
    }

    pub(super) fn context(&self) -> &Context {
        self.renderer.context()
    }

    /// Tells the device what changed in the scene.
    fn update(&mut self, scene: &Scene) {
        let since = match self.known {
            Some((identity, clock)) if identity == scene.identity() => clock,
            _ => {
                self.renderer.clear();
                0
            }
        };
        let slots = scene.instances();
        for (slot, instance) in slots.changed_since(since) {
            self.renderer.set(slot, instance.map(|instance| (placed(instance), &instance.mesh)));
        }
        self.known = Some((scene.identity(), slots.clock()));
    }

    /// Draws the visible instances of a scene into `words`.
    pub(super) fn draw(
        &mut self,
        scene: &Scene,
        view: &View,
        screen: Screen,
        options: &RenderOptions,
        mut words: Vec<u64>,
    ) -> Result<Rastered> {
        self.update(scene);
        let ways = Ways { wide_atomics: options.wide_atomics, occlusion: options.occlusion };
        let eye = Eye::new(view);
        let drawn = self.renderer.draw(&view_record(&screen, &eye, options.pixel_error), ways, &mut words)?;
        let instances = scene.instances();
        let mut stats = FrameStats::default();
        let on_screen = drawn.instances.iter().filter_map(|&slot| instances.at(slot as usize));
        stats.source_triangles = on_screen.map(|instance| instance.mesh.source_faces).sum();
        // In scene order: each instance once.
        let mut slots: Vec<u32> = drawn.visible.iter().map(|v| v.instance).collect();
        slots.dedup();
        let views: Vec<InstanceView> = slots
            .par_iter()
            .filter_map(|&slot| Some(InstanceView::new(view, &eye, slot, instances.at(slot as usize)?)))
            .collect();
        let mut at = 0;
        let number = |v: &VisibleCluster| {
            at += usize::from(views.get(at).is_some_and(|view| view.slot != v.instance));
            Visible { instance: at as u32, cluster: ClusterAddress(v.cluster) }
        };
        let visible: Vec<Visible> = drawn.visible.iter().map(number).collect();
        let large: Vec<bool> = drawn.visible.iter().map(|v| v.large != 0).collect();
        stats.stages = stages(&drawn, instances.len() as u64, &screen);
        stats.uploaded_bytes = drawn.uploaded_bytes;
        stats.occluded_instances = drawn.phases.iter().map(|phase| phase.hidden_instances).sum();
        stats.occluded_clusters = drawn.phases.get(1).map_or(0, |second| second.counters.held.into());
        Ok(Rastered { words, views, visible, large, stats })
    }
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

/// Three rows with a fourth column.
fn rows(linear: &[[f32; 3]; 3], last: &[f32; 3]) -> [[f32; 4]; 3] {
    std::array::from_fn(|k| [linear[k][0], linear[k][1], linear[k][2], last[k]])
}

/// A view's constants, as shaders read them.
pub fn view_record(screen: &Screen, eye: &Eye, tau: f32) -> gpu_types::View {
    gpu_types::View {
        width: screen.width,
        height: screen.height,
        orthographic: u32::from(screen.orthographic),
        near: screen.near,
        far: screen.far,
        far_key: screen.far_key,
        tau,
        rotate: rows(&eye.rotate, &eye.high),
        forward: eye.forward,
        lod_focal: eye.lod_focal,
        low: eye.low,
        lod_near: eye.lod_near,
        focal: eye.focal,
        center: eye.center,
        mirrored: u32::from(eye.mirrored),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// An instance as shaders read it: all but where the mesh lies on the device.
pub fn placed(instance: &Instance) -> Placed {
    let placement = instance.placement();
    let (center, extent) = mesh_bounds(&instance.mesh);
    Placed {
        linear: rows(&placement.linear, &placement.high),
        inverse: rows(&placement.inverse, &placement.low),
        center,
        lod_scale: placement.lod_scale,
        extent,
        double_sided: u32::from(instance.material.double_sided),
        mirrored: u32::from(placement.mirrored),
        visible: u32::from(instance.visible),
        ..bytemuck::Zeroable::zeroed()
    }
}
