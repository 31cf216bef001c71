//! Streaming: what is drawn of a mesh in a file, with little of it in memory, while pages come, go and fail.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use nanite_rs::Error;
use nanite_rs::config::{RenderOptions, Samples};
use nanite_rs::format::input::{Input, RangeRequest, read_blocking};
use nanite_rs::format::{from_bytes, open_input, to_bytes};
#[cfg(feature = "gpu")]
use nanite_rs::gpu::meshes::Meshes;
use nanite_rs::limits::{PAGE_MAX_BYTES, ROOT_PAGE_MAX_BYTES};
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{Dag, PageWords, UNINTERRUPTED, Workers};
use nanite_rs::render::{Frame, Renderer, ViewDesc};
use nanite_rs::scene::{Material, Scene};
use nanite_rs::stream::{Ask, Needs, Pool, Request, StreamOptions, StreamStats, Streamer};

use crate::dag_invariants::Random;
use crate::render_frames::{CAMERA, IDENTITY, Pose, at, dag, lit, same, shoot};
use crate::shapes::{bumpy_sphere, cube, grid, torus, unindexed};

/// A disk that loses pages, fails now and then, or is slow.
#[derive(Default)]
struct Disk {
    bytes: Vec<u8>,
    /// From this byte on bytes are wrong.
    wrong_from: Option<u64>,
    /// Of reads behind the beginning, one in so many fails.
    fails: u64,
    /// The file was cut short after it was opened.
    ends_at: Option<u64>,
    delay: Duration,
    /// While set, reads of pages do not come back.
    hangs: Arc<AtomicBool>,
    /// Reads behind this byte are those of pages.
    pages_at: u64,
    reads: Arc<AtomicU64>,
}

/// A disk in use.
struct Drive(Arc<Disk>);

impl Input for Drive {
    fn length(&self) -> u64 {
        self.0.bytes.len() as u64
    }

    fn read(&self, batch: Vec<RangeRequest>, workers: &Workers) {
        let disk = Arc::clone(&self.0);
        read_blocking(batch, workers, move |range| disk.range(range));
    }
}

impl Disk {
    fn range(&self, range: Range<u64>) -> std::io::Result<Vec<u8>> {
        let mut bytes = self.bytes[range.start as usize..range.end as usize].to_vec();
        if range.start >= self.pages_at {
            let number = self.reads.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(self.delay);
            while self.hangs.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
            }
            if self.fails > 0 && number % self.fails == 2 {
                return Err(std::io::Error::other("the disk is old"));
            }
            if self.ends_at.is_some_and(|end| range.end > end) {
                return Err(std::io::ErrorKind::UnexpectedEof.into());
            }
            if self.wrong_from.is_some_and(|from| range.start >= from) {
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
            }
        }
        Ok(bytes)
    }
}

impl Disk {
    fn of(mesh: &Dag) -> Self {
        let bytes = to_bytes(mesh).unwrap();
        let sections = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let pages = 24 + (sections - 1) * 32 + 8;
        let pages_at = u64::from_le_bytes(bytes[pages..pages + 8].try_into().unwrap());
        Self { bytes, pages_at, ..Self::default() }
    }

    /// A byte so far into the pages.
    fn part(&self, share: f64) -> u64 {
        self.pages_at + (share * (self.bytes.len() as u64 - self.pages_at) as f64) as u64
    }
}

fn open(disk: Disk) -> Arc<Dag> {
    Arc::new(open_input(Box::new(Drive(Arc::new(disk))), "disk").unwrap())
}

/// The same mesh in a file, of which nothing was read yet.
pub fn stored(mesh: &Dag) -> Arc<Dag> {
    open(Disk::of(mesh))
}

pub fn scene_of(mesh: &Arc<Dag>) -> Scene {
    let mut scene = lit();
    scene.add(Arc::clone(mesh), &IDENTITY, Material::default()).unwrap();
    scene
}

pub fn renderer(backend: &str, pool_bytes: u64) -> Renderer {
    let mut renderer = Renderer::new(320, 240, backend).unwrap();
    renderer.stream(Some(pool_bytes));
    renderer
}

pub fn stream(frame: &Frame) -> &StreamStats {
    frame.stats.stream.as_ref().unwrap()
}

pub fn page_bytes(mesh: &Dag) -> u64 {
    4 * mesh.pages.word_count()
}

/// From far to near and around.
fn path(steps: usize) -> Vec<Pose> {
    let step = |i: usize| {
        let t = i as f64 / steps as f64;
        let (angle, distance) = (4.0 * t, 6.0 - 4.6 * (3.1 * t).sin().abs());
        let (s, c) = angle.sin_cos();
        [
            [c, 0.0, s, distance * s],
            [0.0, 1.0, 0.0, 0.3 * (5.0 * t).sin()],
            [-s, 0.0, c, distance * c],
            [0.0, 0.0, 0.0, 1.0],
        ]
    };
    (0..steps).map(step).collect()
}

/// Bytes of a pool that holds all that the path wants to draw, of `all` bytes.
fn wanted(backend: &str, mesh: &Arc<Dag>, all: u64, pixel_error: f32) -> u64 {
    let options = RenderOptions { pixel_error, ..RenderOptions::default() };
    let scene = scene_of(&open(Disk::of(mesh)));
    let mut streamed = renderer(backend, all);
    let held = |pose: &Pose| {
        let frame = streamed.render(&scene, &CAMERA, pose, &options).unwrap();
        assert_eq!((stream(&frame).refused_pages, stream(&frame).evicted_pages), (0, 0));
        stream(&frame).pool_bytes
    };
    let held = path(90).iter().map(held).max().unwrap();
    println!("{backend}: the path wants {held} bytes of {all}");
    held
}

/// From every source cluster up, along any path of the DAG, exactly one cluster is in the cut of what is resident.
fn whole_surface(mesh: &Dag, holds: impl Fn(usize) -> bool, threshold: &Threshold) {
    let refine = |g: u32| {
        let group = &mesh.groups[g as usize];
        holds(group.first.page()) && threshold.exceeded_by(&group.lod_sphere, group.error)
    };
    let drawn = |at| {
        let record = mesh.record(at);
        refine(record.group) && !(record.level > 0 && refine(record.refined))
    };
    let mut outputs = vec![Vec::new(); mesh.groups.len()];
    for at in mesh.pages.addresses() {
        if let Some(list) = outputs.get_mut(mesh.record(at).refined as usize) {
            list.push(at);
        }
    }
    let mut random = Random(5);
    for start in mesh.pages.addresses().filter(|at| mesh.record(*at).level == 0) {
        let (mut at, mut count) = (start, 0);
        loop {
            count += u32::from(drawn(at));
            let above = &outputs[mesh.record(at).group as usize];
            if above.is_empty() {
                break;
            }
            at = above[(random.next() * above.len() as f64) as usize];
        }
        assert_eq!(count, 1, "{start:?}");
    }
}

/// Backends that are there, by the name of a test, and bytes of a pool that holds all of a mesh.
pub fn backends(test: &str, mesh: &Dag) -> Vec<(&'static str, u64)> {
    #[cfg(feature = "gpu")]
    let there = crate::gpu_parity::device(test).is_some();
    #[cfg(not(feature = "gpu"))]
    let there = test.is_empty();
    // Every page takes a place of one size there.
    let places = (mesh.pages.table.len() * PAGE_MAX_BYTES) as u64;
    let gpu = there.then_some(("gpu", places));
    [("cpu", page_bytes(mesh))].into_iter().chain(gpu).collect()
}

#[test]
fn opening_reads_no_page_and_cuts_read_what_they_need() {
    let mesh = dag(&bumpy_sphere(120));
    let disk = Disk::of(&mesh);
    let reads = Arc::clone(&disk.reads);
    let stored = open(disk);
    assert_eq!(reads.load(Ordering::Relaxed), 0);
    let coarse = Threshold::Uniform(0.02);
    nanite_rs::lod::load(&stored, &coarse, UNINTERRUPTED).unwrap();
    let read = reads.load(Ordering::Relaxed) as usize;
    assert!(0 < read && 4 * read < stored.pages.table.len(), "{read} of {}", stored.pages.table.len());
    assert!(nanite_rs::lod::select(&stored, &coarse) == nanite_rs::lod::select(&mesh, &coarse));
    stored.load_all(UNINTERRUPTED).unwrap();
    assert!(*stored == *mesh && reads.load(Ordering::Relaxed) as usize == mesh.pages.table.len());
}

#[test]
fn once_settled_the_picture_is_that_of_the_whole_mesh() {
    let mesh = dag(&bumpy_sphere(160));
    let options = RenderOptions::default();
    for (backend, all) in backends("once_settled_the_picture_is_that_of_the_whole_mesh", &mesh) {
        let stored = open(Disk::of(&mesh));
        let (scene, whole) = (scene_of(&stored), scene_of(&mesh));
        let mut streamed = renderer(backend, all);
        let mut resident = Renderer::new(320, 240, backend).unwrap();
        let mut loaded = 0;
        for occlusion in [true, false] {
            let options = RenderOptions { occlusion, ..options.clone() };
            for pose in path(12) {
                let frame = streamed.render(&scene, &CAMERA, &pose, &options).unwrap();
                let stats = stream(&frame);
                assert!(stats.missing_pages == 0 && stats.coarsest_pixels == 0.0, "{stats:?}");
                same(&frame, &resident.render(&whole, &CAMERA, &pose, &options).unwrap());
                loaded = loaded.max(stats.resident_pages);
                streamed.streamer().unwrap().pool().check().unwrap();
            }
        }
        assert!(loaded < mesh.pages.table.len() as u64, "{backend}: all was read");
    }
}

#[test]
fn once_settled_several_samples_are_those_of_the_whole_mesh() {
    let mesh = dag(&bumpy_sphere(120));
    let whole = scene_of(&Arc::new(from_bytes(&to_bytes(&mesh).unwrap(), "mesh").unwrap()));
    for (backend, pool) in backends("once_settled_several_samples_are_those_of_the_whole_mesh", &mesh) {
        let streamed = scene_of(&open(Disk::of(&mesh)));
        let mut renderer = renderer(backend, pool);
        let mut resident = Renderer::new(320, 240, backend).unwrap();
        for distance in [6.0, 2.5, 2.1] {
            let waits =
                RenderOptions { pixel_error: 0.5, samples: Samples::Four, ..RenderOptions::default() };
            let now = RenderOptions { wait: false, ..waits.clone() };
            let early = renderer.render(&streamed, &CAMERA, &at(0.0, 0.0, distance), &now).unwrap();
            assert_eq!((stream(&early).draws, early.stats.samples), (1, 4));
            let frame = renderer.render(&streamed, &CAMERA, &at(0.0, 0.0, distance), &waits).unwrap();
            assert_eq!(stream(&frame).missing_pages, 0);
            let expected = resident.render(&whole, &CAMERA, &at(0.0, 0.0, distance), &waits).unwrap();
            same(&frame, &expected);
            assert!(frame.linear().unwrap() == expected.linear().unwrap());
        }
    }
}

/// Pages come to places that were there before them: nothing else on the device moves.
#[cfg(feature = "gpu")]
#[test]
fn a_device_has_places_for_all_pages_of_the_pool() {
    let Some(context) = crate::gpu_parity::device("a_device_has_places_for_all_pages_of_the_pool") else {
        return;
    };
    let stored = open(Disk::of(&dag(&bumpy_sphere(330))));
    let pages = stored.pages.table.len();
    assert!(pages > 80, "{pages}");
    let pool_bytes = 2048 * PAGE_MAX_BYTES as u64;
    let mut streamer = Streamer::new(StreamOptions { pool_bytes, equal_pages: true });
    let mut meshes = Meshes::default();
    let mut arrays = None;
    for count in [0, 1, 10, pages] {
        let mut needs = Needs::default();
        (0..count as u32).for_each(|page| needs.add(&stored, Request { page, pixels: 1.0 }));
        streamer.resident([&stored].into_iter(), true, UNINTERRUPTED).unwrap();
        streamer.request(&needs).unwrap();
        streamer.wait(UNINTERRUPTED).unwrap();
        let resident = streamer.resident([&stored].into_iter(), true, UNINTERRUPTED).unwrap();
        assert!(resident.held() + stored.root_pages() >= count);
        if arrays.is_none() {
            meshes.upload(&context, [&stored].into_iter(), &resident).unwrap();
        }
        assert!(!meshes.lacks_places(&resident));
        meshes.stream(&context, &resident).unwrap();
        let now = meshes.pages().map(|array| array.buffer.clone());
        assert!(*arrays.get_or_insert_with(|| now.clone()) == now);
    }
}

/// With less memory than the pool may take, what fits is drawn.
#[cfg(feature = "gpu")]
#[test]
fn a_device_with_little_memory_has_fewer_places() {
    let test = "a_device_with_little_memory_has_fewer_places";
    let Some(context) = crate::gpu_parity::device(test) else { return };
    if !crate::gpu_parity::alone(&format!("streaming::{test}")) {
        return;
    }
    let mesh = dag(&bumpy_sphere(330));
    let scene = scene_of(&open(Disk::of(&mesh)));
    let mut streamed = renderer("gpu", 2048 * PAGE_MAX_BYTES as u64);
    context.limit_memory(40 * PAGE_MAX_BYTES as u64);
    let [far, near] = [40.0, 1.5].map(|distance| at(0.0, 0.0, distance));
    let frame = streamed.render(&scene, &CAMERA, &far, &RenderOptions::default()).unwrap();
    assert_eq!(stream(&frame).missing_pages, 0);
    let all = RenderOptions { pixel_error: 0.0, occlusion: false, ..RenderOptions::default() };
    match streamed.render(&scene, &CAMERA, &near, &all) {
        Err(Error::Backend { message, .. }) => {
            assert!(message.contains("the clusters of the meshes"), "{message}")
        }
        other => panic!("{other:?}"),
    }
    let again = streamed.render(&scene, &CAMERA, &far, &RenderOptions::default()).unwrap_err();
    assert!(matches!(again, Error::Backend { .. }), "{again:?}");
    context.limit_memory(u64::MAX);
    let again = streamed.render(&scene, &CAMERA, &far, &RenderOptions::default()).unwrap();
    same(&again, &frame);
}

#[test]
fn with_little_room_frames_come_are_whole_and_say_how_coarse() {
    let mesh = dag(&bumpy_sphere(240));
    let options = RenderOptions { wait: false, pixel_error: 0.1, ..RenderOptions::default() };
    for (backend, all) in backends("with_little_room_frames_come_are_whole_and_say_how_coarse", &mesh) {
        let room = wanted(backend, &mesh, all, options.pixel_error) / 4;
        let stored = open(Disk { delay: Duration::from_micros(300), ..Disk::of(&mesh) });
        let scene = scene_of(&stored);
        let mut streamed = renderer(backend, room);
        let (mut refused, mut evicted, mut arrived) = (0, 0, 0);
        let frames = if std::env::var_os("NANITE_SOAK").is_some() { 10_000 } else { 90 };
        for (i, pose) in path(frames).into_iter().enumerate() {
            let frame = streamed.render(&scene, &CAMERA, &pose, &options).unwrap();
            let stats = stream(&frame).clone();
            let coarse = frame.visible().len();
            assert!(coarse > 0 && stats.draws == 1);
            assert!(stats.pool_bytes <= room, "{stats:?}");
            assert_eq!(stats.coarsest_pixels > options.pixel_error, stats.coarsest_pixels > 0.0);
            let streamer = streamed.streamer().unwrap();
            streamer.pool().check().unwrap();
            if i % 10 == 0 {
                let resident = streamer.resident([&stored].into_iter(), true, UNINTERRUPTED).unwrap();
                let pages = resident.pages(&stored);
                whole_surface(&mesh, |page| pages.holds(page), &Threshold::Uniform(0.0));
                whole_surface(&mesh, |page| pages.holds(page), &Threshold::Uniform(0.003));
            }
            refused += stats.refused_pages;
            evicted += stats.evicted_pages;
            arrived += stats.arrived_pages;
        }
        assert!(refused > 0 && evicted > 0 && arrived > 0, "{refused} {evicted} {arrived}");
        // At rest, and with room for all that is needed, everything arrives.
        let far = at(0.0, 0.0, 30.0);
        let frame = streamed.render(&scene, &CAMERA, &far, &RenderOptions::default()).unwrap();
        assert_eq!(stream(&frame).missing_pages, 0);
        same(&frame, &shoot(&scene_of(&mesh), &CAMERA, &far, (320, 240), &RenderOptions::default()));
    }
}

/// A picture of a scene of which some pages are lost: it comes, it is whole, and each fault is told once.
#[test]
fn lost_pages_cost_detail_and_nothing_else() {
    let mesh = dag(&bumpy_sphere(160));
    let pose = at(0.0, 0.0, 2.2);
    let options = RenderOptions { pixel_error: 0.1, ..RenderOptions::default() };
    let good = shoot(&scene_of(&mesh), &CAMERA, &pose, (320, 240), &options);
    for (what, disk) in [
        ("checksum", Disk { wrong_from: Some(Disk::of(&mesh).part(0.5)), ..Disk::of(&mesh) }),
        ("end of file", Disk { ends_at: Some(Disk::of(&mesh).part(0.6)), ..Disk::of(&mesh) }),
    ] {
        let scene = scene_of(&open(disk));
        let mut streamed = renderer("cpu", page_bytes(&mesh));
        let frame = streamed.render(&scene, &CAMERA, &pose, &options).unwrap();
        let stats = stream(&frame).clone();
        assert!(stats.read_errors > 0 && stats.coarsest_pixels > 0.1, "{what}: {stats:?}");
        let read_errors = streamed.streamer().unwrap().read_errors();
        assert_eq!(read_errors.len() as u64, stats.read_errors);
        assert!(read_errors.iter().all(|fault| fault.message.contains(what)), "{read_errors:?}");
        let again = streamed.render(&scene, &CAMERA, &pose, &options).unwrap();
        assert_eq!(stream(&again).read_errors, stats.read_errors, "what is still lost is told once");
        assert!(streamed.streamer().unwrap().read_errors().is_empty());
        // As many pixels, but for the outline, and as far away.
        let near = frame.stats.covered_pixels as f64 / good.stats.covered_pixels as f64;
        assert!((near - 1.0).abs() < 0.02, "{near}");
        let (found, expected) = (frame.depth().unwrap(), good.depth().unwrap());
        let off =
            found.iter().zip(&expected).filter(|(a, b)| **a > 0.0 && **b > 0.0 && (**a - **b).abs() > 0.05);
        assert!(off.count() < found.len() / 200);
    }
}

#[test]
fn a_disk_that_fails_now_and_then_loses_nothing() {
    let mesh = dag(&bumpy_sphere(120));
    let disk = Disk { fails: 5, delay: Duration::from_micros(100), ..Disk::of(&mesh) };
    let scene = scene_of(&open(disk));
    let pose = at(0.0, 0.0, 2.2);
    let mut streamed = renderer("cpu", page_bytes(&mesh));
    let frame = streamed.render(&scene, &CAMERA, &pose, &RenderOptions::default()).unwrap();
    assert_eq!((stream(&frame).read_errors, stream(&frame).missing_pages), (0, 0));
    same(&frame, &shoot(&scene_of(&mesh), &CAMERA, &pose, (320, 240), &RenderOptions::default()));
}

/// Who waits for a disk that does not answer may leave at any time, and come back when it does.
#[test]
fn waiting_for_a_disk_can_be_given_up() {
    let mesh = dag(&bumpy_sphere(120));
    let [near, far] = [1.8, 40.0].map(|distance| [(CAMERA, at(0.0, 0.0, distance))]);
    let options = RenderOptions::default();
    let hanging = || {
        let disk = Disk::of(&mesh);
        let hangs = Arc::clone(&disk.hangs);
        hangs.store(true, Ordering::Relaxed);
        (open(disk), hangs)
    };
    // Gives up once asked after a while, which is soon.
    fn given_up<T: std::fmt::Debug>(work: impl FnOnce(&dyn Fn() -> bool) -> Result<T, Error>) {
        let start = Instant::now();
        let outcome = work(&|| start.elapsed() < Duration::from_millis(80));
        assert!(matches!(outcome, Err(Error::Cancelled)), "{outcome:?}");
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    }
    for (backend, all) in backends("waiting_for_a_disk_can_be_given_up", &mesh) {
        let mut resident = Renderer::new(320, 240, backend).unwrap();
        let whole = resident.render(&scene_of(&mesh), &CAMERA, &near[0].1, &options).unwrap();
        for streaming in [true, false] {
            let (stored, hangs) = hanging();
            let scene = scene_of(&stored);
            let mut renderer = renderer(backend, all);
            renderer.stream(streaming.then_some(all));
            // What always is there, or everything.
            given_up(|proceed| renderer.render_views(&scene, &ViewDesc::numbered(&near), &options, proceed));
            if streaming {
                hangs.store(false, Ordering::Relaxed);
                renderer.render_views(&scene, &ViewDesc::numbered(&far), &options, UNINTERRUPTED).unwrap();
                hangs.store(true, Ordering::Relaxed);
                // What the picture needs besides: frames that do not wait come meanwhile.
                for _ in 0..2 {
                    given_up(|proceed| {
                        renderer.render_views(&scene, &ViewDesc::numbered(&near), &options, proceed)
                    });
                    let soon = RenderOptions { wait: false, ..options.clone() };
                    let frame = renderer.render(&scene, &CAMERA, &near[0].1, &soon).unwrap();
                    assert!(stream(&frame).missing_pages > 0 && stream(&frame).draws == 1);
                    renderer.streamer().unwrap().pool().check().unwrap();
                }
            }
            hangs.store(false, Ordering::Relaxed);
            let frame = renderer.render(&scene, &CAMERA, &near[0].1, &options).unwrap();
            same(&frame, &whole);
            assert!(
                frame.stats.stream.as_ref().is_none_or(|stats| stats.draws < 5 && stats.read_errors == 0)
            );
        }
        // Nor does the end of a renderer wait.
        let (stored, hangs) = hanging();
        hangs.store(false, Ordering::Relaxed);
        let mut renderer = renderer(backend, all);
        renderer
            .render_views(&scene_of(&stored), &ViewDesc::numbered(&far), &options, UNINTERRUPTED)
            .unwrap();
        hangs.store(true, Ordering::Relaxed);
        given_up(|proceed| {
            renderer.render_views(&scene_of(&stored), &ViewDesc::numbered(&near), &options, proceed)
        });
        drop(renderer);
        hangs.store(false, Ordering::Relaxed);
    }
    let (stored, hangs) = hanging();
    given_up(|proceed| stored.load_all(proceed));
    given_up(|proceed| nanite_rs::lod::load(&stored, &Threshold::Uniform(0.02), proceed));
    hangs.store(false, Ordering::Relaxed);
    stored.load_all(UNINTERRUPTED).unwrap();
    assert!(*stored == *mesh);
}

#[test]
fn without_its_root_there_is_nothing_to_draw() {
    let mesh = dag(&grid(20, |x, y| (9.0 * x).sin() * y * 0.1));
    let disk = Disk::of(&mesh);
    let scene = scene_of(&open(Disk { wrong_from: Some(disk.pages_at), ..disk }));
    for streaming in [true, false] {
        let mut renderer = Renderer::new(64, 64, "cpu").unwrap();
        renderer.stream(streaming.then_some(1 << 24));
        match renderer.render(&scene, &CAMERA, &at(0.0, 0.0, 3.0), &RenderOptions::default()) {
            Err(Error::Format { offset, message, .. }) => {
                assert!(offset > 0 && message.contains("checksum"), "{message}");
            }
            other => panic!("{other:?}"),
        }
    }
    let small = scene_of(&open(Disk::of(&mesh)));
    match renderer("cpu", 100).render(&small, &CAMERA, &at(0.0, 0.0, 3.0), &RenderOptions::default()) {
        Err(Error::Argument { argument: "pool_bytes", message }) => assert!(message.contains("100 bytes")),
        other => panic!("{other:?}"),
    }
}

/// Of many small meshes each takes as much as its root page has, on both backends.
#[test]
fn small_meshes_take_little() {
    const COUNT: u16 = 1000;
    let mesh = dag(&torus(20, 12));
    assert_eq!((mesh.pages.table.len(), mesh.root_pages()), (1, 1));
    let disk = Disk::of(&mesh).bytes;
    let pose = |i: u16| {
        let mut pose = at(0.25 * f64::from(i % 40) - 5.0, 0.25 * f64::from(i / 40) - 3.0, 0.0);
        (0..3).for_each(|k| pose[k][k] = 0.1);
        pose
    };
    let (mut stored, mut whole) = (lit(), lit());
    for i in 0..COUNT {
        let opened = open(Disk { bytes: disk.clone(), ..Disk::default() });
        stored.add(opened, &pose(i), Material::default()).unwrap();
        whole.add(Arc::clone(&mesh), &pose(i), Material::default()).unwrap();
    }
    let (eye, options) = (at(0.0, 0.0, 12.0), RenderOptions { pixel_error: 0.5, ..RenderOptions::default() });
    let pool = u64::from(COUNT) * page_bytes(&mesh);
    assert!(pool < u64::from(COUNT) * ROOT_PAGE_MAX_BYTES as u64);
    for (backend, _) in backends("small_meshes_take_little", &mesh) {
        let frame = renderer(backend, pool).render(&stored, &CAMERA, &eye, &options).unwrap();
        assert_eq!((stream(&frame).pool_bytes, stream(&frame).missing_pages), (pool, 0));
        let mut resident = Renderer::new(320, 240, backend).unwrap();
        same(&frame, &resident.render(&whole, &CAMERA, &eye, &options).unwrap());
    }
}

/// Meshes in files and meshes in memory in one scene, which come and go, more than there first was room for.
#[test]
fn meshes_come_and_go() {
    let (ball, field) =
        (dag(&bumpy_sphere(100)), dag(&grid(120, |x, y| (9.0 * x).sin() * (7.0 * y).cos() * 0.1)));
    let fine = dag(&bumpy_sphere(200));
    let [stored_ball, stored_field, stored_fine] = [&ball, &field, &fine].map(|mesh| open(Disk::of(mesh)));
    let poses = [at(-1.2, 0.0, 0.0), at(1.2, 0.0, 0.0), at(0.0, 1.0, 0.0)];
    let with = |meshes: [Option<&Arc<Dag>>; 3]| {
        let mut scene = lit();
        for (mesh, pose) in meshes.into_iter().zip(&poses) {
            if let Some(mesh) = mesh {
                scene.add(Arc::clone(mesh), pose, Material::default()).unwrap();
            }
        }
        scene
    };
    let eye = at(0.0, 0.2, 4.0);
    let (b, f, n) = (Some(&stored_ball), Some(&stored_field), Some(&stored_fine));
    let (rb, rf, rn) = (Some(&ball), Some(&field), Some(&fine));
    for (backend, all) in backends("meshes_come_and_go", &fine) {
        let mut streamed = renderer(backend, 3 * all);
        let mut resident = Renderer::new(320, 240, backend).unwrap();
        for (stored, whole) in [
            (with([b, None, None]), with([rb, None, None])),
            (with([b, f, rb]), with([rb, rf, rb])),
            (with([b, n, None]), with([rb, rn, None])),
            (with([b, n, rn]), with([rb, rn, rn])),
            (with([None, None, None]), with([None, None, None])),
            (with([rf, f, n]), with([rf, rf, rn])),
            (with([f, f, b]), with([rf, rf, rb])),
        ] {
            let frame = streamed.render(&stored, &CAMERA, &eye, &RenderOptions::default()).unwrap();
            assert_eq!(stream(&frame).missing_pages, 0);
            same(&frame, &resident.render(&whole, &CAMERA, &eye, &RenderOptions::default()).unwrap());
            streamed.streamer().unwrap().pool().check().unwrap();
        }
    }
}

/// Any order of requests, arrivals, failures and departures keeps the pool's rules; and what is asked for often enough
/// arrives.
#[test]
fn the_pool_keeps_its_rules() {
    let mut random = Random(17);
    let mut pick = move |n: usize| (random.next() * n as f64) as usize;
    let words: PageWords = vec![0u32; 4].into();
    let (mut evictions, mut refusals) = (0, 0);
    for _ in 0..300 {
        let pages = 4 + pick(60);
        let table: Vec<(u64, Vec<u32>)> = (0..pages)
            .map(|page| {
                let bytes = 1 + pick(20) as u64;
                let mut on: Vec<u32> =
                    (0..pick(4)).filter(|_| page > 0).map(|_| pick(page.max(1)) as u32).collect();
                on.sort_unstable();
                on.dedup();
                (bytes, on)
            })
            .collect();
        let total: u64 = table.iter().map(|page| page.0).sum();
        let mut pool = Pool::new(table[0].0 + pick(total as usize) as u64);
        let mesh = pool.attach(table.clone(), vec![(0, words.clone())]).unwrap();
        let mut asked: Vec<Ask> = Vec::new();
        let ask_for = |pool: &mut Pool, asked: &mut Vec<Ask>, wanted: &[Request]| {
            asked.drain(..).for_each(|ask| pool.take_back(ask));
            let plan = pool.request(&[(mesh, wanted.to_vec())]);
            asked.extend(&plan.load);
            plan
        };
        for _ in 0..60 {
            let mut wanted: Vec<Request> = (0..pick(12))
                .map(|_| Request { page: pick(pages) as u32, pixels: 0.1 + pick(100) as f32 })
                .collect();
            wanted.sort_by_key(|request| request.page);
            wanted.dedup_by_key(|request| request.page);
            refusals += ask_for(&mut pool, &mut asked, &wanted).refused;
            pool.check().unwrap();
            for _ in 0..pick(asked.len() + 1) {
                let ask = asked.swap_remove(pick(asked.len()));
                match pick(20) {
                    0 => pool.failed(ask),
                    1 => {
                        pool.failed(ask);
                        pool.retry(ask);
                    }
                    _ => pool.arrived(ask, words.clone()),
                }
                pool.check().unwrap();
            }
            pool.enter(u64::MAX);
            pool.check().unwrap();
        }
        evictions += pool.evicted();
        // No request is lost: asked for again and again, and answered, all that has room comes.
        (0..pages as u32).for_each(|page| pool.retry(Ask { mesh, page }));
        let wanted: Vec<Request> =
            (0..pages as u32).map(|page| Request { page, pixels: 1000.0 - page as f32 }).collect();
        for _ in 0..pages {
            ask_for(&mut pool, &mut asked, &wanted);
            for ask in asked.drain(..) {
                pool.arrived(ask, words.clone());
            }
            pool.enter(u64::MAX);
            pool.check().unwrap();
        }
        let plan = ask_for(&mut pool, &mut asked, &wanted);
        assert_eq!(plan.missing, plan.refused);
        pool.detach(mesh);
        pool.check().unwrap();
        assert_eq!(pool.used(), 0);
    }
    assert!(evictions > 1000 && refusals > 1000, "{evictions} {refusals}");
}

/// What is needed more comes first, whatever it depends on.
#[test]
fn the_most_needed_pages_get_the_room() {
    let words: PageWords = vec![0u32; 4].into();
    let mut pool = Pool::new(40);
    // 1 and 2 stand on 0, and 3 on 1.
    let table = vec![(10, vec![]), (10, vec![0]), (10, vec![0]), (10, vec![1]), (10, vec![2])];
    let mesh = pool.attach(table, vec![(0, words)]).unwrap();
    let need = |page, pixels| Request { page, pixels };
    let plan = pool.request(&[(mesh, vec![need(1, 2.0), need(3, 2.0), need(4, 5.0)])]);
    let pages: Vec<u32> = plan.load.iter().map(|ask| ask.page).collect();
    assert_eq!((pages, plan.missing, plan.refused), (vec![2, 4, 1], 4, 1));
    // What is only expected comes last and is not missed.
    let plan = pool.request(&[(mesh, vec![need(1, 2.0), Request::later(4, 9.0)])]);
    assert_eq!((plan.missing, plan.refused), (1, 0));
}

/// Pages that are asked for by nobody are not read.
#[test]
fn nothing_is_read_that_nobody_needs() {
    let mesh = dag(&bumpy_sphere(80));
    let stored = open(Disk::of(&mesh));
    let mut streamer = Streamer::new(StreamOptions { pool_bytes: page_bytes(&mesh), equal_pages: false });
    streamer.resident([&stored].into_iter(), true, UNINTERRUPTED).unwrap();
    let stats = streamer.request(&Needs::default()).unwrap();
    streamer.wait(UNINTERRUPTED).unwrap();
    let resident = streamer.resident([&stored].into_iter(), true, UNINTERRUPTED).unwrap();
    let held = (0..stored.pages.table.len()).filter(|page| resident.pages(&stored).holds(*page)).count();
    assert_eq!((held as u64, stats.needed_pages, stats.missing_pages), (stats.resident_pages, 0, 0));
    assert!(held < stored.pages.table.len() && from_bytes(&to_bytes(&mesh).unwrap(), "x").is_ok());
}

/// Clusters that could not be simplified come again at the next levels: the triangles of the source lie in pages of those,
/// too, and are counted there.
#[test]
fn source_triangles_are_counted_where_they_lie() {
    let mut random = Random(3);
    let mut noise = |vertices: usize, faces: usize| {
        let positions: Vec<[f32; 3]> =
            (0..vertices).map(|_| [0, 1, 2].map(|_| random.next() as f32)).collect();
        let mut corner = || (random.next() * vertices as f64) as u32;
        let faces: Vec<[u32; 3]> = (0..faces).map(|_| [corner(), corner(), corner()]).collect();
        (positions, faces)
    };
    // Where every vertex has hundreds of triangles nothing can be simplified, and beside it the sphere goes on.
    let (mut positions, mut faces) = bumpy_sphere(60);
    let (more, others) = noise(60, 3000);
    let first = positions.len() as u32;
    positions.extend(more.iter().map(|p| [p[0] + 3.0, p[1], p[2]]));
    faces.extend(others.iter().map(|face| face.map(|v| first + v)));
    let meshes = [(positions, faces), noise(60, 3000), unindexed(&cube(24))];
    let mut again = 0;
    for mesh in meshes {
        let built = dag(&mesh);
        again += built.pages.table.iter().filter(|entry| entry.level > 0 && entry.faces > 0).count();
        for mesh in [&*built, &from_bytes(&to_bytes(&built).unwrap(), "x").unwrap()] {
            let mut before = 0;
            for at in mesh.pages.addresses().filter(|at| mesh.record(*at).level == 0) {
                assert_eq!(mesh.pages.first_face(at), before);
                before += usize::from(mesh.record(at).triangle_count);
            }
            assert_eq!(before as u64, mesh.source_faces);
        }
    }
    assert!(again > 0, "no cluster comes again");
}
