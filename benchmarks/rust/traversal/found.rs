//! What a run of a form finds and takes, from what comes back of it.

use nanite_rs::gpu_types::{
    CandidateGroup, Counters, Dispatch, Group, Marks, Node, TraversalItem, VisibleCluster,
};
use nanite_rs::math::Sphere;
use nanite_rs::model::ClusterRecord;

use super::{Form, Forms, INDIRECT_ENTRIES, Room};

/// What one run of a form found and took.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Milliseconds of each of [`INDIRECT_ENTRIES`] by the device's clock; NaN without one.
    pub ms: [f64; 4],
    /// Milliseconds from the submission to the answer, clearing of buffers included.
    pub wall: f64,
    /// Bits of groups, or of parts.
    pub bits: Vec<u32>,
    /// The visible list, in scene order.
    pub visible: Vec<VisibleCluster>,
    /// Nodes looked at, or parts.
    pub nodes: u64,
    /// Groups looked at.
    pub groups: u64,
    /// Groups or parts whose clusters were looked at.
    pub candidates: u64,
    /// Clusters looked at.
    pub clusters: u64,
    /// Of the queue: nodes that lanes walked themselves.
    pub walked: u64,
    /// Of the queue: claims that came to nothing.
    pub idle: u64,
    /// Bytes of what was looked at, each read counted once.
    pub read: u64,
    /// Bytes that the form keeps on the device besides what all need, for this frame's lists.
    pub memory: u64,
}

/// Everything that is copied back, in this order.
pub(super) struct Answer<'a> {
    pub(super) queue: &'a [u8],
    pub(super) counters: &'a [u8],
    pub(super) culling: &'a [u8],
    pub(super) bits: &'a [u8],
    pub(super) visible: &'a [u8],
    pub(super) starts: &'a [u8],
    pub(super) levels: &'a [u8],
    pub(super) ticks: &'a [u8],
}

fn all<T: bytemuck::Pod>(bytes: &[u8]) -> Vec<T> {
    bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
}

/// Bytes of so many of a type.
fn of<T>(count: u64) -> u64 {
    count * size_of::<T>() as u64
}

impl Forms {
    /// What was found, and the lengths that its lists wanted.
    pub(super) fn report(&self, form: Form, answer: &Answer<'_>, wall: f64) -> (Found, Room) {
        let queue: Vec<u32> = all(answer.queue);
        let counters: Counters = bytemuck::pod_read_unaligned(answer.counters);
        let candidates = bytemuck::pod_read_unaligned::<Dispatch>(answer.culling).count;
        let mut visible: Vec<VisibleCluster> = all(answer.visible);
        visible.truncate(counters.visible as usize);
        let bits: Vec<u32> = all(answer.bits);
        let levels: Vec<Dispatch> = all(answer.levels);
        let ticks: Vec<u64> = all(answer.ticks);
        let tick = self.context.tick().unwrap_or(f64::NAN);
        let ms = |step: usize| {
            let ends = ticks.get(2 * step).zip(ticks.get(2 * step + 1));
            ends.map_or(f64::NAN, |(start, end)| end.saturating_sub(*start) as f64 * tick)
        };
        // The first list is that of the instances, which has room for all.
        let widest = levels.iter().skip(1).map(|level| level.count).max().unwrap_or(0);
        let of_levels = |of: fn(&Dispatch) -> u32| levels.iter().map(|level| u64::from(of(level))).sum();
        let of_queue = |k: usize| if form == Form::Queue { u64::from(queue[k]) } else { 0 };
        let (nodes, groups) = match form {
            Form::Levels => (of_levels(|level| level.count), of_levels(|level| level.visited)),
            Form::Queue => (of_queue(4), of_queue(5)),
            Form::Parts => {
                let starts = all::<TraversalItem>(answer.starts).into_iter().take(levels[0].count as usize);
                (starts.map(|start| u64::from(self.part_counts[start.instance as usize])).sum(), 0)
            }
        };
        let clusters = u64::from(counters.visited_clusters);
        let listed = u64::from(candidates);
        let lists = of::<CandidateGroup>(listed) + of::<u32>(listed) + of::<Marks>(listed);
        let words = of::<u32>(bits.len() as u64);
        // Of its group, a cluster of a part reads a sphere and an error.
        let (looked_at, own) = match form {
            Form::Levels => {
                (of::<Node>(nodes) + of::<TraversalItem>(nodes), of::<TraversalItem>(2 * u64::from(widest)))
            }
            Form::Queue => (of::<Node>(nodes) + of::<u32>(nodes), of::<u32>(self.ring.slots.into())),
            Form::Parts => {
                (of::<Group>(nodes) + of::<Sphere>(clusters) + of::<f32>(clusters), self.part_bytes)
            }
        };
        let found = Found {
            ms: std::array::from_fn::<_, { INDIRECT_ENTRIES.len() }, _>(ms),
            wall,
            bits,
            visible,
            nodes,
            groups,
            candidates: listed,
            clusters,
            walked: of_queue(6),
            idle: of_queue(7),
            read: looked_at + of::<Group>(groups) + of::<ClusterRecord>(clusters) + 2 * words + lists,
            memory: own + words + lists,
        };
        (found, Room { items: widest, candidates, visible: counters.visible })
    }
}
