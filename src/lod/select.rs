//! Selecting the clusters of a cut.

use crate::error::Result;
use crate::model::rule::Threshold;
use crate::model::{ClusterAddress, Dag, Group, InterruptCheck};

/// The groups with members that may be drawn: the group's (parent) error is above the threshold, and a member's own
/// error is not.
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

/// Loads the pages that [`select`] reads, where the mesh is in a file.
pub fn load(dag: &Dag, threshold: &Threshold, proceed: InterruptCheck<'_>) -> Result<()> {
    if dag.pages.source().is_none() {
        return Ok(());
    }
    load_groups(dag, candidates(dag, threshold).into_iter(), proceed)
}

/// Loads the pages of groups, where the mesh is in a file.
fn load_groups<'a>(
    dag: &Dag,
    groups: impl Iterator<Item = &'a Group>,
    proceed: InterruptCheck<'_>,
) -> Result<()> {
    let mut pages: Vec<usize> = groups.map(|group| group.first.page()).collect();
    pages.sort_unstable();
    pages.dedup();
    dag.pages.load(pages.into_iter(), proceed)
}

/// The clusters that the rule of the cut draws, in page order: exactly one over every piece of the surface. Their pages
/// are in memory: see [`load`].
pub fn select(dag: &Dag, threshold: &Threshold) -> Vec<ClusterAddress> {
    let own = |at: &ClusterAddress| {
        let (sphere, error) = dag.own_error(dag.record(*at));
        !threshold.exceeded_by(&sphere, error)
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

/// The attribute error of a cut, as a length in object units.
pub fn cut_attribute_error(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    attribute_error_with(dag, clusters, 0.0)
}

/// The same of a cut that also has what is so far off, in internal units.
pub fn attribute_error_with(dag: &Dag, clusters: &[ClusterAddress], other: f32) -> f64 {
    f64::from(largest(dag, clusters, |group| group.attribute_error).max(other)) * dag.frame.scale
}

/// The largest stated error of a cut's clusters in object units, plus the rounding of positions; rounded up.
pub fn cut_error(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    error_with(dag, clusters, 0.0)
}

/// The same of a cut that also has what is so far off, in internal units.
pub fn error_with(dag: &Dag, clusters: &[ClusterAddress], other: f32) -> f64 {
    let largest = largest(dag, clusters, Group::distance).max(other);
    let rounding = dag.rounding();
    let error = f64::from(largest) * dag.frame.scale + rounding;
    if largest > 0.0 && rounding > 0.0 { error.next_up() } else { error }
}

/// The number of triangles of the cut after each group is replaced by its simplification. Found once; a budget is
/// then a search in this table.
///
/// Budgets compare the ranks of groups, not their proven errors. A bound is that of the worst point of a group; a
/// rank says more about all of its points, so that cuts are closer in the mean. Ranks do not decrease along the DAG
/// either, and of equal ones the finer level comes first. A cut needs no more to be complete.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceBudget {
    /// Groups by ascending rank.
    order: Vec<u32>,
    /// The place of each group in that order.
    ranks: Vec<u32>,
    /// Triangles of the cut in which so many of them are replaced.
    faces: Vec<u64>,
}

/// The two cuts of whole groups beside a number of triangles, each by the number of groups that are replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beside {
    /// The one with more, if there is one.
    pub fine: Option<usize>,
    /// The one with at most so many, or the coarsest there is.
    pub coarse: usize,
}

impl FaceBudget {
    /// Whether a mesh says how many triangles its groups have; otherwise all of its pages are asked.
    pub fn is_stated(dag: &Dag) -> bool {
        dag.groups.iter().all(|group| group.triangles > 0)
    }

    /// Tabulates a mesh. Costs one pass over the groups, or, unless they say how many triangles they have, over the clusters
    /// of all pages, which are in memory.
    pub fn new(dag: &Dag) -> Self {
        let mut order: Vec<u32> = (0..dag.groups.len() as u32).collect();
        let of = |g: &u32| &dag.groups[*g as usize];
        order.sort_by(|a, b| {
            let by_rank = of(a).rank.total_cmp(&of(b).rank);
            of(a)
                .error
                .is_infinite()
                .cmp(&of(b).error.is_infinite())
                .then(by_rank)
                .then(of(a).level.cmp(&of(b).level))
                .then(a.cmp(b))
        });
        let mut ranks = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(g, rank)| ranks[*g as usize] = rank);
        let mut steps = vec![0i64; order.len()];
        if Self::is_stated(dag) {
            for (group, rank) in dag.groups.iter().zip(&ranks) {
                steps[*rank as usize] = i64::from(group.made) - i64::from(group.triangles);
            }
        } else {
            for (group, rank) in dag.groups.iter().zip(&ranks) {
                for at in group.members() {
                    let record = dag.record(at);
                    let triangles = i64::from(record.triangle_count);
                    steps[*rank as usize] -= triangles;
                    if let Some(refined) = ranks.get(record.refined as usize) {
                        steps[*refined as usize] += triangles;
                    }
                }
            }
        }
        // Where all are replaced nothing is left.
        let mut source = -steps.iter().sum::<i64>();
        let replaceable = order.iter().take_while(|g| of(g).error.is_finite()).count();
        let mut faces = vec![source.max(0) as u64];
        for step in &steps[..replaceable] {
            source += step;
            faces.push(source.max(0) as u64);
        }
        Self { order, ranks, faces }
    }

    /// Triangles of the cut in which so many groups are replaced.
    pub fn faces(&self, replaced: usize) -> u64 {
        self.faces[replaced]
    }

    /// Loads the pages of all groups but the first so many, where the mesh is in a file: what [`Self::clusters`] and
    /// [`Self::next`] look at.
    pub fn load(&self, dag: &Dag, replaced: usize, proceed: InterruptCheck<'_>) -> Result<()> {
        let groups = self.order[replaced.min(self.order.len())..].iter();
        load_groups(dag, groups.map(|g| &dag.groups[*g as usize]), proceed)
    }

    /// The cuts beside a number of triangles.
    pub fn beside(&self, target: u64) -> Beside {
        // Counts fall, except for rare steps up by a few triangles: take the largest that fits.
        let fits = |i: &usize| self.faces[*i] <= target;
        let best = (0..self.faces.len()).filter(fits).max_by_key(|i| (self.faces[*i], std::cmp::Reverse(*i)));
        let coarse = best.unwrap_or(self.faces.len() - 1);
        Beside { fine: best.and_then(|best| (0..best).rfind(|i| !fits(i))), coarse }
    }

    /// The clusters of the cut in which so many groups are replaced, in page order.
    pub fn clusters(&self, dag: &Dag, replaced: usize) -> Vec<ClusterAddress> {
        let groups = self.order[replaced.min(self.order.len())..].iter().map(|g| &dag.groups[*g as usize]);
        let mut clusters: Vec<_> =
            groups.flat_map(Group::members).filter(|at| self.is_made(dag, *at, replaced)).collect();
        clusters.sort_unstable();
        clusters
    }

    /// Whether a cluster is of the source, or was made from one of the first groups.
    fn is_made(&self, dag: &Dag, at: ClusterAddress, replaced: usize) -> bool {
        self.ranks.get(dag.record(at).refined as usize).is_none_or(|rank| (*rank as usize) < replaced)
    }

    /// The groups that are replaced next and have all of their members in that cut, in order.
    pub fn next<'a>(&'a self, dag: &'a Dag, replaced: usize) -> impl Iterator<Item = &'a Group> {
        let groups = self.order[replaced..].iter().map(|g| &dag.groups[*g as usize]);
        groups.filter(move |group| group.members().all(|at| self.is_made(dag, at, replaced)))
    }

    /// The finest cut of whole groups with at most `target` triangles, or the coarsest there is, in page order.
    pub fn select(&self, dag: &Dag, target: u64) -> Vec<ClusterAddress> {
        self.clusters(dag, self.beside(target).coarse)
    }
}
