//! The source in blocks: which faces each block has, which faces of others touch them, and which positions blocks share.
//!
//! A face is in the block of its centroid. A position is at home in the block of its cell, whose list of visitors has the faces
//! of other blocks around it: so the home knows all faces around a position, and tells every block that has one of them.

use std::path::Path;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::cells::{Blocks, Cells};
use super::lists::{self, Lists};
use crate::build::silhouette::{Silhouette, Silhouettes};
use crate::error::Result;
use crate::math::Aabb;
use crate::mesh::{SourceMesh, frame};
use crate::model::CoordinateFrame;

/// Lists of faces of others that are at home in a block.
const VISITORS: &str = "visitors";
/// Faces that are looked at at a time.
const CHUNK: usize = 1 << 20;

/// Lists of the faces of each block,
pub const OWN: &str = "own";
/// of faces of others that touch a position that they share with a block,
pub const AROUND: &str = "around";
/// and of the bits of positions that blocks share with others.
pub const BORDER: &str = "border";

struct Places<'a> {
    source: &'a SourceMesh<'a>,
    frame: &'a CoordinateFrame,
    cells: &'a Cells,
}

impl Places<'_> {
    fn corners(&self, face: u32) -> [[f32; 3]; 3] {
        self.source.faces[face as usize]
            .map(|v| frame::internal(self.frame, self.source.positions.get(v as usize)))
    }

    /// The cell of a face.
    fn cell(&self, corners: &[[f32; 3]; 3]) -> u32 {
        self.cells.of(std::array::from_fn(|k| corners.iter().map(|p| f64::from(p[k])).sum::<f64>() / 3.0))
    }

    fn home(&self, p: &[f32; 3]) -> u32 {
        self.cells.of(p.map(f64::from))
    }
}

/// Which vertices faces use that have three corners apart.
pub fn used(source: &SourceMesh<'_>, frame: &CoordinateFrame) -> Vec<bool> {
    let mut used = vec![false; source.positions.len()];
    for face in source.faces {
        let [a, b, c] = face.map(|v| frame::internal(frame, source.positions.get(v as usize)));
        if a != b && b != c && c != a {
            face.iter().for_each(|v| used[*v as usize] = true);
        }
    }
    used
}

/// The area that a source covers.
pub fn silhouette(source: &SourceMesh<'_>, frame: &CoordinateFrame, used: &[bool]) -> Silhouette {
    let place = |v: usize| frame::internal(frame, source.positions.get(v));
    let around = (0..used.len()).into_par_iter().filter(|v| used[*v]).map(|v| Aabb::of_points([&place(v)]));
    let bounds = around.reduce(|| Aabb::EMPTY, |a, b| a.union(&b));
    let none = || Silhouettes::new(&bounds);
    let drawn = source.faces.par_chunks(CHUNK).map(|faces| {
        let mut own = none();
        faces.iter().for_each(|face| own.draw(face.map(|v| place(v as usize))));
        own
    });
    Silhouette { bounds, covered: drawn.reduce(none, |a, b| a.union(&b)).covered() }
}

/// Puts the faces of a valid source into blocks of at most `most`; returns how many there are.
pub fn distribute(
    source: &SourceMesh<'_>,
    frame: &CoordinateFrame,
    cells: &Cells,
    most: u64,
    folder: &Path,
) -> Result<usize> {
    let places = Places { source, frame, cells };
    let chunks = |count: usize| (0..count).step_by(CHUNK).map(move |start| start..count.min(start + CHUNK));
    let mut counts = vec![0; Cells::COUNT];
    for chunk in chunks(source.faces.len()) {
        let found: Vec<u32> = chunk.into_par_iter().map(|f| places.cell(&places.corners(f as u32))).collect();
        found.iter().for_each(|cell| counts[*cell as usize] += 1);
    }
    let blocks = Blocks::new(&counts, most);
    drop(counts);
    let list = |name| Lists::new(folder, name, blocks.count);
    let [own, around, shared] = [OWN, AROUND, BORDER].map(list);
    let visitors = list(VISITORS);
    for chunk in chunks(source.faces.len()) {
        let mut found: Vec<(u32, u32, bool)> = chunk
            .into_par_iter()
            .flat_map_iter(|f| {
                let corners = places.corners(f as u32);
                let owner = blocks.of(places.cell(&corners));
                let homes = corners.map(|p| blocks.of(places.home(&p)));
                let new = move |k: &usize| homes[*k] != owner && !homes[..*k].contains(&homes[*k]);
                let visits = (0..3).filter(new).map(move |k| (homes[k], f as u32, true));
                std::iter::once((owner, f as u32, false)).chain(visits)
            })
            .collect();
        found.par_sort_unstable_by_key(|(block, face, visits)| (*visits, *block, *face));
        for run in found.chunk_by(|a, b| (a.0, a.2) == (b.0, b.2)) {
            let faces: Vec<u32> = run.iter().map(|(_, face, _)| *face).collect();
            let (block, list) = (run[0].0 as usize, if run[0].2 { &visitors } else { &own });
            list.append(block, &faces)?;
        }
    }
    own.finish()?;
    visitors.finish()?;
    (0..blocks.count).into_par_iter().try_for_each(|block| -> Result<()> {
        let visitors = lists::read(folder, VISITORS, block)?;
        // The faces around each position that is at home here and has visitors, with their owners.
        let mut at: FxHashMap<[u32; 3], Vec<(u32, u32)>> = FxHashMap::default();
        for face in &visitors {
            let corners = places.corners(*face);
            let owner = blocks.of(places.cell(&corners));
            for p in corners.iter().filter(|p| blocks.of(places.home(p)) as usize == block) {
                at.entry(p.map(f32::to_bits)).or_default().push((owner, *face));
            }
        }
        if at.is_empty() {
            return Ok(());
        }
        for face in lists::read(folder, OWN, block)? {
            for p in places.corners(face) {
                if let Some(faces) = at.get_mut(&p.map(f32::to_bits)) {
                    faces.push((block as u32, face));
                }
            }
        }
        for (position, mut faces) in at {
            faces.sort_unstable();
            faces.dedup();
            if faces.iter().all(|(owner, _)| *owner == faces[0].0) {
                continue;
            }
            for run in faces.chunk_by(|a, b| a.0 == b.0) {
                let owner = run[0].0;
                shared.append(owner as usize, &position)?;
                let others: Vec<u32> = faces.iter().filter(|f| f.0 != owner).map(|f| f.1).collect();
                around.append(owner as usize, &others)?;
            }
        }
        Ok(())
    })?;
    around.finish()?;
    shared.finish()?;
    Ok(blocks.count)
}
