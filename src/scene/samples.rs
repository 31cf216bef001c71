//! Where pixels are sampled: the standard patterns of 4 and 16 samples of Direct3D 11 and Vulkan (Vulkan specification,
//! `standardSampleLocations`). In each no two samples share a row or a column of as many. That of 16, whose grid of
//! sixteenths has no middle, is moved by half a step here, so that the mean of both is the centre.

use crate::config::Samples;

/// Parts of a pixel's side in which patterns are written.
const PARTS: f64 = 32.0;

const FOUR: [[i8; 2]; 4] = [[-4, -12], [12, -4], [-12, 4], [4, 12]];
const SIXTEEN: [[i8; 2]; 16] = [
    [3, 3],
    [-1, -5],
    [-5, 5],
    [9, -1],
    [-9, -3],
    [5, 11],
    [11, 7],
    [7, -9],
    [-3, 13],
    [1, -13],
    [-7, -11],
    [-11, 9],
    [-15, 1],
    [15, -7],
    [13, 15],
    [-13, -15],
];

impl Samples {
    /// Where they are from the pixel's centre, pixels to the right and down, unless there is one: the centre itself.
    pub fn offsets(self) -> Vec<[f64; 2]> {
        let pattern = match self {
            Self::One => &[][..],
            Self::Four => &FOUR,
            Self::Sixteen => &SIXTEEN,
        };
        pattern.iter().map(|at| at.map(|v| f64::from(v) / PARTS)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_have_a_sample_in_each_row_and_column() {
        for samples in [Samples::Four, Samples::Sixteen] {
            let (offsets, count) = (samples.offsets(), samples as u32);
            for k in 0..2 {
                let cell = |v: f64| ((v + 0.5) * f64::from(count)).floor() as u32;
                let mut cells: Vec<u32> = offsets.iter().map(|at| cell(at[k])).collect();
                cells.sort_unstable();
                assert_eq!(cells, (0..count).collect::<Vec<_>>());
                assert_eq!(offsets.iter().map(|at| at[k]).sum::<f64>(), 0.0);
            }
        }
        assert_eq!(Samples::One.offsets(), Vec::<[f64; 2]>::new());
    }
}
