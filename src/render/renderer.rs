//! The facade: checks what it is given, runs the stages in order, hands out the frame.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use rayon::prelude::*;

use super::frame::{Frame, Spare};
use super::stages::Stage;
use super::stats::FrameStats;
use crate::config::RenderOptions;
use crate::cpu::cluster_cull::{self, Candidate, nearest_portion};
use crate::cpu::hzb::Hzb;
use crate::cpu::project::{Footprint, InstanceView, Screen};
use crate::cpu::shade::{self, Lighting};
use crate::cpu::surface::Pixels;
use crate::cpu::visibility::{MAX_VISIBLE, Nearest, Visible, as_atomic, renumber};
use crate::cpu::{instance_cull, node_cull, output, raster_large, raster_small};
use crate::error::{Error, Result};
use crate::scene::{Camera, Instance, Scene};

/// Fewer triangles than this are drawn at once: a depth pyramid costs more than it could save.
const PYRAMID_ABOVE: u64 = 1 << 15;

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

fn triangles(list: &[Candidate]) -> u64 {
    list.iter().map(|c| u64::from(c.triangles)).sum()
}

/// The state of a frame on its way through the culling and raster stages.
struct Pass {
    screen: Screen,
    tau: f32,
    views: Vec<InstanceView>,
    words: Vec<u64>,
    stats: FrameStats,
}

impl Pass {
    /// Culls and draws everything; returns the frame's visible list, in scene order.
    ///
    /// With occlusion, and where footprints overlap enough for it to pay, only the nearest portion is drawn
    /// first; the depth pyramid of that then culls the rest. Hidden clusters have no pixel, so the picture is
    /// the same either way; and since numbers are given in scene order over what is drawn, so are all ties.
    fn draw_scene(&mut self, occlusion: bool, hzb: &mut Hzb) -> Result<Vec<Candidate>> {
        let all: Vec<u32> = (0..self.views.len() as u32).collect();
        let footprints: Vec<Footprint> = self.views.iter().map(|v| v.footprint).collect();
        let key =
            if occlusion && all.len() > 1 { nearest_portion(&footprints, &self.screen, 1.5) } else { None };
        let (first, put_off): (Vec<u32>, Vec<u32>) =
            all.into_iter().partition(|&i| key.is_none_or(|k| footprints[i as usize].near_key >= k));
        let candidates = self.cull(1, &first, None);
        let key = if occlusion && triangles(&candidates) > PYRAMID_ABOVE {
            let footprints: Vec<Footprint> = candidates.iter().map(|c| c.footprint).collect();
            nearest_portion(&footprints, &self.screen, 3.0)
        } else {
            None
        };
        let (now, later): (Vec<Candidate>, Vec<Candidate>) =
            candidates.into_iter().partition(|c| key.is_none_or(|k| c.footprint.near_key >= k));
        check_count(now.len() + later.len())?;
        let visible: Vec<Visible> = now.iter().map(|c| c.visible).collect();
        self.draw(1, &now, &(0..now.len() as u32).collect::<Vec<_>>(), &visible);
        if put_off.is_empty() && later.is_empty() {
            return Ok(now);
        }
        let survivors = self.second_pass(&put_off, &later, hzb);
        check_count(now.len() + survivors.len())?;
        if survivors.is_empty() {
            return Ok(now);
        }
        let (list, numbers_now, numbers_new) = merge(&now, &survivors);
        renumber(&mut self.words, &numbers_now);
        let visible: Vec<Visible> = list.iter().map(|c| c.visible).collect();
        self.draw(2, &survivors, &numbers_new, &visible);
        Ok(list)
    }

    /// What the depth pyramid of the first pass does not hide, in scene order.
    fn second_pass(&mut self, put_off: &[u32], later: &[Candidate], hzb: &mut Hzb) -> Vec<Candidate> {
        let (width, height) = (self.screen.width as usize, self.screen.height as usize);
        self.stats.time(Stage::Hzb, 1, || {
            hzb.build(&self.words, width, height);
            ((), (width * height) as u64, (width.div_ceil(2) * height.div_ceil(2)) as u64)
        });
        let rest = self.stats.time(Stage::InstanceCull, 2, || {
            let rest = instance_cull::unhidden(put_off, &self.views, hzb);
            let count = rest.len() as u64;
            (rest, put_off.len() as u64, count)
        });
        let mut survivors = cluster_cull::unhidden(later, hzb);
        self.stats.occluded_instances = (put_off.len() - rest.len()) as u64;
        self.stats.occluded_clusters = (later.len() - survivors.len()) as u64;
        survivors.append(&mut self.cull(2, &rest, Some(hzb)));
        survivors.sort_unstable_by_key(scene_order);
        survivors
    }

    /// Node and cluster culling of instances; survivors in scene order.
    fn cull(&mut self, pass: u8, instances: &[u32], hzb: Option<&Hzb>) -> Vec<Candidate> {
        let (views, screen, tau) = (&self.views, &self.screen, self.tau);
        let walk = self.stats.time(Stage::NodeCull, pass, || {
            let walk = node_cull::run(instances, views, screen, tau, hzb);
            let counts = (walk.visited, walk.groups.len() as u64);
            (walk, counts.0, counts.1)
        });
        self.stats.time(Stage::ClusterCull, pass, || {
            let mut culled = cluster_cull::run(&walk.groups, views, screen, tau, hzb);
            if !culled.candidates.is_sorted_by_key(scene_order) {
                culled.candidates.par_sort_unstable_by_key(scene_order);
            }
            let count = culled.candidates.len() as u64;
            (culled.candidates, culled.visited, count)
        })
    }

    /// Draws `list`, whose entries have `numbers` in `visible`. The first pass starts from background.
    fn draw(&mut self, pass: u8, list: &[Candidate], numbers: &[u32], visible: &[Visible]) {
        let (views, screen, words) = (&self.views, &self.screen, &mut self.words);
        for (stage, large) in [(Stage::RasterSmall, false), (Stage::RasterLarge, true)] {
            self.stats.time(stage, pass, || {
                if pass == 1 && !large {
                    words.par_chunks_mut(1 << 15).for_each(|chunk| chunk.fill(0));
                }
                let sink = Nearest(as_atomic(words));
                let mut received = 0;
                let mut chosen = Vec::with_capacity(list.len());
                for (candidate, &number) in list.iter().zip(numbers) {
                    if candidate.large == large {
                        chosen.push(number);
                        received += u64::from(candidate.triangles);
                    }
                }
                let drawn = if large {
                    raster_large::run(&chosen, visible, views, screen, &sink)
                } else {
                    raster_small::run(&chosen, visible, views, screen, &sink)
                };
                ((), received, drawn)
            });
        }
    }
}

fn scene_order(candidate: &Candidate) -> (u32, u32) {
    (candidate.visible.instance, candidate.visible.cluster.0)
}

fn check_count(count: usize) -> Result<()> {
    if count > MAX_VISIBLE {
        return Err(Error::TooLarge(format!(
            "{count} clusters are visible at once, the most is {MAX_VISIBLE}"
        )));
    }
    Ok(())
}

/// Merges two lists in scene order; also the numbers that the entries of each get.
fn merge(a: &[Candidate], b: &[Candidate]) -> (Vec<Candidate>, Vec<u32>, Vec<u32>) {
    let mut list = Vec::with_capacity(a.len() + b.len());
    let (mut of_a, mut of_b) = (Vec::with_capacity(a.len()), Vec::with_capacity(b.len()));
    while of_a.len() < a.len() || of_b.len() < b.len() {
        let take_a = match (a.get(of_a.len()), b.get(of_b.len())) {
            (Some(x), Some(y)) => scene_order(x) < scene_order(y),
            (x, _) => x.is_some(),
        };
        let (from, numbers) = if take_a { (a, &mut of_a) } else { (b, &mut of_b) };
        let entry = from[numbers.len()];
        numbers.push(list.len() as u32);
        list.push(entry);
    }
    (list, of_a, of_b)
}
