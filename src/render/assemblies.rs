//! Which assemblies are drawn by their parts: a scene of meshes that follows one with assemblies, made for the views of a call
//! before its first stage. All stages, shadows, streaming and both backends see meshes alone.
//!
//! An assembly is taken apart where, from any view that it may be seen in, the error of the mesh that stands for it projects
//! above the threshold: the rule of the cut, see [`crate::model::rule`]. All views of a call see the same, and so do lights.
//! Outside of all views the one mesh stands there for shadows. What is drawn depends on the call alone and not on frames
//! before, its order included.

use std::sync::Arc;
use std::time::Instant;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::stats::AssemblyStats;
use crate::error::{Error, Result};
use crate::limits::MAX_PARTS;
use crate::math::sphere::round_up;
use crate::math::{LodView, Sphere};
use crate::model::rule::Threshold;
use crate::scene::placement::Eye;
use crate::scene::{Assembly, Dressed, Handle, Instance, Owners, PartShape, Scene, View};

/// Assemblies and parts per task.
const PER_TASK: usize = 256;

/// A view, for the choice.
struct Spectator {
    planes: Vec<(DVec3, f64)>,
    place: DVec3,
    eye: Eye,
    tau: f32,
}

impl Spectator {
    fn new((view, tau): &(View, f32)) -> Self {
        Self { planes: view.planes(), place: view.eye(), eye: Eye::new(view), tau: *tau }
    }

    fn may_see(&self, center: DVec3, radius: f64) -> bool {
        let to = center - self.place;
        // f64: this much covers the rounding of the sphere and the test.
        let radius = radius + 1.0e-12 * (center.length() + self.place.length());
        self.planes.iter().all(|(normal, distance)| normal.dot(to) + distance >= -radius)
    }

    /// Whether an error of something of a radius, both in its own units and stretched by up to `scale`, projects above the
    /// threshold.
    fn is_too_large(&self, error: f64, center: DVec3, radius: f64, scale: f64) -> bool {
        let Eye { rotate, lod_focal, lod_widest, lod_near, .. } = &self.eye;
        let to = center - self.place;
        let row = |r: [f32; 3]| {
            let along: f64 = r.iter().zip(to.to_array()).map(|(r, t)| f64::from(*r) * t).sum();
            [0.0, 0.0, 0.0, along as f32]
        };
        let view = LodView {
            object_to_eye: rotate.map(row),
            scale: round_up(scale),
            rounding: 0.0,
            focal: *lod_focal,
            widest: *lod_widest,
            near: *lod_near,
        };
        // Grown by what rounding moves the middle.
        let radius = radius + 1.0e-6 * to.length() / scale;
        let sphere = Sphere { center: [0.0; 3], radius: round_up(radius) };
        Threshold::View(view, self.tau).exceeded_by(&sphere, round_up(error))
    }
}

/// What becomes of an assembly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Choice {
    Outside,
    Far,
    Expanded,
}

/// What an assembly at a pose that stretches by up to `scale` becomes.
fn choose(spectators: &[Spectator], assembly: &Assembly, pose: &DAffine3, scale: f64) -> Choice {
    let (center, radius) = assembly.sphere();
    let (center, error) = (pose.transform_point3(center), assembly.error());
    let mut choice = Choice::Outside;
    for spectator in spectators.iter().filter(|s| s.may_see(center, radius * scale)) {
        if spectator.is_too_large(error, center, radius, scale) {
            return Choice::Expanded;
        }
        choice = Choice::Far;
    }
    choice
}

/// A part at its place in the world.
struct Placed<'a> {
    what: &'a Dressed,
    pose: DAffine3,
}

/// Takes assemblies apart, level by level.
struct Walk<'a> {
    spectators: &'a [Spectator],
    /// What nobody sees is drawn, too: it may throw shadows.
    unseen: bool,
    parts: Vec<Placed<'a>>,
    stats: AssemblyStats,
}

impl<'a> Walk<'a> {
    fn expand(&mut self, assembly: &'a Assembly, pose: &DAffine3, scale: f64) -> Result<()> {
        self.stats.expanded += 1;
        for part in &assembly.parts {
            match &part.shape {
                PartShape::Mesh(what) => {
                    self.check(part.places.len())?;
                    let placed = part.places.iter().map(|place| Placed { what, pose: *pose * place.pose });
                    self.parts.extend(placed);
                }
                PartShape::Assembly(inner) => {
                    self.stats.walked += part.places.len() as u64;
                    for place in &part.places {
                        let (pose, scale) = (*pose * place.pose, scale * place.scale);
                        match choose(self.spectators, inner, &pose, scale) {
                            Choice::Expanded => self.expand(inner, &pose, scale)?,
                            choice => self.stand_in(inner, pose, choice)?,
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// One mesh for all of an assembly.
    fn stand_in(&mut self, assembly: &'a Assembly, pose: DAffine3, choice: Choice) -> Result<()> {
        let outside = choice == Choice::Outside;
        *(if outside { &mut self.stats.outside } else { &mut self.stats.far }) += 1;
        if self.unseen || !outside {
            self.check(1)?;
            self.parts.push(Placed { what: &assembly.far, pose });
        }
        Ok(())
    }

    fn check(&self, more: usize) -> Result<()> {
        let count = self.parts.len() + more;
        if count <= MAX_PARTS {
            return Ok(());
        }
        let message = format!(
            "{count} parts of assemblies and more would be drawn one by one, the most is {MAX_PARTS}: assemblies with finer \
             far meshes, or a larger pixel_error, are taken apart later"
        );
        Err(Error::TooLarge(message))
    }
}

/// The scene that is drawn in place of one with assemblies. Kept from frame to frame, so that only what changes is made anew.
#[derive(Debug, Default)]
pub(super) struct Expansion {
    scene: Scene,
    /// The scene that it follows, and its clock then.
    known: Option<(u64, u64)>,
    /// Slots of its instances of assemblies.
    assemblies: Vec<u32>,
    /// Those that are taken apart, which are hidden here.
    expanded: Vec<u32>,
    /// Where parts begin, behind all slots of that scene.
    base: u32,
    /// How many there are.
    parts: u32,
}

impl Expansion {
    /// What is to be drawn.
    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Follows a scene and chooses for views, each with its threshold. With `unseen` what lies outside of all of them is there,
    /// too.
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        views: &[(View, f32)],
        unseen: bool,
    ) -> Result<AssemblyStats> {
        let start = Instant::now();
        let slots = scene.instances();
        let since = self.known.filter(|known| known.0 == scene.identity()).map(|known| known.1);
        if since.is_none() || slots.capacity() > self.base as usize {
            // Room for as many again, so that this is seldom.
            let base = slots.capacity().next_power_of_two().min(u32::MAX as usize) as u32;
            *self = Self { base, ..Self::default() };
        }
        let since = self.known.map_or(0, |known| known.1);
        let clock = self.scene.follow(scene, since);
        if since == 0 || clock != since {
            let of_assembly = |(slot, instance): (u32, &Instance)| instance.assembly.as_ref().map(|_| slot);
            self.assemblies = slots.iter().filter_map(of_assembly).collect();
        }
        self.known = Some((scene.identity(), clock));
        let spectators: Vec<Spectator> = views.iter().map(Spectator::new).collect();
        let choices: Vec<Choice> = self
            .assemblies
            .par_iter()
            .with_min_len(PER_TASK)
            .map(|slot| match slots.at(*slot as usize) {
                Some(instance @ Instance { visible: true, assembly: Some(assembly), .. }) => {
                    choose(&spectators, assembly, instance.pose(), instance.scale())
                }
                _ => Choice::Outside,
            })
            .collect();
        let mut walk =
            Walk { spectators: &spectators, unseen, parts: Vec::new(), stats: AssemblyStats::default() };
        walk.stats.walked = choices.len() as u64;
        let (mut expanded, mut runs) = (Vec::new(), Vec::new());
        for (slot, choice) in self.assemblies.iter().zip(choices) {
            match choice {
                Choice::Outside => walk.stats.outside += 1,
                Choice::Far => walk.stats.far += 1,
                Choice::Expanded => {
                    let Some(instance) = slots.at(*slot as usize) else { continue };
                    let Some(assembly) = &instance.assembly else { continue };
                    runs.push((walk.parts.len(), instance, *slot));
                    walk.expand(assembly, instance.pose(), instance.scale())?;
                    expanded.push(*slot);
                }
            }
        }
        let Walk { parts, mut stats, .. } = walk;
        self.hide(scene, expanded);
        stats.parts = parts.len() as u64;
        stats.changed = self.place(&runs, &parts)?;
        stats.ms = start.elapsed().as_secs_f64() * 1e3;
        Ok(stats)
    }

    /// Hides what is taken apart, and nothing else that the scene shows.
    fn hide(&mut self, scene: &Scene, expanded: Vec<u32>) {
        let slots = scene.instances();
        for slot in self.expanded.iter().filter(|slot| expanded.binary_search(slot).is_err()) {
            self.scene.put(slots.handle(*slot), slots.at(*slot as usize).cloned());
        }
        for slot in &expanded {
            let shown = self.scene.instances().at(*slot as usize).filter(|instance| instance.visible);
            if let Some(mut hidden) = shown.cloned() {
                hidden.visible = false;
                self.scene.put(slots.handle(*slot), Some(hidden));
            }
        }
        self.expanded = expanded;
    }

    /// Puts parts behind the slots of the scene, in the order of their owners: those that are not there. Returns how many.
    fn place(&mut self, runs: &[(usize, &Instance, u32)], parts: &[Placed<'_>]) -> Result<u64> {
        let count = u32::try_from(parts.len()).ok().filter(|count| self.base.checked_add(*count).is_some());
        let count = count.ok_or_else(|| Error::TooLarge("a scene holds at most 2³² instances".to_owned()))?;
        let slots = self.scene.instances();
        let ends = runs.iter().skip(1).map(|run| run.0).chain([parts.len()]);
        let mut new: Vec<(u32, Instance)> = Vec::new();
        for ((first, owner, _), end) in runs.iter().zip(ends) {
            let run = parts[*first..end].par_iter().enumerate().with_min_len(PER_TASK);
            let made = run.filter_map(|(number, Placed { what, pose })| {
                let slot = self.base + (first + number) as u32;
                let there = slots.at(slot as usize).is_some_and(|known| known.is_part(owner, what, pose));
                (!there).then(|| (slot, Instance::part(owner, what, *pose)))
            });
            new.extend(made.collect::<Vec<_>>());
        }
        let changed = new.len() as u64;
        for (index, instance) in new {
            self.scene.put(Handle { index, generation: 0 }, Some(instance));
        }
        for index in self.base + count..self.base + self.parts.max(count) {
            self.scene.put(Handle { index, generation: 0 }, None);
        }
        self.parts = count;
        let first = |first: usize| self.base + first as u32;
        let owners = Owners::new(runs.iter().map(|run| (first(run.0), run.2)).collect());
        self.scene.set_owners(Arc::new(owners));
        Ok(changed)
    }
}
