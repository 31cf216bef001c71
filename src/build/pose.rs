//! A DAG under a pose of its joints: bounds and errors of groups, in a frame about where the vertices go. Clusters are moved
//! when somebody asks for them ([`Pose`]). The proof of the bounds stands in docs/numerics.md.

use std::sync::Arc;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::layout::hierarchy;
use crate::math::affine::{self, Affine};
use crate::math::sphere::round_up;
use crate::math::{Aabb, Sphere};
use crate::mesh::frame;
use crate::model::rule::{ERROR_FLOOR, ERROR_STEP, ROOT_ERROR, SOURCE_ERROR};
use crate::model::skin::{GroupSkin, JointBox, Joints, Lists, Skin, moved_box};
use crate::model::{CoordinateFrame, Dag, GeometryId, Group, Motion, Pose};

/// Rounding of some hundred operations in f64, relative to the result.
pub(super) const ROUNDING: f64 = 1.0e-10;
/// How far f32 moves a position whose coordinates are at most 1.
pub(super) const COORDINATE_ROUNDING: f64 = 1.0 / (1u64 << 24) as f64;

/// The mesh where joints take it: `matrices` map object space at rest to where each joint takes it. Pages are those of the mesh at
/// rest.
pub fn posed(rest: &Dag, skin: &Arc<Skin>, matrices: &[Affine]) -> Result<Dag> {
    if matrices.len() != skin.joints {
        let message =
            format!("expected one for each of the {} joints, found {}", skin.joints, matrices.len());
        return Err(Error::argument("matrices", message));
    }
    if let Some(joint) = matrices.iter().position(|rows| !rows.as_flattened().iter().all(|x| x.is_finite())) {
        return Err(Error::argument("matrices", format!("that of joint {joint} is not finite")));
    }
    let inward = |map: &Affine| inner_to_object(map, &rest.frame);
    let object: Vec<Affine> = matrices.iter().map(inward).collect();
    let frame = frame_of(&object, skin, rest)?;
    let maps: Vec<Affine> = object.iter().map(|map| object_to_inner(map, &frame)).collect();
    let pairs = Pairs::of(&maps);
    let bounds = moved_box(skin.source.iter().map(|entry| entry_box(&maps, entry)));
    let parts: Vec<GroupParts> = (0..rest.groups.len())
        .into_par_iter()
        .map(|g| GroupParts::of(&rest.groups[g], skin.groups.of(g), &skin.errors[g], &maps, &pairs))
        .collect();
    let moved = Moved { frame, bounds, topology: Arc::clone(&skin.topology), parts };
    let joints = Joints { skin: Arc::clone(skin), maps };
    Ok(moved.dag(rest, &skin.below, Motion::Joints(joints)))
}

/// What moves a mesh makes of it.
pub(super) struct Moved {
    /// About where vertices go.
    pub(super) frame: CoordinateFrame,
    /// The box of the source there.
    pub(super) bounds: Aabb,
    /// One for all shapes of the mesh.
    pub(super) topology: Arc<GeometryId>,
    /// By group.
    pub(super) parts: Vec<GroupParts>,
}

impl Moved {
    /// The mesh there: errors increase along the DAG, and spheres nest. `below` are the groups that those of each are made from.
    pub(super) fn dag(self, rest: &Dag, below: &Lists<u32>, motion: Motion) -> Dag {
        let Self { frame, bounds, topology, parts } = self;
        let mut groups: Vec<Group> = rest.groups.to_vec();
        for g in (0..groups.len()).rev() {
            let (part, below) = (&parts[g], below.of(g));
            let mut spheres = vec![part.sphere];
            spheres.extend(below.iter().map(|below| groups[*below as usize].lod_sphere));
            let most =
                |of: fn(&Group) -> f32| below.iter().map(|b| of(&groups[*b as usize])).fold(0.0, f32::max);
            let step = |below: f32, own: f32| own.max((below * ERROR_STEP).next_up()).max(ERROR_FLOOR);
            let of_source = rest.groups[g].min_own_error == SOURCE_ERROR;
            let least = below.iter().map(|b| groups[*b as usize].error).fold(f32::INFINITY, f32::min);
            let (error, bound) = (step(most(|b| b.error), part.error), step(most(|b| b.bound), part.bound));
            let (quadric, attribute_error) = (part.quadric.max(most(|b| b.quadric)), part.attribute_error);
            let (center, extent) = part.bounds.center_extent();
            let group = &mut groups[g];
            (group.lod_sphere, group.center, group.extent) = (Sphere::of_spheres(&spheres), center, extent);
            group.min_own_error = if of_source { SOURCE_ERROR } else { least };
            if group.error != ROOT_ERROR {
                (group.error, group.attribute_error) = (error, attribute_error);
                group.quadric = quadric;
                if group.bound.is_finite() {
                    group.bound = bound;
                }
            }
        }
        let boxes: Vec<Aabb> = parts.iter().map(|part| part.bounds).collect();
        Dag {
            id: GeometryId::default(),
            topology: Some(topology),
            frame,
            bounds,
            nodes: hierarchy(&groups, &boxes),
            groups: groups.into(),
            grid: None,
            pages: rest.pages.in_memory(),
            pose: Some(Arc::new(Pose::new(motion, rest.cluster_count()))),
            ..rest.clone()
        }
    }
}

/// A map of object space as one from internal space.
fn inner_to_object(map: &Affine, frame: &CoordinateFrame) -> Affine {
    let origin = affine::apply(map, frame.origin);
    std::array::from_fn(|k| {
        let [x, y, z, _] = map[k];
        [x * frame.scale, y * frame.scale, z * frame.scale, origin[k]]
    })
}

/// A map to object space as one to internal space.
fn object_to_inner(map: &Affine, frame: &CoordinateFrame) -> Affine {
    std::array::from_fn(|k| {
        let [x, y, z, w] = map[k];
        [x / frame.scale, y / frame.scale, z / frame.scale, (w - frame.origin[k]) / frame.scale]
    })
}

/// A frame in which no coordinate is above 1.
fn frame_of(maps: &[Affine], skin: &Skin, rest: &Dag) -> Result<CoordinateFrame> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for entry in &skin.source {
        let (map, center, extent) = entry_box(maps, entry);
        let (center, extent) = affine::apply_to_box(map, center, extent);
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(center[k] - extent[k]), high[k].max(center[k] + extent[k]));
        }
    }
    let origin: [f64; 3] = std::array::from_fn(|k| low[k] * 0.5 + high[k] * 0.5);
    let largest = (0..3).map(|k| high[k] * 0.5 - low[k] * 0.5).fold(0.0, f64::max) * (1.0 + ROUNDING);
    if !largest.is_finite() || !origin.iter().all(|x| x.is_finite()) {
        return Err(Error::argument("matrices", "they take the mesh beyond what float64 holds".to_owned()));
    }
    let scale = frame::power_of_two_above(largest);
    let stretch = maps.iter().map(affine::norm).fold(0.0, f64::max) / rest.frame.scale;
    let far = origin.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let rounding =
        rest.rounding() * stretch + 3f64.sqrt() * (scale * COORDINATE_ROUNDING + far * f64::EPSILON);
    Ok(CoordinateFrame { origin, scale, rounding: rounding * (1.0 + ROUNDING) })
}

/// A joint's map and its box: centre and half extents.
fn entry_box<'a>(maps: &'a [Affine], entry: &JointBox) -> (&'a Affine, [f64; 3], [f64; 3]) {
    let (center, extent) = entry.bounds.center_extent();
    (&maps[entry.joint as usize], center.map(f64::from), extent.map(f64::from))
}

/// How much linear parts of maps stretch, and how much two of them differ.
struct Pairs {
    joints: usize,
    norms: Vec<f64>,
}

impl Pairs {
    fn of(maps: &[Affine]) -> Self {
        let joints = maps.len();
        let norm = |at: usize| {
            let (i, j) = (at / joints, at % joints);
            match i.cmp(&j) {
                std::cmp::Ordering::Equal => affine::norm(&maps[i]),
                std::cmp::Ordering::Less => affine::norm(&affine::difference(&maps[i], &maps[j])),
                std::cmp::Ordering::Greater => 0.0,
            }
        };
        Self { joints, norms: (0..joints * joints).into_par_iter().map(norm).collect() }
    }

    fn stretch(&self, joint: u32) -> f64 {
        self.norms[joint as usize * (self.joints + 1)]
    }

    /// Of joints in their order.
    fn difference(&self, first: u32, second: u32) -> f64 {
        self.norms[first as usize * self.joints + second as usize]
    }
}

/// What moves a group makes of it, without what it has from those below.
pub(super) struct GroupParts {
    /// Around what its members are.
    pub(super) bounds: Aabb,
    /// Where errors are projected.
    pub(super) sphere: Sphere,
    /// See [`Group::error`].
    pub(super) error: f32,
    /// See [`Group::bound`].
    pub(super) bound: f32,
    /// See [`Group::quadric`].
    pub(super) quadric: f32,
    /// See [`Group::attribute_error`].
    pub(super) attribute_error: f32,
}

impl GroupParts {
    fn of(group: &Group, joints: &[JointBox], errors: &GroupSkin, maps: &[Affine], pairs: &Pairs) -> Self {
        let bounds = moved_box(joints.iter().map(|entry| entry_box(maps, entry)));
        let spheres: Vec<Sphere> = joints
            .iter()
            .map(|entry| {
                let center = group.lod_sphere.center.map(f64::from);
                let radius = f64::from(group.lod_sphere.radius) * pairs.stretch(entry.joint);
                let center = affine::apply(&maps[entry.joint as usize], center).map(|x| x as f32);
                Sphere { center, radius: round_up(radius * (1.0 + ROUNDING)) }
            })
            .collect();
        let stretch = joints.iter().map(|entry| pairs.stretch(entry.joint)).fold(0.0, f64::max);
        let [reach, deviation, edges, edge] =
            [errors.reach, errors.deviation, errors.bend, errors.edge].map(f64::from);
        // How far two joints take a point apart that both of them may act on, and by how much they stretch differently what is
        // in one triangle.
        let (mut apart, mut bend) = (0f64, 0f64);
        for (i, first) in joints.iter().enumerate() {
            for second in &joints[i + 1..] {
                let Some((center, extent)) = meeting(&first.bounds, &second.bounds, edge + reach) else {
                    continue;
                };
                let by = affine::difference(&maps[first.joint as usize], &maps[second.joint as usize]);
                let (center, extent) = affine::apply_to_box(&by, center, extent);
                let farthest = (0..3).map(|k| (center[k].abs() + extent[k]).powi(2)).sum::<f64>();
                apart = apart.max(farthest.sqrt());
                if meeting(&first.bounds, &second.bounds, edge).is_some() {
                    bend = bend.max(pairs.difference(first.joint, second.joint));
                }
            }
        }
        // Either what corresponds for the weights counts, or what is nearest, whatever its weights.
        let moved = |distance: f64| {
            let known = reach.max(distance) * stretch + deviation * apart;
            let nearest = distance * stretch + apart;
            known.min(nearest) + bend * edges / 3.0
        };
        let outwards = |x: f64| round_up(x * (1.0 + ROUNDING));
        let attribute_error = outwards(f64::from(group.attribute_error) * stretch);
        Self {
            bounds,
            sphere: Sphere::of_spheres(&spheres),
            error: outwards(moved(group.distance().into())).max(attribute_error),
            bound: outwards(moved(group.bound.into())),
            quadric: outwards(moved(group.quadric.into())),
            attribute_error,
        }
    }
}

/// Where two boxes meet, each grown by a length: centre and half extents.
fn meeting(a: &Aabb, b: &Aabb, grown: f64) -> Option<([f64; 3], [f64; 3])> {
    let grown = grown * (1.0 + ROUNDING) + f64::EPSILON;
    let low: [f64; 3] = std::array::from_fn(|k| f64::from(a.min[k].max(b.min[k])) - grown);
    let high: [f64; 3] = std::array::from_fn(|k| f64::from(a.max[k].min(b.max[k])) + grown);
    let meet = (0..3).all(|k| low[k] <= high[k]);
    meet.then(|| {
        let center = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        (center, std::array::from_fn(|k| 0.5 * (high[k] - low[k])))
    })
}
