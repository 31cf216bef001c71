//! The arrays of a frame, as shaders and the CPU make them.

use crate::config::Output;

/// An array of a frame, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub enum Array {
    /// RGB.
    Bytes(Vec<u8>),
    /// Numbers, and vectors of three.
    Floats(Vec<f32>),
    /// Numbers, some of them negative.
    Signed(Vec<i32>),
    /// Numbers.
    Unsigned(Vec<u32>),
}

impl Array {
    /// From what a shader wrote for so many pixels.
    pub fn read(output: Output, pixels: usize, bytes: &[u8]) -> Self {
        fn words<T>(bytes: &[u8], word: impl Fn([u8; 4]) -> T) -> Vec<T> {
            bytes.as_chunks::<4>().0.iter().map(|bytes| word(*bytes)).collect()
        }
        match output {
            Output::Color | Output::Triangles | Output::Clusters | Output::Groups | Output::Levels => {
                Self::Bytes(bytes[..3 * pixels].to_vec())
            }
            Output::Linear
            | Output::Depth
            | Output::Normal
            | Output::BaseColor
            | Output::ShadingNormal
            | Output::Orm
            | Output::Emissive => Self::Floats(words(bytes, f32::from_ne_bytes)),
            Output::InstanceId | Output::TriangleId => Self::Signed(words(bytes, i32::from_ne_bytes)),
            Output::ClusterId | Output::Overdraw => Self::Unsigned(words(bytes, u32::from_ne_bytes)),
        }
    }
}

macro_rules! holds {
    ($variant:ident: $type:ty) => {
        impl From<Vec<$type>> for Array {
            fn from(values: Vec<$type>) -> Self {
                Self::$variant(values)
            }
        }

        impl From<Array> for Vec<$type> {
            /// Empty for an array of another type.
            fn from(array: Array) -> Self {
                if let Array::$variant(values) = array { values } else { Self::new() }
            }
        }
    };
}
holds!(Bytes: u8);
holds!(Floats: f32);
holds!(Signed: i32);
holds!(Unsigned: u32);
