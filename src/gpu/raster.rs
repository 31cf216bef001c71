//! What the rasterizers of both sizes and the device's own share: how they write, and what they bind.

use super::kernel::{Constant, bindings};

bindings! {
    /// What all rasterizers bind.
    RasterBindings {
        view: Uniform, instances: Read, page_offsets: Read, pages: Read, visible: Read, numbers: Read, draws: Read,
        words: Write, counters: Write, pages_1: Read, pages_2: Read, pages_3: Read,
    }
}

/// How rasterizers write to the visibility buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// By one 64-bit atomic maximum.
    Int64,
    /// The nearest key of every pixel, the first of two 32-bit passes.
    Keys,
    /// The largest low half among those with that key, the second.
    Lows,
    /// How many triangles cover every pixel, instead.
    Count,
    /// The nearest key of every pixel and nothing else.
    Depth,
}

impl Words {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Int64, Self::Keys, Self::Lows, Self::Count, Self::Depth];

    /// Whether this is the first pass over the triangles, which counts them.
    pub(super) const fn constant(self) -> Constant {
        Constant::Flag("FIRST_PASS", matches!(self, Self::Int64 | Self::Keys | Self::Depth))
    }

    /// The shared file that writes so.
    pub(super) const fn file(self) -> &'static str {
        match self {
            Self::Int64 => "shared/words_64",
            Self::Keys | Self::Lows => "shared/words_32",
            Self::Count => "shared/words_count",
            Self::Depth => "shared/words_depth",
        }
    }
}
