//! Meeting a budget of triangles exactly. Cuts come in steps of whole groups; the difference to the budget is
//! simplified when a cut is made.
//!
//! The finer of the two cuts beside the budget is the start. The groups that the coarser one would replace next
//! become one mesh, several times as large as what has to go. Its edges are collapsed as in building, down to what
//! the budget leaves for it. Vertices that the rest of the cut shares are locked, so that no crack opens. The error
//! of the result is measured against the clusters it was made from, and their own stated error is added:
//! docs/numerics.md has the proof.

mod bisect;
mod gather;
mod measure;
mod stitch;

use std::sync::OnceLock;

use rustc_hash::FxHashSet;

use self::bisect::bisect_to;
use self::gather::Region;
use self::measure::Changes;
use crate::build::content::Content;
use crate::build::dag::RELAX_REACH;
use crate::build::simplify::{Finished, collapse_loosely_to, collapse_to, prune_to, thin_to};
use crate::build::store::LocalMesh;
use crate::error::{Error, Result};
use crate::lod::{CutArrays, FaceBudget, attribute_error_with, error_with, extract_numbered};
use crate::math::sphere::round_up;
use crate::mesh::channels::{Scale, scales};
use crate::mesh::hash;
use crate::model::{ClusterAddress, Dag, Group, InterruptCheck};

/// Triangles that are gathered for each triangle to remove: the cheapest edges are chosen among them.
const ROOM: u64 = 6;
/// The least number of triangles that are gathered, if there are as many.
const LEAST: u64 = 4_000;
/// The same where collapses may change the topology, which takes ten times as long where the surface is folded.
const ROOM_APART: u64 = 2;
const LEAST_APART: u64 = 1_000;
/// Where the error is more than so many times the coarser cut's, collapses that change the topology are tried.
/// Where the better result is still as far off, the coarser cut is taken.
const FAR: f32 = 1.5;
/// Where the coarser cut lacks less than one in so many of the triangles between the two cuts, its edges are
/// bisected: it is nearer to the source than what collapses leave.
const FEW_PART: u64 = 10;
/// Where the gathered triangles do not suffice, so many times as many are gathered.
const MORE: u64 = 8;
/// A whole cut of at most `SMALL` triangles is measured against a cut with `FINER` times as many.
const SMALL: u64 = 3_000;
const FINER: u64 = 3;
/// The distance that collapses since that finer cut moved, as a multiple of that of the last step.
const FINER_REACH: f64 = 4.0;
/// A closed surface loses two triangles at a time.
const NEAR: u64 = 1;
/// A cut meets its budget with at most so many triangles fewer, or with one in so many fewer.
const SHORT: u64 = 2;
const SHORT_PART: u64 = 200;

/// What is computed once for a mesh to meet budgets.
#[derive(Debug)]
pub struct Finisher {
    /// Triangles of the cuts of whole groups.
    pub budget: FaceBudget,
    content: Content,
    /// Whether errors are proven.
    bounded: bool,
    scales: OnceLock<Vec<Scale>>,
}

/// A cut, part of which may be made for its budget.
#[derive(Debug)]
pub struct FinishedCut {
    /// Its clusters, in page order.
    pub clusters: Vec<ClusterAddress>,
    /// The triangles that were made.
    pub made: Option<Made>,
}

/// Triangles that replace some clusters and are in no cluster of the mesh.
#[derive(Debug)]
pub struct Made {
    /// The triangles, with the vertices of what they were made from.
    pub mesh: LocalMesh,
    /// Runs of triangles of one material and level.
    pub parts: Vec<Part>,
    /// For each channel of the mesh the rows of new vertices, in the order of their identities.
    pub channels: Vec<Vec<u32>>,
    /// The stated error of its shape, in internal units.
    pub distance: f32,
    /// The stated error of its attributes.
    pub attribute_error: f32,
}

/// A run of made triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Part {
    /// Of its triangles.
    pub material: i32,
    /// Times their surface was simplified.
    pub level: u8,
    /// Number of triangles.
    pub faces: u32,
}

impl Finisher {
    /// Tabulates a mesh; [`FaceBudget::is_stated`] tells whether its pages are in memory then.
    pub fn new(dag: &Dag) -> Self {
        let infos: Vec<_> = dag.channels.iter().map(|channel| channel.info.clone()).collect();
        let report = &dag.report;
        let content = Content::of(dag.layout(), &infos, report.computed_normals, &report.weights);
        // Where building proved nothing, no group has a bound.
        let bounded = dag.groups.iter().all(|group| group.error.is_infinite() || group.bound.is_finite());
        Self { budget: FaceBudget::new(dag), content, bounded, scales: OnceLock::new() }
    }

    /// How floating-point channels are scaled; reads them.
    fn scales(&self, dag: &Dag) -> Result<&[Scale]> {
        if let Some(scales) = self.scales.get() {
            return Ok(scales);
        }
        let found = scales(&dag.channels)?;
        Ok(self.scales.get_or_init(|| found))
    }

    /// Loads the pages that cuts of `target` triangles look at, where the mesh is in a file.
    pub fn load(&self, dag: &Dag, target: u64, proceed: InterruptCheck<'_>) -> Result<()> {
        if dag.pages.source().is_none() {
            return Ok(());
        }
        let beside = self.budget.beside(target);
        let fine = beside.fine.unwrap_or(beside.coarse);
        let faces = self.budget.faces(fine);
        // That a small one is measured against.
        let finer = if faces <= SMALL { self.budget.beside(FINER * faces).coarse } else { fine };
        self.budget.load(dag, fine.min(finer), proceed)
    }

    /// A cut of whole groups: the finest with at most `target` triangles, or the coarsest there is.
    pub fn whole(&self, dag: &Dag, target: u64) -> FinishedCut {
        FinishedCut { clusters: self.budget.select(dag, target), made: None }
    }

    /// A cut of `target` triangles, or two or half a percent less; the coarsest there is where that has more.
    pub fn exact(&self, dag: &Dag, target: u64) -> Result<FinishedCut> {
        let beside = self.budget.beside(target);
        let (Some(fine), true) = (beside.fine, self.budget.faces(beside.coarse) + NEAR < target) else {
            return Ok(self.whole(dag, target));
        };
        let scales = self.scales(dag)?;
        let finish = Finish {
            finisher: self,
            dag,
            scales,
            short: SHORT.max(target / SHORT_PART) as usize,
            relaxes: self.bounded && !dag.report.preserve_area && self.content.is_bare(),
        };
        let clusters = self.budget.clusters(dag, fine);
        let coarser = self.budget.clusters(dag, beside.coarse);
        let bisected = || finish.bisected(&clusters, &coarser, target);
        let [more, fewer] = [fine, beside.coarse].map(|replaced| self.budget.faces(replaced));
        // What a file states of its groups need not be so.
        if [faces_of(dag, &clusters), faces_of(dag, &coarser)] != [more, fewer] {
            return Err(Error::Invariant("groups do not have the triangles that they state".into()));
        }
        if FEW_PART * (target - fewer) <= more - fewer {
            return bisected();
        }
        let excess = more - target;
        // Collapses would shift images that were baked for their level, which has more seams than edges to collapse.
        if coarser.iter().any(|at| dag.report.is_rebaked(dag.record(*at).material)) {
            return bisected();
        }
        let enough = (ROOM * excess).max(LEAST);
        let groups = self.gather(dag, fine, enough);
        if groups.is_empty() {
            return bisected();
        }
        if dag.report.preserve_area {
            // Collapses would shrink islands; the coarser cut covers as much as the source.
            return finish.thinned(&clusters, &groups, excess)?.map_or_else(bisected, Ok);
        }
        let attempt = |groups: &[&Group], cuts| Attempt::new(&finish, &clusters, groups, excess, cuts);
        // Collapses that keep the topology are fast, and mostly enough.
        let kept = attempt(&groups, false)?.collapsed().transpose()?;
        let is_far = |cut: &FinishedCut| cut.made_distance() > FAR * largest(dag, &coarser, Group::distance);
        if let Some(cut) = kept {
            if !is_far(&cut) {
                return Ok(cut);
            }
            // Removing components may be better.
            let few = self.gather(dag, fine, (ROOM_APART * excess).max(LEAST_APART));
            let apart = attempt(&few, true)?;
            let other = apart.collapsed().transpose()?;
            let nearer = other.filter(|other| other.made_distance() < cut.made_distance()).unwrap_or(cut);
            // The coarser cut is better than a worse shape.
            return if is_far(&nearer) { bisected() } else { Ok(nearer) };
        }
        let apart = attempt(&groups, true)?;
        if let Some(cut) = apart.collapsed().or_else(|| apart.thinned()).transpose()? {
            return Ok(cut);
        }
        let more = self.gather(dag, fine, MORE * enough);
        if more.len() > groups.len()
            && let Some(cut) = attempt(&more, false)?.collapsed().transpose()?
        {
            return Ok(cut);
        }
        apart.loose().unwrap_or_else(bisected)
    }

    /// The groups that are replaced next, until they have `enough` triangles together.
    fn gather<'a>(&'a self, dag: &'a Dag, fine: usize, enough: u64) -> Vec<&'a Group> {
        let mut sum = 0;
        let mut groups = Vec::new();
        for group in self.budget.next(dag, fine) {
            groups.push(group);
            sum += group.members().map(|at| u64::from(dag.record(at).triangle_count)).sum::<u64>();
            if sum >= enough {
                break;
            }
        }
        groups
    }
}

/// Triangles of clusters.
fn faces_of(dag: &Dag, clusters: &[ClusterAddress]) -> u64 {
    clusters.iter().map(|at| u64::from(dag.record(*at).triangle_count)).sum()
}

/// What finishing a cut needs.
struct Finish<'a> {
    finisher: &'a Finisher,
    dag: &'a Dag,
    scales: &'a [Scale],
    /// Triangles that may be missing.
    short: usize,
    /// Whether vertices are relaxed to fit best, as in building.
    relaxes: bool,
}

/// Some groups of a cut after as many collapses as the budget asks for.
struct Attempt<'a> {
    finish: &'a Finish<'a>,
    /// The clusters of the cut that are in none of them.
    rest: Vec<ClusterAddress>,
    region: Region,
    /// Triangles that the budget leaves for it.
    target: usize,
    made: Finished,
}

impl<'a> Attempt<'a> {
    fn new(
        finish: &'a Finish<'a>,
        clusters: &[ClusterAddress],
        groups: &[&Group],
        excess: u64,
        cuts: bool,
    ) -> Result<Self> {
        let (region, rest, target) = finish.region(clusters, groups, excess)?;
        let made = collapse_to(&region.mesh, target, &finish.finisher.content, cuts);
        Ok(Self { finish, rest, region, target, made })
    }

    /// Whether a mesh meets the budget.
    fn fits(&self, mesh: &LocalMesh) -> bool {
        self.finish.fits(mesh, self.target)
    }

    fn state(&self, mesh: LocalMesh, estimate: f32, pruned: bool) -> Result<FinishedCut> {
        let mut changes = Changes::new(&self.region, mesh, pruned);
        // Where components were removed, all else stays as it is.
        let finer = if changes.pruned { None } else { self.finer()? };
        let reach = RELAX_REACH * f64::from(self.made.moved);
        match &finer {
            Some(finer) if self.finish.relaxes => changes.relax_to(finer, FINER_REACH * reach),
            None if self.finish.relaxes => changes.relax(&self.region, reach),
            _ => {}
        }
        self.finish.state(self.rest.clone(), &self.region, changes, estimate, finer.as_ref())
    }

    /// A cut with several times the triangles to measure against, where the whole cut is made and comparing is
    /// fast.
    fn finer(&self) -> Result<Option<Region>> {
        let Finish { finisher, dag, scales, .. } = self.finish;
        let faces = self.region.faces() as u64;
        if !finisher.bounded || !self.rest.is_empty() || faces > SMALL {
            return Ok(None);
        }
        let clusters = finisher.budget.select(dag, FINER * faces);
        Region::gather(dag, clusters, &[], scales).map(Some)
    }

    /// The cut, if collapses suffice.
    fn collapsed(&self) -> Option<Result<FinishedCut>> {
        let Finished { mesh, estimate, .. } = &self.made;
        self.fits(mesh).then(|| self.state(mesh.clone(), *estimate, false))
    }

    /// The cut, if islands can be removed as a whole.
    fn thinned(&self) -> Option<Result<FinishedCut>> {
        let mesh = prune_to(&self.made.mesh, self.target)?;
        self.fits(&mesh).then(|| self.state(mesh, self.made.estimate, true))
    }

    /// The cut, if collapses suffice that change the topology.
    fn loose(&self) -> Option<Result<FinishedCut>> {
        let mut mesh = self.made.mesh.clone();
        mesh.position_ids = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
        // Added vertices are ordinary ones here.
        let copies = std::mem::take(&mut mesh.copies);
        let (mesh, error) = collapse_loosely_to(&mesh, self.target, &self.finish.finisher.content)?;
        let mesh = LocalMesh { copies, ..mesh };
        let estimate = round_up(f64::from(self.made.estimate) + f64::from(error));
        self.fits(&mesh).then(|| self.state(mesh, estimate, true))
    }
}

impl Finish<'_> {
    /// Some groups of a cut as a region, the other clusters, and the triangles that the budget leaves for the
    /// region.
    fn region(
        &self,
        clusters: &[ClusterAddress],
        groups: &[&Group],
        excess: u64,
    ) -> Result<(Region, Vec<ClusterAddress>, usize)> {
        let members: FxHashSet<ClusterAddress> = groups.iter().flat_map(|group| group.members()).collect();
        let (own, rest): (Vec<_>, Vec<_>) = clusters.iter().partition(|at| members.contains(at));
        let region = Region::gather(self.dag, own, &rest, self.scales)?;
        let target = region.faces().saturating_sub(excess as usize);
        Ok((region, rest, target))
    }

    /// Whether a mesh has so many triangles, or not many fewer.
    fn fits(&self, mesh: &LocalMesh, target: usize) -> bool {
        let faces = mesh.indices.len() / 3;
        (1..=target).contains(&faces) && faces + self.short >= target
    }

    /// The cut with fewer islands that cover as much, if there are enough of them.
    fn thinned(
        &self,
        clusters: &[ClusterAddress],
        groups: &[&Group],
        excess: u64,
    ) -> Result<Option<FinishedCut>> {
        let (region, rest, target) = self.region(clusters, groups, excess)?;
        let Some((mesh, moved)) = thin_to(&region.mesh, target).filter(|(mesh, _)| self.fits(mesh, target))
        else {
            return Ok(None);
        };
        let changes = Changes::new(&region, mesh, true);
        self.state(rest, &region, changes, round_up(moved), None).map(Some)
    }

    /// The coarser cut, with edges bisected where it differs from the finer one.
    fn bisected(
        &self,
        fine: &[ClusterAddress],
        coarse: &[ClusterAddress],
        target: u64,
    ) -> Result<FinishedCut> {
        let known: FxHashSet<ClusterAddress> = fine.iter().copied().collect();
        let (rest, own): (Vec<_>, Vec<_>) = coarse.iter().partition(|at| known.contains(at));
        let triangles = |at: &ClusterAddress| usize::from(self.dag.record(*at).triangle_count);
        let room = (target as usize).saturating_sub(rest.iter().map(triangles).sum());
        let region = Region::gather(self.dag, own, &rest, self.scales)?;
        let changes = Changes::new(&region, bisect_to(&region.mesh, room), false);
        self.state(rest, &region, changes, 0.0, None)
    }

    /// Measures the error of what was made, and stitches it into the cut.
    fn state(
        &self,
        mut clusters: Vec<ClusterAddress>,
        region: &Region,
        changes: Changes,
        estimate: f32,
        finer: Option<&Region>,
    ) -> Result<FinishedCut> {
        let dag = self.dag;
        let all: Vec<_> = clusters.iter().chain(&region.clusters).copied().collect();
        let touched = changes.touched(region);
        let enough = largest(dag, &all, Group::distance);
        let distance = match finer {
            Some(finer) => changes.bound_to(dag, finer, enough),
            None if self.finisher.bounded => changes.bound(dag, region, enough),
            None => round_up(f64::from(largest(dag, &touched, Group::distance)) + f64::from(estimate)),
        };
        let known = largest(dag, &touched, |group| group.attribute_error);
        let enough = largest(dag, &all, |group| group.attribute_error) - known;
        let step = changes.deviation(region, &self.finisher.content, distance, enough);
        let attribute_error = round_up(f64::from(known) + f64::from(step));
        let (whole, made) = changes.stitch(dag, region, self.scales)?;
        clusters.extend(whole);
        clusters.sort_unstable();
        Ok(FinishedCut { clusters, made: Some(Made { distance, attribute_error, ..made }) })
    }
}

/// The largest stated error of the groups that clusters were made from.
fn largest(dag: &Dag, clusters: &[ClusterAddress], of: fn(&Group) -> f32) -> f32 {
    let origins = clusters.iter().filter_map(|at| dag.groups.get(dag.record(*at).refined as usize));
    origins.map(of).fold(0.0, f32::max)
}

impl FinishedCut {
    /// The stated error of what was made, in internal units.
    fn made_distance(&self) -> f32 {
        self.made.as_ref().map_or(0.0, |made| made.distance)
    }

    /// Its arrays: those of its clusters, then the triangles that were made, each part as if it were a cluster.
    pub fn extract(&self, dag: &Dag) -> CutArrays {
        let (mut out, number) = extract_numbered(dag, &self.clusters);
        if let Some(made) = &self.made {
            made.append(dag, &mut out, &number);
        }
        out
    }

    /// Its stated error, in object units; rounded up.
    pub fn error(&self, dag: &Dag) -> f64 {
        error_with(dag, &self.clusters, self.made_distance())
    }

    /// The stated error of its attributes, as a length in object units.
    pub fn attribute_error(&self, dag: &Dag) -> f64 {
        attribute_error_with(dag, &self.clusters, self.made.as_ref().map_or(0.0, |made| made.attribute_error))
    }

    /// The parts that were made.
    pub fn parts(&self) -> &[Part] {
        self.made.as_ref().map_or(&[], |made| &made.parts)
    }
}
