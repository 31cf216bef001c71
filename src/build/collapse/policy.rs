//! What is minimized, and how to collapse.

use glam::DVec3;

/// What is minimized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cost {
    /// Squared distances to the planes around as they are now, weighted by area.
    #[default]
    Memoryless,
    /// Squared distances to all planes that ever were around (Garland and Heckbert 1997).
    GarlandHeckbert,
    /// Squared volumes against the faces around as they are now (Lindstrom and Turk 1998).
    LindstromTurk,
}

/// How to collapse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// What is minimized.
    pub cost: Cost,
    /// Weight of a border against the surface: of squared distance to the plane that stands on it, times its length
    /// squared.
    pub border_weight: f64,
    /// The same for an attribute seam.
    pub crease_weight: f64,
    /// Weight of the squared mean signed distance when a point is placed: keeps the volume.
    pub volume_weight: f64,
    /// Weight of the squared deviation of attributes against squared distance in the cost of a collapse.
    pub attribute_weight: f64,
    /// The same when a point is placed: enough to decide where the shape does not.
    pub attribute_pull: f64,
    /// Weight of the squared deviation of normals, which mostly follow the shape, against that of other attributes.
    /// With 1 the shape of scans is up to a tenth worse and pictures of them at one pixel up to 0.1 dB better.
    pub normal_weight: f64,
    /// Attributes cost less than this part of the mean edge length, however much they deviate.
    pub attribute_limit: f64,
    /// Weight of the squared distances of past collapses at the ends of an edge: keeps errors from adding up.
    pub drift_weight: f64,
    /// Raises costs by the fourth root of the mean squared distance: small parts far off count more, which lowers
    /// the largest deviation and leaves the mean as it is.
    pub even: bool,
    /// Weight of the squared distance that the ends of an edge move: decides where nothing else does.
    pub shape_weight: f64,
    /// Cosine of the largest turn of a face.
    pub turn: f64,
    /// Collapses that make a face thinner than this cost more, unless it was nearly as thin before. Thinness is
    /// twice the area over the sum of squared sides: 0.289 for an equilateral triangle.
    pub thin: f64,
    /// Whether sheets that touch are separated, rings cut, and components removed. Otherwise the topology is kept.
    pub cuts: bool,
    /// Faces that face this direction go on doing so.
    pub up: Option<DVec3>,
    /// Evaluate every edge around a collapse at once; otherwise when it comes to the front of the queue.
    pub eager: bool,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            cost: Cost::default(),
            border_weight: 2.0,
            crease_weight: 0.5,
            volume_weight: 0.0,
            attribute_weight: 0.025,
            attribute_pull: 0.02,
            normal_weight: 0.2,
            attribute_limit: 0.5,
            drift_weight: 0.3,
            even: true,
            shape_weight: 1.0e-9,
            turn: 0.2,
            thin: 0.02,
            cuts: true,
            up: None,
            eager: false,
        }
    }
}

impl Policy {
    /// The power of a length that a cost is.
    pub(super) fn power(&self) -> f64 {
        if self.even { 4.5 } else { 4.0 }
    }

    /// A cost by the mean squared distance behind it: see [`Policy::even`].
    #[inline]
    pub(super) fn evened(&self, cost: f64, squared: f64) -> f64 {
        if self.even { cost * squared.sqrt().sqrt() } else { cost }
    }

    /// What a collapse costs, [`super::Collapsed::cost`], as a length.
    pub fn length_of(&self, cost: f64) -> f64 {
        cost.powf(1.0 / self.power())
    }
}
