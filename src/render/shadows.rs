//! Shadows of a call's frames: the pages that their pixels may look up, of which those that are not there are drawn. All views
//! of a call share the pages of a light. Who finds and draws pages is a [`Painter`]: the CPU here, a device in `device_shadows`.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::renderer::{FrameContext, Rastered};
use super::stats::{Cascade, ShadowStats, StageStats};
use super::streaming;
use crate::config::{RenderOptions, Shadows as Kind};
use crate::cpu::peel::Layers;
use crate::cpu::shadow_cascades::{self, Prisms};
use crate::cpu::shadow_mark::{self, Marker};
use crate::cpu::shadow_mask::Walls;
use crate::cpu::shadow_pages::{LightShadow, Shadows};
use crate::cpu::shadow_raster::{self, Cascaded};
use crate::cpu::surface::Pixels;
use crate::error::{Error, Result};
use crate::limits::SHADOW_CASCADES;
use crate::scene::{Light, Scene};
use crate::shadow::cache::PAGE_BYTES;
use crate::shadow::receiver::{RelativePage, texel_of};
use crate::shadow::{Lamp, LightView, PageKey, ShadowCache, ShadowMap, ShadowPage};
use crate::stages::Stage;
use crate::stream::{Needs, Resident};
use crate::views::Screen;

/// Levels by which shadows are made coarser at most.
const COARSEST: i32 = 16;

/// The maps of a frame's lights as it looks them up; none where a light throws no shadow.
pub(super) type LightViews = Vec<Option<LightView>>;

/// Where everything is that is visible.
struct Extent {
    low: DVec3,
    high: DVec3,
}

impl Extent {
    fn new(scene: &Scene) -> Self {
        let spheres = || {
            let instances = scene.instances().iter().filter(|(_, instance)| instance.visible);
            instances.map(|(_, instance)| instance.sphere())
        };
        let bound = |sign: f64| {
            let corners = spheres().map(|(center, radius)| sign * center + DVec3::splat(radius));
            corners.reduce(DVec3::max).unwrap_or(DVec3::ZERO)
        };
        Self { low: -bound(-1.0), high: bound(1.0) }
    }

    /// A power of two above its diameter, so that it seldom changes.
    fn size(&self) -> f64 {
        let across = (self.high - self.low).length();
        if across > 0.0 && across.is_finite() { 2f64.powi(across.log2().ceil() as i32) } else { 1.0 }
    }

    /// How far it reaches along an axis, from a place.
    fn above(&self, from: DVec3, axis: DVec3) -> f64 {
        let most = (axis * (self.low - from)).max(axis * (self.high - from));
        most.element_sum()
    }
}

/// What was painted.
#[derive(Debug)]
pub(super) struct Painted<P> {
    /// Pages, and whether nothing stands in them for what is not there.
    pub(super) pages: Vec<(PageKey, P, bool)>,
    /// Clusters, each once for every page that it may touch.
    pub(super) clusters: u64,
    /// Instances that cast nothing that is looked up, or that others hide from the light.
    pub(super) culled_instances: u64,
    /// Clusters of others of which the same is true.
    pub(super) culled_clusters: u64,
    /// Pages of meshes that were not there.
    pub(super) needs: Needs,
}

/// What pages are drawn from.
pub(super) struct Casters<'a> {
    pub(super) maps: &'a FxHashMap<u32, ShadowMap>,
    pub(super) scene: &'a Scene,
    pub(super) resident: &'a Resident,
    /// Whether those are left out that do not matter.
    pub(super) occlusion: bool,
}

/// Finds which pages are wanted, and draws them.
pub(super) trait Painter {
    /// What a page is held by.
    type Page: Clone;

    /// Fits cascades to what a frame shows, where lights have such.
    fn fit(&mut self, _: &FrameContext<'_>, _: &Rastered, _: &mut LightViews) -> Result<()> {
        Ok(())
    }

    /// The pages that pixels of a frame may look up, as its lights' views say; each at least once.
    fn mark(
        &mut self,
        frame_context: &FrameContext<'_>,
        rastered: &Rastered,
        lights: &[LightView],
    ) -> Result<FxHashSet<PageKey>>;

    /// Takes in how frames look maps up, once that is known.
    fn see(&mut self, _: &[LightViews]) {}

    /// Triangles of the light's cut that were drawn of a page.
    fn triangles(page: &Self::Page) -> u32;

    /// Pages that it has room for, however much memory there may be.
    fn most(&self) -> usize;

    /// Draws pages, which are sorted by block, beside those that are held. There is room for `most`.
    fn paint(
        &mut self,
        pages: &[PageKey],
        casters: &Casters<'_>,
        held: &ShadowCache<Self::Page>,
        most: usize,
    ) -> Result<Painted<Self::Page>>;
}

/// The maps of a frame's lights, and what its pixels look up in them.
#[derive(Debug)]
pub(super) struct FrameLight<P> {
    pub(super) view: LightView,
    pub(super) pages: Vec<(RelativePage, P)>,
    /// Those of them that were drawn for this frame.
    pub(super) drawn: FxHashSet<RelativePage>,
}

/// One for each light of a frame, or none where a light throws no shadow.
pub(super) type FrameLights<P> = Vec<Option<FrameLight<P>>>;

/// The CPU.
#[derive(Default)]
pub(super) struct Host {
    /// Of cascades: they are drawn for this frame alone.
    cascaded: Option<ForFrame>,
}

/// What is known of what a frame looks up in cascades.
#[derive(Default)]
struct ForFrame {
    /// By frames; none of depth alone.
    prisms: Vec<Option<Prisms>>,
    walls: Walls,
    /// Layers look something up, too, that is not known.
    layered: bool,
}

impl Host {
    /// For frames of these options.
    pub(super) fn new(options: &RenderOptions) -> Self {
        let cascaded = (options.shadows == Kind::Cascaded).then(ForFrame::default);
        Self { cascaded }
    }
}

/// The receivers of a frame that are opaque.
fn marker<'a>(frame_context: &'a FrameContext<'_>, rastered: &'a Rastered) -> Result<Marker<'a>> {
    let Rastered { picture, visible, views, .. } = rastered;
    let pixels = Pixels { words: picture.words("shadow")?, visible, views, screen: &frame_context.screen };
    Ok(Marker::new(pixels, &frame_context.eye))
}

/// Those of the layers in front of them.
fn layers<'a>(
    frame_context: &'a FrameContext<'_>,
    rastered: &'a Rastered,
) -> impl Iterator<Item = Marker<'a>> {
    let Rastered { views, layers, .. } = rastered;
    let of = |layers: &'a Layers| {
        layers.words.iter().map(|words| {
            let pixels = Pixels { words, visible: &layers.visible, views, screen: &frame_context.screen };
            Marker::new(pixels, &frame_context.eye)
        })
    };
    layers.iter().flat_map(of)
}

impl Painter for Host {
    type Page = Arc<ShadowPage>;

    fn fit(
        &mut self,
        frame_context: &FrameContext<'_>,
        rastered: &Rastered,
        views: &mut LightViews,
    ) -> Result<()> {
        if let Some(for_frame) = &mut self.cascaded {
            for_frame.layered |= rastered.layers.is_some();
            let mut lights: Vec<&mut LightView> =
                views.iter_mut().flatten().filter(|view| view.parallel()).collect();
            // One of depth alone looks nothing up.
            let prisms = match frame_context.options.depth_only {
                true => None,
                false => Some(shadow_cascades::run(&marker(frame_context, rastered)?, &mut lights)),
            };
            for_frame.prisms.push(prisms);
        }
        Ok(())
    }

    fn mark(
        &mut self,
        frame_context: &FrameContext<'_>,
        rastered: &Rastered,
        lights: &[LightView],
    ) -> Result<FxHashSet<PageKey>> {
        let mut wanted = shadow_mark::run(&marker(frame_context, rastered)?, lights);
        layers(frame_context, rastered).for_each(|marker| wanted.extend(shadow_mark::run(&marker, lights)));
        Ok(wanted)
    }

    fn see(&mut self, views: &[LightViews]) {
        let Some(ForFrame { prisms, walls, .. }) = &mut self.cascaded else { return };
        for (prisms, views) in prisms.iter().zip(views) {
            let lights = views.iter().flatten().filter(|view| view.parallel()).enumerate();
            // Rays to lights with a size come by elsewhere, too.
            for (number, light) in lights.filter(|(_, light)| !light.soft()) {
                prisms.iter().for_each(|prisms| prisms.walls(number, light, walls));
            }
        }
    }

    fn triangles(page: &Self::Page) -> u32 {
        page.triangles()
    }

    fn most(&self) -> usize {
        usize::MAX
    }

    fn paint(
        &mut self,
        pages: &[PageKey],
        casters: &Casters<'_>,
        held: &ShadowCache<Self::Page>,
        _: usize,
    ) -> Result<Painted<Self::Page>> {
        let Casters { maps, scene, resident, occlusion } = *casters;
        let streams = || scene.instances().iter().any(|(_, instance)| resident.streams(&instance.mesh));
        let cascaded = self.cascaded.as_ref().map(|for_frame| Cascaded {
            walls: (occlusion && !for_frame.layered).then_some(&for_frame.walls),
            // What a page of a streamed mesh hid may show where that is not there any more.
            seen: (!streams()).then_some(held),
        });
        let mut out = Painted {
            pages: Vec::new(),
            clusters: 0,
            culled_instances: 0,
            culled_clusters: 0,
            needs: Needs::default(),
        };
        for block in shadow_raster::run(pages, maps, scene, resident, cascaded, occlusion) {
            out.culled_instances += block.culled_instances;
            out.culled_clusters += block.culled_clusters;
            out.clusters += block.clusters;
            out.needs.merge(streaming::missed(&block.absent, &block.views));
            out.pages.extend(block.pages);
        }
        Ok(out)
    }
}

/// What frames of the CPU look up.
pub(super) fn on_host(lights: FrameLights<Arc<ShadowPage>>) -> Shadows {
    let light =
        |FrameLight { view, pages, drawn }| LightShadow { view, pages: pages.into_iter().collect(), drawn };
    lights.into_iter().map(|own| own.map(light)).collect()
}

/// Sees to it that the pages are there which the frames of a call look up, and says which.
pub(super) fn light_up<B: Painter>(
    painter: &mut B,
    cache: &mut ShadowCache<B::Page>,
    frame_contexts: &[FrameContext<'_>],
    rastered: &mut [Rastered],
) -> Result<Vec<FrameLights<B::Page>>> {
    let Some(FrameContext { scene, resident, options, .. }) = frame_contexts.first() else {
        return Ok(Vec::new());
    };
    let mut stats = ShadowStats::default();
    let extent = Extent::new(scene);
    let size = extent.size();
    let visible = || scene.lights().iter().filter(|(_, light)| light.visible);
    let maps: FxHashMap<u32, ShadowMap> =
        visible().filter_map(|(slot, light)| Some((slot, ShadowMap::new(light, size)?))).collect();
    stats.invalidated = cache.update(scene, &maps, resident);
    let mut views: Vec<LightViews> = frame_contexts
        .iter()
        .map(|own| {
            let view = |(slot, light): (u32, &Light)| {
                let map = maps.get(&slot)?;
                let top = extent.above(own.view.eye(), map.axes.z_axis);
                let lamp = Lamp::new(light.radius, top, options.shadow_samples);
                Some(LightView::new(slot, map, &own.view, own.options.pixel_error, size, lamp))
            };
            visible().map(view).collect()
        })
        .collect();
    let most = ((options.shadow_memory / PAGE_BYTES).max(1) as usize).min(painter.most());
    let start = Instant::now();
    for ((own, drawn), views) in frame_contexts.iter().zip(&*rastered).zip(&mut views) {
        painter.fit(own, drawn, views)?;
    }
    let (views, wanted) = mark(painter, frame_contexts, rastered, &views, most)?;
    painter.see(&views);
    stats.coarser = views.iter().flatten().flatten().map(|view| view.coarser as u32).max().unwrap_or(0);
    stats.mark_ms = ms(start);
    let start = Instant::now();
    let missing = cache.want(&wanted);
    stats.evicted = cache.make_room(&missing, most);
    (stats.wanted, stats.drawn) = (wanted.len() as u64, missing.len() as u64);
    let casters = Casters { maps: &maps, scene, resident, occlusion: options.occlusion };
    let painted = painter.paint(&missing, &casters, cache, most)?;
    stats.clusters = painted.clusters;
    stats.triangles = painted.pages.iter().map(|(_, page, _)| u64::from(B::triangles(page))).sum();
    (stats.culled_instances, stats.culled_clusters) = (painted.culled_instances, painted.culled_clusters);
    if let Some(first) = rastered.first_mut() {
        first.needs.merge(painted.needs);
    }
    for (key, page, whole) in painted.pages {
        let partial = options.shadows == Kind::Cascaded && maps[&key.light].parallel();
        cache.insert(key, page, whole, partial);
    }
    stats.kept = cache.len() as u64;
    stats.draw_ms = ms(start);
    for ((own, views), frame_context) in rastered.iter_mut().zip(&views).zip(frame_contexts) {
        let Screen { width, height, .. } = frame_context.screen;
        let pixels = u64::from(width) * u64::from(height);
        let of_stage = |stage, received, passed, ms| StageStats { stage, pass: 1, received, passed, ms };
        own.stats.add(&[
            of_stage(Stage::ShadowMark, pixels, stats.wanted, stats.mark_ms),
            of_stage(Stage::ShadowRaster, stats.drawn, stats.triangles, stats.draw_ms),
        ]);
        own.stats.shadows = Some(ShadowStats { cascades: cascades(views), ..stats.clone() });
    }
    let light = |view: LightView| {
        let pages = wanted.iter().filter_map(|key| Some((view.relative(key)?, cache.page(key)?.clone())));
        let drawn = missing.iter().filter_map(|key| view.relative(key));
        FrameLight { pages: pages.collect(), drawn: drawn.collect(), view }
    };
    Ok(views.into_iter().map(|views| views.into_iter().map(|view| view.map(light)).collect()).collect())
}

/// The cascades of a view that show something.
fn cascades(views: &LightViews) -> Vec<Cascade> {
    let of_light = |(light, view): (usize, &Option<LightView>)| {
        let view = view.as_ref()?;
        let cascades = view.cascades?;
        let cascade = |number: usize| {
            let texel = texel_of(view.cascade_level(&cascades, number));
            Cascade { light, range: cascades.splits.range(number), texel }
        };
        let shown = (0..SHADOW_CASCADES).map(cascade).filter(|cascade| cascade.range[0] < cascade.range[1]);
        Some(shown.collect::<Vec<_>>())
    };
    views.iter().enumerate().filter_map(of_light).flatten().collect()
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// The pages that frames may want, in their order: at most as many as there is room for. And the views that say so, all as much
/// coarser as that takes.
fn mark<B: Painter>(
    painter: &mut B,
    frame_contexts: &[FrameContext<'_>],
    rastered: &[Rastered],
    views: &[LightViews],
    most: usize,
) -> Result<(Vec<LightViews>, Vec<PageKey>)> {
    let mut least = 0;
    for coarser in 0..=COARSEST {
        let mut wanted: FxHashSet<PageKey> = FxHashSet::default();
        let of_view = |view: &Option<LightView>| view.as_ref().map(|view| view.made_coarser(coarser));
        let views: Vec<LightViews> = views.iter().map(|views| views.iter().map(of_view).collect()).collect();
        for ((own, drawn), views) in frame_contexts.iter().zip(rastered).zip(&views) {
            if own.options.depth_only {
                continue;
            }
            let lights: Vec<LightView> = views.iter().flatten().cloned().collect();
            if lights.is_empty() {
                continue;
            }
            wanted.extend(painter.mark(own, drawn, &lights)?);
        }
        least = wanted.len();
        if least <= most {
            let mut wanted: Vec<PageKey> = wanted.into_iter().collect();
            wanted.sort_unstable_by_key(|key| (key.block(), *key));
            return Ok((views, wanted));
        }
    }
    let message =
        format!("{least} pages of 64 KiB are the least that the lights of the scene take, not {most}");
    Err(Error::argument("shadow_memory", message))
}
