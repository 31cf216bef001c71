//! Where a box lies on the screen: the pixels that it may cover, and how near it comes.

use super::screen::{Screen, homogeneous};
use super::stroke::Stroke;
use crate::limits::{FOOTPRINT_MARGIN, FOOTPRINT_ROUNDING, FOOTPRINT_SLACK, GUARD_BAND};

/// Where a box lies on the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Footprint {
    /// First column, first row, last column, last row, on the picture, of the pixels that it may cover.
    pub rect: [u16; 4],
    /// Key of a distance nearer than anything in the box; `u32::MAX` when it reaches the near plane.
    pub near_key: u32,
    /// Longer side of the unclipped rectangle, pixels; `u16::MAX` when unknown or larger.
    pub span: u16,
    /// Part of the box may lie before the near plane, behind the far plane or outside the guard band.
    pub clipped: bool,
}

/// Something that says which boxes need not be drawn.
pub trait Occluder: Sync {
    /// True where nothing in a box with this footprint can be of use.
    fn hides(&self, footprint: &Footprint) -> bool;
}

impl Footprint {
    /// Pixels of the rectangle; 1 where it is not known.
    pub fn area(&self) -> u64 {
        if self.near_key == u32::MAX {
            return 1;
        }
        let [x0, y0, x1, y1] = self.rect.map(u64::from);
        (x1 - x0 + 1) * (y1 - y0 + 1)
    }
}

/// Where a box about `center` with half extents `extent` lies, under rows of a map to homogeneous screen space; `None` off
/// the screen. Of points and lines the box holds the vertices, and their pixels are those of what is drawn.
pub fn footprint(
    rows: &[[f32; 4]; 3],
    constants: &Screen,
    center: [f32; 3],
    extent: [f32; 3],
    stroke: Option<&Stroke>,
) -> Option<Footprint> {
    let c = homogeneous(rows, center);
    let half = |r: usize| rows[r].map(f32::abs);
    let reach = |r: usize| {
        let h = half(r);
        h[0] * extent[0] + h[1] * extent[1] + h[2] * extent[2]
    };
    // Bounds of the rounding of a coordinate anywhere in the box.
    let rounding = |r: usize| {
        let h = half(r);
        FOOTPRINT_ROUNDING
            * (h[0] * center[0].abs() + h[1] * center[1].abs() + h[2] * center[2].abs() + reach(r) + h[3])
    };
    let slack = [rounding(0), rounding(1), rounding(2)];
    let (nearest, farthest) = (c[2] - reach(2) - slack[2], c[2] + reach(2) + slack[2]);
    if farthest < constants.near || nearest > constants.far {
        return None;
    }
    let size = [constants.width as f32, constants.height as f32];
    let mut low = [f32::INFINITY; 2];
    let mut high = [f32::NEG_INFINITY; 2];
    let endless = constants.near == f32::NEG_INFINITY;
    if nearest > constants.near && (endless || slack[2] < FOOTPRINT_SLACK * nearest) {
        let scale = if constants.orthographic { 1.0 } else { 1.0 / nearest };
        for k in 0..2 {
            let edge: [f32; 3] = std::array::from_fn(|j| rows[k][j] * extent[j]);
            let deep: [f32; 3] = std::array::from_fn(|j| rows[2][j] * extent[j]);
            for corner in 0..8 {
                let sign = |bit: u32, v: f32| if corner >> bit & 1 == 0 { v } else { -v };
                let x = c[k] + sign(0, edge[0]) + sign(1, edge[1]) + sign(2, edge[2]);
                let d = c[2] + sign(0, deep[0]) + sign(1, deep[1]) + sign(2, deep[2]);
                let x = if constants.orthographic { x } else { x / d };
                low[k] = low[k].min(x);
                high[k] = high[k].max(x);
            }
            // For snapping, then for the rounding of the projection.
            let widest = low[k].abs().max(high[k].abs());
            let across = if constants.orthographic { 0.0 } else { widest * slack[2] };
            let error = FOOTPRINT_MARGIN + scale * (slack[k] + across);
            low[k] -= error;
            high[k] += error;
        }
        if let Some(stroke) = stroke {
            let reach = stroke.reach(constants, nearest);
            for k in 0..2 {
                low[k] -= reach[k];
                high[k] += reach[k];
            }
        }
    } else {
        // It reaches the near plane: test the half spaces, and cover the whole picture.
        // What is drawn of points and lines may reach anywhere from there.
        for k in (0..2).filter(|_| stroke.is_none()) {
            let plane = |sign: f32, offset: f32| -> [f32; 4] {
                std::array::from_fn(|j| {
                    let rest = if constants.orthographic {
                        if j == 3 { offset } else { 0.0 }
                    } else {
                        offset * rows[2][j]
                    };
                    sign * rows[k][j] + rest
                })
            };
            for p in [plane(1.0, 1.0), plane(-1.0, size[k] + 1.0)] {
                let at = p[0] * center[0] + p[1] * center[1] + p[2] * center[2] + p[3];
                let reach = p[0].abs() * extent[0] + p[1].abs() * extent[1] + p[2].abs() * extent[2];
                let error = slack[k] + slack[2] * (size[k] + 1.0);
                if at + reach + error < 0.0 {
                    return None;
                }
            }
        }
        let rect = [0, 0, constants.width as u16 - 1, constants.height as u16 - 1];
        return Some(Footprint { rect, near_key: u32::MAX, span: u16::MAX, clipped: true });
    }
    // The pixels whose centres lie inside: what has none is never drawn.
    let pixel = |v: f32, k: usize| (v + 0.5).clamp(0.0, size[k]) as u16;
    let [x0, y0, x1, y1] = [pixel(low[0], 0), pixel(low[1], 1), pixel(high[0], 0), pixel(high[1], 1)];
    if x0 >= x1 || y0 >= y1 {
        return None;
    }
    let span = (high[0] - low[0]).max(high[1] - low[1]);
    let inside = low.iter().chain(&high).all(|v| v.abs() < GUARD_BAND);
    let value =
        if constants.orthographic { nearest } else { constants.near / nearest * (1.0 + FOOTPRINT_ROUNDING) };
    Some(Footprint {
        rect: [x0, y0, x1 - 1, y1 - 1],
        near_key: constants.key(value),
        span: span.min(65535.0) as u16,
        clipped: !inside || farthest > constants.far,
    })
}
