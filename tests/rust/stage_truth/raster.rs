//! Stages 4 and 5: coverage, ties and clipping.

use super::*;

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
            let kernel =
                if large { raster_large(Onto::Picture, pass) } else { raster_small(Onto::Picture, pass) };
            let bindings: [&[u32]; 12] = [
                words(&instance),
                &offsets,
                &pages,
                words(&visible),
                words(&draws),
                &picture,
                &counters,
                &pages,
                &pages,
                &pages,
                view,
                &numbers,
            ];
            let mut out = device.run(kernel, &bindings, count).unwrap();
            (counters, picture) = (out.swap_remove(6), out.swap_remove(5));
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
