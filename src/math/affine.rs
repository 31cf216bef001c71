//! Affine maps as three rows, in f64: what joints do to space.

use super::project::singular_value_bound;

/// Rows of a map: the linear part, then what is added.
pub type Affine = [[f64; 4]; 3];

/// The sum of nothing.
pub const ZERO: Affine = [[0.0; 4]; 3];

/// A point under a map.
#[inline(always)]
pub fn apply(map: &Affine, [x, y, z]: [f64; 3]) -> [f64; 3] {
    map.map(|row| row[0] * x + row[1] * y + row[2] * z + row[3])
}

/// The difference of two maps.
pub fn difference(a: &Affine, b: &Affine) -> Affine {
    std::array::from_fn(|k| std::array::from_fn(|j| a[k][j] - b[k][j]))
}

/// Adds a part of a map to another.
#[inline(always)]
pub fn add(to: &mut Affine, part: f64, map: &Affine) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(map.as_flattened()) {
        *to += part * from;
    }
}

/// The box around a box under a map: centres and half extents.
pub fn apply_to_box(map: &Affine, center: [f64; 3], extent: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let reach = |row: [f64; 4]| (0..3).map(|j| row[j].abs() * extent[j]).sum();
    (apply(map, center), map.map(reach))
}

/// A bound of how much longer the linear part of a map makes a vector.
pub fn norm(map: &Affine) -> f64 {
    singular_value_bound(map.map(|row| [row[0], row[1], row[2]]))
}

/// A normal under a map, of unit length, zero where there is none.
pub fn turn(map: &Affine, n: [f64; 3]) -> [f32; 3] {
    let out = turned(map, n);
    let length = out.iter().map(|x| x * x).sum::<f64>().sqrt();
    out.map(|x| if length > 0.0 { (x / length) as f32 } else { 0.0 })
}

/// The direction of a normal under a map, of any length. By the cofactors of the linear part: they are the inverse transposed
/// times the determinant, and there where no inverse is. A map that mirrors turns faces over, so they keep its sign.
#[inline(always)]
pub fn turned(map: &Affine, n: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = map.map(|row| [row[0], row[1], row[2]]);
    let cross = |u: [f64; 3], v: [f64; 3]| {
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    };
    [cross(b, c), cross(c, a), cross(a, b)].map(|row| row[0] * n[0] + row[1] * n[1] + row[2] * n[2])
}
