//! Stream compaction: bits are counted, scanned and listed in scene order.

use super::*;

/// Set bits of each block, and where blocks start; behind the last one the total.
fn sums(device: &Context, of: Bits, bits: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let blocks = of.dispatch(bits.len() as u32);
    let room = vec![77; blocks.x as usize + 1];
    let dispatch = [blocks];
    let table = if of == Bits::Groups { with_filled(bits) } else { bits.to_vec() };
    let bindings = [&table[..], words(&dispatch), &room];
    let counts = device.run(count_bits(of), &bindings, blocks.x).unwrap().swap_remove(2);
    let starts = run(device, scan_blocks(of), &[words(&dispatch), &counts]).swap_remove(1);
    (counts[..blocks.x as usize].to_vec(), starts)
}

#[test]
fn bits_are_counted_and_blocks_start_where_those_before_end() {
    let Some(device) = device("bits_are_counted_and_blocks_start_where_those_before_end") else { return };
    let none = |count: usize| vec![0u32; count];
    for of in [Bits::Groups, Bits::Clusters] {
        let sums = |bits: &[u32]| sums(&device, of, bits);
        let block = of.block() as usize;
        // 65 words: empty, all ones, and one bit in the last.
        assert_eq!(sums(&none(65)), (vec![0], vec![0, 0]));
        assert_eq!(sums(&[u32::MAX; 65]), (vec![2080], vec![0, 2080]));
        let mut last = none(65);
        last[64] = 1 << 31;
        assert_eq!(sums(&last), (vec![1], vec![0, 1]));
        // A word more than a block; a full block, an empty one, and a word.
        let mut bits = none(block + 1);
        (bits[0], bits[block - 1], bits[block]) = (0b111, 1, 0b11);
        assert_eq!(sums(&bits), (vec![4, 2], vec![0, 4, 6]));
        let mut bits = none(2 * block + 1);
        bits[..block].fill(u32::MAX);
        bits[2 * block] = 0xff;
        let full = 32 * of.block();
        assert_eq!(sums(&bits), (vec![full, 0, 8], vec![0, full, full, full + 8]));
        // More blocks than the one workgroup that sums them has lanes: 130 with a bit each.
        let mut bits = none(130 * block);
        bits.chunks_mut(block).enumerate().for_each(|(k, words)| words[k * 3] = 1 << (k % 32));
        assert_eq!(sums(&bits), (vec![1; 130], (0..=130).collect()));
    }
}

/// Candidates listed of the bits of both passes, and the dispatches that follow.
fn listed(
    device: &Context,
    cull_pass: CullPass,
    starts: &[u32],
    bits: &[u32],
    first: &[u32],
    room: usize,
) -> (Vec<CandidateGroup>, Dispatch, Dispatch) {
    let instances: Vec<Instance> = (0..)
        .zip(starts)
        .map(|(k, &group_words)| Instance { group_words, first_group: 100 * k, ..seen() })
        .collect();
    // Group n has n mod 5 + 1 clusters from address 1000 · n on.
    let groups: Vec<Group> = (0..100 * starts.len() as u32 + 2080)
        .map(|n| Group { first: 1000 * n, count: n % 5 + 1, ..Group::zeroed() })
        .collect();
    let (_, starts_of_all) = sums(device, Bits::Groups, bits);
    let (_, starts_of_first) = sums(device, Bits::Groups, first);
    let blocks = Bits::Groups.dispatch(bits.len() as u32);
    let view = View { instances: instances.len() as u32, ..view() };
    let (bits, first) = (with_filled(bits), with_filled(first));
    let out = device
        .run(
            list_groups(cull_pass),
            &[
                words(&[view]),
                words(&instances),
                words(&groups),
                &bits,
                words(&[blocks]),
                &starts_of_all,
                words(&vec![CandidateGroup::zeroed(); room]),
                words(&[Dispatch::default()]),
                words(&[Dispatch::default()]),
                &first,
                &starts_of_first,
            ],
            blocks.x,
        )
        .unwrap();
    (entries(&out[6]), entry(&out[7]), entry(&out[8]))
}

#[test]
fn groups_are_listed_in_scene_order() {
    let Some(device) = device("groups_are_listed_in_scene_order") else { return };
    let c = |instance, group: u32, before| CandidateGroup {
        instance,
        first: 1000 * group,
        count: group % 5 + 1,
        before,
        group: group - 100 * instance,
    };
    // The first instance has two words, the second none, the third the rest.
    let starts = [0, 2, 2];
    let bits = [1 << 31 | 1, 0, 0b110, 1];
    let (list, culling, counting) = listed(&device, CullPass::First, &starts, &bits, &[0; 4], 6);
    let expected = [c(0, 0, NONE), c(0, 31, NONE), c(2, 201, NONE), c(2, 202, NONE), c(2, 232, NONE)];
    assert_eq!(list[..5], expected);
    assert_eq!(list[5], CandidateGroup::zeroed());
    // Eight groups a workgroup; the bits of all clusters in one block.
    assert_eq!((culling, counting), (dispatch(1, 1, 5), dispatch(1, 1, 5)));
    // With too little room what fits is listed, and what there is is counted.
    let (list, culling, counting) = listed(&device, CullPass::First, &starts, &bits, &[0; 4], 2);
    assert_eq!(list, expected[..2]);
    assert_eq!((culling, counting), (dispatch(1, 1, 5), dispatch(1, 1, 2)));
    // The second pass also says where they were in the first list, of which it need not have all.
    let first = [1 << 31 | 1 << 3, 0b1, 0b1100, 0];
    let second = [1 << 31 | 1, 0, 0b110, 1];
    let (list, ..) = listed(&device, CullPass::Second, &starts, &second, &first, 5);
    assert_eq!(list, [c(0, 0, NONE), c(0, 31, 1), c(2, 201, NONE), c(2, 202, 3), c(2, 232, NONE)]);
    // All ones over 65 words of an instance: every group once, in order.
    let (list, culling, _) = listed(&device, CullPass::First, &[0; 21], &[u32::MAX; 65], &[0; 65], 2080);
    assert_eq!(culling.count, 2080);
    assert!((0..).zip(&list).all(|(k, found): (u32, _)| *found == c(20, 2000 + k, NONE)));
    // Instances of two words, and others among them.
    let starts = [0, 2, 4, 6, 30, 31, 31, 60];
    let (list, ..) = listed(&device, CullPass::First, &starts, &[u32::MAX; 65], &[0; 65], 2080);
    let instance = |word: u32| starts.partition_point(|start| *start <= word) as u32 - 1;
    let expected = (0..2080).map(|k: u32| {
        let instance = instance(k / 32);
        c(instance, 100 * instance + k - 32 * starts[instance as usize], NONE)
    });
    assert!(list.into_iter().eq(expected));
    // Nothing at all.
    let starts = [0, 2, 2];
    let (_, culling, counting) = listed(&device, CullPass::First, &starts, &[0; 4], &[0; 4], 4);
    assert_eq!((culling.x, culling.count, counting.x, counting.count), (0, 0, 0, 0));
}

#[test]
fn clusters_are_listed_in_scene_order() {
    let Some(device) = device("clusters_are_listed_in_scene_order") else { return };
    let candidates: Vec<CandidateGroup> = [(0, 100), (0, 200), (1, 300)]
        .map(|(instance, first)| CandidateGroup {
            instance,
            first,
            count: 32,
            before: NONE,
            group: first / 100,
        })
        .to_vec();
    let v = |instance, cluster, large| VisibleCluster { instance, cluster, large };
    let visible = [v(0, 100, 0), v(0, 102, 1), v(0, 105, 0), v(1, 300, 0), v(1, 331, 1)];
    let mark = |large, old| Marks { large, old, first: 0, clipped: 0 };
    // Bits of groups: a word for each instance.
    let instances = [seen(), Instance { group_words: 1, ..seen() }];
    let list = |cull_pass,
                candidates: &[CandidateGroup],
                drawn: [u32; 4],
                marks: [Marks; 3],
                first: &[Marks],
                room: usize,
                history: Option<u32>| {
        let two_passes = u32::from(history.is_some());
        let view = View { group_words: 3, two_passes, history: history.unwrap_or(0), ..view() };
        let blocks = dispatch(1, 1, 3);
        let (_, sums) = sums(&device, Bits::Clusters, &drawn[..3]);
        let out = run(
            &device,
            list_clusters(cull_pass),
            &[
                words(&[view]),
                words(candidates),
                words(&[blocks]),
                &drawn,
                words(&marks),
                &sums,
                words(&vec![VisibleCluster::zeroed(); room]),
                &vec![99; 2 * room],
                words(&[Dispatch::default(); LISTS]),
                words(&[Counters::default()]),
                words(first),
                &[88; 4],
                words(&[DrawArgs::zeroed(); LISTS]),
                words(&instances),
                &[0; 4],
            ],
        );
        let draws: Vec<Dispatch> = entries(&out[8]);
        let counts = [0, 1, 2, 3].map(|list: usize| draws[list].count as usize);
        assert_eq!(draws, counts.map(|n| dispatch(n as u32, u32::from(n > 0), n as u32)));
        // The same for draws of 128 triangles; clipped ones and those with holes are not drawn so.
        let draw_args: Vec<DrawArgs> = entries(&out[12]);
        assert_eq!(draw_args.iter().map(|call| call.instances as usize).collect::<Vec<_>>(), counts);
        assert_eq!(draw_args.iter().map(|call| call.vertices).collect::<Vec<_>>(), [384, 384, 0, 0]);
        let [small, large, clipped, alpha_tested] = counts.map(|n| n.min(room));
        let mut front = out[7][..small].to_vec();
        let lists =
            [&out[7][room - large..room], &out[7][room..room + clipped], &out[7][2 * room - alpha_tested..]];
        let mut back = lists.concat();
        front.sort_unstable();
        back.sort_unstable();
        let counters: Counters = entry(&out[9]);
        let firsts: Vec<Marks> = entries(&out[4]);
        let (visible, marked) = (entries::<VisibleCluster>(&out[6]), out[14].clone());
        (visible, front, back, counters.visible, firsts, out[11].clone(), marked)
    };
    // Members 0, 2 and 5 of the first, none of the second, 0 and 31 of the third.
    let drawn = [0b10_0101, 0, 1 << 31 | 1, 0];
    let marks = [mark(0b100, 0), mark(0, 0), mark(1 << 31, 0)];
    let (found, small, large, count, firsts, _, marked) =
        list(CullPass::First, &candidates, drawn, marks, &marks, 6, None);
    assert_eq!((&found[..5], found[5]), (&visible[..], VisibleCluster::zeroed()));
    // Small ones from the front, large ones from the back.
    assert_eq!((small, large, count), (vec![0, 2, 3], vec![1, 4], 5));
    assert_eq!((firsts[0].first, firsts[2].first), (0, 3));
    // Where there is a second pass, it lists their groups: all of them, or of a list those that are still drawn.
    assert_eq!(marked, [0; 4]);
    let marked = |history| list(CullPass::First, &candidates, drawn, marks, &marks, 6, Some(history)).6;
    for history in [0, 1] {
        assert_eq!(marked(history), [0b110, 0b1000, 0, 0b11]);
    }
    assert_eq!(marked(HISTORY_LIST), [0b010, 0b1000, 0, 0b11]);
    // Some of the small ones may have holes, and are drawn where large ones are.
    let holes = [Marks { clipped: 0b1, ..marks[0] }, marks[1], Marks { clipped: 0b1, ..marks[2] }];
    let (found, small, large, count, ..) = list(CullPass::First, &candidates, drawn, holes, &holes, 6, None);
    assert_eq!((small, large, count), (vec![2], vec![0, 1, 3, 4], 5));
    assert_eq!(found[..5].iter().map(|v| v.large).collect::<Vec<_>>(), [1, 1, 0, 1, 1]);
    // With too little room the rest is counted.
    let (found, _, _, count, ..) = list(CullPass::First, &candidates, drawn, marks, &marks, 3, None);
    assert_eq!((&found[..], count), (&visible[..3], 5));
    // The second pass: the first one drew members 2 and 5 of the first and 31 of the third, as its numbers 0, 1 and 2.
    let again: Vec<CandidateGroup> =
        (0..).zip(&candidates).map(|(k, c)| CandidateGroup { before: [1, NONE, 0][k], ..*c }).collect();
    let before = [Marks { first: 2, ..mark(1 << 31, 0) }, Marks { first: 0, ..mark(0b100, 0) }];
    let marks = [mark(0, 0b10_0100), mark(0, 0), mark(0, 1 << 31)];
    let (found, small, large, count, _, renumbered, marked) =
        list(CullPass::Second, &again, drawn, marks, &before, 6, Some(1));
    assert_eq!(marked, [0; 4]);
    assert_eq!((&found[..5], count), (&visible[..], 5));
    // Only the new ones are drawn; the old ones have become 1, 2 and 4.
    assert_eq!((small, large, renumbered), (vec![0, 3], vec![], vec![1, 2, 4, 88]));
}
