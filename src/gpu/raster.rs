//! What the rasterizers of both sizes and the device's own share: how they write, and what they bind.

use super::kernel::{BindingLists, Bindings, Constant, bindings};

bindings! {
    /// What all rasterizers bind.
    RasterBindings {
        instances: Read, page_offsets: Read, pages: Read, visible: Read, draws: Read, words: Write, counters: Write,
        pages_1: Read, pages_2: Read, pages_3: Read,
    }
}

bindings! {
    /// What they bind besides to draw a view.
    OneView { view: Uniform, numbers: Read }
}

bindings! {
    /// What they bind besides to draw pages of shadow maps, each a view.
    PageViews { page_views: Read, pairs: Uniform }
}

/// Where rasterizers draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Onto {
    /// The picture of a view.
    Picture,
    /// Pages of shadow maps.
    Pages,
}

impl Onto {
    /// The shared file that says what is drawn there.
    pub(super) const fn file(self) -> &'static str {
        match self {
            Self::Picture => "shared/one_view",
            Self::Pages => "shared/page_views",
        }
    }

    /// What is bound.
    pub(super) const fn bindings(self) -> BindingLists {
        match self {
            Self::Picture => &[RasterBindings::BINDINGS, OneView::BINDINGS],
            Self::Pages => &[RasterBindings::BINDINGS, PageViews::BINDINGS],
        }
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

/// All forms of the rasterizers in compute.
pub(super) fn forms() -> impl Iterator<Item = (Onto, Words)> {
    Words::ALL.into_iter().map(|words| (Onto::Picture, words)).chain([(Onto::Pages, Words::Depth)])
}
