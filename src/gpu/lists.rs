//! The lists that stages hand to each other on the device: bits that become lists by stream compaction, the lists of the
//! rasterizers, and the indirect arguments that a pass prepares.

use super::kernel::{Bindings, Constant, Kernel, MAX_WORKGROUPS, WIDTH, bindings};
use crate::gpu_types::Dispatch;
use crate::limits::{CLUSTER_MAX_TRIANGLES, PYRAMID_LEVELS};

/// Lanes of a workgroup that sums up words.
pub const SCAN_WIDTH: u32 = CLUSTER_MAX_TRIANGLES as u32;
/// Groups whose clusters a workgroup culls, all of them shared out among its lanes: most have some six to look at. Each is
/// written to by a lane of its own.
pub const GROUPS_PER_WORKGROUP: u32 = 8;
const _: () = assert!(GROUPS_PER_WORKGROUP <= WIDTH);
/// Levels of the depth pyramid that a dispatch makes of the one below.
pub const LEVELS_PER_DISPATCH: u32 = 4;
/// Dispatches that make a whole pyramid.
pub const PYRAMID_DISPATCHES: u32 = (PYRAMID_LEVELS as u32 - 1).div_ceil(LEVELS_PER_DISPATCH);

bindings! {
    /// What `count_bits` binds.
    CountBits { bits: Read, blocks: Read, sums: Write }
}

bindings! {
    /// What `scan_blocks` binds.
    ScanBlocks { blocks: Read, sums: Write }
}

/// Words → set bits of each block of words.
pub const fn count_bits(bits: Bits) -> Kernel {
    let sparse = Constant::Flag("SPARSE", matches!(bits, Bits::Groups));
    Kernel::new("count_bits", &[CountBits::BINDINGS]).constants([bits.block_constant(), sparse])
}

/// Set bits of blocks → where each block starts.
pub const fn scan_blocks(bits: Bits) -> Kernel {
    Kernel::new("scan_blocks", &[ScanBlocks::BINDINGS]).constants([bits.block_constant()])
}

pub(super) fn kernels() -> Vec<Kernel> {
    [Bits::Groups, Bits::Clusters]
        .into_iter()
        .flat_map(|bits| [count_bits(bits), scan_blocks(bits)])
        .collect()
}

/// Words of bits of groups with the bits that tell which of them are not zero.
pub fn group_bit_words(words: u32) -> u32 {
    words + words.div_ceil(u32::BITS)
}

/// Sets of bits that are listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Of all groups of the scene, of which few are looked at.
    Groups,
    /// Of the clusters of the groups that are.
    Clusters,
}

impl Bits {
    /// Words that a workgroup sums up, shared out among its lanes. Of groups those that are not zero are looked at, which
    /// bits tell of 32 words together: so few that waiting for each other takes longer than looking.
    pub const fn block(self) -> u32 {
        match self {
            Self::Groups => 4096,
            Self::Clusters => 512,
        }
    }

    pub(super) const fn block_constant(self) -> Constant {
        Constant::Number("SCAN_BLOCK", self.block())
    }

    /// Sums that so many words have: one for each block, and behind them the total.
    pub const fn sums(self, words: u32) -> u32 {
        words.div_ceil(self.block()) + 1
    }

    /// A dispatch of such workgroups over so many words.
    pub fn dispatch(self, count: u32) -> Dispatch {
        let workgroups = count.div_ceil(self.block());
        let (x, y) = (workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS));
        Dispatch { x, y, z: 1, count, ..Dispatch::default() }
    }
}

/// The lists of clusters to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum List {
    /// Those of small triangles.
    Small,
    /// Those of large ones; with the hardware rasterizer, that it takes.
    Large,
    /// With the hardware rasterizer, large ones that it does not take: that have to be clipped.
    Clipped,
    /// Of any size, alpha-tested.
    AlphaTested,
}

impl List {
    /// How many there are.
    pub const COUNT: u32 = 4;
}

/// The indirect arguments that are prepared after the first pass and after the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndirectEntry {
    /// Blocks of the bits of groups, for the second pass.
    Groups,
    /// Pixels that get the numbers of the list of both passes.
    Pixels,
    /// A dispatch of the depth pyramid.
    Pyramid(u32),
}

impl IndirectEntry {
    /// How many there are.
    pub const COUNT: u32 = 2 + PYRAMID_DISPATCHES;

    /// Place among them.
    pub const fn number(self) -> u32 {
        match self {
            Self::Groups => 0,
            Self::Pixels => 1,
            Self::Pyramid(dispatch) => 2 + dispatch,
        }
    }
}
