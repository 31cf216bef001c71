//! `_core.Renderer` and `_core.Frame`: rendering from Python.

use std::sync::RwLockWriteGuard;

use numpy::{Element, PyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

use super::arrays::matrix4;
use super::calls::{detached, interruptible_on};
use super::errors::to_python;
use super::scene::Scene;
use crate::config::{Output, Outputs, Raster, RenderOptions, Samples};
use crate::error::{Error, Result};
use crate::render::{self, Backend, ImageView, ViewDesc, ViewKind};
use crate::scene::{Camera, Projection, pose};
use crate::threads::{Lock, Own};

/// Kind, its parameters, near and far distance.
pub(super) type RawCamera = (String, Vec<f64>, f64, Option<f64>);

pub(super) fn camera((kind, parameters, znear, zfar): RawCamera) -> Result<Camera> {
    let projection = match (kind.as_str(), parameters.as_slice()) {
        ("perspective", &[yfov]) => Projection::Perspective { yfov, aspect: None },
        ("perspective", &[yfov, aspect]) => Projection::Perspective { yfov, aspect: Some(aspect) },
        ("intrinsics", &[fx, fy, cx, cy, skew]) => Projection::Intrinsics { fx, fy, cx, cy, skew },
        ("orthographic", &[ymag]) => Projection::Orthographic { xmag: None, ymag },
        ("orthographic", &[ymag, xmag]) => Projection::Orthographic { xmag: Some(xmag), ymag },
        _ => return Err(Error::argument("camera", format!("no camera {kind:?} of {parameters:?}"))),
    };
    let camera = Camera { projection, znear, zfar };
    camera.validate()?;
    Ok(camera)
}

/// Checks the parameters of a camera; the error names the first that is wrong.
#[pyfunction]
pub(super) fn check_camera(py: Python<'_>, spec: RawCamera) -> PyResult<()> {
    camera(spec).map(drop).map_err(|error| to_python(py, error))
}

/// Camera, pose, identity, and what it has of its own: size, threshold, arrays, whether depth alone is drawn.
type RawView<'py> =
    (RawCamera, Bound<'py, PyAny>, u64, Option<(u32, u32)>, Option<f32>, Option<Vec<String>>, Option<bool>);

fn of_names(names: &[String]) -> Result<Outputs> {
    names.iter().map(|name| name.parse::<Output>()).collect()
}

/// Form, reason, milliseconds of each form.
type RawCalibration = (&'static str, String, Vec<(&'static str, f64)>);

/// Checks a camera's pose; returns how far it is off a rotation.
#[pyfunction]
pub(super) fn check_pose(pose: &Bound<'_, PyAny>) -> PyResult<f64> {
    let rows = matrix4(pose, "pose")?;
    pose::rigid("pose", &rows).map(|(_, off)| off).map_err(|error| to_python(pose.py(), error))
}

/// How frames are rendered, as `nanite_rs.renderer._Options` says it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct RawOptions {
    pixel_error: f32,
    occlusion: bool,
    raster: String,
    outputs: Option<Vec<String>>,
    depth_only: bool,
    samples: u32,
    shading: String,
    transfer: String,
    wait: bool,
    shadows: String,
    shadow_memory: u64,
    shadow_samples: u32,
    max_layers: u32,
    transparent_ids: bool,
    motion: bool,
}

impl RawOptions {
    fn checked(self) -> Result<RenderOptions> {
        let raster: Raster = self.raster.parse()?;
        let defaults = if self.depth_only { RenderOptions::depth_only() } else { RenderOptions::default() };
        let outputs = self.outputs.map_or(Ok(defaults.outputs), |names| of_names(&names))?;
        Ok(RenderOptions {
            pixel_error: self.pixel_error,
            occlusion: self.occlusion,
            raster,
            outputs,
            samples: Samples::try_from(self.samples)?,
            shading: self.shading.parse()?,
            transfer: self.transfer.parse()?,
            wait: self.wait,
            shadows: self.shadows.parse()?,
            shadow_memory: self.shadow_memory,
            shadow_samples: self.shadow_samples,
            max_layers: self.max_layers,
            transparent_ids: self.transparent_ids,
            motion: self.motion,
            ..defaults
        })
    }
}

/// Renders scenes. See `nanite_rs.Renderer`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Renderer {
    inner: Lock<Own<render::Renderer>>,
    threads: usize,
}

impl Renderer {
    fn lock(&self) -> Result<RwLockWriteGuard<'_, Own<render::Renderer>>> {
        self.inner.write("the renderer")
    }

    /// Something of the renderer.
    fn look<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut render::Renderer) -> T + Send,
    ) -> PyResult<T> {
        py.detach(|| Ok(work(&mut *self.lock()?))).map_err(|error| to_python(py, error))
    }
}

/// Errors where something lies on a device of the process that this one was forked from.
fn usable<T>(of: &Own<T>, on_device: impl FnOnce(&T) -> bool) -> Result<()> {
    if of.is_inherited() && on_device(of) {
        let message = "its device belongs to the process that this one was forked from: make a renderer in this process, \
                       or start workers with \"spawn\" or \"forkserver\"";
        return Err(Error::Backend { backend: "gpu".to_owned(), message: message.to_owned() });
    }
    Ok(())
}

#[pymethods]
impl Renderer {
    #[new]
    #[pyo3(signature = (width, height, backend, pool_bytes=None, threads=0))]
    fn new(
        py: Python<'_>,
        width: u32,
        height: u32,
        backend: &str,
        pool_bytes: Option<u64>,
        threads: usize,
    ) -> PyResult<Self> {
        let mut inner = detached(py, || render::Renderer::new(width, height, backend))?;
        inner.stream(pool_bytes);
        Ok(Self { inner: Lock::new(Own::new(inner)), threads })
    }

    /// What could not be read of streamed meshes, since this was last called.
    fn read_errors(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.look(py, |inner| {
            let read_errors = inner.streamer().map(|streamer| streamer.read_errors()).unwrap_or_default();
            read_errors.into_iter().map(|fault| fault.message).collect()
        })
    }

    /// The backend in use, and why.
    #[getter]
    fn backend(&self, py: Python<'_>) -> PyResult<(&'static str, String)> {
        self.look(py, |inner| (inner.backend().name(), inner.backend_reason().to_owned()))
    }

    /// How rasterizers were chosen: form, reason, milliseconds of each form.
    #[getter]
    fn calibration(&self, py: Python<'_>) -> PyResult<Option<RawCalibration>> {
        self.look(py, |inner| {
            let found = inner.calibration()?;
            let times = found.times.iter().map(|(raster, ms)| (raster.name(), *ms)).collect();
            Some((found.raster.name(), found.reason.clone(), times))
        })
    }

    /// Renders a frame for each view.
    fn render(
        &self,
        py: Python<'_>,
        scene: &Scene,
        views: Vec<RawView<'_>>,
        options: RawOptions,
    ) -> PyResult<Vec<Frame>> {
        let desc = |(camera, pose, id, size, pixel_error, outputs, depth_only): RawView<'_>| {
            let camera = self::camera(camera).map_err(|error| to_python(py, error))?;
            let view = ViewDesc::new(id, camera, matrix4(&pose, "pose")?);
            let outputs = outputs.map(|names| of_names(&names)).transpose();
            let outputs = outputs.map_err(|error| to_python(py, error))?;
            let kind = depth_only.map(|alone| if alone { ViewKind::DepthOnly } else { ViewKind::Color });
            Ok(ViewDesc { size, pixel_error, outputs, kind, ..view })
        };
        let views: Vec<ViewDesc> = views.into_iter().map(desc).collect::<PyResult<_>>()?;
        let options = options.checked().map_err(|error| to_python(py, error))?;
        let frames = interruptible_on(py, self.threads, |proceed| {
            let mut renderer = self.lock()?;
            usable(&renderer, |renderer| renderer.backend() == Backend::Gpu)?;
            renderer.render_views(&*scene.read()?, &views, &options, proceed)
        })?;
        Ok(frames.into_iter().map(|frame| Frame { inner: Lock::new(Own::new(frame)) }).collect())
    }
}

/// A rendered frame. See `nanite_rs.Frame`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Frame {
    inner: Lock<Own<render::Frame>>,
}

/// Counts by name.
type RawCounts = Vec<(&'static str, u64)>;

/// A cascade: its light, where it begins and ends, and its texel.
type RawCascade = (usize, f32, f32, f32);

/// What shadows cost, by name, the milliseconds of marking and drawing, and the cascades.
type RawShadows = (RawCounts, [f64; 2], Vec<RawCascade>);

/// One stage: name, pass, received, what of, passed, what of, milliseconds.
type RawStage = (&'static str, u8, u64, &'static str, u64, &'static str, f64);

impl Frame {
    fn lock(&self) -> Result<RwLockWriteGuard<'_, Own<render::Frame>>> {
        let frame = self.inner.write("the frame")?;
        usable(&frame, render::Frame::is_on_device)?;
        Ok(frame)
    }

    /// Something of the frame.
    fn look<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&render::Frame) -> T + Send) -> PyResult<T> {
        py.detach(|| Ok(work(&*self.lock()?))).map_err(|error| to_python(py, error))
    }

    /// An (H, W) array that takes over what `make` returns.
    fn plane<T: Element>(
        &self,
        py: Python<'_>,
        make: impl FnOnce(&mut render::Frame) -> Result<Vec<T>> + Send,
    ) -> PyResult<Py<PyArray2<T>>> {
        let (values, shape) = detached(py, || {
            let mut frame = self.lock()?;
            let shape = [frame.height() as usize, frame.width() as usize];
            Ok((make(&mut frame)?, shape))
        })?;
        Ok(PyArray::from_vec(py, values).reshape(shape)?.unbind())
    }

    /// An (H, W, 3) array that takes over what `make` returns, or (H, W, 4) where that is as many.
    fn planes<T: Element>(
        &self,
        py: Python<'_>,
        make: impl FnOnce(&mut render::Frame) -> Result<Vec<T>> + Send,
    ) -> PyResult<Py<PyArray3<T>>> {
        let (values, shape) = detached(py, || {
            let mut frame = self.lock()?;
            let [high, wide] = [frame.height(), frame.width()].map(|side| side as usize);
            let values = make(&mut frame)?;
            let channels = values.len() / (high * wide).max(1);
            Ok((values, [high, wide, channels]))
        })?;
        Ok(PyArray::from_vec(py, values).reshape(shape)?.unbind())
    }
}

#[pymethods]
impl Frame {
    fn color(&self, py: Python<'_>) -> PyResult<Py<PyArray3<u8>>> {
        self.planes(py, |frame| frame.take(Output::Color).map(Vec::from))
    }

    fn linear(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::Linear).map(Vec::from))
    }

    /// Base colour, float32.
    fn base_color(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::BaseColor).map(Vec::from))
    }

    /// Shading normals, world space, float32.
    fn shading_normal(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::ShadingNormal).map(Vec::from))
    }

    /// Occlusion, roughness, metallic, float32.
    fn orm(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::Orm).map(Vec::from))
    }

    /// Emitted light, float32.
    fn emissive(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::Emissive).map(Vec::from))
    }

    /// How much of each light reaches each pixel, (H, W, lights) float32.
    fn shadow(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.shadow())
    }

    /// How far each pixel moved, (H, W, 2) float32.
    fn motion(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.motion().map(Vec::into_flattened))
    }

    fn deep_color(&self, py: Python<'_>) -> PyResult<Py<PyArray3<u16>>> {
        self.planes(py, |frame| frame.deep_color())
    }

    /// RGBA, bytes.
    fn rgba(&self, py: Python<'_>) -> PyResult<Py<PyArray3<u8>>> {
        self.planes(py, |frame| frame.rgba())
    }

    /// RGBA, 16 bits.
    fn deep_rgba(&self, py: Python<'_>) -> PyResult<Py<PyArray3<u16>>> {
        self.planes(py, |frame| frame.deep_rgba())
    }

    /// Linear light times coverage, and coverage.
    fn layer(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.layer().map(Vec::into_flattened))
    }

    fn depth(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f32>>> {
        self.plane(py, |frame| frame.take(Output::Depth).map(Vec::from))
    }

    fn normal(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        self.planes(py, |frame| frame.take(Output::Normal).map(Vec::from))
    }

    fn instance_id(&self, py: Python<'_>) -> PyResult<Py<PyArray2<i32>>> {
        self.plane(py, |frame| frame.take(Output::InstanceId).map(Vec::from))
    }

    fn cluster_id(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        self.plane(py, |frame| frame.take(Output::ClusterId).map(Vec::from))
    }

    fn triangle_id(&self, py: Python<'_>) -> PyResult<Py<PyArray2<i32>>> {
        self.plane(py, |frame| frame.take(Output::TriangleId).map(Vec::from))
    }

    fn face_id(&self, py: Python<'_>) -> PyResult<Py<PyArray2<i64>>> {
        self.plane(py, |frame| frame.face_ids())
    }

    fn overdraw(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        self.plane(py, |frame| frame.take(Output::Overdraw).map(Vec::from))
    }

    /// Width and height.
    #[getter]
    fn size(&self, py: Python<'_>) -> PyResult<(u32, u32)> {
        self.look(py, |frame| (frame.width(), frame.height()))
    }

    /// A picture by name, with edges over it in a colour.
    #[pyo3(signature = (name, edges=None))]
    fn view(&self, py: Python<'_>, name: &str, edges: Option<[u8; 3]>) -> PyResult<Py<PyArray3<u8>>> {
        let what = ImageView::parse(name).map_err(|error| to_python(py, error))?;
        self.planes(py, move |frame| frame.image(what, edges))
    }

    /// The stages with their counts and times.
    fn stages(&self, py: Python<'_>) -> PyResult<Vec<RawStage>> {
        self.look(py, |frame| {
            let stage = |s: &render::StageStats| {
                let (received, passed) = s.stage.counts();
                (s.stage.name(), s.pass, s.received, received, s.passed, passed, s.ms)
            };
            frame.stats.stages.iter().map(stage).collect()
        })
    }

    /// What streaming did for the frame, by name; the largest error, pixels, of what stood in for something finer; and the
    /// mean time, milliseconds, from a request to its answer.
    fn stream(&self, py: Python<'_>) -> PyResult<Option<(RawCounts, f32, f64)>> {
        self.look(py, |frame| {
            let stream = frame.stats.stream.as_ref()?;
            let traffic = &stream.traffic;
            let counts = vec![
                ("resident_pages", stream.resident_pages),
                ("pool_bytes", stream.pool_bytes),
                ("needed_pages", stream.needed_pages),
                ("missing_pages", stream.missing_pages),
                ("refused_pages", stream.refused_pages),
                ("arrived_pages", stream.arrived_pages),
                ("evicted_pages", stream.evicted_pages),
                ("read_errors", stream.read_errors),
                ("draws", stream.draws),
                ("requests", traffic.requests),
                ("failed_requests", traffic.failed_requests),
                ("read_bytes", traffic.bytes),
                ("joined_bytes", traffic.joined_bytes),
                ("cached_bytes", traffic.cached_bytes),
            ];
            Some((counts, stream.coarsest_pixels, traffic.latency_ms()))
        })
    }

    /// What shadows cost.
    fn shadows(&self, py: Python<'_>) -> PyResult<Option<RawShadows>> {
        self.look(py, |frame| {
            let shadows = frame.stats.shadows.as_ref()?;
            let counts = vec![
                ("wanted_pages", shadows.wanted),
                ("drawn_pages", shadows.drawn),
                ("invalidated_pages", shadows.invalidated),
                ("evicted_pages", shadows.evicted),
                ("kept_pages", shadows.kept),
                ("clusters", shadows.clusters),
                ("triangles", shadows.triangles),
                ("culled_instances", shadows.culled_instances),
                ("culled_clusters", shadows.culled_clusters),
                ("coarser", shadows.coarser.into()),
            ];
            let cascades = shadows.cascades.iter().map(|cascade| {
                let [begin, end] = cascade.range;
                (cascade.light, begin, end, cascade.texel)
            });
            Some((counts, [shadows.mark_ms, shadows.draw_ms], cascades.collect()))
        })
    }

    /// What became of assemblies, by name, and the milliseconds that it took.
    fn assemblies(&self, py: Python<'_>) -> PyResult<Option<(RawCounts, f64)>> {
        self.look(py, |frame| {
            let found = frame.stats.assemblies.as_ref()?;
            let counts = vec![
                ("walked", found.walked),
                ("outside", found.outside),
                ("far", found.far),
                ("expanded", found.expanded),
                ("parts", found.parts),
                ("changed", found.changed),
            ];
            Some((counts, found.ms))
        })
    }

    /// The frame's totals by name, its time, and which rasterizers drew it.
    fn totals(&self, py: Python<'_>) -> PyResult<(RawCounts, f64, &'static str)> {
        self.look(py, |frame| {
            let stats = &frame.stats;
            let totals = vec![
                ("source_triangles", stats.source_triangles),
                ("clusters", stats.clusters),
                ("triangles", stats.triangles),
                ("drawn_small", stats.drawn_small),
                ("drawn_large", stats.drawn_large),
                ("drawn_hardware", stats.drawn_hardware),
                ("covered_pixels", stats.covered_pixels),
                ("occluded_instances", stats.occluded_instances),
                ("occluded_clusters", stats.occluded_clusters),
                ("uploaded_bytes", stats.uploaded_bytes),
                ("uploaded_mesh_bytes", stats.uploaded_mesh_bytes),
                ("reduced_images", stats.reduced_images),
                ("layers", stats.layers),
                ("layers_left", stats.layers_left),
                ("samples", stats.samples.into()),
            ];
            (totals, stats.total_ms, stats.raster.name())
        })
    }
}
