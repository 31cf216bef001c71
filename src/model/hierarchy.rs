//! The culling hierarchy: one wide tree per level, their roots along a chain from one super root.

use bytemuck::{Pod, Zeroable};

use crate::math::Sphere;

/// A node of the hierarchy. Its children are consecutive nodes or consecutive groups.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Node {
    /// Centre of the box around all clusters below.
    pub center: [f32; 3],
    /// Half extents of that box, rounded up.
    pub extent: [f32; 3],
    /// Encloses the LOD sphere of every group below.
    pub lod_sphere: Sphere,
    /// Above the error of every group below: when this projects to the threshold or less, nothing below is
    /// drawn.
    pub max_parent_error: f32,
    /// The least own error of a cluster below: while it is too large everywhere on the sphere, nothing below is drawn.
    pub min_own_error: f32,
    /// First child node, or first group when `is_leaf`.
    pub first: u32,
    /// Number of children.
    pub count: u16,
    /// 1 when the children are groups.
    pub is_leaf: u16,
    /// Level of the groups below; the super root has the largest.
    pub level: u32,
}

const _: () = assert!(size_of::<Node>() == 60);
