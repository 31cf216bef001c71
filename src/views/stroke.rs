//! How large points and lines are on a picture.

use super::screen::Screen;
use crate::model::{Primitive, StrokeSize};
use crate::scene::placement::Eye;

/// Points or lines as an eye sees them. Their depth is that of the point, or of the segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Lines, not points.
    pub line: bool,
    /// Radius in pixels, at any distance.
    pub pixels: f32,
    /// What is added across and down at distance 1 (pinhole) or at any (parallel), pixels.
    pub spread: [f32; 2],
}

impl Stroke {
    /// No point and no line is thinner than a pixel.
    const LEAST: f32 = 0.5;

    /// That of a geometry; `None` for triangles.
    pub fn new(primitive: Primitive, eye: &Eye) -> Option<Self> {
        let (pixels, radius) = match primitive.size()? {
            StrokeSize::Pixels(radius) => (radius, 0.0),
            StrokeSize::World(radius) => (0.0, radius),
        };
        let line = matches!(primitive, Primitive::Lines(_));
        Some(Self { line, pixels, spread: eye.focal.map(|focal| radius * focal.abs()) })
    }

    /// Radii across and down at a distance from the eye, pixels.
    #[inline]
    pub fn radii(&self, screen: &Screen, distance: f32) -> [f32; 2] {
        let scale = if screen.orthographic { 1.0 } else { 1.0 / distance };
        self.spread.map(|spread| (self.pixels + spread * scale).max(Self::LEAST))
    }

    /// How far anything drawn reaches beyond where its vertices lie, for distances from `nearest` on; pixels, rounded up. A
    /// point covers the pixel that it lies in, too.
    #[inline]
    pub fn reach(&self, screen: &Screen, nearest: f32) -> [f32; 2] {
        self.radii(screen, nearest).map(|radius| radius * (1.0 + 4.0 * f32::EPSILON) + 1.0)
    }
}
