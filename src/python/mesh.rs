//! `_core.Mesh`, `_core.Cut` and `_core.ChannelRows`: building, cutting, saving and checking from Python.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use glam::DAffine3;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rayon::prelude::*;

use super::arrays::{
    ChannelArray, ColorArray, FaceArray, PositionArray, into_array, into_colors, into_rows, into_words,
    matrix4, vertex_rows,
};
use super::calls::{detached, interruptible, watched};
use super::errors::{argument_error, to_python};
use super::remote::Input;
use super::renderer::{self, RawCamera};
use crate::build;
use crate::build::waves::WaveDesc;
use crate::config::BuildOptions;
use crate::decimate::{Decimated, Goal};
use crate::error::{Error, Result};
use crate::finish::{FinishedCut, Finisher};
use crate::format::{self, Precision};
use crate::lod::{CutArrays, FaceBudget, channel_rows, load, select};
use crate::math::affine::Affine;
use crate::math::octahedral::angle_of_bits;
use crate::mesh::SourceMesh;
use crate::model::rule::{ROOT_ERROR, Threshold};
use crate::model::{
    self, AttributeLayout, Blob, Channel, CoordinateFrame, Dag, Grid, Group, InterruptCheck, Materials, Wave,
};
use crate::threads::once;

/// A built mesh.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Mesh {
    /// The cluster DAG.
    pub dag: Arc<Dag>,
    finisher: OnceLock<Finisher>,
}

impl Mesh {
    pub(super) fn new(dag: Dag) -> Self {
        Self { dag: Arc::new(dag), finisher: OnceLock::new() }
    }
}

/// A mesh whose vertices follow joints.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Skin {
    rest: Arc<Dag>,
    skin: Arc<model::Skin>,
}

#[pymethods]
impl Skin {
    /// Number of joints.
    #[getter]
    fn joints(&self) -> usize {
        self.skin.joints
    }

    /// The mesh where joints take it: `matrices` are three rows (3 · J, 4) for each joint, from object space at rest.
    fn posed(&self, py: Python<'_>, matrices: &Bound<'_, PyAny>) -> PyResult<Mesh> {
        let rows = vertex_rows::<f64, 4>(matrices, "matrices", matrices.len()?)?;
        let matrices: &[Affine] = rows.get().as_chunks().0;
        detached(py, || build::pose::posed(&self.rest, &self.skin, matrices)).map(Mesh::new)
    }
}

/// A mesh whose vertices follow waves.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Waves {
    waves: Arc<model::Waves>,
    moved: Dag,
}

#[pymethods]
impl Waves {
    /// How far any vertex goes at most, object units.
    #[getter]
    fn largest(&self) -> f64 {
        self.waves.largest
    }

    /// How much farther apart two points of the same channels may be at any time, as a part of their distance.
    #[getter]
    fn lipschitz(&self) -> f64 {
        self.waves.lipschitz
    }

    /// The mesh at a time, seconds.
    fn at(&self, time: f64) -> Mesh {
        Mesh::new(build::waves::at(&self.waves, &self.moved, time))
    }
}

/// A wave: amplitude, turns per second, turns per unit of length, and channels of weights and of phases.
type RawWave = ([f64; 3], f64, [f64; 3], Option<String>, Option<String>);

/// What positions of a file are rounded to, by name, or to steps of so many object units.
pub(super) fn precision_of(py: Python<'_>, name: &str, step: Option<f64>) -> PyResult<Precision> {
    match (name, step) {
        (_, Some(step)) => Ok(Precision::Step(step)),
        ("auto", None) => Ok(Precision::Auto),
        ("exact", None) => Ok(Precision::Exact),
        (other, None) => {
            let message = format!("expected \"auto\", \"exact\" or a number, not {other:?}");
            Err(argument_error(py, "precision", message))
        }
    }
}

fn to_raise(error: Error) -> PyErr {
    Python::attach(|py| to_python(py, error))
}

/// Options from keyword arguments; unknown names are refused.
pub(super) fn build_options(options: &Bound<'_, PyDict>) -> PyResult<BuildOptions> {
    let mut out = BuildOptions::default();
    for (name, value) in options {
        let name = name.extract::<String>()?;
        set_option(&mut out, &name, &value).map_err(|error| {
            let py = value.py();
            // What no unsigned number can be.
            let out_of_range = error.is_instance_of::<PyOverflowError>(py);
            let message = || format!("{name} must not be {value}");
            if out_of_range { argument_error(py, "options", message()) } else { error }
        })?;
    }
    Ok(out)
}

fn set_option(out: &mut BuildOptions, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    match name {
        "cluster_triangles" => out.cluster_triangles = value.extract()?,
        "cluster_vertices" => out.cluster_vertices = value.extract()?,
        "group_clusters" => out.group_clusters = value.extract()?,
        "clusterizer" => out.clusterizer = value.extract::<String>()?.parse().map_err(to_raise)?,
        "partition" => out.partition = value.extract::<String>()?.parse().map_err(to_raise)?,
        "quality" => out.quality = value.extract::<String>()?.parse().map_err(to_raise)?,
        "error" => out.error = value.extract::<String>()?.parse().map_err(to_raise)?,
        "normal_weight" => out.normal_weight = value.extract()?,
        "color_weight" => out.color_weight = value.extract()?,
        "uv_weight" => out.uv_weight = value.extract()?,
        "channel_weight" => out.channel_weight = value.extract()?,
        "preserve_area" => out.preserve_area = value.extract()?,
        "crease_angle" => out.crease_angle = value.extract()?,
        "face_ids" => out.face_ids = value.extract()?,
        "threads" => out.threads = value.extract()?,
        other => return Err(argument_error(value.py(), "options", format!("no option {other:?}"))),
    }
    Ok(())
}

/// Arrays of a mesh as `nanite_rs._arrays.core_arrays` gives them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct RawArrays<'py> {
    vertices: Bound<'py, PyAny>,
    faces: Bound<'py, PyAny>,
    normals: Option<Bound<'py, PyAny>>,
    colors: Option<Bound<'py, PyAny>>,
    uvs: Vec<Bound<'py, PyAny>>,
    channels: Vec<(String, String, Bound<'py, PyAny>)>,
    face_materials: Option<PyReadonlyArray1<'py, i32>>,
}

impl RawArrays<'_> {
    /// Checks the arrays, and does something with the mesh that they are.
    pub(super) fn with_source<T>(self, work: impl FnOnce(&SourceMesh<'_>) -> PyResult<T>) -> PyResult<T> {
        let positions = PositionArray::new(&self.vertices, "vertices")?;
        let count = positions.get().len();
        let faces = FaceArray::new(&self.faces, "faces", count)?;
        let normals =
            self.normals.as_ref().map(|n| vertex_rows::<f32, 3>(n, "normals", count)).transpose()?;
        let colors = self.colors.as_ref().map(|c| ColorArray::new(c, "colors", count)).transpose()?;
        let uvs: Vec<_> =
            self.uvs.iter().map(|u| vertex_rows::<f32, 2>(u, "uvs", count)).collect::<PyResult<_>>()?;
        let channels: Vec<_> = self
            .channels
            .into_iter()
            .map(|(n, t, v)| ChannelArray::new(n, &t, &v))
            .collect::<PyResult<_>>()?;
        work(&SourceMesh {
            positions: positions.get(),
            faces: faces.get(),
            normals: normals.as_ref().map(|n| n.get()),
            colors: colors.as_ref().map(ColorArray::get),
            uvs: uvs.iter().map(|u| u.get()).collect(),
            channels: channels.iter().map(ChannelArray::get).collect(),
            materials: self.face_materials.as_ref().map(|m| m.as_slice()).transpose()?,
        })
    }
}

/// Materials as `nanite_rs._material_files` encodes them.
#[derive(FromPyObject)]
pub(super) struct RawMaterials(String, Vec<Vec<u8>>);

impl From<RawMaterials> for Materials {
    fn from(RawMaterials(table, images): RawMaterials) -> Self {
        Self { table: table.into(), images: images.into_iter().map(Blob::from).collect() }
    }
}

#[pymethods]
impl Mesh {
    /// Builds from arrays. See `nanite_rs.NaniteMesh.from_arrays`.
    #[staticmethod]
    #[pyo3(signature = (arrays, *, options, progress=None))]
    fn build<'py>(
        py: Python<'py>,
        arrays: RawArrays<'py>,
        options: &Bound<'py, PyDict>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let options = build_options(options)?;
        arrays.with_source(|source| {
            watched(py, options.threads, progress.as_ref(), |progress| {
                build::build(source, &options, progress)
            })
            .map(Self::new)
        })
    }

    /// Opens a `.nanite` file; pages, channels and face ids are read when they are needed.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        detached(py, || format::open(&path)).map(Self::new)
    }

    /// The same of an input that Python reads.
    #[staticmethod]
    fn open_input(py: Python<'_>, remote: &Input) -> PyResult<Self> {
        let (remote, name) = (remote.remote(py), remote.name());
        detached(py, || format::open_input(Box::new(remote), name)).map(Self::new)
    }

    /// Reads what `to_bytes` wrote.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        detached(py, || format::from_bytes(data, "<bytes>")).map(Self::new)
    }

    /// What a `.nanite` file says of itself, without its pages, and what it holds in bytes by part.
    #[staticmethod]
    fn file_info(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyDict>> {
        info_dict(py, &detached(py, || format::file_info(&path))?)
    }

    /// The same of an input that Python reads.
    #[staticmethod]
    fn input_info<'py>(py: Python<'py>, remote: &Input) -> PyResult<Bound<'py, PyDict>> {
        let (remote, name) = (remote.remote(py), remote.name());
        info_dict(py, &detached(py, || format::input_info(&remote, name))?)
    }

    /// Writes a `.nanite` file: to a temporary file beside it, which then takes its name. `step` is the largest step
    /// of positions in object units; `materials` are a table and images, and by default those of the file that it
    /// was opened from. Returns how many triangles of the source have no area in it.
    #[pyo3(signature = (path, precision="auto", step=None, materials=None))]
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        precision: &str,
        step: Option<f64>,
        materials: Option<RawMaterials>,
    ) -> PyResult<u64> {
        let precision = precision_of(py, precision, step)?;
        let looks = materials.map(|materials| Dag { materials: materials.into(), ..(*self.dag).clone() });
        let dag = looks.as_ref().unwrap_or(&self.dag);
        interruptible(py, |proceed| format::save(dag, &path, precision, proceed))
    }

    /// The same mesh, whose source is so far from the surface that it stands for, in object units: that counts as the rounding
    /// of positions does, in every error.
    fn with_source_error(&self, py: Python<'_>, error: f64) -> PyResult<Self> {
        let mut dag = (*self.dag).clone();
        dag.frame.rounding = (dag.frame.rounding + error).next_up();
        if !(error >= 0.0 && dag.frame.rounding.is_finite()) {
            return Err(argument_error(
                py,
                "source_error",
                format!("must be finite and not negative, not {error}"),
            ));
        }
        Ok(Self::new(dag))
    }

    /// The bytes of a `.nanite` file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = interruptible(py, |proceed| {
            self.dag.load_all(proceed)?;
            format::to_bytes(&self.dag)
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Verifies every invariant; returns what was counted.
    fn check<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let report = interruptible(py, |proceed| build::check(&self.dag, proceed))?;
        let out = PyDict::new(py);
        out.set_item("clusters", report.clusters)?;
        out.set_item("groups", report.groups)?;
        out.set_item("nodes", report.nodes)?;
        out.set_item("vertices", report.vertices)?;
        out.set_item("borders", report.borders)?;
        Ok(out)
    }

    /// What building did, as JSON.
    fn report_json(&self, py: Python<'_>) -> PyResult<String> {
        detached(py, || serde_json::to_string(&self.dag.report).map_err(|e| Error::Invariant(e.to_string())))
    }

    /// True when both hold the same content.
    fn equals(&self, py: Python<'_>, other: &Self) -> PyResult<bool> {
        let (a, b) = (Arc::clone(&self.dag), Arc::clone(&other.dag));
        interruptible(py, move |proceed| {
            if Arc::ptr_eq(&a, &b) {
                return Ok(true);
            }
            a.load_all(proceed)?;
            b.load_all(proceed)?;
            Ok(a == b)
        })
    }

    /// The cut for an error in object units.
    fn cut_error(&self, py: Python<'_>, error: f64) -> PyResult<Cut> {
        // Rounded down: the cut never takes more than was allowed.
        // Below infinity, which is the parent error of roots: the coarsest cut holds them.
        let internal = (((error - self.dag.rounding()).max(0.0) / self.dag.frame.scale) as f32).min(f32::MAX);
        let internal =
            if f64::from(internal) * self.dag.frame.scale > error { internal.next_down() } else { internal };
        self.cut_at(py, Threshold::Uniform(internal.max(0.0)))
    }

    /// The cut with so many triangles or a few less; with whole groups, the finest with at most so many. Where that is
    /// less than the coarsest has, that.
    fn cut_faces(&self, py: Python<'_>, target: u64, exact: bool) -> PyResult<Cut> {
        let finisher = interruptible(py, |proceed| {
            if self.finisher.get().is_none() && !FaceBudget::is_stated(&self.dag) {
                self.dag.pages.load_all(proceed)?;
            }
            let finisher = once(&self.finisher, || Finisher::new(&self.dag));
            finisher.load(&self.dag, target, proceed)?;
            Ok(finisher)
        })?;
        let cut =
            // What is simplified beyond whole groups is measured at rest.
            |dag: &Dag| match exact && dag.pose.is_none() {
                true => finisher.exact(dag, target),
                false => Ok(finisher.whole(dag, target)),
            };
        self.cut(py, |dag, _| cut(dag))
    }

    /// What acts on its vertices, from a channel with a column of weights for each joint.
    fn skin(&self, py: Python<'_>, channel: &str) -> PyResult<Skin> {
        let skin = interruptible(py, |proceed| build::skin::skin(&self.dag, channel, proceed))?;
        Ok(Skin { rest: Arc::clone(&self.dag), skin: Arc::new(skin) })
    }

    /// What moves its vertices, of waves.
    fn waves(&self, py: Python<'_>, waves: Vec<RawWave>) -> PyResult<Waves> {
        let desc = |(amplitude, frequency, vector, weight, phase): RawWave| WaveDesc {
            wave: Wave { amplitude, frequency, vector },
            weight,
            phase,
        };
        let waves: Vec<WaveDesc> = waves.into_iter().map(desc).collect();
        let (waves, moved) = interruptible(py, |proceed| build::waves::waves(&self.dag, &waves, proceed))?;
        Ok(Waves { waves, moved })
    }

    /// Triangles of the coarsest cut.
    fn min_faces(&self, py: Python<'_>) -> PyResult<u64> {
        interruptible(py, |proceed| coarsest_faces(&self.dag, proceed))
    }

    /// The cut for an error in pixels, from a camera and its camera-to-mesh pose: the clusters that the renderer
    /// would draw of an instance at the identity, if nothing were culled.
    fn cut_view(
        &self,
        py: Python<'_>,
        camera: RawCamera,
        pose: &Bound<'_, PyAny>,
        viewport: (u32, u32),
        pixel_error: f32,
    ) -> PyResult<Cut> {
        let pose = matrix4(pose, "pose")?;
        let frame = &self.dag.frame;
        let view = renderer::camera(camera).and_then(|camera| camera.view(&pose, viewport.0, viewport.1));
        let view = view.map_err(|error| to_python(py, error))?;
        let lod =
            view.lod_view(&view.object_to_view(&DAffine3::IDENTITY, frame), frame, self.dag.rounding(), 1.0);
        self.cut_at(py, Threshold::View(lod, pixel_error.min(f32::MAX)))
    }

    /// Row of the caller's `faces` for each level-0 triangle of the full-detail cut; `None` unless built with
    /// `face_ids`.
    fn source_face_ids(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray1<u32>>>> {
        let ids = self.dag.face_ids.as_ref();
        let ids = detached(py, || ids.map(|ids| Ok(ids.load()?.to_vec())).transpose())?;
        Ok(ids.map(|ids| into_array(py, ids)))
    }

    /// Triangles of the source after mending.
    #[getter]
    fn source_faces(&self) -> u64 {
        self.dag.source_faces
    }

    /// Vertices of the source after welding.
    #[getter]
    fn source_vertices(&self) -> u64 {
        self.dag.source_vertices
    }

    /// Clusters of all levels.
    #[getter]
    fn cluster_count(&self) -> usize {
        self.dag.cluster_count()
    }

    /// Groups of all levels.
    #[getter]
    fn group_count(&self) -> usize {
        self.dag.groups.len()
    }

    /// Nodes of the hierarchy.
    #[getter]
    fn node_count(&self) -> usize {
        self.dag.nodes.len()
    }

    /// Pages.
    #[getter]
    fn page_count(&self) -> usize {
        self.dag.pages.table.len()
    }

    /// Levels of detail, the source included.
    #[getter]
    fn level_count(&self) -> u32 {
        1 + self.dag.pages.table.iter().map(|p| p.level).max().unwrap_or(0)
    }

    /// Bytes that clusters, groups, hierarchy, face ids and channels take in memory.
    #[getter]
    fn nbytes(&self) -> usize {
        let dag = &self.dag;
        size_of::<u32>() * dag.pages.words_held() as usize
            + size_of_val(&dag.pages.table[..])
            + size_of_val(&dag.groups[..])
            + size_of_val(&dag.nodes[..])
            + dag.words().map(|words| size_of_val(words.held())).sum::<usize>()
    }

    /// The dtype of vertex colours; None without.
    #[getter]
    fn colors(&self) -> Option<&'static str> {
        self.dag.layout().colors.dtype()
    }

    /// Clusters have materials.
    #[getter]
    fn has_materials(&self) -> bool {
        self.dag.layout().materials
    }

    /// The table of the materials in its file, see `nanite_rs._material_files`; empty without.
    #[getter]
    fn material_table(&self) -> &str {
        &self.dag.materials.table
    }

    /// How many images its file has.
    #[getter]
    fn image_count(&self) -> usize {
        self.dag.materials.images.len()
    }

    /// An image of its file, as it was encoded.
    fn image_file<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyBytes>> {
        let Some(image) = self.dag.materials.images.get(number) else {
            return Err(argument_error(py, "number", format!("there is no image {number}")));
        };
        let bytes = detached(py, || image.read())?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Number of UV sets.
    #[getter]
    fn uv_sets(&self) -> u8 {
        self.dag.layout().uv_sets
    }

    /// Name, dtype and number of columns of each channel; None where it has one dimension.
    #[getter]
    fn channels(&self) -> Vec<(String, &'static str, Option<u32>)> {
        self.dag.channels.iter().map(|c| (c.info.name.clone(), c.info.dtype.name(), c.info.columns)).collect()
    }

    /// Smallest and largest corner of the source, object units.
    #[getter]
    fn bounds(&self) -> [[f64; 3]; 2] {
        let Dag { frame, bounds, .. } = &*self.dag;
        [frame.to_object(bounds.min), frame.to_object(bounds.max)]
    }

    /// Object-space origin of the stored positions; zero unless the source needed float64 or lay far away.
    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.dag.frame.origin
    }

    /// Largest distance by which storing a position moved it, object units.
    #[getter]
    fn rounding(&self) -> f64 {
        self.dag.rounding()
    }

    /// Step of the grid that positions are on, object units; `None` before a file rounded them.
    #[getter]
    fn precision(&self) -> Option<f64> {
        self.dag.grid.map(|grid| precision(&self.dag.frame, grid))
    }

    /// Largest angle, degrees, by which normals were rounded.
    #[getter]
    fn normal_rounding(&self) -> f64 {
        normal_rounding(self.dag.grid)
    }

    /// Largest difference by which rounding changed a UV coordinate.
    #[getter]
    fn uv_rounding(&self) -> f32 {
        uv_rounding(self.dag.grid)
    }
}

/// What a file says of itself, for Python.
fn info_dict<'py>(py: Python<'py>, info: &format::FileInfo) -> PyResult<Bound<'py, PyDict>> {
    let (metadata, pages) = (&info.metadata, &info.pages);
    let out = PyDict::new(py);
    out.set_item("faces", metadata.source_faces)?;
    out.set_item("vertices", metadata.source_vertices)?;
    out.set_item("levels", 1 + pages.iter().map(|page| page.level).max().unwrap_or(0))?;
    out.set_item("clusters", pages.iter().map(|page| u64::from(page.clusters)).sum::<u64>())?;
    out.set_item("groups", info.groups)?;
    out.set_item("nodes", info.nodes)?;
    out.set_item("pages", pages.len())?;
    out.set_item("bytes", info.bytes)?;
    out.set_item("page_bytes", 4 * pages.iter().map(|page| u64::from(page.words)).sum::<u64>())?;
    out.set_item("colors", metadata.layout.colors.dtype())?;
    out.set_item("uv_sets", metadata.layout.uv_sets)?;
    out.set_item("materials", metadata.layout.materials)?;
    out.set_item("channels", metadata.channels.iter().map(|c| c.name.clone()).collect::<Vec<_>>())?;
    out.set_item("bounds", metadata.bounds.map(|corner| metadata.frame.to_object(corner).to_vec()).to_vec())?;
    out.set_item("origin", metadata.frame.origin.to_vec())?;
    out.set_item("precision", metadata.grid.map(|grid| precision(&metadata.frame, grid)))?;
    out.set_item("rounding", metadata.frame.rounding_on(metadata.grid))?;
    out.set_item("normal_rounding", normal_rounding(metadata.grid))?;
    out.set_item("uv_rounding", uv_rounding(metadata.grid))?;
    let parts = PyDict::new(py);
    info.parts.iter().try_for_each(|(name, bytes)| parts.set_item(name, bytes))?;
    out.set_item("parts", parts)?;
    Ok(out)
}

fn precision(frame: &CoordinateFrame, grid: Grid) -> f64 {
    frame.scale * f64::from(grid.step())
}

fn normal_rounding(grid: Option<Grid>) -> f64 {
    grid.map_or(0.0, |grid| angle_of_bits(grid.normal_bits).to_degrees())
}

fn uv_rounding(grid: Option<Grid>) -> f32 {
    grid.map_or(0.0, |grid| 0.5 * grid.uv_step())
}

impl Mesh {
    fn cut_at(&self, py: Python<'_>, threshold: Threshold) -> PyResult<Cut> {
        self.cut(py, |dag, proceed| {
            load(dag, &threshold, proceed)?;
            Ok(FinishedCut { clusters: select(dag, &threshold), made: None })
        })
    }

    fn cut(
        &self,
        py: Python<'_>,
        select: impl FnOnce(&Dag, InterruptCheck<'_>) -> Result<FinishedCut> + Send,
    ) -> PyResult<Cut> {
        let dag = &*self.dag;
        let (cut, arrays, error, positions) = interruptible(py, |proceed| {
            let cut = select(dag, proceed)?;
            let mut arrays = cut.extract(dag);
            let error = (cut.error(dag), cut.attribute_error(dag));
            let positions = object_positions(std::mem::take(&mut arrays.positions), &dag.frame);
            Ok((cut, arrays, error, positions))
        })?;
        let made = |channel: usize| -> Arc<[u32]> {
            cut.made.as_ref().map_or_else(Arc::default, |made| made.channels[channel][..].into())
        };
        let ids: Arc<[u32]> = if dag.channels.is_empty() { Arc::default() } else { arrays.ids[..].into() };
        let rows = |(k, channel): (usize, &Channel)| {
            Py::new(py, ChannelRows { channel: channel.clone(), ids: Arc::clone(&ids), made: made(k) })
        };
        let channels = dag.channels.iter().enumerate().map(rows).collect::<PyResult<_>>()?;
        CutParts {
            positions,
            arrays,
            channels,
            cluster_ids: cluster_ids(&cut),
            cluster_levels: levels(dag, &cut),
            cluster_materials: dag.layout().materials.then(|| materials(dag, &cut)),
            layout: dag.layout(),
            error,
        }
        .into_cut(py)
    }
}

/// The triangles of the coarsest cut, whose pages it reads.
fn coarsest_faces(dag: &Dag, proceed: InterruptCheck<'_>) -> Result<u64> {
    dag.pages.load(0..dag.root_pages(), proceed)?;
    let roots = dag.groups.iter().filter(|group| group.error == ROOT_ERROR);
    Ok(roots.flat_map(Group::members).map(|at| u64::from(dag.record(at).triangle_count)).sum())
}

/// What stands for the address of a cluster where triangles are in none.
const NO_CLUSTER: u32 = u32::MAX;

fn cluster_ids(cut: &FinishedCut) -> Vec<u32> {
    cut.clusters.iter().map(|at| at.0).chain(cut.parts().iter().map(|_| NO_CLUSTER)).collect()
}

fn levels(dag: &Dag, cut: &FinishedCut) -> Vec<u8> {
    let levels = cut.clusters.iter().map(|at| dag.record(*at).level);
    levels.chain(cut.parts().iter().map(|part| part.level)).collect()
}

fn materials(dag: &Dag, cut: &FinishedCut) -> Vec<i32> {
    let materials = cut.clusters.iter().map(|at| dag.record(*at).material);
    materials.chain(cut.parts().iter().map(|part| part.material)).collect()
}

enum ObjectPositions {
    F32(Vec<[f32; 3]>),
    F64(Vec<[f64; 3]>),
}

/// Positions in the caller's space and precision. Scaling by a power of two is exact.
fn object_positions(mut internal: Vec<[f32; 3]>, frame: &CoordinateFrame) -> ObjectPositions {
    if !frame.is_f32() {
        return ObjectPositions::F64(internal.into_par_iter().map(|p| frame.to_object(p)).collect());
    }
    // In two steps of f64, since the scale itself may lie outside f32.
    internal.par_iter_mut().for_each(|p| *p = frame.to_object(*p).map(|x| x as f32));
    ObjectPositions::F32(internal)
}

/// Decimates arrays. See `nanite_rs.decimate`.
#[pyfunction]
#[pyo3(signature = (arrays, *, target, options, preserve_border, lossless, progress=None))]
pub(super) fn decimate<'py>(
    py: Python<'py>,
    arrays: RawArrays<'py>,
    target: usize,
    options: &Bound<'py, PyDict>,
    preserve_border: bool,
    lossless: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Cut> {
    let options = build_options(options)?;
    let goal = Goal { target, preserve_border, lossless };
    let made = arrays.with_source(|source| {
        watched(py, options.threads, progress.as_ref(), |progress| {
            let mut made = crate::decimate::decimate(source, goal, &options, progress)?;
            let positions = object_positions(std::mem::take(&mut made.arrays.positions), &made.frame);
            Ok((made, positions))
        })
    })?;
    let (Decimated { arrays, materials, channels, layout, .. }, positions) = made;
    let ids: Arc<[u32]> = if channels.is_empty() { Arc::default() } else { arrays.ids[..].into() };
    let rows = |channel: Channel| Py::new(py, ChannelRows::of(&channel, &ids));
    let runs = materials.len();
    CutParts {
        positions,
        arrays,
        channels: channels.into_iter().map(rows).collect::<PyResult<_>>()?,
        cluster_ids: vec![NO_CLUSTER; runs],
        cluster_levels: vec![1; runs],
        cluster_materials: layout.materials.then_some(materials),
        layout,
        error: (f64::INFINITY, f64::INFINITY),
    }
    .into_cut(py)
}

/// What a cut is made of.
struct CutParts {
    positions: ObjectPositions,
    arrays: CutArrays,
    channels: Vec<Py<ChannelRows>>,
    cluster_ids: Vec<u32>,
    cluster_levels: Vec<u8>,
    cluster_materials: Option<Vec<i32>>,
    layout: AttributeLayout,
    /// Of the shape, and of what it carries.
    error: (f64, f64),
}

impl CutParts {
    fn into_cut(self, py: Python<'_>) -> PyResult<Cut> {
        let Self { arrays, layout, .. } = self;
        let vertices = match self.positions {
            ObjectPositions::F32(rows) => into_rows(py, rows)?.into_py_any(py)?,
            ObjectPositions::F64(rows) => into_rows(py, rows)?.into_py_any(py)?,
        };
        let faces = arrays.faces.into_iter().map(|face| face.map(u32::cast_signed)).collect();
        let sets = arrays.uvs.into_iter().map(|set| into_rows(py, set)).collect::<PyResult<_>>()?;
        Ok(Cut {
            vertices,
            faces: into_rows(py, faces)?,
            normals: into_rows(py, arrays.normals)?,
            colors: into_colors(py, arrays.colors, layout.colors)?,
            uvs: sets,
            channels: self.channels,
            vertex_ids: into_array(py, arrays.ids),
            cluster_ids: into_array(py, self.cluster_ids),
            cluster_levels: into_array(py, self.cluster_levels),
            cluster_materials: self.cluster_materials.map(|materials| into_array(py, materials)),
            first_face: into_array(py, arrays.first_face),
            error: self.error.0,
            attribute_error: self.error.1,
        })
    }
}

/// The arrays of a cut.
#[pyclass(frozen, get_all, module = "nanite_rs._core")]
pub struct Cut {
    vertices: Py<PyAny>,
    faces: Py<PyArray2<i32>>,
    normals: Py<PyArray2<f32>>,
    colors: Option<Py<PyAny>>,
    uvs: Vec<Py<PyArray2<f32>>>,
    channels: Vec<Py<ChannelRows>>,
    vertex_ids: Py<PyArray1<u32>>,
    cluster_ids: Py<PyArray1<u32>>,
    cluster_levels: Py<PyArray1<u8>>,
    cluster_materials: Option<Py<PyArray1<i32>>>,
    first_face: Py<PyArray1<u32>>,
    error: f64,
    attribute_error: f64,
}

/// The rows that a cut has of a channel, until somebody asks for them.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct ChannelRows {
    channel: Channel,
    ids: Arc<[u32]>,
    /// The rows of vertices that the cut alone has.
    made: Arc<[u32]>,
}

impl ChannelRows {
    /// The rows of identities of a mesh.
    pub(super) fn of(channel: &Channel, ids: &Arc<[u32]>) -> Self {
        Self { channel: channel.clone(), ids: Arc::clone(ids), made: Arc::default() }
    }
}

#[pymethods]
impl ChannelRows {
    /// Name of the channel.
    #[getter]
    fn name(&self) -> &str {
        &self.channel.info.name
    }

    /// What the words are.
    #[getter]
    fn dtype(&self) -> &'static str {
        self.channel.info.dtype.name()
    }

    /// Number of columns; None where the channel has one dimension.
    #[getter]
    fn columns(&self) -> Option<u32> {
        self.channel.info.columns
    }

    /// The words, a row for each vertex; the channel is read if it is not in memory.
    fn words(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let words = detached(py, || channel_rows(&self.channel, &self.ids, &self.made))?;
        into_words(py, words, self.channel.info.width())
    }
}
