//! Stage 3: the rule of the cut over clusters, cones, and what the first pass starts from.

use super::*;

/// A flat cluster of so many triangles, its box `half` wide to each side.
fn cluster(triangles: u8, half: f32) -> ClusterRecord {
    ClusterRecord {
        extent: [half, half, 0.0],
        cone: [0, 0, 0, 127],
        lod_sphere: SPHERE,
        error: -1.0,
        triangle_count: triangles,
        ..ClusterRecord::zeroed()
    }
}

/// Two pages: of the second the word behind the first.
fn pages(first: &[ClusterRecord], second: &[ClusterRecord]) -> (Vec<u32>, [u32; 4]) {
    let mut all = words(first).to_vec();
    all.extend(words(second));
    (all, [0, (first.len() * RECORD_WORDS) as u32, 0, 0])
}

/// Bits of the clusters of candidates that are drawn, their marks, and the counts.
fn clusters(
    device: &Context,
    view: &View,
    instance: Instance,
    (pages, offsets): &(Vec<u32>, [u32; 4]),
    candidates: &[CandidateGroup],
) -> (Vec<u32>, Vec<Marks>, Counters) {
    let culling = dispatch(1, 1, candidates.len() as u32);
    let (bits, marks) = (vec![9; 4], vec![Marks::zeroed(); candidates.len()]);
    let out = device
        .run(
            cluster_cull(CullPass::First),
            &[
                words(&[*view]),
                words(&[instance]),
                offsets,
                pages,
                words(candidates),
                words(&[culling]),
                &bits,
                words(&marks),
                words(&[Counters::default()]),
                &[0; KEYS],
                &[0; 4],
                words(&[Group::zeroed()]),
                pages,
                pages,
                pages,
            ],
            // Eight candidates each.
            culling.count.div_ceil(8),
        )
        .unwrap();
    (out[6][..candidates.len()].to_vec(), entries(&out[7]), entry(&out[8]))
}

fn candidate(page: usize, count: u32) -> CandidateGroup {
    CandidateGroup { instance: 0, first: ClusterAddress::new(page, 0).0, count, before: NONE, group: 0 }
}

#[test]
fn clusters_obey_the_rule_and_go_to_their_rasterizer() {
    let Some(device) = device("clusters_obey_the_rule_and_go_to_their_rasterizer") else { return };
    let with_error = |error: f32| ClusterRecord { error, ..cluster(1, 0.2) };
    let off = ClusterRecord { center: [20.0, 0.0, 0.0], ..cluster(1, 0.2) };
    // The source, at the threshold, above it, off the screen, and between the centres of rows 39 and 40: it is less than
    // a pixel high.
    let rule = [cluster(1, 0.2), with_error(LESS), with_error(PIXEL), off, cluster(1, 0.1)];
    // At distance 10 a box is 10 · half + 1/8 pixels long, rounded down. Of two triangles that is an edge: 16 pixels are
    // small and 17 are not. Of 128 it is eight edges: 120 pixels are small, and 121 are too many for that rasterizer.
    let sizes = [cluster(2, 1.68), cluster(2, 1.69), cluster(128, 12.08), cluster(128, 12.09)];
    let view = View { tau: TAU, ..view() };
    let pages = pages(&rule, &sizes);
    let list = [candidate(0, 5), candidate(1, 4), candidate(1, 3)];
    let (drawn, marks, counters) = clusters(&device, &view, seen(), &pages, &list);
    assert_eq!(drawn, [0b0011, 0b1111, 0b111]);
    let large: Vec<u32> = marks.iter().map(|marks| marks.large).collect();
    assert_eq!(large, [0, 0b1010, 0b010]);
    assert!(marks.iter().all(|marks| marks.old == 0));
    assert_eq!((counters.visited_clusters, counters.occluded), (12, 0));
    assert_eq!(counters.triangles_small, 2 + (2 + 128) + (2 + 128));
    assert_eq!(counters.triangles_large, (2 + 128) + 2);
}

#[test]
fn a_cluster_faces_away_by_a_hair() {
    let Some(device) = device("a_cluster_faces_away_by_a_hair") else { return };
    // Ten from the eye, straight along the axis: all face away where 10 ≥ 10 · 64/127 + radius, up to 4.9606.
    let cone =
        |cone: [i8; 4], radius: f32| ClusterRecord { cone, radius, extent: [0.2; 3], ..cluster(1, 0.2) };
    let table = [
        (cone([0, 0, -127, 64], 4.9605), false),
        (cone([0, 0, -127, 64], 4.9607), true),
        (cone([0, 0, 127, 64], 0.1), true),
        // A cutoff of 1 never culls, one of 126/127 does.
        (cone([0, 0, -127, 127], -1.0), true),
        (cone([0, 0, -127, 126], 0.05), false),
        (cone([127, 0, 0, 1], 0.0), true),
    ];
    let records: Vec<ClusterRecord> = table.iter().map(|(record, _)| *record).collect();
    let bits = (0..).zip(&table).fold(0, |bits, (k, (_, drawn))| bits | u32::from(*drawn) << k);
    let pages = pages(&records, &[]);
    let list = [candidate(0, 6)];
    assert_eq!(clusters(&device, &view(), seen(), &pages, &list).0, [bits]);
    let both_sides = Instance { double_sided: 1, ..seen() };
    assert_eq!(clusters(&device, &view(), both_sides, &pages, &list).0, [0b11_1111]);
    // In a parallel view by the direction of sight alone: 1 ≥ 64/127 for the first three that lie along it.
    let parallel = View { orthographic: 1, ..view() };
    let along = Instance {
        eye: [0.0, 0.0, -1.0],
        screen: [[1.0, 0.0, 0.0, 50.5], [0.0, -1.0, 0.0, 40.5], [0.0, 0.0, -1.0, 10.0]],
        ..seen()
    };
    assert_eq!(clusters(&device, &parallel, along, &pages, &list).0, [0b10_1100]);
}

/// The second pass keeps what the first one drew, and looks at all else.
#[test]
fn the_second_phase_looks_at_clusters_that_are_not_drawn_yet() {
    let Some(device) = device("the_second_phase_looks_at_clusters_that_are_not_drawn_yet") else { return };
    // Of the first candidate cluster 0 was drawn, and 2 is off the screen. The second is new.
    let off = ClusterRecord { center: [20.0, 0.0, 0.0], ..cluster(7, 0.2) };
    let records = [cluster(3, 0.2), cluster(5, 0.2), off, cluster(9, 0.2)];
    let (pages, offsets) = pages(&records, &[]);
    let candidates = [CandidateGroup { before: 1, ..candidate(0, 3) }, candidate(0, 4)];
    let drawn = [0, 0b001, 0, 0];
    for (distance, bits, held, small) in [(12.0, [0b0011, 0b1011], 0, 5 + 17), (8.0, [0b0001, 0], 4, 0)] {
        let out = run(
            &device,
            cluster_cull(CullPass::Second),
            &[
                words(&[View { history: 1, ..view() }]),
                words(&[seen()]),
                &offsets,
                &pages,
                words(&candidates),
                words(&[dispatch(1, 1, 2)]),
                &[0; 4],
                words(&[Marks::zeroed(); 2]),
                words(&[Counters::default()]),
                &[key(distance); KEYS],
                &drawn,
                words(&[Group::zeroed()]),
                &pages,
                &pages,
                &pages,
            ],
        );
        assert_eq!(out[6][..2], bits);
        // What the first pass drew is known by its mark.
        let found: Vec<Marks> = entries(&out[7]);
        assert!(found.iter().map(|marks| (marks.large, marks.old)).eq([(0, 1), (0, 0)]));
        let counters: Counters = entry(&out[8]);
        assert_eq!((counters.visited_clusters, counters.occluded), (2 + 4, held));
        assert_eq!((counters.triangles_small, counters.triangles_large), (small, 0));
    }
}

/// From a list, the first pass looks at what the frame before drew, where the group is still refined, its page there and
/// its instance visible.
#[test]
fn the_first_phase_starts_from_a_list() {
    let Some(device) = device("the_first_phase_starts_from_a_list") else { return };
    let too_coarse = ClusterRecord { error: PIXEL, ..cluster(5, 0.2) };
    let records = [cluster(3, 0.2), too_coarse, cluster(7, 0.2), cluster(9, 0.2)];
    let (pages, _) = pages(&records, &[]);
    // The second page is not there, the second group is no longer refined, the second instance not visible.
    let offsets = [0, u32::MAX, 0, 0];
    let groups = [group(PIXEL, 0.0), group(LESS, 0.0)];
    let instances = [seen(), Instance { lod_focal: 0.0, ..seen() }];
    let candidates = [
        candidate(0, 4),
        candidate(1, 4),
        CandidateGroup { group: 1, ..candidate(0, 4) },
        CandidateGroup { instance: 1, ..candidate(0, 4) },
        candidate(0, 4),
        candidate(0, 4),
    ];
    let drawn = [0b0111, 0b0111, 0b0111, 0b0111, 0, 0b1000];
    // What the earlier pyramid hides is left to the second pass: all here, or nothing.
    for (distance, bits, held) in [(12.0, [0b0101, 0, 0, 0, 0, 0b1000], 0), (8.0, [0; 6], 3)] {
        let out = run(
            &device,
            cluster_cull(CullPass::First),
            &[
                words(&[View { history: HISTORY_LIST, tau: TAU, ..view() }]),
                words(&instances),
                &offsets,
                &pages,
                words(&candidates),
                words(&[dispatch(1, 1, 6)]),
                &drawn,
                words(&[Marks::zeroed(); 6]),
                words(&[Counters::default()]),
                &[key(distance); KEYS],
                &[0; 4],
                words(&groups),
                &pages,
                &pages,
                &pages,
            ],
        );
        assert_eq!(out[6], bits);
        let counters: Counters = entry(&out[8]);
        assert_eq!((counters.visited_clusters, counters.occluded), (3 + 1, held));
    }
}
