//! Vertex colours: how a stream holds them.

use serde::{Deserialize, Serialize};

/// What the colours of a mesh are stored as: RGBA, 0 to 1, as precise as the source has them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Stated", into = "Stated")]
pub enum ColorFormat {
    /// There are none.
    #[default]
    None,
    /// Four bytes over 255, red in the lowest.
    Unorm8,
    /// Four 16-bit numbers over 65,535, red in the lowest.
    Unorm16,
    /// Four f32.
    Float32,
}

/// Most words of a colour.
pub const MAX_COLOR_WORDS: usize = 4;

impl ColorFormat {
    /// Words of each vertex.
    #[inline]
    pub const fn words(self) -> usize {
        match self {
            Self::None => 0,
            Self::Unorm8 => 1,
            Self::Unorm16 => 2,
            Self::Float32 => MAX_COLOR_WORDS,
        }
    }

    /// What a stored component of 1 is.
    #[inline]
    pub const fn one(self) -> f32 {
        match self {
            Self::Unorm8 => 255.0,
            Self::Unorm16 => 65_535.0,
            Self::None | Self::Float32 => 1.0,
        }
    }

    /// Whether there are colours.
    #[inline]
    pub const fn is_some(self) -> bool {
        !matches!(self, Self::None)
    }

    /// The NumPy type of a component; `None` without colours.
    pub const fn dtype(self) -> Option<&'static str> {
        match self {
            Self::None => None,
            Self::Unorm8 => Some("uint8"),
            Self::Unorm16 => Some("uint16"),
            Self::Float32 => Some("float32"),
        }
    }

    /// The words of a colour, rounded to nearest and clamped to 0 to 1; those behind [`ColorFormat::words`] are zero.
    #[inline]
    pub fn pack(self, color: [f32; 4]) -> [u32; MAX_COLOR_WORDS] {
        let color = color.map(|x| x.clamp(0.0, 1.0));
        match self {
            Self::None => [0; MAX_COLOR_WORDS],
            Self::Unorm8 => [u32::from_le_bytes(color.map(|x| (x * self.one() + 0.5) as u8)), 0, 0, 0],
            Self::Unorm16 => {
                let [r, g, b, a] = color.map(|x| (x * self.one() + 0.5) as u32);
                [r | g << 16, b | a << 16, 0, 0]
            }
            Self::Float32 => color.map(f32::to_bits),
        }
    }

    /// The colour that as many words hold as [`ColorFormat::words`] says; white where that is none.
    #[inline]
    pub fn unpack(self, words: &[u32]) -> [f32; 4] {
        match *words {
            [word] => word.to_le_bytes().map(|x| f32::from(x) / Self::Unorm8.one()),
            [rg, ba] => [rg, rg >> 16, ba, ba >> 16].map(|x| f32::from(x as u16) / Self::Unorm16.one()),
            [r, g, b, a] => [r, g, b, a].map(f32::from_bits),
            _ => [1.0; 4],
        }
    }
}

/// How metadata state the format. Files of bytes say true, as those did that were written before there were others.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Stated {
    Bytes(bool),
    Finer(Finer),
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Finer {
    Uint16,
    Float32,
}

impl From<Stated> for ColorFormat {
    fn from(stated: Stated) -> Self {
        match stated {
            Stated::Bytes(false) => Self::None,
            Stated::Bytes(true) => Self::Unorm8,
            Stated::Finer(Finer::Uint16) => Self::Unorm16,
            Stated::Finer(Finer::Float32) => Self::Float32,
        }
    }
}

impl From<ColorFormat> for Stated {
    fn from(format: ColorFormat) -> Self {
        match format {
            ColorFormat::None => Self::Bytes(false),
            ColorFormat::Unorm8 => Self::Bytes(true),
            ColorFormat::Unorm16 => Self::Finer(Finer::Uint16),
            ColorFormat::Float32 => Self::Finer(Finer::Float32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_come_back() {
        let steps = |most: u16| (0..=most).map(move |x| f32::from(x) / f32::from(most));
        let formats = [ColorFormat::Unorm8, ColorFormat::Unorm16, ColorFormat::Float32];
        for (format, most) in formats.into_iter().zip([255, 65_535, 65_535]) {
            for x in steps(most) {
                let color = [x, 1.0 - x, 0.0, 1.0];
                let words = format.pack(color);
                let found = format.unpack(&words[..format.words()]);
                assert!(found[0] == x && found[2] == 0.0 && found[3] == 1.0, "{format:?} {x}: {found:?}");
            }
            let wild = format.unpack(&format.pack([-1.0, 2.0, f32::INFINITY, 0.0])[..format.words()]);
            assert_eq!(wild, [0.0, 1.0, 1.0, 0.0]);
        }
    }

    #[test]
    fn formats_have_names() {
        for (format, json) in [
            (ColorFormat::None, "false"),
            (ColorFormat::Unorm8, "true"),
            (ColorFormat::Unorm16, "\"uint16\""),
            (ColorFormat::Float32, "\"float32\""),
        ] {
            assert_eq!(serde_json::to_string(&format).unwrap(), json);
            assert_eq!(serde_json::from_str::<ColorFormat>(json).unwrap(), format);
        }
        assert!(serde_json::from_str::<ColorFormat>("\"uint32\"").is_err());
    }
}
