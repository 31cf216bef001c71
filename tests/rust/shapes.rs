//! Generated meshes for tests and benchmarks.

#![allow(clippy::disallowed_types)] // the order of these tables reaches no assertion

/// Positions and triangles.
pub type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A closed sphere of 8·n² triangles (a subdivided octahedron) with waves on it.
pub fn bumpy_sphere(n: usize) -> Mesh {
    let mut faces = Vec::new();
    let mut positions = Vec::new();
    let mut ids = std::collections::HashMap::new();
    // Integer points with |x|+|y|+|z| = n, so that shared vertices meet exactly.
    let mut vertex = |p: [i64; 3]| {
        *ids.entry(p).or_insert_with(|| {
            let v = p.map(|x| x as f64);
            let len = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let u = v.map(|x| x / len);
            let r = 1.0
                + 0.05 * (7.0 * u[0]).sin() * (6.0 * u[1]).cos()
                + 0.02 * (23.0 * u[2]).sin() * (19.0 * u[0]).sin()
                + 0.004 * (71.0 * u[1]).sin() * (83.0 * u[2]).cos();
            positions.push(u.map(|x| (x * r) as f32));
            (positions.len() - 1) as u32
        })
    };
    let n = n as i64;
    for signs in 0..8 {
        let s = [0, 1, 2].map(|k| if signs >> k & 1 == 1 { -1 } else { 1 });
        let flip = s[0] * s[1] * s[2] < 0;
        for i in 0..n {
            for j in 0..n - i {
                let mut add = |a: [i64; 3], b: [i64; 3], c: [i64; 3]| {
                    let [a, b, c] = [a, b, c].map(|p| vertex([p[0] * s[0], p[1] * s[1], p[2] * s[2]]));
                    faces.push(if flip { [a, c, b] } else { [a, b, c] });
                };
                let p = |i: i64, j: i64| [i, j, n - i - j];
                add(p(i, j), p(i + 1, j), p(i, j + 1));
                if j < n - i - 1 {
                    add(p(i + 1, j), p(i + 1, j + 1), p(i, j + 1));
                }
            }
        }
    }
    (positions, faces)
}

/// An open grid of 2·n² triangles with the given height.
pub fn grid(n: usize, height: impl Fn(f64, f64) -> f64) -> Mesh {
    let at = |i: usize| i as f64 / n as f64;
    let positions = (0..=n)
        .flat_map(|y| (0..=n).map(move |x| (x, y)))
        .map(|(x, y)| [at(x) as f32, at(y) as f32, height(at(x), at(y)) as f32])
        .collect();
    let row = n as u32 + 1;
    let faces = (0..n as u32)
        .flat_map(|y| (0..n as u32).map(move |x| y * row + x))
        .flat_map(|i| [[i, i + 1, i + row + 1], [i, i + row + 1, i + row]])
        .collect();
    (positions, faces)
}

/// A cube from −1 to 1 with 12·n² triangles, closed.
pub fn cube(n: usize) -> Mesh {
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    let mut numbers = std::collections::HashMap::new();
    for axis in 0..3 {
        for sign in [-1i32, 1] {
            let mut corner = |u: usize, v: usize| {
                let mut key = [0; 3];
                key[axis] = sign * n as i32;
                key[(axis + 1) % 3] = 2 * u as i32 - n as i32;
                key[(axis + 2) % 3] = 2 * v as i32 - n as i32;
                *numbers.entry(key).or_insert_with(|| {
                    positions.push(key.map(|k| k as f32 / n as f32));
                    positions.len() as u32 - 1
                })
            };
            for (u, v) in (0..n * n).map(|k| (k % n, k / n)) {
                let quad = [corner(u, v), corner(u + 1, v), corner(u + 1, v + 1), corner(u, v + 1)];
                for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                    let (b, c) = if sign > 0 { (b, c) } else { (c, b) };
                    faces.push([quad[a], quad[b], quad[c]]);
                }
            }
        }
    }
    (positions, faces)
}

/// A closed torus of 2·n·m triangles.
pub fn torus(n: usize, m: usize) -> Mesh {
    let angle = |i: usize, n: usize| std::f64::consts::TAU * i as f64 / n as f64;
    let positions = (0..n)
        .flat_map(|i| (0..m).map(move |j| (i, j)))
        .map(|(i, j)| {
            let (u, v) = (angle(i, n), angle(j, m));
            let r = 1.0 + 0.3 * v.cos() + 0.01 * (9.0 * u).sin();
            [(r * u.cos()) as f32, (r * u.sin()) as f32, (0.3 * v.sin()) as f32]
        })
        .collect();
    let id = |i: usize, j: usize| ((i % n) * m + j % m) as u32;
    let faces = (0..n)
        .flat_map(|i| (0..m).map(move |j| (i, j)))
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    (positions, faces)
}

/// Every triangle with vertices of its own, as an STL file has them.
pub fn unindexed((positions, faces): &Mesh) -> Mesh {
    let corners = faces.iter().flatten().map(|v| positions[*v as usize]).collect();
    (corners, (0..faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
}

/// One flat normal per corner of an unindexed mesh.
pub fn flat_normals((positions, faces): &Mesh) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0; 3]; positions.len()];
    for f in faces {
        let p = f.map(|v| positions[v as usize]);
        let u: [f32; 3] = std::array::from_fn(|k| p[1][k] - p[0][k]);
        let v: [f32; 3] = std::array::from_fn(|k| p[2][k] - p[0][k]);
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        f.iter().for_each(|i| normals[*i as usize] = n);
    }
    normals
}
