//! What shaders look up in shadow maps is what the CPU does, on pages made by hand: `shaders/shared/shadow_*.wgsl`.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable, bytes_of, cast_slice};
use glam::{DAffine3, DMat3, DVec3};
use nanite_rs::cpu::lanes::{LANES, Lanes};
use nanite_rs::cpu::shadow_pages::{LastPage, LightShadow};
use nanite_rs::cpu::shadow_soft::March;
use nanite_rs::gpu::Context;
use nanite_rs::gpu::shaders::constants;
use nanite_rs::gpu::shadow_table::{ShadowEntry, ShadowMapEntries, shadow_hash, shadow_table};
use nanite_rs::gpu_types::{SHADOW_PARALLEL, ShadowLight, View};
use nanite_rs::limits::{SHADOW_PAGE_SIDE, SHADOW_PAGE_TEXELS, SHADOW_SIDE, SHADOW_SLOT_WORDS};
use nanite_rs::render::shadow_map_entries;
use nanite_rs::scene::{Camera, Light, LightKind, Projection};
use nanite_rs::shadow::receiver::{RelativePage, texel_of};
use nanite_rs::shadow::soft::join;
use nanite_rs::shadow::{Lamp, LightView, Lookup, Receiver, ShadowMap, ShadowPage};
use rustc_hash::{FxHashMap, FxHashSet};

use crate::gpu_parity::device;
use crate::own_kernel::{self, shared};

/// A receiver as the kernels of this file read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Item {
    position: [f32; 3],
    light: u32,
    normal: [f32; 3],
    error: f32,
    interpolated: [f32; 3],
    unused: u32,
    point: [f32; 2],
    unused_b: [u32; 2],
}

/// What they share with the product, in its order.
const SOURCES: [&str; 9] = [
    shared!("types"),
    shared!("exact"),
    shared!("hash"),
    shared!("shadow_view"),
    shared!("shadow_pages"),
    shared!("shadow_receiver"),
    shared!("shadow_soft"),
    shared!("shadow_range"),
    shared!("shadow_march"),
];

const BINDINGS: &str = "
    const SHADOW_BINDING: u32 = 2u;
    @group(0) @binding(0) var<storage, read> view: View;
    @group(0) @binding(4) var<storage, read_write> made: array<vec2<u32>>;
";

/// Of each receiver its share, and whether it looks up a page: 0 none, 1 one that is there, 2 one that is not.
const RECEIVERS: &str = "
    struct Item {
        position: vec3<f32>, light: u32,
        normal: vec3<f32>, error: f32,
        interpolated: vec3<f32>, unused: u32,
        point: vec2<f32>, unused_b: vec2<u32>,
    }
    @group(0) @binding(1) var<storage, read> items: array<Item>;

    @compute @workgroup_size(64)
    fn main(@builtin(global_invocation_id) at: vec3<u32>) {
        if at.x >= arrayLength(&items) {
            return;
        }
        let item = items[at.x];
        let receiver = ShadowReceiver(item.position, item.normal, item.interpolated, item.error);
        let light = shadow_light(item.light);
        let moved = shadow_moved(light, receiver);
        var looks = 0u;
        if moved.outcome == SHADOW_LOOKS_UP {
            let place = shadow_place(light, moved.at, moved.level);
            var page = place.page;
            if shadow_soft(light) {
                page.at.z = shadow_slab(light, moved.level, moved.at.z);
            }
            if place.there {
                looks = select(1u, 2u, shadow_page(light, page) == SHADOW_ABSENT);
            }
        }
        made[at.x] = vec2<u32>(bitcast<u32>(shadow_reached(item.light, receiver, item.point)), looks);
    }
";

/// Of each name of a page its slot, and its hash.
const NAMES: &str = "
    @group(0) @binding(1) var<storage, read> names: array<array<u32, 6>>;

    @compute @workgroup_size(64)
    fn main(@builtin(global_invocation_id) at: vec3<u32>) {
        if at.x >= arrayLength(&names) {
            return;
        }
        let name = names[at.x];
        let page = ShadowPage(name[1], bitcast<i32>(name[2]), bitcast<vec3<i32>>(vec3<u32>(name[3], name[4], name[5])));
        let first = shadow_page(shadow_light(name[0]), page);
        // The page of the buffer says its own slot.
        var slot = SHADOW_ABSENT;
        if first != SHADOW_ABSENT {
            slot = shadow_pages[first / SHADOW_SLOT_WORDS];
        }
        made[at.x] = vec2<u32>(slot + view.zero, shadow_hash(bitcast<vec3<u32>>(page.at), shadow_tag(page)));
    }
";

/// What the device makes of items on a table and pages.
fn run(
    context: &Context,
    main: &str,
    items: &[u8],
    count: usize,
    table: &[[u32; 4]],
    pages: &[u32],
) -> Vec<[u32; 2]> {
    let source = [&constants(), BINDINGS, &SOURCES.join("\n"), main].concat();
    let rounds: &[(&str, f64)] = if context.software() { &[("ROUNDS_TO_NEAREST", 1.0)] } else { &[] };
    let view = View::zeroed();
    let inputs = [bytes_of(&view), items, cast_slice(table), cast_slice(pages)];
    own_kernel::run(context, source, rounds, &inputs, count, count)
}

/// Numbers from −1 to 1.
struct Random(u32);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        2.0 * (self.0 >> 8) as f32 / (1u32 << 24) as f32 - 1.0
    }

    /// From 0 to 1.
    fn share(&mut self) -> f32 {
        0.5 * self.next() + 0.5
    }

    fn vector(&mut self) -> [f32; 3] {
        [0; 3].map(|_| self.next())
    }

    fn unit(&mut self) -> [f32; 3] {
        let v = glam::Vec3::from_array(self.vector());
        v.normalize_or(glam::Vec3::Z).to_array()
    }

    fn whole(&mut self, size: i32) -> i32 {
        (self.next() * size as f32) as i32
    }
}

/// A light of each kind in turn, as cameras of both kinds see it, with all thresholds and up to three levels coarser; of a
/// size where that is asked for.
fn light_view(case: usize, soft: bool, random: &mut Random) -> LightView {
    let orthographic = case % 5 == 4;
    let projection = match orthographic {
        true => Projection::Orthographic { xmag: None, ymag: 2.0 },
        false => Projection::Perspective { yfov: 0.8, aspect: None },
    };
    let middle = DVec3::new(5.0, -2.0, 0.0);
    let pose = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, -2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
    let view = Camera { projection, znear: 0.05, zfar: None }.view(&pose, 640, 360).unwrap();
    let axis = DVec3::from_array(random.unit().map(f64::from));
    let (x, y) = axis.any_orthonormal_pair();
    let from = middle + axis * f64::from(1.5 + 3.0 * random.share());
    let range = case.is_multiple_of(2).then_some(5.0);
    let (kind, radius) = match case % 3 {
        0 => (LightKind::Directional, 0.003 + 0.1 * random.share()),
        1 => (LightKind::Spot { range, inner: 0.1, outer: 0.6 }, 0.01 + 0.2 * random.share()),
        _ => (LightKind::Point { range }, 0.01 + 0.2 * random.share()),
    };
    let pose = DAffine3 { matrix3: DMat3::from_cols(x, y, axis), translation: from };
    let map = ShadowMap::new(&Light { kind, pose, ..Light::default() }, 16.0).unwrap();
    let radius = if soft { f64::from(radius) } else { 0.0 };
    let lamp = Lamp::new(radius, 4.0, [8, 13, 32][case / 3 % 3]);
    LightView::new(0, &map, &view, [1.0, 0.0, 0.3][case % 3], 16.0, lamp).made_coarser(case as i32 / 5 % 4)
}

/// Points before the camera with normals of all directions.
fn receivers(count: usize, random: &mut Random) -> Vec<Receiver> {
    (0..count)
        .map(|_| {
            let [x, y, z] = random.vector();
            let normal = random.unit();
            let bend = random.vector();
            let smooth = std::array::from_fn(|k| normal[k] + 0.3 * bend[k]);
            let smooth = glam::Vec3::from_array(smooth).normalize_or(glam::Vec3::Z).to_array();
            Receiver { position: [x, y, 0.2 * z - 3.0], normal, smooth, error: 1e-3 * random.share() }
        })
        .collect()
}

/// Where a receiver is on the picture, about.
fn point_of(number: usize) -> [f32; 2] {
    [(number % 640) as f32 + 0.5, (number / 640 * 7) as f32 + 0.5]
}

/// A light with its pages, and who looks them up.
struct Case {
    shadow: LightShadow,
    receivers: Vec<Receiver>,
}

/// What the device says of the receivers of all cases, in one run; the table has all lights.
fn on_device(context: &Context, cases: &[Case]) -> Vec<Vec<[u32; 2]>> {
    let mut pool = Vec::new();
    let mut entries = Vec::new();
    let mut items = Vec::new();
    for (light, Case { shadow, receivers }) in cases.iter().enumerate() {
        let mut own = Vec::new();
        for (page, texels) in &shadow.pages {
            own.push((*page, (pool.len() / SHADOW_SLOT_WORDS) as u32));
            pool.extend(texels.words());
        }
        entries.push(Some(shadow_map_entries(&shadow.view, own)));
        items.extend(receivers.iter().enumerate().map(|(number, receiver)| Item {
            position: receiver.position,
            light: light as u32,
            normal: receiver.normal,
            error: receiver.error,
            interpolated: receiver.smooth,
            point: point_of(number),
            ..Item::zeroed()
        }));
    }
    let made = run(context, RECEIVERS, cast_slice(&items), items.len(), &shadow_table(&entries), &pool);
    let mut made = made.into_iter();
    cases.iter().map(|case| made.by_ref().take(case.receivers.len()).collect()).collect()
}

#[test]
fn sharp_shadows_are_those_of_the_cpu() {
    let Some(context) = device("sharp_shadows_are_those_of_the_cpu") else { return };
    let mut random = Random(1);
    let cases: Vec<Case> = (0..60)
        .map(|case| {
            let view = light_view(case, false, &mut random);
            let receivers = receivers(400, &mut random);
            let mut pages: FxHashMap<RelativePage, Vec<u32>> = FxHashMap::default();
            for receiver in &receivers {
                if let Lookup::Texel { page, texel, key } = view.look_up(receiver) {
                    let texels = pages.entry(page).or_insert_with(|| vec![0; SHADOW_PAGE_TEXELS]);
                    // Some exactly as deep, some a bit nearer.
                    texels[texel as usize] = key.saturating_add(texel % 3).saturating_sub(1);
                }
            }
            let page = |(at, texels)| (at, Arc::new(ShadowPage::new(texels, 0)));
            let pages = pages.into_iter().map(page).collect();
            Case { shadow: LightShadow { view, pages, drawn: FxHashSet::default() }, receivers }
        })
        .collect();
    let made = on_device(&context, &cases);
    // By kind of light: dark and lit ones that look up.
    let mut outcomes = [[0; 2]; 3];
    for (number, (Case { shadow, receivers }, made)) in cases.iter().zip(made).enumerate() {
        for (receiver, [share, looks]) in receivers.iter().zip(made) {
            let expected = match shadow.view.look_up(receiver) {
                Lookup::Lit => [1.0f32.to_bits(), 0],
                Lookup::Dark => [0, 0],
                Lookup::Texel { page, texel, key } => {
                    let lit = shadow.pages[&page].keys()[texel as usize] <= key;
                    outcomes[number % 3][usize::from(lit)] += 1;
                    [f32::from(u8::from(lit)).to_bits(), 1]
                }
            };
            // Not one differs: all that decides is rounded as here.
            assert_eq!([share, looks], expected, "case {number}: {receiver:?}");
        }
    }
    assert!(outcomes.as_flattened().iter().all(|count| *count > 500), "{outcomes:?}");
}

/// Pages that receivers may want, of hills, steps and holes about as high as receivers are.
fn rough_pages(
    view: &LightView,
    receivers: &[Receiver],
    seed: u32,
) -> FxHashMap<RelativePage, Arc<ShadowPage>> {
    let mut columns = FxHashMap::default();
    for Receiver { position, error, .. } in receivers {
        view.mark(position, *error, |page, heights| join(&mut columns, page, heights));
    }
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for Receiver { position, .. } in receivers {
        let at = view.along_axes(position);
        let height = view.along(view.face(&at), 2, &at);
        (low, high) = (low.min(height), high.max(height));
    }
    let wanted: Vec<_> = view.pages(columns);
    let page = |key: &nanite_rs::shadow::PageKey| {
        let page = view.relative(key).unwrap();
        let side = SHADOW_PAGE_SIDE as i32;
        let key_at = |number: i32| {
            let [x, y] = [page.x * side + number % side, page.y * side + number / side];
            // Blocks of random heights, larger in some pages than in others.
            let block = 2 + (page.x ^ page.y ^ i32::from(page.level)).rem_euclid(5);
            let mut bits = seed ^ (x >> block).wrapping_mul(73_856_093) as u32;
            bits ^= (y >> block).wrapping_mul(19_349_663) as u32;
            bits = bits.wrapping_mul(0x9e37_79b1) ^ u32::from(page.face);
            bits = (bits ^ bits >> 15).wrapping_mul(0x85eb_ca6b);
            let part = (bits >> 8) as f32 / (1u32 << 24) as f32;
            if part > 0.9 {
                return 0;
            }
            let height = low + (high - low) * (1.2 * part - 0.3) + 1e-3 * ((x + y) % 7) as f32;
            match view.anchor(page.level.into()) {
                Some(anchor) => {
                    let top =
                        ((page.z + 1) as f32 * SHADOW_SIDE as f32 - anchor[2]) * texel_of(page.level.into());
                    !(top - height).max(0.0).to_bits()
                }
                None => (view.near / (-height).max(0.01)).to_bits(),
            }
        };
        (page, Arc::new(ShadowPage::new((0..side * side).map(key_at).collect(), 0)))
    };
    wanted.iter().map(page).collect()
}

#[test]
fn soft_shadows_are_those_of_the_cpu() {
    let Some(context) = device("soft_shadows_are_those_of_the_cpu") else { return };
    let mut random = Random(7);
    let cases: Vec<Case> = (0..36)
        .map(|case| {
            let view = light_view(case, true, &mut random);
            let receivers = receivers(120, &mut random);
            let pages = rough_pages(&view, &receivers, case as u32 * 77);
            Case { shadow: LightShadow { view, pages, drawn: FxHashSet::default() }, receivers }
        })
        .collect();
    let made = on_device(&context, &cases);
    // By kind of light: dark, partly lit, lit. And receivers that differ at all, and by more than a ray.
    let (mut outcomes, mut differ, mut far, mut count) = ([[0; 3]; 3], 0, 0, 0);
    for (number, (Case { shadow, receivers }, made)) in cases.iter().zip(made).enumerate() {
        let samples = shadow.view.lamp.points.len() as f32;
        for (at, (receiver, [share, looks])) in receivers.iter().zip(made).enumerate() {
            let mut lit = Lanes::splat(1.0);
            match shadow.view.start(receiver) {
                Ok(start) => {
                    let points = point_of(at).map(Lanes::splat);
                    let last = LastPage::default();
                    let mut starts = [None; LANES];
                    starts[0] = Some(start);
                    March { light: shadow, last: &last }.run(&starts[..1], &mut lit, &points);
                }
                Err(there) => lit.0[0] = f32::from(u8::from(there)),
            }
            assert_ne!(looks, 2, "case {number}: a page that is looked up is not there, {receiver:?}");
            let (expected, share) = (lit.0[0], f32::from_bits(share));
            let off = (expected - share).abs() * samples;
            count += 1;
            differ += usize::from(off > 0.01);
            far += usize::from(off > 1.01);
            outcomes[number % 3][if expected == 0.0 { 0 } else { 1 + usize::from(expected == 1.0) }] += 1;
        }
    }
    println!("{count} receivers, {differ} differ, {far} by more than a ray; {outcomes:?}");
    assert!(outcomes.iter().all(|of| of.iter().all(|count| *count > 20)), "{outcomes:?}");
    // Rays pass edges of texels by rounding: steps are not rounded as on the CPU.
    assert!(100 * differ <= count && 1000 * far <= count, "{differ} and {far} of {count}");
}

#[test]
fn pages_are_found_where_the_host_put_them() {
    let Some(context) = device("pages_are_found_where_the_host_put_them") else { return };
    let mut random = Random(3);
    let mut name = || {
        let at = [random.whole(20), random.whole(20), random.whole(3)];
        (random.whole(6).unsigned_abs() as u8, random.whole(124) as i16, at)
    };
    // One without pages, and two that share names; the third throws no shadow.
    let mut slots = 0..;
    let counts = [Some(0), Some(1000), None, Some(3000)];
    let lights = counts.map(|count| {
        let mut pages = FxHashMap::default();
        while pages.len() < count? {
            pages.entry(name()).or_insert_with(|| slots.next().unwrap());
        }
        Some(pages)
    });
    let entry =
        |(&(face, level, at), &slot): (&(u8, i16, [i32; 3]), &u32)| ShadowEntry { face, level, at, slot };
    let entries = lights.each_ref().map(|pages| {
        let pages = pages.as_ref()?.iter().map(entry).collect();
        let light = ShadowLight { kind: SHADOW_PARALLEL, ..ShadowLight::zeroed() };
        Some(ShadowMapEntries { light, anchors: Vec::new(), points: Vec::new(), pages })
    });
    let (mut names, mut expected) = (Vec::new(), Vec::new());
    for (light, pages) in lights.iter().enumerate() {
        let Some(pages) = pages else { continue };
        let known: Vec<_> = pages.keys().copied().collect();
        let any: Vec<_> = (0..1000).map(|_| name()).collect();
        for (face, level, at) in known.into_iter().chain(any) {
            let slot = pages.get(&(face, level, at)).copied().unwrap_or(u32::MAX);
            let [x, y, z] = at.map(|v| v as u32);
            names.push([light as u32, face.into(), i32::from(level) as u32, x, y, z]);
            expected.push([slot, shadow_hash(&ShadowEntry { face, level, at, slot })]);
        }
    }
    // Where a slot begins is where its number is.
    let pages: Vec<u32> = (0..4000).collect();
    let made = run(&context, NAMES, cast_slice(&names), names.len(), &shadow_table(&entries), &pages);
    assert_eq!(made, expected);
    let found = expected.iter().filter(|[slot, _]| *slot != u32::MAX).count();
    assert!((4000..7000).contains(&found), "{found}");
}
