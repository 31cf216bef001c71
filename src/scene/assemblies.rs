//! Assemblies: lists of placed meshes and of placed assemblies, which are themselves placed in scenes. What stands in many
//! places is held once, whatever it consists of; from far away one mesh stands for all of it.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::material::{Materials, Slot};
use super::pose;
use crate::error::{Error, Result};
use crate::limits::ASSEMBLY_DEPTH;
use crate::math::singular_value_bound;
use crate::model::Dag;

/// How much more than exact spheres the stored ones are: this covers the rounding of f64.
const MARGIN: f64 = 1.0 + 1.0e-9;

/// A mesh and its look.
#[derive(Clone, Debug)]
pub struct Dressed {
    /// The mesh.
    pub mesh: Arc<Dag>,
    /// Its look.
    pub materials: Materials,
}

impl Dressed {
    /// A mesh with materials that it can have.
    pub fn new(mesh: Arc<Dag>, materials: impl Into<Materials>) -> Result<Self> {
        let materials = fitting(materials.into(), &mesh)?;
        Ok(Self { mesh, materials })
    }
}

/// Materials that a mesh can have: in range, with textures on UV sets that it has.
pub(super) fn fitting(materials: Materials, mesh: &Dag) -> Result<Materials> {
    materials.validate()?;
    let sets = mesh.layout().uv_sets;
    for (slot, texture) in materials.list().iter().flat_map(|m| Slot::ALL.into_iter().zip(&m.textures)) {
        if let Some(texture) = texture.as_ref().filter(|texture| texture.uv_set >= sets) {
            let message = format!("wants UV set {}, of which the mesh has {sets}", texture.uv_set);
            return Err(Error::argument(slot.name(), message));
        }
    }
    Ok(materials)
}

/// What stands in the places of a part.
#[derive(Clone, Debug)]
pub enum PartShape {
    /// A mesh.
    Mesh(Dressed),
    /// An assembly.
    Assembly(Arc<Assembly>),
}

/// One of the places of a part: its frame to that of the assembly.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The map.
    pub pose: DAffine3,
    /// An upper bound of how much it stretches any length.
    pub scale: f64,
}

/// One thing in many places.
#[derive(Clone, Debug)]
pub struct Part {
    /// The thing.
    pub shape: PartShape,
    /// Where it stands.
    pub places: Vec<Place>,
}

impl Part {
    /// A thing at poses, rows first.
    pub fn new(shape: PartShape, poses: &[[[f64; 4]; 4]]) -> Result<Self> {
        let place = |pose: DAffine3| {
            let scale = singular_value_bound(pose::linear_rows(&pose.matrix3));
            Place { pose, scale }
        };
        let places: Vec<Place> = pose::affines("poses", poses)?.into_iter().map(place).collect();
        if places.is_empty() {
            return Err(Error::argument("poses", "there are none"));
        }
        Ok(Self { shape, places })
    }

    /// A box around the thing, in its own frame.
    fn bounds(&self) -> (DVec3, DVec3) {
        match &self.shape {
            PartShape::Mesh(Dressed { mesh, .. }) => mesh_box(mesh),
            PartShape::Assembly(assembly) => assembly.bounds,
        }
    }

    fn depth(&self) -> usize {
        match &self.shape {
            PartShape::Mesh(_) => 0,
            PartShape::Assembly(assembly) => assembly.depth,
        }
    }

    /// Meshes in one place of it, those of assemblies one by one.
    fn leaves(&self) -> u64 {
        match &self.shape {
            PartShape::Mesh(_) => 1,
            PartShape::Assembly(assembly) => assembly.leaves,
        }
    }
}

/// Parts and what stands for all of them.
#[derive(Clone, Debug)]
pub struct Assembly {
    /// What it consists of, in scene order.
    pub parts: Vec<Part>,
    /// What is drawn of it where it is small. The rounding of its positions includes how far it is off the parts.
    pub far: Dressed,
    /// A box around all of it: smallest and largest corner.
    bounds: (DVec3, DVec3),
    /// Assemblies inside of each other, this one counted.
    depth: usize,
    leaves: u64,
}

impl Assembly {
    /// Of parts and the mesh that stands for them.
    pub fn new(parts: Vec<Part>, far: Dressed) -> Result<Self> {
        if parts.is_empty() {
            return Err(Error::argument("parts", "there are none"));
        }
        let depth = 1 + parts.iter().map(Part::depth).max().unwrap_or(0);
        if depth > ASSEMBLY_DEPTH {
            let message = format!(
                "assemblies hold assemblies, {depth} inside of each other; the most is {ASSEMBLY_DEPTH}"
            );
            return Err(Error::argument("parts", message));
        }
        let (mut low, mut high) = mesh_box(&far.mesh);
        for (i, part) in parts.iter().enumerate() {
            let (center, half) = middle(part.bounds());
            for (j, Place { pose, .. }) in part.places.iter().enumerate() {
                let m = &pose.matrix3;
                let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
                let reach = reach * MARGIN;
                let at = pose.transform_point3(center);
                if !(at.is_finite() && reach.is_finite()) {
                    let message = format!("[{i}]: poses[{j}]: it lies beyond the largest numbers there are");
                    return Err(Error::argument("parts", message));
                }
                (low, high) = (low.min(at - reach), high.max(at + reach));
            }
        }
        let of_part = |part: &Part| part.leaves().saturating_mul(part.places.len() as u64);
        let leaves = parts.iter().map(of_part).fold(0, u64::saturating_add);
        Ok(Self { parts, far, bounds: (low, high), depth, leaves })
    }

    /// Smallest and largest corner of a box around all of it.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    /// A sphere around all of it: centre and radius.
    pub fn sphere(&self) -> (DVec3, f64) {
        let (center, half) = middle(self.bounds);
        (center, half.length() * MARGIN)
    }

    /// How far the mesh that stands for it may be off the parts: a bound, object units.
    pub fn error(&self) -> f64 {
        self.far.mesh.rounding()
    }

    /// Meshes that it consists of, those of assemblies in it one by one.
    pub fn leaves(&self) -> u64 {
        self.leaves
    }
}

fn mesh_box(mesh: &Dag) -> (DVec3, DVec3) {
    let corner = |p| DVec3::from_array(mesh.frame.to_object(p));
    let (low, high) = (corner(mesh.bounds.min), corner(mesh.bounds.max));
    // Positions may have been rounded.
    (low - mesh.rounding(), high + mesh.rounding())
}

/// Centre and half extents of a box.
fn middle((low, high): (DVec3, DVec3)) -> (DVec3, DVec3) {
    let center = 0.5 * low + 0.5 * high;
    (center, (high - center).max(center - low))
}

/// Which instances of what is drawn are parts of which instance of an assembly.
#[derive(Clone, Debug, Default)]
pub struct Owners {
    /// First slot of each run of parts, in ascending order, and the slot of the instance that they are of.
    runs: Vec<(u32, u32)>,
}

impl Owners {
    /// Of runs: first slots, ascending, and owners.
    pub fn new(runs: Vec<(u32, u32)>) -> Self {
        Self { runs }
    }

    /// Whether every instance is its own.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// The slot of the instance of the scene that what is in a slot belongs to.
    pub fn of(&self, slot: u32) -> u32 {
        match self.runs.partition_point(|(first, _)| *first <= slot) {
            0 => slot,
            after => self.runs[after - 1].1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_before_the_first_run_are_their_own() {
        let owners = Owners::new(vec![(8, 2), (11, 5)]);
        let of: Vec<u32> = [0, 7, 8, 10, 11, 40].into_iter().map(|slot| owners.of(slot)).collect();
        assert_eq!(of, [0, 7, 2, 2, 5, 5]);
        assert_eq!(Owners::default().of(3), 3);
    }
}
