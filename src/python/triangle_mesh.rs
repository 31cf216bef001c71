//! `_core.TriangleMesh`: ordinary meshes, whose vertices may move.

use pyo3::prelude::*;

use super::arrays::{PositionArray, vertex_rows};
use super::calls::detached;
use super::mesh::{Mesh, RawArrays};
use crate::build::OneLevel;

/// What of an ordinary mesh does not depend on where its vertices are.
#[pyclass(frozen, module = "nanite_rs._core")]
pub(super) struct TriangleMesh(OneLevel);

#[pymethods]
impl TriangleMesh {
    /// From arrays. See `nanite_rs.TriangleMesh`.
    #[new]
    fn new(py: Python<'_>, arrays: RawArrays<'_>) -> PyResult<Self> {
        arrays.with_source(|source| detached(py, || OneLevel::new(source)).map(Self))
    }

    /// The mesh with its vertices at these positions. Without `normals` they are computed.
    #[pyo3(signature = (vertices, normals=None))]
    fn shape(
        &self,
        py: Python<'_>,
        vertices: &Bound<'_, PyAny>,
        normals: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Mesh> {
        let positions = PositionArray::new(vertices, "vertices")?;
        let normals =
            normals.map(|rows| vertex_rows::<f32, 3>(rows, "normals", self.0.vertices())).transpose()?;
        let (positions, normals) = (positions.get(), normals.as_ref().map(|rows| rows.get()));
        detached(py, || self.0.shape(positions, normals)).map(Mesh::new)
    }
}
