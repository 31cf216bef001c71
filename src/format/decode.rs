//! Bytes as a mesh. Sizes, counts and offsets are checked against the length before anything is allocated.

use std::borrow::Cow;
use std::sync::Arc;

use bytemuck::AnyBitPattern;
use rayon::prelude::*;

use super::encode::Metadata;
use super::file::{ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, MAX_EXPANSION, OLDEST_VERSION, PageRow, VERSION};
use super::input::Input;
use super::page::Context;
use super::page_decode::Decoder;
use super::validate;
use crate::error::{Error, Result};
use crate::limits::{CLUSTER_MAX_TRIANGLES, PAGE_MAX_BYTES, PAGE_MAX_CLUSTERS};
use crate::math::Aabb;
use crate::model::cluster::NO_GROUP;
use crate::model::{
    Channel, ChannelInfo, ChannelType, ClusterRecord, Dag, GeometryId, Group, PageEntry, PageWords, Pages,
    Words,
};

/// Bytes of words that are read at once.
const WORDS_CHUNK: usize = 1 << 20;

/// The bytes with a name for error messages.
pub struct Source<'a> {
    input: &'a dyn Input,
    name: &'a str,
}

impl<'a> Source<'a> {
    /// Bytes with a name.
    pub fn new(input: &'a dyn Input, name: &'a str) -> Self {
        Self { input, name }
    }

    /// A format error at an offset.
    pub fn fail(&self, offset: u64, message: impl Into<String>) -> Error {
        Error::Format { name: self.name.into(), offset, message: message.into() }
    }

    fn take(&self, offset: u64, length: u64, what: &str) -> Result<Cow<'a, [u8]>> {
        let size = self.input.length();
        let ends = offset.checked_add(length).is_some_and(|end| end <= size);
        let Some(length) = usize::try_from(length).ok().filter(|_| ends) else {
            return Err(self.fail(offset, format!("{what} needs {length} bytes, the file ends at {size}")));
        };
        self.input.read(offset, length).map_err(|source| Error::Io { path: self.name.into(), source })
    }
}

/// A number in bytes that are there.
fn number<const N: usize>(bytes: &[u8], offset: usize) -> u64 {
    bytes[offset..offset + N].iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte))
}

/// A row of the section table.
#[derive(Clone, Copy, Debug)]
struct Entry {
    kind: u64,
    crc: u64,
    offset: u64,
    length: u64,
}

/// A file whose header and section table hold.
pub struct Container<'a> {
    source: Source<'a>,
    version: u64,
    entries: Vec<Entry>,
}

/// What files of version 7 compare for a number of triangles, where later ones have a rank: the estimate of the
/// simplifiers, a part of the bound, and attributes.
fn rank_of_version_7(group: &Group) -> f32 {
    const OF_BOUND: f32 = 0.6;
    group.quadric.max(OF_BOUND * group.distance()).max(group.attribute_error)
}

/// A section of words whose length was checked, and nothing else: a channel, or the face ids.
#[derive(Debug)]
pub(super) struct WordSection {
    entry: Entry,
    /// What it is called in error messages.
    label: String,
    dtype: ChannelType,
}

impl WordSection {
    /// Number of words.
    pub(super) fn count(&self) -> usize {
        self.entry.length as usize / size_of::<u32>()
    }

    /// Reads and checks the words.
    pub(super) fn read(&self, source: &Source<'_>) -> Result<Vec<u32>> {
        let Entry { crc, offset, length, .. } = self.entry;
        let fault = |what: &str| source.fail(offset, format!("{}: {what}", self.label));
        // Bounded by the file, which sections are inside of.
        let mut words = Vec::with_capacity(self.count());
        let mut found = crc32fast::Hasher::new();
        for start in (0..length).step_by(WORDS_CHUNK) {
            let bytes = source.take(offset + start, (length - start).min(WORDS_CHUNK as u64), &self.label)?;
            found.update(&bytes);
            words.extend(bytes.chunks_exact(size_of::<u32>()).map(bytemuck::pod_read_unaligned::<u32>));
        }
        if u64::from(found.finalize()) != crc {
            return Err(fault("the checksum does not match"));
        }
        validate::values(self.dtype, &words).map_err(fault)?;
        Ok(words)
    }
}

/// A section that passed its checksum.
struct Section<'a> {
    offset: u64,
    data: Cow<'a, [u8]>,
}

impl<'a> Container<'a> {
    /// Reads the header and the section table. `name` appears in error messages.
    pub fn new(input: &'a dyn Input, name: &'a str) -> Result<Self> {
        let source = Source::new(input, name);
        let header = source.take(0, HEADER_BYTES as u64, "the header")?;
        if header[..8] != MAGIC {
            return Err(source.fail(0, "the magic bytes are missing"));
        }
        if number::<4>(&header, 20) != u64::from(crc32fast::hash(&header[..20])) {
            return Err(source.fail(20, "the header's checksum does not match"));
        }
        let version = number::<4>(&header, 8);
        if !(u64::from(OLDEST_VERSION)..=u64::from(VERSION)).contains(&version) {
            let known = format!("this build reads versions {OLDEST_VERSION} to {VERSION}");
            return Err(source.fail(8, format!("version {version}; {known}")));
        }
        let count = number::<4>(&header, 12);
        let table = source.take(HEADER_BYTES as u64, count * ENTRY_BYTES as u64, "the section table")?;
        if number::<4>(&header, 16) != u64::from(crc32fast::hash(&table)) {
            return Err(source.fail(16, "the section table's checksum does not match"));
        }
        let entry = |row: &[u8]| Entry {
            kind: number::<4>(row, 0),
            crc: number::<4>(row, 4),
            offset: number::<8>(row, 8),
            length: number::<8>(row, 16),
        };
        let entries: Vec<Entry> = table.chunks_exact(ENTRY_BYTES).map(entry).collect();
        let out = Self { source, version, entries };
        out.kinds()?;
        out.padding()?;
        Ok(out)
    }

    /// Sections are of kinds that exist, and only channels have more than one.
    fn kinds(&self) -> Result<()> {
        for (i, entry) in self.entries.iter().enumerate() {
            let kind = Kind::ALL.into_iter().find(|kind| *kind as u64 == entry.kind);
            let again = || self.entries[..i].iter().any(|other| other.kind == entry.kind);
            if kind.is_none_or(|kind| kind != Kind::Channels && again()) {
                let at = HEADER_BYTES + i * ENTRY_BYTES;
                let message = format!("kind {} of a section is unknown, or there twice", entry.kind);
                return Err(self.source.fail(at as u64, message));
            }
        }
        Ok(())
    }

    /// Sections follow each other with nothing but zeros between them, so that no damage goes unseen.
    fn padding(&self) -> Result<()> {
        let source = &self.source;
        let mut end = (HEADER_BYTES + self.entries.len() * ENTRY_BYTES) as u64;
        for entry in &self.entries {
            let gap = source.take(end, entry.offset.saturating_sub(end), "the space between sections")?;
            if entry.offset < end || gap.iter().any(|byte| *byte != 0) {
                return Err(source.fail(end, "the space between sections is not empty"));
            }
            end = entry.offset.saturating_add(entry.length);
        }
        let size = source.input.length();
        if end == size {
            Ok(())
        } else {
            Err(source.fail(end, format!("sections end here, the file at {size}")))
        }
    }

    /// The sections of a kind.
    fn of(&self, kind: Kind) -> impl Iterator<Item = Entry> {
        self.entries.iter().copied().filter(move |entry| entry.kind == kind as u64)
    }

    fn entry(&self, kind: Kind) -> Option<Entry> {
        self.of(kind).next()
    }

    /// Bytes of the sections of a kind.
    pub fn bytes_of(&self, kind: Kind) -> u64 {
        self.of(kind).map(|entry| entry.length).sum()
    }

    fn required(&self, kind: Kind) -> Result<Section<'a>> {
        let Entry { crc, offset, length, .. } = self.entry(kind).ok_or_else(|| self.missing(kind))?;
        let data = self.source.take(offset, length, &format!("section {kind:?}"))?;
        if u64::from(crc32fast::hash(&data)) != crc {
            return Err(self.source.fail(offset, format!("section {kind:?}: the checksum does not match")));
        }
        Ok(Section { offset, data })
    }

    fn missing(&self, kind: Kind) -> Error {
        self.source.fail(HEADER_BYTES as u64, format!("section {kind:?} is missing"))
    }

    fn records<T: AnyBitPattern>(&self, kind: Kind) -> Result<Vec<T>> {
        let section = self.required(kind)?;
        let (size, length) = (size_of::<T>(), section.data.len());
        if !length.is_multiple_of(size) {
            let message = format!("section {kind:?}: {length} bytes are no multiple of {size}");
            return Err(self.source.fail(section.offset, message));
        }
        // The bytes may lie at any alignment.
        Ok(section.data.chunks_exact(size).map(bytemuck::pod_read_unaligned).collect())
    }

    /// The metadata.
    pub fn metadata(&self) -> Result<Metadata> {
        let json = self.required(Kind::Metadata)?;
        let read = serde_json::from_slice(&json.data);
        let fault = |e| self.source.fail(json.offset, format!("section Metadata: {e}"));
        let metadata: Metadata = read.map_err(fault)?;
        let grid = metadata.grid.map_or(Ok(()), validate::grid);
        grid.map_err(|e| self.source.fail(json.offset, format!("section Metadata: {e}")))?;
        Ok(metadata)
    }

    /// The page table, whose rows follow each other and fit the file.
    pub fn page_table(&self) -> Result<Vec<PageRow>> {
        let table_at = self.entry(Kind::PageTable).map_or(0, |entry| entry.offset);
        let rows: Vec<PageRow> = self.records(Kind::PageTable)?;
        let pages = self.entry(Kind::Pages).ok_or_else(|| self.missing(Kind::Pages))?;
        let (mut offset, mut group, mut identity, mut faces) = (0u64, 0, 0, 0u64);
        if rows.first().is_none_or(|row| row.first_group != 0) {
            return Err(self.source.fail(table_at, "the page table does not begin with the first group"));
        }
        for (p, row) in rows.iter().enumerate() {
            let at = table_at + (p * size_of::<PageRow>()) as u64;
            let fault = |what: &str| Err(self.source.fail(at, format!("page {p}: {what}")));
            let known: u64 = row.parts.iter().map(|b| u64::from(*b)).sum();
            if row.offset != offset || row.first_group < group || row.first_identity < identity {
                return fault("it does not follow the one before");
            }
            if !(1..=PAGE_MAX_CLUSTERS as u32).contains(&row.clusters) {
                return fault("number of clusters");
            }
            if row.words as usize > MAX_EXPANSION / 4 * row.bytes as usize || known > u64::from(row.bytes) {
                return fault("too few bytes for what it holds");
            }
            // Who keeps pages in places of one size relies on it.
            if row.words as usize > PAGE_MAX_BYTES / size_of::<u32>() {
                return fault("it decodes to more than a page may have");
            }
            if row.faces > row.clusters * CLUSTER_MAX_TRIANGLES as u32 {
                return fault("number of triangles");
            }
            faces += u64::from(row.faces);
            if faces > u64::from(u32::MAX) {
                return fault("the source has more than 2^32 triangles");
            }
            offset += u64::from(row.bytes);
            (group, identity) = (row.first_group, row.first_identity);
        }
        if offset != pages.length || pages.crc != 0 {
            return Err(self.source.fail(table_at, "the page table does not cover the section of the pages"));
        }
        Ok(rows)
    }

    /// What the metadata says of the channels, each with its section.
    fn channels(&self, metadata: &Metadata) -> Result<Vec<(ChannelInfo, WordSection)>> {
        let (infos, rows) = (&metadata.channels, u64::from(metadata.vertex_count));
        let sections = self.of(Kind::Channels).count();
        if sections != infos.len() {
            let message = format!("{sections} sections Channels for {} channels", infos.len());
            return Err(self.source.fail(HEADER_BYTES as u64, message));
        }
        let section = |(info, entry): (&ChannelInfo, Entry)| {
            let label = format!("section Channels, {:?}", info.name);
            let count = rows * info.width() as u64;
            Ok((info.clone(), self.words(entry, label, info.dtype, count)?))
        };
        infos.iter().zip(self.of(Kind::Channels)).map(section).collect()
    }

    /// A section of so many words, of which none is read.
    fn words(&self, entry: Entry, label: String, dtype: ChannelType, count: u64) -> Result<WordSection> {
        let size = size_of::<u32>() as u64;
        if count.checked_mul(size) == Some(entry.length) {
            Ok(WordSection { entry, label, dtype })
        } else {
            let message = format!("{label}: {} bytes for {count} words", entry.length);
            Err(self.source.fail(entry.offset, message))
        }
    }

    /// What there is besides channels and face ids, without a page.
    fn head(&self) -> Result<Head> {
        let pages = self.entry(Kind::Pages).ok_or_else(|| self.missing(Kind::Pages))?;
        let rows = self.page_table()?;
        let at = self.entry(Kind::Dependencies).map_or(0, |entry| entry.offset);
        let dependencies = Dependencies::new(&rows, self.records(Kind::Dependencies)?)
            .map_err(|message| self.source.fail(at, format!("section Dependencies: {message}")))?;
        let mut groups: Vec<Group> = self.records(Kind::Groups)?;
        if self.version < 8 {
            groups.iter_mut().for_each(|group| group.rank = rank_of_version_7(group));
        }
        Ok(Head {
            metadata: self.metadata()?,
            rows,
            groups: groups.into(),
            dependencies,
            pages_at: pages.offset,
        })
    }

    /// The mesh without the words of its pages, and what decoding them takes; `words` says what becomes of those of
    /// channels and of the face ids.
    pub(super) fn dag(&self, words: impl Fn(WordSection) -> Result<Words>) -> Result<(Dag, Head)> {
        let head = self.head()?;
        let metadata = head.metadata.clone();
        let channels = self.channels(&metadata)?.into_iter();
        let channels = channels.map(|(info, section)| Ok(Channel { info, words: words(section)? }));
        let face_ids = self.entry(Kind::FaceIds).map(|entry| {
            let faces = head.rows.iter().map(|row| u64::from(row.faces)).sum();
            words(self.words(entry, "section FaceIds".into(), ChannelType::Uint32, faces)?)
        });
        let dag = Dag {
            id: GeometryId::default(),
            frame: metadata.frame,
            bounds: Aabb { min: metadata.bounds[0], max: metadata.bounds[1] },
            pages: Arc::new(Pages::absent(head.entries().into(), metadata.layout)),
            groups: Arc::clone(&head.groups),
            nodes: self.records(Kind::Nodes)?,
            vertex_count: metadata.vertex_count,
            channels: channels.collect::<Result<_>>()?,
            source_faces: metadata.source_faces,
            source_vertices: metadata.source_vertices,
            face_ids: face_ids.transpose()?,
            grid: metadata.grid,
            report: metadata.report,
        };
        validate::head(&dag).map_err(|(kind, message)| {
            let at = self.entry(kind).map_or(HEADER_BYTES as u64, |entry| entry.offset);
            self.source.fail(at, format!("section {kind:?}: {message}"))
        })?;
        Ok((dag, head))
    }
}

/// For each page the pages that hold what was made from its groups: while these are not there, it cannot be drawn.
#[derive(Debug)]
pub struct Dependencies {
    /// First of each page in `pages`, and the end.
    first: Vec<usize>,
    pages: Vec<u32>,
}

impl Dependencies {
    fn new(rows: &[PageRow], pages: Vec<u32>) -> std::result::Result<Self, String> {
        let mut first = vec![0];
        let mut end = 0usize;
        for (p, row) in rows.iter().enumerate() {
            let start = end;
            end = end.saturating_add(row.dependencies as usize);
            let own = pages.get(start..end).ok_or_else(|| format!("it ends before page {p}"))?;
            if !own.is_sorted_by(|a, b| a < b) || own.last().is_some_and(|last| *last as usize >= p) {
                return Err(format!("page {p} depends on pages that are not before it, or are out of order"));
            }
            first.push(end);
        }
        if end == pages.len() {
            Ok(Self { first, pages })
        } else {
            Err("it goes on behind the last page".into())
        }
    }

    /// Those of a page, ascending.
    pub fn of(&self, page: usize) -> &[u32] {
        &self.pages[self.first[page]..self.first[page + 1]]
    }
}

/// What decoding a page takes.
#[derive(Debug)]
pub struct Head {
    pub(super) metadata: Metadata,
    pub(super) rows: Vec<PageRow>,
    pub(super) groups: Arc<[Group]>,
    pub(super) dependencies: Dependencies,
    /// First byte of the pages in the file.
    pages_at: u64,
}

impl Head {
    /// The table of the pages in memory.
    pub(super) fn entries(&self) -> Vec<PageEntry> {
        let next = |last: &mut PageEntry, row: &PageRow| {
            *last = last.next(row.words, row.clusters, row.level, row.faces);
            Some(*last)
        };
        // Behind nothing: a level of no triangles.
        self.rows.iter().scan(PageEntry::default(), next).collect()
    }

    /// Reads, decodes and checks a page.
    pub(super) fn page(&self, source: &Source<'_>, page: usize, decoder: &mut Decoder) -> Result<PageWords> {
        let row = &self.rows[page];
        let at = self.pages_at + row.offset;
        let fault = |what: &str| source.fail(at, format!("page {page}: {what}"));
        let end = self.rows.get(page + 1).map_or(self.groups.len(), |next| next.first_group as usize);
        let own = row.first_group as usize..end;
        if validate::members(&self.groups, page, &own) != Some(row.clusters) {
            return Err(fault("its clusters are not those of its groups"));
        }
        let bytes = source.take(at, u64::from(row.bytes), "a page")?;
        if crc32fast::hash(&bytes) != row.crc {
            return Err(fault("the checksum does not match"));
        }
        let Metadata { layout, grid, vertex_count, .. } = self.metadata;
        let first_identity = row.first_identity;
        let context = Context { layout, grid, groups: &self.groups, own, first_identity };
        let step = context.step();
        // Bounded by the bytes of the page, which are there: see `page_table`.
        let mut words = vec![0u32; row.words as usize];
        decoder.decode(&context, &bytes, row.clusters as usize, &mut words).map_err(fault)?;
        let limits = validate::PageLimits { layout, groups: &self.groups, vertex_count, step };
        let records = limits.check(row.clusters, row.faces, &words).map_err(|what| fault(&what))?;
        let depends = |r: &ClusterRecord| {
            r.refined == NO_GROUP
                || r.refined_page as usize == page
                || self.dependencies.of(r.refined_page as usize).binary_search(&(page as u32)).is_ok()
        };
        if !records.iter().all(depends) {
            return Err(fault("what was made from the groups of another does not name it"));
        }
        Ok(words.into())
    }
}

/// Parses a mesh, all of it. `name` appears in error messages.
pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Dag> {
    let source = Source::new(&bytes, name);
    let read = |section: WordSection| section.read(&source).map(Words::from);
    let (dag, head) = Container::new(&bytes, name)?.dag(read)?;
    let decode = |decoder: &mut Result<Decoder>, page: usize| match decoder {
        Ok(decoder) => head.page(&source, page, decoder),
        Err(error) => Err(Error::Invariant(error.to_string())),
    };
    let pages = (0..head.rows.len()).into_par_iter().map_init(Decoder::new, decode).collect::<Result<_>>()?;
    Ok(Dag { pages: Arc::new(Pages::new(head.entries(), dag.layout(), pages)), ..dag })
}
