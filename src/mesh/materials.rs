//! Vertices of one material: a vertex at which faces of several materials meet becomes one for each of them, so that
//! lines between materials are seams to everything that follows.

use rustc_hash::FxHashMap;

/// Faces whose corners have the face's material.
#[derive(Clone, Debug)]
pub struct ByMaterial {
    /// The faces over the vertices given and, after them, the copies.
    pub faces: Vec<[u32; 3]>,
    /// The vertex that each copy is one of.
    pub copies: Vec<u32>,
    /// Material of each vertex and copy.
    pub materials: Vec<u32>,
}

/// Copies vertices so that each has one material.
pub fn split(faces: &[[u32; 3]], materials: &[i32], vertices: usize) -> ByMaterial {
    let mut first: Vec<Option<u32>> = vec![None; vertices];
    let mut copies = Vec::new();
    let mut of_copy = Vec::new();
    let mut known: FxHashMap<(u32, u32), u32> = FxHashMap::default();
    let mut named = |v: u32, material: u32| {
        if *first[v as usize].get_or_insert(material) == material {
            return v;
        }
        *known.entry((v, material)).or_insert_with(|| {
            copies.push(v);
            of_copy.push(material);
            (vertices + copies.len()) as u32 - 1
        })
    };
    let faces = faces
        .iter()
        .zip(materials)
        .map(|(face, material)| face.map(|v| named(v, material.cast_unsigned())))
        .collect();
    let materials = first.into_iter().map(Option::unwrap_or_default).chain(of_copy).collect();
    ByMaterial { faces, copies, materials }
}
