//! `_core.Unbaked`: a mesh whose levels are grown, and wait for images.

use std::sync::Mutex;

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{into_array, into_rows};
use super::calls::{detached, watched};
use super::errors::argument_error;
use super::mesh::{Mesh, RawArrays, build_options};
use crate::build::rebake::{self, Atlas, Rebaking, Surface};

/// What has grown, until it is finished.
#[pyclass(frozen, module = "nanite_rs._core")]
pub(super) struct Unbaked(Mutex<Option<rebake::Unbaked>>);

/// What was baked for a surface.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct RawAtlas<'py> {
    origins: PyReadonlyArray1<'py, u32>,
    uvs: PyReadonlyArray2<'py, f32>,
    faces: PyReadonlyArray2<'py, u32>,
    material: i32,
    texel: f64,
}

#[pymethods]
impl Unbaked {
    /// Grows the levels of a mesh. `classes` are pairs of a material and what it becomes where levels are welded: numbers of
    /// `numbers`, first and behind the last, which no face of the source has.
    #[new]
    #[pyo3(signature = (arrays, *, options, classes, numbers, progress=None))]
    fn new<'py>(
        py: Python<'py>,
        arrays: RawArrays<'py>,
        options: &Bound<'py, PyDict>,
        classes: Vec<(i32, i32)>,
        numbers: (i32, i32),
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let options = build_options(options)?;
        let rebaking = Rebaking { classes: classes.into_iter().collect(), numbers: numbers.0..numbers.1 };
        arrays.with_source(|source| {
            watched(py, options.threads, progress.as_ref(), |progress| {
                rebake::grow(source, &options, rebaking, progress)
            })
            .map(|grown| Self(Mutex::new(Some(grown))))
        })
    }

    /// What has to be baked, finest first.
    fn surfaces<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let surfaces = {
            let grown = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            grown.as_ref().map(rebake::Unbaked::surfaces).unwrap_or_default()
        };
        let surface = |surface: Surface| {
            let out = PyDict::new(py);
            out.set_item("level", surface.level)?;
            out.set_item("material", surface.material)?;
            out.set_item("vertices", into_rows(py, surface.positions)?)?;
            out.set_item("normals", into_rows(py, surface.normals)?)?;
            out.set_item("faces", into_rows(py, surface.faces)?)?;
            out.set_item("errors", into_array(py, surface.errors))?;
            Ok(out)
        };
        surfaces.into_iter().map(surface).collect()
    }

    /// The mesh with what was baked for each of the surfaces; nothing is left here.
    fn finish(&self, py: Python<'_>, atlases: Vec<RawAtlas<'_>>) -> PyResult<Mesh> {
        let wrong = |what: &str| argument_error(py, "atlases", what.to_owned());
        let atlas = |raw: &RawAtlas<'_>| -> PyResult<Atlas> {
            let uvs = raw.uvs.as_slice()?.as_chunks::<2>();
            let faces = raw.faces.as_slice()?.as_chunks::<3>();
            if !uvs.1.is_empty() || !faces.1.is_empty() {
                return Err(wrong("expected (N, 2) coordinates and (M, 3) faces"));
            }
            Ok(Atlas {
                origins: raw.origins.as_slice()?.to_vec(),
                uvs: uvs.0.to_vec(),
                faces: faces.0.to_vec(),
                material: raw.material,
                texel: raw.texel,
            })
        };
        let atlases = atlases.iter().map(atlas).collect::<PyResult<Vec<_>>>()?;
        let grown = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        let grown = grown.ok_or_else(|| wrong("the mesh is finished"))?;
        detached(py, || grown.finish(&atlases)).map(Mesh::new)
    }
}
