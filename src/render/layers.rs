//! What is seen of meshes alone, to be laid over another picture: light times coverage, and coverage (Porter and Duff,
//! "Compositing Digital Images", SIGGRAPH 1984).

use rayon::prelude::*;

/// Pixels that a thread takes at a time.
const RUN: usize = 1 << 14;

/// Adds a share of a picture where its depth says that a mesh is seen.
pub(super) fn add(layer: &mut [[f32; 4]], light: &[f32], depth: &[f32], share: f32) {
    let light = light.as_chunks::<3>().0;
    layer.par_iter_mut().zip(light).zip(depth).with_min_len(RUN).for_each(|((pixel, light), depth)| {
        if *depth > 0.0 {
            for k in 0..3 {
                pixel[k] += light[k] * share;
            }
            pixel[3] += share;
        }
    });
}

/// Adds a share of such a layer.
pub(super) fn add_layer(layer: &mut [[f32; 4]], other: &[[f32; 4]], share: f32) {
    layer.par_iter_mut().zip(other).with_min_len(RUN).for_each(|(pixel, other)| {
        (0..4).for_each(|k| pixel[k] += other[k] * share);
    });
}

/// RGBA with colours as they are beside coverage, and nothing where there is none.
pub(super) fn straight<T: Copy + Default + Send>(
    layer: &[[f32; 4]],
    color: impl Fn(f32) -> T + Sync,
    alpha: impl Fn(f32) -> T + Sync,
) -> Vec<T> {
    let pixel = |&[r, g, b, a]: &[f32; 4]| match a > 0.0 {
        true => [color(r / a), color(g / a), color(b / a), alpha(a)],
        false => [T::default(); 4],
    };
    layer.par_iter().with_min_len(RUN).map(pixel).collect::<Vec<_>>().into_flattened()
}
