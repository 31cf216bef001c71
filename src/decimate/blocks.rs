//! Blocks of the mesh: dividing space, extracting a block as a mesh of its own, sampling the cost of collapses, and
//! writing simplified blocks back.

use rayon::prelude::*;

use super::{NEW, Rounds};
use crate::build::collapse::Limit;
use crate::build::dag::merged;
use crate::build::simplify::trace;
use crate::build::store::{LocalMesh, Numbering};
use crate::math::median::{Place, median_split};
use crate::mesh::hash;

/// Triangles of a sample, and the part of its mean target that it collapses to.
const SAMPLE: usize = 1 << 10;
const SAMPLED: f64 = 0.25;
/// Samples of all blocks together.
const LEAST_SAMPLES: usize = 24;

/// Collapses of some triangles of a block.
struct Sample {
    /// Positions that may move.
    free: usize,
    triangles: usize,
    /// See [`trace`].
    trace: Vec<(f64, u32)>,
}

impl Rounds<'_> {
    /// For each position, by the first vertex there, whether it is locked: several blocks have it, or it stays
    /// anyway.
    pub fn shared(&self, blocks: &[&mut [Place]]) -> Vec<bool> {
        let whole = &self.whole;
        let mut owner = vec![u32::MAX; whole.ids.len()];
        let mut shared = whole.locked.clone();
        for (block, places) in (0..).zip(blocks) {
            for place in places.iter() {
                for v in &whole.indices[3 * place.number as usize..][..3] {
                    let position = whole.position_ids[*v as usize] as usize;
                    if owner[position] == u32::MAX {
                        owner[position] = block;
                    } else if owner[position] != block {
                        shared[position] = true;
                    }
                }
            }
        }
        shared
    }

    /// Some triangles as a mesh of their own, whose `ids` are vertices of the whole.
    pub fn part(&self, triangles: &[Place], locked: impl Fn(u32) -> bool) -> LocalMesh {
        let whole = &self.whole;
        let [mut numbering, mut at_position] = [0; 2].map(|_| Numbering::with_room(triangles.len()));
        let mut local = LocalMesh::default();
        let mut first = Vec::new();
        for place in triangles {
            for v in &whole.indices[3 * place.number as usize..][..3] {
                let (number, new) = numbering.number(*v);
                local.indices.push(number);
                if !new {
                    continue;
                }
                let position = whole.position_ids[*v as usize];
                let (p, new) = at_position.number(position);
                if new {
                    first.push(number);
                }
                local.ids.push(*v);
                local.position_ids.push(first[p as usize]);
                local.locked.push(locked(position));
            }
        }
        let vertices = || local.ids.iter().map(|v| *v as usize);
        local.positions = vertices().map(|v| whole.positions[v]).collect();
        local.attributes.reserve(local.ids.len() * self.stride);
        for v in local.ids.iter().map(|v| *v as usize) {
            local.attributes.extend_from_slice(&whole.attributes[v * self.stride..][..self.stride]);
        }
        if !whole.materials.is_empty() {
            local.materials = local.ids.iter().map(|v| whole.materials[*v as usize]).collect();
        }
        if !whole.labels.is_empty() {
            local.labels = local.ids.iter().map(|v| whole.labels[*v as usize]).collect();
        }
        local
    }

    /// The cost up to which samples of the blocks collapse to keep `part` of their free vertices.
    pub fn cost(&self, blocks: &mut [&mut [Place]], ratio: f64) -> f64 {
        let whole = &self.whole;
        let mut uses = vec![0u32; whole.ids.len()];
        whole.indices.iter().for_each(|v| uses[whole.position_ids[*v as usize] as usize] += 1);
        let each = LEAST_SAMPLES.div_ceil(blocks.len());
        let samples: Vec<Sample> = blocks
            .par_iter_mut()
            .enumerate()
            .with_max_len(1)
            .flat_map_iter(|(number, block)| {
                let sample = |turn| self.sample(block, number ^ turn, &uses, ratio);
                (0..each).map(sample).collect::<Vec<_>>()
            })
            .collect();
        let free: usize = samples.iter().map(|sample| sample.free).sum();
        // A collapse takes a vertex and two triangles.
        let mut gone = (2.0 * free as f64 * (1.0 - ratio)) as i64;
        let traces = samples.iter().map(|sample| (sample.triangles, &sample.trace[..]));
        for (cost, triangles) in merged(traces) {
            gone -= i64::from(triangles);
            if gone <= 0 {
                return cost;
            }
        }
        f64::INFINITY
    }

    /// Collapses a few triangles of a block that lie together; `uses` has the corners at each position.
    fn sample(&self, block: &mut [Place], number: usize, uses: &[u32], ratio: f64) -> Sample {
        let (mut places, mut turns) = (block, number);
        while places.len() > SAMPLE {
            let middle = places.len() / 2;
            let (low, high) = median_split(places, middle);
            places = if turns % 2 == 0 { low } else { high };
            turns /= 2;
        }
        let mut local = self.part(places, |_| false);
        let mut inside = vec![0; local.ids.len()];
        local.indices.iter().for_each(|v| inside[local.position_ids[*v as usize] as usize] += 1);
        let mut free = 0;
        for v in 0..local.ids.len() {
            let position = self.whole.position_ids[local.ids[v] as usize] as usize;
            let first = local.position_ids[v] as usize;
            local.locked[v] = self.whole.locked[position] || inside[first] != uses[position];
            free += usize::from(first == v && !local.locked[v]);
        }
        let triangles = places.len();
        let limit = Limit::triangles((SAMPLED * ratio * triangles as f64) as usize);
        Sample { free, triangles, trace: trace(&local, limit, &self.content, &self.options) }
    }

    /// Writes a simplified block back.
    pub fn take_in(&mut self, part: &LocalMesh, moved: &[bool], indices: &mut Vec<u32>) {
        let (whole, stride) = (&mut self.whole, self.stride);
        let known = part.ids.len() - part.copies.len();
        let mut number = part.ids.clone();
        let mut used = vec![false; part.ids.len()];
        part.indices.iter().for_each(|v| used[*v as usize] = true);
        for v in (0..part.ids.len()).filter(|v| used[*v]) {
            let row = &part.attributes[v * stride..][..stride];
            if v >= known {
                let of = whole.ids[part.ids[v] as usize];
                number[v] = whole.ids.len() as u32;
                whole.ids.push(if moved[v] { NEW } else { of });
                whole.positions.push(part.positions[v]);
                whole.attributes.extend_from_slice(row);
                whole.labels.extend(part.labels.get(v));
                whole.materials.extend(part.materials.get(v));
                whole.locked.push(false);
            } else if moved[v] {
                // No other block has it: shared vertices are locked.
                let at = number[v] as usize;
                whole.ids[at] = NEW;
                whole.positions[at] = part.positions[v];
                whole.attributes[at * stride..][..stride].copy_from_slice(row);
                if let Some(label) = part.labels.get(v) {
                    whole.labels[at] = *label;
                }
            }
        }
        indices.extend(part.indices.iter().map(|v| number[*v as usize]));
    }
}

/// Divides points, at `middle` of each part, until blocks have at most `size`.
pub fn split(places: &mut [Place], size: usize, middle: f64) -> Vec<&mut [Place]> {
    if places.len() <= size {
        return vec![places];
    }
    let at = (places.len() as f64 * middle) as usize;
    let (a, b) = median_split(places, at);
    let (mut blocks, mut right) = rayon::join(|| split(a, size, middle), || split(b, size, middle));
    blocks.append(&mut right);
    blocks
}

/// The part of a mesh that its triangles use, in their order.
pub fn compact(mesh: &LocalMesh, stride: usize) -> LocalMesh {
    let mut number = vec![u32::MAX; mesh.ids.len()];
    let mut order = Vec::new();
    let mut indices = Vec::with_capacity(mesh.indices.len());
    for v in &mesh.indices {
        let number = &mut number[*v as usize];
        if *number == u32::MAX {
            *number = order.len() as u32;
            order.push(*v as usize);
        }
        indices.push(*number);
    }
    fn pick<T: Copy>(values: &[T], order: &[usize]) -> Vec<T> {
        if values.is_empty() { Vec::new() } else { order.iter().map(|v| values[*v]).collect() }
    }
    let positions = pick(&mesh.positions, &order);
    LocalMesh {
        ids: pick(&mesh.ids, &order),
        attributes: order.iter().flat_map(|v| &mesh.attributes[v * stride..][..stride]).copied().collect(),
        labels: pick(&mesh.labels, &order),
        position_ids: hash::first_equal(bytemuck::cast_slice(&positions), 3),
        materials: pick(&mesh.materials, &order),
        locked: pick(&mesh.locked, &order),
        indices,
        copies: Vec::new(),
        positions,
    }
}
