//! What acts on which part of a built mesh whose vertices have weights, and how much a step of simplification changes of it:
//! what a bound of the error of any pose is made of. The proof stands in docs/numerics.md.
//!
//! Weights are a floating-point channel with a column for each joint, so that building carries them along.

use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::attribute_error::deviation_in;
use super::content::Content;
use super::simplify::mean_edge;
use super::store::{LocalMesh, Numbering};
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::math::sphere::round_up;
use crate::mesh::hash;
use crate::model::skin::{GroupSkin, Influence, JointBox, Lists, Skin, moved_table};
use crate::model::{ChannelType, ClusterAddress, Dag, Group, InterruptCheck};

/// Rounding of weights to f32, and of the sums of a row: for each joint of a group.
const WEIGHT_ROUNDING: f64 = 1.0 / (1u64 << 22) as f64;

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
    let mut made: Vec<Vec<ClusterAddress>> = vec![Vec::new(); dag.groups.len()];
    for at in &addresses {
        if let Some(made) = made.get_mut(dag.record(*at).refined as usize) {
            made.push(*at);
        }
    }
    let below: Lists<u32> = dag
        .groups
        .iter()
        .map(|group| {
            let mut below: Vec<u32> = group.members().map(|at| dag.record(at).refined).collect();
            below.sort_unstable();
            below.dedup();
            below.retain(|group| (*group as usize) < dag.groups.len());
            below
        })
        .collect();
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

/// The sum of the differences of two rows.
fn difference(a: &[Influence], b: &[Influence]) -> f64 {
    let (mut i, mut j, mut sum) = (0, 0, 0.0);
    while i < a.len() || j < b.len() {
        let joint = |row: &[Influence], at: usize| row.get(at).map_or(u32::MAX, |influence| influence.joint);
        let (left, right) = (joint(a, i), joint(b, j));
        let weight = |row: &[Influence], at: usize| f64::from(row[at].weight);
        if left == right {
            sum += (weight(a, i) - weight(b, j)).abs();
            (i, j) = (i + 1, j + 1);
        } else if left < right {
            sum += weight(a, i);
            i += 1;
        } else {
            sum += weight(b, j);
            j += 1;
        }
    }
    sum
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

/// Where identities are.
struct Vertices {
    positions: Vec<[f32; 3]>,
    /// Whether the source has them.
    source: Vec<bool>,
}

impl Vertices {
    fn of(dag: &Dag) -> Self {
        let count = dag.vertex_count as usize;
        let (mut positions, mut source) = (vec![[f32::NAN; 3]; count], vec![false; count]);
        for at in dag.pages.addresses() {
            let (geometry, level) = (dag.pages.geometry(at), dag.record(at).level);
            for (id, position) in geometry.ids.iter().zip(geometry.positions.iter()) {
                positions[id as usize] = position;
                source[id as usize] |= level == 0;
            }
        }
        Self { positions, source }
    }

    /// Lets identities that building made at one place, such as those of a seam, have the same weights, so that no pose opens
    /// them: the nearest of those that the source has there, or their mean.
    fn join(&self, rows: &mut [Vec<Influence>]) {
        let first = hash::first_equal(bytemuck::cast_slice(&self.positions), 3);
        let mut places: FxHashMap<u32, Vec<usize>> = FxHashMap::default();
        for (id, first) in first.iter().enumerate().filter(|(id, first)| *id != **first as usize) {
            places.entry(*first).or_insert_with(|| vec![*first as usize]).push(id);
        }
        for ids in places.values().filter(|ids| !self.positions[ids[0]][0].is_nan()) {
            let (of_source, made): (Vec<usize>, Vec<usize>) = ids.iter().partition(|id| self.source[**id]);
            if of_source.is_empty() {
                let mean = mean(made.iter().map(|id| &rows[*id][..]));
                made.iter().for_each(|id| rows[*id].clone_from(&mean));
                continue;
            }
            for id in made {
                let far = |other: &usize| difference(&rows[*other], &rows[id]);
                let nearest = of_source.iter().copied().min_by(|a, b| far(a).total_cmp(&far(b)));
                if let Some(nearest) = nearest {
                    rows[id] = rows[nearest].clone();
                }
            }
        }
    }
}

/// The mean of rows.
fn mean<'a>(rows: impl ExactSizeIterator<Item = &'a [Influence]>) -> Vec<Influence> {
    let part = 1.0 / rows.len().max(1) as f64;
    let mut sums: Vec<(u32, f64)> = Vec::new();
    for influence in rows.flatten() {
        let weight = f64::from(influence.weight) * part;
        match sums.binary_search_by_key(&influence.joint, |(joint, _)| *joint) {
            Ok(at) => sums[at].1 += weight,
            Err(at) => sums.insert(at, (influence.joint, weight)),
        }
    }
    sums.into_iter().map(|(joint, weight)| Influence { joint, weight: weight as f32 }).collect()
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
        round_up(most * (1.0 + WEIGHT_ROUNDING))
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
        let mut joints: Vec<u32> = Vec::new();
        for at in members.iter().chain(made) {
            let ids = self.dag.pages.geometry(*at).ids;
            joints.extend(ids.iter().flat_map(|id| self.influences.of(id as usize)).map(|entry| entry.joint));
            joints.sort_unstable();
            joints.dedup();
        }
        let [before, after] = [&members[..], made].map(|clusters| self.local(clusters, &joints));
        // Both of the steps' surfaces are so near to the source, so that no more is left than what weights deviate.
        let below =
            members.iter().filter_map(|at| self.dag.groups.get(self.dag.record(*at).refined as usize));
        let near = below.map(Group::distance).fold(0.0, f32::max);
        let free = round_up(f64::from(group.distance()) + f64::from(near));
        let unit = f64::from(mean_edge(&before));
        let content = Content::of_weights(joints.len());
        let apart = f64::from(deviation_in(&before, &after, &content, free, unit));
        // Half of a sum is at most half the root of the number of terms times the root of the sum of their squares.
        let count = joints.len() as f64;
        let deviation = if joints.len() < 2 {
            0.0
        } else if apart < unit {
            0.5 * count.sqrt() * apart / unit * (1.0 + WEIGHT_ROUNDING) + count * WEIGHT_ROUNDING
        } else {
            1.0
        };
        let reach = round_up(f64::from(free) + apart);
        Step { reach, deviation: round_up(deviation.min(1.0)), bends }
    }

    /// Clusters as one mesh, with the weights of these joints.
    fn local(&self, clusters: &[ClusterAddress], joints: &[u32]) -> LocalMesh {
        let vertices = clusters.iter().map(|at| usize::from(self.dag.record(*at).vertex_count)).sum();
        let mut numbering = Numbering::with_room(vertices);
        let mut local = LocalMesh::default();
        for at in clusters {
            let geometry = self.dag.pages.geometry(*at);
            let numbers: Vec<u32> = geometry
                .ids
                .iter()
                .map(|id| {
                    let (number, new) = numbering.number(id);
                    if new {
                        local.ids.push(id);
                    }
                    number
                })
                .collect();
            local.indices.extend(geometry.triangles.iter().flatten().map(|v| numbers[usize::from(v)]));
        }
        local.positions = local.ids.iter().map(|id| self.positions[*id as usize]).collect();
        local.attributes = vec![0.0; local.ids.len() * joints.len()];
        for (row, id) in local.attributes.chunks_exact_mut(joints.len()).zip(&local.ids) {
            for influence in self.influences.of(*id as usize) {
                if let Ok(column) = joints.binary_search(&influence.joint) {
                    row[column] = influence.weight;
                }
            }
        }
        local
    }
}
