//! Taking in a mesh: points, faces, materials, and what all edges and parts cost at first.

use glam::DVec3;

use super::components::Components;
use super::forms::{Channel, Forms, Sums};
use super::queue::Queue;
use super::surface::{NONE, Surface};
use super::wedges::Merge;
use super::{Collapser, Entry, Policy, Worst, bits, sheets};
use crate::build::store::LocalMesh;
use crate::math::Aabb;

/// The first columns of an attribute row hold the normal.
const NORMAL_COLUMNS: usize = 3;

impl Collapser {
    pub(super) fn new(
        mesh: &LocalMesh,
        locked: &[bool],
        mut rows: Vec<f32>,
        weights: &[f32],
        policy: Policy,
    ) -> Self {
        let bounds = Aabb::of_points(&mesh.positions);
        let [min, max] = [bounds.min, bounds.max].map(|p| DVec3::from_array(p.map(f64::from)));
        let extent = Some((max - min).max_element()).filter(|e| *e > 0.0 && e.is_finite()).unwrap_or(1.0);
        let center = Some((min + max) * 0.5).filter(|c| c.is_finite()).unwrap_or(DVec3::ZERO);
        let mut point_of = vec![NONE; mesh.positions.len()];
        let mut places: Vec<[f32; 3]> = Vec::new();
        let mut is_locked = Vec::new();
        for v in 0..mesh.positions.len() {
            let first = mesh.position_ids[v] as usize;
            if point_of[first] == NONE {
                point_of[first] = places.len() as u32;
                places.push(mesh.positions[first]);
                is_locked.push(false);
            }
            point_of[v] = point_of[first];
            is_locked[point_of[v] as usize] |= locked[v];
        }
        let local = |p: &[f32; 3]| (DVec3::from_array(p.map(f64::from)) - center) / extent;
        let mut surface =
            Surface::new(places.iter().map(local).collect(), is_locked, &point_of, &mesh.indices);
        let stride = weights.len();
        let mut copies = Vec::new();
        if policy.cuts
            && let Some(apart) = sheets::take_apart(&surface, mesh.positions.len())
        {
            let Surface { mut positions, mut locked, .. } = surface;
            for (p, q, part) in apart.places {
                let place = positions[p as usize].lerp(positions[q as usize], part);
                let internal = (center + place * extent).as_vec3().to_array();
                let is_copy = part == 0.0;
                places.push(if is_copy { places[p as usize] } else { internal });
                positions.push(if is_copy { positions[p as usize] } else { local(&internal) });
            }
            for (v, w, part) in apart.wedges {
                let row = |w: u32, j: usize| rows[w as usize * stride + j];
                let mixed = |j: usize| row(v, j) + part as f32 * (row(w, j) - row(v, j));
                let new: Vec<f32> = (0..stride).map(mixed).collect();
                rows.extend(new);
                copies.push((v as usize).checked_sub(mesh.positions.len()).map_or(v, |copy| copies[copy]));
            }
            point_of.extend(&apart.points);
            locked.resize(positions.len(), false);
            surface = Surface::new(positions, locked, &point_of, &apart.corners);
        }
        let channels = (0..stride)
            .filter(|k| weights[*k] > 0.0)
            .map(|column| {
                let factor = if column < NORMAL_COLUMNS { policy.normal_weight.sqrt() } else { 1.0 };
                Channel { column, weight: f64::from(weights[column]) * factor }
            })
            .collect();
        let forms = Forms::new(&surface, &rows, stride, point_of.len(), channels, policy);
        let area: f64 = (0..surface.faces.len()).map(|f| forms.plane(f).1).sum();
        let mean = area / surface.faces.len().max(1) as f64;
        Self {
            policy,
            worst: Worst::default(),
            center,
            extent,
            attribute_limit: policy.attribute_limit * policy.attribute_limit * mean * 4.0 / 3f64.sqrt(),
            queue: Queue::default(),
            entries: vec![Entry::default(); surface.edges.len()],
            blocked: vec![false; surface.edges.len()],
            waiting: vec![false; places.len()],
            changed: vec![0; places.len()],
            rank: ranks(mesh, &point_of, places.len()),
            components: if policy.cuts { Components::of(&surface) } else { Components::default() },
            component_queue: Queue::default(),
            rings: Vec::new(),
            copies,
            trace: Vec::new(),
            vertices: mesh.positions.len(),
            drift: vec![0.0; places.len()],
            count: 0,
            taken: places.iter().copied().map(bits).collect(),
            places,
            rows,
            stride,
            merge: Merge::default(),
            sums: Sums::default(),
            ring: Vec::new(),
            pending: Vec::new(),
            surface,
            forms,
        }
    }

    /// Finds what all edges and parts cost.
    pub(super) fn start(&mut self) {
        self.queue.reset(self.surface.edges.len());
        for edge in 0..self.surface.edges.len() as u32 {
            self.update(edge);
        }
        self.component_queue.reset(self.components.all.len());
        (0..self.components.all.len() as u32).for_each(|part| self.queue_component(part));
    }
}

/// See [`Collapser::rank`].
fn ranks(mesh: &LocalMesh, point_of: &[u32], points: usize) -> Vec<u8> {
    if mesh.materials.windows(2).all(|pair| pair[0] == pair[1]) {
        return Vec::new();
    }
    let mut at_points: Vec<(u32, u32)> =
        point_of.iter().copied().zip(mesh.materials.iter().copied()).collect();
    at_points.sort_unstable();
    at_points.dedup();
    let mut ranks = vec![0; points];
    at_points.windows(2).filter(|pair| pair[0].0 == pair[1].0).for_each(|pair| {
        let rank = &mut ranks[pair[0].0 as usize];
        *rank = 2.min(*rank + 1);
    });
    ranks
}
