//! What a geometry consists of.

/// What the elements of a geometry are. Points and lines are stored as triangles that name a vertex several times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Primitive {
    /// Triangles.
    #[default]
    Triangles,
    /// Discs that face the eye: a vertex three times.
    Points(StrokeSize),
    /// What lies within a radius of a segment, on the picture: its first vertex, and its second twice.
    Lines(StrokeSize),
}

impl Primitive {
    /// The size that triangles have not.
    pub fn size(self) -> Option<StrokeSize> {
        match self {
            Self::Triangles => None,
            Self::Points(size) | Self::Lines(size) => Some(size),
        }
    }
}

/// The radius of points, and half the width of lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StrokeSize {
    /// Pixels, at any distance.
    Pixels(f32),
    /// Units of the world, whatever the pose of an instance scales.
    World(f32),
}
