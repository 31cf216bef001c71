//! `_core.Assembly`: placed meshes and assemblies from Python.

use std::sync::Arc;

use numpy::PyArray2;
use pyo3::prelude::*;

use super::arrays::{into_rows, matrices};
use super::calls::detached;
use super::errors::to_python;
use super::mesh::Mesh;
use super::scene::{RawMaterial, materials};
use crate::error::{Error, Result};
use crate::scene::{self, Dressed, Part, PartShape, pose};

/// Parts and the mesh that stands for them. See `nanite_rs.Assembly`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Assembly {
    pub(super) inner: Arc<scene::Assembly>,
}

/// Checks poses, (N, 4, 4); the error says which is wrong.
#[pyfunction]
pub(super) fn check_poses(py: Python<'_>, poses: &Bound<'_, PyAny>) -> PyResult<()> {
    let poses = matrices(poses, "poses")?;
    pose::affines("poses", &poses).map(drop).map_err(|error| to_python(py, error))
}

/// What a part is of.
#[derive(FromPyObject)]
enum RawShape {
    Mesh(Py<Mesh>),
    Assembly(Py<Assembly>),
}

/// What, the looks of a mesh, and where.
type RawPart<'py> = (RawShape, Vec<RawMaterial>, Bound<'py, PyAny>);

#[pymethods]
impl Assembly {
    #[new]
    fn new(
        py: Python<'_>,
        parts: Vec<RawPart<'_>>,
        far: &Mesh,
        far_looks: Vec<RawMaterial>,
    ) -> PyResult<Self> {
        let part = |(shape, looks, poses): RawPart<'_>| {
            let poses = matrices(&poses, "poses")?;
            let shape: Result<PartShape> = match shape {
                RawShape::Mesh(mesh) => {
                    Dressed::new(Arc::clone(&mesh.get().dag), materials(looks)).map(PartShape::Mesh)
                }
                RawShape::Assembly(inner) => Ok(PartShape::Assembly(Arc::clone(&inner.get().inner))),
            };
            Ok((shape, poses))
        };
        let parts: Vec<_> = parts.into_iter().map(part).collect::<PyResult<_>>()?;
        let (far, far_looks) = (Arc::clone(&far.dag), materials(far_looks));
        let inner = detached(py, || {
            let numbered = |i: usize, error| match error {
                Error::Argument { argument, message } => {
                    let gap = if message.starts_with('[') { "" } else { ": " };
                    Error::argument("parts", format!("[{i}]: {argument}{gap}{message}"))
                }
                other => other,
            };
            let part = |(i, (shape, poses)): (usize, (Result<PartShape>, Vec<_>))| {
                shape.and_then(|shape| Part::new(shape, &poses)).map_err(|error| numbered(i, error))
            };
            let parts = parts.into_iter().enumerate().map(part).collect::<Result<Vec<Part>>>()?;
            scene::Assembly::new(parts, Dressed::new(far, far_looks)?)
        })?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Smallest and largest corner of a box around all of it.
    #[getter]
    fn bounds(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let (low, high) = self.inner.bounds();
        into_rows(py, vec![low.to_array(), high.to_array()])
    }

    /// How far the mesh that stands for it may be off its parts.
    #[getter]
    fn error(&self) -> f64 {
        self.inner.error()
    }

    /// Meshes that it consists of.
    #[getter]
    fn leaves(&self) -> u64 {
        self.inner.leaves()
    }
}
