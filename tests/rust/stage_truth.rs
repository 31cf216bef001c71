//! Kernels by themselves, on tables made by hand: what goes in is written down, and what has to come out was worked out
//! on paper, not by the CPU twin.

use bytemuck::{Pod, Zeroable, cast_slice};
use nanite_rs::gpu::Context;
use nanite_rs::gpu::shaders::{Bits, CullPass, IndirectEntry, Kernel, List, Words};
use nanite_rs::gpu_types::{
    CandidateGroup, Counters, Dispatch, DrawArgs, Group, HISTORY_LIST, Instance, InstanceTransform, Marks,
    Node, TILES, TraversalItem, View, VisibleCluster,
};
use nanite_rs::limits::{PYRAMID_ABOVE, PYRAMID_LEVELS};
use nanite_rs::math::Sphere;
use nanite_rs::model::cluster::RECORD_WORDS;
use nanite_rs::model::packing::{VertexRow, vertex_row, write_triangles};
use nanite_rs::model::rule::SOURCE_ERROR;
use nanite_rs::model::{AttributeLayout, ClusterAddress, ClusterRecord, Packing};

use crate::gpu_parity::device;

/// No earlier place.
const NONE: u32 = u32::MAX;

fn words<T: Pod>(entries: &[T]) -> &[u32] {
    cast_slice(entries)
}

fn entries<T: Pod>(words: &[u32]) -> Vec<T> {
    cast_slice(words).to_vec()
}

fn entry<T: Pod>(words: &[u32]) -> T {
    entries(words)[0]
}

/// Runs a kernel in one workgroup.
fn run(device: &Context, kernel: Kernel, bindings: &[&[u32]]) -> Vec<Vec<u32>> {
    device.run(kernel, bindings, 1).unwrap()
}

fn dispatch(x: u32, y: u32, count: u32) -> Dispatch {
    Dispatch { x, y, z: u32::from(x > 0), count, ..Dispatch::default() }
}

/// 100 × 80 pixels from the origin along −z, between distances 1 and 20: across, x = ±d is the edge of the picture; up
/// and down, y = ±d.
fn view() -> View {
    let mut pyramid = [[0; 4]; PYRAMID_LEVELS];
    pyramid[..8].copy_from_slice(&[
        [100, 80, 0, 100],
        [50, 40, 8000, 52],
        [25, 20, 10_080, 28],
        [13, 10, 10_640, 16],
        [7, 5, 10_800, 8],
        [4, 3, 10_840, 4],
        [2, 2, 10_852, 4],
        [1, 1, 10_860, 4],
    ]);
    View {
        width: 100,
        height: 80,
        near: 1.0,
        far: 20.0,
        // Of the depth value 1 / 20.
        far_key: 0.05f32.to_bits(),
        levels: 8,
        pyramid,
        rotate: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        forward: [0.0, 0.0, -1.0],
        focal: [50.0, -40.0],
        center: [50.0, 40.0],
        lod_focal: 64.0,
        lod_near: 1.0,
        lod_widest: 1.0,
        ..View::zeroed()
    }
}

/// Keys of the pyramid of that view.
const KEYS: usize = 10_864;

/// A mesh in a box of half extent 1 about a place.
fn instance_transform(x: f32, y: f32, z: f32) -> InstanceTransform {
    InstanceTransform {
        linear: [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]],
        inverse: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        lod_scale: 1.0,
        extent: [1.0; 3],
        visible: 1,
        ..InstanceTransform::zeroed()
    }
}

/// An instance at distance 10 in the middle of that view, as it was in the frame before.
fn seen() -> Instance {
    let screen = [[50.0, 0.0, -50.0, 500.0], [0.0, -40.0, -40.0, 400.0], [0.0, 0.0, -1.0, 10.0]];
    Instance {
        screen,
        before: screen,
        object_to_eye: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -10.0]],
        lod_scale: 1.0,
        lod_focal: 64.0,
        near_key: u32::MAX,
        eye: [0.0, 0.0, 10.0],
        ..Instance::zeroed()
    }
}

/// The visits that a walk goes on with, in order, and those that it puts off. Instances were elsewhere in the frame before.
fn culled(
    device: &Context,
    view: &View,
    instance_transform: &[InstanceTransform],
    before: &[InstanceTransform],
    pyramid: &[u32],
) -> [Vec<TraversalItem>; 2] {
    let before: Vec<Instance> = before
        .iter()
        .map(|p| {
            let [x, y, z] = [0, 1, 2].map(|k| p.linear[k][3]);
            let mut instance = seen();
            instance.screen[0][3] = 50.0 * x - 50.0 * z;
            instance.screen[1][3] = -40.0 * y - 40.0 * z;
            instance.screen[2][3] = -z;
            instance
        })
        .collect();
    let (list, level) = (vec![0; 2 * instance_transform.len().max(2)], [Dispatch::default()]);
    let view = words(std::slice::from_ref(view));
    let bindings = [
        view,
        words(instance_transform),
        words(&before),
        &list,
        words(&level),
        pyramid,
        &list,
        words(&level),
    ];
    let out = run(device, Kernel::InstanceCull, &bindings);
    [[3, 4], [6, 7]].map(|[list, level]| {
        let level: Dispatch = entry(&out[level]);
        let x = u32::from(level.count > 0);
        assert_eq!(level, dispatch(x, x, level.count));
        let mut items: Vec<TraversalItem> = entries(&out[list]);
        items.truncate(level.count as usize);
        items.sort();
        items
    })
}

#[test]
fn instances_are_seen_as_far_as_a_pixel_may_show_them() {
    let Some(device) = device("instances_are_seen_as_far_as_a_pixel_may_show_them") else { return };
    // (x, y, z), and whether it is seen. The far corners of a box at distance 10 are 11 away: there the centres of the
    // last pixels lie half a pixel within the picture's edge, and 1/16 of one is for rounding: at 11 · 49.5625/50 = 10.904
    // across, 11 · 39.5625/40 = 10.880 up and down.
    let table = [
        ([0.0, 0.0, -10.0], true),
        // Right, left, top, bottom.
        ([11.90, 0.0, -10.0], true),
        ([11.91, 0.0, -10.0], false),
        ([-11.90, 0.0, -10.0], true),
        ([-11.91, 0.0, -10.0], false),
        ([0.0, 11.87, -10.0], true),
        ([0.0, 11.89, -10.0], false),
        ([0.0, -11.87, -10.0], true),
        ([0.0, -11.89, -10.0], false),
        // The near plane, by the far side of the box; behind the eye.
        ([0.0, 0.0, -0.01], true),
        ([0.0, 0.0, 0.01], false),
        ([0.0, 0.0, 10.0], false),
        // The far plane, by the near side.
        ([0.0, 0.0, -20.99], true),
        ([0.0, 0.0, -21.01], false),
        // Across the near plane, from 0 to 2: there the edge of the picture lies at 2, a pixel beyond it at 2.04.
        ([3.03, 0.0, -1.0], true),
        ([3.05, 0.0, -1.0], false),
        ([-3.03, 0.0, -1.0], true),
        ([-3.05, 0.0, -1.0], false),
        ([0.0, 3.04, -1.0], true),
        ([0.0, 3.06, -1.0], false),
        ([0.0, -3.04, -1.0], true),
        ([0.0, -3.06, -1.0], false),
    ];
    let mut instances: Vec<InstanceTransform> =
        table.iter().map(|([x, y, z], _)| instance_transform(*x, *y, *z)).collect();
    // One that the user hid.
    instances.push(InstanceTransform { visible: 0, ..instances[0] });
    let view = View { instances: instances.len() as u32, ..view() };
    let expected: Vec<TraversalItem> = (0..)
        .zip(&table)
        .filter(|(_, (_, seen))| *seen)
        .map(|(instance, _)| TraversalItem { instance, node: 0 })
        .collect();
    assert_eq!(culled(&device, &view, &instances, &instances, &[0; KEYS]), [expected, vec![]]);
}

#[test]
fn an_instance_as_seen_from_the_eye() {
    let Some(device) = device("an_instance_as_seen_from_the_eye") else { return };
    let view = View { instances: 2, mirrored: 1, ..view() };
    let there = InstanceTransform { group_words: 7, first_node: 5, ..instance_transform(3.0, -2.0, -10.0) };
    let hidden = InstanceTransform { group_words: 9, visible: 0, ..there };
    let (list, level) = ([0; 4], [Dispatch::default()]);
    let old = [Instance { screen: [[4.0; 4]; 3], lod_focal: 9.0, ..Instance::zeroed() }; 2];
    let out = run(
        &device,
        Kernel::InstanceCull,
        &[
            words(&[view]),
            words(&[there, hidden]),
            words(&old),
            &list,
            words(&level),
            &[0; KEYS],
            &list,
            words(&level),
        ],
    );
    let [found, not_seen]: [Instance; 2] = entries(&out[2]).try_into().unwrap();
    // 50 · (x + 3) + 50 · (10 − z), −40 · (y − 2) + 40 · (10 − z), and the distance 10 − z.
    let screen = [[50.0, 0.0, -50.0, 650.0], [0.0, -40.0, -40.0, 480.0], [0.0, 0.0, -1.0, 10.0]];
    assert_eq!(found.screen, screen);
    assert_eq!(found.before, [[4.0; 4]; 3]);
    let to_eye = [[1.0, 0.0, 0.0, 3.0], [0.0, 1.0, 0.0, -2.0], [0.0, 0.0, 1.0, -10.0]];
    assert_eq!(found.object_to_eye, to_eye);
    assert_eq!((found.eye, found.extent, found.mirrored), ([-3.0, 2.0, 10.0], [1.0; 3], 1));
    assert_eq!((found.group_words, found.first_node), (7, 5));
    assert_eq!((not_seen.group_words, not_seen.screen), (9, old[1].screen));
    // Which tells that nothing of it is to be drawn.
    assert_eq!((found.lod_focal, not_seen.lod_focal), (64.0, 0.0));
}

/// The depth key of a distance in a view with near distance 1.
fn key(distance: f32) -> u32 {
    (1.0 / distance).to_bits()
}

#[test]
fn what_the_earlier_pyramid_hides_is_put_off() {
    let Some(device) = device("what_the_earlier_pyramid_hides_is_put_off") else { return };
    // At distance 7 to 9 in the middle: 50 ± 50/7 across and 40 ± 40/7 down, which are the centres of columns 43 to 56
    // and rows 34 to 45. That is columns 5 to 7 and rows 4 to 5 of level 3, the first where no side is longer than four
    // texels, and 21 to 28 and 17 to 22 of level 1, two levels finer.
    let coarse = |column: usize, row: usize| 10_640 + row * 16 + column;
    let fine = |column: usize, row: usize| 8000 + row * 52 + column;
    let box_nearer = 6.99;
    let behind = vec![key(box_nearer); KEYS];
    let with = |holes: &[usize]| {
        let mut keys = behind.clone();
        holes.iter().for_each(|&hole| keys[hole] = 0);
        keys
    };
    let table = [
        (vec![key(7.01); KEYS], false),
        (behind.clone(), true),
        // A hole beside the box, on either level.
        (with(&[coarse(4, 4), coarse(8, 5), fine(20, 17), fine(29, 22)]), true),
        // A hole that the finer level does not have.
        (with(&[coarse(5, 4)]), true),
        (with(&[coarse(7, 5), fine(28, 22)]), false),
        (with(&[coarse(5, 4), fine(21, 17)]), false),
        (with(&[coarse(5, 4), fine(29, 23)]), true),
    ];
    for (number, (pyramid, hidden)) in table.into_iter().enumerate() {
        let go = |view: &View, now: InstanceTransform, before: InstanceTransform| {
            let [drawn, occluded_queue] = culled(&device, view, &[now], &[before], &pyramid);
            assert_eq!([&drawn[..], &occluded_queue].concat(), [TraversalItem { instance: 0, node: 0 }]);
            occluded_queue.len() == 1
        };
        let here = instance_transform(0.0, 0.0, -8.0);
        let now = View { instances: 1, history: 1, ..view() };
        assert_eq!(go(&now, here, here), hidden, "{number}");
        // By where it was; and what reaches the near plane is never hidden.
        assert_eq!(go(&now, instance_transform(5.0, 2.0, -12.0), here), hidden, "{number}");
        assert!(!go(&now, here, instance_transform(0.0, 0.0, -1.5)));
        // All that is on the picture, where the first pass has a list to start from.
        let listed = View { history: HISTORY_LIST, ..now };
        assert!(go(&listed, here, here) && go(&listed, instance_transform(0.0, 0.0, -1.5), here));
        let nothing = culled(&device, &listed, &[instance_transform(99.0, 0.0, -10.0)], &[here], &pyramid);
        assert_eq!(nothing, [vec![], vec![]]);
        // What was not on the picture, or where there was none, is put off where it is not near enough.
        let off = instance_transform(99.0, 0.0, -10.0);
        for (history, before) in [(0, here), (1, off)] {
            for (occluders, far) in [(0, false), (key(7.01), false), (key(6.99), true), (u32::MAX, true)] {
                let view = View { history, occluders, ..now };
                assert_eq!(go(&view, here, before), far);
                assert!(!go(&view, instance_transform(0.0, 0.0, -1.5), before));
            }
        }
    }
}

/// A sphere and an error at distance 10 that make exactly a pixel: 0.125 · 64 / (10 − 1.875 − 0.125).
const LISTS: usize = List::COUNT as usize;

const SPHERE: Sphere = Sphere { center: [0.0; 3], radius: 1.875 };
const PIXEL: f32 = 0.125;
/// The next smaller error: 0.125 − 2⁻²⁷ makes 1 − 2⁻²⁴ pixels, the next smaller f32.
const LESS: f32 = 0.125 - 1.0 / 134_217_728.0;
/// That many pixels: the threshold that the one exceeds and the other does not.
const TAU: f32 = 1.0 - 1.0 / 16_777_216.0;

fn node(max_parent_error: f32, first: u32, count: u16, is_leaf: bool) -> Node {
    Node {
        center: [0.0; 3],
        extent: [1.0; 3],
        lod_sphere: SPHERE,
        max_parent_error,
        min_own_error: SOURCE_ERROR,
        first,
        count,
        is_leaf: u16::from(is_leaf),
        unused: [0; 2],
    }
}

fn group(error: f32, x: f32) -> Group {
    let center = [x, 0.0, 0.0];
    let min_own_error = SOURCE_ERROR;
    Group { lod_sphere: SPHERE, error, center, extent: [0.5; 3], min_own_error, ..Group::zeroed() }
}

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
        Kernel::NodeCull(cull_pass),
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
            Kernel::NodeCull(CullPass::First),
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
        for cull_pass in [CullPass::First, CullPass::Second] {
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
            Kernel::ClusterCull(CullPass::First),
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
            Kernel::ClusterCull(CullPass::Second),
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
            Kernel::ClusterCull(CullPass::First),
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

/// Words of bits, with a bit for each that is not zero behind them.
fn with_filled(bits: &[u32]) -> Vec<u32> {
    let filled =
        bits.chunks(32).map(|words| (0..).zip(words).map(|(k, word)| u32::from(*word != 0) << k).sum());
    bits.iter().copied().chain(filled).collect()
}

/// Set bits of each block, and where blocks start; behind the last one the total.
fn sums(device: &Context, of: Bits, bits: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let blocks = of.dispatch(bits.len() as u32);
    let room = vec![77; blocks.x as usize + 1];
    let dispatch = [blocks];
    let table = if of == Bits::Groups { with_filled(bits) } else { bits.to_vec() };
    let bindings = [&table[..], words(&dispatch), &room];
    let counts = device.run(Kernel::CountBits(of), &bindings, blocks.x).unwrap().swap_remove(2);
    let starts = run(device, Kernel::ScanBlocks(of), &[words(&dispatch), &counts]).swap_remove(1);
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
            Kernel::ListGroups(cull_pass),
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
            Kernel::ListClusters(cull_pass),
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

/// Pixels of the pictures that triangles are drawn into, across and down.
const SIDE: usize = 8;

/// A cluster of triangles, in pixels and depth.
struct Triangles {
    corners: Vec<[f32; 3]>,
    triangles: Vec<[u8; 3]>,
}

/// Pixels as (key, low half), drawn by a rasterizer; and the triangles that it counted.
fn drawn(
    device: &Context,
    large: bool,
    view: &View,
    instance: Instance,
    clusters: &[Triangles],
) -> (Vec<(u32, u32)>, u32) {
    // A page for each: its record, and its streams. Positions are on a grid where they can be, and else as they are.
    const STEP: f32 = 0.0625;
    let (mut pages, mut offsets) = (Vec::new(), Vec::new());
    for Triangles { corners, triangles } in clusters {
        offsets.push(pages.len() as u32);
        let record = ClusterRecord {
            vertex_count: corners.len() as u8,
            triangle_count: triangles.len() as u8,
            data: RECORD_WORDS as u32,
            ..ClusterRecord::zeroed()
        };
        pages.extend(words(&[record]));
        let on_grid = corners.as_flattened().iter().all(|x| (x / STEP).fract() == 0.0 && x.abs() < 1.0e5);
        let step = if on_grid { STEP } else { 0.0 };
        let rows: Vec<VertexRow> = corners.iter().map(|p| vertex_row(*p, 0, step)).collect();
        let packing = Packing::of(&rows, step);
        let streams = AttributeLayout::default().streams(corners.len(), triangles.len(), packing.widths);
        let mut own = vec![0; streams.end];
        packing.write(&rows, &mut own);
        write_triangles(triangles, corners.len(), &mut own[streams.triangles..]);
        pages.extend(own);
    }
    offsets.resize(4, 0);
    let visible: Vec<VisibleCluster> = (0..clusters.len())
        .map(|page| VisibleCluster {
            instance: 0,
            cluster: ClusterAddress::new(page, 0).0,
            large: u32::from(large),
        })
        .collect();
    let count = clusters.len() as u32;
    // The large rasterizer takes its numbers from the back, before those that are clipped.
    let room = clusters.len().max(2);
    let mut numbers = vec![u32::MAX; 2 * room];
    for number in 0..clusters.len() {
        numbers[if large { room - 1 - number } else { number }] = number as u32;
    }
    let mut draws = [Dispatch::default(); LISTS];
    draws[usize::from(large)] = dispatch(count, 1, count);
    let (view, instance) = (words(std::slice::from_ref(view)), [instance]);
    let mut results = Vec::new();
    let mut keys = Vec::new();
    let mut forms = vec![vec![Words::Depth], vec![Words::Keys, Words::Lows]];
    forms.extend(device.int64_atomics().then(|| vec![Words::Int64]));
    for form in forms {
        let alone = form == [Words::Depth];
        let pixels = if alone { SIDE * SIDE } else { 2 * SIDE * SIDE };
        let (mut picture, mut counters) = (vec![0; pixels], vec![0; size_of::<Counters>() / 4]);
        for pass in form {
            let kernel = if large { Kernel::RasterLarge(pass) } else { Kernel::RasterSmall(pass) };
            let bindings: [&[u32]; 12] = [
                view,
                words(&instance),
                &offsets,
                &pages,
                words(&visible),
                &numbers,
                words(&draws),
                &picture,
                &counters,
                &pages,
                &pages,
                &pages,
            ];
            let mut out = device.run(kernel, &bindings, count).unwrap();
            (counters, picture) = (out.swap_remove(8), out.swap_remove(7));
        }
        let counters: Counters = entry(&counters);
        let triangles = if large { counters.drawn_large } else { counters.drawn_small };
        if alone {
            keys.push((picture, triangles));
        } else {
            results.push((picture.chunks(2).map(|word| (word[1], word[0])).collect(), triangles));
        }
    }
    assert!(results.iter().all(|result| *result == results[0]), "two passes draw the same");
    let (pixels, triangles): (Vec<(u32, u32)>, u32) = results.swap_remove(0);
    assert_eq!(keys, [(pixels.iter().map(|(key, _)| *key).collect(), triangles)], "keys alone are the same");
    (pixels, triangles)
}

/// A parallel view whose world is its picture: x right and y down, pixels; and depth.
fn flat() -> View {
    View {
        width: SIDE as u32,
        height: SIDE as u32,
        orthographic: 1,
        near: 0.5,
        far: f32::INFINITY,
        ..View::zeroed()
    }
}

/// Internal space as it is. Pictures have y down, which mirrors; so that what is clockwise on them is a front, this does not.
fn plain() -> Instance {
    let screen = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    Instance { screen, mirrored: 1, ..Instance::zeroed() }
}

/// A square from its upper left to its lower right corner, cut along that diagonal: first above it, then below.
fn square(low: f32, high: f32, depth: impl Fn(f32, f32) -> f32) -> Triangles {
    let corners = [[low, low], [high, low], [high, high], [low, high]];
    Triangles {
        corners: corners.map(|[x, y]| [x, y, depth(x, y)]).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// What pixels show: number of the cluster and triangle, or two dots.
fn shown(pixels: &[(u32, u32)]) -> Vec<String> {
    let name = |&(_, low): &(u32, u32)| match low {
        0 => "..".to_owned(),
        low => format!("{}{}", (!low >> 7) - 1, char::from(b'a' + (!low & 127) as u8)),
    };
    pixels.chunks(SIDE).map(|row| row.iter().map(name).collect::<Vec<_>>().join(" ")).collect()
}

/// The key of a depth in a parallel view.
fn flat_key(depth: f32) -> u32 {
    !depth.to_bits()
}

#[test]
fn triangles_cover_the_pixels_whose_centres_they_hold() {
    let Some(device) = device("triangles_cover_the_pixels_whose_centres_they_hold") else { return };
    // Pixels on the diagonal that both share belong to the triangle that has it on its left: the one above.
    let whole = [
        ".. .. .. .. .. .. .. ..",
        ".. 0a 0a 0a 0a .. .. ..",
        ".. 0b 0a 0a 0a .. .. ..",
        ".. 0b 0b 0a 0a .. .. ..",
        ".. 0b 0b 0b 0a .. .. ..",
        ".. .. .. .. .. .. .. ..",
        ".. .. .. .. .. .. .. ..",
        ".. .. .. .. .. .. .. ..",
    ];
    for large in [false, true] {
        let draw =
            |instance: Instance, clusters: &[Triangles]| drawn(&device, large, &flat(), instance, clusters);
        // Corners on corners of pixels; on their centres, where top and left edges hold them and the others do not;
        // and by less than 1/512 beyond that, which is the same.
        for (low, high) in [(1.0, 5.0), (1.5, 5.5), (1.5 - 1.0 / 600.0, 5.5 + 1.0 / 600.0)] {
            let (pixels, count) = draw(plain(), &[square(low, high, |_, _| 2.0)]);
            assert_eq!(shown(&pixels), whole, "{low} {large}");
            assert!(pixels.iter().all(|(key, low)| *key == if *low == 0 { 0 } else { flat_key(2.0) }));
            assert_eq!(count, 2);
        }
        // From the other side nothing, unless both sides count.
        let turned = Instance { mirrored: 0, ..plain() };
        let (pixels, count) = draw(turned, &[square(1.0, 5.0, |_, _| 2.0)]);
        assert!(count == 0 && pixels.iter().all(|pixel| *pixel == (0, 0)));
        let both = Instance { double_sided: 1, ..turned };
        assert_eq!(shown(&draw(both, &[square(1.0, 5.0, |_, _| 2.0)]).0), whole);
        // Between the centres of pixels there is nothing to draw, and a needle on a row of centres counts no corner.
        let (pixels, count) = draw(plain(), &[square(1.6, 2.4, |_, _| 2.0)]);
        assert!(count == 0 && pixels.iter().all(|pixel| *pixel == (0, 0)));
        // More than the picture: every pixel, once.
        let (pixels, _) = draw(plain(), &[square(-40.0, 48.0, |_, _| 2.0)]);
        let above = |k: usize| if k % SIDE >= k / SIDE { "0a" } else { "0b" };
        let rows = shown(&pixels).join(" ");
        assert!(rows.split(' ').enumerate().all(|(k, shown)| shown == above(k)));
    }
}

#[test]
fn the_nearest_shows_and_of_equal_ones_the_first() {
    let Some(device) = device("the_nearest_shows_and_of_equal_ones_the_first") else { return };
    for large in [false, true] {
        let draw = |clusters: &[Triangles]| drawn(&device, large, &flat(), plain(), clusters).0;
        // A floor at 2, one before its right half, one behind, and the first again.
        let pixels = draw(&[
            square(0.0, 8.0, |_, _| 2.0),
            square(4.0, 8.0, |_, _| 1.0),
            square(0.0, 8.0, |_, _| 4.0),
            square(0.0, 8.0, |_, _| 2.0),
        ]);
        for (k, &(key, low)) in pixels.iter().enumerate() {
            let (x, y) = (k % SIDE, k / SIDE);
            let (cluster, depth) = if x >= 4 && y >= 4 { (1, 1.0) } else { (0, 2.0) };
            let triangle = u32::from(x < y);
            assert_eq!((key, low), (flat_key(depth), !((cluster + 1) << 7) - triangle), "{x} {y}");
        }
        // A slope: a quarter more with each column, an eighth with each row, at the centres of pixels.
        let pixels = draw(&[square(0.0, 8.0, |x, y| 2.0 + 0.25 * x + 0.125 * y)]);
        for (k, &(key, _)) in pixels.iter().enumerate() {
            let (x, y) = ((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5);
            assert_eq!(key, flat_key(2.0 + 0.25 * x + 0.125 * y), "{x} {y}");
        }
    }
}

#[test]
fn a_triangle_is_cut_at_the_near_plane_and_at_the_far_one() {
    let Some(device) = device("a_triangle_is_cut_at_the_near_plane_and_at_the_far_one") else { return };
    // Through a pinhole a point (x, y, d) is at pixel (x / d, y / d). The first corner is nearer than 1; the edges from
    // it meet that distance a third of their way on, at pixels (5, 0) and (0, 5). What is left lies between x + y = 5, an
    // edge on the left that holds the centres on it, and 7½: centres add up to column + row + 1.
    let corner = Triangles {
        corners: vec![[0.0, 0.0, 0.5], [15.0, 0.0, 2.0], [0.0, 15.0, 2.0]],
        triangles: vec![[0, 1, 2]],
    };
    let pinhole = View { orthographic: 0, near: 1.0, ..flat() };
    let (pixels, count) = drawn(&device, true, &pinhole, plain(), std::slice::from_ref(&corner));
    assert_eq!(count, 1);
    for (k, &(key, low)) in pixels.iter().enumerate() {
        let sum = k % SIDE + k / SIDE + 1;
        if !(5..=7).contains(&sum) {
            assert_eq!((key, low), (0, 0), "{k}");
            continue;
        }
        // 1 / d falls evenly from 1 at 5 to ½ at 7½.
        let expected = 1.0 - 0.2 * (sum as f32 - 5.0);
        assert!((f32::from_bits(key) - expected).abs() < 1.0e-6 && low == !(1 << 7), "{k} {key}");
    }
    // Beyond distance 1 / 0.7 nothing shows: that is between those of 6 and 7.
    let short = View { far: 1.0 / 0.7, far_key: 0.7f32.to_bits(), ..pinhole };
    let (pixels, _) = drawn(&device, true, &short, plain(), &[corner]);
    for (k, pixel) in pixels.iter().enumerate() {
        assert_eq!(pixel.0 != 0, (5..=6).contains(&(k % SIDE + k / SIDE + 1)), "{k}");
    }
}

#[test]
fn pyramids_hold_the_farthest_of_each_square() {
    let Some(device) = device("pyramids_hold_the_farthest_of_each_square") else { return };
    let build = |width: u32, height: u32, levels: &[[u32; 4]], keys: &[u32], rounds: u32| {
        let mut pyramid = [[0; 4]; PYRAMID_LEVELS];
        pyramid[..levels.len()].copy_from_slice(levels);
        let whole = View { width, height, levels: levels.len() as u32, pyramid, ..view() };
        let alone = View { depth_only: 1, ..whole };
        let picture: Vec<u32> = keys.iter().flat_map(|key| [7, *key]).collect();
        let drawn = Counters { tiles: [u32::MAX; TILES], ..Counters::default() };
        let texels: u32 = levels.iter().map(|[_, rows, _, stride]| stride * rows).sum();
        // Of words, and of keys alone.
        let [of_words, of_keys] = [(whole, &picture[..]), (alone, keys)].map(|(view, picture)| {
            (0..rounds).fold(vec![0; texels as usize], |keys, round| {
                let (view, drawn) = (&[view], &[drawn]);
                run(&device, Kernel::Hzb(round), &[words(view), picture, &keys, words(drawn)]).swap_remove(2)
            })
        });
        assert_eq!(of_keys, of_words);
        // Rows fill up to multiples of four with anything.
        let row = |first: u32, columns: u32| &of_words[first as usize..][..columns as usize];
        let level = |[columns, rows, first, stride]: [u32; 4]| {
            (0..rows).flat_map(move |y| row(first + y * stride, columns)).copied().collect::<Vec<u32>>()
        };
        levels.iter().map(|of| level(*of)).collect::<Vec<_>>()
    };
    #[rustfmt::skip]
    let picture = [
        9, 8, 7, 6, 5,
        4, 3, 2, 1, 9,
        8, 7, 6, 5, 4,
    ];
    let levels = [[5, 3, 0, 8], [3, 2, 24, 4], [2, 1, 32, 4], [1, 1, 36, 4]];
    let expected_of_picture = [&picture[..], &[3, 1, 5, 7, 5, 4], &[1, 4], &[1]];
    assert_eq!(build(5, 3, &levels, &picture, 1), expected_of_picture);
    // A row of 17, of six levels: two rounds.
    let row: Vec<u32> = (1..=17).rev().collect();
    let levels = [[17, 1, 0, 20], [9, 1, 20, 12], [5, 1, 32, 8], [3, 1, 40, 4], [2, 1, 44, 4], [1, 1, 48, 4]];
    let halves = &[16, 14, 12, 10, 8, 6, 4, 2, 1][..];
    let expected = [&row[..], halves, &[14, 10, 6, 2, 1], &[10, 2, 1], &[2, 1], &[1]];
    assert_eq!(build(17, 1, &levels, &row, 2), expected);
    // One pixel.
    assert_eq!(build(1, 1, &[[1, 1, 0, 4]], &[42], 1), [[42]]);
    // Too large for keys of all pixels: the same without.
    let without = [[5, 3, 0, 0], [3, 2, 0, 4], [2, 1, 8, 4], [1, 1, 12, 4]];
    assert_eq!(build(5, 3, &without, &picture, 1)[1..], expected_of_picture[1..]);
}

#[test]
fn pyramids_leave_out_tiles_that_nothing_was_drawn_to() {
    let Some(device) = device("pyramids_leave_out_tiles_that_nothing_was_drawn_to") else { return };
    // Of tiles of 4 × 4 pixels, the third of the first row and the first of the second.
    let (width, height) = (100, 12);
    let mut pyramid = [[0; 4]; PYRAMID_LEVELS];
    (pyramid[0], pyramid[1]) = ([width, height, 0, 100], [50, 6, 1200, 52]);
    let view = View { width, height, levels: 2, pyramid, ..view() };
    let picture = vec![5; 2 * (width * height) as usize];
    let mut drawn = Counters::default();
    (drawn.tiles[0], drawn.tiles[1]) = (0b100, 0b1);
    let (view, drawn) = (&[view], &[drawn]);
    let bindings = [words(view), &picture, &[9; 1512], words(drawn)];
    // 64 pixels a workgroup.
    let texels = device.run(Kernel::Hzb(0), &bindings, 2).unwrap().swap_remove(2);
    // A lane looks at 8 × 8 pixels, where one of its tiles was drawn to: the first two squares of the first row.
    for (k, texel) in texels[..1200].iter().enumerate() {
        let (column, row) = (k % 100, k / 100);
        assert_eq!(*texel, if column < 16 && row < 8 { 5 } else { 0 }, "{column}, {row}");
    }
    for (k, texel) in texels[1200..].iter().enumerate().filter(|(k, _)| k % 52 < 50) {
        let (column, row) = (k % 52, k / 52);
        assert_eq!(*texel, if column < 8 && row < 4 { 5 } else { 0 }, "{column}, {row}");
    }
}

/// What is decided after a pass: its steps, and whether a pyramid is to be built.
fn settled(
    device: &Context,
    cull_pass: CullPass,
    occluded_queue: u32,
    fresh: u32,
    own: Counters,
    other: Counters,
) -> (Vec<Dispatch>, u32) {
    let view = View { group_words: 80_000, ..view() };
    let mut draws = [Dispatch::default(); LISTS];
    draws[0] = dispatch(fresh, 1, fresh);
    let steps = [Dispatch::default(); IndirectEntry::COUNT as usize];
    let occluded_queue = dispatch(occluded_queue, 1, occluded_queue);
    let out = run(
        device,
        Kernel::PrepareIndirect(cull_pass),
        &[
            words(&[view]),
            words(&[occluded_queue]),
            words(&draws),
            words(&[own]),
            words(&[other]),
            words(&steps),
        ],
    );
    let own: Counters = entry(&out[3]);
    (entries(&out[5]), own.pyramid)
}

#[test]
fn phases_settle_what_comes_next() {
    let Some(device) = device("phases_settle_what_comes_next") else { return };
    let nothing = vec![Dispatch::default(); IndirectEntry::COUNT as usize];
    // 100 × 80 pixels, a workgroup for 64 × 64; three levels on 13 × 10 texels, and again 2 × 2.
    let mut pyramid = nothing.clone();
    for (round, (x, y)) in (0..).zip([(2, 2), (1, 1), (1, 1)]) {
        pyramid[IndirectEntry::Pyramid(round).number() as usize] = dispatch(x, y, 0);
    }
    let none = Counters::default();
    let prepare_indirect = |cull_pass, occluded_queue, fresh, own, other| {
        settled(&device, cull_pass, occluded_queue, fresh, own, other)
    };
    // The first: where something waits, a node or a cluster, the second has words of bits to list.
    assert_eq!(prepare_indirect(CullPass::First, 0, 9, none, none), (nothing.clone(), 0));
    let mut waits = pyramid.clone();
    waits[IndirectEntry::Groups.number() as usize] = dispatch(20, 1, 80_000);
    assert_eq!(prepare_indirect(CullPass::First, 1, 9, none, none), (waits.clone(), 1));
    assert_eq!(prepare_indirect(CullPass::First, 0, 9, Counters { occluded: 1, ..none }, none), (waits, 1));
    // The second: pixels get other numbers where it draws something new among what was drawn, 64 × 16 to a workgroup.
    let mut pixels = nothing.clone();
    pixels[IndirectEntry::Pixels.number() as usize] = dispatch(10, 1, 10);
    let mut both = pyramid.clone();
    both[IndirectEntry::Pixels.number() as usize] = dispatch(10, 1, 10);
    let before = |visible, built, triangles| Counters {
        visible,
        pyramid: built,
        drawn_small: triangles,
        ..Counters::default()
    };
    assert_eq!(prepare_indirect(CullPass::Second, 0, 0, none, before(16, 1, 9)), (nothing.clone(), 0));
    assert_eq!(prepare_indirect(CullPass::Second, 0, 8, none, before(16, 1, 9)), (pixels.clone(), 0));
    // More than half is new: the first pyramid no longer does.
    assert_eq!(prepare_indirect(CullPass::Second, 0, 9, none, before(16, 1, 9)), (both, 1));
    assert_eq!(prepare_indirect(CullPass::Second, 0, 3, none, before(0, 1, 0)), (pyramid.clone(), 1));
    // None was built, and there is enough that one could hide.
    assert_eq!(prepare_indirect(CullPass::Second, 0, 0, none, before(16, 0, PYRAMID_ABOVE)), (nothing, 0));
    assert_eq!(
        prepare_indirect(CullPass::Second, 0, 0, none, before(16, 0, PYRAMID_ABOVE + 1)),
        (pyramid, 1)
    );
}

#[test]
fn pixels_get_the_numbers_of_both_phases() {
    let Some(device) = device("pixels_get_the_numbers_of_both_phases") else { return };
    let low = |number: u32, triangle: u32| !((number + 1) << 7 | triangle);
    // 130 × 20 pixels, in three times two blocks of 64 × 16; tiles of 8 × 8, of which one was drawn to.
    let view = [View { width: 130, height: 20, ..View::zeroed() }];
    let renumber = |tile: (u32, u32), before: &[(usize, [u32; 2])]| {
        let mut pixels = vec![[0; 2]; 130 * 20];
        before.iter().for_each(|(pixel, word)| pixels[*pixel] = *word);
        let mut counters = [Counters::default()];
        counters[0].tiles[tile.1 as usize] = 1 << tile.0;
        let table = [9, 7, 8, 1_000_000];
        let bindings = [words(&view), &table, words(&pixels), words(&counters)];
        let out = device.run(Kernel::Renumber, &bindings, 6).unwrap();
        let after: Vec<[u32; 2]> = entries(&out[2]);
        let elsewhere = |pixel: &usize| before.iter().all(|(known, _)| known != pixel);
        assert!((0..after.len()).filter(elsewhere).all(|pixel| after[pixel] == [0; 2]));
        before.iter().map(|(pixel, _)| after[*pixel]).collect::<Vec<_>>()
    };
    let key = 0xdead_beef;
    // The first and the last triangle, one that the table does not hold, the corners of a block, and the next ones.
    let (first, last) = (16 * 130 + 64, 19 * 130 + 127);
    let before = [
        (first, [low(0, 0), key]),
        (first + 1, [low(3, 127), key]),
        (first + 2, [low(4, 1), key]),
        (last, [low(1, 5), 1]),
        (first - 1, [low(1, 5), key]),
        (first - 130, [low(1, 5), key]),
        (last + 1, [low(1, 5), key]),
    ];
    let mut after = before.map(|(_, word)| word);
    after[..4].copy_from_slice(&[
        [low(9, 0), key],
        [low(1_000_000, 127), key],
        [low(4, 1), key],
        [low(7, 5), 1],
    ]);
    for tile in [(8, 2), (15, 2)] {
        assert_eq!(renumber(tile, &before), after, "{tile:?}");
    }
    // The tiles to the left, above and to the right are of other blocks; the first one's has nothing.
    let untouched = before.map(|(_, word)| word);
    for (tile, changed) in [((7, 2), Some(4)), ((8, 1), Some(5)), ((16, 2), Some(6)), ((0, 0), None)] {
        let mut expected = untouched;
        changed.iter().for_each(|place: &usize| expected[*place] = [low(7, 5), key]);
        assert_eq!(renumber(tile, &before), expected, "{tile:?}");
    }
}

#[test]
fn pixels_that_show_anything_are_counted() {
    let Some(device) = device("pixels_that_show_anything_are_counted") else { return };
    // 1030 pixels, two workgroups; behind them, one that is not of the picture.
    let view = View { width: 103, height: 10, ..bytemuck::Zeroable::zeroed() };
    let mut pixels = vec![[0u32; 2]; 1040];
    for (pixel, word) in
        [(0, [1, 0]), (63, [0, 1]), (64, [7, 7]), (1023, [9, 0]), (1029, [1, 1]), (1030, [1, 1])]
    {
        pixels[pixel] = word;
    }
    let (view, counters) = ([view], [Counters { covered: 100, ..Counters::default() }]);
    let bindings = [words(&view), words(&pixels), words(&counters)];
    let out = device.run(Kernel::CountCovered, &bindings, 2).unwrap();
    assert_eq!(entry::<Counters>(&out[2]), Counters { covered: 105, ..Counters::default() });
}

#[test]
fn a_kernel_leaves_what_its_bindings_hold() {
    let Some(device) = device("a_kernel_leaves_what_its_bindings_hold") else { return };
    // Two trips from 3: (n ^ n >> 7) · 1664525 + 0, then + 1, modulo 2³².
    let first = 3 * 1_664_525u64;
    let second = ((first ^ first >> 7) * 1_664_525 + 1) % (1 << 32);
    assert_eq!(run(&device, Kernel::LoopProbe, &[&[2, 3]]), [[2, second as u32]]);
}
