//! Linear blend skinning: vertices under the poses of the joints that act on them.
//!
//! Magnenat-Thalmann, Laperrière and Thalmann, "Joint-dependent local deformations for hand animation and object grasping",
//! Graphics Interface 1988; weights and matrices as glTF 2.0, section 3.7.3, has them.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::math::affine::{self, Affine};

/// Rows of a matrix that maps positions at rest to where a joint takes them.
pub type JointMatrix = Affine;

/// What acts on the vertices of a mesh: as many joints for each.
#[derive(Clone, Copy, Debug)]
pub struct Influences<'a> {
    /// Joints of each vertex, one vertex after the other.
    pub joints: &'a [u32],
    /// How much each acts; those of a vertex need not add up to 1.
    pub weights: &'a [f32],
}

/// Positions and, where there are any, unit normals.
pub type Skinned = (Vec<[f64; 3]>, Option<Vec<[f32; 3]>>);

/// Vertices that lie at `positions` and face `normals` at rest, where these joints take them. Normals have any length. A vertex
/// without weights is that of the first of its joints.
pub fn skin(
    positions: &[[f32; 3]],
    normals: Option<&[[f32; 3]]>,
    influences: Influences<'_>,
    matrices: &[JointMatrix],
) -> Result<Skinned> {
    let Influences { joints, weights } = influences;
    let each = joints.len().checked_div(positions.len()).unwrap_or(0);
    if each == 0 || joints.len() != each * positions.len() || weights.len() != joints.len() {
        let message = format!(
            "expected as many joints and weights for each of the {} vertices, found {} and {}",
            positions.len(),
            joints.len(),
            weights.len()
        );
        return Err(Error::argument("joints", message));
    }
    if let Some(at) = joints.par_iter().position_first(|joint| *joint as usize >= matrices.len()) {
        let message = format!("vertex {}: joint {} of {}", at / each, joints[at], matrices.len());
        return Err(Error::argument("joints", message));
    }
    if let Some(at) = weights.par_iter().position_first(|weight| !weight.is_finite()) {
        return Err(Error::argument(
            "weights",
            format!("vertex {}: {} is not finite", at / each, weights[at]),
        ));
    }
    if let Some(joint) = matrices.iter().position(|rows| !rows.as_flattened().iter().all(|x| x.is_finite())) {
        return Err(Error::argument("matrices", format!("that of joint {joint} is not finite")));
    }
    let blended = |v: usize| blended(&joints[v * each..][..each], &weights[v * each..][..each], matrices);
    let moved = (0..positions.len())
        .into_par_iter()
        .map(|v| affine::apply(&blended(v), positions[v].map(f64::from)))
        .collect();
    let turned = normals.map(|normals| {
        (0..positions.len())
            .into_par_iter()
            .map(|v| affine::turn(&blended(v), normals[v].map(f64::from)))
            .collect()
    });
    Ok((moved, turned))
}

fn blended(joints: &[u32], weights: &[f32], matrices: &[JointMatrix]) -> JointMatrix {
    let sum: f64 = weights.iter().map(|weight| f64::from(*weight)).sum();
    if sum <= 0.0 {
        return matrices[joints[0] as usize];
    }
    let mut out = affine::ZERO;
    for (joint, weight) in joints.iter().zip(weights) {
        affine::add(&mut out, f64::from(*weight) / sum, &matrices[*joint as usize]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOVED: JointMatrix = [[1.0, 0.0, 0.0, 5.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]];
    const REST: JointMatrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

    #[test]
    fn weights_blend_matrices() {
        let positions = [[1.0f32, 1.0, 1.0]; 3];
        let normals = [[0.0f32, 3.0, 0.0]; 3];
        let influences = Influences { joints: &[0, 1, 0, 1, 1, 0], weights: &[1.0, 1.0, 0.0, 3.0, 0.0, 0.0] };
        let (moved, turned) = skin(&positions, Some(&normals), influences, &[REST, MOVED]).unwrap();
        assert_eq!(moved, [[3.5, 1.5, 0.5], [6.0, 2.0, 0.0], [6.0, 2.0, 0.0]]);
        assert_eq!(turned.unwrap(), [[0.0, 1.0, 0.0]; 3]);
    }

    #[test]
    fn mistakes_are_named() {
        let positions = [[0.0f32; 3]; 2];
        let found = |joints: &[u32], weights: &[f32], matrices: &[JointMatrix]| {
            skin(&positions, None, Influences { joints, weights }, matrices).unwrap_err().to_string()
        };
        assert!(found(&[0, 2], &[1.0; 2], &[REST, MOVED]).contains("vertex 1: joint 2 of 2"));
        assert!(found(&[0, 1, 0], &[1.0; 3], &[REST, MOVED]).starts_with("joints: expected"));
        assert!(found(&[], &[], &[REST]).starts_with("joints: expected"));
        assert!(found(&[0, 0], &[1.0, f32::NAN], &[REST]).contains("vertex 1"));
        assert!(found(&[0, 0], &[1.0; 2], &[[[f64::NAN; 4]; 3]]).contains("joint 0"));
    }
}
