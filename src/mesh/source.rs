//! Borrowed views of the caller's arrays.

use crate::model::{ChannelInfo, ColorFormat};

/// Vertex positions, object units.
#[derive(Clone, Copy, Debug)]
pub enum Positions<'a> {
    /// Single precision.
    F32(&'a [[f32; 3]]),
    /// Double precision. Kept as f32 about an f64 origin unless every value is an f32 already.
    F64(&'a [[f64; 3]]),
}

impl Positions<'_> {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(p) => p.len(),
            Self::F64(p) => p.len(),
        }
    }

    /// True when there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One position.
    pub fn get(&self, i: usize) -> [f64; 3] {
        match self {
            Self::F32(p) => p[i].map(f64::from),
            Self::F64(p) => p[i],
        }
    }
}

/// A named channel as the caller has it.
#[derive(Clone, Debug)]
pub struct SourceChannel<'a> {
    /// Name, type and width.
    pub info: ChannelInfo,
    /// N rows of words: the bits of numbers, see [`crate::model::ChannelType`].
    pub words: &'a [u32],
}

/// RGBA colours as the caller has them, each kept as precise as it is.
#[derive(Clone, Copy, Debug)]
pub enum Colors<'a> {
    /// Bytes over 255.
    U8(&'a [[u8; 4]]),
    /// 16-bit numbers over 65,535.
    U16(&'a [[u16; 4]]),
    /// Numbers of 0 to 1.
    F32(&'a [[f32; 4]]),
}

impl Colors<'_> {
    /// Number of colours.
    pub fn len(self) -> usize {
        match self {
            Self::U8(rows) => rows.len(),
            Self::U16(rows) => rows.len(),
            Self::F32(rows) => rows.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// The colour of vertex `i`, 0 to 1.
    pub fn get(self, i: usize) -> [f32; 4] {
        match self {
            Self::U8(rows) => rows[i].map(|x| f32::from(x) / ColorFormat::Unorm8.one()),
            Self::U16(rows) => rows[i].map(|x| f32::from(x) / ColorFormat::Unorm16.one()),
            Self::F32(rows) => rows[i],
        }
    }

    /// What a mesh stores them as.
    pub fn format(self) -> ColorFormat {
        match self {
            Self::U8(_) => ColorFormat::Unorm8,
            Self::U16(_) => ColorFormat::Unorm16,
            Self::F32(_) => ColorFormat::Float32,
        }
    }
}

/// A triangle mesh as the caller has it. Nothing is trusted until [`super::validate::validate`] passed.
#[derive(Clone, Debug)]
pub struct SourceMesh<'a> {
    /// N positions.
    pub positions: Positions<'a>,
    /// M triangles, counter-clockwise seen from the front.
    pub faces: &'a [[u32; 3]],
    /// N normals of any length; computed when missing.
    pub normals: Option<&'a [[f32; 3]]>,
    /// N RGBA colours.
    pub colors: Option<Colors<'a>>,
    /// UV sets of N pairs each, at most [`SourceMesh::MAX_UV_SETS`].
    pub uvs: Vec<&'a [[f32; 2]]>,
    /// Named channels.
    pub channels: Vec<SourceChannel<'a>>,
    /// A material for each of the M triangles.
    pub materials: Option<&'a [i32]>,
}

impl<'a> SourceMesh<'a> {
    /// Most UV sets.
    pub const MAX_UV_SETS: usize = 4;

    /// Positions and faces alone.
    pub fn new(positions: Positions<'a>, faces: &'a [[u32; 3]]) -> Self {
        Self {
            positions,
            faces,
            normals: None,
            colors: None,
            uvs: Vec::new(),
            channels: Vec::new(),
            materials: None,
        }
    }
}
