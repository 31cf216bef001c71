//! The metric of attribute rows: which columns belong together, their weights, and the distance between two rows.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use super::dag::BuildCluster;
use super::source_labels::SourceLabels;
use super::store::VertexStore;
use crate::config::BuildOptions;
use crate::mesh::WeldedMesh;
use crate::model::{AttributeLayout, ChannelInfo, Weights};

/// Columns that one attribute takes.
#[derive(Clone, Debug)]
pub struct Block {
    columns: Range<usize>,
    /// A unit of it in mean edge lengths.
    weight: f32,
    /// Unit vectors: what is interpolated between them is made one again.
    unit: bool,
    /// Its deviation is part of the error.
    measured: bool,
}

/// The weights of the options.
pub fn weights(options: &BuildOptions) -> Weights {
    Weights {
        normal: options.normal_weight,
        color: options.color_weight,
        uv: options.uv_weight,
        channel: options.channel_weight,
    }
}

/// What a mesh carries besides its shape.
#[derive(Clone, Debug)]
pub struct Content {
    blocks: Vec<Block>,
    /// Weight of a label that is another one; zero when there are no labels.
    pub label_weight: f32,
    /// Whether there are several materials.
    materials: bool,
    /// The direction over which the source is a graph, if there is one: all faces of all levels face it.
    pub up: Option<DVec3>,
    /// The labels of the source, where it has any and is known.
    pub source_labels: Option<Arc<SourceLabels>>,
}

impl Content {
    /// The content of a mesh, weighed by the options. Normals come first, then colours, UV sets and the
    /// floating-point channels. Computed normals follow from the shape: they steer, but are not
    /// measured.
    pub fn new(mesh: &WeldedMesh, computed_normals: bool, options: &BuildOptions) -> Self {
        let content = Self::of(mesh.layout, &mesh.channels.infos, computed_normals, &weights(options));
        debug_assert_eq!(content.stride(), mesh.stride);
        content.over(&mesh.positions, &mesh.faces)
    }

    /// The same over other faces.
    #[must_use]
    pub fn over(self, positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Self {
        Self { up: up(positions, faces), ..self }
    }

    /// The same from what a finished mesh says of itself.
    pub fn of(
        layout: AttributeLayout,
        channels: &[ChannelInfo],
        computed_normals: bool,
        weights: &Weights,
    ) -> Self {
        let mut blocks = Vec::new();
        let mut at = 0;
        let mut add = |width: usize, weight: f32, unit: bool| {
            let measured = weight > 0.0 && !(unit && computed_normals);
            blocks.push(Block { columns: at..at + width, weight, unit, measured });
            at += width;
        };
        add(3, weights.normal, true);
        if layout.colors.is_some() {
            add(4, weights.color, false);
        }
        (0..layout.uv_sets).for_each(|_| add(2, weights.uv, false));
        let floats = channels.iter().filter(|info| !info.dtype.is_label());
        floats.for_each(|info| add(info.width(), weights.channel, false));
        let has_labels = channels.iter().any(|info| info.dtype.is_label());
        Self {
            blocks,
            label_weight: if has_labels { weights.channel } else { 0.0 },
            materials: layout.materials,
            up: None,
            source_labels: None,
        }
    }

    /// The same where images have what normals and texture coordinates say: these are carried along, and count nothing.
    #[must_use]
    pub fn unmeasured(&self, coordinates: &Range<usize>) -> Self {
        let mut out = self.clone();
        let is_shown = |block: &Block| block.unit || coordinates.contains(&block.columns.start);
        for block in out.blocks.iter_mut().filter(|block| is_shown(block)) {
            block.measured = false;
        }
        out
    }

    /// Keeps the labels of the surface that levels grow over, where there are any.
    pub fn set_source(&mut self, store: &VertexStore, clusters: &[BuildCluster]) {
        if self.label_weight > 0.0 {
            self.source_labels = Some(Arc::new(SourceLabels::new(store, clusters)));
        }
    }

    /// Rows of weights of joints and nothing else, of which a unit counts an edge.
    pub fn of_weights(joints: usize) -> Self {
        Self {
            blocks: vec![Block { columns: 0..joints, weight: 1.0, unit: false, measured: true }],
            label_weight: 0.0,
            materials: false,
            up: None,
            source_labels: None,
        }
    }

    /// Floats per row.
    pub fn stride(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.columns.end)
    }

    /// The weight of each column, in mean edge lengths.
    pub fn weights(&self) -> impl Iterator<Item = f32> {
        self.blocks.iter().flat_map(|block| std::iter::repeat_n(block.weight, block.columns.len()))
    }

    /// Whether a mesh carries nothing but its shape, one material, and normals that follow from it.
    pub fn is_bare(&self) -> bool {
        !self.is_measured() && self.label_weight == 0.0 && !self.materials
    }

    /// Whether normals came with the mesh, and so say what the shape does not.
    pub fn has_own_normals(&self) -> bool {
        self.blocks.first().is_some_and(|block| block.measured)
    }

    /// Whether deviations of the rows are part of the error.
    pub fn is_measured(&self) -> bool {
        self.blocks.iter().any(|block| block.measured)
    }

    /// How far `row` is, in its first columns, from a mean of rows, in mean edge lengths: the largest of all
    /// attributes, each of which counts one unit at most.
    pub fn deviation(&self, row: &[f32], rows: [&[f32]; 3], at: [f32; 3]) -> f32 {
        let of_block = |block: &Block| {
            let mean = |k: usize| (0..3).map(|c| at[c] * rows[c][k]).sum::<f32>();
            let scale = if block.unit {
                let size = block.columns.clone().map(|k| mean(k) * mean(k)).sum::<f32>().sqrt();
                if size > 0.0 { size.recip() } else { 1.0 }
            } else {
                1.0
            };
            let squared: f32 = block.columns.clone().map(|k| (mean(k) * scale - row[k]).powi(2)).sum();
            block.weight * squared.sqrt().min(1.0)
        };
        let blocks = self.blocks.iter().filter(|b| b.measured && b.columns.end <= row.len());
        blocks.map(of_block).fold(0.0, f32::max)
    }

    /// A bound of how far two surfaces deviate over a piece of one that is compared with a piece of the other, in
    /// edges. `a` and `b` are the rows at the corners of the triangles they are of, `pairs` the barycentric coordinates
    /// of their corners.
    pub fn deviation_bound(&self, a: [&[f32]; 3], b: [&[f32]; 3], pairs: &[([f64; 3], [f64; 3])]) -> f64 {
        let of_block = |block: &Block| {
            let weight = f64::from(block.weight);
            let most = if block.unit {
                unit_deviation(a, b, block.columns.start, pairs)
            } else {
                let difference = |k: usize, (at, bt): &([f64; 3], [f64; 3])| mean(a, k, at) - mean(b, k, bt);
                let squared = |pair| block.columns.clone().map(|k| difference(k, pair).powi(2)).sum::<f64>();
                pairs.iter().map(squared).fold(0.0, f64::max).sqrt()
            };
            weight * most.min(1.0)
        };
        self.blocks.iter().filter(|block| block.measured).map(of_block).fold(0.0, f64::max)
    }

    /// A bound of the weighted length of what is part of the error in rows.
    pub fn largest(&self, rows: &[f32]) -> f64 {
        let of_block = |block: &Block| {
            let values = rows.chunks_exact(self.stride()).flat_map(|row| &row[block.columns.clone()]);
            let columns = block.columns.len() as f64;
            f64::from(block.weight)
                * columns.sqrt()
                * values.fold(0.0f64, |most, x| most.max(f64::from(x.abs())))
        };
        self.blocks.iter().filter(|block| block.measured).map(of_block).fold(0.0, f64::max)
    }
}

/// Corrections of the direction that all faces may face.
const ATTEMPTS: usize = 32;

/// A direction that all faces of a mesh face, if one is found: an axis, the mean normal, or what comes of turning that
/// towards the face that is farthest from it (the perceptron of Rosenblatt, 1958).
pub fn up(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Option<DVec3> {
    let normal = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| DVec3::from_array(positions[v as usize].map(f64::from)));
        (b - a).cross(c - a)
    };
    // Most meshes are told by a few faces.
    let step = faces.len().div_ceil(FEW_FACES);
    let mean: DVec3 = faces.iter().step_by(step).map(normal).sum();
    let worst = |up: DVec3, step: usize| {
        let facing = |f: &[u32; 3]| {
            let n = normal(f).normalize_or_zero();
            (n != DVec3::ZERO).then(|| (n.dot(up), n))
        };
        let mut least = (f64::INFINITY, DVec3::ZERO);
        for (d, n) in faces.iter().step_by(step).filter_map(facing) {
            if d < least.0 {
                least = (d, n);
            }
            if step == 1 && d <= 0.0 {
                break;
            }
        }
        least
    };
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    let mut tries: Vec<DVec3> = axes.filter(|axis| axis.dot(mean) > 0.0).collect();
    let mut turned = mean.try_normalize()?;
    tries.push(turned);
    for _ in 0..ATTEMPTS {
        let (least, n) = worst(turned, step);
        if least > 0.0 {
            break;
        }
        turned = (turned + n * (0.1 - least)).try_normalize()?;
    }
    tries.push(turned);
    tries.into_iter().find(|up| worst(*up, step).0 > 0.0 && worst(*up, 1).0 > 0.0)
}

/// Faces that a direction is first tried on.
const FEW_FACES: usize = 4096;

/// Column `k` of a mean of rows.
fn mean(rows: [&[f32]; 3], k: usize, at: &[f64; 3]) -> f64 {
    at[0] * f64::from(rows[0][k]) + at[1] * f64::from(rows[1][k]) + at[2] * f64::from(rows[2][k])
}

/// Rounding of a unit vector's columns, many times over.
const UNIT_ROUNDING: f64 = 1.0 / (1u64 << 40) as f64;

/// The same for unit vectors: |u/|u| − v/|v|| ≤ 2 |u − v| / (|u| + |v|), and over a piece neither is shorter than the
/// least of its corners along any direction.
fn unit_deviation(a: [&[f32]; 3], b: [&[f32]; 3], first: usize, pairs: &[([f64; 3], [f64; 3])]) -> f64 {
    let vector = |rows, at: &[f64; 3]| DVec3::from_array([0, 1, 2].map(|k| mean(rows, first + k, at)));
    let shortest = |vectors: &mut dyn Iterator<Item = DVec3>, along: DVec3| {
        vectors.map(|v| v.dot(along)).fold(f64::INFINITY, f64::min) - UNIT_ROUNDING
    };
    let apart =
        pairs.iter().map(|(at, bt)| vector(a, at).distance_squared(vector(b, bt))).fold(0.0, f64::max);
    let (mut sum_a, mut sum_b) = (DVec3::ZERO, DVec3::ZERO);
    for (at, bt) in pairs {
        sum_a += vector(a, at);
        sum_b += vector(b, bt);
    }
    let least = shortest(&mut pairs.iter().map(|(at, _)| vector(a, at)), sum_a.normalize_or_zero());
    let other = shortest(&mut pairs.iter().map(|(_, bt)| vector(b, bt)), sum_b.normalize_or_zero());
    if least > 0.0 && other > 0.0 { 2.0 * (apart.sqrt() + UNIT_ROUNDING) / (least + other) } else { 1.0 }
}
