//! `_core.Scene`: instances and lights from Python.

use std::sync::{Arc, RwLockReadGuard, RwLockWriteGuard};

use glam::DAffine3;
use numpy::{PyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use super::arrays::{matrices, matrix4};
use super::assembly::Assembly;
use super::errors::to_python;
use super::image::{EnvironmentMap, Image};
use super::mesh::Mesh;
use crate::error::{Error, Result};
use crate::scene::texture::{Mipmaps, Wrap};
use crate::scene::{
    self, Environment, Handle, InstanceHandle, Light, LightHandle, LightKind, Material, Materials, Slot,
    Texture, pose,
};
use crate::threads::Lock;

/// Index and generation.
type RawHandle = (u32, u32);

/// A material as `Material._raw` gives it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct RawMaterial {
    base_color: [f32; 4],
    metallic: f32,
    roughness: f32,
    emissive: [f32; 3],
    double_sided: bool,
    smooth: bool,
    unlit: bool,
    normal_scale: f32,
    occlusion_strength: f32,
    alpha_cutoff: Option<f32>,
    blends: bool,
    textures: [Option<RawTexture>; Slot::COUNT],
}

/// A texture as `Texture._raw` gives it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct RawTexture {
    image: Py<Image>,
    uv_set: u8,
    wrap: (u8, u8),
    linear: bool,
    mipmaps: u8,
    anisotropy: u32,
    rows: [[f32; 3]; 2],
}

/// Kind, colour, intensity, range, inner and outer angle of the cone, whether it casts shadows.
type RawLight = (String, [f32; 3], f32, Option<f32>, Option<(f64, f64)>, (bool, f64));

/// Map, intensity, rotation, and whether it is seen behind all.
type RawEnvironment = (Py<EnvironmentMap>, f32, f64, bool);

/// What errors call it.
const WHAT: &str = "the scene";

/// What is drawn. See `nanite_rs.Scene`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Scene {
    inner: Lock<scene::Scene>,
}

impl Scene {
    /// The scene, to be read.
    pub(super) fn read(&self) -> Result<RwLockReadGuard<'_, scene::Scene>> {
        self.inner.read(WHAT)
    }

    /// Edits the scene without the interpreter lock, since a render may hold it for a while.
    fn edit<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut RwLockWriteGuard<'_, scene::Scene>) -> Result<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| work(&mut self.inner.write(WHAT)?)).map_err(|error| to_python(py, error))
    }

    fn look<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&scene::Scene) -> Result<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| work(&*self.read()?)).map_err(|error| to_python(py, error))
    }
}

fn handle((index, generation): RawHandle) -> Handle {
    Handle { index, generation }
}

pub(super) fn materials(looks: Vec<RawMaterial>) -> Materials {
    Materials::from(looks.into_iter().map(material).collect::<Vec<_>>())
}

fn material(raw: RawMaterial) -> Material {
    let [red, green, blue, alpha] = raw.base_color;
    Material {
        base_color: [red, green, blue],
        alpha,
        metallic: raw.metallic,
        roughness: raw.roughness,
        emissive: raw.emissive,
        double_sided: raw.double_sided,
        smooth: raw.smooth,
        unlit: raw.unlit,
        normal_scale: raw.normal_scale,
        occlusion_strength: raw.occlusion_strength,
        alpha_cutoff: raw.alpha_cutoff,
        blends: raw.blends,
        textures: raw.textures.map(|texture| texture.map(self::texture)),
    }
}

/// The way of a number, in the order that Python has them in.
pub(super) fn wrap(way: u8) -> Wrap {
    match way {
        0 => Wrap::Repeat,
        1 => Wrap::Mirror,
        _ => Wrap::Clamp,
    }
}

fn texture(raw: RawTexture) -> Texture {
    Texture {
        image: Arc::clone(&raw.image.get().inner),
        uv_set: raw.uv_set,
        wrap: [wrap(raw.wrap.0), wrap(raw.wrap.1)],
        linear: raw.linear,
        mipmaps: match raw.mipmaps {
            0 => Mipmaps::Off,
            1 => Mipmaps::Nearest,
            _ => Mipmaps::Linear,
        },
        anisotropy: raw.anisotropy,
        rows: raw.rows,
    }
}

/// Adds something at all poses, or nothing where one of them is wrong.
fn all(
    scene: &mut scene::Scene,
    poses: &[[[f64; 4]; 4]],
    add: impl Fn(&mut scene::Scene, &[[f64; 4]; 4]) -> Result<InstanceHandle>,
) -> Result<Vec<RawHandle>> {
    pose::affines("poses", poses)?;
    let handle = |InstanceHandle(at): InstanceHandle| (at.index, at.generation);
    poses.iter().map(|pose| add(scene, pose).map(handle)).collect()
}

fn light(
    (kind, color, intensity, range, cone, (casts_shadows, radius)): RawLight,
    rows: &[[f64; 4]; 4],
) -> Result<Light> {
    let kind = match (&kind[..], cone) {
        ("directional", None) => LightKind::Directional,
        ("point", None) => LightKind::Point { range },
        ("spot", Some((inner, outer))) => LightKind::Spot { range, inner, outer },
        _ => return Err(Error::argument("kind", format!("no light is {kind:?} with this cone"))),
    };
    let pose = pose::affine("pose", rows)?;
    Ok(Light { kind, color, intensity, pose, visible: true, casts_shadows, radius })
}

/// Checks the parameters of a light; the error names the first that is wrong.
#[pyfunction]
pub(super) fn check_light(py: Python<'_>, shape: RawLight) -> PyResult<()> {
    let rows = pose::rows(&DAffine3::IDENTITY);
    light(shape, &rows).and_then(|light| light.validate()).map_err(|error| to_python(py, error))
}

#[pymethods]
impl Scene {
    #[new]
    fn new() -> Self {
        Self { inner: Lock::new(scene::Scene::default()) }
    }

    /// Adds an instance; returns its handle.
    fn add_mesh(
        &self,
        py: Python<'_>,
        mesh: &Mesh,
        pose: &Bound<'_, PyAny>,
        looks: Vec<RawMaterial>,
    ) -> PyResult<RawHandle> {
        let rows = matrix4(pose, "pose")?;
        let dag = Arc::clone(&mesh.dag);
        let at = self.edit(py, |scene| scene.add(dag, &rows, materials(looks)))?.0;
        Ok((at.index, at.generation))
    }

    /// Adds an instance of an assembly; returns its handle.
    fn add_assembly(
        &self,
        py: Python<'_>,
        assembly: &Assembly,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<RawHandle> {
        let rows = matrix4(pose, "pose")?;
        let assembly = Arc::clone(&assembly.inner);
        let at = self.edit(py, |scene| scene.add_assembly(assembly, &rows))?.0;
        Ok((at.index, at.generation))
    }

    /// Adds an instance at each of many poses, or none where one is wrong; returns their handles.
    fn add_meshes(
        &self,
        py: Python<'_>,
        mesh: &Mesh,
        poses: &Bound<'_, PyAny>,
        looks: Vec<RawMaterial>,
    ) -> PyResult<Vec<RawHandle>> {
        let (poses, mesh, looks) = (matrices(poses, "poses")?, &mesh.dag, materials(looks));
        self.edit(py, |scene| {
            all(scene, &poses, |scene, pose| scene.add(Arc::clone(mesh), pose, looks.clone()))
        })
    }

    /// The same of an assembly.
    fn add_assemblies(
        &self,
        py: Python<'_>,
        assembly: &Assembly,
        poses: &Bound<'_, PyAny>,
    ) -> PyResult<Vec<RawHandle>> {
        let (poses, assembly) = (matrices(poses, "poses")?, &assembly.inner);
        self.edit(py, |scene| {
            all(scene, &poses, |scene, pose| scene.add_assembly(Arc::clone(assembly), pose))
        })
    }

    /// Number of instances of assemblies.
    #[getter]
    fn assembly_count(&self, py: Python<'_>) -> PyResult<usize> {
        self.look(py, |s| Ok(s.assemblies()))
    }

    /// Moves an instance.
    fn set_pose(&self, py: Python<'_>, at: RawHandle, pose: &Bound<'_, PyAny>) -> PyResult<()> {
        let rows = matrix4(pose, "pose")?;
        self.edit(py, |scene| scene.set_pose(InstanceHandle(handle(at)), &rows))
    }

    /// Gives instances another geometry: handles of those that are there no more are stale.
    fn set_mesh(&self, py: Python<'_>, at: Vec<RawHandle>, mesh: &Mesh) -> PyResult<()> {
        self.edit(py, |scene| {
            at.into_iter()
                .try_for_each(|at| scene.set_mesh(InstanceHandle(handle(at)), Arc::clone(&mesh.dag)))
        })
    }

    /// Object to world of an instance.
    fn pose(&self, py: Python<'_>, at: RawHandle) -> PyResult<Py<PyArray2<f64>>> {
        let rows = self.look(py, |s| Ok(pose::rows(s.instance(InstanceHandle(handle(at)))?.pose())))?;
        Ok(PyArray::from_vec(py, rows.concat()).reshape([4, 4])?.unbind())
    }

    /// Shows or hides an instance.
    fn set_visible(&self, py: Python<'_>, at: RawHandle, visible: bool) -> PyResult<()> {
        self.edit(py, |scene| scene.set_visible(InstanceHandle(handle(at)), visible))
    }

    /// True unless an instance is hidden.
    fn visible(&self, py: Python<'_>, at: RawHandle) -> PyResult<bool> {
        self.look(py, |s| Ok(s.instance(InstanceHandle(handle(at)))?.visible))
    }

    /// Says whether an instance casts shadows, and whether they fall on it.
    fn set_shadows(&self, py: Python<'_>, at: RawHandle, casts: bool, receives: bool) -> PyResult<()> {
        self.edit(py, |scene| scene.set_shadows(InstanceHandle(handle(at)), casts, receives))
    }

    /// Whether an instance casts shadows, and whether they fall on it.
    fn shadows(&self, py: Python<'_>, at: RawHandle) -> PyResult<(bool, bool)> {
        self.look(py, |s| Ok(s.instance(InstanceHandle(handle(at)))?.shadows()))
    }

    /// Changes the look of an instance.
    fn set_material(&self, py: Python<'_>, at: RawHandle, looks: Vec<RawMaterial>) -> PyResult<()> {
        self.edit(py, |scene| scene.set_material(InstanceHandle(handle(at)), materials(looks)))
    }

    /// Removes an instance.
    fn remove(&self, py: Python<'_>, at: RawHandle) -> PyResult<()> {
        self.edit(py, |scene| scene.remove(InstanceHandle(handle(at))).map(drop))
    }

    /// Adds a light; returns its handle.
    fn add_light(&self, py: Python<'_>, shape: RawLight, pose: &Bound<'_, PyAny>) -> PyResult<RawHandle> {
        let rows = matrix4(pose, "pose")?;
        let at = self.edit(py, |scene| scene.add_light(light(shape, &rows)?))?.0;
        Ok((at.index, at.generation))
    }

    /// Replaces a light.
    fn set_light(
        &self,
        py: Python<'_>,
        at: RawHandle,
        shape: RawLight,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let rows = matrix4(pose, "pose")?;
        let at = LightHandle(handle(at));
        self.edit(py, |scene| {
            let visible = scene.light(at)?.visible;
            scene.set_light(at, Light { visible, ..light(shape, &rows)? })
        })
    }

    /// Switches a light on or off.
    fn set_light_visible(&self, py: Python<'_>, at: RawHandle, visible: bool) -> PyResult<()> {
        let at = LightHandle(handle(at));
        self.edit(py, |scene| {
            let light = Light { visible, ..*scene.light(at)? };
            scene.set_light(at, light)
        })
    }

    /// True unless a light is switched off.
    fn light_visible(&self, py: Python<'_>, at: RawHandle) -> PyResult<bool> {
        self.look(py, |s| Ok(s.light(LightHandle(handle(at)))?.visible))
    }

    /// Light to world of a light.
    fn light_pose(&self, py: Python<'_>, at: RawHandle) -> PyResult<Py<PyArray2<f64>>> {
        let rows = self.look(py, |s| Ok(pose::rows(&s.light(LightHandle(handle(at)))?.pose)))?;
        Ok(PyArray::from_vec(py, rows.concat()).reshape([4, 4])?.unbind())
    }

    /// Removes a light.
    fn remove_light(&self, py: Python<'_>, at: RawHandle) -> PyResult<()> {
        self.edit(py, |scene| scene.remove_light(LightHandle(handle(at))).map(drop))
    }

    /// Constant light on every surface.
    #[getter]
    fn ambient_light(&self, py: Python<'_>) -> PyResult<[f32; 3]> {
        self.look(py, |s| Ok(s.ambient_light()))
    }

    /// Sets the ambient light.
    fn set_ambient_light(&self, py: Python<'_>, color: [f32; 3]) -> PyResult<()> {
        self.edit(py, |scene| scene.set_ambient_light(color))
    }

    /// Colour of pixels that nothing covers.
    #[getter]
    fn bg_color(&self, py: Python<'_>) -> PyResult<[f32; 3]> {
        self.look(py, |s| Ok(s.bg_color()))
    }

    /// Sets the background colour.
    fn set_bg_color(&self, py: Python<'_>, color: [f32; 3]) -> PyResult<()> {
        self.edit(py, |scene| scene.set_bg_color(color))
    }

    /// Sets the environment, or takes it away.
    fn set_environment(&self, py: Python<'_>, environment: Option<RawEnvironment>) -> PyResult<()> {
        let environment = environment.map(|(map, intensity, rotation, background)| Environment {
            map: Arc::clone(&map.get().inner),
            intensity,
            rotation,
            background,
        });
        self.edit(py, |scene| scene.set_environment(environment))
    }

    /// Number of instances.
    #[getter]
    fn instance_count(&self, py: Python<'_>) -> PyResult<usize> {
        self.look(py, |s| Ok(s.instances().len()))
    }

    /// Number of lights.
    #[getter]
    fn light_count(&self, py: Python<'_>) -> PyResult<usize> {
        self.look(py, |s| Ok(s.lights().len()))
    }
}
