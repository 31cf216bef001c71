//! Stage 8. Visibility buffer → the arrays that a caller asks for: depth, normals, identities, debug views.
//! Each is made on its own, so that nothing is made that nobody reads.

use std::sync::atomic::AtomicU32;

use rayon::prelude::*;

use super::surface::{Detail, Extra, Pixels, Surfels, Walk};
use super::triangle::project;
use super::visibility::{Counter, Pixel};
use super::{raster_large, raster_small};
use crate::error::Result;
use crate::scene::palette::{FACING, RAMP_LEVELS, hash, hue, ramp};
use crate::scene::placement::Eye;
use crate::views::{Hit, InstanceView, Screen, Visible, decode};

/// Rows per task.
pub(super) const ROWS: usize = 8;

/// What `cluster_ids` holds where nothing is covered.
pub const NO_CLUSTER: u32 = u32::MAX;

/// What the rasterizer of small triangles drew: blue.
const SMALL_COLOR: [f32; 3] = [0.25, 0.6, 0.95];
/// What that of large triangles drew: orange.
const LARGE_COLOR: [f32; 3] = [0.95, 0.5, 0.15];

/// Surfaces of wireframes.
const BLANK_GREY: f32 = 0.9;

/// A debug view: what pixels of equal colour have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DebugView {
    /// A triangle.
    Triangles,
    /// A cluster.
    Clusters,
    /// A group: clusters simplified together.
    Groups,
    /// A level of detail; warm is fine, cool is coarse.
    Levels,
}

/// One value per pixel from its hit alone.
fn map<T: Send + Copy>(pixels: Pixels<'_>, background: T, value: impl Fn(Hit) -> T + Sync) -> Vec<T> {
    let mut out = vec![background; pixels.words.len()];
    out.par_chunks_mut(1 << 13).zip(pixels.words.par_chunks(1 << 13)).for_each(|(out, words)| {
        for (out, &word) in out.iter_mut().zip(words) {
            if let Some(hit) = decode(word) {
                *out = value(hit);
            }
        }
    });
    out
}

/// One value per pixel from its surface point, with detail or without: `value` gets the points and a lane.
fn map_surface<T: Send + Copy, D: Extra>(
    pixels: Pixels<'_>,
    background: T,
    value: impl Fn(&Surfels<'_, D>, usize) -> T + Sync,
) -> Vec<T> {
    let chunk = pixels.screen.width as usize * ROWS;
    let mut out = vec![background; pixels.words.len()];
    out.par_chunks_mut(chunk).enumerate().for_each(|(i, out)| {
        let start = i * chunk;
        let Some(mut walk) = Walk::new(pixels, start..start + out.len()) else { return };
        while let Some(surfels) = walk.step() {
            for lane in 0..surfels.count {
                out[surfels.pixels[lane] as usize - start] = value(&surfels, lane);
            }
        }
    });
    out
}

/// Distance along the view axis, world units; 0 where nothing is covered.
fn distance(screen: &Screen, key: u32) -> f32 {
    if key == 0 { 0.0 } else { screen.distance(key) }
}

/// The distance of each pixel.
pub fn depth(pixels: Pixels<'_>, out: &mut [f32]) {
    out.par_chunks_mut(1 << 14).zip(pixels.words.par_chunks(1 << 14)).for_each(|(out, words)| {
        out.iter_mut().zip(words).for_each(|(out, word)| *out = distance(pixels.screen, word.key()));
    });
}

/// Keys → the bits of their distances, in place.
pub fn depth_of_keys(keys: &mut [u32], screen: &Screen) {
    let at = |key: &mut u32| *key = distance(screen, *key).to_bits();
    keys.par_chunks_mut(1 << 14).for_each(|keys| keys.iter_mut().for_each(at));
}

/// Unit normals in world space; zero where nothing is covered.
pub fn normals(pixels: Pixels<'_>, eye: &Eye) -> Vec<[f32; 3]> {
    let r = &eye.rotate;
    let to_world: [[f32; 3]; 3] = std::array::from_fn(|k| [r[0][k], r[1][k], r[2][k]]);
    map_surface(pixels, [0.0; 3], |surfels: &Surfels<'_>, lane| {
        let n = surfels.normal.map(|c| c.0[lane]);
        to_world.map(|row| n[0] * row[0] + n[1] * row[1] + n[2] * row[2])
    })
}

fn instance<'a>(pixels: Pixels<'a>, hit: Hit) -> &'a InstanceView {
    &pixels.views[pixels.visible[hit.visible as usize].instance as usize]
}

/// Slot number of the instance; −1 where nothing is covered.
pub fn instance_ids(pixels: Pixels<'_>) -> Vec<i32> {
    map(pixels, -1, |hit| instance(pixels, hit).slot as i32)
}

/// Address of the cluster; [`NO_CLUSTER`] where nothing is covered.
pub fn cluster_ids(pixels: Pixels<'_>) -> Vec<u32> {
    map(pixels, NO_CLUSTER, |hit| pixels.visible[hit.visible as usize].cluster.0)
}

/// Number of the triangle inside its cluster; −1 where nothing is covered.
pub fn triangle_ids(pixels: Pixels<'_>) -> Vec<i32> {
    map(pixels, -1, |hit| hit.triangle as i32)
}

/// Row of the caller's faces; −1 where nothing is covered, where a coarser level is shown, and for meshes
/// built without `face_ids`.
pub fn face_ids(pixels: Pixels<'_>) -> Result<Vec<i64>> {
    // The rows of each cluster of the source that is drawn.
    let rows = |visible: &Visible| -> Result<&[u32]> {
        let view = &pixels.views[visible.instance as usize];
        match &view.mesh.face_ids {
            Some(faces) if view.pages.record(visible.cluster).level == 0 => {
                Ok(faces.load()?.get(view.pages.first_face(visible.cluster)..).unwrap_or_default())
            }
            _ => Ok(&[]),
        }
    };
    let rows: Vec<&[u32]> = pixels.visible.par_iter().map(rows).collect::<Result<_>>()?;
    Ok(map(pixels, -1, |hit| {
        rows[hit.visible as usize].get(hit.triangle as usize).map_or(-1, |row| i64::from(*row))
    }))
}

/// Triangles that cover each pixel, hidden or not, among the clusters of the visible list.
pub fn overdraw(pixels: Pixels<'_>, large: &[bool]) -> Vec<u32> {
    let cells: Vec<AtomicU32> = (0..pixels.words.len()).map(|_| AtomicU32::new(0)).collect();
    let (large, small): (Vec<u32>, Vec<u32>) =
        (0..pixels.visible.len() as u32).partition(|&n| large[n as usize]);
    raster_small::run(&small, pixels.visible, pixels.views, pixels.screen, &Counter(&cells));
    raster_large::run(&large, pixels.visible, pixels.views, pixels.screen, &Counter(&cells));
    cells.into_iter().map(AtomicU32::into_inner).collect()
}

/// Colours in RGB bytes, darkened where the surface turns away; black where nothing is covered.
fn faced(pixels: Pixels<'_>, color: impl Fn(&Surfels<'_>, usize) -> [f32; 3] + Sync) -> Vec<[u8; 3]> {
    map_surface(pixels, [0; 3], |surfels: &Surfels<'_>, lane| {
        let facing = FACING[0] + FACING[1] * surfels.normal[2].0[lane].abs();
        color(surfels, lane).map(|c| (c * facing * 255.0 + 0.5) as u8)
    })
}

/// A debug view in RGB; black where nothing is covered.
pub fn debug(pixels: Pixels<'_>, what: DebugView) -> Vec<[u8; 3]> {
    faced(pixels, |surfels, lane| {
        let (view, cluster) = (surfels.view, surfels.clusters[lane]);
        let record = view.pages.record(cluster);
        match what {
            DebugView::Triangles => hue(hash([view.slot, cluster.0, surfels.hits[lane].triangle])),
            DebugView::Clusters => hue(hash([view.slot, cluster.0, 1 << 8])),
            DebugView::Groups => hue(hash([view.slot, record.group, 1 << 9])),
            DebugView::Levels => ramp(f32::from(record.level) / RAMP_LEVELS),
        }
    })
}

/// Which rasterizer drew what is seen, in RGB: that of small triangles blue, that of large ones orange; black where nothing is covered.
pub fn rasterizers(pixels: Pixels<'_>, large: &[bool]) -> Vec<[u8; 3]> {
    faced(
        pixels,
        |surfels, lane| {
            if large[surfels.hits[lane].visible as usize] { LARGE_COLOR } else { SMALL_COLOR }
        },
    )
}

/// How far what each pixel shows has moved since a frame before, pixels to the right and down: zero where nothing is covered, NaN
/// where it was at the eye or behind it. `before` are the frame's instances as they were, on that frame's screen. Points of
/// triangles keep their barycentric coordinates.
pub fn motion(pixels: Pixels<'_>, before: &[InstanceView], screen: &Screen) -> Vec<[f32; 2]> {
    map_surface(pixels, [0.0; 2], |surfels: &Surfels<'_, Detail>, lane| {
        let weights = surfels.detail.weights.map(|w| w.0[lane]);
        let (triangle, cluster) = (surfels.hits[lane].triangle as usize, surfels.clusters[lane]);
        let place = |view: &InstanceView, screen: &Screen| {
            let corners = view.cluster(cluster).corners(triangle);
            let point = std::array::from_fn(|k| (0..3).map(|i| weights[i] * corners[i][k]).sum());
            let h = view.homogeneous(point);
            let ahead = screen.orthographic || h[2] > 0.0;
            let [x, y, _] = project(screen, h);
            if ahead { [x, y] } else { [f32::NAN; 2] }
        };
        let now = place(surfels.view, pixels.screen);
        let then = place(&before[surfels.instance as usize], screen);
        [now[0] - then[0], now[1] - then[1]]
    })
}

/// How much an edge of the triangle that it shows counts at each pixel, 0 to 1: less with the distance, up to a pixel. Points and
/// lines have none.
///
/// Distances to edges are barycentric coordinates over their change (Bærentzen and others, "Single-Pass Wireframe Rendering",
/// 2006).
pub fn edges(pixels: Pixels<'_>) -> Vec<f32> {
    map_surface(pixels, 0.0, |surfels: &Surfels<'_, Detail>, lane| {
        if surfels.view.stroke.is_some() {
            return 0.0;
        }
        let Detail { weights, change: [right, down], .. } = &surfels.detail;
        let away = |k: usize| {
            let (right, down) = (right[k].0[lane], down[k].0[lane]);
            weights[k].0[lane] / (right * right + down * down).sqrt()
        };
        let nearest = (0..3).map(away).fold(f32::INFINITY, f32::min);
        (1.0 - nearest).clamp(0.0, 1.0)
    })
}

/// Surfaces in light grey, darkened where they turn away; black where nothing is covered.
pub fn blank(pixels: Pixels<'_>) -> Vec<[u8; 3]> {
    faced(pixels, |_, _| [BLANK_GREY; 3])
}

/// Draws edges over a picture.
pub fn draw_edges(pixels: Pixels<'_>, color: [u8; 3], image: &mut [u8]) {
    for (pixel, share) in image.chunks_exact_mut(3).zip(edges(pixels)) {
        for (value, line) in pixel.iter_mut().zip(color) {
            let (from, to) = (f32::from(*value), f32::from(line));
            *value = (from + share * (to - from) + 0.5) as u8;
        }
    }
}

/// Overdraw in RGB: black none, then from blue (1) to red (8 and more).
pub fn overdraw_colors(counts: &[u32]) -> Vec<[u8; 3]> {
    counts
        .par_iter()
        .map(|&n| match n {
            0 => [0; 3],
            n => ramp(1.0 - (n.min(8) - 1) as f32 / 7.0).map(|c| (c * 255.0 + 0.5) as u8),
        })
        .collect()
}
