//! Stage 6 and what lies between the two passes: pyramids, indirect arguments, new numbers.

use super::*;

#[test]
fn pyramids_hold_the_farthest_of_each_square() {
    let Some(device) = device("pyramids_hold_the_farthest_of_each_square") else { return };
    let build = |width: u32, height: u32, levels: &[[u32; 4]], keys: &[u32], dispatches: u32| {
        let mut pyramid = [[0; 4]; PYRAMID_LEVELS];
        pyramid[..levels.len()].copy_from_slice(levels);
        let whole = View { width, height, levels: levels.len() as u32, pyramid, ..view() };
        let alone = View { depth_only: 1, ..whole };
        let picture: Vec<u32> = keys.iter().flat_map(|key| [7, *key]).collect();
        let drawn = Counters { tiles: [u32::MAX; TILES], ..Counters::default() };
        let texels: u32 = levels.iter().map(|[_, rows, _, stride]| stride * rows).sum();
        // Of words, and of keys alone.
        let [of_words, of_keys] = [(whole, &picture[..]), (alone, keys)].map(|(view, picture)| {
            (0..dispatches).fold(vec![0; texels as usize], |keys, number| {
                let (view, drawn) = (&[view], &[drawn]);
                let bindings = [words(view), picture, &keys, words(drawn)];
                device.run(hzb(number), &bindings, width.div_ceil(16)).unwrap().swap_remove(2)
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
    // A row of 17, of six levels: two dispatches.
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
    // 16 pixels a workgroup, which looks at them where one of its tiles was drawn to.
    let texels = device.run(hzb(0), &bindings, 2).unwrap().swap_remove(2);
    for (k, texel) in texels[..1200].iter().enumerate() {
        let (column, row) = (k % 100, k / 100);
        assert_eq!(
            *texel,
            if column < 16 {
                5
            } else if column < 32 {
                0
            } else {
                9
            },
            "{column}, {row}"
        );
    }
    for (k, texel) in texels[1200..].iter().enumerate().filter(|(k, _)| k % 52 < 50) {
        let (column, row) = (k % 52, k / 52);
        assert_eq!(
            *texel,
            if column < 8 {
                5
            } else if column < 16 {
                0
            } else {
                9
            },
            "{column}, {row}"
        );
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
        prepare_indirect(cull_pass),
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
    // 100 × 80 pixels, a workgroup for 16 × 16; four levels on 7 × 5 texels.
    let mut pyramid = nothing.clone();
    for (number, (x, y)) in (0..).zip([(7, 5), (1, 1)]) {
        pyramid[IndirectEntry::Pyramid(number).number() as usize] = dispatch(x, y, 0);
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
        let out = device.run(RENUMBER, &bindings, 6).unwrap();
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
    let out = device.run(COUNT_COVERED, &bindings, 2).unwrap();
    assert_eq!(entry::<Counters>(&out[2]), Counters { covered: 105, ..Counters::default() });
}

#[test]
fn a_kernel_leaves_what_its_bindings_hold() {
    let Some(device) = device("a_kernel_leaves_what_its_bindings_hold") else { return };
    // Two trips from 3: (n ^ n >> 7) · 1664525 + 0, then + 1, modulo 2³².
    let first = 3 * 1_664_525u64;
    let second = ((first ^ first >> 7) * 1_664_525 + 1) % (1 << 32);
    assert_eq!(run(&device, LOOP_PROBE, &[&[2, 3]]), [[2, second as u32]]);
}
