//! Named per-vertex values beside the standard attributes: floating-point channels and labels.
//!
//! They belong to vertex identities and lie beside the pages, so that channels of any width leave clusters, groups
//! and pages as they are, and a reader that does not ask for them never touches them.

use serde::{Deserialize, Serialize};

use super::words::Words;

/// What a channel's words are, by the name that NumPy has for it. 64-bit labels hold values of 32 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChannelType {
    /// Blended where the surface is simplified.
    Float32,
    /// A label, like all that follow: never blended. Words 0 and 1.
    Bool,
    /// Two's complement in a word.
    Int8,
    /// Two's complement in a word.
    Int16,
    /// Two's complement in a word.
    Int32,
    /// Values of `i32`, two's complement in a word.
    Int64,
    /// A word.
    Uint8,
    /// A word.
    Uint16,
    /// A word.
    Uint32,
    /// Values of `u32`.
    Uint64,
}

impl ChannelType {
    const NAMES: [(&'static str, Self); 10] = [
        ("float32", Self::Float32),
        ("bool", Self::Bool),
        ("int8", Self::Int8),
        ("int16", Self::Int16),
        ("int32", Self::Int32),
        ("int64", Self::Int64),
        ("uint8", Self::Uint8),
        ("uint16", Self::Uint16),
        ("uint32", Self::Uint32),
        ("uint64", Self::Uint64),
    ];

    /// The type of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(n, _)| *n == name).map(|(_, dtype)| *dtype)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, dtype)| *dtype == self).map_or("", |(name, _)| name)
    }

    /// True for everything that is never blended.
    pub fn is_label(self) -> bool {
        self != Self::Float32
    }

    /// Whether a word is a value of this type: a finite number, or one in range.
    pub fn holds(self, word: u32) -> bool {
        let signed = word.cast_signed();
        match self {
            Self::Float32 => f32::from_bits(word).is_finite(),
            Self::Bool => word <= 1,
            Self::Int8 => i8::try_from(signed).is_ok(),
            Self::Int16 => i16::try_from(signed).is_ok(),
            Self::Uint8 => u8::try_from(word).is_ok(),
            Self::Uint16 => u16::try_from(word).is_ok(),
            Self::Int32 | Self::Int64 | Self::Uint32 | Self::Uint64 => true,
        }
    }
}

/// What is known of a channel without its values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelInfo {
    /// Its name; no two channels of a mesh have the same.
    pub name: String,
    /// What its words are.
    pub dtype: ChannelType,
    /// Columns; none for one value per vertex in an array of one dimension.
    pub columns: Option<u32>,
}

impl ChannelInfo {
    /// Words per vertex.
    pub fn width(&self) -> usize {
        self.columns.unwrap_or(1) as usize
    }
}

/// A channel of a built mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name, type and width.
    pub info: ChannelInfo,
    /// A row for each vertex identity.
    pub words: Words,
}
