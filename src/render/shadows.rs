//! Shadows of a call's frames: what their pixels look up, the pages that this wants and that are not there, and the
//! comparison. All views of a call share the pages of a light.

use std::time::Instant;

use rustc_hash::{FxHashMap, FxHashSet};

use super::renderer::{FrameContext, Rastered};
use super::stats::ShadowStats;
use super::streaming;
use crate::config::Shadows;
use crate::cpu::shadow_mark::{self, Marked};
use crate::cpu::surface::Pixels;
use crate::cpu::{shadow_raster, shadow_test};
use crate::error::{Error, Result};
use crate::scene::Scene;
use crate::shadow::cache::PAGE_BYTES;
use crate::shadow::{LightView, PageKey, ShadowCache, ShadowMap};

/// Levels by which shadows are made coarser at most.
const COARSEST: i32 = 16;

/// What a frame looks up, and in which of its lights.
struct Frame {
    lights: Vec<Option<usize>>,
    views: Vec<LightView>,
}

/// The size of a scene across: a power of two above the diameter of what is visible, so that it seldom changes.
fn scene_size(scene: &Scene) -> f64 {
    let spheres = || {
        let instances = scene.instances().iter().filter(|(_, instance)| instance.visible);
        instances.map(|(_, instance)| instance.sphere())
    };
    let bound = |sign: f64| {
        let corners = spheres().map(|(center, radius)| sign * center + glam::DVec3::splat(radius));
        corners.reduce(glam::DVec3::max).unwrap_or(glam::DVec3::ZERO)
    };
    let across = (bound(1.0) + bound(-1.0)).length();
    if across > 0.0 && across.is_finite() { 2f64.powi(across.log2().ceil() as i32) } else { 1.0 }
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
    let size = scene_size(scene);
    let visible = || scene.lights().iter().filter(|(_, light)| light.visible);
    let maps: Vec<(u32, ShadowMap)> =
        visible().filter_map(|(slot, light)| Some((slot, ShadowMap::new(light, size)?))).collect();
    stats.invalidated = cache.update(scene, &maps, resident);
    let of_slot: FxHashMap<u32, ShadowMap> = maps.iter().copied().collect();
    let frames: Vec<Frame> = frame_contexts
        .iter()
        .map(|own| {
            let mut views = Vec::new();
            let lights = visible().map(|(slot, _)| {
                let map = of_slot.get(&slot)?;
                views.push(LightView::new(slot, map, &own.view, own.options.pixel_error, size));
                Some(views.len() - 1)
            });
            Frame { lights: lights.collect(), views }
        })
        .collect();
    let most = (options.shadow_memory / PAGE_BYTES).max(1) as usize;
    let start = Instant::now();
    let (marked, wanted) = mark(frame_contexts, rastered, &frames, most, &mut stats)?;
    stats.mark_ms = ms(start);
    let start = Instant::now();
    let missing = cache.want(&wanted);
    stats.evicted = cache.make_room(missing.len(), most);
    (stats.wanted, stats.drawn) = (wanted.len() as u64, missing.len() as u64);
    for block in shadow_raster::run(&missing, &of_slot, scene, resident) {
        stats.clusters += block.clusters;
        stats.triangles += block.triangles;
        if let Some(first) = rastered.first_mut() {
            first.needs.merge(streaming::missed(&block.absent, &block.views));
        }
        block.pages.into_iter().for_each(|(key, texels)| cache.insert(key, texels));
    }
    stats.kept = cache.len() as u64;
    stats.draw_ms = ms(start);
    let start = Instant::now();
    for ((own, marked), Frame { lights, .. }) in rastered.iter_mut().zip(&marked).zip(frames) {
        own.shadows = marked.as_ref().map(|marked| shadow_test::run(marked, lights, cache));
    }
    stats.test_ms = ms(start);
    rastered.iter_mut().for_each(|own| own.stats.shadows = Some(stats.clone()));
    Ok(())
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// What all frames look up, and the pages that are wanted for it, in their order: at most as many as there is room for.
#[allow(clippy::type_complexity)]
fn mark(
    frame_contexts: &[FrameContext<'_>],
    rastered: &[Rastered],
    frames: &[Frame],
    most: usize,
    stats: &mut ShadowStats,
) -> Result<(Vec<Option<Vec<Vec<Marked>>>>, Vec<PageKey>)> {
    for coarser in 0..=COARSEST {
        let mut wanted: FxHashSet<PageKey> = FxHashSet::default();
        let mut all = Vec::new();
        for ((own, drawn), frame) in frame_contexts.iter().zip(rastered).zip(frames) {
            if own.options.depth_only {
                all.push(None);
                continue;
            }
            let words = drawn.picture.words("shadow")?;
            let pixels = Pixels { words, visible: &drawn.visible, views: &drawn.views, screen: &own.screen };
            let views: Vec<LightView> = frame.views.iter().map(|view| view.coarser(coarser)).collect();
            let marked = shadow_mark::run(pixels, &own.eye, &views);
            wanted.extend(marked.iter().flatten().flat_map(|one| &one.pages));
            all.push(Some(marked));
        }
        if wanted.len() <= most {
            stats.coarser = coarser as u32;
            let mut wanted: Vec<PageKey> = wanted.into_iter().collect();
            wanted.sort_unstable_by_key(|key| (key.block(), *key));
            return Ok((all, wanted));
        }
    }
    let message = format!("shadows {COARSEST} levels coarser than pixels want more than {most} pages");
    Err(Error::argument("shadow_memory", message))
}
