//! Shadows of a call's frames: the pages that their pixels may look up, of which those that are not there are drawn. All views
//! of a call share the pages of a light.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::renderer::{FrameContext, Rastered};
use super::stats::ShadowStats;
use super::streaming;
use crate::config::Shadows;
use crate::cpu::shadow_pages::LightShadow;
use crate::cpu::surface::Pixels;
use crate::cpu::{shadow_mark, shadow_raster};
use crate::error::{Error, Result};
use crate::scene::{Light, Scene};
use crate::shadow::cache::PAGE_BYTES;
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
    let views: Vec<LightViews> = frame_contexts
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
    let (views, wanted) = mark(frame_contexts, rastered, &views, most)?;
    stats.coarser = views.iter().flatten().flatten().map(|view| view.coarser as u32).max().unwrap_or(0);
    stats.mark_ms = ms(start);
    let start = Instant::now();
    let missing = cache.want(&wanted);
    stats.evicted = cache.make_room(missing.len(), most);
    (stats.wanted, stats.drawn) = (wanted.len() as u64, missing.len() as u64);
    for block in shadow_raster::run(&missing, &maps, scene, resident) {
        stats.clusters += block.clusters;
        stats.triangles += block.triangles;
        if let Some(first) = rastered.first_mut() {
            first.needs.merge(streaming::missed(&block.absent, &block.views));
        }
        block.pages.into_iter().for_each(|(key, texels, whole)| cache.insert(key, texels, whole));
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
        own.shadows = Some(views.into_iter().map(|view| view.map(shadow)).collect());
        own.stats.shadows = Some(stats.clone());
    }
    Ok(())
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// The pages that frames may want, in their order: at most as many as there is room for. And the views that say so, all as much
/// coarser as that takes.
fn mark(
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
            let Rastered { visible, views, .. } = drawn;
            let pixels =
                Pixels { words: drawn.picture.words("shadow")?, visible, views, screen: &own.screen };
            wanted.extend(shadow_mark::run(pixels, &own.eye, &lights));
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
