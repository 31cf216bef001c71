//! `_core.Tiles` and `_core.Piece`: a mesh laid out in tiles, and what a tile has.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use super::arrays::{into_array, into_colors, into_rows};
use super::calls::interruptible;
use super::errors::argument_error;
use super::mesh::{ChannelRows, Mesh};
use crate::lod::{attribute_error_with, error_with};
use crate::math::Aabb;
use crate::model::Dag;
use crate::tile::{Layout, Plan, Tile, extract, plan};

/// The tiles of a mesh. Lengths are in units of the mesh.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Tiles {
    dag: Arc<Dag>,
    plan: Plan,
}

/// The surface in a tile: rows of vertices and faces.
#[pyclass(frozen, get_all, module = "nanite_rs._core")]
pub struct Piece {
    vertices: Py<PyArray2<f64>>,
    faces: Py<PyArray2<i32>>,
    normals: Py<PyArray2<f32>>,
    colors: Option<Py<PyAny>>,
    uvs: Vec<Py<PyArray2<f32>>>,
    face_materials: Option<Py<PyArray1<i32>>>,
    /// The rows of three vertices that each one is mixed of,
    channels: Vec<Py<ChannelRows>>,
    /// and what these weigh.
    weights: Py<PyArray2<f32>>,
    borders: Py<PyArray2<u32>>,
}

#[pymethods]
impl Tiles {
    /// At most about so many triangles in each.
    #[new]
    fn new(py: Python<'_>, mesh: &Mesh, triangles: u32) -> PyResult<Self> {
        Self::laid_out(py, mesh, &Layout::Triangles(triangles))
    }

    /// Boxes of one size on each level: of the whole, lower and upper corner, and for each level, coarsest first, the error and
    /// how often its boxes are halved.
    #[staticmethod]
    fn grid(py: Python<'_>, mesh: &Mesh, bounds: [[f64; 3]; 2], levels: Vec<(f64, u32)>) -> PyResult<Self> {
        let frame = &mesh.dag.frame;
        let internal = |p: [f64; 3]| -> [f32; 3] {
            std::array::from_fn(|k| ((p[k] - frame.origin[k]) / frame.scale) as f32)
        };
        let levels = levels.into_iter().map(|(error, halvings)| ((error / frame.scale) as f32, halvings));
        let bounds = Aabb { min: internal(bounds[0]), max: internal(bounds[1]) };
        Self::laid_out(py, mesh, &Layout::Grid { bounds, levels: levels.collect() })
    }

    /// The errors that the cuts of levels were asked for.
    #[getter]
    fn levels(&self) -> Vec<f64> {
        self.plan.levels.iter().map(|error| f64::from(*error) * self.dag.frame.scale).collect()
    }

    /// For each tile its level.
    #[getter]
    fn level(&self, py: Python<'_>) -> Py<PyArray1<u32>> {
        self.column(py, |tile| tile.level)
    }

    /// The tile that it replaces a part of; −1 at the top.
    #[getter]
    fn parent(&self, py: Python<'_>) -> Py<PyArray1<i64>> {
        self.column(py, |tile| tile.parent.map_or(-1, i64::from))
    }

    /// Lower corners.
    #[getter]
    fn lower(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        self.corners(py, |bounds| bounds.min)
    }

    /// Upper corners.
    #[getter]
    fn upper(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        self.corners(py, |bounds| bounds.max)
    }

    /// How far its surface is from the source at most; rounded up.
    #[getter]
    fn error(&self, py: Python<'_>) -> Py<PyArray1<f64>> {
        self.column(py, |tile| error_with(&self.dag, &[], tile.error))
    }

    /// How far attributes are off at most, as a length.
    #[getter]
    fn attribute_error(&self, py: Python<'_>) -> Py<PyArray1<f64>> {
        self.column(py, |tile| attribute_error_with(&self.dag, &[], tile.attribute_error))
    }

    /// Whether it has the source itself.
    #[getter]
    fn whole(&self, py: Python<'_>) -> Py<PyArray1<bool>> {
        self.column(py, |tile| tile.whole)
    }

    /// Number of tiles.
    fn __len__(&self) -> usize {
        self.plan.tiles.len()
    }

    /// Cuts out a tile.
    fn piece(&self, py: Python<'_>, number: usize) -> PyResult<Piece> {
        if number >= self.plan.tiles.len() {
            let message = format!("there are {} tiles, found {number}", self.plan.tiles.len());
            return Err(argument_error(py, "number", message));
        }
        let dag = &*self.dag;
        let (piece, positions) = interruptible(py, |proceed| {
            let piece = extract(dag, &self.plan, number, proceed)?;
            let positions = piece.arrays.positions.iter().map(|p| dag.frame.to_object(*p)).collect();
            Ok((piece, positions))
        })?;
        let arrays = piece.arrays;
        let ids: Arc<[u32]> =
            if dag.channels.is_empty() { Arc::default() } else { piece.sources.as_flattened().into() };
        let channels = dag.channels.iter().map(|channel| Py::new(py, ChannelRows::of(channel, &ids)));
        let faces = arrays.faces.into_iter().map(|face| face.map(u32::cast_signed)).collect();
        Ok(Piece {
            vertices: into_rows(py, positions)?,
            faces: into_rows(py, faces)?,
            normals: into_rows(py, arrays.normals)?,
            colors: into_colors(py, arrays.colors, dag.layout().colors)?,
            uvs: arrays.uvs.into_iter().map(|set| into_rows(py, set)).collect::<PyResult<_>>()?,
            face_materials: dag.layout().materials.then(|| into_array(py, piece.materials)),
            channels: channels.collect::<PyResult<_>>()?,
            weights: into_rows(py, piece.weights)?,
            borders: into_rows(py, piece.borders)?,
        })
    }
}

impl Tiles {
    fn laid_out(py: Python<'_>, mesh: &Mesh, layout: &Layout) -> PyResult<Self> {
        let dag = Arc::clone(&mesh.dag);
        let plan = interruptible(py, |proceed| plan(&dag, layout, proceed))?;
        Ok(Self { dag, plan })
    }

    fn column<T: numpy::Element>(&self, py: Python<'_>, of: impl Fn(&Tile) -> T) -> Py<PyArray1<T>> {
        into_array(py, self.plan.tiles.iter().map(of).collect())
    }

    fn corners(&self, py: Python<'_>, of: impl Fn(&Aabb) -> [f32; 3]) -> PyResult<Py<PyArray2<f64>>> {
        let tiles = self.plan.tiles.iter();
        into_rows(py, tiles.map(|tile| self.dag.frame.to_object(of(&tile.bounds))).collect())
    }
}
