//! The stages of a frame on the GPU backend: what goes to the device, and what of its answer the
//! frame keeps.

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::bisect;
use super::device_shadows::{DeviceShadows, MarkedOnDevice, OnDevice, table};
use super::frame_shadows::FrameShadows;
use super::pass::INSTANCES;
use super::queue::Queue;
use super::renderer::{FrameContext, Rastered};
use super::shadows;
use super::stats::{FrameStats, StageStats};
use super::visibility_buffer::{ScratchPool, VisibilityBuffer};
use crate::config::{Output, Outputs, RenderOptions, Samples, Shadows};
use crate::cpu::instance_cull;
use crate::error::Result;
use crate::gpu::{
    Context, Counted, CullPass, DevicePage, DeviceRenderer, Drawn, SceneInstance, ViewRequest, Ways,
};
use crate::gpu_types::{
    self, InstanceMaterial, InstanceTransform, MATERIAL_COLOR_WORDS, MATERIAL_CONFORMAL, MATERIAL_SHADOWED,
    MATERIAL_SMOOTH, MATERIAL_UNLIT, SEEN_BY_LIGHTS, SEEN_BY_VIEWS, VisibleCluster,
};
use crate::model::ClusterAddress;
use crate::scene::environment::{GRIDS, Grid};
use crate::scene::placement::Eye;
use crate::scene::{Instance, Lighting, Scene, ShadeLight};
use crate::shadow::ShadowCache;
use crate::stages::Stage;
use crate::views::{InstanceView, Screen, Visible, mesh_bounds};

/// A device and what it knows of the scene drawn last.
#[derive(Debug)]
pub(super) struct Device {
    renderer: DeviceRenderer,
    /// The scene, and its clock then.
    known: Option<(u64, u64)>,
    /// Pages of shadow maps.
    shadows: ShadowCache<Arc<DevicePage>>,
}

impl Device {
    /// On the best device there is.
    pub(super) fn new() -> Result<Self> {
        Ok(Self { renderer: DeviceRenderer::new()?, known: None, shadows: ShadowCache::default() })
    }

    #[cfg(feature = "internals")]
    pub(super) fn renderer(&self) -> &DeviceRenderer {
        &self.renderer
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
            // The CPU draws the others.
            let drawn = instance.filter(|instance| !instance.needs_cpu());
            self.renderer.set(slot, drawn.map(scene_instance));
        }
        self.known = Some((scene.identity(), slots.clock()));
    }

    /// Draws the visible instances of a scene from several views, and makes what is asked for.
    pub(super) fn draw(
        &mut self,
        frame_contexts: &[FrameContext<'_>],
        scratch: &ScratchPool,
    ) -> Result<Vec<Rastered>> {
        let Some(FrameContext { scene, options, resident, .. }) = frame_contexts.first() else {
            return Ok(Vec::new());
        };
        self.update(scene);
        let RenderOptions { int64_atomics, raster, shading, cpu_from, .. } = *options;
        // What the CPU goes on with is of one pass.
        let occlusion = options.occlusion && bisect::on_device(options, Stage::Hzb);
        let waits = options.shadows != Shadows::Off && bisect::on_device(options, Stage::Shade);
        let ways = Ways { int64_atomics, occlusion, raster, shading, until: cpu_from, waits };
        let on_device = options.device_outputs.unwrap_or(!self.context().software());
        // Colour of several samples is their mean.
        let shaded = match options.samples {
            Samples::One => &[][..],
            _ => &[Output::Color, Output::Linear],
        };
        let outputs = |options: &RenderOptions| {
            let runs = |output: &Output| {
                let stage = if output.shaded() { Stage::Shade } else { Stage::Output };
                on_device && bisect::on_device(options, stage)
            };
            let outputs: Outputs = options.outputs.iter().filter(runs).collect();
            shaded.iter().fold(outputs, |outputs, shaded| outputs.without(*shaded))
        };
        let views = frame_contexts.iter().map(|frame_context| {
            let view =
                view_record(&frame_context.screen, &frame_context.eye, frame_context.options.pixel_error);
            let starts = occlusion && self.renderer.starts(frame_context.id, &view);
            gpu_types::View { occluders: if starts { occluders(frame_context) } else { 0 }, ..view }
        });
        let views: Vec<gpu_types::View> = views.collect();
        let picture = |FrameContext { screen, options, .. }: &FrameContext<'_>| {
            scratch.take(screen.width as usize * screen.height as usize, options.depth_only)
        };
        let mut pictures: Vec<VisibilityBuffer> = frame_contexts.iter().map(picture).collect();
        let requests =
            frame_contexts.iter().zip(views).zip(&mut pictures).map(|((frame_context, view), picture)| {
                ViewRequest {
                    id: frame_context.id,
                    view,
                    depth_only: frame_context.options.depth_only,
                    words: picture.bits(),
                    // Where the CPU is to make nothing of it now, the visibility buffer is read when it is. A device that
                    // is software has it in this memory, and reading it costs less than counting its pixels there. Of
                    // depth alone that is so where no depth is made.
                    keep_on_device: on_device
                        && cpu_from.is_none()
                        && (!frame_context.options.depth_only || frame_context.options.outputs.is_empty()),
                    outputs: outputs(&frame_context.options),
                    lighting: lighting_record(&frame_context.lighting),
                    lights: frame_context.lighting.lights.iter().map(light).collect(),
                    transfer: frame_context.lighting.transfer,
                    environment: frame_context
                        .lighting
                        .environment
                        .as_ref()
                        .map(|environment| Arc::clone(&environment.map)),
                }
            });
        let drawn = self.renderer.draw(&mut requests.collect::<Vec<_>>(), ways, resident)?;
        Ok(frame_contexts
            .iter()
            .zip(drawn)
            .zip(pictures)
            .map(|((frame_context, mut drawn), picture)| match drawn.visibility.take() {
                None => rastered(frame_context, drawn, picture, scratch, on_device),
                Some(left) => {
                    scratch.give(picture);
                    let picture = match frame_context.options.depth_only {
                        true => VisibilityBuffer::DepthOnDevice(left, OnceLock::new()),
                        false => VisibilityBuffer::OnDevice(left, OnceLock::new()),
                    };
                    rastered(frame_context, drawn, picture, scratch, on_device)
                }
            })
            .collect())
    }
}

impl Device {
    /// What marks pages of shadow maps there, and has the CPU draw them.
    pub(super) fn marks(&mut self) -> MarkedOnDevice<'_> {
        MarkedOnDevice(OnDevice(&mut self.renderer))
    }

    /// Gives frames the shadows that they look up, and makes the arrays that waited for them.
    pub(super) fn light_up(
        &mut self,
        frame_contexts: &[FrameContext<'_>],
        rastered: &mut [Rastered],
    ) -> Result<()> {
        let mut painter = OnDevice(&mut self.renderer);
        let lights = shadows::light_up(&mut painter, &mut self.shadows, frame_contexts, rastered)?;
        let shaded = frame_contexts.iter().all(|own| bisect::on_device(&own.options, Stage::Shade));
        if shaded {
            let tables: Vec<(u64, Vec<[u32; 4]>)> =
                frame_contexts.iter().zip(&lights).map(|(own, lights)| (own.id, table(lights))).collect();
            let (made, times) = self.renderer.shade(&tables)?;
            for ((own, made), frame_context) in rastered.iter_mut().zip(made).zip(frame_contexts) {
                own.made.extend(made);
                let Screen { width, height, .. } = frame_context.screen;
                let pixels = u64::from(width) * u64::from(height);
                let covered = own.stats.covered_pixels;
                let stats = times.iter().map(|(stage, _, ms)| {
                    let passed = if *stage == Stage::Shade { covered } else { pixels };
                    StageStats { stage: *stage, pass: 1, received: pixels, passed, ms: *ms }
                });
                own.stats.add(&stats.collect::<Vec<_>>());
            }
        }
        for (own, lights) in rastered.iter_mut().zip(lights) {
            own.shadows = Some(FrameShadows::Device(DeviceShadows::new(lights)));
        }
        Ok(())
    }
}

/// What a frame keeps of the device's answer.
fn rastered(
    frame_context: &FrameContext<'_>,
    mut drawn: Drawn,
    mut picture: VisibilityBuffer,
    scratch: &ScratchPool,
    on_device: bool,
) -> Rastered {
    let FrameContext { scene, eye, screen, resident, .. } = frame_context;
    let instances = scene.instances();
    let triangles = drawn.cull_passes.iter().map(|cull_pass| cull_pass.counters.triangles()).sum();
    let source_triangles = drawn.source_triangles;
    let mut stats = FrameStats { source_triangles, triangles, ..FrameStats::default() };
    let from = frame_context.options.cpu_from.filter(|from| *from < Stage::Hzb);
    // In scene order: each instance once.
    let mut slots: Vec<u32> = drawn.visible.iter().map(|v| v.instance).collect();
    slots.dedup();
    let slots = from.map_or(slots, |from| bisect::slots(from, &drawn));
    let there: Vec<(u32, &Instance)> =
        slots.into_iter().filter_map(|slot| Some((slot, instances.at(slot as usize)?))).collect();
    let view =
        |&(slot, instance): &(u32, &Instance)| InstanceView::new(eye, screen, slot, instance, resident);
    let mut views = scratch.take_views();
    there.par_iter().map(view).collect_into_vec(&mut views);
    let mut at = 0;
    let number = |v: &VisibleCluster| {
        at += usize::from(views.get(at).is_some_and(|view| view.slot != v.instance));
        Visible { instance: at as u32, cluster: ClusterAddress(v.cluster) }
    };
    let mut visible: Vec<Visible> = drawn.visible.iter().map(number).collect();
    let mut large: Vec<bool> = drawn.visible.iter().map(|v| v.large != 0).collect();
    let mut needs = std::mem::take(&mut drawn.needs);
    if let Some(from) = from {
        let (list, missed) = bisect::cull(from, frame_context, &drawn, &views);
        needs.merge(missed);
        bisect::raster(from, frame_context, &views, &list, &mut picture);
        visible = list.iter().map(|candidate| candidate.visible).collect();
        large = list.iter().map(|candidate| candidate.large).collect();
    }
    stats.covered_pixels = match picture {
        VisibilityBuffer::OnDevice(..) | VisibilityBuffer::DepthOnDevice(..) => {
            drawn.cull_passes.iter().map(|cull_pass| u64::from(cull_pass.counters.covered)).sum()
        }
        _ => picture.covered(),
    };
    stats.stages = stages(&drawn, instances.len() as u64, stats.covered_pixels, screen);
    stats.uploaded_bytes = drawn.uploaded_bytes;
    stats.uploaded_mesh_bytes = drawn.uploaded_mesh_bytes;
    stats.reduced_images = drawn.reduced_images;
    stats.raster = drawn.raster;
    stats.occluded_instances = drawn.cull_passes.iter().map(|cull_pass| cull_pass.hidden_instances).sum();
    stats.occluded_clusters = drawn.cull_passes.get(1).map_or(0, |second| second.counters.occluded.into());
    stats.drawn_hardware =
        drawn.cull_passes.iter().map(|cull_pass| u64::from(cull_pass.counters.drawn_hardware)).sum();
    // A device has made depth of the keys that it was to make it of.
    let made_here = !bisect::on_device(&frame_context.options, Stage::Output);
    // Where the CPU draws more, it does so behind that.
    if !scene.needs_cpu() && (!on_device || made_here || frame_context.options.outputs.is_empty()) {
        picture.measure(screen, &mut stats);
    }
    let made = drawn.made;
    Rastered {
        picture,
        views,
        visible,
        large,
        layers: None,
        made,
        light: None,
        layer: None,
        shadows: None,
        needs,
        stats,
    }
}

/// Batches of instances that the first pass of a first frame draws: in a city, one leaves more to the second pass than
/// it saves, and three are more than hide the rest.
const FIRST_BATCHES: usize = 2;

/// The key of the farthest of the nearest instances that could cover the occupied part of the picture; 0 where they
/// overlap too little.
fn occluders(frame_context: &FrameContext<'_>) -> u32 {
    let FrameContext { scene, view, eye, screen, resident, .. } = frame_context;
    let instances: Vec<(u32, &Instance)> = scene.instances().iter().collect();
    let views = instance_cull::run(&instances, view, eye, screen, resident);
    let keys = views.iter().map(|v| (v.footprint, v.footprint.near_key, false));
    let mut queue = Queue::new(keys, screen, INSTANCES);
    let nearest: Vec<u32> = (0..FIRST_BATCHES).flat_map(|_| queue.take()).collect();
    if queue.is_empty() { 0 } else { nearest.into_iter().min().unwrap_or(0) }
}

/// What each stage received and passed on, and its time by the device's clock.
fn stages(drawn: &Drawn, instances: u64, covered: u64, screen: &Screen) -> Vec<StageStats> {
    let pixels = u64::from(screen.width) * u64::from(screen.height);
    let texels = u64::from(screen.width.div_ceil(2)) * u64::from(screen.height.div_ceil(2));
    let mut out: Vec<StageStats> = Vec::new();
    for &(stage, cull_pass, ms) in &drawn.times {
        let pass = match cull_pass {
            CullPass::First => 1,
            CullPass::Second => 2,
        };
        if let Some(known) = out.iter_mut().find(|s| s.stage == stage && s.pass == pass) {
            known.ms += ms;
            continue;
        }
        let Some(Counted { starts, visited, groups, clusters, counters, .. }) =
            drawn.cull_passes.get(usize::from(pass) - 1)
        else {
            continue;
        };
        // A first pass that starts from a list leaves instances to the second and walks to no group; else the second lists
        // the groups of both.
        let (deferred, known) = match (&drawn.cull_passes[..], drawn.listed) {
            ([_, second], true) => (second.starts, if pass == 1 { *groups } else { 0 }),
            ([first, _], false) if pass == 2 => (0, first.groups),
            _ => (0, 0),
        };
        let (received, passed) = match stage {
            Stage::InstanceCull => (instances, starts + deferred),
            Stage::NodeCull => (*visited, groups.saturating_sub(known)),
            Stage::ClusterCull => (counters.visited_clusters.into(), *clusters),
            Stage::RasterSmall => (counters.triangles_small.into(), counters.drawn_small.into()),
            Stage::RasterLarge => (counters.triangles_large.into(), counters.drawn_large.into()),
            // They have no pass of their own.
            Stage::ShadowMark | Stage::ShadowRaster => continue,
            Stage::Hzb => (pixels * u64::from(counters.pyramid), texels * u64::from(counters.pyramid)),
            Stage::Shade => (pixels, covered),
            Stage::Output => (pixels, pixels),
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
        lod_widest: eye.lod_widest,
        focal: eye.focal,
        center: eye.center,
        inverse_focal: eye.inverse_focal,
        skew: eye.skew,
        mirrored: u32::from(eye.mirrored),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// An instance as shaders read it: all but where the mesh lies on the device.
pub fn instance_transform(instance: &Instance) -> InstanceTransform {
    let placement = instance.placement();
    let (center, extent) = mesh_bounds(&instance.mesh);
    InstanceTransform {
        linear: rows(&placement.linear, &placement.high),
        inverse: rows(&placement.inverse, &placement.low),
        center,
        lod_scale: placement.lod_scale,
        extent,
        double_sided: instance.materials.double_sided_bits(),
        alpha_tested: instance.materials.alpha_tested_bits(),
        rounding: placement.rounding,
        mirrored: u32::from(placement.mirrored),
        visible: seen_by(instance),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// Who sees an instance, see [`SEEN_BY_VIEWS`].
fn seen_by(instance: &Instance) -> u32 {
    match (instance.visible, instance.casts_shadows()) {
        (false, _) => 0,
        (true, false) => SEEN_BY_VIEWS,
        (true, true) => SEEN_BY_VIEWS | SEEN_BY_LIGHTS,
    }
}

fn scene_instance(instance: &Instance) -> SceneInstance<'_> {
    let plain = instance.materials.plain();
    let materials = if plain.is_some() { None } else { Some(&instance.materials) };
    SceneInstance {
        transform: instance_transform(instance),
        material: instance_material(instance),
        mesh: &instance.mesh,
        materials,
    }
}

fn instance_material(instance: &Instance) -> InstanceMaterial {
    let (placement, material) = (instance.placement(), instance.materials.of(0));
    let flag = |is: bool, bit: u32| if is { bit } else { 0 };
    InstanceMaterial {
        normal: rows(&placement.normal, &material.base_color),
        emissive: material.emissive,
        metallic: material.metallic,
        roughness: material.shaded_roughness(1.0),
        first_material: u32::MAX,
        flags: flag(instance.materials.smooth(), MATERIAL_SMOOTH)
            | flag(placement.conformal, MATERIAL_CONFORMAL)
            | (instance.mesh.layout().colors.words() as u32) << MATERIAL_COLOR_WORDS
            | flag(material.unlit, MATERIAL_UNLIT)
            | flag(instance.receives_shadows(), MATERIAL_SHADOWED),
        last_material: 0,
    }
}

fn light(light: &ShadeLight) -> gpu_types::Light {
    let shape = light.falloff;
    gpu_types::Light {
        vector: light.vector,
        point: u32::from(shape.is_some()),
        radiance: light.radiance,
        inverse_range: shape.map_or(0.0, |f| f.inverse_range),
        direction: shape.map_or([0.0; 3], |f| f.direction),
        cone_scale: shape.map_or(0.0, |f| f.cone_scale),
        cone_offset: shape.map_or(1.0, |f| f.cone_offset),
        unused: [0.0; 3],
    }
}

fn lighting_record(lighting: &Lighting) -> gpu_types::Lighting {
    let [red, green, blue] = lighting.background;
    let environment = lighting.environment.as_ref();
    let grids = environment.map_or([[0; 4]; GRIDS], |environment| {
        environment.map.grids().map(|Grid { side, start }| [side, start, 0, 0])
    });
    gpu_types::Lighting {
        ambient: lighting.ambient,
        lights: lighting.lights.len() as u32,
        behind: lighting.behind(),
        background: u32::from_le_bytes([red, green, blue, 0]),
        power: lighting.transfer.power(),
        shading: lighting.shading as u32,
        environment_visible: u32::from(environment.is_some_and(|environment| environment.background)),
        intensity: environment.map_or(0.0, |environment| environment.intensity),
        to_map: environment.map_or([[0.0; 4]; 3], |environment| rows(&environment.to_map, &[0.0; 3])),
        grids,
    }
}
