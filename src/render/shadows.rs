//! Shadows of a call's frames: the pages that their pixels may look up, of which those that are not there are drawn. All views
//! of a call share the pages of a light.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::renderer::{FrameContext, Rastered};
use super::stats::{Cascade, ShadowStats};
use super::streaming;
use crate::config::Shadows;
use crate::cpu::shadow_cascades;
use crate::cpu::shadow_mark::{self, Marker};
use crate::cpu::shadow_mask::Walls;
use crate::cpu::shadow_pages::LightShadow;
use crate::cpu::shadow_raster::{self, Cascaded};
use crate::cpu::surface::Pixels;
use crate::error::{Error, Result};
use crate::limits::SHADOW_CASCADES;
use crate::scene::{Light, Scene};
use crate::shadow::cache::PAGE_BYTES;
use crate::shadow::receiver::texel_of;
use crate::shadow::{Lamp, LightView, PageKey, ShadowCache, ShadowMap};

/// Levels by which shadows are made coarser at most.
const COARSEST: i32 = 16;

/// The maps of a frame's lights as it looks them up; none where a light throws no shadow.
type LightViews = Vec<Option<LightView>>;

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

/// Lights up the frames of a call.
pub(super) fn light_up(
    cache: &mut ShadowCache,
    frame_contexts: &[FrameContext<'_>],
    rastered: &mut [Rastered],
) -> Result<()> {
    let Some(FrameContext { scene, resident, options, .. }) = frame_contexts.first() else { return Ok(()) };
    if options.shadows == Shadows::Off {
        return Ok(());
    }
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
    let most = (options.shadow_memory / PAGE_BYTES).max(1) as usize;
    let start = Instant::now();
    let markers = markers(frame_contexts, rastered)?;
    let cascaded = options.shadows == Shadows::Cascaded;
    let mut prisms = Vec::new();
    if cascaded {
        let fit = |(marker, views): (&Option<Marker<'_>>, &mut LightViews)| {
            let mut lights: Vec<&mut LightView> =
                views.iter_mut().flatten().filter(|view| view.parallel()).collect();
            marker.as_ref().map(|marker| shadow_cascades::run(marker, &mut lights))
        };
        prisms = markers.iter().zip(&mut views).map(fit).collect();
    }
    let (views, wanted) = mark(&markers, &views, most)?;
    let mut walls = Walls::default();
    for (prisms, views) in prisms.iter().zip(&views) {
        let lights = views.iter().flatten().filter(|view| view.parallel()).enumerate();
        // Rays to lights with a size come by elsewhere, too.
        for (number, light) in lights.filter(|(_, light)| !light.soft()) {
            prisms.iter().for_each(|prisms| prisms.walls(number, light, &mut walls));
        }
    }
    stats.coarser = views.iter().flatten().flatten().map(|view| view.coarser as u32).max().unwrap_or(0);
    stats.mark_ms = ms(start);
    let start = Instant::now();
    let missing = cache.want(&wanted);
    stats.evicted = cache.make_room(&missing, most);
    (stats.wanted, stats.drawn) = (wanted.len() as u64, missing.len() as u64);
    let streams = || scene.instances().iter().any(|(_, instance)| resident.streams(&instance.mesh));
    let for_frame = cascaded.then(|| Cascaded {
        walls: options.occlusion.then_some(&walls),
        // What a page of a streamed mesh hid may show where that is not there any more.
        seen: (!streams()).then_some(&*cache),
    });
    for block in shadow_raster::run(&missing, &maps, scene, resident, for_frame) {
        stats.culled_instances += block.culled_instances;
        stats.culled_clusters += block.culled_clusters;
        stats.clusters += block.clusters;
        stats.triangles += block.triangles;
        if let Some(first) = rastered.first_mut() {
            first.needs.merge(streaming::missed(&block.absent, &block.views));
        }
        for (key, texels, whole) in block.pages {
            cache.insert(key, texels, whole, cascaded && maps[&key.light].parallel());
        }
    }
    stats.kept = cache.len() as u64;
    stats.draw_ms = ms(start);
    for (own, views) in rastered.iter_mut().zip(views) {
        let shadow = |view: LightView| {
            let pages =
                wanted.iter().filter_map(|key| Some((view.relative(key)?, Arc::clone(cache.page(key)?))));
            let drawn = missing.iter().filter_map(|key| view.relative(key));
            LightShadow { pages: pages.collect(), drawn: drawn.collect(), view }
        };
        let cascades = cascades(&views);
        own.shadows = Some(views.into_iter().map(|view| view.map(shadow)).collect());
        own.stats.shadows = Some(ShadowStats { cascades, ..stats.clone() });
    }
    Ok(())
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// The receivers of frames; none of one of depth alone.
fn markers<'a>(
    frame_contexts: &'a [FrameContext<'_>],
    rastered: &'a [Rastered],
) -> Result<Vec<Option<Marker<'a>>>> {
    let marker = |(own, drawn): (&'a FrameContext<'_>, &'a Rastered)| {
        if own.options.depth_only {
            return Ok(None);
        }
        let Rastered { visible, views, .. } = drawn;
        let pixels = Pixels { words: drawn.picture.words("shadow")?, visible, views, screen: &own.screen };
        Ok(Some(Marker::new(pixels, &own.eye)))
    };
    frame_contexts.iter().zip(rastered).map(marker).collect()
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

/// The pages that frames may want, in their order: at most as many as there is room for. And the views that say so, all as much
/// coarser as that takes.
fn mark(
    markers: &[Option<Marker<'_>>],
    views: &[LightViews],
    most: usize,
) -> Result<(Vec<LightViews>, Vec<PageKey>)> {
    let mut least = 0;
    for coarser in 0..=COARSEST {
        let mut wanted: FxHashSet<PageKey> = FxHashSet::default();
        let of_view = |view: &Option<LightView>| view.as_ref().map(|view| view.made_coarser(coarser));
        let views: Vec<LightViews> = views.iter().map(|views| views.iter().map(of_view).collect()).collect();
        for (marker, views) in markers.iter().zip(&views) {
            let Some(marker) = marker else { continue };
            let lights: Vec<LightView> = views.iter().flatten().cloned().collect();
            wanted.extend(shadow_mark::run(marker, &lights));
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
