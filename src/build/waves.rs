//! A built mesh that follows waves: how far its clusters go at most, and errors, spheres and boxes of groups that hold at all
//! times. The proof stands in docs/numerics.md.

use std::f64::consts::TAU;
use std::sync::Arc;

use rayon::prelude::*;

use super::pose::{COORDINATE_ROUNDING, GroupParts, Moved, ROUNDING};
use super::rows::{Rows, VALUE_ROUNDING, Vertices, groups_below, made_from_groups};
use crate::error::{Error, Result};
use crate::math::sphere::round_up;
use crate::math::{Aabb, Sphere};
use crate::mesh::frame;
use crate::model::pose::moved_table;
use crate::model::skin::{Influence, Lists};
use crate::model::waves::Sway;
use crate::model::{
    ChannelType, ClusterAddress, CoordinateFrame, Dag, GeometryId, Group, InterruptCheck, Motion, Pose, Wave,
    Waves,
};

/// Phases beyond this many turns are no phases, and lose what f32 has of a turn.
const MOST_TURNS: f64 = 4096.0;

/// A wave as a caller gives it, object units.
#[derive(Clone, Debug)]
pub struct WaveDesc {
    /// What it does to a vertex of weight 1.
    pub wave: Wave,
    /// The channel of weights, 1 without one.
    pub weight: Option<String>,
    /// The channel of phases, turns; 0 without one.
    pub phase: Option<String>,
}

/// Reads what waves need of a mesh, and its pages. Returns it as it is at time 0.
pub fn waves(dag: &Dag, waves: &[WaveDesc], proceed: InterruptCheck<'_>) -> Result<(Arc<Waves>, Dag)> {
    let columns = waves
        .iter()
        .map(|wave| Ok([column(dag, wave.weight.as_deref())?, column(dag, wave.phase.as_deref())?]))
        .collect::<Result<Vec<_>>>()?;
    dag.pages.load_all(proceed)?;
    let vertices = Vertices::of(dag);
    let mut given: Vec<Vec<Influence>> = Vec::with_capacity(dag.vertex_count as usize);
    for id in 0..dag.vertex_count as usize {
        let values = columns
            .iter()
            .flat_map(|[weight, phase]| [of_column(weight, id, 1.0), of_column(phase, id, 0.0)]);
        given.push(
            (0..).zip(values).map(|(column, value)| Influence { joint: column, weight: value }).collect(),
        );
    }
    vertices.join(&mut given);
    let rows = given.iter().flat_map(|row| row.chunks_exact(2).map(|pair| [pair[0].weight, pair[1].weight]));
    let rows: Vec<[f32; 2]> = rows.collect();
    let scale = dag.frame.scale;
    let inner = |wave: &WaveDesc| Wave {
        amplitude: wave.wave.amplitude.map(|x| x / scale),
        vector: wave.wave.vector.map(|x| x * scale),
        ..wave.wave
    };
    let offset = |wave: &WaveDesc| {
        let turns: f64 = (0..3).map(|k| wave.wave.vector[k] * dag.frame.origin[k]).sum();
        turns.rem_euclid(1.0)
    };
    let swaying = Swaying {
        dag,
        positions: &vertices.positions,
        waves: waves.iter().map(inner).collect(),
        rows: &rows,
    };
    swaying.measured(waves.iter().map(offset).collect(), &columns, proceed)
}

/// The mesh at a time, seconds; `moved` is that of any time.
pub fn at(waves: &Arc<Waves>, moved: &Dag, time: f64) -> Dag {
    let sway = Sway::at(Arc::clone(waves), time);
    let pose = Pose::new(Motion::Sway(sway), moved.cluster_count());
    Dag { id: GeometryId::default(), pose: Some(Arc::new(pose)), ..moved.clone() }
}

/// The words of a channel of one column.
fn column<'a>(dag: &'a Dag, name: Option<&str>) -> Result<Option<&'a [u32]>> {
    let Some(name) = name else { return Ok(None) };
    let wrong = |message: String| Err(Error::argument("waves", message));
    let Some(channel) = dag.channels.iter().find(|known| known.info.name == name) else {
        return wrong(format!("the mesh has no channel {name:?}"));
    };
    if channel.info.dtype != ChannelType::Float32 || channel.info.width() != 1 {
        let (width, dtype) = (channel.info.width(), channel.info.dtype.name());
        return wrong(format!("channel {name:?}: expected one column of float32, found {width} of {dtype}"));
    }
    Ok(Some(channel.words.load()?))
}

fn of_column(words: &Option<&[u32]>, id: usize, otherwise: f32) -> f32 {
    words.map_or(otherwise, |words| f32::from_bits(words[id]))
}

/// A length.
fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A mesh with waves, internal units.
struct Swaying<'a> {
    dag: &'a Dag,
    positions: &'a [[f32; 3]],
    waves: Vec<Wave>,
    /// By identity, of each wave the weight and the phase.
    rows: &'a [[f32; 2]],
}

/// What is so of a group and of all below. Lengths, rounded up.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    /// Each point of the source has one of what was made from the group no farther off than this, whose channels move it no
    /// more than `deviation` elsewhere; and the other way round.
    reach: f64,
    deviation: f64,
    /// How far what is drawn of triangles lies off the moved surface: of the source, and of what was made.
    bends: [f64; 2],
    /// How far any vertex goes.
    largest: f64,
}

impl Swaying<'_> {
    /// Of each wave the weight and the phase of an identity.
    fn row(&self, id: u32) -> &[[f32; 2]] {
        &self.rows[id as usize * self.waves.len()..][..self.waves.len()]
    }

    /// How far an identity goes at most along each axis.
    fn reach(&self, id: u32) -> [f64; 3] {
        let parts = || self.waves.iter().zip(self.row(id));
        std::array::from_fn(|k| parts().map(|(wave, [w, _])| (wave.amplitude[k] * f64::from(*w)).abs()).sum())
    }

    /// How far vertices of a cluster go at most, along each axis and at all.
    fn cluster_reach(&self, at: ClusterAddress) -> ([f32; 3], f64) {
        let (mut axes, mut largest) = ([0f64; 3], 0f64);
        for id in self.dag.pages.geometry(at).ids.iter() {
            let reach = self.reach(id);
            (0..3).for_each(|k| axes[k] = axes[k].max(reach[k]));
            let parts = self.waves.iter().zip(self.row(id));
            largest =
                largest.max(parts.map(|(wave, [w, _])| length(wave.amplitude) * f64::from(w.abs())).sum());
        }
        (axes.map(|x| round_up(x * (1.0 + ROUNDING))), largest * (1.0 + ROUNDING))
    }

    /// How far what is drawn of a triangle of a cluster, between its moved corners, lies off its moved points.
    fn bend(&self, at: ClusterAddress) -> f64 {
        let geometry = self.dag.pages.geometry(at);
        let ids: Vec<u32> = geometry.ids.iter().collect();
        let amplitudes: Vec<f64> = self.waves.iter().map(|wave| length(wave.amplitude)).collect();
        let phase = |id: u32, k: usize| {
            let p = self.positions[id as usize];
            let along: f64 = (0..3).map(|j| self.waves[k].vector[j] * f64::from(p[j])).sum();
            f64::from(self.row(id)[k][1]) + along
        };
        let range = |values: [f64; 3]| {
            let [least, most] = [f64::min, f64::max].map(|of| of(of(values[0], values[1]), values[2]));
            most - least
        };
        let mut farthest = 0f64;
        for triangle in geometry.triangles.iter() {
            let corners = triangle.map(|v| ids[usize::from(v)]);
            let parts = amplitudes.iter().enumerate().map(|(k, amplitude)| {
                let weights = corners.map(|id| f64::from(self.row(id)[k][0]));
                let weight = weights.iter().fold(0f64, |most, w| most.max(w.abs()));
                let (apart, turned) = (range(weights), TAU * range(corners.map(|id| phase(id, k))));
                let first = 0.5 * (apart + weight * turned);
                let second = 0.125 * (2.0 * apart * turned + weight * turned * turned);
                amplitude * first.min(second).min(2.0 * weight)
            });
            farthest = farthest.max(parts.sum());
        }
        farthest * (1.0 + ROUNDING)
    }

    /// Columns of lengths whose differences bound how far channels move points apart, as parts of `unit`.
    fn columns(&self, given: &[[Option<&[u32]>; 2]], weights: &[f64], unit: f64) -> Lists<Influence> {
        let row = |id: u32| {
            let values = self.row(id).iter().enumerate().flat_map(|(k, [weight, phase])| {
                let by = length(self.waves[k].amplitude) / unit;
                let value = [by * f64::from(*weight), by * TAU * weights[k] * f64::from(*phase)];
                // What is the same everywhere deviates nowhere.
                (0..2).filter(move |j| given[k][*j].is_some()).map(move |j| (2 * k + j, value[j]))
            });
            let influence =
                |(column, value): (usize, f64)| Influence { joint: column as u32, weight: value as f32 };
            values.map(influence).collect::<Vec<_>>()
        };
        (0..self.dag.vertex_count).map(row).collect()
    }

    fn measured(
        self,
        offsets: Vec<f64>,
        given: &[[Option<&[u32]>; 2]],
        proceed: InterruptCheck<'_>,
    ) -> Result<(Arc<Waves>, Dag)> {
        let dag = self.dag;
        let addresses: Vec<ClusterAddress> = dag.pages.addresses().collect();
        let reaches: Vec<([f32; 3], f64)> = addresses.par_iter().map(|at| self.cluster_reach(*at)).collect();
        let bends: Vec<f64> = addresses.par_iter().map(|at| self.bend(*at)).collect();
        let largest = reaches.iter().fold(0.0, |most: f64, (_, reach)| most.max(*reach));
        let mut weights = vec![0f64; self.waves.len()];
        let mut phases = weights.clone();
        for row in self.rows.chunks_exact(self.waves.len().max(1)) {
            for (k, [weight, phase]) in row.iter().enumerate() {
                weights[k] = weights[k].max(f64::from(weight.abs()));
                phases[k] = phases[k].max(f64::from(phase.abs()));
            }
        }
        if let Some(k) = phases.iter().position(|phase| *phase > MOST_TURNS) {
            let message = format!("wave {k} has an offset of {} turns, more than {MOST_TURNS}", phases[k]);
            return Err(Error::argument("waves", message));
        }
        // How much the displacement grows with position, as a part of it.
        let slope =
            |(wave, weight): (&Wave, &f64)| TAU * length(wave.amplitude) * weight * length(wave.vector);
        let lipschitz = self.waves.iter().zip(&weights).map(slope).sum::<f64>() * (1.0 + ROUNDING);
        let (mut reach, mut low, mut high) = ([0f32; 3], [f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (at, (own, _)) in addresses.iter().zip(&reaches).filter(|(at, _)| dag.record(**at).level == 0) {
            let record = dag.record(*at);
            for k in 0..3 {
                let (center, extent) =
                    (f64::from(record.center[k]), f64::from(record.extent[k]) + f64::from(own[k]));
                (low[k], high[k]) = (low[k].min(center - extent), high[k].max(center + extent));
                reach[k] = reach[k].max(own[k]);
            }
        }
        let farthest = low.iter().chain(&high).fold(0.0, |most: f64, x| most.max(x.abs())) * dag.frame.scale;
        if !(farthest.is_finite() && lipschitz.is_finite()) {
            let message = "they take the mesh beyond what float64 holds".to_owned();
            return Err(Error::argument("waves", message));
        }
        let scale = frame::power_of_two_above(farthest).max(dag.frame.scale);
        let ratio = dag.frame.scale / scale;
        let turn_rounding = (0..self.waves.len()).map(|k| {
            let wave = &self.waves[k];
            let turns = 2.0 + phases[k] + 2.0 * length(wave.vector);
            TAU * length(wave.amplitude) * weights[k] * turns * 8.0 * f64::EPSILON
        });
        let rounding = dag.rounding() * (1.0 + lipschitz)
            + turn_rounding.sum::<f64>() * dag.frame.scale
            + 3f64.sqrt() * scale * COORDINATE_ROUNDING;
        let frame = CoordinateFrame { scale, rounding: rounding * (1.0 + ROUNDING), ..dag.frame };
        let waves = Arc::new(Waves {
            offsets,
            rows: self.rows.to_vec(),
            reach: reaches.iter().map(|(reach, _)| *reach).collect(),
            ratio,
            table: moved_table(&dag.pages),
            largest: largest * dag.frame.scale,
            lipschitz,
            topology: Arc::default(),
            waves: self.waves.clone(),
        });
        let below = groups_below(dag);
        if !proceed() {
            return Err(Error::Cancelled);
        }
        let known = self.known(&below, given, &weights, &reaches, &bends);
        let outwards = |x: f64| round_up(x * ratio * (1.0 + ROUNDING));
        let part = |(group, known): (&Group, &Known)| {
            let Known { reach, deviation, bends, largest } = *known;
            // Either what corresponds for the channels counts, or what is nearest, whatever its channels.
            let moved = |distance: f64| {
                let corresponds = reach.max(distance) * (1.0 + lipschitz) + deviation;
                corresponds.min(distance + 2.0 * largest) + bends[0] + bends[1]
            };
            let attribute_error = outwards(f64::from(group.attribute_error) * (1.0 + lipschitz));
            let sphere = Sphere {
                center: group.lod_sphere.center.map(|x| (f64::from(x) * ratio) as f32),
                radius: outwards(f64::from(group.lod_sphere.radius) + largest),
            };
            let axes = group.members().fold([0f32; 3], |most, at| {
                let own = waves.reach[dag.pages.dense_index(at)];
                std::array::from_fn(|k| most[k].max(own[k]))
            });
            GroupParts {
                bounds: waves.grown(group.center.map(f64::from), group.extent.map(f64::from), axes),
                sphere,
                error: outwards(moved(group.distance().into())).max(attribute_error),
                bound: outwards(moved(group.bound.into())),
                quadric: outwards(moved(group.quadric.into())),
                attribute_error,
            }
        };
        let parts = dag.groups.iter().zip(&known).map(part).collect();
        let bounds = Aabb {
            min: std::array::from_fn(|k| ((low[k] * ratio) as f32).next_down()),
            max: std::array::from_fn(|k| ((high[k] * ratio) as f32).next_up()),
        };
        let moved = Moved { frame, bounds, topology: Arc::clone(&waves.topology), parts };
        let motion = Motion::Sway(Sway::at(Arc::clone(&waves), 0.0));
        let moved = moved.dag(dag, &below, motion);
        Ok((waves, moved))
    }

    /// What is so of each group and of all below.
    fn known(
        &self,
        below: &Lists<u32>,
        given: &[[Option<&[u32]>; 2]],
        weights: &[f64],
        reaches: &[([f32; 3], f64)],
        bends: &[f64],
    ) -> Vec<Known> {
        let dag = self.dag;
        let largest = reaches.iter().fold(0.0, |most: f64, (_, reach)| most.max(*reach));
        // A mesh that does not move deviates nowhere.
        let unit = if largest > 0.0 { largest } else { 1.0 };
        let columns = self.columns(given, weights, unit);
        let rows = Rows { dag, positions: self.positions, rows: &columns };
        let made = made_from_groups(dag);
        let step = |(group, made): (&Group, &Vec<ClusterAddress>)| {
            if made.is_empty() {
                return (0.0, 0.0);
            }
            let (step, count) = rows.step(group, made);
            // The sum of differences is at most the root of their number times the root of the sum of their squares.
            let count = count as f64;
            let deviation =
                if count == 0.0 { 0.0 } else { count.sqrt() * step.deviation + count * VALUE_ROUNDING };
            (step.reach, unit * deviation * (1.0 + VALUE_ROUNDING))
        };
        let steps: Vec<(f64, f64)> = dag.groups.par_iter().zip(&made).with_max_len(1).map(step).collect();
        let mut out = vec![Known::default(); dag.groups.len()];
        // Finer groups come later: what is below a group is known before it.
        for g in (0..dag.groups.len()).rev() {
            let mut known = Known::default();
            for at in dag.groups[g].members() {
                let number = dag.pages.dense_index(at);
                known.largest = known.largest.max(reaches[number].1);
                if dag.record(at).level == 0 {
                    known.bends[0] = known.bends[0].max(bends[number]);
                }
            }
            for number in made[g].iter().map(|at| dag.pages.dense_index(*at)) {
                known.largest = known.largest.max(reaches[number].1);
                known.bends[1] = known.bends[1].max(bends[number]);
            }
            for below in below.of(g).iter().map(|below| &out[*below as usize]) {
                (known.reach, known.deviation) =
                    (known.reach.max(below.reach), known.deviation.max(below.deviation));
                (0..2).for_each(|k| known.bends[k] = known.bends[k].max(below.bends[k]));
                known.largest = known.largest.max(below.largest);
            }
            known.reach += steps[g].0;
            known.deviation += steps[g].1;
            out[g] = known;
        }
        out
    }
}
