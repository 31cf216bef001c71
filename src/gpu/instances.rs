//! The instances of a scene on the device: each in the slot that the scene gave it. What changed since the last frame is
//! written, in runs; a camera that moves writes nothing.

use std::sync::Arc;

use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::materials::MaterialTable;
use super::meshes::{Meshes, topology};
use crate::config::Shading;
use crate::error::{Error, Result};
use crate::gpu_types::{InstanceMaterial, InstanceTransform};
use crate::model::Dag;
use crate::scene::Materials;
use crate::stream::Resident;

/// Slots that did not change are written along where the way around is as short.
const GAP: usize = 16;

/// What the arrays hold, for messages.
pub(super) const WHAT: &str = "the instances of the scene";

/// An instance as it is drawn. Where its mesh and its materials lie on the device is filled in.
#[derive(Debug)]
pub struct SceneInstance<'a> {
    /// Where it is.
    pub transform: InstanceTransform,
    /// How it looks.
    pub material: InstanceMaterial,
    /// What it is.
    pub mesh: &'a Arc<Dag>,
    /// Its materials, unless there is a plain one, which is part of the look.
    pub materials: Option<&'a Materials>,
}

/// The slots of a scene.
#[derive(Debug, Default)]
pub(super) struct Instances {
    records: Vec<InstanceTransform>,
    instance_materials: Vec<InstanceMaterial>,
    meshes: Vec<Option<Arc<Dag>>>,
    /// Triangles of these at full detail.
    faces: Vec<u64>,
    materials: Vec<Option<Materials>>,
    table: MaterialTable,
    /// Slots to write, with repetitions.
    changed: Vec<u32>,
    /// Some slot has another mesh than before, so that what lies behind it may lie elsewhere.
    rearranged: bool,
    /// Some slot has another shape of its mesh than before.
    reshaped: bool,
    /// Some slot has other materials than before.
    repainted: bool,
    /// What frames materials are on the device for.
    shading: Shading,
    buffers: Option<Slots>,
    /// How often it was told where they lie and which bits are theirs.
    arrangements: u64,
    /// Words of the bits of all groups, and levels of the deepest hierarchy.
    group_words: u32,
    depth: u32,
}

/// The arrays on the device.
#[derive(Debug)]
pub(super) struct Slots {
    room: u32,
    /// As the scene places them.
    pub(super) transforms: Buffer,
    /// How they look.
    pub(super) instance_materials: Buffer,
}

impl Instances {
    /// Forgets all.
    pub(super) fn clear(&mut self) {
        let (buffers, arrangements) = (self.buffers.take(), self.arrangements);
        *self = Self { buffers, arrangements, rearranged: true, repainted: true, ..Self::default() };
    }

    /// Puts an instance in a slot, or nothing. Where its mesh lies on the device is found out later.
    pub(super) fn set(&mut self, slot: u32, instance: Option<SceneInstance<'_>>) {
        let index = slot as usize;
        if self.records.len() <= index {
            self.records.resize(index + 1, bytemuck::Zeroable::zeroed());
            self.instance_materials.resize(index + 1, bytemuck::Zeroable::zeroed());
            self.meshes.resize(index + 1, None);
            self.faces.resize(index + 1, 0);
            self.materials.resize(index + 1, None);
        }
        let (record, material, mesh, materials) = match instance {
            Some(SceneInstance { transform, material, mesh, materials }) => {
                (transform, material, Some(mesh), materials)
            }
            None => (bytemuck::Zeroable::zeroed(), bytemuck::Zeroable::zeroed(), None, None),
        };
        if self.materials[index].as_ref() != materials {
            self.repainted = true;
            self.materials[index] = materials.cloned();
        }
        let InstanceMaterial { first_material, last_material, .. } = self.instance_materials[index];
        self.instance_materials[index] = match materials {
            Some(_) => InstanceMaterial { first_material, last_material, ..material },
            None => material,
        };
        let known = self.meshes[index].as_ref();
        if known.map(|mesh| mesh.id.number()) != mesh.map(|mesh| mesh.id.number()) {
            let before = known.and_then(|mesh| topology(mesh));
            let same = before.is_some() && before == mesh.and_then(|mesh| topology(mesh));
            *(if same { &mut self.reshaped } else { &mut self.rearranged }) = true;
            self.meshes[index] = mesh.cloned();
            self.faces[index] = mesh.map_or(0, |mesh| mesh.source_faces);
        }
        let InstanceTransform { first_node, first_group, first_page, group_words, .. } = self.records[index];
        let placement = InstanceTransform { first_node, first_group, first_page, group_words, ..record };
        self.records[index] = placement;
        self.changed.push(slot);
    }

    /// Slots in use, or that were.
    pub(super) fn len(&self) -> u32 {
        self.records.len() as u32
    }

    /// Triangles at full detail of the mesh in each slot.
    pub(super) fn faces(&self) -> &[u64] {
        &self.faces
    }

    /// Slots that there is room for.
    pub(super) fn room(&self) -> u32 {
        self.buffers.as_ref().map_or(0, |slots| slots.room)
    }

    /// Whether anything is to be seen.
    pub(super) fn any(&self) -> bool {
        self.records.iter().any(|record| record.visible != 0)
    }

    /// A number for where they lie and which bits are theirs: lists made with another mean something else.
    pub(super) fn arrangement(&self) -> u64 {
        self.arrangements
    }

    /// Words of the bits of all groups.
    pub(super) fn group_words(&self) -> u32 {
        self.group_words
    }

    /// Levels of the deepest hierarchy.
    pub(super) fn depth(&self) -> u32 {
        self.depth
    }

    /// Takes in what colours will be. Whether bringing the device up to date may then put other buffers in the place of those
    /// of the scene.
    pub(super) fn replaces_buffers(
        &mut self,
        meshes: &Meshes,
        resident: &Resident,
        shading: Shading,
    ) -> bool {
        let encoded = |shading| shading == Shading::Pyrender;
        self.repainted |= encoded(shading) != encoded(self.shading) && self.table.buffers().is_some();
        self.shading = shading;
        let reshaped = self.reshaped && !meshes.have_places(self.meshes.iter().flatten());
        let meshes_come = self.rearranged || reshaped || meshes.lacks_places(resident);
        meshes_come || self.repainted || self.room() < self.len()
    }

    /// Brings the device up to date, meshes first. Returns the bytes of instances written.
    pub(super) fn upload(
        &mut self,
        context: &Context,
        meshes: &mut Meshes,
        resident: &Resident,
    ) -> Result<u64> {
        if let Err(error) = self.bring(context, meshes, resident) {
            // Of what has come by then nobody knows.
            (*meshes, self.rearranged) = (Meshes::default(), true);
            (self.table, self.repainted) = (MaterialTable::default(), true);
            return Err(error);
        }
        if self.room() < self.len() {
            let room = self.len().checked_next_power_of_two().unwrap_or(self.len());
            let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            let buffer = |bytes: usize| context.buffer(WHAT, u64::from(room) * bytes as u64, storage);
            // The old ones go first.
            self.buffers = None;
            let (transforms, instance_materials) =
                (buffer(size_of::<InstanceTransform>())?, buffer(size_of::<InstanceMaterial>())?);
            self.buffers = Some(Slots { room, transforms, instance_materials });
            self.changed = (0..self.len()).collect();
        }
        let Some(slots) = &self.buffers else { return Ok(0) };
        let mut written = 0;
        self.changed.sort_unstable();
        for run in self.changed.chunk_by(|a, b| (b - a) as usize <= GAP) {
            let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
            let run = *first as usize..=*last as usize;
            written += write(context, &slots.transforms, *first, &self.records[run.clone()])?;
            written += write(context, &slots.instance_materials, *first, &self.instance_materials[run])?;
        }
        self.changed.clear();
        Ok(written)
    }

    /// Brings the meshes up to date.
    fn bring(&mut self, context: &Context, meshes: &mut Meshes, resident: &Resident) -> Result<()> {
        let anew = self.rearranged || meshes.lacks_places(resident);
        if anew || self.reshaped {
            meshes.upload(context, self.meshes.iter().flatten(), resident)?;
            self.arrange(meshes, anew)?;
            (self.rearranged, self.reshaped) = (false, false);
        }
        if self.repainted {
            self.paint(context)?;
            self.repainted = false;
        }
        meshes.stream(context, resident)
    }

    /// Tells each instance where its materials are.
    fn paint(&mut self, context: &Context) -> Result<()> {
        let materials = self.materials.iter().map(Option::as_ref);
        let firsts = if materials.clone().any(|m| m.is_some()) {
            self.table.upload(context, materials, self.shading)?
        } else {
            self.table = MaterialTable::default();
            vec![[u32::MAX, 0]; self.instance_materials.len()]
        };
        for ((material, [first_material, last_material]), slot) in
            self.instance_materials.iter_mut().zip(firsts).zip(0..)
        {
            let painted = InstanceMaterial { first_material, last_material, ..*material };
            if *material != painted {
                *material = painted;
                self.changed.push(slot);
            }
        }
        Ok(())
    }

    /// The materials on the device, where an instance has others than a plain one.
    pub(super) fn table(&self) -> &MaterialTable {
        &self.table
    }

    /// Tells each instance where its mesh is and gives it bits for its groups. Unless all is `anew`, meshes are what they were
    /// but for their shapes.
    fn arrange(&mut self, meshes: &Meshes, anew: bool) -> Result<()> {
        let (mut words, mut depth, mut moved) = (0u32, 0, anew);
        for ((record, mesh), slot) in self.records.iter_mut().zip(&self.meshes).zip(0..) {
            let mut arranged = InstanceTransform { group_words: words, ..*record };
            if let Some(mesh) = mesh {
                let Some(place) = meshes.placement(mesh) else {
                    return Err(Error::Invariant("a mesh of the scene was not uploaded".to_owned()));
                };
                arranged.first_node = place.first_node;
                arranged.first_group = place.first_group;
                arranged.first_page = place.first_page;
                depth = depth.max(place.depth);
                let more = (mesh.groups.len() as u32).div_ceil(u32::BITS);
                words = words.checked_add(more).ok_or_else(|| {
                    let message = "the instances of the scene have more than 2^37 groups of clusters";
                    Error::TooLarge(message.to_owned())
                })?;
            }
            if *record != arranged {
                *record = arranged;
                self.changed.push(slot);
                moved = true;
            }
        }
        (self.group_words, self.depth) = (words, depth);
        self.arrangements += u64::from(moved);
        Ok(())
    }

    /// The arrays on the device, once there are any.
    pub(super) fn slots(&self) -> Option<&Slots> {
        self.buffers.as_ref()
    }
}

/// Writes entries from `first` on; returns how many bytes these are.
fn write<T: bytemuck::NoUninit>(
    context: &Context,
    buffer: &Buffer,
    first: u32,
    entries: &[T],
) -> Result<u64> {
    let offset = u64::from(first) * size_of::<T>() as u64;
    context.write(WHAT, buffer, offset, bytemuck::cast_slice(entries))?;
    Ok(size_of_val(entries) as u64)
}
