//! Meshes whose vertices follow waves: a displacement of each vertex from its channels and the time, known as world position
//! offset. A vertex at x with weights w and phases p goes to x + Σ aₖ wₖ sin 2π (fₖ t + pₖ + κₖ · x).

use std::f64::consts::TAU;
use std::sync::Arc;

use super::geometry::GeometryId;
use super::page::PageEntry;
use crate::math::Aabb;

/// A wave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// How far a vertex of weight 1 goes at most, and which way.
    pub amplitude: [f64; 3],
    /// Turns per second.
    pub frequency: f64,
    /// Turns per unit of length, along each axis.
    pub vector: [f64; 3],
}

/// Waves that move a mesh. All lengths in internal units at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Waves {
    /// Each.
    pub waves: Vec<Wave>,
    /// Turns of each at the internal origin at time 0.
    pub offsets: Vec<f64>,
    /// By vertex identity, of each wave the weight and the phase, turns.
    pub rows: Vec<[f32; 2]>,
    /// By cluster in page order, how far a vertex goes at most along each axis, rounded up.
    pub reach: Vec<[f32; 3]>,
    /// From internal units at rest to those of the moved mesh, a power of two.
    pub ratio: f64,
    /// The pages with clusters that may lie anywhere.
    pub table: Vec<PageEntry>,
    /// How far any vertex goes at most, object units, rounded up.
    pub largest: f64,
    /// How much farther apart two points of the same channels may be at any time, as a part of their distance; rounded up.
    pub lipschitz: f64,
    /// One for all times.
    pub topology: Arc<GeometryId>,
}

/// Waves at a time.
#[derive(Clone, Debug)]
pub struct Sway {
    /// What moves.
    pub waves: Arc<Waves>,
    /// Turns of each wave at the internal origin: 0 to 1.
    pub turns: Vec<f64>,
}

impl Sway {
    /// At a time, seconds.
    pub fn at(waves: Arc<Waves>, time: f64) -> Self {
        let turn = |(wave, offset): (&Wave, &f64)| {
            ((wave.frequency * time).rem_euclid(1.0) + offset).rem_euclid(1.0)
        };
        let turns = waves.waves.iter().zip(&waves.offsets).map(turn).collect();
        Self { waves, turns }
    }

    /// Where an identity goes from a position at rest.
    #[inline]
    pub fn vertex(&self, id: u32, position: [f64; 3]) -> [f64; 3] {
        let Waves { waves, rows, ratio, .. } = &*self.waves;
        let mut out = position;
        let rows = &rows[id as usize * waves.len()..][..waves.len()];
        for ((wave, turn), [weight, phase]) in waves.iter().zip(&self.turns).zip(rows) {
            let [x, y, z] = wave.vector;
            let along = x * position[0] + y * position[1] + z * position[2];
            let by = f64::from(*weight) * (TAU * (turn + f64::from(*phase) + along).rem_euclid(1.0)).sin();
            (0..3).for_each(|k| out[k] += by * wave.amplitude[k]);
        }
        out.map(|x| x * ratio)
    }

    /// The box around a cluster, by number in page order, from the box at rest: the same at all times. Rounded outwards.
    pub fn cluster_box(&self, number: usize, center: [f64; 3], extent: [f64; 3]) -> Aabb {
        self.waves.grown(center, extent, self.waves.reach[number])
    }
}

impl Waves {
    /// A box at rest, grown by how far vertices go and by what rounding adds to it.
    pub fn grown(&self, center: [f64; 3], extent: [f64; 3], reach: [f32; 3]) -> Aabb {
        // Of some sums of f64.
        const ROUNDING: f64 = 1.0e-14;
        let by: [f64; 3] = std::array::from_fn(|k| {
            let reach = extent[k] + f64::from(reach[k]);
            (reach + ROUNDING * (center[k].abs() + reach)) * self.ratio
        });
        let at = center.map(|x| x * self.ratio);
        Aabb {
            min: std::array::from_fn(|k| ((at[k] - by[k]) as f32).next_down()),
            max: std::array::from_fn(|k| ((at[k] + by[k]) as f32).next_up()),
        }
    }
}

/// Waves at the same time, of the same mesh.
impl PartialEq for Sway {
    fn eq(&self, other: &Self) -> bool {
        self.turns == other.turns && (Arc::ptr_eq(&self.waves, &other.waves) || self.waves == other.waves)
    }
}
