//! The ordered list of stages, written once. Stage `x` is `src/cpu/x.rs`, and `src/gpu/x.rs` with `shaders/x.wgsl`.

/// A stage of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Instances of the scene → instances on the screen.
    InstanceCull,
    /// Hierarchies of instances → groups whose clusters may be drawn.
    NodeCull,
    /// Clusters of groups → clusters to draw, small or large.
    ClusterCull,
    /// Triangles of small clusters → visibility buffer.
    RasterSmall,
    /// Triangles of large and clipped clusters → visibility buffer.
    RasterLarge,
    /// Visibility buffer → depth pyramid for the second pass of the stages before.
    Hzb,
    /// Visibility buffer → pages of shadow maps that its pixels may look up.
    ShadowMark,
    /// Those that are not there → their depths.
    ShadowRaster,
    /// Visibility buffer → colour.
    Shade,
    /// Visibility buffer → depth and the other arrays.
    Output,
}

/// All stages in the order in which they run. When a depth pyramid is built, the stages before it run again over
/// what was deferred, on the CPU in batches.
pub const STAGES: [Stage; 10] = [
    Stage::InstanceCull,
    Stage::NodeCull,
    Stage::ClusterCull,
    Stage::RasterSmall,
    Stage::RasterLarge,
    Stage::Hzb,
    Stage::ShadowMark,
    Stage::ShadowRaster,
    Stage::Shade,
    Stage::Output,
];

impl Stage {
    /// Name of the stage and of its files.
    pub fn name(self) -> &'static str {
        match self {
            Self::InstanceCull => "instance_cull",
            Self::NodeCull => "node_cull",
            Self::ClusterCull => "cluster_cull",
            Self::RasterSmall => "raster_small",
            Self::RasterLarge => "raster_large",
            Self::Hzb => "hzb",
            Self::ShadowMark => "shadow_mark",
            Self::ShadowRaster => "shadow_raster",
            Self::Shade => "shade",
            Self::Output => "output",
        }
    }

    /// The stage of a name.
    pub fn of_name(name: &str) -> Option<Self> {
        STAGES.into_iter().find(|stage| stage.name() == name)
    }

    /// What the stage's `received` and `passed` count.
    pub fn counts(self) -> (&'static str, &'static str) {
        match self {
            Self::InstanceCull => ("instances", "instances"),
            Self::NodeCull => ("nodes and groups", "groups"),
            Self::ClusterCull => ("clusters", "clusters"),
            Self::RasterSmall | Self::RasterLarge => ("triangles", "triangles"),
            Self::Hzb => ("pixels", "texels"),
            Self::ShadowMark => ("pixels", "pages"),
            Self::ShadowRaster => ("pages", "triangles"),
            Self::Shade | Self::Output => ("pixels", "pixels"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stage_has_its_files() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        for (i, stage) in STAGES.iter().enumerate() {
            assert_eq!(*stage as usize, i);
            let name = stage.name();
            let files =
                [format!("src/cpu/{name}.rs"), format!("src/gpu/{name}.rs"), format!("shaders/{name}.wgsl")];
            for file in files {
                assert!(root.join(&file).is_file(), "{file}");
            }
        }
    }
}
