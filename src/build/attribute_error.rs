//! How far what a surface carries changes in a step of simplification, as a length.
//!
//! An attribute that deviates by one unit counts as its weight times an edge length, since what is wrong at a point is
//! wrong over about an edge: the mean one of the group's input, or that of the triangle compared with, if that is
//! longer. No attribute counts more than one unit. A label or a material is wrong by the distance to where it is right,
//! if that is less. Along the DAG steps add up.
//!
//! Measured at the vertices of both surfaces, and beside the lines between labels, each against the other surface at its nearest point. Where another
//! triangle around that point fits better, as beside a seam, the way there counts instead: so a seam, or a line
//! between colours, is off by how far it moved and not by how much it divides.

use super::content::Content;
use super::field::{Field, Place};
use super::simplify::mean_edge;
use super::store::LocalMesh;

/// The deviation of `after`, made from `before`, in the unit of the positions.
pub fn step_deviation(before: &LocalMesh, after: &LocalMesh, content: &Content) -> f32 {
    let differ = |values: &[u32]| values.windows(2).any(|pair| pair[0] != pair[1]);
    let (labels, materials) = (differ(&before.labels), differ(&before.materials));
    if !(content.is_measured() || labels && content.label_weight > 0.0 || materials) {
        return 0.0;
    }
    let edge = mean_edge(before);
    let mut used = vec![false; after.positions.len()];
    after.indices.iter().for_each(|v| used[*v as usize] = true);
    let stride = content.stride();
    let row = |v: usize| v * stride..(v + 1) * stride;
    let same = |v: usize| {
        before.positions[v] == after.positions[v]
            && before.attributes[row(v)] == after.attributes[row(v)]
            && before.labels.get(v) == after.labels.get(v)
    };
    let mut most = 0.0;
    for (probes, surface) in [(before, after), (after, before)] {
        let field = Field::new(surface, content);
        let mut near = 0;
        let mut look = |v: usize, p: [f32; 3], known: &[f32]| {
            let cost = |place: &Place, farther: f32| {
                if materials && field.material(place) != probes.materials[v] {
                    return f32::INFINITY;
                }
                let edge = edge.max(field.edge(place));
                let deviation = edge * content.deviation(known, field.rows(place), place.at);
                let label = if labels { way_to_label(&field, place, p, probes.labels[v]) } else { 0.0 };
                farther.max(deviation).max(label.min(content.label_weight * edge))
            };
            let (_, deviation) = field.best_place(p, &mut near, most, cost);
            // Nothing of its material is near: as wrong as can be.
            most = f32::max(most, if deviation.is_finite() { deviation } else { edge });
        };
        for v in 0..used.len() {
            // What stays as it is lies on both surfaces.
            let stays = if std::ptr::eq(probes, before) {
                before.locked[v] || used[v] && same(v)
            } else {
                !used[v] || same(v)
            };
            if !stays {
                look(v, probes.positions[v], &probes.attributes[row(v)]);
            }
        }
        if labels {
            lines_between_labels(probes).for_each(|(v, p)| look(v, p, &[]));
        }
    }
    most
}

/// Part of an edge at which the line between its labels is looked for: a little before its middle.
const BESIDE_LINE: f32 = 7.0 / 16.0;

/// Points on either side of the lines between labels, each with a vertex of its label.
fn lines_between_labels(mesh: &LocalMesh) -> impl Iterator<Item = (usize, [f32; 3])> {
    let edges = mesh.indices.chunks_exact(3).flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
    let both = edges.flat_map(|(v, w)| [(v as usize, w as usize), (w as usize, v as usize)]);
    both.filter(|(v, w)| mesh.labels[*v] != mesh.labels[*w]).map(|(v, w)| {
        let (p, q) = (mesh.positions[v], mesh.positions[w]);
        (v, [0, 1, 2].map(|k| p[k] + BESIDE_LINE * (q[k] - p[k])))
    })
}

/// How much farther from `p` than a place the nearest one on the same triangle is that has a label; infinite where
/// there is none.
fn way_to_label(field: &Field<'_>, place: &Place, p: [f32; 3], label: u32) -> f32 {
    if field.label(place) == label {
        return 0.0;
    }
    let Some(q) = field.towards_label(place, label) else { return f32::INFINITY };
    let distance = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt();
    (distance - place.distance).max(0.0)
}
