//! Halving of what lies in space.

/// An item to be split off by where it is. Point and number lie together, so that splitting reads memory in order.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Where it is.
    pub point: [f32; 3],
    /// What it is.
    pub number: u32,
}

/// The `middle` smallest along the longest axis of the points, and the rest. Ties go by number, so the two parts, as
/// sets, depend on the points alone.
pub fn median_split(places: &mut [Place], middle: usize) -> (&mut [Place], &mut [Place]) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for Place { point, .. } in places.iter() {
        for k in 0..3 {
            low[k] = low[k].min(point[k]);
            high[k] = high[k].max(point[k]);
        }
    }
    let axis = (0..3).fold(0, |a, b| if high[b] - low[b] > high[a] - low[a] { b } else { a });
    // Compared as integers: coordinate first, then number.
    let key = |place: &Place| {
        let bits = place.point[axis].to_bits() as i32;
        let ordered = (bits ^ ((bits >> 31) as u32 >> 1) as i32) as u32 ^ 0x8000_0000;
        u64::from(ordered) << 32 | u64::from(place.number)
    };
    places.select_nth_unstable_by_key(middle, key);
    places.split_at_mut(middle)
}
