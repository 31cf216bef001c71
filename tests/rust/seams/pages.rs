//! Page sources and page sinks that are none of the crate's own.

use std::collections::BTreeMap;
use std::io::{Cursor, Error as IoError, ErrorKind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nanite_rs::build::{Silent, build_into};
use nanite_rs::config::{BuildOptions, RenderOptions};
use nanite_rs::format::encode::FileSink;
use nanite_rs::format::file::{HEADER_BYTES, Kind};
use nanite_rs::format::input::{Input, RangeRequest};
use nanite_rs::format::quantize::Rounded;
use nanite_rs::format::{Precision, from_bytes, open_input, quantize, to_bytes};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::cluster::RECORD_WORDS;
use nanite_rs::model::{
    Clock, ClusterRecord, Dag, LoadRequest, Loader, Outline, PageRequest, PageSink, PageSource, PageWords,
    Retry, Traffic, TrafficCounter, UNINTERRUPTED, Workers, read_pages,
};
use nanite_rs::stream::{Needs, Request, StreamOptions, Streamer};
use nanite_rs::{Error, Result};

use crate::damage::{entries, rich_mesh, section};
use crate::render_frames::{CAMERA, at, dag, same};
use crate::shapes::bumpy_sphere;
use crate::streaming::{backends, page_bytes, renderer, scene_of, stream};

/// Ranges that a store asks for at once.
const BATCH: usize = 32;

/// What happens to a store.
#[derive(Default)]
struct Weather {
    /// The ranges of each batch that it was asked for.
    batches: Mutex<Vec<Vec<std::ops::Range<u64>>>>,
    /// Of so many ranges the second loses its connection; 0 for none.
    drops: u64,
    reads: AtomicU64,
    /// No connection at all.
    down: AtomicBool,
    /// Bytes behind this one are wrong; 0 for none.
    wrong_from: AtomicU64,
}

impl Weather {
    fn sizes(&self) -> Vec<usize> {
        self.batches.lock().unwrap().iter().map(Vec::len).collect()
    }
}

/// A store far away: it is slow, and answers from a thread of its own, the last first.
struct Store {
    bytes: Arc<Vec<u8>>,
    weather: Arc<Weather>,
}

impl Input for Store {
    fn length(&self) -> u64 {
        self.bytes.len() as u64
    }

    fn read(&self, batch: Vec<RangeRequest>, _: &Workers) {
        let ranges = batch.iter().map(|request| request.range.clone()).collect();
        self.weather.batches.lock().unwrap().push(ranges);
        let (bytes, weather) = (Arc::clone(&self.bytes), Arc::clone(&self.weather));
        std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(2));
            for RangeRequest { range, answer } in batch.into_iter().rev() {
                let number = weather.reads.fetch_add(1, Ordering::Relaxed);
                let dropped = weather.drops > 0 && number % weather.drops == 1;
                let mut part = bytes[range.start as usize..range.end as usize].to_vec();
                let wrong_from = weather.wrong_from.load(Ordering::Relaxed);
                if wrong_from > 0 && range.start >= wrong_from {
                    part[0] ^= 1;
                }
                answer.send(match dropped || weather.down.load(Ordering::Relaxed) {
                    true => Err(IoError::from(ErrorKind::ConnectionReset)),
                    false => Ok(part),
                });
            }
        });
    }

    fn batch_size(&self) -> usize {
        BATCH
    }
}

fn stored(mesh: &Dag, weather: Weather) -> (Arc<Dag>, Arc<Weather>) {
    let (bytes, weather) = (Arc::new(to_bytes(mesh).unwrap()), Arc::new(weather));
    let store = Store { bytes, weather: Arc::clone(&weather) };
    let opened = Arc::new(open_input(Box::new(store), "store").unwrap());
    weather.batches.lock().unwrap().clear();
    (opened, weather)
}

#[test]
fn a_store_far_away_gives_what_memory_has() {
    let mesh = dag(&bumpy_sphere(120));
    let (pose, options) = (at(0.0, 0.0, 1.8), RenderOptions::default());
    for (backend, pool) in backends("a_store_far_away_gives_what_memory_has", &mesh) {
        // The second range loses its connection: opening begins with it.
        let weather = Weather { drops: 4, reads: AtomicU64::new(1), ..Weather::default() };
        let (opened, weather) = stored(&mesh, weather);
        let start = Instant::now();
        let frame = renderer(backend, pool).render(&scene_of(&opened), &CAMERA, &pose, &options).unwrap();
        assert!(start.elapsed() < Duration::from_secs(60), "{:?}", start.elapsed());
        assert_eq!((stream(&frame).missing_pages, stream(&frame).read_errors), (0, 0));
        let mut resident = nanite_rs::render::Renderer::new(320, 240, backend).unwrap();
        same(&frame, &resident.render(&scene_of(&mesh), &CAMERA, &pose, &options).unwrap());
        // It was asked for many pages at once.
        let sizes = weather.sizes();
        assert!(sizes.iter().max().is_some_and(|most| (BATCH / 2..=2 * BATCH).contains(most)), "{sizes:?}");
        opened.load_all(UNINTERRUPTED).unwrap();
        assert!(*opened == *mesh);
    }
}

/// Without a connection a frame that waits ends, coarser; once there is one again, it gets what it needs.
#[test]
fn an_outage_costs_detail_until_it_is_over() {
    let mesh = dag(&bumpy_sphere(120));
    let (opened, weather) = stored(&mesh, Weather::default());
    let (scene, options) = (scene_of(&opened), RenderOptions::default());
    let [near, far] = [1.8, 40.0].map(|distance| at(0.0, 0.0, distance));
    let mut renderer = renderer("cpu", page_bytes(&mesh));
    renderer.render(&scene, &CAMERA, &far, &options).unwrap();
    weather.down.store(true, Ordering::Relaxed);
    let start = Instant::now();
    let frame = renderer.render(&scene, &CAMERA, &near, &options).unwrap();
    assert!(start.elapsed() < Duration::from_secs(30), "{:?}", start.elapsed());
    assert!(stream(&frame).read_errors > 0 && stream(&frame).coarsest_pixels > 1.0);
    assert!(matches!(opened.load_all(UNINTERRUPTED), Err(Error::Io { .. })));
    weather.down.store(false, Ordering::Relaxed);
    let whole = nanite_rs::render::Renderer::new(320, 240, "cpu").unwrap().render(
        &scene_of(&mesh),
        &CAMERA,
        &near,
        &options,
    );
    let mut healed = || {
        std::thread::sleep(Duration::from_millis(100));
        stream(&renderer.render(&scene, &CAMERA, &near, &options).unwrap()).coarsest_pixels == 0.0
    };
    assert!((0..300).any(|_| healed()), "pages did not come back");
    same(&renderer.render(&scene, &CAMERA, &near, &options).unwrap(), &whole.unwrap());
}

#[test]
fn a_file_that_is_repaired_heals() {
    let mesh = dag(&bumpy_sphere(80));
    let pages_at = section(&to_bytes(&mesh).unwrap(), Kind::Pages).unwrap().start as u64;
    let (opened, weather) = stored(&mesh, Weather::default());
    let (start, ahead) = (Instant::now(), Arc::new(AtomicU64::new(0)));
    let time = Arc::clone(&ahead);
    let clock = Clock::new(move || start + Duration::from_secs(time.load(Ordering::Relaxed)));
    let options = StreamOptions { pool_bytes: page_bytes(&mesh), equal_pages: false };
    let mut streamer = Streamer::with_clock(options, clock);
    let (count, roots) = (mesh.pages.table.len(), mesh.root_pages());
    assert!(count > roots + 2);
    let mut needs = Needs::default();
    (0..count as u32).for_each(|page| needs.add(&opened, Request { page, pixels: 1.0 }));
    // A frame that waits: how many pages it has, and was read for it; what was told.
    let mut frame = || {
        let before = weather.reads.load(Ordering::Relaxed);
        streamer.resident([&opened].into_iter(), true, UNINTERRUPTED).unwrap();
        streamer.request(&needs).unwrap();
        streamer.wait(UNINTERRUPTED).unwrap();
        let resident = streamer.resident([&opened].into_iter(), true, UNINTERRUPTED).unwrap();
        let stats = streamer.request(&needs).unwrap();
        streamer.wait(UNINTERRUPTED).unwrap();
        streamer.finish();
        streamer.pool().check().unwrap();
        assert_eq!(stats.missing_pages, 0, "it does not wait for what could not be read");
        let read = (weather.reads.load(Ordering::Relaxed) - before) as usize;
        (resident.held() + roots, read, streamer.read_errors(), stats.read_errors as usize)
    };
    weather.wrong_from.store(pages_at + 1, Ordering::Relaxed);
    let (held, _, told, errors) = frame();
    assert_eq!((held, told.len(), errors), (roots, count - roots, count - roots));
    assert!(told.iter().all(|fault| fault.message.contains("checksum")), "{told:?}");
    // Not again at once; then again, but it is no news.
    assert_eq!(frame(), (roots, 0, Vec::new(), count - roots));
    ahead.fetch_add(100, Ordering::Relaxed);
    assert_eq!(frame(), (roots, count - roots, Vec::new(), count - roots));
    weather.wrong_from.store(0, Ordering::Relaxed);
    assert_eq!(frame(), (roots, 0, Vec::new(), count - roots));
    ahead.fetch_add(100, Ordering::Relaxed);
    assert_eq!(frame(), (count, count - roots, Vec::new(), count - roots));
}

/// Sources that answer at once, by nothing, or by a panic.
#[derive(Debug)]
enum Odd {
    AtOnce,
    Drops,
    Panics,
    PanicsOnAWorker,
}

impl PageSource for Odd {
    fn read(&self, batch: Vec<PageRequest>, workers: &Workers) {
        for PageRequest { page, answer } in batch {
            match self {
                Self::AtOnce => answer.send(Ok([page as u32].into())),
                Self::Drops => drop(answer),
                Self::Panics => panic!("a source"),
                Self::PanicsOnAWorker => workers.last(move || {
                    let _answer = answer;
                    panic!("a worker");
                }),
            }
        }
    }

    fn dependencies(&self, _: usize) -> &[u32] {
        &[]
    }
}

#[test]
fn every_request_has_an_answer() {
    let at_once: Arc<dyn PageSource> = Arc::new(Odd::AtOnce);
    let mut seen = vec![false; 100_000];
    let take = |page: usize, words: PageWords| seen[page] = *words == [page as u32];
    read_pages(&at_once, (0..100_000).collect(), UNINTERRUPTED, take).unwrap();
    assert!(seen.iter().all(|seen| *seen));
    for odd in [Odd::Drops, Odd::Panics, Odd::PanicsOnAWorker] {
        let source: Arc<dyn PageSource> = Arc::new(odd);
        let outcome = read_pages(&source, (0..50).collect(), UNINTERRUPTED, |_, _| {});
        assert!(matches!(outcome, Err(Error::Invariant(_))), "{source:?}: {outcome:?}");
    }
}

/// Keeps what it is asked for, and answers nothing.
#[derive(Default)]
struct Mute(Mutex<Vec<PageRequest>>);

impl std::fmt::Debug for Mute {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Mute")
    }
}

impl PageSource for Mute {
    fn read(&self, mut batch: Vec<PageRequest>, _: &Workers) {
        self.0.lock().unwrap().append(&mut batch);
    }

    fn dependencies(&self, _: usize) -> &[u32] {
        &[]
    }
}

#[test]
fn answers_say_when_nobody_waits_any_more() {
    let mute = Arc::new(Mute::default());
    let mut loader = Loader::new(1, Clock::default());
    let source: Arc<dyn PageSource> = mute.clone();
    loader.submit(vec![LoadRequest { source, page: 7, tag: (), retry: Retry::default() }]).unwrap();
    let asked = std::mem::take(&mut *mute.0.lock().unwrap());
    assert!(asked.len() == 1 && !asked[0].answer.cancelled().is_set());
    drop(loader);
    assert!(asked[0].answer.cancelled().is_set());
    drop(asked);
}

/// What reading costs reaches frames, each what came since the one before.
#[test]
fn frames_say_what_reading_cost() {
    struct Counts(Store, TrafficCounter);
    impl Input for Counts {
        fn length(&self) -> u64 {
            self.0.length()
        }

        fn read(&self, batch: Vec<RangeRequest>, workers: &Workers) {
            let bytes = batch.iter().map(|request| request.range.end - request.range.start).sum();
            self.1.add(Traffic { requests: 1, bytes, nanoseconds: 3_000_000, ..Traffic::default() });
            self.0.read(batch, workers);
        }

        fn traffic(&self) -> Traffic {
            self.1.get()
        }
    }
    let mesh = dag(&bumpy_sphere(120));
    let store = Store { bytes: Arc::new(to_bytes(&mesh).unwrap()), weather: Arc::default() };
    let opened = Arc::new(open_input(Box::new(Counts(store, TrafficCounter::default())), "store").unwrap());
    let opening = opened.pages.source().unwrap().traffic();
    assert!(opening.requests >= 1 && opening.latency_ms() == 3.0);
    let (scene, options) = (scene_of(&opened), RenderOptions::default());
    let mut renderer = renderer("cpu", page_bytes(&mesh));
    let mut frame =
        || stream(&renderer.render(&scene, &CAMERA, &at(0.0, 0.0, 1.8), &options).unwrap()).traffic;
    let (first, second) = (frame(), frame());
    let all = opened.pages.source().unwrap().traffic();
    assert!(first.requests > 0 && opening.plus(first) == all, "{opening:?} {first:?} {all:?}");
    assert_eq!(second, Traffic::default());
}

/// One batch opens a file, two where what comes before pages and channels is large; neither reads these.
#[test]
fn opening_takes_a_batch_or_two() {
    let mut mesh = rich_mesh(8);
    for long in [false, true] {
        if long {
            mesh.channels[0].info.name = "long".repeat(100_000);
        }
        let bytes = Arc::new(to_bytes(&mesh).unwrap());
        let weather = Arc::<Weather>::default();
        let store = Store { bytes: Arc::clone(&bytes), weather: Arc::clone(&weather) };
        let opened = open_input(Box::new(store), "store").unwrap();
        let batches = weather.batches.lock().unwrap().clone();
        assert_eq!(batches.len(), 1 + usize::from(long), "{batches:?}");
        let sections = entries(&bytes).count();
        let front = section(&bytes, Kind::Nodes).unwrap().end as u64;
        let gaps = |range: &&std::ops::Range<u64>| range.start >= front;
        if long {
            assert!(batches[1].iter().filter(gaps).all(|gap| gap.end - gap.start < 64));
            assert!(batches[1].len() < sections && batches[1][0].end >= front);
        } else {
            assert!(batches[0].len() == 1 && batches[0][0] == (0..bytes.len().min(1 << 18) as u64));
        }
        opened.load_all(UNINTERRUPTED).unwrap();
        assert!(opened == mesh);
        // Damage between sections is found, wherever it is.
        let mut damaged = bytes.to_vec();
        let pages = section(&bytes, Kind::Pages).unwrap().start;
        let gap = (HEADER_BYTES..pages).rev().find(|at| {
            !entries(&bytes).any(|entry| {
                let field =
                    |k: usize| u64::from_le_bytes(bytes[entry + k..][..8].try_into().unwrap()) as usize;
                (field(8)..field(8) + field(16)).contains(at)
            })
        });
        damaged[gap.unwrap()] = 1;
        match open_input(Box::new(damaged), "damaged") {
            Err(Error::Format { message, .. }) => assert!(message.contains("not empty"), "{message}"),
            other => panic!("{other:?}"),
        }
    }
}

/// Groups, clusters and triangles of each level.
type Census = BTreeMap<u32, [usize; 3]>;

/// Counts what passes and keeps nothing.
#[derive(Default)]
struct Count {
    census: Census,
    pages: usize,
}

impl PageSink for Count {
    type Output = Self;

    fn begin(&mut self, outline: &Outline) -> Result<()> {
        assert!(self.pages == 0 && outline.mesh.pages.words_held() == 0);
        assert_eq!(outline.dependencies.len(), outline.mesh.pages.table.len());
        outline.mesh.groups.iter().for_each(|group| self.census.entry(group.level).or_default()[0] += 1);
        Ok(())
    }

    fn pages(&mut self, outline: &Outline, words: Vec<PageWords>) -> Result<()> {
        for words in words {
            let entry = outline.mesh.pages.table[self.pages];
            assert_eq!(words.len(), entry.words as usize);
            self.pages += 1;
            let records: &[ClusterRecord] =
                bytemuck::cast_slice(&words[..entry.clusters as usize * RECORD_WORDS]);
            for record in records {
                let level = outline.mesh.groups[record.group as usize].level;
                let [_, clusters, triangles] = self.census.get_mut(&level).unwrap();
                *clusters += 1;
                *triangles += usize::from(record.triangle_count);
            }
        }
        Ok(())
    }

    fn finish(self, outline: Outline) -> Result<Self> {
        assert_eq!(self.pages, outline.mesh.pages.table.len());
        Ok(self)
    }
}

fn census(mesh: &Dag) -> Census {
    let mut out = Census::new();
    for group in mesh.groups.iter() {
        let [groups, clusters, triangles] = out.entry(group.level).or_default();
        *groups += 1;
        for at in group.members() {
            *clusters += 1;
            *triangles += mesh.geometry(at).triangles.len();
        }
    }
    out
}

#[test]
fn a_sink_sees_what_the_mesh_has() {
    let (positions, faces) = bumpy_sphere(60);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    let options = BuildOptions { face_ids: true, ..BuildOptions::default() };
    let mesh = nanite_rs::build::build(&source, &options, &Silent).unwrap();
    let seen = build_into(&source, &options, &Silent, Count::default()).unwrap();
    assert!(seen.census == census(&mesh) && seen.census.len() > 3, "{:?}", seen.census);
    let file = FileSink::new(Cursor::new(Vec::new()), Path::new("built"));
    let built = build_into(&source, &options, &Silent, file).unwrap().into_inner();
    assert!(built == to_bytes(&mesh).unwrap() && from_bytes(&built, "built").unwrap() == mesh);
    for precision in [Precision::Auto, Precision::Exact] {
        let seen = Rounded::new(&mesh, precision, UNINTERRUPTED).unwrap().store(Count::default()).unwrap();
        assert!(seen.census == census(&quantize(&mesh, precision).unwrap()));
    }
}

#[test]
fn a_stored_mesh_is_rounded_without_keeping_its_pages() {
    for mesh in [dag(&bumpy_sphere(90)), Arc::new(rich_mesh(30))] {
        let (opened, _) = stored(&mesh, Weather::default());
        for precision in [Precision::Auto, Precision::Exact, Precision::Step(1.0e-3)] {
            let stored = |mesh: &Dag| {
                let file = FileSink::new(Cursor::new(Vec::new()), Path::new("stored"));
                Rounded::new(mesh, precision, UNINTERRUPTED).unwrap().store(file).unwrap().into_inner()
            };
            assert!(stored(&opened) == stored(&mesh), "{precision:?}");
            assert_eq!(opened.pages.words_held(), 0);
        }
        let stopped = Rounded::new(&opened, Precision::Auto, &|| false);
        assert!(matches!(stopped.map(|_| ()), Err(Error::Cancelled)));
    }
}
