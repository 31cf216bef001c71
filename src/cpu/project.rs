//! An instance as seen from a view: the f32 matrices that every stage uses, and the footprint of boxes.
//!
//! Screen space is pixels, x right and y down from the upper left corner. A point has homogeneous coordinates
//! (x, y, d) with d its distance along the view axis; a pinhole view divides x and y by d, a parallel one does
//! not. What rasterizers interpolate linearly on the screen is the *depth value* v: near ÷ d for a pinhole,
//! d itself for a parallel view. Its *key* is an unsigned integer that grows towards the eye.

use std::sync::Arc;

use crate::limits::{FOOTPRINT_MARGIN, FOOTPRINT_ROUNDING, FOOTPRINT_SLACK, GUARD_BAND};
use crate::math::{LodView, Sphere};
use crate::model::{Dag, Pages};
use crate::scene::placement::{Eye, Placement};
use crate::scene::{Instance, Materials, View};
use crate::stream::Resident;

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

    /// The key of a depth value.
    #[inline]
    pub fn key(&self, value: f32) -> u32 {
        if self.orthographic { !value.to_bits() } else { value.to_bits() }
    }

    /// The distance of a key.
    #[inline]
    pub fn distance(&self, key: u32) -> f32 {
        if self.orthographic { f32::from_bits(!key) } else { self.near / f32::from_bits(key) }
    }
}

/// An instance as seen from a view.
#[derive(Clone, Debug)]
pub struct InstanceView {
    /// Slot number in the scene.
    pub slot: u32,
    /// The mesh.
    pub mesh: Arc<Dag>,
    /// Its pages, or those of them that are there.
    pub pages: Arc<Pages>,
    /// The look.
    pub materials: Materials,
    /// Rows of the map from internal space to homogeneous screen space.
    pub screen: [[f32; 4]; 3],
    /// For the rule of the cut.
    pub lod: LodView,
    /// The eye in internal space (pinhole), or the direction of sight (parallel).
    pub eye: [f32; 3],
    /// Rows of the map from internal normals to camera space; not normalized.
    pub normal: [[f32; 3]; 3],
    /// `normal` keeps angles: interpolated normals may be transformed after interpolation.
    pub conformal: bool,
    /// The map from internal to camera space reverses orientation.
    pub mirrored: bool,
    /// Pixel bounds and nearest key of the whole instance, where the CPU culls.
    pub footprint: Footprint,
}

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

impl InstanceView {
    /// Derives everything but the footprint; `eye` is that of the view.
    pub fn new(eye: &Eye, screen: &Screen, slot: u32, instance: &Instance, resident: &Resident) -> Self {
        let placement = instance.placement();
        let Derived { screen, object_to_eye, normal, eye: eye_inside } =
            derive(eye, screen.orthographic, placement);
        Self {
            slot,
            mesh: Arc::clone(&instance.mesh),
            pages: Arc::clone(resident.pages(&instance.mesh)),
            materials: instance.materials.clone(),
            screen,
            lod: LodView {
                object_to_eye,
                scale: placement.lod_scale,
                rounding: placement.rounding,
                focal: eye.lod_focal,
                widest: eye.lod_widest,
                near: eye.lod_near,
            },
            eye: eye_inside,
            normal,
            conformal: placement.conformal,
            mirrored: placement.mirrored != eye.mirrored,
            footprint: Footprint::default(),
        }
    }

    /// Centre and half extents of the box around the mesh, rounded up.
    pub fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        mesh_bounds(&self.mesh)
    }

    /// Homogeneous screen coordinates of an internal position.
    #[inline(always)]
    pub fn homogeneous(&self, p: [f32; 3]) -> [f32; 3] {
        homogeneous(&self.screen, p)
    }

    /// Where a box about `center` with half extents `extent` lies; `None` off the screen.
    #[inline]
    pub fn footprint(&self, constants: &Screen, center: [f32; 3], extent: [f32; 3]) -> Option<Footprint> {
        footprint(&self.screen, constants, center, extent)
    }

    /// True when every triangle of a cluster with this sphere and cone faces away.
    #[inline]
    pub fn faces_away(&self, orthographic: bool, sphere: &Sphere, cone: ([f32; 3], f32)) -> bool {
        let (axis, cutoff) = cone;
        if cutoff >= 1.0 {
            return false;
        }
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        if orthographic {
            return dot(self.eye, axis) >= cutoff;
        }
        let to: [f32; 3] = std::array::from_fn(|k| sphere.center[k] - self.eye[k]);
        dot(to, axis) >= cutoff * dot(to, to).sqrt() + sphere.radius
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

/// Centre and half extents of the box around a mesh, internal space, rounded up.
pub fn mesh_bounds(mesh: &Dag) -> ([f32; 3], [f32; 3]) {
    let bounds = &mesh.bounds;
    let extent = |k: usize| (0.5 * (bounds.max[k] - bounds.min[k])).next_up() + f32::EPSILON;
    (bounds.center(), std::array::from_fn(extent))
}

/// What stages need of an instance and an eye.
struct Derived {
    screen: [[f32; 4]; 3],
    object_to_eye: [[f32; 4]; 3],
    normal: [[f32; 3]; 3],
    eye: [f32; 3],
}

/// Sums are written out, so that shaders can do them in the same order: `shaders/shared/derive.wgsl`.
fn derive(eye: &Eye, orthographic: bool, placement: &Placement) -> Derived {
    let (r, l, i) = (&eye.rotate, &placement.linear, &placement.inverse);
    // The origin of internal space as seen from the eye.
    let way: [f32; 3] =
        std::array::from_fn(|k| (placement.high[k] - eye.high[k]) + (placement.low[k] - eye.low[k]));
    let dot = |a: &[f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let column = |j: usize| [l[0][j], l[1][j], l[2][j]];
    let object_to_eye: [[f32; 4]; 3] = std::array::from_fn(|k| {
        [dot(&r[k], column(0)), dot(&r[k], column(1)), dot(&r[k], column(2)), dot(&r[k], way)]
    });
    let distance = object_to_eye[2].map(|v| -v);
    // What goes to the right of what goes up.
    let skewed = |k: usize, up: f32| if k == 0 { eye.skew * up } else { 0.0 };
    let axis = |k: usize| -> [f32; 4] {
        std::array::from_fn(|j| {
            let center = if orthographic {
                if j == 3 { eye.center[k] } else { 0.0 }
            } else {
                eye.center[k] * distance[j]
            };
            eye.focal[k] * object_to_eye[k][j] + skewed(k, object_to_eye[1][j]) + center
        })
    };
    let to = if orthographic { eye.forward } else { way.map(|v| -v) };
    let mut inside: [f32; 3] = std::array::from_fn(|k| dot(&i[k], to));
    if orthographic {
        let length = dot(&inside, inside).sqrt();
        inside = inside.map(|v| if length > 0.0 { v / length } else { 0.0 });
    }
    let normal = std::array::from_fn(|k| {
        std::array::from_fn(|j| {
            dot(&r[k], [placement.normal[0][j], placement.normal[1][j], placement.normal[2][j]])
        })
    });
    Derived { screen: [axis(0), axis(1), distance], object_to_eye, normal, eye: inside }
}

fn footprint(
    rows: &[[f32; 4]; 3],
    constants: &Screen,
    center: [f32; 3],
    extent: [f32; 3],
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
    if nearest > constants.near && slack[2] < FOOTPRINT_SLACK * nearest {
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
    } else {
        // It reaches the near plane: test the half spaces, and cover the whole picture.
        for k in 0..2 {
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
