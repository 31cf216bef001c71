//! Channels and face ids of files: read when somebody asks for them, and whatever is wrong with one is its own affair.

use std::fs::File;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nanite_rs::Error;
use nanite_rs::build::check;
use nanite_rs::config::RenderOptions;
use nanite_rs::format::file::{HEADER_BYTES, Kind};
use nanite_rs::format::input::{Input, RangeRequest};
use nanite_rs::format::{Precision, from_bytes, open, open_input, save, to_bytes};
use nanite_rs::lod::{channel_rows, extract, load, select};
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{Dag, UNINTERRUPTED, Words, Workers};
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Camera, Material, Projection, Scene};

use crate::damage::{entries, reseal, rich_mesh, sections};

fn lazy(bytes: Vec<u8>) -> Dag {
    open_input(Box::new(bytes), "lazy").unwrap()
}

/// Everything that is in a section of its own, in the order of the file: face ids, then channels.
fn words(dag: &Dag) -> Vec<&Words> {
    dag.face_ids.iter().chain(dag.channels.iter().map(|channel| &channel.words)).collect()
}

/// Where these sections are.
fn places(bytes: &[u8]) -> Vec<Range<usize>> {
    sections(bytes, Kind::FaceIds).chain(sections(bytes, Kind::Channels)).collect()
}

fn format_fault<T>(result: Result<T, Error>, at: usize, what: &[&str]) {
    match result.map(drop) {
        Err(Error::Format { offset, message, .. }) => {
            assert_eq!(offset, at as u64, "{message}");
            assert!(what.iter().all(|what| message.contains(what)), "{message}");
        }
        other => panic!("{what:?}: {other:?}"),
    }
}

#[test]
fn each_is_read_when_it_is_asked_for() {
    let dag = rich_mesh(8);
    let stored = lazy(to_bytes(&dag).unwrap());
    assert!(words(&stored).iter().all(|words| words.held().is_empty() && words.count() > 0));
    let clusters = |dag: &Dag| {
        load(dag, &Threshold::Uniform(0.01), UNINTERRUPTED).unwrap();
        select(dag, &Threshold::Uniform(0.01))
    };
    let cut = extract(&stored, &clusters(&stored));
    assert_eq!(cut, extract(&dag, &clusters(&dag)));
    assert!(words(&stored).iter().all(|words| words.held().is_empty()), "a cut needs none of them");
    for (i, (whole, part)) in dag.channels.iter().zip(&stored.channels).enumerate() {
        assert_eq!(channel_rows(part, &cut.ids, &[]).unwrap(), channel_rows(whole, &cut.ids, &[]).unwrap());
        let held: Vec<bool> = stored.channels.iter().map(|c| !c.words.held().is_empty()).collect();
        assert_eq!(held, [true, i == 1]);
    }
    assert!(stored.face_ids.as_ref().unwrap().held().is_empty());
    stored.load_all(UNINTERRUPTED).unwrap();
    assert!(stored == dag);
}

/// A file of which reads are counted, by where they begin.
struct Counting {
    bytes: Vec<u8>,
    counted: Range<usize>,
    reads: Arc<AtomicU64>,
}

impl Input for Counting {
    fn length(&self) -> u64 {
        self.bytes.len() as u64
    }

    fn read(&self, batch: Vec<RangeRequest>, workers: &Workers) {
        let counted = |request: &&RangeRequest| self.counted.contains(&(request.range.start as usize));
        let counted = batch.iter().filter(counted).count() as u32;
        self.reads.fetch_add(u64::from(counted), Ordering::Relaxed);
        std::thread::sleep(counted * std::time::Duration::from_millis(20));
        self.bytes.read(batch, workers);
    }
}

#[test]
fn of_many_threads_one_reads() {
    let dag = rich_mesh(8);
    let bytes = to_bytes(&dag).unwrap();
    let (counted, reads) = (places(&bytes)[1].clone(), Arc::new(AtomicU64::new(0)));
    let stored =
        open_input(Box::new(Counting { bytes, counted, reads: Arc::clone(&reads) }), "counted").unwrap();
    assert_eq!(reads.load(Ordering::Relaxed), 0, "opening reads no channel");
    let (ours, expected) = (&stored.channels[0].words, &dag.channels[0].words);
    let found: Vec<&[u32]> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(|| ours.load().unwrap())).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(found.iter().all(|words| *words == expected.held() && std::ptr::eq(*words, ours.held())));
    assert_eq!(reads.load(Ordering::Relaxed), 1);
}

/// A flipped bit of a channel or of the face ids: the mesh opens and cuts, all others are there, and whoever wants the
/// damaged one is told, each time.
#[test]
fn damage_is_found_when_it_is_asked_for() {
    let dag = rich_mesh(8);
    let bytes = to_bytes(&dag).unwrap();
    let names = ["section FaceIds", "section Channels, \"heat\"", "section Channels, \"part\""];
    for (i, (place, name)) in places(&bytes).into_iter().zip(names).enumerate() {
        let mut damaged = bytes.clone();
        damaged[place.start + place.len() / 2] ^= 4;
        format_fault(from_bytes(&damaged, "x"), place.start, &[name, "checksum"]);
        let stored = lazy(damaged);
        for _ in 0..2 {
            for (k, (ours, expected)) in words(&stored).into_iter().zip(words(&dag)).enumerate() {
                if k == i {
                    format_fault(ours.load(), place.start, &[name, "checksum"]);
                    assert!(ours.held().is_empty());
                } else {
                    assert_eq!(ours.load().unwrap(), expected.held());
                }
            }
        }
        let threshold = Threshold::Uniform(0.0);
        load(&stored, &threshold, UNINTERRUPTED).unwrap();
        assert_eq!(extract(&stored, &select(&stored, &threshold)).faces.len() as u64, dag.source_faces);
        format_fault(to_bytes(&stored), place.start, &[name]);
        format_fault(check(&stored, UNINTERRUPTED), place.start, &[name]);
    }
}

/// A frame needs face ids for nothing but an array of them.
#[test]
fn frames_without_their_face_ids() {
    let dag = rich_mesh(8);
    let mut bytes = to_bytes(&dag).unwrap();
    let place = places(&bytes)[0].clone();
    let draw = |dag: Dag| {
        let mut pose = [[0.0; 4]; 4];
        (0..4).for_each(|k| pose[k][k] = 1.0);
        let mut scene = Scene::new();
        scene.add(Arc::new(dag), &pose, Material::default()).unwrap();
        pose[2][3] = 3.0;
        let projection = Projection::Perspective { yfov: 0.8, aspect: None };
        let camera = Camera { projection, znear: 0.05, zfar: None };
        let options = RenderOptions { pixel_error: 0.0, ..RenderOptions::default() };
        Renderer::new(48, 32, "cpu").unwrap().render(&scene, &camera, &pose, &options).unwrap()
    };
    let whole = draw(dag);
    let stored = draw(lazy(bytes.clone()));
    assert!(whole.face_ids().unwrap().iter().any(|row| *row > 0));
    assert_eq!(stored.face_ids().unwrap(), whole.face_ids().unwrap());
    bytes[place.start] ^= 1;
    let damaged = draw(lazy(bytes));
    assert_eq!(damaged.color().unwrap(), whole.color().unwrap());
    format_fault(damaged.face_ids(), place.start, &["section FaceIds"]);
}

/// What the metadata says of channels, against what sections there are: found when the file is opened.
#[test]
fn sections_that_do_not_fit_are_refused() {
    let bytes = to_bytes(&rich_mesh(6)).unwrap();
    let place = places(&bytes);
    let json = sections(&bytes, Kind::Metadata).next().unwrap();
    let text = std::str::from_utf8(&bytes[json.clone()]).unwrap();
    let refused = |at: Range<usize>, with: &[u8], offset: usize, what: &str| {
        let mut damaged = bytes.clone();
        damaged.splice(at, with.iter().copied());
        reseal(&mut damaged);
        format_fault(open_input(Box::new(damaged), "x"), offset, &[what]);
    };
    let found = |part: &str| {
        let start = json.start + text.find(part).unwrap();
        start..start + part.len()
    };
    refused(found("\"columns\": 2"), b"\"columns\": 1", place[1].start, "section Channels, \"heat\"");
    refused(found("\"columns\": 2"), b"\"columns\": 9", place[1].start, "section Channels, \"heat\"");
    refused(found("\"columns\": null"), b"\"columns\": 3   ", place[2].start, "section Channels, \"part\"");
    refused(found("\"part\""), b"\"heat\"", place[1].start, "name");
    let list = found("\"channels\": [").end;
    let list = list..list + text[list - json.start..].find(']').unwrap();
    refused(list.clone(), &vec![b' '; list.len()], HEADER_BYTES, "2 sections Channels for 0 channels");
    // Kinds in the table, in order: metadata, page table, dependencies, groups, nodes, materials, face ids, two channels, images,
    // pages.
    let rows: Vec<usize> = entries(&bytes).collect();
    for (row, kind, at) in [(8, Kind::FaceIds as u32, 8), (2, Kind::Nodes as u32, 4), (2, 99, 2)] {
        let place = rows[row]..rows[row] + 4;
        refused(place, &kind.to_le_bytes(), rows[at], "unknown, or there twice");
    }
    let kind = (Kind::Channels as u32).to_le_bytes();
    refused(rows[6]..rows[6] + 4, &kind, HEADER_BYTES, "3 sections Channels for 2");
    // A word less of the last channel is a word between sections.
    let (length, end) = (rows[8] + 16, place[2].end - 4);
    let shorter = (place[2].len() as u64 - 4).to_le_bytes();
    refused(length..length + 8, &shorter, end, "not empty");
}

/// Values that the type has not, behind a checksum that is right.
#[test]
fn wrong_values_are_found_when_they_are_read() {
    let mut bytes = to_bytes(&rich_mesh(6)).unwrap();
    let place = places(&bytes);
    bytes[place[1].start..place[1].start + 4].copy_from_slice(&f32::NAN.to_bits().to_le_bytes());
    bytes[place[2].start + 7] ^= 1;
    reseal(&mut bytes);
    let stored = lazy(bytes.clone());
    format_fault(stored.channels[0].words.load(), place[1].start, &["\"heat\"", "values"]);
    assert!(stored.channels[1].words.load().is_ok());
    format_fault(from_bytes(&bytes, "x"), place[1].start, &["\"heat\"", "values"]);
}

/// A file that somebody cuts short after it was opened, and repairs: nothing is lost.
#[test]
fn files_cut_short_after_opening() {
    let dag = rich_mesh(8);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nanite");
    save(&dag, &path, Precision::Exact, UNINTERRUPTED).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let stored = open(&path).unwrap();
    let end = places(&bytes)[2].start as u64 + 8;
    File::options().write(true).open(&path).unwrap().set_len(end).unwrap();
    assert_eq!(stored.channels[0].words.load().unwrap(), dag.channels[0].words.held());
    assert!(matches!(stored.channels[1].words.load(), Err(Error::Io { .. })));
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(stored.channels[1].words.load().unwrap(), dag.channels[1].words.held());
    // Saving over itself: the open file is the one that was opened.
    let stored = open(&path).unwrap();
    save(&stored, &path, Precision::Exact, UNINTERRUPTED).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
}
