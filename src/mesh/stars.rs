//! The triangles around each vertex.

/// The corners of an index buffer at each vertex.
#[derive(Debug)]
pub struct Stars {
    starts: Vec<u32>,
    corners: Vec<u32>,
}

impl Stars {
    /// The stars of so many vertices in an index buffer of triangles.
    pub fn new(vertices: usize, indices: &[u32]) -> Self {
        // Counted two places ahead, so that filling leaves the starts where they belong.
        let mut starts = vec![0u32; vertices + 2];
        indices.iter().for_each(|v| starts[*v as usize + 2] += 1);
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut corners = vec![0; indices.len()];
        for (corner, v) in indices.iter().enumerate() {
            let at = &mut starts[*v as usize + 1];
            corners[*at as usize] = corner as u32;
            *at += 1;
        }
        Self { starts, corners }
    }

    /// The triangles around a vertex, each with the number of its corner there, in their order.
    pub fn of(&self, vertex: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let corners = &self.corners[self.starts[vertex] as usize..self.starts[vertex + 1] as usize];
        corners.iter().map(|corner| (*corner as usize / 3, *corner as usize % 3))
    }
}
