use super::*;
use crate::measure::piece::Piece;

const TRIANGLE: Triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// The halves of triangles, one of each in each of two clusters.
fn halves(triangles: &[u32]) -> [Pieces; 2] {
    let (first, second) = Piece::new(TRIANGLE).halves();
    [first, second.unwrap()].map(|half| {
        let mut pieces = Pieces::default();
        triangles.iter().for_each(|t| pieces.push(*t, TRIANGLE, &half));
        pieces
    })
}

fn reference(count: u32, pieces: &[Pieces]) -> Reference {
    let positions = Arc::default();
    let mut reference = Reference {
        positions,
        clusters: Vec::new(),
        starts: Vec::new(),
        boxes: OnceLock::new(),
        count,
        radii: Vec::new(),
        shares: Vec::new(),
        least: 0.0,
        levels: 0,
        is_last: false,
    };
    reference.begin(1.0, false, pieces.iter());
    reference
}

#[test]
fn triangles_become_whole_where_all_parts_meet() {
    let [a, b] = halves(&[3, 5, 4]);
    // Of 5 a third part is elsewhere.
    let [elsewhere, _] = halves(&[5]);
    let all = [a, b, elsewhere];
    let reference = reference(6, &all);
    let [mut a, mut b, mut elsewhere] = all;
    let kept = a.offsets[usize::from(a.parts[0].1)..][..usize::from(a.parts[1].1)].to_vec();
    let mut group = [std::mem::take(&mut a), std::mem::take(&mut b)];
    reference.join(&mut group);
    assert_eq!(group[0].whole, [3, 4]);
    assert!(group[1].whole.is_empty());
    for pieces in &group {
        assert_eq!(pieces.parts.iter().map(|(t, ..)| *t).collect::<Vec<_>>(), [5]);
        assert_eq!(pieces.offsets.len(), usize::from(pieces.parts[0].1));
    }
    assert_eq!(group[0].offsets, kept);
    reference.join(std::slice::from_mut(&mut elsewhere));
    assert!(elsewhere.whole.is_empty() && elsewhere.parts.len() == 1);
}

#[test]
fn triangles_in_too_many_parts_stay_cut() {
    let [mut many, _] = halves(&vec![0; usize::from(MANY) + 1]);
    let reference = reference(1, std::slice::from_ref(&many));
    reference.join(std::slice::from_mut(&mut many));
    assert!(many.whole.is_empty() && many.parts.len() == usize::from(MANY) + 1);
}
