//! The maps of lights, their levels and pages, as views that stages draw.

use glam::{DAffine3, DMat3, DVec3};

use crate::limits::{SHADOW_BLOCK_PAGES, SHADOW_BOUNDED_LEVELS, SHADOW_PAGE_SIDE, SHADOW_SIDE};
use crate::scene::{Light, LightKind, View};

/// A spot whose cone is wider than this, radians from its axis, is drawn on the faces of a cube.
const WIDEST_SPOT: f64 = std::f64::consts::FRAC_PI_4;

/// Levels of a map that has an end.
pub const BOUNDED_LEVELS: i32 = SHADOW_BOUNDED_LEVELS as i32;

/// The near plane of maps of lights with a position, as a part of the size of the scene. Depth is reversed, so that little
/// is lost by its being near.
const NEAR: f64 = 1.0 / (1u64 << 20) as f64;

/// Of each face of a cube, the axes of the world that are its right, its up and the way against its sight, and their signs.
pub const CUBE_FACES: [[(usize, f32); 3]; 6] = [
    [(2, 1.0), (1, 1.0), (0, -1.0)],
    [(2, -1.0), (1, 1.0), (0, 1.0)],
    [(0, 1.0), (2, 1.0), (1, -1.0)],
    [(0, -1.0), (2, 1.0), (1, 1.0)],
    [(0, -1.0), (1, 1.0), (2, -1.0)],
    [(0, 1.0), (1, 1.0), (2, 1.0)],
];

/// The projections of a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapKind {
    /// Parallel, without an end: the level of a texel of 2ⁿ world units has the number n.
    Parallel,
    /// One pinhole.
    Spot,
    /// Six pinholes of 90°, along the axes of the world.
    Cube,
}

/// Where a light stands and how it is projected: the same for as long as none of that changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowMap {
    /// What it is.
    pub kind: MapKind,
    /// Columns: right, up, and towards the light, unit, in the world. Of a cube, the world's.
    pub axes: DMat3,
    /// Its place; of a parallel one the origin of the world.
    pub origin: DVec3,
    /// Tangent of half the angle of a pinhole.
    pub tangent: f64,
    /// Near distance of a pinhole, world units.
    pub near: f64,
    /// Distance from its place at which the light ends; infinite where it does not.
    pub range: f64,
}

/// A page of a map. It holds what a light sees through its texels, which depends on nothing but the scene and this key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PageKey {
    /// Slot of the light in its scene.
    pub light: u32,
    /// Of a cube, the face.
    pub face: u8,
    /// Parallel: the logarithm of a texel in world units. Otherwise 0 for the finest, and each next of half the texels across.
    pub level: i16,
    /// Binary logarithm of the light's threshold in texels; [`PageKey::WHOLE`] for none, where the source is drawn.
    pub tau: i16,
    /// Pages to the right of the map's origin, or of its left edge.
    pub x: i64,
    /// Pages down.
    pub y: i64,
    /// Parallel: which slab of [`SHADOW_SIDE`] texels across depths are measured in, upwards from the origin.
    pub z: i64,
}

impl PageKey {
    /// The light's threshold where nothing may be simplified.
    pub const WHOLE: i16 = i16::MIN;

    /// The light's threshold, texels, for a view's in pixels: at most one, and a power of two, so that pages stay right
    /// while a threshold changes a little.
    pub fn tau_of(pixel_error: f32) -> i16 {
        if pixel_error >= 1.0 {
            return 0;
        }
        let exponent = (pixel_error.to_bits() >> 23) as i16 - 127;
        if pixel_error < f32::MIN_POSITIVE { Self::WHOLE } else { exponent }
    }

    /// The threshold in texels.
    pub fn threshold(tau: i16) -> f32 {
        if tau == Self::WHOLE { 0.0 } else { f32::powi(2.0, i32::from(tau)) }
    }

    /// The block that it is culled in.
    pub fn block(&self) -> Block {
        let side = i64::from(SHADOW_BLOCK_PAGES);
        Block(Self { x: self.x.div_euclid(side), y: self.y.div_euclid(side), ..*self })
    }
}

/// Pages that lie side by side, [`SHADOW_BLOCK_PAGES`] across and down: one view culls what they show. Its key is that of
/// its pages, but that it counts blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Block(pub PageKey);

impl Block {
    /// Column and row in it of a page of it.
    pub fn place(&self, page: &PageKey) -> [usize; 2] {
        let side = i64::from(SHADOW_BLOCK_PAGES);
        [page.x - side * self.0.x, page.y - side * self.0.y].map(|v| v as usize)
    }
}

impl ShadowMap {
    /// Of a light, in a scene of some size across; `None` where it throws no shadow.
    pub fn new(light: &Light, scene_size: f64) -> Option<Self> {
        if !light.casts_shadows {
            return None;
        }
        let axis = light.pose.matrix3.z_axis.normalize_or_zero();
        let along = || {
            let (x, y) = if axis == DVec3::ZERO { (DVec3::X, DVec3::Y) } else { axis.any_orthonormal_pair() };
            DMat3::from_cols(x, y, if axis == DVec3::ZERO { DVec3::Z } else { axis })
        };
        let near = scene_size * NEAR;
        let range = match light.kind {
            LightKind::Spot { range: Some(range), .. } | LightKind::Point { range: Some(range) } => {
                range.into()
            }
            _ => f64::INFINITY,
        };
        let (kind, axes, tangent) = match light.kind {
            LightKind::Directional => (MapKind::Parallel, along(), 1.0),
            LightKind::Spot { outer, .. } if outer <= WIDEST_SPOT => (MapKind::Spot, along(), outer.tan()),
            LightKind::Spot { .. } | LightKind::Point { .. } => (MapKind::Cube, DMat3::IDENTITY, 1.0),
        };
        let origin = if kind == MapKind::Parallel { DVec3::ZERO } else { light.pose.translation };
        Some(Self { kind, axes, origin, tangent, near, range })
    }

    /// Whether it has no end.
    pub fn parallel(&self) -> bool {
        self.kind == MapKind::Parallel
    }

    /// Axes of a face: right, up, and against its sight, as columns.
    fn face_axes(&self, face: u8) -> DMat3 {
        if self.kind != MapKind::Cube {
            return self.axes;
        }
        let [x, y, z] =
            CUBE_FACES[usize::from(face)].map(|(axis, sign)| f64::from(sign) * DMat3::IDENTITY.col(axis));
        DMat3::from_cols(x, y, z)
    }

    /// A texel of a parallel map's level, world units.
    pub fn texel(level: i16) -> f64 {
        2f64.powi(i32::from(level))
    }

    /// The view that draws a page.
    pub fn page_view(&self, key: &PageKey) -> View {
        self.view(key, 1)
    }

    /// The view that culls for the pages of a block.
    pub fn block_view(&self, block: &Block) -> View {
        self.view(&block.0, SHADOW_BLOCK_PAGES)
    }

    /// The view of a square of so many pages on a side.
    fn view(&self, key: &PageKey, pages: u32) -> View {
        let side = pages * SHADOW_PAGE_SIDE;
        let (half, side) = (0.5 * f64::from(side), f64::from(side));
        let axes = self.face_axes(key.face);
        let size = pages * SHADOW_PAGE_SIDE;
        if self.parallel() {
            let texel = Self::texel(key.level);
            let middle = |at: i64| (at as f64 + 0.5) * side * texel;
            // What is above the slab is before the eye, and is held to depth 0.
            let top = (key.z + 1) as f64 * f64::from(SHADOW_SIDE) * texel;
            let eye = axes * DVec3::new(middle(key.x), -middle(key.y), top);
            return View {
                width: size,
                height: size,
                orthographic: true,
                focal: [1.0 / texel; 2],
                skew: 0.0,
                center: [half; 2],
                near: f64::NEG_INFINITY,
                far: None,
                pose: DAffine3 { matrix3: axes, translation: eye },
            };
        }
        let texels = f64::from(SHADOW_SIDE >> key.level);
        let center = [key.x, key.y].map(|at| 0.5 * texels - at as f64 * side);
        View {
            width: size,
            height: size,
            orthographic: false,
            focal: [0.5 * texels / self.tangent; 2],
            skew: 0.0,
            center,
            near: self.near,
            far: None,
            pose: DAffine3 { matrix3: axes, translation: self.origin },
        }
    }

    /// Whether what lies in a sphere may change a page: it may touch the page's beam, wider by a texel.
    pub fn touches(&self, key: &PageKey, center: DVec3, radius: f64) -> bool {
        let to = self.face_axes(key.face).transpose() * (center - self.origin);
        if self.parallel() {
            let texel = Self::texel(key.level);
            let side = f64::from(SHADOW_PAGE_SIDE) * texel;
            let radius = radius + texel + 1.0e-12 * to.length();
            let apart = |at: f64, page: i64| {
                let middle = (page as f64 + 0.5) * side;
                (at - middle).abs() > 0.5 * side + radius
            };
            return !(apart(to.x, key.x) || apart(-to.y, key.y));
        }
        let texels = f64::from(SHADOW_SIDE >> key.level);
        let side = f64::from(SHADOW_PAGE_SIDE);
        // Planes through the light and the page's edges.
        let tangent = |texel: f64| (texel - 0.5 * texels) * 2.0 * self.tangent / texels;
        let within = |at: f64, page: i64| {
            let low = tangent(page as f64 * side - 1.0);
            let high = tangent((page + 1) as f64 * side + 1.0);
            let depth = -to.z;
            at - low * depth >= -radius * (1.0 + low * low).sqrt()
                && high * depth - at >= -radius * (1.0 + high * high).sqrt()
        };
        -to.z >= -radius && within(to.x, key.x) && within(-to.y, key.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_of_a_cube_are_rotations_that_look_everywhere() {
        let map = ShadowMap {
            kind: MapKind::Cube,
            axes: DMat3::IDENTITY,
            origin: DVec3::ZERO,
            tangent: 1.0,
            near: 1e-3,
            range: f64::INFINITY,
        };
        let mut seen = DVec3::ZERO;
        for face in 0..6 {
            let axes = map.face_axes(face);
            assert!((axes.determinant() - 1.0).abs() < 1e-12, "face {face}");
            seen += axes.z_axis.abs();
        }
        assert_eq!(seen, DVec3::splat(2.0));
    }

    #[test]
    fn thresholds_are_powers_of_two_below_those_of_views() {
        for (pixels, texels) in [(4.0, 1.0), (1.0, 1.0), (0.99, 0.5), (0.5, 0.5), (0.3, 0.25), (0.0, 0.0)] {
            assert_eq!(PageKey::threshold(PageKey::tau_of(pixels)), texels, "{pixels}");
        }
    }
}
