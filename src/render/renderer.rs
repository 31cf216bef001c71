//! The facade: checks what it is given, runs the stages in order, hands out the frame.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::assemblies::Expansion;
#[cfg(feature = "gpu")]
use super::device;
use super::frame::Frame;
use super::frame_shadows::FrameShadows;
use super::history::VisibilityHistory;
use super::layers;
use super::motion::Stance;
use super::pass::{self, FramePasses, Listed};
use super::shadows::{self, Host};
use super::stats::FrameStats;
use super::streaming;
#[cfg(feature = "gpu")]
use super::undrawn;
use super::visibility_buffer::{ScratchPool, VisibilityBuffer};
use crate::config::{Calibration, Output, Outputs, Raster, RenderOptions, Samples, Shadows};
use crate::cpu::hzb::Hzb;
use crate::cpu::instance_cull;
use crate::cpu::peel::Layers;
use crate::cpu::visibility::Pixel;
use crate::error::{Error, Result};
use crate::gpu_types::Array;
use crate::model::{InterruptCheck, UNINTERRUPTED};
use crate::scene::placement::Eye;
use crate::scene::{Camera, Instance, Lighting, Scene, View};
use crate::shadow::{ShadowCache, ShadowPage};
use crate::stages::{STAGES, Stage};
use crate::stream::{Needs, Resident, StreamOptions, Streamer};
use crate::views::desc::{check_ids, check_size};
use crate::views::{Histories, ViewDesc};
use crate::views::{InstanceView, Screen, Visible};

/// Frames that are drawn at most until all is there: more than levels, of which each makes the next one wanted.
const MOST_FRAMES: u64 = 64;

/// Where frames are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// The CPU twin of every stage.
    Cpu,
    /// A device of wgpu.
    Gpu,
}

impl Backend {
    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

/// What runs the culling and raster stages.
#[derive(Debug)]
enum Device {
    Cpu,
    #[cfg(feature = "gpu")]
    Gpu {
        device: Box<device::Device>,
        /// The caller did not ask for it: where it cannot draw a frame, the CPU does.
        replaceable: bool,
    },
}

impl Device {
    /// Resolves a requested backend; also says why it was taken.
    fn choose(name: &str) -> Result<(Self, String)> {
        match name {
            "cpu" => Ok((Self::Cpu, "asked for".to_owned())),
            "auto" => Ok(Self::automatic()),
            "gpu" => Self::gpu(),
            _ => {
                Err(Error::argument("backend", format!("must be \"auto\", \"cpu\" or \"gpu\", not {name:?}")))
            }
        }
    }

    #[cfg(feature = "gpu")]
    fn gpu() -> Result<(Self, String)> {
        let device = Box::new(device::Device::new()?);
        let reason = format!("asked for: {}", device.context().name());
        Ok((Self::Gpu { device, replaceable: false }, reason))
    }

    #[cfg(not(feature = "gpu"))]
    fn gpu() -> Result<(Self, String)> {
        let message = "this build has none; use \"cpu\" or \"auto\"".to_owned();
        Err(Error::Backend { backend: "gpu".to_owned(), message })
    }

    /// A GPU if there is one; a program on the CPU that acts as one is slower than the CPU twin.
    #[cfg(feature = "gpu")]
    fn automatic() -> (Self, String) {
        match device::Device::new() {
            Ok(device) if device.context().software() => {
                let reason = format!("the only adapter is software: {}", device.context().name());
                (Self::Cpu, reason)
            }
            Ok(device) => {
                let reason = format!("the best adapter: {}", device.context().name());
                (Self::Gpu { device: Box::new(device), replaceable: true }, reason)
            }
            Err(error) => (Self::Cpu, error.to_string()),
        }
    }

    #[cfg(not(feature = "gpu"))]
    fn automatic() -> (Self, String) {
        (Self::Cpu, "this build has no GPU backend".to_owned())
    }
}

/// A view that was asked for, checked.
#[derive(Clone, Debug)]
pub(super) struct DrawnView {
    /// See [`ViewDesc::id`].
    pub(super) id: u64,
    pub(super) view: View,
    /// Those of the call, with what the view has of its own.
    pub(super) options: RenderOptions,
}

/// What is to be drawn, and how.
pub(super) struct FrameContext<'a> {
    /// See [`ViewDesc::id`].
    pub(super) id: u64,
    pub(super) scene: &'a Scene,
    pub(super) view: View,
    pub(super) eye: Eye,
    pub(super) screen: Screen,
    pub(super) lighting: Lighting,
    /// Those of the call, with what the view has of its own.
    pub(super) options: RenderOptions,
    /// Which pages there are.
    pub(super) resident: &'a Resident,
}

impl<'a> FrameContext<'a> {
    fn new(scene: &'a Scene, DrawnView { id, view, options }: DrawnView, resident: &'a Resident) -> Self {
        let (eye, screen) = (Eye::new(&view), Screen::new(&view));
        let lighting = Lighting::new(scene, &view, options.shading, options.transfer);
        Self { id, scene, view, eye, screen, lighting, options, resident }
    }

    /// The same through points so far from the pixel centres, right and down. The cut is the same: only the picture moves.
    fn moved(&self, by: [f64; 2], options: RenderOptions) -> FrameContext<'a> {
        let center = std::array::from_fn(|k| (self.view.center[k] - by[k]) as f32);
        let Self { id, scene, view, eye, screen, lighting, resident, .. } = self;
        let (view, lighting) = (view.clone(), lighting.clone());
        FrameContext {
            id: *id,
            scene,
            view,
            eye: Eye { center, ..*eye },
            screen: *screen,
            lighting,
            options,
            resident,
        }
    }
}

/// What the culling and raster stages leave for those after them.
pub(super) struct Rastered {
    /// The visibility buffer, or depth.
    pub(super) picture: VisibilityBuffer,
    /// The frame's instances.
    pub(super) views: Vec<InstanceView>,
    /// The frame's visible list.
    pub(super) visible: Vec<Visible>,
    /// Which of it went to the large rasterizer.
    pub(super) large: Vec<bool>,
    /// What is blended, in front of that.
    pub(super) layers: Option<Layers>,
    /// What a device made besides.
    pub(super) made: Vec<(Output, Array)>,
    /// Colour before it is encoded, where each pixel has several samples: their mean.
    pub(super) light: Option<Vec<f32>>,
    /// The same of samples that show a mesh, times how many of all that are, and how many.
    pub(super) layer: Option<Vec<[f32; 4]>>,
    /// What is in the way of each light, where lights throw shadows.
    pub(super) shadows: Option<FrameShadows>,
    /// Streamed pages that it shows or misses.
    pub(super) needs: Needs,
    /// All but what makes arrays, and the time of the whole.
    pub(super) stats: FrameStats,
}

impl Rastered {
    /// Counts what was drawn.
    fn count(&mut self) {
        let stats = &mut self.stats;
        stats.clusters = self.visible.len() as u64;
        let drawn = |stage| stats.stages.iter().filter(|s| s.stage == stage).map(|s| s.passed).sum();
        (stats.drawn_small, stats.drawn_large) = (drawn(Stage::RasterSmall), drawn(Stage::RasterLarge));
    }
}

/// Renders scenes into pictures of one size. Buffers are kept between frames.
#[derive(Debug)]
pub struct Renderer {
    width: u32,
    height: u32,
    device: Device,
    reason: String,
    hzb: Hzb,
    /// What each view showed in its last frame, by its id, where the CPU draws.
    histories: Histories<VisibilityHistory>,
    scratch: ScratchPool,
    /// Pages of shadow maps.
    shadows: ShadowCache<Arc<ShadowPage>>,
    /// A scene and its clock when all pages of its meshes were in memory.
    loaded: Option<(u64, u64)>,
    /// Where everything was in the last frame of each view that took note.
    stances: Histories<Stance>,
    /// There when meshes in files are streamed.
    streamer: Option<Streamer>,
    /// See [`RenderOptions::cpu_from`], where a frame says nothing.
    cpu_from: Option<Stage>,
    /// The views of the call before, where it streamed.
    before: Vec<DrawnView>,
    /// What is drawn of a scene with assemblies.
    expansion: Option<Expansion>,
}

impl Renderer {
    /// A renderer of `width` × `height` pictures; `backend` is "auto", "cpu" or "gpu".
    pub fn new(width: u32, height: u32, backend: &str) -> Result<Self> {
        check_size(width, height)?;
        let (device, reason) = Device::choose(backend)?;
        let (hzb, histories, scratch) = (Hzb::default(), Histories::default(), ScratchPool::default());
        let (loaded, streamer, before) = (None, None, Vec::new());
        let cpu_from = cpu_from()?;
        Ok(Self {
            width,
            height,
            device,
            reason,
            hzb,
            histories,
            scratch,
            shadows: ShadowCache::default(),
            loaded,
            stances: Histories::default(),
            streamer,
            cpu_from,
            before,
            expansion: None,
        })
    }

    /// From now on, of meshes whose pages lie in files, those are read that frames need, into a pool of so many bytes; or again
    /// all.
    pub fn stream(&mut self, pool_bytes: Option<u64>) {
        let equal_pages = self.backend() == Backend::Gpu;
        let streamer = |pool_bytes| Streamer::new(StreamOptions { pool_bytes, equal_pages });
        self.streamer = pool_bytes.map(streamer);
    }

    /// What streams, if anything.
    pub fn streamer(&mut self) -> Option<&mut Streamer> {
        self.streamer.as_mut()
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The backend in use.
    pub fn backend(&self) -> Backend {
        match self.device {
            Device::Cpu => Backend::Cpu,
            #[cfg(feature = "gpu")]
            Device::Gpu { .. } => Backend::Gpu,
        }
    }

    /// Why that backend.
    pub fn backend_reason(&self) -> &str {
        &self.reason
    }

    /// How the device's rasterizers were chosen; absent before the first frame that left it open.
    pub fn calibration(&self) -> Option<&Calibration> {
        match &self.device {
            Device::Cpu => None,
            #[cfg(feature = "gpu")]
            Device::Gpu { device, .. } => device.context().calibration(),
        }
    }

    /// The device with what it knows of the last frame, on the GPU backend: for benchmarks.
    #[cfg(all(feature = "gpu", feature = "internals"))]
    pub fn on_device(&self) -> Option<&crate::gpu::DeviceRenderer> {
        match &self.device {
            Device::Cpu => None,
            Device::Gpu { device, .. } => Some(device.renderer()),
        }
    }

    /// Renders `scene` as `camera` sees it from the camera-to-world `pose`.
    pub fn render(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        pose: &[[f64; 4]; 4],
        options: &RenderOptions,
    ) -> Result<Frame> {
        let mut frames =
            self.render_views(scene, &[ViewDesc::new(0, *camera, *pose)], options, UNINTERRUPTED)?;
        frames.pop().ok_or_else(|| Error::Invariant("a view gave no frame".to_owned()))
    }

    /// Renders `scene` as several cameras see it, on a GPU in one submission: a frame for each, as if rendered alone. Times
    /// are of all together. Where it waits for pages in files, it asks `proceed`.
    pub fn render_views(
        &mut self,
        scene: &Scene,
        views: &[ViewDesc],
        options: &RenderOptions,
        proceed: InterruptCheck<'_>,
    ) -> Result<Vec<Frame>> {
        let expansion = self.expansion.take();
        if scene.assemblies() == 0 {
            return self.render_meshes(scene, views, options, proceed);
        }
        let size = (self.width, self.height);
        let spectator = |desc: &ViewDesc| Ok((desc.view(size)?, desc.options(options).pixel_error));
        let spectators: Vec<(View, f32)> = views.iter().map(spectator).collect::<Result<_>>()?;
        let mut expansion = expansion.unwrap_or_default();
        let stats = expansion.update(scene, &spectators, options.shadows != Shadows::Off)?;
        let frames = self.render_meshes(expansion.scene(), views, options, proceed);
        self.expansion = Some(expansion);
        let mut frames = frames?;
        for frame in &mut frames {
            frame.stats.total_ms += stats.ms;
            frame.stats.assemblies = Some(stats.clone());
        }
        Ok(frames)
    }

    /// The same of a scene whose assemblies are drawn as the meshes that stand for them.
    fn render_meshes(
        &mut self,
        scene: &Scene,
        views: &[ViewDesc],
        options: &RenderOptions,
        proceed: InterruptCheck<'_>,
    ) -> Result<Vec<Frame>> {
        // A device makes depth with what it draws, and all that is shaded later: where both are asked for, the CPU shades.
        let depth = |desc: &ViewDesc| desc.options(options).depth_only;
        let shaded = match options.shadows {
            Shadows::Off => None,
            Shadows::Virtual => views.iter().any(depth).then_some(Stage::Shade),
            // Cascades are the CPU's.
            Shadows::Cascaded => Some(Stage::ShadowMark),
        };
        // What a scene has that no device draws, the CPU draws over the device's picture, and goes on from there.
        let undrawn = scene.needs_cpu().then_some(Stage::ShadowMark);
        let cpu_from = [options.cpu_from.or(self.cpu_from), shaded, undrawn].into_iter().flatten().min();
        let options = &RenderOptions { cpu_from, ..options.clone() };
        options.validate()?;
        let start = Instant::now();
        check_ids(views)?;
        let size = (self.width, self.height);
        let checked = |desc: &ViewDesc| {
            let view = DrawnView { id: desc.id, view: desc.view(size)?, options: desc.options(options) };
            view.options.validate().map(|()| view)
        };
        let views: Vec<DrawnView> = views.iter().map(checked).collect::<Result<_>>()?;
        let mut frames = match self.streamer.take() {
            None => {
                self.load(scene, proceed)?;
                let resident = Resident::default();
                let frame_contexts = frame_contexts(scene, &views, &resident);
                let mut rastered = self.draw_lit(&frame_contexts)?;
                self.sample(&frame_contexts, &mut rastered)?;
                self.finish(frame_contexts, rastered)?
            }
            Some(mut streamer) => {
                let frames = self.streamed(&mut streamer, scene, &views, options, proceed);
                streamer.finish();
                self.streamer = Some(streamer);
                frames?
            }
        };
        if options.motion {
            self.note_motion(scene, &views, &mut frames);
        }
        let total_ms = start.elapsed().as_secs_f64() * 1e3;
        frames.iter_mut().for_each(|frame| frame.stats.total_ms = total_ms);
        Ok(frames)
    }

    /// Tells frames what they show as it was in the frames before, and takes note of it as it is.
    fn note_motion(&mut self, scene: &Scene, views: &[DrawnView], frames: &mut [Frame]) {
        for (view, frame) in views.iter().zip(frames) {
            let before = self.stances.take([view.id]).pop();
            frame.before = before.and_then(|stance| stance.of(scene, frame));
            self.stances.give([(view.id, Stance::new(scene, frame))]);
        }
        self.stances.trim(views.iter().map(|view| view.id));
    }

    /// Sees to it that all pages of the meshes of a scene are in memory.
    fn load(&mut self, scene: &Scene, proceed: InterruptCheck<'_>) -> Result<()> {
        let slots = scene.instances();
        // Once there, they stay.
        let since = self.loaded.filter(|loaded| loaded.0 == scene.identity()).map_or(0, |loaded| loaded.1);
        let mut new = slots.changed_since(since).filter_map(|(_, instance)| instance);
        new.try_for_each(|instance| instance.mesh.pages.load_all(proceed))?;
        self.loaded = Some((scene.identity(), slots.clock()));
        Ok(())
    }

    /// Draws what is there, and asks for what is not; where that is wished, until nothing is missing that could come.
    fn streamed(
        &mut self,
        streamer: &mut Streamer,
        scene: &Scene,
        views: &[DrawnView],
        options: &RenderOptions,
        proceed: InterruptCheck<'_>,
    ) -> Result<Vec<Frame>> {
        // Rounds of which the picture is not kept are without.
        let mut sampled = !options.wait || options.samples == Samples::One;
        loop {
            let meshes = scene.instances().iter().map(|(_, instance)| &instance.mesh);
            let resident = streamer.resident(meshes, options.wait, proceed)?;
            let frame_contexts = frame_contexts(scene, views, &resident);
            let mut rastered = self.draw_lit(&frame_contexts)?;
            if sampled {
                self.sample(&frame_contexts, &mut rastered)?;
            }
            let mut needs = Needs::default();
            rastered.iter_mut().for_each(|rastered| needs.merge(std::mem::take(&mut rastered.needs)));
            streaming::expected(scene, &self.before, views, &resident, &mut needs);
            let stats = streamer.request(&needs)?;
            let settled = stats.missing_pages == stats.refused_pages;
            let again = options.wait && !settled && stats.draws < MOST_FRAMES;
            if again || !sampled {
                rastered.into_iter().for_each(|rastered| self.scratch.give(rastered.picture));
                if again {
                    streamer.wait(proceed)?;
                }
                sampled |= !again;
                continue;
            }
            self.before = views.to_vec();
            let mut frames = self.finish(frame_contexts, rastered)?;
            frames.iter_mut().for_each(|frame| frame.stats.stream = Some(stats.clone()));
            return Ok(frames);
        }
    }

    /// The frames of what was drawn.
    fn finish(&self, frame_contexts: Vec<FrameContext<'_>>, rastered: Vec<Rastered>) -> Result<Vec<Frame>> {
        let frame = |(frame_context, rastered)| finished(frame_context, rastered, self.scratch.clone());
        frame_contexts.into_iter().zip(rastered).map(frame).collect()
    }

    /// Gives pixels of several samples the mean of what is seen through each, a frame for every place in a pixel. To
    /// stages it adds theirs.
    fn sample(&mut self, frame_contexts: &[FrameContext<'_>], rastered: &mut [Rastered]) -> Result<()> {
        let Some(FrameContext { options, .. }) = frame_contexts.first() else { return Ok(()) };
        let offsets = options.samples.offsets();
        let outputs: Outputs = [Output::Linear, Output::Depth].into_iter().collect();
        let share = 1.0 / offsets.len() as f32;
        for (number, by) in offsets.into_iter().enumerate() {
            let moved = frame_contexts.iter().map(|frame_context| {
                let options = frame_context.options.clone();
                frame_context.moved(by, RenderOptions { outputs, samples: Samples::One, ..options })
            });
            let moved: Vec<FrameContext<'_>> = moved.collect();
            let drawn = self.draw_lit(&moved)?;
            for ((frame_context, mut drawn), whole) in moved.into_iter().zip(drawn).zip(&mut *rastered) {
                whole.needs.merge(std::mem::take(&mut drawn.needs));
                let mut frame = finished(frame_context, drawn, self.scratch.clone())?;
                whole.stats.add(&frame.stats.stages);
                let new = Vec::from(frame.take(Output::Linear)?);
                let depth: Vec<f32> = frame.take(Output::Depth)?.into();
                let layer = whole.layer.get_or_insert_with(|| vec![[0.0; 4]; depth.len()]);
                match &frame.layer {
                    Some(own) => layers::add_layer(layer, own, share),
                    None => layers::add(layer, &new, &depth, share),
                }
                match &mut whole.light {
                    None => whole.light = Some(new),
                    Some(mean) => blend(mean, &new, 1.0 / (number + 1) as f32),
                }
            }
        }
        Ok(())
    }

    /// Draws frames, with the shadows that they look up.
    fn draw_lit(&mut self, frame_contexts: &[FrameContext<'_>]) -> Result<Vec<Rastered>> {
        let mut rastered = self.draw(frame_contexts)?;
        match self.light_up(frame_contexts, &mut rastered) {
            Err(error) if self.replace(&error) => {
                rastered = self.draw(frame_contexts)?;
                self.light_up(frame_contexts, &mut rastered)?;
            }
            lit => lit?,
        }
        Ok(rastered)
    }

    /// Has the CPU draw from now on, if the caller did not ask for the device that an error is of.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "there is no device to replace"))]
    fn replace(&mut self, error: &Error) -> bool {
        match &self.device {
            #[cfg(feature = "gpu")]
            Device::Gpu { replaceable: true, .. } if matches!(error, Error::Backend { .. }) => {
                (self.device, self.reason) = (Device::Cpu, error.to_string());
                true
            }
            _ => false,
        }
    }

    /// Gives frames the shadows that they look up.
    fn light_up(&mut self, frame_contexts: &[FrameContext<'_>], rastered: &mut [Rastered]) -> Result<()> {
        let Some(FrameContext { options, .. }) = frame_contexts.first() else { return Ok(()) };
        if options.shadows == Shadows::Off {
            return Ok(());
        }
        let lights = match &mut self.device {
            #[cfg(feature = "gpu")]
            Device::Gpu { device, .. } if options.cpu_from.is_none_or(|from| from > Stage::ShadowRaster) => {
                return device.light_up(frame_contexts, rastered);
            }
            #[cfg(feature = "gpu")]
            Device::Gpu { device, .. } if options.cpu_from == Some(Stage::ShadowRaster) => {
                let mut painter = device.marks();
                shadows::light_up(&mut painter, &mut self.shadows, frame_contexts, rastered)?
            }
            _ => shadows::light_up(&mut Host::new(options), &mut self.shadows, frame_contexts, rastered)?,
        };
        for (own, lights) in rastered.iter_mut().zip(lights) {
            own.shadows = Some(FrameShadows::Host(shadows::on_host(lights)));
        }
        Ok(())
    }

    /// The culling and raster stages, and on a device more.
    fn draw(&mut self, frame_contexts: &[FrameContext<'_>]) -> Result<Vec<Rastered>> {
        let mut drawn = self.draw_on_device(frame_contexts)?;
        for (frame_context, drawn) in frame_contexts.iter().zip(&mut drawn) {
            drawn.count();
            let mut needs = std::mem::take(&mut drawn.needs);
            streaming::drawn(drawn, frame_context.options.pixel_error, frame_context.resident, &mut needs);
            drawn.needs = needs;
        }
        Ok(drawn)
    }

    /// The same where there is a device, or else on the CPU.
    fn draw_on_device(&mut self, frame_contexts: &[FrameContext<'_>]) -> Result<Vec<Rastered>> {
        #[cfg(feature = "gpu")]
        if let Device::Gpu { device, .. } = &mut self.device
            && frame_contexts.iter().all(|own| own.options.cpu_from != Some(Stage::InstanceCull))
        {
            match device.draw(frame_contexts, &self.scratch) {
                Err(error) if self.replace(&error) => {}
                Err(error) => return Err(error),
                Ok(mut drawn) => {
                    let left = frame_contexts.iter().zip(&mut drawn).filter(|(own, _)| own.scene.needs_cpu());
                    for (frame_context, drawn) in left {
                        undrawn::draw(frame_context, drawn, &mut self.hzb)?;
                    }
                    return Ok(drawn);
                }
            }
        }
        let drawn = frame_contexts.iter().map(|frame_context| self.draw_on_cpu(frame_context)).collect();
        self.histories.trim(frame_contexts.iter().map(|frame_context| frame_context.id));
        drawn
    }

    fn draw_on_cpu(&mut self, frame_context: &FrameContext<'_>) -> Result<Rastered> {
        let FrameContext { id, scene, view, eye, screen, options, resident, .. } = frame_context;
        let pixels = screen.width as usize * screen.height as usize;
        let mut picture = self.scratch.take(pixels, options.depth_only);
        let mut stats = FrameStats { raster: Raster::Compute, ..FrameStats::default() };
        let instances: Vec<(u32, &Instance)> = scene.instances().iter().collect();
        let views = stats.time(Stage::InstanceCull, 1, || {
            let views = instance_cull::run(&instances, view, eye, screen, resident);
            let count = views.len() as u64;
            (views, instances.len() as u64, count)
        });
        stats.source_triangles = views.iter().map(|v| v.mesh.source_faces).sum();
        let new = || Ok::<_, Error>(VisibilityHistory::default());
        let (hzb, history) = (&mut self.hzb, self.histories.get_or_make(*id, new)?);
        let Listed { list, absent, blended } = match &mut picture {
            VisibilityBuffer::Words(words) => raster(frame_context, &views, words, hzb, history, &mut stats)?,
            depth => raster(frame_context, &views, depth.bits(), hzb, history, &mut stats)?,
        };
        let layers = pass::peel(frame_context, &picture, &views, &blended, &mut stats);
        stats.covered_pixels = picture.covered();
        picture.measure(screen, &mut stats);
        let visible: Vec<Visible> = list.iter().map(|c| c.visible).collect();
        stats.triangles = pass::triangles(&list);
        let large = list.iter().map(|c| c.large).collect();
        let needs = streaming::missed(&absent, &views);
        Ok(Rastered {
            picture,
            views,
            visible,
            large,
            layers,
            made: Vec::new(),
            light: None,
            layer: None,
            shadows: None,
            needs,
            stats,
        })
    }
}

/// The variable of the environment that says from which stage on the CPU draws, see [`RenderOptions::cpu_from`].
const CPU_FROM: &str = "NANITE_CPU_FROM";

fn cpu_from() -> Result<Option<Stage>> {
    let Ok(name) = std::env::var(CPU_FROM) else { return Ok(None) };
    let names = STAGES.map(Stage::name).join(", ");
    let unknown = || Error::argument(CPU_FROM, format!("must be one of {names}, not {name:?}"));
    Stage::of_name(&name).map(Some).ok_or_else(unknown)
}

/// What is to be drawn from each view.
fn frame_contexts<'a>(
    scene: &'a Scene,
    views: &[DrawnView],
    resident: &'a Resident,
) -> Vec<FrameContext<'a>> {
    views.iter().map(|view| FrameContext::new(scene, view.clone(), resident)).collect()
}

/// Culls and draws into pixels of one kind or the other.
fn raster<P: Pixel>(
    frame_context: &FrameContext<'_>,
    views: &[InstanceView],
    pixels: &mut [P],
    hzb: &mut Hzb,
    history: &mut VisibilityHistory,
    stats: &mut FrameStats,
) -> Result<Listed> {
    let mut pass = FramePasses::new(frame_context, views, pixels, stats);
    let list = pass.draw_scene(frame_context.options.occlusion, hzb, history)?;
    Ok(pass.listed(list))
}

/// Moves numbers by a part of the way to others: nowhere, exactly, where they are equal.
fn blend(numbers: &mut [f32], others: &[f32], part: f32) {
    let towards = |(own, other): (&mut f32, &f32)| *own += (*other - *own) * part;
    numbers.par_iter_mut().with_min_len(1 << 14).zip(others).for_each(towards);
}

/// The frame of what was drawn, with the arrays asked for.
fn finished(frame_context: FrameContext<'_>, rastered: Rastered, scratch: ScratchPool) -> Result<Frame> {
    let Rastered { picture, views, visible, large, layers, made, light, layer, shadows, mut stats, .. } =
        rastered;
    let FrameContext { scene, view, eye, screen, lighting, options, .. } = frame_context;
    stats.samples = options.samples as u32;
    let mut frame = Frame {
        picture,
        visible,
        large,
        views,
        owners: Arc::clone(scene.owners()),
        screen,
        view,
        eye,
        lighting,
        light,
        layer,
        shadows,
        before: None,
        tells_motion: options.motion,
        made,
        scratch,
        stats,
    };
    // Where there are several samples, their mean is there.
    if let (Some(layers), None) = (&layers, &frame.light) {
        frame.blend(layers)?;
    }
    frame.name_owners();
    if let Some(layers) = layers.filter(|_| options.transparent_ids) {
        frame.show_layers(layers);
        frame.stats.covered_pixels = frame.picture.covered();
    }
    frame.finish(options.outputs)?;
    Ok(frame)
}

#[cfg(test)]
#[cfg(feature = "gpu")]
mod tests {
    use std::io::Write;
    use std::sync::Arc;

    use super::*;
    use crate::build::{Silent, build};
    use crate::config::BuildOptions;
    use crate::mesh::{Positions, SourceMesh};
    use crate::scene::{Material, Projection};

    /// No other test of this binary uses the device, which this one leaves without memory.
    #[test]
    fn where_an_automatic_device_cannot_the_cpu_draws() {
        let test = "where_an_automatic_device_cannot_the_cpu_draws";
        let mut renderer = match Renderer::new(8, 8, "gpu") {
            Ok(renderer) => renderer,
            Err(error) => {
                println!("skipped {test}: {error}");
                if let Some(path) = std::env::var_os("NANITE_SKIPS") {
                    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
                    writeln!(file.unwrap(), "{test}\t{error}").unwrap();
                }
                return;
            }
        };
        let positions = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]];
        let source = SourceMesh::new(Positions::F32(&positions), &[[0, 1, 2]]);
        let mesh = Arc::new(build(&source, &BuildOptions::default(), &Silent).unwrap());
        let mut scene = Scene::new();
        let pose = glam::DMat4::from_translation(glam::DVec3::new(0.0, 0.0, -3.0));
        let rows = pose.transpose().to_cols_array_2d();
        scene.add(mesh, &rows, Material::default()).unwrap();
        let projection = Projection::Perspective { yfov: 0.8, aspect: None };
        let camera = Camera { projection, znear: 0.05, zfar: None };
        let pose = glam::DMat4::IDENTITY.to_cols_array_2d();
        let options = RenderOptions::default();
        let expected = Renderer::new(8, 8, "cpu").unwrap().render(&scene, &camera, &pose, &options).unwrap();
        let mut draw = |automatic: bool| {
            let Device::Gpu { device, replaceable } = &mut renderer.device else { panic!("no device") };
            *replaceable = automatic;
            device.context().limit_memory(0);
            let frame = renderer.render(&scene, &camera, &pose, &options);
            (frame, renderer.backend(), renderer.backend_reason().to_owned())
        };
        let (refused, backend, _) = draw(false);
        assert!(matches!(refused, Err(Error::Backend { .. })) && backend == Backend::Gpu);
        let (frame, backend, reason) = draw(true);
        assert!(backend == Backend::Cpu && reason.contains("is out of memory: "), "{reason}");
        let frame = frame.unwrap();
        assert!(frame.words().unwrap() == expected.words().unwrap() && frame.stats.covered_pixels > 0);
    }
}
