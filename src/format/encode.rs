//! A mesh as bytes.

use std::io::{Cursor, Seek, SeekFrom, Write};

use bytemuck::Zeroable;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::file::{ALIGNMENT, ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, MAX_EXPANSION, PageRow, VERSION};
use super::page::Context;
use super::page_decode::Decoder;
use super::page_encode;
use super::planes::{Writer, ZSTD_LEVEL};
use super::quantize::{Precision, Rounded};
use crate::error::{Error, Result};
use crate::model::{AttributeLayout, BuildReport, ChannelInfo, CoordinateFrame, Dag, Grid};

/// Pages that are coded between two writes.
const BATCH: usize = 256;

/// The metadata section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// What wrote the file.
    pub generator: String,
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// Smallest and largest corner of the source, internal units.
    pub bounds: [[f32; 3]; 2],
    /// What positions and normals were rounded to.
    pub grid: Option<Grid>,
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    /// Number of vertex identities.
    pub vertex_count: u32,
    /// Name, type and width of each channel.
    pub channels: Vec<ChannelInfo>,
    /// Triangles of the source after mending.
    pub source_faces: u64,
    /// Vertices of the source after welding.
    pub source_vertices: u64,
    /// What building did.
    pub report: BuildReport,
}

/// Serializes a mesh as it is. The same mesh gives the same bytes.
pub fn to_bytes(dag: &Dag) -> Result<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    let io = |source| Error::Io { path: "<bytes>".into(), source };
    write(&Rounded::new(dag, Precision::Exact)?, &mut out, &io)?;
    Ok(out.into_inner())
}

/// Writes a mesh: pages first, in batches, so that memory holds but a few coded ones; then what comes before them.
pub fn write(
    rounded: &Rounded<'_>,
    out: &mut (impl Write + Seek),
    io: &impl Fn(std::io::Error) -> Error,
) -> Result<()> {
    let dag = rounded.dag;
    let metadata = Metadata {
        generator: concat!("nanite_rs ", env!("CARGO_PKG_VERSION")).into(),
        frame: dag.frame,
        bounds: [rounded.bounds.min, rounded.bounds.max],
        grid: rounded.grid,
        layout: dag.layout(),
        vertex_count: dag.vertex_count,
        channels: dag.channels.iter().map(|c| c.info.clone()).collect(),
        source_faces: dag.source_faces,
        source_vertices: dag.source_vertices,
        report: dag.report.clone(),
    };
    // A struct of numbers and strings always has a JSON form.
    let json = serde_json::to_vec_pretty(&metadata).unwrap_or_default();
    let dependencies = dependencies(rounded);
    let blank = |list: &Vec<u32>| PageRow { dependencies: list.len() as u32, ..PageRow::zeroed() };
    let mut rows: Vec<PageRow> = dependencies.iter().map(blank).collect();
    // Lengths are known before the rows of the pages are.
    let known = sections(rounded, &json, &rows, &dependencies)?;
    let lengths: Vec<usize> = known.iter().map(|(_, parts)| parts.iter().map(|p| p.len()).sum()).collect();
    let mut end = HEADER_BYTES + (lengths.len() + 1) * ENTRY_BYTES;
    let mut places = Vec::new();
    for length in lengths {
        let offset = end.next_multiple_of(ALIGNMENT);
        places.push((offset, length));
        end = offset + length;
    }
    let pages_at = end.next_multiple_of(ALIGNMENT);
    out.seek(SeekFrom::Start(pages_at as u64)).map_err(io)?;
    let pages_bytes = write_pages(rounded, &mut rows, out, io)?;
    places.push((pages_at, pages_bytes));

    let mut sections = sections(rounded, &json, &rows, &dependencies)?;
    // Written, and each with a checksum of its own.
    sections.push((Kind::Pages, Vec::new()));
    let mut table = Vec::new();
    for ((kind, parts), (offset, length)) in sections.iter().zip(&places) {
        let mut crc = crc32fast::Hasher::new();
        parts.iter().for_each(|part| crc.update(part));
        table.extend_from_slice(&(*kind as u32).to_le_bytes());
        table.extend_from_slice(&crc.finalize().to_le_bytes());
        table.extend_from_slice(&(*offset as u64).to_le_bytes());
        table.extend_from_slice(&(*length as u64).to_le_bytes());
        table.extend_from_slice(&[0; 8]);
    }
    let mut head = Vec::with_capacity(HEADER_BYTES + table.len());
    head.extend_from_slice(&MAGIC);
    head.extend_from_slice(&VERSION.to_le_bytes());
    head.extend_from_slice(&(places.len() as u32).to_le_bytes());
    head.extend_from_slice(&crc32fast::hash(&table).to_le_bytes());
    head.extend_from_slice(&crc32fast::hash(&head).to_le_bytes());
    head.extend_from_slice(&table);
    out.seek(SeekFrom::Start(0)).map_err(io)?;
    out.write_all(&head).map_err(io)?;
    let mut end = head.len();
    for ((_, parts), (offset, length)) in sections.iter().zip(places) {
        out.write_all(&vec![0; offset - end]).map_err(io)?;
        parts.iter().try_for_each(|part| out.write_all(part)).map_err(io)?;
        end = offset + length;
    }
    out.flush().map_err(io)
}

/// The bytes of a section, in parts that follow each other.
type Parts<'a> = Vec<&'a [u8]>;

/// All that comes before the pages, in the order of the file.
fn sections<'a>(
    rounded: &'a Rounded<'_>,
    json: &'a [u8],
    rows: &'a [PageRow],
    dependencies: &'a [Vec<u32>],
) -> Result<Vec<(Kind, Parts<'a>)>> {
    let mut out: Vec<(Kind, Parts<'_>)> = vec![
        (Kind::Metadata, vec![json]),
        (Kind::PageTable, vec![bytemuck::cast_slice(rows)]),
        (Kind::Dependencies, dependencies.iter().map(|list| bytemuck::cast_slice(list)).collect()),
        (Kind::Groups, vec![bytemuck::cast_slice(&rounded.groups)]),
        (Kind::Nodes, vec![bytemuck::cast_slice(&rounded.nodes)]),
    ];
    let face_ids = rounded.face_ids.iter().map(|ids| (Kind::FaceIds, &**ids));
    let channels = rounded.channels.iter().map(|channel| (Kind::Channels, &channel.words));
    for (kind, words) in face_ids.chain(channels) {
        out.push((kind, vec![bytemuck::cast_slice(words.load()?)]));
    }
    Ok(out)
}

/// Codes and writes all pages and fills in their rows; the bytes of all.
fn write_pages(
    rounded: &Rounded<'_>,
    rows: &mut [PageRow],
    out: &mut impl Write,
    io: &impl Fn(std::io::Error) -> Error,
) -> Result<usize> {
    let count = rows.len();
    let contexts = contexts(rounded);
    let code = |tools: &mut Result<(Writer, Decoder)>, p: usize| -> Result<(PageRow, Vec<u8>)> {
        let (writer, decoder) = match tools {
            Ok(tools) => (&mut tools.0, &mut tools.1),
            Err(error) => return Err(Error::Invariant(error.to_string())),
        };
        let entry = rounded.table[p];
        let context = &contexts[p];
        let words = rounded.page(p);
        let clusters = entry.clusters as usize;
        writer.bytes.clear();
        let parts = page_encode::encode(context, &words, clusters, writer)?;
        // What a page has no form for, such as a vertex that no triangle uses, shows when it is read back.
        let mut again = vec![0; words.len()];
        let read = decoder.decode(context, &writer.bytes, clusters, &mut again);
        if read.is_err() || again != *words {
            return Err(Error::Invariant(format!("page {p} is in no order that a file can hold")));
        }
        let mut bytes = writer.bytes.clone();
        bytes.resize(bytes.len().max(size_of_val(&words[..]).div_ceil(MAX_EXPANSION)), 0);
        let row = PageRow {
            offset: 0,
            bytes: bytes.len() as u32,
            crc: crc32fast::hash(&bytes),
            words: words.len() as u32,
            clusters: entry.clusters,
            level: entry.level,
            first_group: context.own.start as u32,
            first_identity: context.first_identity,
            faces: entry.faces,
            dependencies: 0,
            parts,
        };
        Ok((row, bytes))
    };
    let mut offset = 0u64;
    for start in (0..count).step_by(BATCH) {
        let batch: Vec<(PageRow, Vec<u8>)> = (start..count.min(start + BATCH))
            .into_par_iter()
            .map_init(|| Ok((Writer::new(Some(ZSTD_LEVEL))?, Decoder::new()?)), code)
            .collect::<Result<_>>()?;
        for ((row, bytes), slot) in batch.into_iter().zip(&mut rows[start..]) {
            *slot = PageRow { offset, dependencies: slot.dependencies, ..row };
            offset += bytes.len() as u64;
            out.write_all(&bytes).map_err(io)?;
        }
    }
    Ok(offset as usize)
}

/// What each page is coded against.
pub fn contexts<'a>(rounded: &'a Rounded<'_>) -> Vec<Context<'a>> {
    let dag = rounded.dag;
    let count = rounded.table.len();
    let ends: Vec<u32> = (0..count).into_par_iter().map(|p| identities_end(rounded, p)).collect();
    let mut first_identity = 0;
    let context = |p: usize| {
        let own = rounded.groups_of(p);
        let out = Context {
            layout: dag.layout(),
            grid: rounded.grid,
            groups: &rounded.groups,
            own,
            first_identity,
        };
        first_identity = first_identity.max(ends[p]);
        out
    };
    (0..count).map(context).collect()
}

/// For each page the others with clusters that were made from its groups, ascending.
fn dependencies(rounded: &Rounded<'_>) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); rounded.table.len()];
    for page in 0..rounded.table.len() {
        for at in rounded.members(page) {
            let refined_page = rounded.renamed(rounded.dag.record(at).refined).1 as usize;
            if let Some(list) = out.get_mut(refined_page)
                && refined_page != page
                && list.last() != Some(&(page as u32))
            {
                list.push(page as u32);
            }
        }
    }
    out
}

/// One more than the largest identity of a page.
fn identities_end(rounded: &Rounded<'_>, page: usize) -> u32 {
    let ids = rounded.members(page).flat_map(|at| rounded.dag.geometry(at).ids.iter());
    ids.map(|id| rounded.name(id)).max().map_or(0, |id| id + 1)
}
