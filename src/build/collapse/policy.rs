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
    /// The same for an edge across which attributes change.
    pub crease_weight: f64,
    /// Weight of the squared mean signed distance when a point is placed: keeps the volume.
    pub volume_weight: f64,
    /// Weight of the squared deviation of attributes against squared distance in the cost of a collapse.
    pub attribute_weight: f64,
    /// The same where a point is placed: enough to decide where the shape does not.
    pub attribute_pull: f64,
    /// Weight of the squared deviation of normals, which mostly follow the shape, against that of other attributes.
    /// With 1 the shape of scans is up to a tenth worse and pictures of them at one pixel up to 0.1 dB better.
    pub normal_weight: f64,
    /// Attributes cost less than this part of the mean edge length, however much they deviate.
    pub attribute_limit: f64,
    /// Weight of the squared distances that past collapses left at the ends of an edge: keeps them from adding up.
    pub drift_weight: f64,
    /// Raises costs by the fourth root of the mean squared distance: small parts far off count more, which lowers the
    /// largest deviation and leaves the mean as it is.
    pub even: bool,
    /// Weight of the squared distance that the ends of an edge move, whichever way: decides where nothing else does.
    pub shape_weight: f64,
    /// Cosine of the largest turn of a face.
    pub turn: f64,
    /// Collapses that make a face thinner than this wait, area against sides (an equilateral triangle has 0.289), unless
    /// it is so: they cost more, as if they moved the surface by a small part of the length of their edge.
    pub thin: f64,
    /// Whether sheets that touch are taken apart, rings are cut and parts go as a whole. Otherwise the topology is kept.
    pub cuts: bool,
    /// A direction that faces go on facing where they do.
    pub up: Option<DVec3>,
    /// Look at every edge again whose surroundings changed, at once; otherwise when it comes to the front.
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

    /// What a collapse costs, [`Collapsed::cost`], as a length.
    pub fn length_of(&self, cost: f64) -> f64 {
        cost.powf(1.0 / self.power())
    }
}
