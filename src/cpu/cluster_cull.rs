//! Stage 3. Clusters of candidate groups → clusters to draw, in scene order: the second half of the rule of
//! the cut, the picture's bounds, the depth pyramid and the backface cone. Each survivor goes to the small or
//! the large rasterizer.

use rayon::prelude::*;

use super::node_cull::CandidateGroup;
use crate::limits::{MAX_SPAN, SMALL_EDGE};
use crate::model::rule::Threshold;
use crate::views::{Footprint, InstanceView, Occluder, Screen, Visible};

/// Groups per task.
const GROUPS_PER_TASK: usize = 8;

/// A cluster to draw. Candidates compare by scene order: by instance, then by cluster address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CandidateCluster {
    /// The cluster and its instance.
    pub visible: Visible,
    /// Where it lies.
    pub footprint: Footprint,
    /// For the large rasterizer.
    pub large: bool,
    /// Number of triangles.
    pub triangles: u8,
}

impl CandidateCluster {
    /// Whether it is blended with what is behind it.
    pub fn is_blended(&self, views: &[InstanceView]) -> bool {
        views[self.visible.instance as usize].is_blended(self.visible.cluster)
    }
}

/// What culling clusters found and cost.
#[derive(Debug, Default)]
pub struct Culled {
    /// Survivors, in scene order.
    pub candidates: Vec<CandidateCluster>,
    /// Clusters looked at.
    pub visited: u64,
}

/// Culls the clusters of `groups`.
pub fn run(
    groups: &[CandidateGroup],
    views: &[InstanceView],
    screen: &Screen,
    tau: f32,
    hzb: Option<&impl Occluder>,
) -> Culled {
    let parts: Vec<Culled> = groups
        .par_chunks(GROUPS_PER_TASK)
        .map(|chunk| {
            let mut out = Culled::default();
            for &group in chunk {
                cull_group(group, views, screen, tau, hzb, &mut out);
            }
            out
        })
        .collect();
    let mut all = Culled::default();
    for mut part in parts {
        all.candidates.append(&mut part.candidates);
        all.visited += part.visited;
    }
    all
}

fn cull_group(
    at: CandidateGroup,
    views: &[InstanceView],
    screen: &Screen,
    tau: f32,
    hzb: Option<&impl Occluder>,
    out: &mut Culled,
) {
    let instance = &views[at.instance as usize];
    let threshold = Threshold::View(instance.lod, tau);
    for cluster in instance.mesh.groups[at.group as usize].members() {
        out.visited += 1;
        let record = instance.pages.record(cluster);
        let (sphere, error) = instance.mesh.own_error(record);
        // What it was made from is drawn instead, where that is there.
        if threshold.exceeded_by(&sphere, error) && instance.pages.holds(record.refined_page as usize) {
            continue;
        }
        let bounds = instance.cluster_bounds(cluster);
        let Some(footprint) = instance.footprint(screen, bounds.sphere.center, bounds.extent) else {
            continue;
        };
        if !instance.double_sided(record.material) && instance.faces_away(screen.orthographic, &bounds) {
            continue;
        }
        if hzb.is_some_and(|h| h.hides(&footprint)) {
            continue;
        }
        // A patch of n triangles has some √(n/2) edges across.
        let edge = f32::from(footprint.span) / (f32::from(record.triangle_count) * 0.5).sqrt().max(1.0);
        // Alpha-tested ones are drawn in one form.
        let alpha_tested = instance.materials.alpha_tested(record.material);
        let is_stroke = instance.stroke.is_some();
        let large = !is_stroke
            && (alpha_tested || footprint.clipped || footprint.span > MAX_SPAN || edge > SMALL_EDGE);
        let visible = Visible { instance: at.instance, cluster };
        out.candidates.push(CandidateCluster { visible, footprint, large, triangles: record.triangle_count });
    }
}

/// A later round, over clusters that passed every other test: keeps those that the depth pyramid does not hide.
pub fn unhidden(candidates: &[CandidateCluster], hzb: &impl Occluder) -> Vec<CandidateCluster> {
    candidates.iter().filter(|c| !hzb.hides(&c.footprint)).copied().collect()
}
