//! How long stages take on the device: a timestamp before and after each pass of one.

use wgpu::{
    Buffer, BufferUsages, CommandEncoder, ComputePassTimestampWrites, QuerySet, QuerySetDescriptor,
    QueryType, RenderPassTimestampWrites,
};

use super::context::Context;
use crate::error::Result;

/// Passes of a frame at most: six stages in two passes, the first of them in one; those that draw may take two each, and
/// large triangles twice as many; then shading, and other arrays in three.
const PASSES: u32 = 6 + 5 + 4 + 4 + 4;
/// Timestamps of a pass: before and after.
const ENDS: u32 = 2;

/// The timestamps of a frame.
#[derive(Debug)]
pub(super) struct Times {
    /// Absent where the device takes none.
    set: Option<QuerySet>,
    ticks: Buffer,
}

impl Times {
    /// Bytes of [`Times::ticks`].
    pub(super) const BYTES: u64 = (PASSES * ENDS) as u64 * size_of::<u64>() as u64;

    pub(super) fn new(context: &Context) -> Result<Self> {
        let descriptor =
            QuerySetDescriptor { label: Some("times"), ty: QueryType::Timestamp, count: PASSES * ENDS };
        let set = context.tick().map(|_| context.device().create_query_set(&descriptor));
        let ticks =
            context.buffer("times", Self::BYTES, BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC)?;
        Ok(Self { set, ticks })
    }

    /// What pass `number` writes.
    pub(super) fn of_pass(&self, number: u32) -> Option<ComputePassTimestampWrites<'_>> {
        self.set.as_ref().map(|query_set| ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(number * ENDS),
            end_of_pass_write_index: Some(number * ENDS + 1),
        })
    }

    /// The same for passes that draw: for the first and the last of those that count as one.
    pub(super) fn of_draw(
        &self,
        number: u32,
        first: bool,
        last: bool,
    ) -> Option<RenderPassTimestampWrites<'_>> {
        let compute = self.of_pass(number).filter(|_| first || last)?;
        Some(RenderPassTimestampWrites {
            query_set: compute.query_set,
            beginning_of_pass_write_index: compute.beginning_of_pass_write_index.filter(|_| first),
            end_of_pass_write_index: compute.end_of_pass_write_index.filter(|_| last),
        })
    }

    /// Makes the timestamps of so many passes readable.
    pub(super) fn resolve(&self, encoder: &mut CommandEncoder, passes: u32) {
        if let Some(set) = &self.set {
            encoder.resolve_query_set(set, 0..passes * ENDS, &self.ticks, 0);
        }
    }

    /// Device ticks before and after each pass.
    pub(super) fn ticks(&self) -> &Buffer {
        &self.ticks
    }
}

/// Milliseconds of each pass, from the ticks read back; NaN where the device takes no time.
pub(super) fn milliseconds(ticks: &[u8], tick: Option<f64>) -> impl Iterator<Item = f64> {
    let passes = ticks.chunks_exact(ENDS as usize * size_of::<u64>());
    passes.map(move |ends| {
        let [start, end]: [u64; 2] = bytemuck::pod_read_unaligned(ends);
        // Some drivers set their clock back between passes.
        tick.map_or(f64::NAN, |tick| end.saturating_sub(start) as f64 * tick)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_become_milliseconds() {
        let ticks: [u64; 6] = [10, 20, 100, 140, 400, 390];
        let found = |tick| milliseconds(bytemuck::cast_slice(&ticks), tick).collect::<Vec<_>>();
        assert_eq!(found(Some(0.5)), [5.0, 20.0, 0.0]);
        assert!(found(None).iter().all(|ms| ms.is_nan()));
    }
}
