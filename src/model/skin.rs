//! Meshes whose vertices follow joints: what acts on which part of a DAG.
//!
//! Linear blend skinning (Magnenat-Thalmann, Laperrière and Thalmann, Graphics Interface 1988): a vertex at x goes to
//! Σ wᵢ Mᵢ x, where wᵢ are its weights, which add up to 1, and Mᵢ what the joints do to space.

use std::sync::Arc;

use super::geometry::GeometryId;
use super::page::PageEntry;
use crate::math::affine::{self, Affine};
use crate::math::{Aabb, octahedral};

/// Lists one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Lists<T> {
    /// Where each begins; one more entry than lists.
    first: Vec<u32>,
    items: Vec<T>,
}

impl<T> Lists<T> {
    /// The list of a number.
    #[inline]
    pub fn of(&self, number: usize) -> &[T] {
        &self.items[self.first[number] as usize..self.first[number + 1] as usize]
    }

    /// How many lists there are.
    pub fn len(&self) -> usize {
        self.first.len() - 1
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl<T, L: IntoIterator<Item = T>> FromIterator<L> for Lists<T> {
    fn from_iter<I: IntoIterator<Item = L>>(lists: I) -> Self {
        let mut out = Self { first: vec![0], items: Vec::new() };
        for list in lists {
            out.items.extend(list);
            out.first.push(out.items.len() as u32);
        }
        out
    }
}

/// How much a joint acts on a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    /// Number of the joint.
    pub joint: u32,
    /// Above 0. Those of a vertex add up to 1.
    pub weight: f32,
}

/// A joint and the box of what it acts on, internal space at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointBox {
    /// Number of the joint.
    pub joint: u32,
    /// Around all vertices that it acts on.
    pub bounds: Aabb,
}

/// What bounds of the error of a group under a pose are made of: docs/numerics.md. All lengths in internal units, rounded up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GroupSkin {
    /// Each point of the source has one of what was made from the group no farther off than this, whose weights deviate no more
    /// than by `deviation`; and the other way round.
    pub reach: f32,
    /// Half the sum of the differences of weights.
    pub deviation: f32,
    /// The largest, over edges of triangles, of half the sum of the differences of weights times the length: of what was made,
    /// and of the source.
    pub bend: f32,
    /// The longest edge of any triangle of those: a joint acts no farther beyond the vertices that it acts on.
    pub edge: f32,
}

/// What acts on which part of a DAG.
#[derive(Clone, Debug, PartialEq)]
pub struct Skin {
    /// Number of joints.
    pub joints: usize,
    /// By vertex identity.
    pub influences: Lists<Influence>,
    /// Joints that act on each cluster, in page order.
    pub clusters: Lists<u32>,
    /// For each group the joints that act on its members, on what was made from it, or on anything below.
    pub groups: Lists<JointBox>,
    /// For each group those that its members were made from.
    pub below: Lists<u32>,
    /// What errors are made of, by group.
    pub errors: Vec<GroupSkin>,
    /// The joints that act on the source.
    pub source: Vec<JointBox>,
    /// One for all poses.
    pub topology: Arc<GeometryId>,
    /// The pages with clusters that may lie anywhere.
    pub table: Vec<PageEntry>,
}

/// Where joints are: what moves the vertices of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Joints {
    /// What acts on what.
    pub skin: Arc<Skin>,
    /// For each joint, from internal space at rest to that under the pose.
    pub maps: Vec<Affine>,
}

impl Joints {
    /// The box around a cluster, by number in page order, from the box at rest: each vertex is a mean of where its joints take
    /// it.
    pub fn cluster_box(&self, number: usize, center: [f64; 3], extent: [f64; 3]) -> Aabb {
        let joints = self.skin.clusters.of(number);
        moved_box(joints.iter().map(|joint| (&self.maps[*joint as usize], center, extent)))
    }

    /// Where an identity goes from a position at rest, and its octahedral normal there.
    #[inline]
    pub fn vertex(&self, id: u32, position: [f64; 3], normal: u32) -> ([f64; 3], u32) {
        let map = self.blended(id);
        let normal = affine::turned(&map, octahedral::direction(normal).map(f64::from));
        // What f32 holds the largest of, it holds all of.
        let largest = normal.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        (affine::apply(&map, position), octahedral::encode(normal.map(|x| (x / largest) as f32)))
    }

    /// What the joints of an identity do to space together. Their weights add up to 1: the first has what the others leave.
    #[inline]
    fn blended(&self, id: u32) -> Affine {
        let Some((first, others)) = self.skin.influences.of(id as usize).split_first() else {
            return affine::ZERO;
        };
        let first = &self.maps[first.joint as usize];
        if others.is_empty() {
            return *first;
        }
        let (mut out, mut rest) = (affine::ZERO, 1.0);
        for influence in others {
            let weight = f64::from(influence.weight);
            rest -= weight;
            affine::add(&mut out, weight, &self.maps[influence.joint as usize]);
        }
        affine::add(&mut out, rest, first);
        out
    }
}

/// The box around boxes, each under a map: centre and half extents of each. Rounded outwards.
pub fn moved_box<'a>(boxes: impl Iterator<Item = (&'a Affine, [f64; 3], [f64; 3])>) -> Aabb {
    // Of sums of four products, many times over.
    const ROUNDING: f64 = 1.0e-14;
    let mut out = Aabb::EMPTY;
    for (map, center, extent) in boxes {
        let (at, reach) = affine::apply_to_box(map, center, extent);
        for k in 0..3 {
            let size: f64 = (0..3).map(|j| (map[k][j] * center[j]).abs()).sum::<f64>() + map[k][3].abs();
            let reach = reach[k] + ROUNDING * (size + reach[k]);
            out.min[k] = out.min[k].min(((at[k] - reach) as f32).next_down());
            out.max[k] = out.max[k].max(((at[k] + reach) as f32).next_up());
        }
    }
    out
}
