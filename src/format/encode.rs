//! A mesh as bytes: the sink that writes a file.

use std::borrow::Cow;
use std::io::{Cursor, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use bytemuck::{NoUninit, Zeroable};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::file::{ALIGNMENT, ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, MAX_EXPANSION, PageRow, VERSION};
use super::page::Context;
use super::page_decode::Decoder;
use super::page_encode;
use super::planes::{Writer, ZSTD_LEVEL};
use super::quantize::{Precision, Rounded};
use crate::error::{Error, Result};
use crate::model::cluster::RECORD_WORDS;
use crate::model::{
    AttributeLayout, Blob, BuildReport, ChannelInfo, ClusterGeometry, ClusterRecord, CoordinateFrame, Dag,
    Grid, Outline, PageEntry, PageSink, PageWords, UNINTERRUPTED,
};

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
    let sink = FileSink::new(Cursor::new(Vec::new()), Path::new("<bytes>"));
    Ok(Rounded::new(dag, Precision::Exact, UNINTERRUPTED)?.store(sink)?.into_inner())
}

/// Writes a file: pages as they come, coded in parallel, then what comes before them.
pub struct FileSink<W> {
    out: W,
    /// What errors name.
    path: PathBuf,
    metadata: Vec<u8>,
    rows: Vec<PageRow>,
    /// Offset and length of each section before the pages.
    places: Vec<(usize, usize)>,
    contexts: Contexts,
    pages_at: usize,
    pages_bytes: u64,
}

impl<W: Write + Seek> FileSink<W> {
    /// Writes to the beginning of `out`; `path` appears in error messages.
    pub fn new(out: W, path: &Path) -> Self {
        Self {
            out,
            path: path.to_path_buf(),
            metadata: Vec::new(),
            rows: Vec::new(),
            places: Vec::new(),
            contexts: Contexts::default(),
            pages_at: 0,
            pages_bytes: 0,
        }
    }

    fn seek(&mut self, offset: usize) -> Result<()> {
        self.out.seek(SeekFrom::Start(offset as u64)).map(drop).map_err(|source| self.failed(source))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(|source| self.failed(source))
    }

    fn failed(&self, source: std::io::Error) -> Error {
        Error::Io { path: self.path.clone(), source }
    }
}

impl<W: Write + Seek> PageSink for FileSink<W> {
    type Output = W;

    fn begin(&mut self, outline: &Outline) -> Result<()> {
        // A struct of numbers and strings always has a JSON form.
        self.metadata = serde_json::to_vec_pretty(&Metadata::of(&outline.mesh)).unwrap_or_default();
        let row = |list: &Vec<u32>| PageRow { dependencies: list.len() as u32, ..PageRow::zeroed() };
        // Lengths are known before the rows of the pages are.
        self.rows = outline.dependencies.iter().map(row).collect();
        let known = sections(outline, &self.metadata, &self.rows)?;
        let lengths = known.iter().map(|(_, parts)| parts.iter().map(Piece::count).sum::<usize>());
        let mut end = HEADER_BYTES + (known.len() + 1) * ENTRY_BYTES;
        self.places = lengths
            .map(|length| {
                let offset = end.next_multiple_of(ALIGNMENT);
                end = offset + length;
                (offset, length)
            })
            .collect();
        self.pages_at = end.next_multiple_of(ALIGNMENT);
        self.seek(self.pages_at)
    }

    fn pages(&mut self, outline: &Outline, words: Vec<PageWords>) -> Result<()> {
        let first = self.contexts.page;
        let contexts = self.contexts.next(&outline.mesh, &words);
        let entries = &outline.mesh.pages.table[first..];
        let code = |tools: &mut Result<(Writer, Decoder)>, k: usize| match tools {
            Ok((writer, decoder)) => code(&contexts[k], first + k, &entries[k], &words[k], (writer, decoder)),
            Err(error) => Err(Error::Invariant(error.to_string())),
        };
        let coded: Vec<(PageRow, Vec<u8>)> = (0..words.len())
            .into_par_iter()
            .map_init(|| Ok((Writer::new(Some(ZSTD_LEVEL))?, Decoder::new()?)), code)
            .collect::<Result<_>>()?;
        for (page, (row, bytes)) in (first..).zip(coded) {
            let dependencies = self.rows[page].dependencies;
            self.rows[page] = PageRow { offset: self.pages_bytes, dependencies, ..row };
            self.pages_bytes += bytes.len() as u64;
            self.write(&bytes)?;
        }
        Ok(())
    }

    fn finish(mut self, outline: Outline) -> Result<W> {
        let (metadata, rows) = (std::mem::take(&mut self.metadata), std::mem::take(&mut self.rows));
        let mut places = std::mem::take(&mut self.places);
        places.push((self.pages_at, self.pages_bytes as usize));
        let mut sections = sections(&outline, &metadata, &rows)?;
        // Written, and each with a checksum of its own.
        sections.push((Kind::Pages, Vec::new()));
        let mut table = Vec::new();
        let mut end = HEADER_BYTES + places.len() * ENTRY_BYTES;
        self.seek(end)?;
        for ((kind, parts), (offset, length)) in sections.into_iter().zip(places) {
            self.write(&vec![0; offset - end])?;
            let mut crc = crc32fast::Hasher::new();
            for part in parts {
                let bytes = part.bytes()?;
                crc.update(&bytes);
                self.write(&bytes)?;
            }
            end = offset + length;
            table.extend_from_slice(&(kind as u32).to_le_bytes());
            table.extend_from_slice(&crc.finalize().to_le_bytes());
            table.extend_from_slice(&(offset as u64).to_le_bytes());
            table.extend_from_slice(&(length as u64).to_le_bytes());
            table.extend_from_slice(&[0; 8]);
        }
        let mut head = Vec::with_capacity(HEADER_BYTES);
        head.extend_from_slice(&MAGIC);
        head.extend_from_slice(&VERSION.to_le_bytes());
        head.extend_from_slice(&((table.len() / ENTRY_BYTES) as u32).to_le_bytes());
        head.extend_from_slice(&crc32fast::hash(&table).to_le_bytes());
        head.extend_from_slice(&crc32fast::hash(&head).to_le_bytes());
        self.seek(0)?;
        self.write(&head)?;
        self.write(&table)?;
        self.out.flush().map_err(|source| self.failed(source))?;
        Ok(self.out)
    }
}

impl Metadata {
    fn of(mesh: &Dag) -> Self {
        Self {
            generator: concat!("nanite_rs ", env!("CARGO_PKG_VERSION")).into(),
            frame: mesh.frame,
            bounds: [mesh.bounds.min, mesh.bounds.max],
            grid: mesh.grid,
            layout: mesh.layout(),
            vertex_count: mesh.vertex_count,
            channels: mesh.channels.iter().map(|c| c.info.clone()).collect(),
            source_faces: mesh.source_faces,
            source_vertices: mesh.source_vertices,
            report: mesh.report.clone(),
        }
    }
}

/// The bytes of a section, in pieces that follow each other.
type Pieces<'a> = Vec<Piece<'a>>;

/// Bytes that are there, or are read when they are written.
enum Piece<'a> {
    Bytes(&'a [u8]),
    Blob(&'a Blob),
}

impl<'a> Piece<'a> {
    fn of<T: NoUninit>(values: &'a [T]) -> Self {
        Self::Bytes(bytemuck::cast_slice(values))
    }

    fn count(&self) -> usize {
        match self {
            Self::Bytes(bytes) => bytes.len(),
            Self::Blob(blob) => blob.count() as usize,
        }
    }

    fn bytes(&self) -> Result<Cow<'a, [u8]>> {
        match self {
            Self::Bytes(bytes) => Ok(Cow::Borrowed(bytes)),
            Self::Blob(blob) => blob.read(),
        }
    }
}

/// All that comes before the pages, in the order of the file.
fn sections<'a>(
    Outline { mesh, dependencies }: &'a Outline,
    metadata: &'a [u8],
    rows: &'a [PageRow],
) -> Result<Vec<(Kind, Pieces<'a>)>> {
    let mut out: Vec<(Kind, Pieces<'_>)> = vec![
        (Kind::Metadata, vec![Piece::Bytes(metadata)]),
        (Kind::PageTable, vec![Piece::of(rows)]),
        (Kind::Dependencies, dependencies.iter().map(|list| Piece::of(list)).collect()),
        (Kind::Groups, vec![Piece::of(&mesh.groups)]),
        (Kind::Nodes, vec![Piece::of(&mesh.nodes)]),
    ];
    if mesh.materials.table.is_empty() && !mesh.materials.images.is_empty() {
        return Err(Error::argument("materials", "images without a table"));
    }
    if !mesh.materials.table.is_empty() {
        out.push((Kind::Materials, vec![Piece::Bytes(mesh.materials.table.as_bytes())]));
    }
    let face_ids = mesh.face_ids.iter().map(|ids| (Kind::FaceIds, ids));
    let channels = mesh.channels.iter().map(|channel| (Kind::Channels, &channel.words));
    for (kind, words) in face_ids.chain(channels) {
        out.push((kind, vec![Piece::of(words.load()?)]));
    }
    out.extend(mesh.materials.images.iter().map(|image| (Kind::Images, vec![Piece::Blob(image)])));
    Ok(out)
}

/// The bytes of a page and its row, but for its offset and dependencies.
fn code(
    context: &Context<'_>,
    page: usize,
    entry: &PageEntry,
    words: &[u32],
    (writer, decoder): (&mut Writer, &mut Decoder),
) -> Result<(PageRow, Vec<u8>)> {
    let clusters = entry.clusters as usize;
    writer.bytes.clear();
    let parts = page_encode::encode(context, words, clusters, writer)?;
    // What a page has no form for, such as a vertex that no triangle uses, shows when it is read back.
    let mut again = vec![0; words.len()];
    let read = decoder.decode(context, &writer.bytes, clusters, &mut again);
    if read.is_err() || again != words {
        return Err(Error::Invariant(format!("page {page} is in no order that a file can hold")));
    }
    let mut bytes = writer.bytes.clone();
    bytes.resize(bytes.len().max(size_of_val(words).div_ceil(MAX_EXPANSION)), 0);
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
}

/// What pages are coded against, one after the other.
#[derive(Default)]
struct Contexts {
    /// The next page.
    page: usize,
    /// One more than the largest identity of those before.
    first_identity: u32,
}

impl Contexts {
    /// Those of the next pages.
    fn next<'m>(&mut self, mesh: &'m Dag, words: &[PageWords]) -> Vec<Context<'m>> {
        let pages = self.page..self.page + words.len();
        let tables = mesh.pages.table[pages.clone()].par_iter().zip(words);
        let ends: Vec<u32> =
            tables.map(|(entry, words)| identities_end(entry, mesh.layout(), words)).collect();
        self.page = pages.end;
        let context = |(page, end): (usize, u32)| {
            let own = mesh.groups_of(page);
            let first_identity = self.first_identity;
            self.first_identity = first_identity.max(end);
            Context { layout: mesh.layout(), grid: mesh.grid, groups: &mesh.groups, own, first_identity }
        };
        pages.zip(ends).map(context).collect()
    }
}

/// What each page of a mesh in memory is coded against.
pub fn contexts(dag: &Dag) -> Vec<Context<'_>> {
    let words: Vec<PageWords> =
        (0..dag.pages.table.len()).filter_map(|page| dag.pages.words(page).cloned()).collect();
    Contexts::default().next(dag, &words)
}

/// One more than the largest identity of a page.
fn identities_end(entry: &PageEntry, layout: AttributeLayout, words: &[u32]) -> u32 {
    let records: &[ClusterRecord] = bytemuck::cast_slice(&words[..entry.clusters as usize * RECORD_WORDS]);
    let ids = records.iter().flat_map(|record| {
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        ClusterGeometry::new(&words[record.data as usize..], layout, vertices, triangles).ids.iter()
    });
    ids.max().map_or(0, |id| id + 1)
}
