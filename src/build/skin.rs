//! What acts on which part of a built mesh whose vertices have weights, and how much a step of simplification changes of it:
//! what a bound of the error of any pose is made of. The proof stands in docs/numerics.md.
//!
//! Weights are a floating-point channel with a column for each joint, so that building carries them along.

use std::sync::Arc;

use rayon::prelude::*;

use super::rows::{Rows, VALUE_ROUNDING, Vertices, difference, groups_below, made_from_groups};
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::math::sphere::round_up;
use crate::model::pose::moved_table;
use crate::model::skin::{GroupSkin, Influence, JointBox, Lists, Skin};
use crate::model::{ChannelType, ClusterAddress, Dag, Group, InterruptCheck};

/// Reads the weights of a mesh from a channel, and its pages.
pub fn skin(dag: &Dag, channel: &str, proceed: InterruptCheck<'_>) -> Result<Skin> {
    let Some(channel) = dag.channels.iter().find(|known| known.info.name == channel) else {
        return Err(Error::argument("channel", format!("the mesh has no channel {channel:?}")));
    };
    if channel.info.dtype != ChannelType::Float32 {
        let message = format!("expected weights as float32, found {}", channel.info.dtype.name());
        return Err(Error::argument("channel", message));
    }
    dag.pages.load_all(proceed)?;
    let joints = channel.info.width();
    let mut rows: Vec<Vec<Influence>> = channel.words.load()?.par_chunks(joints).map(influences).collect();
    let vertices = Vertices::of(dag);
    vertices.join(&mut rows);
    let influences: Lists<Influence> = rows.into_iter().collect();
    let skinned = Skinned { dag, positions: &vertices.positions, influences: &influences };
    let addresses: Vec<ClusterAddress> = dag.pages.addresses().collect();
    let parts: Vec<Vec<JointBox>> = addresses.par_iter().map(|at| skinned.joints(*at)).collect();
    let part = |at: ClusterAddress| &parts[dag.pages.dense_index(at)];
    let (made, below) = (made_from_groups(dag), groups_below(dag));
    let steps: Vec<Step> = dag
        .groups
        .par_iter()
        .zip(&made)
        .with_max_len(1)
        .map(|(group, made)| skinned.step(group, made))
        .collect();
    // Finer groups come later: what is below a group is known before it.
    let mut groups: Vec<Vec<JointBox>> = vec![Vec::new(); dag.groups.len()];
    let mut errors = vec![GroupSkin::default(); dag.groups.len()];
    let mut bends = vec![[0f32; 2]; dag.groups.len()];
    for g in (0..dag.groups.len()).rev() {
        let (group, step) = (&dag.groups[g], &steps[g]);
        let mut joints = Vec::new();
        group.members().chain(made[g].iter().copied()).for_each(|at| join_boxes(&mut joints, part(at)));
        let (mut reach, mut deviation, [mut source, mut made_bend]) = (0f32, 0f32, step.bends);
        let edges = group.members().chain(made[g].iter().copied()).map(|at| dag.record(at).max_edge);
        let mut edge = edges.fold(0.0, f32::max);
        for below in below.of(g).iter().map(|below| *below as usize) {
            debug_assert!(below > g, "finer groups come later");
            join_boxes(&mut joints, &groups[below]);
            (reach, deviation) = (reach.max(errors[below].reach), deviation.max(errors[below].deviation));
            (source, made_bend) = (source.max(bends[below][0]), made_bend.max(bends[below][1]));
            edge = edge.max(errors[below].edge);
        }
        groups[g] = joints;
        bends[g] = [source, made_bend];
        errors[g] = GroupSkin {
            reach: round_up(f64::from(reach) + f64::from(step.reach)),
            deviation: round_up(f64::from(deviation) + f64::from(step.deviation)).min(1.0),
            bend: round_up(f64::from(source) + f64::from(made_bend)),
            edge,
        };
    }
    let mut source = Vec::new();
    for at in addresses.iter().filter(|at| dag.record(**at).level == 0) {
        join_boxes(&mut source, part(*at));
    }
    let clusters = parts.iter().map(|boxes| boxes.iter().map(|entry| entry.joint)).collect();
    Ok(Skin {
        joints,
        influences,
        clusters,
        groups: groups.into_iter().collect(),
        below,
        errors,
        source,
        topology: Arc::default(),
        table: moved_table(&dag.pages),
    })
}

/// The influences of a row of weights, which add up to 1. A row without any is that of the first joint.
fn influences(row: &[u32]) -> Vec<Influence> {
    let weights = row.iter().map(|word| f64::from(f32::from_bits(*word)).max(0.0));
    let sum: f64 = weights.clone().sum();
    if sum <= 0.0 {
        return vec![Influence { joint: 0, weight: 1.0 }];
    }
    let parts = (0..).zip(weights).map(|(joint, weight)| Influence { joint, weight: (weight / sum) as f32 });
    parts.filter(|influence| influence.weight > 0.0).collect()
}

/// Adds boxes of joints to others. Both go by joint.
fn join_boxes(to: &mut Vec<JointBox>, boxes: &[JointBox]) {
    for entry in boxes {
        match to.binary_search_by_key(&entry.joint, |known| known.joint) {
            Ok(at) => to[at].bounds = to[at].bounds.union(&entry.bounds),
            Err(at) => to.insert(at, *entry),
        }
    }
}

/// A mesh with weights.
struct Skinned<'a> {
    dag: &'a Dag,
    positions: &'a [[f32; 3]],
    influences: &'a Lists<Influence>,
}

/// What a step of simplification adds: see [`GroupSkin`].
struct Step {
    reach: f32,
    deviation: f32,
    /// Of members that are of the source, and of what was made.
    bends: [f32; 2],
}

impl Skinned<'_> {
    /// The joints that act on a cluster.
    fn joints(&self, at: ClusterAddress) -> Vec<JointBox> {
        let mut boxes = Vec::new();
        for id in self.dag.pages.geometry(at).ids.iter() {
            let bounds = Aabb::of_points([&self.positions[id as usize]]);
            for influence in self.influences.of(id as usize) {
                join_boxes(&mut boxes, &[JointBox { joint: influence.joint, bounds }]);
            }
        }
        boxes
    }

    /// The largest product of half the difference of weights along an edge of a cluster and its length.
    fn bend(&self, at: ClusterAddress) -> f32 {
        let geometry = self.dag.pages.geometry(at);
        let ids: Vec<usize> = geometry.ids.iter().map(|id| id as usize).collect();
        let mut most = 0f64;
        for triangle in geometry.triangles.iter() {
            let corners = triangle.map(|v| ids[usize::from(v)]);
            for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a], corners[b])) {
                let length = (0..3)
                    .map(|k| (f64::from(self.positions[a][k]) - f64::from(self.positions[b][k])).powi(2));
                let apart = 0.5 * difference(self.influences.of(a), self.influences.of(b));
                most = most.max(apart * length.sum::<f64>().sqrt());
            }
        }
        round_up(most * (1.0 + VALUE_ROUNDING))
    }

    fn step(&self, group: &Group, made: &[ClusterAddress]) -> Step {
        let members: Vec<ClusterAddress> = group.members().collect();
        let of_source = members.iter().filter(|at| self.dag.record(**at).level == 0);
        let largest = |bends: &mut dyn Iterator<Item = f32>| bends.fold(0.0, f32::max);
        let bends = [
            largest(&mut of_source.map(|at| self.bend(*at))),
            largest(&mut made.iter().map(|at| self.bend(*at))),
        ];
        if made.is_empty() {
            return Step { reach: 0.0, deviation: 0.0, bends };
        }
        let rows = Rows { dag: self.dag, positions: self.positions, rows: self.influences };
        let (step, joints) = rows.step(group, made);
        // Half of a sum is at most half the root of the number of terms times the root of the sum of their squares.
        let count = joints as f64;
        let deviation = if joints < 2 {
            0.0
        } else {
            0.5 * count.sqrt() * step.deviation * (1.0 + VALUE_ROUNDING) + count * VALUE_ROUNDING
        };
        Step { reach: round_up(step.reach), deviation: round_up(deviation.min(1.0)), bends }
    }
}
