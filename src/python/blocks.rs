//! `_core.BlockBuild`: builds larger than memory, block by block.

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::calls::{interruptible, watched};
use super::mesh::{RawArrays, RawMaterials, build_options, precision_of};
use crate::build::Meter;
use crate::config::BuildOptions;
use crate::external::{Work, memory_of};
use crate::format;
use crate::model::Dag;

/// A build in the files of a folder. The arrays of the source are those that it was begun with.
#[pyclass(module = "nanite_rs._core")]
pub(super) struct BlockBuild {
    work: Work,
    options: BuildOptions,
}

#[pymethods]
impl BlockBuild {
    /// Goes on with the build of this `key` in a folder, or begins it. See `nanite_rs.build_file`.
    #[staticmethod]
    #[pyo3(signature = (arrays, *, options, memory, folder, key, progress=None))]
    fn begin<'py>(
        py: Python<'py>,
        arrays: RawArrays<'py>,
        options: &Bound<'py, PyDict>,
        memory: u64,
        folder: PathBuf,
        key: &str,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let options = build_options(options)?;
        arrays.with_source(|source| {
            let work = watched(py, options.threads, progress.as_ref(), |_| {
                Work::begin(source, &options, memory, &folder, key)
            })?;
            Ok(Self { work, options: options.clone() })
        })
    }

    /// Opens what another process began.
    #[staticmethod]
    fn open(py: Python<'_>, folder: PathBuf, options: &Bound<'_, PyDict>) -> PyResult<Self> {
        let options = build_options(options)?;
        let work = interruptible(py, |_| Work::open(&folder, &options))?;
        Ok(Self { work, options })
    }

    /// Blocks of the current stage that are to be made.
    fn missing(&self) -> Vec<usize> {
        self.work.missing()
    }

    /// Names of the files that making a block reads, in the folder: first what says which others, then those that it says.
    fn inputs(&self, py: Python<'_>, block: usize) -> PyResult<[Vec<String>; 2]> {
        interruptible(py, |_| self.work.inputs(block))
    }

    /// Names of the files that making a block writes; the last one says that it is made.
    fn outputs(&self, block: usize) -> [String; 2] {
        self.work.outputs(block)
    }

    /// Makes a block of the current stage.
    #[pyo3(signature = (arrays, block, progress=None))]
    fn make(
        &self,
        py: Python<'_>,
        arrays: RawArrays<'_>,
        block: usize,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        arrays.with_source(|source| {
            watched(py, self.options.threads, progress.as_ref(), |progress| {
                let meter = Meter::new(progress, 2 * source.faces.len() as u64);
                self.work.make(source, block, &meter)
            })
        })
    }

    /// Goes on to the next stage; false where there is none.
    fn advance(&mut self, py: Python<'_>) -> PyResult<bool> {
        let work = &mut self.work;
        interruptible(py, |_| work.advance())
    }

    /// Writes the file with these materials; returns how many triangles of the source have no area on the grid.
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        precision: &str,
        step: Option<f64>,
        materials: RawMaterials,
    ) -> PyResult<u64> {
        let precision = precision_of(py, precision, step)?;
        let materials = materials.into();
        interruptible(py, |proceed| {
            let mesh = Dag { materials, ..self.work.finish()? };
            let folder = Some(self.work.folder());
            format::save_by_way_of(&mesh, &path, precision, folder, proceed)
        })
    }
}

/// Bytes that building these arrays in memory takes, about.
#[pyfunction]
pub(super) fn build_memory(arrays: RawArrays<'_>) -> PyResult<u64> {
    arrays.with_source(|source| Ok(memory_of(source)))
}
