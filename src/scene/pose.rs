//! Checked 4×4 poses, rows first, as f64 affine maps.

use glam::{DAffine3, DMat3, DVec3};

use crate::error::{Error, Result};

/// How far a number of a camera's pose may be off that of the nearest rotation: poses of data sets are rounded, or
/// solved for, and are rotations to three digits at best.
pub const RIGID_TOLERANCE: f64 = 1.0e-2;

/// How far the last row may be off 0 0 0 1: that of f32 arithmetic.
const LAST_ROW_TOLERANCE: f64 = 1.0e-6;

/// An invertible affine map from its 4×4 matrix: any rotation, shear, non-uniform or negative scale.
///
/// `argument` names the matrix in the error.
pub fn affine(argument: &'static str, rows: &[[f64; 4]; 4]) -> Result<DAffine3> {
    for (i, row) in rows.iter().enumerate() {
        if let Some(j) = row.iter().position(|v| !v.is_finite()) {
            return Err(Error::argument(argument, format!("[{i}, {j}] must be finite, not {}", row[j])));
        }
    }
    let last = [0.0, 0.0, 0.0, 1.0];
    if (0..4).any(|j| (rows[3][j] - last[j]).abs() > LAST_ROW_TOLERANCE) {
        return Err(Error::argument(argument, format!("the last row must be 0 0 0 1, not {:?}", rows[3])));
    }
    let column = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]);
    let linear = DMat3::from_cols(column(0), column(1), column(2));
    // Relative to the product of the column lengths, so that a uniformly tiny scale is no fault.
    let lengths = column(0).length() * column(1).length() * column(2).length();
    let determinant = linear.determinant();
    let inverse_is_finite = linear.inverse().is_finite();
    if !(determinant.abs() > 1.0e-12 * lengths && inverse_is_finite) {
        return Err(Error::argument(
            argument,
            format!("the upper left 3×3 must be invertible, but its determinant is {determinant:e}"),
        ));
    }
    Ok(DAffine3 { matrix3: linear, translation: column(3) })
}

/// Many of them: an error says which is wrong.
pub fn affines(argument: &'static str, poses: &[[[f64; 4]; 4]]) -> Result<Vec<DAffine3>> {
    let numbered = |(i, rows)| {
        affine(argument, rows).map_err(|error| match error {
            Error::Argument { argument, message } => {
                let gap = if message.starts_with('[') { "" } else { ": " };
                Error::argument(argument, format!("[{i}]{gap}{message}"))
            }
            other => other,
        })
    };
    poses.iter().enumerate().map(numbered).collect()
}

/// A rotation (or reflection) and a translation: the nearest to the matrix, which may be off by [`RIGID_TOLERANCE`].
/// Returns by how much it was, too.
pub fn rigid(argument: &'static str, rows: &[[f64; 4]; 4]) -> Result<(DAffine3, f64)> {
    let pose = affine(argument, rows)?;
    let rotation = nearest_rotation(pose.matrix3);
    let off = (pose.matrix3 - rotation).to_cols_array().iter().fold(0.0, |off: f64, v| off.max(v.abs()));
    if off.is_nan() || off > RIGID_TOLERANCE {
        return Err(Error::argument(
            argument,
            format!(
                "a camera's pose must be a rotation and a translation, without scale or shear; \
                 it is off the nearest by {off:.2e}, and may be by {RIGID_TOLERANCE}"
            ),
        ));
    }
    Ok((DAffine3 { matrix3: rotation, translation: pose.translation }, off))
}

/// The rotation (or reflection) nearest to an invertible matrix, its polar factor, by Newton's iteration (Higham,
/// "Computing the Polar Decomposition", SIAM J. Sci. Stat. Comput. 7(4), 1986), which doubles the digits in each step.
fn nearest_rotation(matrix: DMat3) -> DMat3 {
    let mut rotation = matrix;
    for _ in 0..60 {
        let next = (rotation + rotation.inverse().transpose()) * 0.5;
        if next == rotation || !next.is_finite() {
            break;
        }
        rotation = next;
    }
    rotation
}

/// The 4×4 matrix of an affine map, rows first.
pub fn rows(pose: &DAffine3) -> [[f64; 4]; 4] {
    let (m, t) = (pose.matrix3, pose.translation);
    [
        [m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x],
        [m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y],
        [m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z],
        [0.0, 0.0, 0.0, 1.0],
    ]
}

/// The rows of a 3×3 matrix.
pub fn linear_rows(m: &DMat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d()
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: [[f64; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

    fn with(i: usize, j: usize, value: f64) -> [[f64; 4]; 4] {
        let mut m = IDENTITY;
        m[i][j] = value;
        m
    }

    #[test]
    fn bad_poses_are_named() {
        for (bad, word) in [
            (with(1, 3, f64::NAN), "[1, 3]"),
            (with(0, 0, f64::INFINITY), "finite"),
            (with(3, 0, 1.0), "last row"),
            (with(2, 2, 0.0), "invertible"),
        ] {
            let message = affine("pose", &bad).unwrap_err().to_string();
            assert!(message.starts_with("pose: ") && message.contains(word), "{message}");
        }
        assert!(affine("pose", &with(0, 1, 3.0)).is_ok());
        assert!(affine("pose", &with(0, 0, -1e-9)).is_ok());
        assert!(rigid("pose", &with(0, 0, 2.0)).is_err());
        assert!(rigid("pose", &with(0, 3, 1e7)).is_ok());
        assert!(affine("pose", &with(3, 3, 1.0 + 1e-7)).is_ok());
    }

    #[test]
    fn poses_that_are_nearly_rotations_become_the_nearest() {
        for (change, off) in
            [(with(0, 0, 1.009), 0.009), (with(0, 1, 0.006), 0.003), (with(2, 2, -1.005), 0.005)]
        {
            let (pose, found) = rigid("pose", &change).unwrap();
            let product = pose.matrix3.transpose() * pose.matrix3;
            assert!((product - DMat3::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-15));
            assert!((found - off).abs() < 1e-4, "{found} {off}");
        }
        assert_eq!(rigid("pose", &IDENTITY).unwrap().1, 0.0);
        assert!(rigid("pose", &with(0, 0, 1.011)).is_err());
        assert!(rigid("pose", &with(0, 1, 0.03)).is_err());
        assert_eq!(rows(&affine("pose", &with(0, 3, 5.0)).unwrap()), with(0, 3, 5.0));
    }
}
