//! Stage 1, and the occluded queue.

use super::*;

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
    let out = run(device, INSTANCE_CULL, &bindings);
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
        INSTANCE_CULL,
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
