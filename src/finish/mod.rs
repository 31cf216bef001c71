//! Meeting a budget of triangles exactly: cuts come in steps of whole groups, and what is left between two of them is
//! made when a cut is.
//!
//! Of the two cuts beside a budget the finer one is taken. Of the groups that would be replaced next so many are gathered
//! that edges can be chosen among them, and these are collapsed as in building, down to what the budget leaves. What the rest
//! of the cut shares stays as it is, so that no crack opens. The error of what was made is measured against the clusters it was
//! made from, and what these state is added: docs/numerics.md has the proof.

mod gather;
mod measure;
mod weave;

use std::sync::OnceLock;

use rustc_hash::FxHashSet;

use self::gather::Region;
use self::measure::Changes;
use crate::build::content::Content;
use crate::build::simplify::collapse_to;
use crate::build::store::LocalMesh;
use crate::error::Result;
use crate::lod::{CutArrays, FaceBudget, attribute_error_with, error_with, extract_numbered};
use crate::math::sphere::round_up;
use crate::mesh::channels::{Scale, scales};
use crate::model::{ClusterAddress, Dag, Group};

/// Triangles that are gathered for each one that has to go: the cheapest edges are chosen among them.
const ROOM: u64 = 6;
/// As many are gathered at least, if there are.
const LEAST: u64 = 4_000;
/// Where they do not suffice, so many times as many.
const MORE: u64 = 8;
/// A closed surface loses two triangles at a time.
const NEAR: u64 = 1;

/// What is found once of a mesh to cut it by budgets.
#[derive(Debug)]
pub struct Finisher {
    /// Triangles of the cuts of whole groups.
    pub budget: FaceBudget,
    content: Content,
    scales: OnceLock<Vec<Scale>>,
}

/// A cut, some of which may be made for its budget.
#[derive(Debug)]
pub struct FinishedCut {
    /// Its clusters, in page order.
    pub clusters: Vec<ClusterAddress>,
    /// The rest.
    pub made: Option<Made>,
}

/// Triangles that are in no cluster of the mesh, in the place of some clusters.
#[derive(Debug)]
pub struct Made {
    /// The triangles, with the vertices of what they were made from.
    pub mesh: LocalMesh,
    /// Runs of triangles of one material and level.
    pub parts: Vec<Part>,
    /// For each channel of the mesh the rows of new vertices, in the order of their identities.
    pub channels: Vec<Vec<u32>>,
    /// How far its shape is stated to be off, in internal units.
    pub distance: f32,
    /// How far what it carries is.
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
    /// Tabulates a mesh whose pages are all in memory.
    pub fn new(dag: &Dag) -> Self {
        let infos: Vec<_> = dag.channels.iter().map(|channel| channel.info.clone()).collect();
        let report = &dag.report;
        let content = Content::of(dag.layout(), &infos, report.computed_normals, &report.weights);
        Self { budget: FaceBudget::new(dag), content, scales: OnceLock::new() }
    }

    /// How floating-point channels are scaled; reads them.
    fn scales(&self, dag: &Dag) -> Result<&[Scale]> {
        if let Some(scales) = self.scales.get() {
            return Ok(scales);
        }
        let found = scales(&dag.channels)?;
        Ok(self.scales.get_or_init(|| found))
    }

    /// A cut of whole groups: the finest with at most `target` triangles, or the coarsest there is.
    pub fn whole(&self, dag: &Dag, target: u64) -> FinishedCut {
        FinishedCut { clusters: self.budget.select(dag, target), made: None }
    }

    /// A cut of `target` triangles or at most [`NEAR`] fewer; the coarsest there is where that has more.
    pub fn exact(&self, dag: &Dag, target: u64) -> Result<FinishedCut> {
        let beside = self.budget.beside(target);
        let (Some(fine), true) = (beside.fine, self.budget.faces(beside.coarse) + NEAR < target) else {
            return Ok(self.whole(dag, target));
        };
        let scales = self.scales(dag)?;
        let clusters = self.budget.clusters(dag, fine);
        let excess = self.budget.faces(fine) - target;
        let mut enough = (ROOM * excess).max(LEAST);
        let mut gathered = 0;
        loop {
            let groups = self.gather(dag, fine, enough);
            if groups.len() == gathered {
                return Ok(self.whole(dag, target));
            }
            gathered = groups.len();
            if let Some(cut) = self.finish(dag, &clusters, &groups, excess, scales)? {
                return Ok(cut);
            }
            enough *= MORE;
        }
    }

    /// The groups that come next, of at least so many triangles together, if there are as many.
    fn gather<'a>(&'a self, dag: &'a Dag, fine: usize, enough: u64) -> Vec<&'a Group> {
        let mut sum = 0;
        let triangles = |group: &Group| -> u64 {
            group.members().map(|at| u64::from(dag.record(at).triangle_count)).sum()
        };
        let mut groups = Vec::new();
        for group in self.budget.next(dag, fine) {
            groups.push(group);
            sum += triangles(group);
            if sum >= enough {
                break;
            }
        }
        groups
    }

    /// A cut with `excess` fewer triangles, taken from these groups; nothing where so many cannot go.
    fn finish(
        &self,
        dag: &Dag,
        clusters: &[ClusterAddress],
        groups: &[&Group],
        excess: u64,
        scales: &[Scale],
    ) -> Result<Option<FinishedCut>> {
        let members: FxHashSet<ClusterAddress> = groups.iter().flat_map(|group| group.members()).collect();
        let (own, rest): (Vec<_>, Vec<_>) = clusters.iter().partition(|at| members.contains(at));
        let region = Region::gather(dag, own, &rest, scales)?;
        let Some(target) = region.faces().checked_sub(excess as usize).filter(|target| *target > 0) else {
            return Ok(None);
        };
        let (after, estimate) = collapse_to(&region.mesh, target, &self.content);
        if after.indices.len() / 3 > target {
            return Ok(None);
        }
        let changes = Changes::new(&region, after);
        Ok(Some(self.state(dag, rest, region, changes, estimate, scales)?))
    }

    /// Measures what was made, and puts it together.
    fn state(
        &self,
        dag: &Dag,
        mut clusters: Vec<ClusterAddress>,
        region: Region,
        changes: Changes,
        estimate: f32,
        scales: &[Scale],
    ) -> Result<FinishedCut> {
        let largest = |clusters: &[ClusterAddress], of: fn(&Group) -> f32| {
            let origins = clusters.iter().filter_map(|at| dag.groups.get(dag.record(*at).refined as usize));
            origins.map(of).fold(0.0, f32::max)
        };
        let all = || clusters.iter().chain(&region.clusters).copied().collect::<Vec<_>>();
        let all = all();
        let touched = changes.touched(&region);
        let enough = largest(&all, Group::distance);
        let bounded = largest(&all, |group| group.bound).is_finite();
        let distance = if bounded {
            changes.bound(dag, &region, enough)
        } else {
            round_up(f64::from(largest(&touched, Group::distance)) + f64::from(estimate))
        };
        let enough = largest(&all, |group| group.attribute_error);
        let known = largest(&touched, |group| group.attribute_error);
        let step = changes.deviation(&region, &self.content, distance, enough - known);
        let attribute_error = round_up(f64::from(known) + f64::from(step));
        let (whole, made) = changes.weave(dag, &region, scales)?;
        clusters.extend(whole);
        clusters.sort_unstable();
        Ok(FinishedCut { clusters, made: Some(Made { distance, attribute_error, ..made }) })
    }
}

impl FinishedCut {
    /// Its arrays: those of its clusters, and behind them the triangles that were made, each part as if it were a cluster.
    pub fn extract(&self, dag: &Dag) -> CutArrays {
        let (mut out, number) = extract_numbered(dag, &self.clusters);
        if let Some(made) = &self.made {
            made.append(dag, &mut out, &number);
        }
        out
    }

    /// How far it is stated to be off, in object units; rounded up.
    pub fn error(&self, dag: &Dag) -> f64 {
        error_with(dag, &self.clusters, self.made.as_ref().map_or(0.0, |made| made.distance))
    }

    /// How far what it carries is, as a length in object units.
    pub fn attribute_error(&self, dag: &Dag) -> f64 {
        attribute_error_with(dag, &self.clusters, self.made.as_ref().map_or(0.0, |made| made.attribute_error))
    }

    /// The parts that were made.
    pub fn parts(&self) -> &[Part] {
        self.made.as_ref().map_or(&[], |made| &made.parts)
    }
}
