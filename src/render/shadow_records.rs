//! Shadow maps as shaders look them up: records of how a view sees lights, and of where pages lie.

use crate::gpu::shadow_table::{ShadowEntry, ShadowMapEntries};
use crate::gpu_types::{SHADOW_CUBE, SHADOW_PARALLEL, SHADOW_SPOT, ShadowLight};
use crate::shadow::LightView;
use crate::shadow::map::MapKind;
use crate::shadow::receiver::RelativePage;

/// A light's map as a view looks it up, with the pages that lie on the device and their slots.
pub fn shadow_map_entries(
    view: &LightView,
    pages: impl IntoIterator<Item = (RelativePage, u32)>,
) -> ShadowMapEntries {
    let [x, y, z] = view.axes;
    let axes = [(x, 0), (y, 1), (z, 2)].map(|([a, b, c], k)| [a, b, c, view.eye[k]]);
    let radius = view.lamp.radius;
    let light = ShadowLight {
        axes,
        kind: match view.kind {
            MapKind::Parallel => SHADOW_PARALLEL,
            MapKind::Spot => SHADOW_SPOT,
            MapKind::Cube => SHADOW_CUBE,
        },
        first: view.first,
        coarser: view.coarser,
        orthographic: u32::from(view.orthographic),
        tangent: view.tangent,
        near: view.near,
        // Shaders know no infinity.
        reach_squared: view.reach_squared.min(f32::MAX),
        focal: view.focal,
        threshold: view.threshold,
        radius,
        inverse_radius: if radius > 0.0 { 1.0 / radius } else { 0.0 },
        top: view.lamp.top,
        ..bytemuck::Zeroable::zeroed()
    };
    let entry = |(page, slot): (RelativePage, u32)| {
        let RelativePage { face, level, x, y, z } = page;
        ShadowEntry { face, level, at: [x, y, z], slot }
    };
    ShadowMapEntries {
        light,
        anchors: view.offsets().collect(),
        points: view.lamp.points.clone(),
        pages: pages.into_iter().map(entry).collect(),
    }
}
