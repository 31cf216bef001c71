//! The order of groups: coarsest level first, and inside a level the order of a k-d tree over their boxes.

use crate::limits::NODE_WIDTH;
use crate::math::Aabb;
use crate::math::median::{Place, median_split};

/// Numbers of groups of these levels and boxes, in the order in which pages take them and nodes enclose them.
pub fn spatial_order(groups: impl Iterator<Item = (u32, Aabb)>) -> Vec<u32> {
    let mut groups: Vec<(u32, Place)> = groups
        .zip(0..)
        .map(|((level, bounds), number)| (level, Place { point: bounds.center(), number }))
        .collect();
    groups.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    let mut order = Vec::with_capacity(groups.len());
    for of_level in groups.chunk_by(|a, b| a.0 == b.0) {
        let mut places: Vec<Place> = of_level.iter().map(|g| g.1).collect();
        sort_spatially(&mut places);
        order.extend(places.iter().map(|place| place.number));
    }
    order
}

/// Orders groups so that halves of halves are compact: medians along the longest axis.
fn sort_spatially(groups: &mut [Place]) {
    if groups.len() <= NODE_WIDTH {
        groups.sort_unstable_by_key(|g| g.number);
        return;
    }
    let (a, b) = median_split(groups, groups.len() / 2);
    sort_spatially(a);
    sort_spatially(b);
}
