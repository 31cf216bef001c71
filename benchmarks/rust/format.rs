//! What pages take on disk and how fast one core decodes them, by the ways to code them that were tried. `cargo bench
//! --bench format`; behind `--`, `.nanite` files (saved with `precision="exact"`, so that rounding is part of it) in
//! place of a generated mesh.

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::BuildOptions;
use nanite_rs::format::encode::contexts;
use nanite_rs::format::file::PageRow;
use nanite_rs::format::page::{Context, Part};
use nanite_rs::format::page_decode::Decoder;
use nanite_rs::format::planes::{Writer, ZSTD_LEVEL};
use nanite_rs::format::{Precision, open, page_encode, quantize};
use nanite_rs::math::octahedral::narrow;
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::{ClusterAddress, Dag, UNINTERRUPTED};

/// Rounds of decoding, of which the fastest counts: others may be at work.
const ROUNDS: usize = 40;

/// Decodes all pages several times on this thread; millions of stored triangles in a second.
fn speed(dag: &Dag, mut decode: impl FnMut(usize)) -> f64 {
    let seconds = (0..ROUNDS).map(|_| {
        let start = Instant::now();
        (0..dag.pages.table.len()).for_each(&mut decode);
        start.elapsed().as_secs_f64()
    });
    dag.report.triangles as f64 * 1.0e-6 / seconds.fold(f64::INFINITY, f64::min)
}

/// Words as they lie in memory, through zstd.
fn raw(dag: &Dag, level: i32) -> (f64, f64) {
    let pages = 0..dag.pages.table.len();
    let coded: Vec<Vec<u8>> = pages
        .map(|p| zstd::bulk::compress(bytemuck::cast_slice(dag.pages.page(p)), level).unwrap())
        .collect();
    let bytes: usize = coded.iter().map(Vec::len).sum();
    let speed = speed(dag, |p| {
        black_box(zstd::bulk::decompress(&coded[p], 4 * dag.pages.page(p).len()).unwrap());
    });
    (bytes as f64, speed)
}

/// A vertex as meshoptimizer's codec takes it: grid steps, octahedral coordinates, identity.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Vertex {
    position: [i32; 3],
    normal: [i16; 2],
    id: u32,
}

/// The distinct vertices of a page and its triangles over them, by meshoptimizer's codecs, then zstd or not. Decoding
/// here ends before clusters are made of them.
fn meshopt(dag: &Dag, level: Option<i32>) -> (f64, f64) {
    let grid = dag.grid.unwrap();
    let (mut bytes, mut coded) = (0, Vec::new());
    for (p, entry) in dag.pages.table.iter().enumerate() {
        let (mut vertices, mut indices): (Vec<Vertex>, Vec<u32>) = (Vec::new(), Vec::new());
        let mut numbers = rustc_hash::FxHashMap::default();
        for slot in 0..entry.clusters as usize {
            let g = dag.geometry(ClusterAddress::new(p, slot));
            indices.extend(g.triangles.iter().flatten().map(|v| {
                let v = usize::from(v);
                *numbers.entry(g.ids.get(v)).or_insert_with(|| {
                    vertices.push(Vertex {
                        position: g.positions.get(v).map(|x| (x / grid.step()) as i32),
                        normal: narrow(g.normals[v], grid.normal_bits).map(|t| t as i16),
                        id: g.ids.get(v),
                    });
                    vertices.len() as u32 - 1
                })
            }));
        }
        let mut parts = [
            meshopt::encode_vertex_buffer(&vertices).unwrap(),
            meshopt::encode_index_buffer(&indices, vertices.len()).unwrap(),
        ];
        let lengths = [parts[0].len(), parts[1].len()];
        if let Some(level) = level {
            parts = parts.map(|part| zstd::bulk::compress(&part, level).unwrap());
        }
        bytes += parts.iter().map(Vec::len).sum::<usize>();
        coded.push((parts, lengths, vertices.len(), indices.len()));
    }
    let speed = speed(dag, |p| {
        let (parts, lengths, vertices, indices) = &coded[p];
        let plain = |k: usize| match level {
            Some(_) => zstd::bulk::decompress(&parts[k], lengths[k]).unwrap(),
            None => parts[k].clone(),
        };
        black_box(meshopt::decode_vertex_buffer::<Vertex>(&plain(0), *vertices).unwrap());
        black_box(meshopt::decode_index_buffer::<u32>(&plain(1), *indices).unwrap());
    });
    (bytes as f64, speed)
}

/// The format: bytes by part, and speed.
fn own(dag: &Dag, contexts: &[Context<'_>], level: Option<i32>) -> ([f64; Part::ALL.len()], f64) {
    let mut writer = Writer::new(level).unwrap();
    let (mut parts, mut coded) = ([0.0; Part::ALL.len()], Vec::new());
    for (p, context) in contexts.iter().enumerate() {
        writer.bytes.clear();
        let clusters = dag.pages.table[p].clusters as usize;
        let page = page_encode::encode(context, dag.pages.page(p), clusters, &mut writer).unwrap();
        parts.iter_mut().zip(page).for_each(|(sum, bytes)| *sum += f64::from(bytes));
        coded.push(writer.bytes.clone());
    }
    let mut decoder = Decoder::new().unwrap();
    let mut words = Vec::new();
    let speed = speed(dag, |p| {
        words.clear();
        words.resize(dag.pages.page(p).len(), 0);
        let clusters = dag.pages.table[p].clusters as usize;
        decoder.decode(&contexts[p], &coded[p], clusters, &mut words).unwrap();
    });
    assert!(words == dag.pages.page(dag.pages.table.len() - 1));
    (parts, speed)
}

fn report(name: &str, exact: &Dag) {
    let dag = quantize(exact, Precision::Auto).unwrap();
    let faces = dag.source_faces as f64;
    println!("\n{name}: {} triangles, {} stored, {:?}", dag.source_faces, dag.report.triangles, dag.grid);
    let in_memory = (4 * dag.pages.word_count()) as f64 / dag.report.triangles as f64;
    println!("{in_memory:.3} bytes of memory per stored triangle");
    println!(
        "{:<34} {:>10} {:>8} {:>8}   by part, bytes per input triangle",
        "", "B/triangle", "M/s", "GB/s"
    );
    let line = |what: &str, bytes: f64, speed: f64, rest: String| {
        let words = speed * in_memory * 1.0e-3;
        println!("{what:<34} {:>10.3} {speed:>8.1} {words:>8.3}   {rest}", bytes / faces);
    };
    for level in [3, ZSTD_LEVEL] {
        let (bytes, speed) = raw(&dag, level);
        line(&format!("words, zstd {level}"), bytes, speed, String::new());
    }
    for level in [None, Some(ZSTD_LEVEL)] {
        let (bytes, speed) = meshopt(&dag, level);
        let what = level.map_or(String::from("meshopt"), |level| format!("meshopt, zstd {level}"));
        line(&(what + " (vertices, triangles)"), bytes, speed, String::new());
    }
    let parts_of = |parts: &[f64]| {
        let of = |part: &Part| format!("{} {:.3}", part.name(), parts[*part as usize] / faces);
        Part::ALL.iter().map(of).collect::<Vec<_>>().join(", ")
    };
    let contexts_of_grid = contexts(&dag);
    for level in [None, Some(1), Some(3), Some(ZSTD_LEVEL), Some(19)] {
        let (parts, speed) = own(&dag, &contexts_of_grid, level);
        let what = level.map_or(String::from("planes alone"), |level| format!("planes, zstd {level}"));
        line(&what, parts.iter().sum(), speed, parts_of(&parts));
    }
    let (parts, speed) = own(exact, &contexts(exact), Some(ZSTD_LEVEL));
    line(&format!("planes, zstd {ZSTD_LEVEL}, exact"), parts.iter().sum(), speed, parts_of(&parts));
    let hierarchy = size_of_val(&dag.groups[..])
        + size_of_val(&dag.nodes[..])
        + size_of::<PageRow>() * dag.pages.table.len();
    line("hierarchy besides", hierarchy as f64, f64::NAN, String::new());
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|word| word.ends_with(".nanite")).collect();
    for file in &files {
        let mesh = open(Path::new(file)).unwrap();
        mesh.pages.load_all(UNINTERRUPTED).unwrap();
        report(file, &mesh);
    }
    if files.is_empty() {
        let (positions, faces) = shapes::bumpy_sphere(354);
        let source = SourceMesh::new(Positions::F32(&positions), &faces);
        report("bumpy sphere", &build(&source, &BuildOptions::default(), &Silent).unwrap());
    }
}
