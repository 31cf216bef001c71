//! The constants of a view in the precision of the stages, depth values and their keys, and where pixels lie.
//!
//! Screen space is pixels, x right and y down from the upper left corner. A point has homogeneous coordinates
//! (x, y, d) with d its distance along the view axis; a pinhole view divides x and y by d, a parallel one does
//! not. What rasterizers interpolate linearly on the screen is the *depth value* v: near ÷ d for a pinhole,
//! d itself for a parallel view. Its *key* is an unsigned integer that grows towards the eye.

use crate::scene::View;

/// A view's constants in the precision of the stages.
#[derive(Clone, Copy, Debug)]
pub struct Screen {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Parallel projection.
    pub orthographic: bool,
    /// Near distance.
    pub near: f32,
    /// Far distance; infinite when there is none.
    pub far: f32,
    /// Keys below this are beyond the far distance.
    pub far_key: u32,
}

impl Screen {
    /// The constants of a view.
    pub fn new(view: &View) -> Self {
        let near = view.near as f32;
        let far = view.far.map_or(f32::INFINITY, |f| f as f32);
        let mut screen = Self {
            width: view.width,
            height: view.height,
            orthographic: view.orthographic,
            near,
            far,
            far_key: 0,
        };
        if far.is_finite() {
            screen.far_key = screen.key(screen.value(far));
        }
        screen
    }

    /// The depth value at a distance.
    #[inline]
    pub fn value(&self, distance: f32) -> f32 {
        if self.orthographic { distance } else { self.near / distance }
    }

    /// The key of a depth value. What is behind the eye of a parallel view, which has no near plane then, is at it.
    #[inline]
    pub fn key(&self, value: f32) -> u32 {
        if self.orthographic { !value.max(0.0).to_bits() } else { value.to_bits() }
    }

    /// The place of a pixel in the view's target, row by row; those of a row follow each other. Nobody else knows, but for
    /// `shaders/shared/target.wgsl`.
    #[inline(always)]
    pub fn pixel_address(&self, column: usize, row: usize) -> usize {
        row * self.width as usize + column
    }

    /// Column and row of the pixel at a place.
    #[inline(always)]
    pub fn pixel_of(&self, address: u32) -> [u32; 2] {
        [address % self.width, address / self.width]
    }

    /// The distance of a key.
    #[inline]
    pub fn distance(&self, key: u32) -> f32 {
        if self.orthographic { f32::from_bits(!key) } else { self.near / f32::from_bits(key) }
    }
}

/// Homogeneous screen coordinates of an internal position: the one place where vertices are transformed, so
/// that clusters agree on shared vertices bit for bit.
#[inline(always)]
pub fn homogeneous(rows: &[[f32; 4]; 3], p: [f32; 3]) -> [f32; 3] {
    [
        rows[0][0] * p[0] + rows[0][1] * p[1] + rows[0][2] * p[2] + rows[0][3],
        rows[1][0] * p[0] + rows[1][1] * p[1] + rows[1][2] * p[2] + rows[1][3],
        rows[2][0] * p[0] + rows[2][1] * p[1] + rows[2][2] * p[2] + rows[2][3],
    ]
}
