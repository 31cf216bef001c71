//! Triangles in f64.

/// The normal of a triangle, counter-clockwise from the front, as long as twice its area.
pub fn area_normal(p: [[f32; 3]; 3]) -> [f64; 3] {
    let p = p.map(|v| v.map(f64::from));
    let u: [f64; 3] = std::array::from_fn(|k| p[1][k] - p[0][k]);
    let v: [f64; 3] = std::array::from_fn(|k| p[2][k] - p[0][k]);
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// The area of a triangle.
pub fn area(p: [[f32; 3]; 3]) -> f64 {
    let n = area_normal(p);
    0.5 * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt()
}

/// The edge of the equilateral triangle of an area.
pub fn edge_of_area(area: f64) -> f64 {
    (area * 4.0 / 3f64.sqrt()).sqrt()
}
