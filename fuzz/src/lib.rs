//! What fuzz targets and the maker of seeds have in common.

#[path = "../../tests/rust/damage.rs"]
pub mod damage;
#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
pub mod shapes;

use std::mem::offset_of;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::BuildOptions;
use nanite_rs::format::encode::contexts;
use nanite_rs::format::file::{ENTRY_BYTES, HEADER_BYTES, Kind, PageRow};
use nanite_rs::format::page::Context;
use nanite_rs::format::planes::Writer;
use nanite_rs::format::{Precision, page_encode, quantize, to_bytes};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;

/// Makes this thread the only one: coverage is then that of the input alone, and no time goes to waking others.
pub fn one_thread() {
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap();
}

/// Small meshes that carry everything or nothing, on the grid and off it.
pub fn meshes() -> Vec<Dag> {
    let (positions, faces) = shapes::bumpy_sphere(6);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    let plain = build(&source, &BuildOptions::default(), &Silent).unwrap();
    let exact = [damage::rich_mesh(4), plain];
    exact.into_iter().flat_map(|dag| [quantize(&dag, Precision::Auto).unwrap(), dag]).collect()
}

/// The bytes of a page, its planes through zstd or plain.
pub fn page(dag: &Dag, context: &Context<'_>, p: usize, level: Option<i32>) -> (Vec<u8>, [u32; 7]) {
    let mut writer = Writer::new(level).unwrap();
    let clusters = dag.pages.table[p].clusters as usize;
    let parts = page_encode::encode(context, dag.pages.page(p), clusters, &mut writer).unwrap();
    (writer.bytes, parts)
}

/// A file with plain planes, which any reader takes: a flipped bit of it is a changed number, and not the end of a zstd
/// frame.
pub fn plain_file(dag: &Dag) -> Vec<u8> {
    let mut bytes = to_bytes(dag).unwrap();
    let [table, pages] = [Kind::PageTable, Kind::Pages].map(|kind| damage::section(&bytes, kind).unwrap());
    bytes.truncate(pages.start);
    for (p, context) in contexts(dag).iter().enumerate() {
        let (coded, parts) = page(dag, context, p, None);
        let row = table.start + p * size_of::<PageRow>();
        let offset = (bytes.len() - pages.start) as u64;
        bytes[row..row + 8].copy_from_slice(&offset.to_le_bytes());
        bytes[row + 8..row + 12].copy_from_slice(&(coded.len() as u32).to_le_bytes());
        for (k, part) in parts.iter().enumerate() {
            bytes[row + offset_of!(PageRow, parts) + 4 * k..][..4].copy_from_slice(&part.to_le_bytes());
        }
        bytes.extend(coded);
    }
    // The pages are the last section.
    let length = (bytes.len() - pages.start) as u64;
    let sections = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let field = HEADER_BYTES + sections * ENTRY_BYTES - 16;
    bytes[field..field + 8].copy_from_slice(&length.to_le_bytes());
    damage::reseal(&mut bytes);
    bytes
}
