//! Rows of values by vertex identity that move vertices, such as weights of joints: the same at the same place, and how much a
//! step of simplification changes them.

use rustc_hash::FxHashMap;

use super::attribute_error::deviation_in;
use super::content::Content;
use super::simplify::mean_edge;
use super::store::{LocalMesh, Numbering};
use crate::math::sphere::round_up;
use crate::mesh::hash;
use crate::model::skin::{Influence, Lists};
use crate::model::{ClusterAddress, Dag, Group};

/// Rounding of values to f32, and of the sums of a row: for each column.
pub const VALUE_ROUNDING: f64 = 1.0 / (1u64 << 22) as f64;

/// The sum of the differences of two rows.
pub fn difference(a: &[Influence], b: &[Influence]) -> f64 {
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

/// Where identities are.
pub struct Vertices {
    /// By identity; NaN where no cluster has it.
    pub positions: Vec<[f32; 3]>,
    /// Whether the source has them.
    source: Vec<bool>,
}

impl Vertices {
    /// Those of a mesh whose pages are in memory.
    pub fn of(dag: &Dag) -> Self {
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

    /// Lets identities that building made at one place, such as those of a seam, have the same row, so that nothing that moves
    /// them opens them: the nearest of those that the source has there, or their mean.
    pub fn join(&self, rows: &mut [Vec<Influence>]) {
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

/// For each group those that its members were made from.
pub fn groups_below(dag: &Dag) -> Lists<u32> {
    let below = |group: &Group| {
        let mut below: Vec<u32> = group.members().map(|at| dag.record(at).refined).collect();
        below.sort_unstable();
        below.dedup();
        below.retain(|group| (*group as usize) < dag.groups.len());
        below
    };
    dag.groups.iter().map(below).collect()
}

/// The clusters that were made from each group.
pub fn made_from_groups(dag: &Dag) -> Vec<Vec<ClusterAddress>> {
    let mut made: Vec<Vec<ClusterAddress>> = vec![Vec::new(); dag.groups.len()];
    for at in dag.pages.addresses() {
        if let Some(made) = made.get_mut(dag.record(at).refined as usize) {
            made.push(at);
        }
    }
    made
}

/// How far what was made from a group deviates from its members.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// Each point of one has a point of the other no farther off than this, whose values deviate no more than by `deviation`.
    pub reach: f64,
    /// The root of the sum of the squares of the differences; infinite where nothing is known.
    pub deviation: f64,
}

/// A mesh with rows.
pub struct Rows<'a> {
    /// The mesh, with its pages in memory.
    pub dag: &'a Dag,
    /// Where identities are.
    pub positions: &'a [[f32; 3]],
    /// Columns and values of each identity.
    pub rows: &'a Lists<Influence>,
}

impl Rows<'_> {
    /// The columns that clusters have.
    fn columns<'a>(&self, clusters: impl Iterator<Item = &'a ClusterAddress>) -> Vec<u32> {
        let mut columns: Vec<u32> = Vec::new();
        for at in clusters {
            let ids = self.dag.pages.geometry(*at).ids;
            columns.extend(ids.iter().flat_map(|id| self.rows.of(id as usize)).map(|entry| entry.joint));
            columns.sort_unstable();
            columns.dedup();
        }
        columns
    }

    /// A step of simplification, and how many columns it looked at.
    pub fn step(&self, group: &Group, made: &[ClusterAddress]) -> (Step, usize) {
        let members: Vec<ClusterAddress> = group.members().collect();
        let columns = self.columns(members.iter().chain(made));
        // Both of the steps' surfaces are so near to the source, so that no more is left than what values deviate.
        let below =
            members.iter().filter_map(|at| self.dag.groups.get(self.dag.record(*at).refined as usize));
        let near = below.map(Group::distance).fold(0.0, f32::max);
        let free = round_up(f64::from(group.distance()) + f64::from(near));
        if columns.is_empty() {
            return (Step { reach: f64::from(free), deviation: 0.0 }, 0);
        }
        let [before, after] = [&members[..], made].map(|clusters| self.local(clusters, &columns));
        let unit = f64::from(mean_edge(&before));
        let content = Content::of_weights(columns.len());
        let apart = f64::from(deviation_in(&before, &after, &content, free, unit));
        let deviation = if apart < unit { apart / unit } else { f64::INFINITY };
        (Step { reach: f64::from(free) + apart, deviation }, columns.len())
    }

    /// Clusters as one mesh, with the values of these columns.
    fn local(&self, clusters: &[ClusterAddress], columns: &[u32]) -> LocalMesh {
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
        local.attributes = vec![0.0; local.ids.len() * columns.len()];
        for (row, id) in local.attributes.chunks_exact_mut(columns.len()).zip(&local.ids) {
            for influence in self.rows.of(*id as usize) {
                if let Ok(column) = columns.binary_search(&influence.joint) {
                    row[column] = influence.weight;
                }
            }
        }
        local
    }
}
