//! Stage 2: the rule of the cut over nodes, pages that are not resident, the second pass.

use super::*;

/// What looking at nodes leaves.
struct Walked {
    next: Dispatch,
    items: Vec<TraversalItem>,
    bits: Vec<u32>,
    occluded_queue: Vec<TraversalItem>,
    /// Pixels by which the page of the groups is missed.
    wanted: f32,
}

/// What is looked at, and by what.
#[derive(Clone, Copy)]
struct Walk<'a> {
    cull_pass: CullPass,
    view: &'a View,
    items: &'a [TraversalItem],
    pyramid: &'a [u32],
    /// The first of two.
    instance: Instance,
    /// A word of the table of the one page that all groups lie in.
    page: u32,
    /// Groups of the first word that have marks.
    marked: u32,
}

fn walk(
    device: &Context,
    cull_pass: CullPass,
    view: &View,
    items: &[TraversalItem],
    pyramid: &[u32],
) -> Walked {
    walk_as(device, Walk { cull_pass, view, items, pyramid, instance: seen(), page: 0, marked: 0 })
}

fn walk_as(device: &Context, walk: Walk<'_>) -> Walked {
    let Walk { cull_pass, view, items, pyramid, instance, page, marked } = walk;
    // The root has two leaves; a pixel is the error of one, less than that of the other.
    let nodes = [node(PIXEL, 1, 2, false), node(PIXEL, 0, 3, true), node(LESS, 3, 1, true)];
    // A pixel, less, off the screen; a pixel.
    let groups =
        [group(PIXEL, 0.0), group(LESS, 0.0), group(PIXEL, 13.0), group(PIXEL, 0.0), group(PIXEL, 0.0)];
    // The mesh of the second instance starts at the second node and the third group.
    let instances = [instance, Instance { first_node: 1, first_group: 2, group_words: 1, ..seen() }];
    let level = dispatch(1, 1, items.len() as u32);
    let view = View { group_words: 4, ..*view };
    let mut out = run(
        device,
        node_cull(cull_pass),
        &[
            words(&[view]),
            words(&instances),
            words(&nodes),
            words(&groups),
            words(items),
            words(&[level]),
            &[0; 4],
            words(&[Dispatch::default()]),
            &with_filled(&[marked, 0, 0, 0]),
            pyramid,
            &[0; 8],
            words(&[Dispatch::default()]),
            &[page],
            &[0],
        ],
    );
    let (next, occluded_dispatch): (Dispatch, Dispatch) = (entry(&out[7]), entry(&out[11]));
    let list = |words: &[u32], count: u32| {
        let mut items: Vec<TraversalItem> = entries(words);
        items.truncate(count as usize);
        items.sort();
        items
    };
    let (items, occluded_queue) = (list(&out[6], next.count), list(&out[10], occluded_dispatch.count));
    let wanted = f32::from_bits(out[13][0]);
    let mut bits = out.swap_remove(8);
    let found = bits.clone();
    bits.truncate(4);
    assert_eq!(found, with_filled(&bits));
    Walked { next, items, bits, occluded_queue, wanted }
}

#[test]
fn nodes_above_the_threshold_are_walked() {
    let Some(device) = device("nodes_above_the_threshold_are_walked") else { return };
    let root = TraversalItem { instance: 0, node: 0 };
    let at = |tau: f32| View { tau, ..view() };
    let no_pyramid = [0; KEYS];
    let go = |view: &View, items: &[TraversalItem]| walk(&device, CullPass::First, view, items, &no_pyramid);
    // The root is at the threshold, then by one step above it.
    let walked = go(&at(1.0), &[root]);
    assert_eq!((walked.next, walked.items), (Dispatch::default(), vec![]));
    let walked = go(&at(TAU), &[root]);
    let children = [1, 2].map(|node| TraversalItem { instance: 0, node });
    assert_eq!((walked.next, &walked.items[..]), (dispatch(1, 1, 2), &children[..]));
    assert_eq!((&walked.bits[..], &walked.occluded_queue[..]), (&[0; 4][..], &[][..]));
    // Of the leaves one is above it, and of its three groups the first: the second is below, the third off the screen.
    let walked = go(&at(TAU), &children);
    assert_eq!(walked.next, Dispatch { visited: 3, ..Dispatch::default() });
    assert_eq!(walked.bits, [0b1, 0, 0, 0]);
    // At zero, full detail: what has an error at all.
    let walked = go(&at(0.0), &children);
    assert_eq!((walked.next.visited, walked.bits), (4, vec![0b1011, 0, 0, 0]));
    // Another instance starts elsewhere in every array: its node 0 is that leaf, and its groups 0 to 2 are 2 to 4 of all.
    let walked = go(&at(0.0), &[TraversalItem { instance: 1, node: 0 }]);
    assert_eq!((walked.next.visited, walked.bits), (3, vec![0, 0b110, 0, 0]));
}

/// An error of 0.5, on whatever sphere inside of the one at distance 10, makes 0.5 · 64 / (10 + 1.875) pixels at least,
/// less a 64th of that: 2.6526.
#[test]
fn what_is_too_coarse_all_through_is_left_out() {
    let Some(device) = device("what_is_too_coarse_all_through_is_left_out") else { return };
    let found = |tau: f32, own: [f32; 3]| {
        let [of_root, of_leaf, of_group] = own;
        let nodes = [
            Node { min_own_error: of_root, ..node(1.0, 1, 1, false) },
            Node { min_own_error: of_leaf, ..node(1.0, 0, 2, true) },
        ];
        let groups = [Group { min_own_error: of_group, ..group(1.0, 0.0) }, group(1.0, 0.0)];
        let items = [0, 1].map(|node| TraversalItem { instance: 0, node });
        let view = View { tau, group_words: 1, ..view() };
        let out = run(
            &device,
            node_cull(CullPass::First),
            &[
                words(&[view]),
                words(&[seen()]),
                words(&nodes),
                words(&groups),
                words(&items),
                words(&[dispatch(1, 1, 2)]),
                &[0; 4],
                words(&[Dispatch::default()]),
                &[0; 2],
                &[0; KEYS],
                &[0; 8],
                words(&[Dispatch::default()]),
                &[0],
                &[0],
            ],
        );
        (entry::<Dispatch>(&out[7]).count, out[8][0])
    };
    let (source, error) = (SOURCE_ERROR, 0.5);
    for (tau, coarse) in [(2.652, true), (2.653, false)] {
        // One child is walked, and both groups are marked, but for what is too coarse.
        assert_eq!(found(tau, [source; 3]), (1, 0b11));
        assert_eq!(found(tau, [error, source, source]), (u32::from(!coarse), 0b11));
        assert_eq!(found(tau, [source, error, source]), (1, if coarse { 0 } else { 0b11 }));
        assert_eq!(found(tau, [source, source, error]), (1, if coarse { 0b10 } else { 0b11 }));
    }
    // An error of the source is never too large, nor is none.
    assert_eq!(found(0.0, [source; 3]), (1, 0b11));
    assert_eq!(found(0.0, [0.0; 3]), (1, 0b11));
}

/// A page that is not there is asked for with the largest error of its groups on the screen, a pixel here, and none of
/// its groups is marked. Where a second pass knows what hides them, the first leaves it to that.
#[test]
fn groups_that_are_not_there_are_asked_for() {
    let Some(device) = device("groups_that_are_not_there_are_asked_for") else { return };
    let leaf = TraversalItem { instance: 0, node: 1 };
    let view = |two_passes| View { tau: 0.5, two_passes, ..view() };
    let go = |cull_pass, two_passes, page, key: u32| {
        let (view, items, pyramid) = (&view(two_passes), &[leaf][..], &[key; KEYS][..]);
        walk_as(&device, Walk { cull_pass, view, items, pyramid, instance: seen(), page, marked: 0 })
    };
    let there = go(CullPass::First, 0, 0, 0);
    assert_eq!((there.wanted, there.bits[0]), (0.0, 0b11));
    let pixels = go(CullPass::First, 0, u32::MAX, 0);
    assert_eq!((pixels.wanted, pixels.bits[0], pixels.occluded_queue.len()), (1.0, 0, 0));
    let occluded_queue = go(CullPass::First, 1, u32::MAX, 0);
    assert_eq!(
        (occluded_queue.wanted, occluded_queue.bits[0], &occluded_queue.occluded_queue[..]),
        (0.0, 0, &[leaf][..])
    );
    let second = go(CullPass::Second, 1, u32::MAX, key(f32::INFINITY));
    assert_eq!((second.wanted, second.bits[0], second.occluded_queue.len()), (1.0, 0, 0));
    let hidden = go(CullPass::Second, 1, u32::MAX, key(1.0));
    assert_eq!((hidden.wanted, hidden.bits[0], hidden.occluded_queue.len()), (0.0, 0, 0));
}

/// The ball of the root's sphere and error has radius 2 and lies on the axis at distance 10: 8 is its least depth, so that
/// the tangent of no point in it is above 2 / 8. That makes 1 + 1/16 pixels of one.
#[test]
fn errors_grow_towards_the_corners_of_the_picture() {
    let Some(device) = device("errors_grow_towards_the_corners_of_the_picture") else { return };
    let root = TraversalItem { instance: 0, node: 0 };
    let walked = |lod_widest: f32, tau: f32| {
        let view = View { tau, lod_widest, ..view() };
        walk(&device, CullPass::First, &view, &[root], &[0; KEYS]).next.count > 0
    };
    let angle = 1.0625;
    assert!(walked(4.0, angle - 0.001) && !walked(4.0, angle));
    // No point is farther off the axis than the picture's corner.
    assert!(walked(1.03125, 1.03) && !walked(1.03125, 1.03125));
}

#[test]
fn a_list_of_nodes_counts_on_past_its_end() {
    let Some(device) = device("a_list_of_nodes_counts_on_past_its_end") else { return };
    // Three roots with two children each, and room for two.
    let walked = walk(
        &device,
        CullPass::First,
        &View { tau: TAU, ..view() },
        &[TraversalItem { instance: 0, node: 0 }; 3],
        &[0; KEYS],
    );
    assert_eq!(walked.next, dispatch(1, 1, 6));
    assert_eq!(walked.items.len(), 2);
    assert!(walked.items.iter().all(|item| item.instance == 0 && (1..3).contains(&item.node)));
}

#[test]
fn hidden_nodes_wait_for_the_second_phase() {
    let Some(device) = device("hidden_nodes_wait_for_the_second_phase") else { return };
    let view = View { tau: TAU, history: 1, ..view() };
    for node in [0, 1] {
        let item = TraversalItem { instance: 0, node };
        let go = |cull_pass, distance: f32| walk(&device, cull_pass, &view, &[item], &[key(distance); KEYS]);
        // All of the box is behind distance 8; it starts at 9.
        let walked = go(CullPass::First, 8.0);
        assert_eq!((walked.next, &walked.occluded_queue[..]), (Dispatch::default(), &[item][..]));
        // The second pass puts nothing off. It counts the instances that it does not hide, by their roots.
        let walked = go(CullPass::Second, 8.0);
        assert_eq!(walked.next, Dispatch { unhidden: 1 - node, ..Dispatch::default() });
        assert_eq!((walked.items, walked.occluded_queue, walked.bits), (vec![], vec![], vec![0; 4]));
        for cull_pass in CullPass::BOTH {
            let walked = go(cull_pass, 12.0);
            let expected = [(2, 0, 0), (0, 3, 1)][node as usize];
            assert_eq!((walked.next.count, walked.next.visited, walked.bits[0]), expected);
            assert_eq!(walked.occluded_queue, []);
        }
    }
    // Before it looks at a root, at the box of the instance, where stage 1 left it.
    let root = TraversalItem { instance: 0, node: 0 };
    let from_root = |view: &View, pyramid: &[u32], instance: Instance| {
        let (cull_pass, items) = (CullPass::Second, &[root][..]);
        walk_as(&device, Walk { cull_pass, view, items, pyramid, instance, page: 0, marked: 0 }).next
    };
    let starts = |rect: [u32; 4], near_key: u32| {
        let mut pyramid = vec![key(12.0); KEYS];
        // Three pixels of a square: what is small is looked for among pixels.
        [(42, 30), (43, 30), (43, 31)].iter().for_each(|(x, y)| pyramid[100 * y + x] = key(8.0));
        from_root(&view, &pyramid, Instance { rect, near_key, ..seen() })
    };
    for rect in [[43, 31, 43, 31], [42, 30, 43, 30], [43, 30, 43, 31]] {
        assert_eq!(starts(rect, key(8.01)), Dispatch::default(), "{rect:?}");
    }
    let shown = [([43, 31, 43, 31], 7.99), ([42, 31, 42, 31], 8.01), ([42, 30, 43, 31], 8.01)];
    for (rect, distance) in [&shown[..], &[([41, 30, 43, 30], 8.01), ([43, 31, 43, 32], 8.01)]].concat() {
        let next = starts(rect, key(distance));
        assert_eq!((next.count, next.unhidden), (2, 1), "{rect:?}, {distance}");
    }
    // Where there are no keys of pixels, it is looked for among squares of four.
    let coarse = |square: f32| {
        let mut levels = view.pyramid;
        levels[0][3] = 0;
        let view = View { pyramid: levels, ..view };
        let mut pyramid = vec![key(12.0); KEYS];
        pyramid[8000 + 15 * 52 + 21] = key(square);
        let instance = Instance { rect: [43, 31, 43, 31], near_key: key(8.01), ..seen() };
        from_root(&view, &pyramid, instance).count
    };
    assert_eq!((coarse(8.0), coarse(8.02)), (0, 2));
    // The boxes of the groups start at 9.5: with all nearer than 9.2 the leaf is seen, and they are not.
    let leaf = TraversalItem { instance: 0, node: 1 };
    for (cull_pass, occluded_queue) in [(CullPass::First, vec![leaf]), (CullPass::Second, vec![])] {
        let walked = walk(&device, cull_pass, &view, &[leaf], &[key(9.2); KEYS]);
        assert_eq!((walked.next.visited, walked.bits[0], walked.occluded_queue), (3, 0, occluded_queue));
    }
}

#[test]
fn groups_that_the_first_phase_marked_are_not_looked_at() {
    let Some(device) = device("groups_that_the_first_phase_marked_are_not_looked_at") else { return };
    let view = View { tau: TAU, history: 1, ..view() };
    let leaf = TraversalItem { instance: 0, node: 1 };
    // Of its three groups, the pyramid hides those that are not marked; a mark stays.
    let (view, items, pyramid) = (&view, &[leaf][..], &[key(9.2); KEYS][..]);
    let instance = seen();
    let go = |cull_pass| {
        walk_as(&device, Walk { cull_pass, view, items, pyramid, instance, page: 0, marked: 0b110 })
    };
    let walked = go(CullPass::Second);
    assert_eq!((walked.next.visited, walked.bits[0]), (3, 0b110));
    // The first pass has marks of no other.
    let walked = go(CullPass::First);
    assert_eq!((walked.next.visited, walked.bits[0], walked.occluded_queue), (3, 0b110, vec![leaf]));
}
