//! Which clusters make up a cut.

use crate::error::Result;
use crate::model::rule::Threshold;
use crate::model::{ClusterAddress, Dag, Group, Patience};

/// The groups with members that may be drawn: whose error is too large for what was made from them, while that of some
/// member is not.
fn candidates<'a>(dag: &'a Dag, threshold: &Threshold) -> Vec<&'a Group> {
    let mut found = Vec::new();
    let mut stack = vec![0u32];
    while let Some(n) = stack.pop() {
        let node = &dag.nodes[n as usize];
        if !threshold.may_be_in_cut(&node.lod_sphere, node.max_parent_error, node.min_own_error) {
            continue;
        }
        let children = node.first..node.first + u32::from(node.count);
        if node.is_leaf == 0 {
            stack.extend(children);
            continue;
        }
        let groups = &dag.groups[children.start as usize..children.end as usize];
        let in_cut = |g: &&Group| threshold.may_be_in_cut(&g.lod_sphere, g.error, g.min_own_error);
        found.extend(groups.iter().filter(in_cut));
    }
    found
}

/// Brings the pages into memory that [`select`] looks at, if they are in a file.
pub fn load(dag: &Dag, threshold: &Threshold, go_on: Patience<'_>) -> Result<()> {
    if dag.pages.source().is_none() {
        return Ok(());
    }
    let mut pages: Vec<usize> = candidates(dag, threshold).iter().map(|group| group.first.page()).collect();
    pages.sort_unstable();
    pages.dedup();
    dag.pages.load(pages.into_iter(), go_on)
}

/// The clusters that the rule of the cut draws, in page order: exactly one over every piece of the surface. Their pages
/// are in memory: see [`load`].
pub fn select(dag: &Dag, threshold: &Threshold) -> Vec<ClusterAddress> {
    let own = |at: &ClusterAddress| {
        let record = dag.record(*at);
        !threshold.exceeded_by(&record.lod_sphere, record.error)
    };
    let members = candidates(dag, threshold).into_iter().flat_map(Group::members);
    let mut clusters: Vec<ClusterAddress> = members.filter(own).collect();
    clusters.sort_unstable();
    clusters
}

/// The largest of an error of the groups that a cut's clusters were made from; 0 at level 0.
fn largest(dag: &Dag, clusters: &[ClusterAddress], error: impl Fn(&Group) -> f32) -> f32 {
    let origins = clusters.iter().filter_map(|at| dag.groups.get(dag.record(*at).refined as usize));
    origins.map(error).fold(0.0, f32::max)
}

/// How far attributes are off in a cut, as a length in object units.
pub fn cut_attribute_error(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    f64::from(largest(dag, clusters, |group| group.attribute_error)) * dag.frame.scale
}

/// The largest distance stated for a cut's clusters in object units, plus the rounding of positions; rounded up.
pub fn cut_error(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    let largest = largest(dag, clusters, Group::distance);
    let rounding = dag.rounding();
    let error = f64::from(largest) * dag.frame.scale + rounding;
    if largest > 0.0 && rounding > 0.0 { error.next_up() } else { error }
}

/// How many triangles the cut for each estimate has: found once, then any budget is a search in a table.
///
/// For a number of triangles it is the estimates of the simplifier that are compared, and not what is proven: a bound
/// is that of the worst point of a group, an estimate says more about all of them, so that cuts come out nearer in the
/// mean. Estimates do not decrease along the DAG either, which is all that a cut needs to be whole.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceBudget {
    /// Estimates, increasing, internal units; the first is 0.
    estimates: Vec<f32>,
    /// Triangles of the cut at each.
    faces: Vec<u64>,
    /// Groups by falling estimate.
    groups: Vec<u32>,
}

/// What is compared for a number of triangles.
fn estimate(group: &Group) -> f32 {
    group.rank
}

/// The same for what a cluster is itself.
fn own_estimate(dag: &Dag, at: ClusterAddress) -> f32 {
    dag.groups.get(dag.record(at).refined as usize).map_or(0.0, estimate)
}

impl FaceBudget {
    /// Tabulates a mesh whose pages are all in memory. Costs one pass over the clusters.
    pub fn new(dag: &Dag) -> Self {
        // A cluster counts from its own estimate on, and no longer from its group's.
        let mut steps: Vec<(f32, i64)> = Vec::with_capacity(2 * dag.cluster_count());
        for group in dag.groups.iter() {
            for at in group.members() {
                let triangles = i64::from(dag.record(at).triangle_count);
                steps.push((own_estimate(dag, at), triangles));
                if group.error.is_finite() {
                    steps.push((estimate(group), -triangles));
                }
            }
        }
        steps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut groups: Vec<u32> = (0..dag.groups.len() as u32).collect();
        let of = |g: &u32| estimate(&dag.groups[*g as usize]);
        groups.sort_by(|a, b| of(b).total_cmp(&of(a)));
        let mut budget = Self { estimates: Vec::new(), faces: Vec::new(), groups };
        let mut count = 0;
        for step in steps.chunk_by(|a, b| a.0 == b.0) {
            count += step.iter().map(|s| s.1).sum::<i64>();
            budget.estimates.push(step[0].0);
            budget.faces.push(count.max(0) as u64);
        }
        budget
    }

    /// The finest cut with at most `target` triangles, or the coarsest there is, in page order.
    pub fn select(&self, dag: &Dag, target: u64) -> Vec<ClusterAddress> {
        // Counts fall with the estimate but for rare steps up by a few triangles: take the fullest that fits.
        let fits = |i: &usize| self.faces[*i] <= target;
        let best = (0..self.faces.len()).filter(fits).max_by_key(|i| (self.faces[*i], std::cmp::Reverse(*i)));
        let most = best.map_or_else(|| *self.estimates.last().unwrap_or(&0.0), |i| self.estimates[i]);
        let groups = self.groups.iter().map(|g| &dag.groups[*g as usize]);
        let coarser = groups.take_while(|group| estimate(group) > most);
        let members = coarser.flat_map(Group::members);
        let mut clusters: Vec<_> = members.filter(|at| own_estimate(dag, *at) <= most).collect();
        clusters.sort_unstable();
        clusters
    }
}
