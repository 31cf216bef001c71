//! Occlusion culling in one pass: against the depth of the last frame, reprojected, and completed by occluders of this one.
//!
//! Haar and Aaltonen, "GPU-Driven Rendering Pipelines" (SIGGRAPH 2015, Advances in Real-Time Rendering): the best occluders
//! are drawn first, their depth goes to 512 × 256 texels and is combined with the reprojected depth of the last frame, and
//! everything else is culled once against the pyramid of that.
//!
//! Where the talk leaves something open, this takes what culls most at least cost, or errs least:
//! - Occluders are the largest instances on the screen that the reprojected depth does not hide, and of them the clusters
//!   that it does not hide. They are drawn into the visibility buffer itself, so nothing is drawn twice.
//! - A texel has the farthest depth of the pixels that it touches. It is moved as a square at that depth, and the texels that
//!   the square touches take the farthest of all that reaches them: no pinholes where the picture grows.
//! - What nothing reaches is infinitely far. `Care::Most` takes a texel only if something reaches all nine around it too: a
//!   square that reaches a part of a texel says nothing about the rest. It also leaves out pixels of instances that moved.
//! - A camera that stands needs no reprojection.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use glam::{DAffine3, DVec3, Vec3};
use nanite_rs::cpu::cluster_cull::{self, CandidateCluster};
use nanite_rs::cpu::hzb::Hzb;
use nanite_rs::cpu::visibility::{Nearest, Pixel, covered};
use nanite_rs::cpu::{instance_cull, node_cull, raster_large, raster_small};
use nanite_rs::model::ClusterAddress;
use nanite_rs::scene::placement::Eye;
use nanite_rs::scene::{Instance, Scene, View};
use nanite_rs::stream::Resident;
use nanite_rs::views::{Footprint, InstanceView, Occluder, Screen, Visible};
use rayon::prelude::*;

/// Texels of the depth that is reprojected: those of the talk.
const COLUMNS: usize = 512;
const ROWS: usize = 256;
/// With a ring around it, for what leaves the picture.
const RING_COLUMNS: usize = COLUMNS + 2;
const RING_ROWS: usize = ROWS + 2;
/// Nothing reached the texel.
const HOLE: u32 = u32::MAX;
/// Texels by which a moved square may reach a texel in vain: more than its coordinates are rounded by.
const SLACK: f32 = 0.01;
/// The same of depth, relative.
const DEPTH_SLACK: f32 = 1.0e-5;
/// Rows of texels, or of pixels, per task.
const ROWS_PER_TASK: usize = 8;

/// How doubtful depth is treated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Care {
    /// A texel is what reaches it, whatever moved.
    Least,
    /// See above.
    Most,
}

/// One form of it.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    pub care: Care,
    /// Instances that are drawn first.
    pub occluders: usize,
}

/// Milliseconds of the steps of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Farthest depths, moving them, combining, pyramids.
    pub depth: f64,
    pub cull: f64,
    pub raster: f64,
    /// Of the whole.
    pub wall: f64,
}

/// A frame.
pub struct Drawn {
    pub words: Vec<u64>,
    /// Clusters drawn, in scene order, by the slot of their instance.
    pub list: Vec<(u32, ClusterAddress)>,
    pub triangles: u64,
    pub times: Times,
}

/// What a frame leaves for the next one.
struct Last {
    view: View,
    words: Vec<u64>,
    list: Vec<(u32, ClusterAddress)>,
    poses: Vec<(u32, DAffine3)>,
}

/// The alternative, with what it keeps from frame to frame.
pub struct OnePass {
    form: Form,
    last: Option<Last>,
    /// Of the ring and all within.
    scattered: Vec<AtomicU32>,
    texels: Vec<u32>,
    hzb: Hzb,
}

impl OnePass {
    pub fn new(form: Form) -> Self {
        let scattered = (0..RING_COLUMNS * RING_ROWS).map(|_| AtomicU32::new(HOLE)).collect();
        Self { form, last: None, scattered, texels: vec![0; COLUMNS * ROWS], hzb: Hzb::default() }
    }

    /// Draws a frame; the caller gives its memory back by [`Self::keep`].
    pub fn draw(&mut self, scene: &Scene, view: &View, tau: f32, mut words: Vec<u64>) -> Drawn {
        let start = Instant::now();
        let mut times = Times::default();
        let (eye, screen) = (Eye::new(view), Screen::new(view));
        let instances: Vec<(u32, &Instance)> = scene.instances().iter().collect();
        let views = clock(&mut times.cull, || {
            instance_cull::run(&instances, view, &eye, &screen, &Resident::default())
        });
        clock(&mut times.depth, || {
            self.reproject(&instances, view, &screen);
            self.hzb.build(&self.texels, COLUMNS, 0..ROWS);
        });
        let pass = Pass { views: &views, screen: &screen, tau };
        words.resize(screen.width as usize * screen.height as usize, 0);
        clock(&mut times.raster, || words.par_chunks_mut(1 << 15).for_each(|chunk| chunk.fill(0)));
        // Occluders.
        let (occluders, rest) = clock(&mut times.cull, || self.choose(&pass));
        let first = clock(&mut times.cull, || pass.cull(&occluders, &self.occluder(&screen)));
        let mut list = first;
        if !list.is_empty() {
            clock(&mut times.raster, || pass.draw(&list, &list, &mut words));
            clock(&mut times.depth, || {
                let width = screen.width as usize;
                let complete = |texel: &mut u32, key: u32| *texel = (*texel).max(key);
                farthest(&words, width, |word| word.key(), &mut self.texels, complete);
                self.hzb.build(&self.texels, COLUMNS, 0..ROWS);
            });
        }
        // Everything else.
        let second = clock(&mut times.cull, || {
            let occluder = self.occluder(&screen);
            pass.cull(&instance_cull::unhidden(&rest, &views, &occluder), &occluder)
        });
        clock(&mut times.raster, || {
            let old = list.clone();
            list.extend_from_slice(&second);
            list.par_sort_unstable();
            u64::renumber(&mut words, &numbers(&old, &list));
            pass.draw(&second, &list, &mut words);
        });
        // As the product counts them.
        std::hint::black_box(covered(&words));
        times.wall = start.elapsed().as_secs_f64() * 1e3;
        let of_slot = |c: &CandidateCluster| (views[c.visible.instance as usize].slot, c.visible.cluster);
        let triangles = list.iter().map(|c| u64::from(c.triangles)).sum();
        Drawn { words, list: list.iter().map(of_slot).collect(), triangles, times }
    }

    /// Takes note of a frame for the next one; returns memory for it.
    pub fn keep(&mut self, scene: &Scene, view: &View, drawn: Drawn) -> Vec<u64> {
        let poses = scene.instances().iter().map(|(slot, instance)| (slot, *instance.pose())).collect();
        let last = Last { view: view.clone(), words: drawn.words, list: drawn.list, poses };
        self.last.replace(last).map(|last| last.words).unwrap_or_default()
    }

    fn occluder(&self, screen: &Screen) -> Coarse<'_> {
        Coarse { hzb: &self.hzb, size: [screen.width, screen.height] }
    }

    /// Occluders, and the other instances that are not hidden; both ascending.
    fn choose(&self, pass: &Pass<'_>) -> (Vec<u32>, Vec<u32>) {
        let all: Vec<u32> = (0..pass.views.len() as u32).collect();
        let mut unhidden = instance_cull::unhidden(&all, pass.views, &self.occluder(pass.screen));
        let area = |&i: &u32| {
            let [x0, y0, x1, y1] = pass.views[i as usize].footprint.rect.map(u64::from);
            std::cmp::Reverse((x1 - x0 + 1) * (y1 - y0 + 1))
        };
        unhidden.sort_by_key(area);
        let mut rest = unhidden.split_off(self.form.occluders.min(unhidden.len()));
        unhidden.sort_unstable();
        rest.sort_unstable();
        (unhidden, rest)
    }

    /// Fills the texels with what the last frame says of this one; with the farthest key where it says nothing.
    fn reproject(&mut self, instances: &[(u32, &Instance)], view: &View, screen: &Screen) {
        let Some(last) = &self.last else { return self.texels.fill(0) };
        let width = screen.width as usize;
        let set = |texel: &mut u32, key: u32| *texel = key;
        let moved: Vec<bool> = match self.form.care {
            Care::Least => Vec::new(),
            Care::Most => last.moved(instances),
        };
        if moved.contains(&true) {
            let key = |word: u64| match word.visible() {
                Some(number) if !moved[number as usize] => word.key(),
                _ => 0,
            };
            farthest(&last.words, width, key, &mut self.texels, set);
        } else {
            farthest(&last.words, width, |word| word.key(), &mut self.texels, set);
        }
        if view.pose == last.view.pose {
            return;
        }
        self.scattered.par_iter().with_min_len(1 << 14).for_each(|t| t.store(HOLE, Ordering::Relaxed));
        let scatter = Scatter::new(&last.view, view, &self.scattered);
        let rows = self.texels.par_chunks(ROWS_PER_TASK * COLUMNS).enumerate();
        rows.for_each(|(chunk, keys)| {
            for (row, keys) in keys.chunks(COLUMNS).enumerate() {
                scatter.row(chunk * ROWS_PER_TASK + row, keys);
            }
        });
        let (scattered, care) = (&self.scattered, self.form.care);
        let at = |column: usize, row: usize| scattered[row * RING_COLUMNS + column].load(Ordering::Relaxed);
        let fill = |(row, out): (usize, &mut [u32])| {
            for (column, out) in out.iter_mut().enumerate() {
                let own = at(column + 1, row + 1);
                let mut around = (0..9).map(|k| at(column + k % 3, row + k / 3));
                let doubtful = own == HOLE || care == Care::Most && around.any(|key| key == HOLE);
                *out = if doubtful { 0 } else { own };
            }
        };
        self.texels.par_chunks_mut(COLUMNS).enumerate().with_min_len(ROWS_PER_TASK).for_each(fill);
    }
}

impl Last {
    /// Which clusters of the list belong to instances that moved, or are gone.
    fn moved(&self, instances: &[(u32, &Instance)]) -> Vec<bool> {
        let poses = |slot: u32| {
            let old = self.poses.binary_search_by_key(&slot, |(slot, _)| *slot).ok()?;
            let new = instances.binary_search_by_key(&slot, |(slot, _)| *slot).ok()?;
            Some((self.poses[old].1, *instances[new].1.pose()))
        };
        let moved = |slot: u32| poses(slot).is_none_or(|(old, new)| old != new);
        self.list.iter().map(|(slot, _)| moved(*slot)).collect()
    }
}

/// Moves squares at a depth from one picture to another.
struct Scatter<'a> {
    /// The ray through a corner of texels at distance 1, in the camera space of the new picture: its first, and steps.
    first: Vec3,
    right: Vec3,
    down: Vec3,
    /// The old eye there.
    eye: Vec3,
    focal: [f32; 2],
    center: [f32; 2],
    near: f32,
    out: &'a [AtomicU32],
}

impl<'a> Scatter<'a> {
    fn new(from: &View, to: &View, out: &'a [AtomicU32]) -> Self {
        let map = to.pose.inverse() * from.pose;
        let texel = [f64::from(to.width) / COLUMNS as f64, f64::from(to.height) / ROWS as f64];
        let ray = |x: f64, y: f64, z: f64| (map.matrix3 * DVec3::new(x, y, z)).as_vec3();
        Self {
            first: ray(-from.center[0] / from.focal[0], from.center[1] / from.focal[1], -1.0),
            right: ray(texel[0] / from.focal[0], 0.0, 0.0),
            down: ray(0.0, -texel[1] / from.focal[1], 0.0),
            eye: map.translation.as_vec3(),
            focal: std::array::from_fn(|k| (to.focal[k] / texel[k]) as f32),
            center: std::array::from_fn(|k| (to.center[k] / texel[k]) as f32),
            near: to.near as f32,
            out,
        }
    }

    /// A row of texels. A key is that of near ÷ distance, so 0 is infinitely far, and has a place all the same.
    fn row(&self, row: usize, keys: &[u32]) {
        let ray =
            |column: usize, row: usize| self.first + self.right * column as f32 + self.down * row as f32;
        'texels: for (column, &key) in keys.iter().enumerate() {
            let value = f32::from_bits(key);
            let (mut low, mut high, mut farthest) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2], 1.0f32);
            for corner in 0..4 {
                // Over the distance from the old eye.
                let point = ray(column + corner % 2, row + corner / 2) + self.eye * (value / self.near);
                let ahead = -point.z;
                if ahead <= 1.0e-3 || value >= ahead {
                    // Behind the eye or before the near plane.
                    continue 'texels;
                }
                farthest = farthest.min(value / ahead);
                let at = [point.x, -point.y];
                for k in 0..2 {
                    let at = self.focal[k] * at[k] / ahead + self.center[k];
                    (low[k], high[k]) = (low[k].min(at), high[k].max(at));
                }
            }
            let key = (farthest * (1.0 - DEPTH_SLACK)).to_bits();
            // Numbers in the ring, of which the first lies one to the left.
            let range = |k: usize, count: usize| {
                let first = (low[k] + SLACK).floor().max(-1.0) + 1.0;
                let last = (high[k] - SLACK).ceil().min(count as f32 - 1.0);
                (first as usize, last as i64)
            };
            let (columns, rows) = (range(0, RING_COLUMNS), range(1, RING_ROWS));
            for y in rows.0 as i64..=rows.1 {
                for x in columns.0 as i64..=columns.1 {
                    let texel = &self.out[y as usize * RING_COLUMNS + x as usize];
                    if key < texel.load(Ordering::Relaxed) {
                        texel.fetch_min(key, Ordering::Relaxed);
                    }
                }
            }
        }
    }
}

/// The pyramid of the texels, asked in pixels.
struct Coarse<'a> {
    hzb: &'a Hzb,
    /// Of the picture, pixels.
    size: [u32; 2],
}

impl Occluder for Coarse<'_> {
    fn hides(&self, footprint: &Footprint) -> bool {
        let [width, height] = self.size;
        let texel = |edge: u32, texels: usize, size: u32| (edge * texels as u32 / size) as u16;
        let [x0, y0, x1, y1] = footprint.rect.map(u32::from);
        // The last texel that the last pixel touches.
        let last = |pixel: u32, texels: usize, size: u32| {
            ((((pixel + 1) * texels as u32).div_ceil(size)) - 1) as u16
        };
        let rect = [
            texel(x0, COLUMNS, width),
            texel(y0, ROWS, height),
            last(x1, COLUMNS, width),
            last(y1, ROWS, height),
        ];
        self.hzb.hides(&Footprint { rect, ..*footprint })
    }
}

/// Gives every texel the farthest key of the pixels that it touches, by `put`.
fn farthest(
    words: &[u64],
    width: usize,
    key: impl Fn(u64) -> u32 + Sync,
    texels: &mut [u32],
    put: impl Fn(&mut u32, u32) + Sync,
) {
    let height = words.len() / width;
    let fill = |(row, out): (usize, &mut [u32])| {
        let rows = row * height / ROWS..((row + 1) * height).div_ceil(ROWS);
        let mut columns = vec![u32::MAX; width];
        for row in rows {
            let pixels = words[row * width..][..width].iter();
            columns.iter_mut().zip(pixels).for_each(|(least, word)| *least = (*least).min(key(*word)));
        }
        for (column, texel) in out.iter_mut().enumerate() {
            let touched = column * width / COLUMNS..((column + 1) * width).div_ceil(COLUMNS);
            put(texel, columns[touched].iter().copied().min().unwrap_or(0));
        }
    };
    texels.par_chunks_mut(COLUMNS).enumerate().with_min_len(ROWS_PER_TASK).for_each(fill);
}

/// The product's own stages over some instances.
struct Pass<'a> {
    views: &'a [InstanceView],
    screen: &'a Screen,
    tau: f32,
}

impl Pass<'_> {
    fn cull(&self, instances: &[u32], hzb: &impl Occluder) -> Vec<CandidateCluster> {
        let walk = node_cull::run(instances, self.views, self.screen, self.tau, Some(hzb));
        let culled = cluster_cull::run(&walk.groups, self.views, self.screen, self.tau, Some(hzb));
        let mut candidates = culled.candidates;
        if !candidates.is_sorted() {
            candidates.par_sort_unstable();
        }
        candidates
    }

    /// Draws some clusters of a list.
    fn draw(&self, some: &[CandidateCluster], list: &[CandidateCluster], words: &mut [u64]) {
        let visible: Vec<Visible> = list.iter().map(|c| c.visible).collect();
        let numbers = numbers(some, list);
        let of = |large: bool| -> Vec<u32> {
            let some = some.iter().zip(&numbers).filter(|(c, _)| c.large == large);
            some.map(|(_, number)| *number).collect()
        };
        let sink = Nearest(u64::cells(words));
        raster_small::run(&of(false), &visible, self.views, self.screen, &sink);
        raster_large::run(&of(true), &visible, self.views, self.screen, &sink);
    }
}

/// Where entries of a sorted list lie in it.
fn numbers(some: &[CandidateCluster], list: &[CandidateCluster]) -> Vec<u32> {
    let mut at = 0;
    let number = |c: &CandidateCluster| {
        at += list[at..].iter().position(|other| other == c).expect("it is in the list");
        at as u32
    };
    some.iter().map(number).collect()
}

fn clock<T>(ms: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *ms += start.elapsed().as_secs_f64() * 1e3;
    result
}
