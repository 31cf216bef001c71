//! An instance as seen from a view: the f32 matrices that every stage uses.

use std::sync::Arc;

use super::footprint::{Footprint, footprint};
use super::screen::{Screen, homogeneous};
use super::stroke::Stroke;
use crate::math::{LodView, Sphere};
use crate::model::{ClusterAddress, ClusterGeometry, Dag, Pages};
use crate::scene::placement::{Eye, Placement};
use crate::scene::{Instance, Materials};
use crate::stream::Resident;

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
    /// Of points and lines, how large they are drawn.
    pub stroke: Option<Stroke>,
    /// Shadows fall on it.
    pub receives_shadows: bool,
    /// Back faces are drawn, whatever its materials say: from a light.
    pub two_sided: bool,
    /// Pixel bounds and nearest key of the whole instance, where the CPU culls.
    pub footprint: Footprint,
}

/// Where a cluster lies: internal space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterBounds {
    /// About the centre of its box; encloses its vertices.
    pub sphere: Sphere,
    /// Half extents of its box, rounded up.
    pub extent: [f32; 3],
    /// Axis and cutoff of its cone of normals, see [`crate::model::ClusterRecord::cone`].
    pub cone: ([f32; 3], f32),
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
            stroke: Stroke::new(instance.mesh.primitive, eye),
            receives_shadows: instance.receives_shadows(),
            two_sided: false,
            footprint: Footprint::default(),
        }
    }

    /// The same instance on the picture of another eye. What decides on its cut stays.
    pub fn moved_to(&self, eye: &Eye, orthographic: bool, placement: &Placement) -> Self {
        let Derived { screen, .. } = derive(eye, orthographic, placement);
        Self { screen, ..self.clone() }
    }

    /// The same instance on a part of the picture of a parallel eye, from so many pixels right and down on.
    pub fn shifted(&self, by: [f32; 2]) -> Self {
        let mut out = self.clone();
        (0..2).for_each(|k| out.screen[k][3] -= by[k]);
        out
    }

    /// Whether back faces of clusters with a number are seen.
    #[inline]
    pub fn double_sided(&self, material: i32) -> bool {
        self.two_sided || self.materials.double_sided(material)
    }

    /// Whether a cluster is blended with what is behind it.
    #[inline]
    pub fn is_blended(&self, cluster: ClusterAddress) -> bool {
        self.materials.blended(self.pages.record(cluster).material, self.mesh.layout().colors.is_some())
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
        footprint(&self.screen, constants, center, extent, self.stroke.as_ref())
    }

    /// Where a cluster lies, and which way it faces. Culling asks here alone, so that a geometry whose shape changes can
    /// answer otherwise than by its pages.
    #[inline]
    pub fn cluster_bounds(&self, cluster: ClusterAddress) -> ClusterBounds {
        if let Some(pose) = &self.mesh.pose {
            let (sphere, extent) = pose.cluster_bounds(&self.pages, cluster);
            return ClusterBounds { sphere, extent, cone: ([0.0; 3], 1.0) };
        }
        let record = self.pages.record(cluster);
        let sphere = Sphere { center: record.center, radius: record.radius };
        ClusterBounds { sphere, extent: record.extent, cone: record.cone() }
    }

    /// The vertices and triangles of a cluster. Rasterizers and shading fetch them here alone, for the same reason.
    #[inline]
    pub fn cluster(&self, cluster: ClusterAddress) -> ClusterGeometry<'_> {
        self.mesh.geometry_of(&self.pages, cluster)
    }

    /// True when every triangle of a cluster with these bounds faces away.
    #[inline]
    pub fn faces_away(&self, orthographic: bool, bounds: &ClusterBounds) -> bool {
        let ClusterBounds { sphere, cone: (axis, cutoff), .. } = *bounds;
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
