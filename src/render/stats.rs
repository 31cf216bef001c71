//! What a frame cost and skipped.

use std::fmt;

use crate::config::Raster;
use crate::stages::Stage;
use crate::stream::StreamStats;

/// One stage of one pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageStats {
    /// The stage.
    pub stage: Stage,
    /// The pass: 1, or 2 for what was deferred until there was a depth pyramid of this frame. On the CPU the second pass has
    /// several batches, which count as one.
    pub pass: u8,
    /// What came in; [`Stage::counts`] says of what.
    pub received: u64,
    /// What went out.
    pub passed: u64,
    /// Milliseconds: wall time, or that of the device's clock on a GPU; NaN where it has none.
    pub ms: f64,
}

/// A cascade of a view that shows something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cascade {
    /// Which of the view's lights.
    pub light: usize,
    /// Where it begins and ends: distances from the camera.
    pub range: [f32; 2],
    /// A texel, world units.
    pub texel: f32,
}

/// What shadows cost: of all views of a call together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadowStats {
    /// Pages that pixels look up.
    pub wanted: u64,
    /// Those of them that were not there and were drawn.
    pub drawn: u64,
    /// Pages that were dropped since something in them changed.
    pub invalidated: u64,
    /// Pages that were dropped for want of room.
    pub evicted: u64,
    /// Pages that are kept for the next frame.
    pub kept: u64,
    /// Clusters drawn into pages; one that touches several counts for each.
    pub clusters: u64,
    /// Their triangles.
    pub triangles: u64,
    /// Instances that cast nothing that is looked up in cascades, or that others hide from the light; once for each cascade.
    pub culled_instances: u64,
    /// Clusters of others of which the same is true, and in virtual pages those that others hide; once for each page.
    pub culled_clusters: u64,
    /// The cascades of each light that has any: of this view alone.
    pub cascades: Vec<Cascade>,
    /// Levels by which texels are larger than pixels, since the pages had no room.
    pub coarser: u32,
    /// Finding what pixels look up, milliseconds.
    pub mark_ms: f64,
    /// Drawing pages.
    pub draw_ms: f64,
}

/// What was made of instances of assemblies: for all views of a call together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AssemblyStats {
    /// Assemblies that were looked at: instances of the scene, and those inside of others that were taken apart.
    pub walked: u64,
    /// Those of them that lie outside of all views.
    pub outside: u64,
    /// Those that one mesh stands for in some view.
    pub far: u64,
    /// Those that were taken apart.
    pub expanded: u64,
    /// Instances that the latter gave to the stages.
    pub parts: u64,
    /// Of these, what was not there in the frame before.
    pub changed: u64,
    /// Time of all that, milliseconds.
    pub ms: f64,
}

/// Everything a frame reports.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// In the order in which they first ran.
    pub stages: Vec<StageStats>,
    /// Triangles of all visible instances at full detail.
    pub source_triangles: u64,
    /// Clusters of the visible list.
    pub clusters: u64,
    /// Triangles of those clusters.
    pub triangles: u64,
    /// Triangles that faced the eye and could reach a pixel, by the small rasterizer.
    pub drawn_small: u64,
    /// The same by the large one.
    pub drawn_large: u64,
    /// Of both, those that a device's own rasterizer drew.
    pub drawn_hardware: u64,
    /// Pixels that show a surface.
    pub covered_pixels: u64,
    /// Instances that the depth pyramid hid.
    pub occluded_instances: u64,
    /// Clusters that passed every other test, and that the depth pyramid then hid.
    pub occluded_clusters: u64,
    /// Bytes of instances that were written to a device, because they changed.
    pub uploaded_bytes: u64,
    /// Bytes of meshes that were written to a device: of new ones and pages that came all, of those that moved where their
    /// vertices are.
    pub uploaded_mesh_bytes: u64,
    /// Images of textures that lack their largest levels on a device, since it has no room for them.
    pub reduced_images: u64,
    /// Layers of blended surfaces.
    pub layers: u64,
    /// Pixels where more of them lie behind the last layer.
    pub layers_left: u64,
    /// Which rasterizers drew: on a GPU never `Auto`, on the CPU always `Compute`.
    pub raster: Raster,
    /// What streaming did, where meshes are streamed.
    pub stream: Option<StreamStats>,
    /// What shadows cost, where there are any.
    pub shadows: Option<ShadowStats>,
    /// What became of assemblies, where there are any.
    pub assemblies: Option<AssemblyStats>,
    /// Samples of each pixel's colour. Stages are those of all passes together: of the one through pixel centres, and of one
    /// for each sample where there are several. The totals are of the first.
    pub samples: u32,
    /// Wall time of the whole frame, milliseconds.
    pub total_ms: f64,
}

impl FrameStats {
    /// Adds stages of another frame.
    pub(super) fn add(&mut self, stages: &[StageStats]) {
        for &other in stages {
            let StageStats { stage, pass, received, passed, ms } = other;
            match self.stages.iter_mut().find(|s| s.stage == stage && s.pass == pass) {
                Some(s) => {
                    (s.received, s.passed, s.ms) = (s.received + received, s.passed + passed, s.ms + ms)
                }
                None => self.stages.push(other),
            }
        }
    }

    /// Runs a stage and takes its time; `work` returns its result with the counts received and passed.
    pub(super) fn time<T>(&mut self, stage: Stage, pass: u8, work: impl FnOnce() -> (T, u64, u64)) -> T {
        let start = std::time::Instant::now();
        let (result, received, passed) = work();
        let ms = start.elapsed().as_secs_f64() * 1e3;
        self.add(&[StageStats { stage, pass, received, passed, ms }]);
        result
    }
}

impl fmt::Display for FrameStats {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<14} {:>4} {:>13} {:>13} {:>9}", "stage", "pass", "received", "passed", "ms")?;
        for s in &self.stages {
            let (stage, ms) = (s.stage.name(), s.ms);
            writeln!(f, "{stage:<14} {:>4} {:>13} {:>13} {ms:>9.3}", s.pass, s.received, s.passed)?;
        }
        writeln!(f, "{:<14} {:>4} {:>13} {:>13} {:>9.3}", "frame", "", "", "", self.total_ms)?;
        write!(
            f,
            "triangles: {} in the source, {} in the cut's clusters, {} rasterized small, {} large; {} pixels covered",
            self.source_triangles, self.triangles, self.drawn_small, self.drawn_large, self.covered_pixels
        )
    }
}
