//! The DAG as plain tables: for tests that verify it without its own rules, and for the curious.

use std::path::PathBuf;

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{into_array, into_colors, into_rows};
use super::calls::{detached, interruptible};
use super::mesh::Mesh;
use crate::format;
use crate::math::{Sphere, octahedral};
use crate::model::cluster::NO_GROUP;
use crate::model::{ClusterAddress, ClusterRecord, Dag, Group};

/// Centre and radius in object units: rows of x, y, z, r.
fn spheres(py: Python<'_>, dag: &Dag, of: impl Iterator<Item = Sphere>) -> PyResult<Py<PyArray2<f64>>> {
    let rows = of.map(|sphere| {
        let [x, y, z] = dag.frame.to_object(sphere.center);
        [x, y, z, f64::from(sphere.radius) * dag.frame.scale]
    });
    into_rows(py, rows.collect())
}

/// Columns of all clusters, in page order. `origin` is the group a cluster was made from, −1 at level 0.
#[pyfunction]
pub(super) fn cluster_table(py: Python<'_>, mesh: &Mesh) -> PyResult<Py<PyDict>> {
    let dag = &*mesh.dag;
    interruptible(py, |proceed| dag.pages.load_all(proceed))?;
    let records: Vec<&ClusterRecord> = dag.pages.addresses().map(|at| dag.record(at)).collect();
    let signed = |group: u32| if group == NO_GROUP { -1 } else { i64::from(group) };
    let out = PyDict::new(py);
    out.set_item("id", into_array(py, dag.pages.addresses().map(|at| at.0).collect()))?;
    out.set_item("level", into_array(py, records.iter().map(|r| r.level).collect()))?;
    out.set_item("group", into_array(py, records.iter().map(|r| signed(r.group)).collect()))?;
    out.set_item("origin", into_array(py, records.iter().map(|r| signed(r.refined)).collect()))?;
    let own = |record: &&ClusterRecord| dag.own_error(record);
    let errors = records.iter().map(|record| f64::from(own(record).1) * dag.frame.scale);
    out.set_item("error", into_array(py, errors.collect()))?;
    out.set_item("triangles", into_array(py, records.iter().map(|r| u32::from(r.triangle_count)).collect()))?;
    out.set_item("vertices", into_array(py, records.iter().map(|r| u32::from(r.vertex_count)).collect()))?;
    out.set_item("sphere", spheres(py, dag, records.iter().map(|record| own(record).0))?)?;
    out.set_item("material", into_array(py, records.iter().map(|r| r.material).collect()))?;
    Ok(out.unbind())
}

/// The vertices and triangles of all clusters, one cluster after the other in page order; `lower` and
/// `upper` are the corners of boxes around them.
#[pyfunction]
pub(super) fn cluster_arrays(py: Python<'_>, mesh: &Mesh) -> PyResult<Py<PyDict>> {
    let dag = &*mesh.dag;
    let layout = dag.layout();
    let arrays = interruptible(py, |proceed| {
        dag.pages.load_all(proceed)?;
        let mut arrays = ClusterArrays { uvs: vec![Vec::new(); layout.uv_sets.into()], ..Default::default() };
        dag.pages.addresses().for_each(|at| arrays.push(dag, at));
        Ok(arrays)
    })?;
    let out = PyDict::new(py);
    out.set_item("vertices", into_rows(py, arrays.positions)?)?;
    out.set_item("normals", into_rows(py, arrays.normals)?)?;
    out.set_item("colors", into_colors(py, arrays.colors, layout.colors)?)?;
    let sets = arrays.uvs.into_iter().map(|set| into_rows(py, set));
    out.set_item("uvs", sets.collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("vertex_ids", into_array(py, arrays.ids))?;
    out.set_item("triangles", into_rows(py, arrays.triangles)?)?;
    out.set_item("lower", into_rows(py, arrays.lower)?)?;
    out.set_item("upper", into_rows(py, arrays.upper)?)?;
    Ok(out.unbind())
}

/// What [`cluster_arrays`] returns.
#[derive(Default)]
struct ClusterArrays {
    positions: Vec<[f64; 3]>,
    normals: Vec<[f32; 3]>,
    colors: Vec<u32>,
    uvs: Vec<Vec<[f32; 2]>>,
    ids: Vec<u32>,
    triangles: Vec<[u8; 3]>,
    lower: Vec<[f64; 3]>,
    upper: Vec<[f64; 3]>,
}

impl ClusterArrays {
    fn push(&mut self, dag: &Dag, at: ClusterAddress) {
        let geometry = dag.geometry(at);
        let count = geometry.positions.len();
        let own = (0..count).map(|i| dag.frame.to_object(geometry.positions.get(i)));
        let first = self.positions.len();
        self.positions.extend(own);
        let corner = |pick: fn(f64, f64) -> f64, start: f64| {
            let of = |k: usize| self.positions[first..].iter().fold(start, |most, p| pick(most, p[k]));
            [0, 1, 2].map(of)
        };
        self.lower.push(corner(f64::min, f64::INFINITY));
        self.upper.push(corner(f64::max, f64::NEG_INFINITY));
        self.normals.extend(geometry.normals[..count].iter().map(|word| octahedral::decode(*word)));
        self.colors.extend_from_slice(&geometry.colors[..dag.layout().colors.words() * count]);
        for (set, uvs) in self.uvs.iter_mut().enumerate() {
            uvs.extend_from_slice(&geometry.uvs[set * count..][..count]);
        }
        self.ids.extend(geometry.ids.iter());
        self.triangles.extend(geometry.triangles.iter());
    }
}

/// Columns of all groups. `error` is that of what was made from the group, infinite where nothing was: at least
/// `shape_error` and `attribute_error`.
#[pyfunction]
pub(super) fn group_table(py: Python<'_>, mesh: &Mesh) -> PyResult<Py<PyDict>> {
    let dag = &*mesh.dag;
    let out = PyDict::new(py);
    let of =
        |error: fn(&Group) -> f32| dag.groups.iter().map(|g| f64::from(error(g)) * dag.frame.scale).collect();
    out.set_item("error", into_array(py, of(|g| g.error)))?;
    out.set_item("shape_error", into_array(py, of(Group::distance)))?;
    out.set_item("attribute_error", into_array(py, of(|g| g.attribute_error)))?;
    out.set_item("level", into_array(py, dag.groups.iter().map(|g| g.level).collect()))?;
    out.set_item("count", into_array(py, dag.groups.iter().map(|g| g.count).collect()))?;
    out.set_item("sphere", spheres(py, dag, dag.groups.iter().map(|g| g.lod_sphere))?)?;
    Ok(out.unbind())
}

/// Columns of all pages: the words that each takes in memory, and the level of its first group.
#[pyfunction]
pub(super) fn page_table(py: Python<'_>, mesh: &Mesh) -> PyResult<Py<PyDict>> {
    let rows = mesh.dag.pages.table.iter().map(|page| (page.words, page.level));
    Ok(page_columns(py, rows)?.unbind())
}

/// The same of a file, of which only the beginning is read, and the bytes that each page takes there.
#[pyfunction]
pub(super) fn page_table_of_file(py: Python<'_>, path: PathBuf) -> PyResult<Py<PyDict>> {
    let table = detached(py, || format::file_info(&path))?.pages;
    let out = page_columns(py, table.iter().map(|page| (page.words, page.level)))?;
    out.set_item("bytes", into_array(py, table.iter().map(|page| page.bytes).collect()))?;
    Ok(out.unbind())
}

fn page_columns(py: Python<'_>, rows: impl Iterator<Item = (u32, u32)>) -> PyResult<Bound<'_, PyDict>> {
    let (words, levels): (Vec<u32>, Vec<u32>) = rows.unzip();
    let out = PyDict::new(py);
    out.set_item("words", into_array(py, words))?;
    out.set_item("level", into_array(py, levels))?;
    Ok(out)
}
