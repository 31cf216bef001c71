//! What the attribute rows mean: which columns belong together, what each weighs, and how far two rows are apart.

use std::ops::Range;

use crate::config::BuildOptions;
use crate::mesh::WeldedMesh;

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

/// What a mesh carries besides its shape.
#[derive(Clone, Debug)]
pub struct Content {
    blocks: Vec<Block>,
    /// Weight of a label that is another one; zero when there are no labels.
    pub label_weight: f32,
}

impl Content {
    /// The content of a mesh, weighed by the options. Normals come first, then colours, UV sets and the
    /// floating-point channels. Computed normals say nothing that the shape does not: they steer, but are not
    /// measured.
    pub fn new(mesh: &WeldedMesh, computed_normals: bool, options: &BuildOptions) -> Self {
        let mut blocks = Vec::new();
        let mut at = 0;
        let mut add = |width: usize, weight: f32, unit: bool| {
            let measured = weight > 0.0 && !(unit && computed_normals);
            blocks.push(Block { columns: at..at + width, weight, unit, measured });
            at += width;
        };
        add(3, options.normal_weight, true);
        if mesh.layout.colors {
            add(4, options.color_weight, false);
        }
        (0..mesh.layout.uv_sets).for_each(|_| add(2, options.uv_weight, false));
        mesh.channels.float_widths().for_each(|width| add(width, options.channel_weight, false));
        debug_assert_eq!(at, mesh.stride);
        let has_labels = mesh.channels.infos.iter().any(|info| info.dtype.is_label());
        Self { blocks, label_weight: if has_labels { options.channel_weight } else { 0.0 } }
    }

    /// Floats per row.
    pub fn stride(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.columns.end)
    }

    /// The weight of each column, in mean edge lengths.
    pub fn weights(&self) -> impl Iterator<Item = f32> {
        self.blocks.iter().flat_map(|block| std::iter::repeat_n(block.weight, block.columns.len()))
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
}
