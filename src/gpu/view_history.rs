//! A view: what it keeps on the device between frames, and what of it goes into a submission.

use wgpu::{Buffer, BufferUsages};

use super::buffers::Buffers;
use super::context::Context;
use super::instances::{self, Instances};
use super::lights::Lights;
use super::pyramids::Pyramids;
use super::raster_hardware::Target;
use super::request::{Counted, Drawn, ViewRequest};
use super::shadow_table::ShadowTable;
use crate::error::Result;
use crate::gpu_types::{HISTORY_LIST, Instance, View};

/// What a view keeps on the device between frames.
#[derive(Debug)]
pub(super) struct ViewHistory {
    /// The instances as seen from it, with room for so many slots.
    pub(super) seen: Option<(u32, Buffer)>,
    pub(super) buffers: Option<Buffers>,
    pub(super) pyramids: Pyramids,
    pub(super) lights: Lights,
    /// There once lights threw shadows.
    pub(super) shadow_table: Option<ShadowTable>,
    /// There once the hardware rasterizer has drawn it.
    pub(super) target: Option<Target>,
    /// How instances were arranged when it was last drawn.
    arrangement: u64,
}

impl ViewHistory {
    pub(super) fn new(context: &Context) -> Result<Self> {
        let (pyramids, lights) = (Pyramids::new(context, (0, 0))?, Lights::new(context)?);
        Ok(Self {
            seen: None,
            buffers: None,
            pyramids,
            lights,
            shadow_table: None,
            target: None,
            arrangement: 0,
        })
    }

    /// The side of the viewport of the hardware rasterizer for images of a size; 0 where it draws nothing.
    pub(super) fn viewport(&mut self, context: &Context, size: (u32, u32), hardware: bool) -> Result<u32> {
        if hardware && self.target.as_ref().is_none_or(|target| target.size() != size) {
            self.target = Some(Target::new(context, size)?);
        }
        Ok(self.target.as_ref().filter(|_| hardware).map_or(0, Target::viewport))
    }

    /// Gets ready to draw.
    pub(super) fn prepare(
        &mut self,
        context: &Context,
        instances: &Instances,
        request: &ViewRequest<'_>,
        occlusion: bool,
    ) -> Result<Prepared> {
        self.lights.write(context, request)?;
        let room = instances.room();
        if self.seen.as_ref().is_none_or(|(seen, _)| *seen != room) {
            self.seen = None;
            let bytes = u64::from(room) * size_of::<Instance>() as u64;
            let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            self.seen = Some((room, context.buffer(instances::WHAT, bytes, storage)?));
        }
        let mut view = View {
            instances: instances.len(),
            group_words: instances.group_words(),
            depth_only: request.depth_only.into(),
            ..request.view
        };
        if !occlusion {
            return Ok(Prepared { view, culling: false, pyramid: false, alike: false });
        }
        let size = (view.width, view.height);
        if self.pyramids.size() != size {
            self.pyramids = Pyramids::new(context, size)?;
        }
        let (pyramid, alike) = self.pyramids.recall(&mut view);
        let before = std::mem::replace(&mut self.arrangement, instances.arrangement());
        let culling = !self.pyramids.paused();
        view.two_passes = culling.into();
        Ok(Prepared { view, culling, pyramid, alike: alike && before == instances.arrangement() })
    }

    /// Takes in that a frame was drawn, with culling or without.
    pub(super) fn remember(&mut self, view: &View, drawn: &Drawn, culling: bool, occlusion: bool) {
        let mut both = false;
        if culling {
            let counters = drawn.cull_passes.iter().map(|cull_pass| cull_pass.counters);
            let built = counters.clone().any(|c| c.pyramid != 0);
            let hidden =
                |cull_pass: &Counted| cull_pass.hidden_instances + u64::from(cull_pass.counters.occluded);
            let hidden = drawn.cull_passes.get(1).map_or(0, hidden);
            // Where the first pass built one, the second walked.
            both = drawn.cull_passes.first().is_some_and(|first| first.counters.pyramid != 0);
            self.pyramids.remember(view, counters.map(|c| c.triangles()).sum(), hidden, built);
        } else if occlusion {
            self.pyramids.wait();
        }
        self.buffers.iter_mut().for_each(|buffers| buffers.keep_list(both));
    }
}

/// A view that is ready to be drawn.
pub(super) struct Prepared {
    pub(super) view: View,
    /// It culls what is hidden.
    pub(super) culling: bool,
    /// There is a pyramid of an earlier frame.
    pyramid: bool,
    /// It shows much the same as the frame before, of the same instances.
    alike: bool,
}

impl Prepared {
    /// Decides what the frame starts from, see [`View::history`]: the list of the frame before that these buffers hold, a
    /// pyramid, or nothing.
    pub(super) fn start(&mut self, buffers: &Buffers) {
        self.view.history = match (self.pyramid, self.alike && buffers.listed) {
            (true, true) => HISTORY_LIST,
            (pyramid, _) => pyramid.into(),
        };
    }
}

/// A view in a submission.
pub(super) struct SubmittedView<'a> {
    pub(super) view: &'a View,
    pub(super) culling: bool,
    pub(super) seen: &'a Buffer,
    pub(super) buffers: &'a Buffers,
    pub(super) history: &'a ViewHistory,
}
