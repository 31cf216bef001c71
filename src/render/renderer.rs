//! The facade: checks what it is given, runs the stages in order, hands out the frame.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use rayon::prelude::*;

use super::frame::{Frame, Spare};
use super::pass::{Pass, triangles};
use super::stages::Stage;
use super::stats::FrameStats;
use crate::config::RenderOptions;
use crate::cpu::hzb::Hzb;
use crate::cpu::project::Screen;
use crate::cpu::shade::{self, Lighting};
use crate::cpu::surface::Pixels;
use crate::cpu::visibility::Visible;
use crate::cpu::{instance_cull, output};
use crate::error::{Error, Result};
use crate::scene::{Camera, Instance, Scene};

/// Where frames are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// The CPU twin of every stage.
    Cpu,
}

impl Backend {
    /// Resolves a requested backend; also says why it was taken.
    pub fn choose(name: &str) -> Result<(Self, &'static str)> {
        match name {
            "cpu" => Ok((Self::Cpu, "asked for")),
            "auto" => Ok((Self::Cpu, "this build has no GPU backend")),
            "gpu" => Err(Error::Backend {
                backend: name.to_owned(),
                message: "this build has no GPU backend; use \"cpu\" or \"auto\"".to_owned(),
            }),
            _ => {
                Err(Error::argument("backend", format!("must be \"auto\", \"cpu\" or \"gpu\", not {name:?}")))
            }
        }
    }

    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        "cpu"
    }
}

/// Renders scenes into pictures of one size. Buffers are kept between frames.
#[derive(Debug)]
pub struct Renderer {
    width: u32,
    height: u32,
    backend: Backend,
    reason: &'static str,
    hzb: Hzb,
    spare: Spare,
}

impl Renderer {
    /// A renderer of `width` × `height` pictures; `backend` is "auto", "cpu" or "gpu".
    pub fn new(width: u32, height: u32, backend: &str) -> Result<Self> {
        for (name, value) in [("width", width), ("height", height)] {
            let most = crate::scene::camera::MAX_VIEWPORT;
            if !(1..=most).contains(&value) {
                return Err(Error::argument(name, format!("must be between 1 and {most}, not {value}")));
            }
        }
        let (backend, reason) = Backend::choose(backend)?;
        let spare = Arc::new(Mutex::new(Vec::new()));
        Ok(Self { width, height, backend, reason, hzb: Hzb::default(), spare })
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The backend in use.
    pub fn backend(&self) -> Backend {
        self.backend
    }

    /// Why that backend.
    pub fn backend_reason(&self) -> &'static str {
        self.reason
    }

    /// Renders `scene` as `camera` sees it from the camera-to-world `pose`.
    pub fn render(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        pose: &[[f64; 4]; 4],
        options: &RenderOptions,
    ) -> Result<Frame> {
        options.validate()?;
        let start = Instant::now();
        let view = camera.view(pose, self.width, self.height)?;
        let screen = Screen::new(&view);
        let mut stats = FrameStats::default();
        let instances: Vec<(u32, &Instance)> = scene.instances().iter().collect();
        let views = stats.time(Stage::InstanceCull, 1, || {
            let views = instance_cull::run(&instances, &view, &screen);
            let count = views.len() as u64;
            (views, instances.len() as u64, count)
        });
        let mut pass = Pass { screen, tau: options.pixel_error, views, words: self.spare_words(), stats };
        let list = pass.draw_scene(options.occlusion, &mut self.hzb)?;
        let Pass { views, words, mut stats, .. } = pass;

        let lighting = Lighting::new(scene, &view);
        let visible: Vec<Visible> = list.iter().map(|c| c.visible).collect();
        let pixels = Pixels { words: &words, visible: &visible, views: &views, screen: &screen };
        let count = words.len();
        let color = options.color.then(|| {
            stats.time(Stage::Shade, 1, || {
                let mut out = vec![0; 3 * count];
                let covered = shade::run(pixels, &view, &lighting, &mut out);
                (out, count as u64, covered)
            })
        });
        let depth = options.depth.then(|| {
            stats.time(Stage::Output, 1, || {
                let mut out = vec![0.0; count];
                output::depth(pixels, &mut out);
                (out, count as u64, count as u64)
            })
        });
        stats.covered_pixels = match stats.stages.iter().find(|s| s.stage == Stage::Shade) {
            Some(shade) => shade.passed,
            None => words.par_iter().filter(|w| **w != 0).count() as u64,
        };
        stats.source_triangles = views.iter().map(|v| v.mesh.source_faces).sum();
        stats.clusters = list.len() as u64;
        stats.triangles = triangles(&list);
        let drawn = |stage| stats.stages.iter().filter(|s| s.stage == stage).map(|s| s.passed).sum();
        (stats.drawn_small, stats.drawn_large) = (drawn(Stage::RasterSmall), drawn(Stage::RasterLarge));
        stats.total_ms = start.elapsed().as_secs_f64() * 1e3;
        let large = list.iter().map(|c| c.large).collect();
        let spare = Arc::clone(&self.spare);
        Ok(Frame { words, visible, large, views, screen, view, lighting, color, depth, spare, stats })
    }

    /// A visibility buffer, of an earlier frame if there is one.
    fn spare_words(&self) -> Vec<u64> {
        let count = self.width as usize * self.height as usize;
        let words = self.spare.lock().ok().and_then(|mut s| s.pop()).unwrap_or_default();
        if words.len() == count { words } else { vec![0; count] }
    }
}
