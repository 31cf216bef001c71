//! Options with their units and defaults.

use crate::error::{Error, Result};
use crate::limits::{
    CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, GROUP_MAX_CLUSTERS, MAX_LAYERS, SHADOW_SAMPLES_MAX,
};
use crate::stages::Stage;

/// The choice of that name; the error names all.
fn choose<T: Copy>(argument: &'static str, name: &str, choices: &[(&str, T)]) -> Result<T> {
    let found = choices.iter().find(|(choice, _)| *choice == name).map(|(_, value)| *value);
    found.ok_or_else(|| {
        let quoted: Vec<String> = choices.iter().map(|(choice, _)| format!("{choice:?}")).collect();
        let (last, others) =
            quoted.split_last().map_or(("", &[][..]), |(last, others)| (last.as_str(), others));
        Error::argument(argument, format!("must be {} or {last}, not {name:?}", others.join(", ")))
    })
}

/// What splits triangles into clusters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clusterizer {
    /// Our own: halves at medians. Full clusters, a quarter less build time than with `Flex`, cuts as good.
    #[default]
    Median,
    /// meshoptimizer's: grows clusters along the surface.
    Flex,
    /// METIS: cuts the fewest edges of the graph of triangles. Building takes about twice as long as with `Median`.
    #[cfg(feature = "metis")]
    Metis,
}

impl std::str::FromStr for Clusterizer {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let choices = [
            ("median", Self::Median),
            ("flex", Self::Flex),
            #[cfg(feature = "metis")]
            ("metis", Self::Metis),
        ];
        choose("clusterizer", name, &choices)
    }
}

/// What gathers clusters into groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Partition {
    /// meshoptimizer's: merges neighbours.
    #[default]
    Meshopt,
    /// METIS: cuts little of the border that clusters share.
    #[cfg(feature = "metis")]
    Metis,
}

impl std::str::FromStr for Partition {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let choices = [
            ("meshopt", Self::Meshopt),
            #[cfg(feature = "metis")]
            ("metis", Self::Metis),
        ];
        choose("partition", name, &choices)
    }
}

/// What simplifies groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// meshoptimizer's simplifier: for hurry.
    Fast,
    /// Edge collapse with a queue and memoryless quadrics: less error at the same size for more time.
    #[default]
    Best,
}

impl std::str::FromStr for Quality {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        choose("quality", name, &[("fast", Self::Fast), ("best", Self::Best)])
    }
}

/// How the error of a simplification is found. Both are at least the simplifier's own estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ErrorMeasure {
    /// The simplifier's own estimate, which is often exceeded. Costs nothing.
    Quadric,
    /// A proven bound for every point of both surfaces.
    #[default]
    Bound,
}

impl std::str::FromStr for ErrorMeasure {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        choose("error", name, &[("quadric", Self::Quadric), ("bound", Self::Bound)])
    }
}

/// Which levels of detail are built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Levels {
    /// The source alone: for what is too small for levels, or changes too often.
    One,
    /// Down to a few triangles.
    #[default]
    All,
}

/// How a mesh is built.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// Triangles per cluster, 16 to 128.
    pub cluster_triangles: usize,
    /// Vertices per cluster, 32 to 255.
    pub cluster_vertices: usize,
    /// What splits triangles into clusters.
    pub clusterizer: Clusterizer,
    /// What gathers clusters into groups.
    pub partition: Partition,
    /// Clusters a group aims at, 4 to 24. Groups may grow by a third to take in stragglers.
    pub group_clusters: usize,
    /// What simplifies groups.
    pub quality: Quality,
    /// How errors are found.
    pub error: ErrorMeasure,
    /// Weight of a unit of normal deviation against one mean edge length of distance.
    pub normal_weight: f32,
    /// Weight of a unit of colour (0 to 1) against one mean edge length of distance.
    pub color_weight: f32,
    /// Weight of a unit of UV against one mean edge length of distance.
    pub uv_weight: f32,
    /// Weight of a channel's range, or of another label, against one mean edge length of distance.
    pub channel_weight: f32,
    /// Of small islands such as leaves, those that stay grow until as much is covered as before. For foliage and hair.
    pub preserve_area: bool,
    /// Of sources without normals: where faces meet at more than so many degrees there is an edge, and computed normals
    /// are not smooth over it. `None` for smooth normals everywhere.
    pub crease_angle: Option<f32>,
    /// Which levels of detail are built.
    pub levels: Levels,
    /// Keep the map from level-0 triangles to rows of the caller's `faces`.
    pub face_ids: bool,
    /// Threads; 0 uses all cores. The result does not depend on it.
    pub threads: usize,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            cluster_triangles: CLUSTER_MAX_TRIANGLES,
            cluster_vertices: CLUSTER_MAX_VERTICES,
            clusterizer: Clusterizer::default(),
            partition: Partition::default(),
            group_clusters: 16,
            quality: Quality::default(),
            error: ErrorMeasure::default(),
            normal_weight: 1.0,
            color_weight: 1.0,
            uv_weight: 1.0,
            channel_weight: 1.0,
            preserve_area: false,
            crease_angle: None,
            levels: Levels::default(),
            face_ids: false,
            threads: 0,
        }
    }
}

impl BuildOptions {
    /// Checks every range; the error names the option.
    pub fn validate(&self) -> Result<()> {
        let range = |name: &'static str, value: usize, low: usize, high: usize| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(Error::argument(name, format!("must be between {low} and {high}, not {value}")))
            }
        };
        range("cluster_triangles", self.cluster_triangles, 16, CLUSTER_MAX_TRIANGLES)?;
        range("cluster_vertices", self.cluster_vertices, 32, CLUSTER_MAX_VERTICES)?;
        range("group_clusters", self.group_clusters, 4, GROUP_MAX_CLUSTERS * 3 / 4)?;
        if let Some(angle) = self.crease_angle.filter(|angle| !(0.0..=180.0).contains(angle)) {
            return Err(Error::argument(
                "crease_angle",
                format!("must be between 0 and 180 degrees, not {angle}"),
            ));
        }
        for (name, weight) in [
            ("normal_weight", self.normal_weight),
            ("color_weight", self.color_weight),
            ("uv_weight", self.uv_weight),
            ("channel_weight", self.channel_weight),
        ] {
            if !(weight.is_finite() && weight >= 0.0) {
                return Err(Error::argument(name, format!("must be finite and not negative, not {weight}")));
            }
        }
        Ok(())
    }
}

/// An array of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Shaded picture, RGB bytes.
    Color,
    /// The same before it is encoded: linear light, which may exceed 1.
    Linear,
    /// Distance along the view axis, world units; 0 where nothing is covered.
    Depth,
    /// Unit normals, world space; zero where nothing is covered.
    Normal,
    /// Slot numbers of instances; −1 where nothing is covered.
    InstanceId,
    /// Addresses of clusters; `u32::MAX` where nothing is covered.
    ClusterId,
    /// Numbers of triangles inside their clusters; −1 where nothing is covered.
    TriangleId,
    /// Triangles that cover each pixel, hidden ones included.
    Overdraw,
    /// A colour for each triangle, RGB bytes, as are the next three.
    Triangles,
    /// For each cluster.
    Clusters,
    /// For each group.
    Groups,
    /// For each level of detail.
    Levels,
    /// Base colours as they are shaded, linear; zero where nothing is covered, as in the next three.
    BaseColor,
    /// Unit normals as they are shaded, world space: with those of textures.
    ShadingNormal,
    /// Occlusion, roughness and metallic.
    Orm,
    /// Emitted light.
    Emissive,
}

/// All arrays that can be made with a frame.
pub const OUTPUTS: [Output; 16] = [
    Output::Color,
    Output::Linear,
    Output::Depth,
    Output::Normal,
    Output::InstanceId,
    Output::ClusterId,
    Output::TriangleId,
    Output::Overdraw,
    Output::Triangles,
    Output::Clusters,
    Output::Groups,
    Output::Levels,
    Output::BaseColor,
    Output::ShadingNormal,
    Output::Orm,
    Output::Emissive,
];

impl Output {
    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "color",
            Self::Linear => "linear",
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::InstanceId => "instance_id",
            Self::ClusterId => "cluster_id",
            Self::TriangleId => "triangle_id",
            Self::Overdraw => "overdraw",
            Self::Triangles => "triangles",
            Self::Clusters => "clusters",
            Self::Groups => "groups",
            Self::Levels => "levels",
            Self::BaseColor => "base_color",
            Self::ShadingNormal => "shading_normal",
            Self::Orm => "orm",
            Self::Emissive => "emissive",
        }
    }

    /// Shaded: made by the stage before the others.
    pub fn shaded(self) -> bool {
        matches!(self, Self::Color | Self::Linear) || self.surface()
    }

    /// What light meets, and not what becomes of it.
    pub fn surface(self) -> bool {
        matches!(self, Self::BaseColor | Self::ShadingNormal | Self::Orm | Self::Emissive)
    }

    /// A picture of three bytes per pixel; the others are of words.
    pub fn rgb(self) -> bool {
        matches!(self, Self::Color | Self::Triangles | Self::Clusters | Self::Groups | Self::Levels)
    }
}

impl std::str::FromStr for Output {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        choose("outputs", name, &OUTPUTS.map(|output| (output.name(), output)))
    }
}

/// A set of arrays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs(u16);

impl Outputs {
    /// Whether an array is among them.
    pub fn contains(self, output: Output) -> bool {
        self.0 >> output as u16 & 1 == 1
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// All but one.
    pub fn without(self, output: Output) -> Self {
        Self(self.0 & !(1 << output as u16))
    }

    /// All of them, in the order of [`OUTPUTS`].
    pub fn iter(self) -> impl Iterator<Item = Output> {
        OUTPUTS.into_iter().filter(move |output| self.contains(*output))
    }
}

impl FromIterator<Output> for Outputs {
    fn from_iter<I: IntoIterator<Item = Output>>(outputs: I) -> Self {
        Self(outputs.into_iter().fold(0, |bits, output| bits | 1 << output as u16))
    }
}

/// Which rasterizers of a GPU draw. The same pixels are covered, and show the same but for ties and rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Raster {
    /// By the facts of the adapter, so that a frame is reproducible: [`Raster::Compute`], which was the fastest on every GPU
    /// that was measured.
    #[default]
    Auto,
    /// All triangles in compute shaders.
    Compute,
    /// Small triangles in compute shaders, large ones by the rasterizer of the device.
    Hybrid,
    /// All by the rasterizer of the device but those that have to be clipped.
    Hardware,
    /// The fastest of these on the device that covers the same pixels, by a short measurement before the first frame.
    Measured,
}

impl Raster {
    const CHOICES: [(&str, Self); 5] = [
        ("auto", Self::Auto),
        ("compute", Self::Compute),
        ("hybrid", Self::Hybrid),
        ("hardware", Self::Hardware),
        ("measured", Self::Measured),
    ];

    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        Self::CHOICES[self as usize].0
    }
}

impl std::str::FromStr for Raster {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        choose("raster", name, &Self::CHOICES)
    }
}

/// Samples of the colour of each pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Samples {
    /// Its centre.
    #[default]
    One = 1,
    /// Four about its centre.
    Four = 4,
    /// Sixteen about its centre.
    Sixteen = 16,
}

impl TryFrom<u32> for Samples {
    type Error = Error;

    fn try_from(count: u32) -> Result<Self> {
        let all = [Self::One, Self::Four, Self::Sixteen];
        let found = all.into_iter().find(|samples| *samples as u32 == count);
        found.ok_or_else(|| Error::argument("samples", format!("must be 1, 4 or 16, not {count}")))
    }
}

/// What colours are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shading {
    /// Light reflected by glTF's metallic-roughness model.
    Gltf,
    /// The same as pyrender 0.1.45 has it: colours filtered as they are encoded, occlusion of all light, vertex colours after
    /// light, one UV set, back faces with the normals of the front.
    #[default]
    Pyrender,
    /// Base colours, without light.
    Flat,
    /// World-space normals, from −1..1 to 0..1, not encoded.
    Normals,
}

impl std::str::FromStr for Shading {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let choices = [
            ("gltf", Self::Gltf),
            ("pyrender", Self::Pyrender),
            ("flat", Self::Flat),
            ("normals", Self::Normals),
        ];
        choose("shading", name, &choices)
    }
}

/// How light becomes the bytes of a shaded picture. The background is written as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Transfer {
    /// The power 1/2.2, as pyrender has it.
    #[default]
    Gamma22,
    /// The curve of sRGB, IEC 61966-2-1.
    Srgb,
    /// None.
    Linear,
}

impl std::str::FromStr for Transfer {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let choices = [("gamma22", Self::Gamma22), ("srgb", Self::Srgb), ("linear", Self::Linear)];
        choose("transfer", name, &choices)
    }
}

/// Which lights throw shadows, and how they are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shadows {
    /// None.
    #[default]
    Off,
    /// Of all lights that may, by virtual shadow maps.
    Virtual,
    /// The same, but those of directional lights by cascades that are fitted to what a frame sees.
    Cascaded,
}

impl std::str::FromStr for Shadows {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let all = [("off", Self::Off), ("virtual", Self::Virtual), ("cascaded", Self::Cascaded)];
        choose("shadows", name, &all)
    }
}

/// What a device was found to draw fastest with.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// That form.
    pub raster: Raster,
    /// Milliseconds that each form took; only those that may be taken.
    pub times: Vec<(Raster, f64)>,
    /// Why that form.
    pub reason: String,
}

/// How a frame is rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOptions {
    /// Threshold of the cut, pixels: no surface point moves farther on the screen. 0 is full detail.
    pub pixel_error: f32,
    /// Occlusion culling in two passes. The image does not depend on it.
    pub occlusion: bool,
    /// On a GPU, draw by 64-bit atomics where the device has them. The picture does not depend on it.
    pub int64_atomics: bool,
    /// On a GPU, which rasterizers draw.
    pub raster: Raster,
    /// What to make with the frame; the rest, when it is first read.
    pub outputs: Outputs,
    /// On a GPU, whether it makes them, and not the CPU from the visibility buffer; without a choice, unless the device is
    /// software, which is slower at it.
    pub device_outputs: Option<bool>,
    /// Depth and nothing else, bit for bit that of other frames: less is written per pixel, and less comes back from a
    /// device. For shadows and for sensors of depth; see [`RenderOptions::depth_only`].
    pub depth_only: bool,
    /// Samples of the colour of each pixel, of one cut, whose mean is taken in linear light. Everything else is of the
    /// centre.
    pub samples: Samples,
    /// What colours are.
    pub shading: Shading,
    /// How colours are encoded.
    pub transfer: Transfer,
    /// Which lights throw shadows.
    pub shadows: Shadows,
    /// Bytes of pages of shadow maps at most: where a frame wants more, its shadows are coarser.
    pub shadow_memory: u64,
    /// Rays from each receiver to a light with a size, at most [`SHADOW_SAMPLES_MAX`].
    pub shadow_samples: u32,
    /// Layers of blended surfaces that are composited at each pixel, at most [`MAX_LAYERS`]; what lies behind them is not seen.
    pub max_layers: u32,
    /// Depth, ids and normals are those of the nearest surface, blended or not; otherwise of the nearest opaque one.
    pub transparent_ids: bool,
    /// Take note of where everything is, so that the next frame of the view can tell what moved, and tell it of this one.
    pub motion: bool,
    /// To find a fault of a device: it runs the stages before this one, and their CPU twins the others, which makes the same
    /// image. In one pass, and slowly. Counts of stages are those of the device.
    pub cpu_from: Option<Stage>,
    /// Where meshes are streamed, draw until all that the picture needs is there, as far as the pool has room for it;
    /// otherwise once, with what is there.
    pub wait: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            pixel_error: 1.0,
            occlusion: true,
            int64_atomics: true,
            raster: Raster::default(),
            outputs: [Output::Color, Output::Depth].into_iter().collect(),
            device_outputs: None,
            depth_only: false,
            samples: Samples::default(),
            shading: Shading::default(),
            transfer: Transfer::default(),
            shadows: Shadows::default(),
            shadow_memory: 256 << 20,
            shadow_samples: 32,
            max_layers: 8,
            transparent_ids: false,
            motion: false,
            cpu_from: None,
            wait: true,
        }
    }
}

impl RenderOptions {
    /// The defaults for frames of depth alone.
    pub fn depth_only() -> Self {
        Self { depth_only: true, outputs: [Output::Depth].into_iter().collect(), ..Self::default() }
    }

    /// Checks every range and what goes together; the error names the option.
    pub fn validate(&self) -> Result<()> {
        if !(self.pixel_error.is_finite() && self.pixel_error >= 0.0) {
            return Err(Error::argument(
                "pixel_error",
                format!("must be finite and not negative, not {}", self.pixel_error),
            ));
        }
        if !(1..=SHADOW_SAMPLES_MAX).contains(&self.shadow_samples) {
            return Err(Error::argument(
                "shadow_samples",
                format!("must be from 1 to {SHADOW_SAMPLES_MAX}, not {}", self.shadow_samples),
            ));
        }
        if self.transparent_ids && self.depth_only {
            return Err(Error::argument("transparent_ids", "frames of depth alone show what is opaque"));
        }
        if self.max_layers > MAX_LAYERS {
            let message = format!("must be from 0 to {MAX_LAYERS}, not {}", self.max_layers);
            return Err(Error::argument("max_layers", message));
        }
        if self.depth_only && self.samples != Samples::One {
            return Err(Error::argument("samples", "with depth_only there is no colour, and it must be 1"));
        }
        let others = self.outputs.without(Output::Depth).iter().next();
        if let Some(other) = others.filter(|_| self.depth_only) {
            return Err(Error::argument(
                "outputs",
                format!("with depth_only there is \"depth\" alone, not {:?}", other.name()),
            ));
        }
        Ok(())
    }
}
