//! Bytes as a mesh. Sizes, counts and offsets are checked against the length before anything is allocated.

use std::borrow::Cow;
use std::iter::once;
use std::ops::Range;
use std::sync::Arc;

use bytemuck::AnyBitPattern;
use rayon::prelude::*;

use super::encode::Metadata;
use super::file::{ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, MAX_EXPANSION, OLDEST_VERSION, PageRow, VERSION};
use super::input::{Input, read_now};
use super::page::Context;
use super::page_decode::Decoder;
use super::validate;
use crate::error::{Error, Result};
use crate::limits::{CLUSTER_MAX_TRIANGLES, PAGE_MAX_BYTES, PAGE_MAX_CLUSTERS};
use crate::math::Aabb;
use crate::model::cluster::NO_GROUP;
use crate::model::{
    Blob, Channel, ChannelInfo, ChannelType, ClusterRecord, Dag, GeometryId, Group, Materials, PageEntry,
    PageWords, Pages, Primitive, Words,
};

/// Bytes that opening reads first: header, section table and, of most files, all that comes before pages and channels.
pub const FIRST_READ: u64 = 1 << 18;
/// What opening needs.
const FRONT: [Kind; 6] =
    [Kind::Metadata, Kind::PageTable, Kind::Dependencies, Kind::Groups, Kind::Nodes, Kind::Materials];
/// Bytes that are read as one range, of sections that are read when they are wanted.
const CHUNK: u64 = 1 << 20;

/// The bytes that were read of a file, with its name for error messages.
pub struct Source<'a> {
    name: &'a str,
    length: u64,
    /// Where more of them come from.
    input: Option<&'a dyn Input>,
    /// Each with the offset of its first byte.
    parts: Vec<(u64, Cow<'a, [u8]>)>,
}

impl<'a> Source<'a> {
    /// All of a file.
    pub fn of_bytes(bytes: &'a [u8], name: &'a str) -> Self {
        Self { name, length: bytes.len() as u64, input: None, parts: vec![(0, Cow::Borrowed(bytes))] }
    }

    /// A file of which nothing is read yet.
    pub fn of_input(input: &'a dyn Input, name: &'a str) -> Self {
        Self { name, length: input.length(), input: Some(input), parts: Vec::new() }
    }

    /// A format error at an offset.
    fn fail(&self, offset: u64, message: impl Into<String>) -> Error {
        fault(self.name, offset, message)
    }

    /// Reads what is not there of these ranges, as far as the file goes, by one batch. What touches becomes one part.
    fn fetch(&mut self, wanted: impl IntoIterator<Item = Range<u64>>) -> Result<()> {
        let Some(input) = self.input else { return Ok(()) };
        let mut wanted: Vec<Range<u64>> = wanted.into_iter().collect();
        wanted.sort_by_key(|range| range.start);
        let mut ranges: Vec<Range<u64>> = Vec::new();
        for range in wanted {
            let known = self.parts.iter().map(|(first, bytes)| *first..first + bytes.len() as u64);
            let behind = |start: u64, other: Range<u64>| match (other.start..=other.end).contains(&start) {
                true => other.end,
                false => start,
            };
            let start = known.chain(ranges.last().cloned()).fold(range.start, behind);
            let end = range.end.min(self.length);
            match ranges.last_mut() {
                _ if start >= end => {}
                Some(last) if last.end == start => last.end = end,
                _ => ranges.push(start..end),
            }
        }
        if ranges.is_empty() {
            return Ok(());
        }
        let read = read_now(input, &ranges).map_err(io(self.name))?;
        for (bytes, Range { start, .. }) in read.into_iter().zip(ranges) {
            match self.parts.iter_mut().find(|(first, part)| first + part.len() as u64 == start) {
                Some((_, part)) => part.to_mut().extend(bytes),
                None => self.parts.push((start, bytes.into())),
            }
        }
        Ok(())
    }

    /// Bytes that were read. None are there everywhere.
    fn take(&self, offset: u64, length: u64, what: &str) -> Result<&[u8]> {
        if offset.checked_add(length).is_none_or(|end| end > self.length) {
            let size = self.length;
            return Err(self.fail(offset, format!("{what} needs {length} bytes, the file ends at {size}")));
        }
        let inside = |(first, bytes): &(u64, Cow<'a, [u8]>)| {
            let start = usize::try_from(offset.checked_sub(*first)?).ok()?;
            let end = start.checked_add(usize::try_from(length).ok()?)?;
            (end <= bytes.len()).then_some(start..end)
        };
        let found = self.parts.iter().find_map(|part| Some(&part.1[inside(part)?]));
        let none: Option<&[u8]> = (length == 0).then_some(&[]);
        found.or(none).ok_or_else(|| Error::Invariant(format!("{what} was not read")))
    }
}

/// A format error of a file at an offset.
pub(super) fn fault(name: &str, offset: u64, message: impl Into<String>) -> Error {
    Error::Format { name: name.into(), offset, message: message.into() }
}

/// An error of reading a file.
pub(super) fn io(name: &str) -> impl Fn(std::io::Error) -> Error + '_ {
    |source| Error::Io { path: name.into(), source }
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

/// A section of which nothing was read, inside of the file: an image, or one of words.
#[derive(Debug)]
pub(super) struct LateSection {
    entry: Entry,
    /// What it is called in error messages.
    label: String,
}

impl LateSection {
    /// Number of bytes.
    pub(super) fn count(&self) -> u64 {
        self.entry.length
    }

    /// Where it lies, in ranges of whole words.
    pub(super) fn ranges(&self) -> Vec<Range<u64>> {
        let end = self.entry.offset + self.entry.length;
        let starts = (self.entry.offset..end).step_by(CHUNK as usize);
        starts.map(|start| start..end.min(start + CHUNK)).collect()
    }

    /// Takes the bytes of these ranges, and checks them.
    pub(super) fn read<T: AnyBitPattern, B: AsRef<[u8]>>(
        &self,
        name: &str,
        parts: impl Iterator<Item = Result<B>>,
    ) -> Result<Vec<T>> {
        // Bounded by the file.
        let mut values = Vec::with_capacity(self.entry.length as usize / size_of::<T>());
        let mut found = crc32fast::Hasher::new();
        for part in parts {
            let part = part?;
            let bytes = part.as_ref();
            found.update(bytes);
            values.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
        }
        if u64::from(found.finalize()) == self.entry.crc {
            Ok(values)
        } else {
            Err(self.fault(name, "the checksum does not match"))
        }
    }

    fn fault(&self, name: &str, what: &str) -> Error {
        fault(name, self.entry.offset, format!("{}: {what}", self.label))
    }
}

/// A section of words whose length was checked, and nothing else: a channel, or the face ids.
#[derive(Debug)]
pub(super) struct WordSection {
    /// Where they are.
    pub(super) late: LateSection,
    dtype: ChannelType,
}

impl WordSection {
    /// Number of words.
    pub(super) fn count(&self) -> usize {
        self.late.count() as usize / size_of::<u32>()
    }

    /// Takes the bytes of its ranges as words, and checks them.
    pub(super) fn words<B: AsRef<[u8]>>(
        &self,
        name: &str,
        parts: impl Iterator<Item = Result<B>>,
    ) -> Result<Vec<u32>> {
        let words = self.late.read(name, parts)?;
        validate::values(self.dtype, &words).map_err(|what| self.late.fault(name, what))?;
        Ok(words)
    }
}

/// A section that passed its checksum.
struct Section<'a> {
    offset: u64,
    data: &'a [u8],
}

impl<'a> Container<'a> {
    /// Reads the header, the section table and the sections of some kinds: by one batch where they are among the first
    /// bytes, by two else.
    pub fn new(mut source: Source<'a>, kinds: &[Kind]) -> Result<Self> {
        source.fetch(once(0..FIRST_READ))?;
        let header = source.take(0, HEADER_BYTES as u64, "the header")?;
        if header[..8] != MAGIC {
            return Err(source.fail(0, "the magic bytes are missing"));
        }
        if number::<4>(header, 20) != u64::from(crc32fast::hash(&header[..20])) {
            return Err(source.fail(20, "the header's checksum does not match"));
        }
        let version = number::<4>(header, 8);
        if !(u64::from(OLDEST_VERSION)..=u64::from(VERSION)).contains(&version) {
            let known = format!("this build reads versions {OLDEST_VERSION} to {VERSION}");
            return Err(source.fail(8, format!("version {version}; {known}")));
        }
        let count = number::<4>(header, 12);
        let (crc, bytes) = (number::<4>(header, 16), count * ENTRY_BYTES as u64);
        source.fetch(once(HEADER_BYTES as u64..HEADER_BYTES as u64 + bytes))?;
        let table = source.take(HEADER_BYTES as u64, bytes, "the section table")?;
        if crc != u64::from(crc32fast::hash(table)) {
            return Err(source.fail(16, "the section table's checksum does not match"));
        }
        let entry = |row: &[u8]| Entry {
            kind: number::<4>(row, 0),
            crc: number::<4>(row, 4),
            offset: number::<8>(row, 8),
            length: number::<8>(row, 16),
        };
        let entries: Vec<Entry> = table.chunks_exact(ENTRY_BYTES).map(entry).collect();
        let mut out = Self { source, version, entries };
        out.kinds()?;
        out.source.fetch(out.wanted(kinds))?;
        out.padding()?;
        Ok(out)
    }

    /// The sections of some kinds, and the space before each section.
    fn wanted(&self, kinds: &[Kind]) -> Vec<Range<u64>> {
        let mut end = (HEADER_BYTES + self.entries.len() * ENTRY_BYTES) as u64;
        let mut out = Vec::new();
        for entry in &self.entries {
            out.push(end..entry.offset);
            end = entry.offset.saturating_add(entry.length);
            if kinds.iter().any(|kind| *kind as u64 == entry.kind) {
                out.push(entry.offset..end);
            }
        }
        out
    }

    /// Sections are of kinds that exist, and only of some there are several.
    fn kinds(&self) -> Result<()> {
        for (i, entry) in self.entries.iter().enumerate() {
            let kind = Kind::ALL.into_iter().find(|kind| *kind as u64 == entry.kind);
            let again = || self.entries[..i].iter().any(|other| other.kind == entry.kind);
            if kind.is_none_or(|kind| !kind.several() && again()) {
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
        let size = source.length;
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

    fn required(&self, kind: Kind) -> Result<Section<'_>> {
        let Entry { crc, offset, length, .. } = self.entry(kind).ok_or_else(|| self.missing(kind))?;
        let data = self.source.take(offset, length, &format!("section {kind:?}"))?;
        if u64::from(crc32fast::hash(data)) != crc {
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
        let read = serde_json::from_slice(json.data);
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
            Ok(WordSection { late: LateSection { entry, label }, dtype })
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

    /// How it looks; `blob` says what becomes of images.
    fn materials(&self, blob: impl Fn(LateSection) -> Result<Blob>) -> Result<Materials> {
        let images = self.of(Kind::Images).zip(0..).map(|(entry, number)| {
            blob(LateSection { entry, label: format!("section Images, number {number}") })
        });
        let images = images.collect::<Result<Vec<Blob>>>()?;
        if self.entry(Kind::Materials).is_none() {
            let none =
                || self.source.fail(HEADER_BYTES as u64, "section Materials is missing, Images are not");
            return images.is_empty().then(Materials::default).ok_or_else(none);
        }
        let table = self.required(Kind::Materials)?;
        let text = std::str::from_utf8(table.data);
        let text = text.map_err(|e| self.source.fail(table.offset, format!("section Materials: {e}")))?;
        Ok(Materials { table: text.into(), images })
    }

    /// The mesh without the words of its pages, and what decoding them takes; `words` says what becomes of those of
    /// channels and of the face ids, `blob` of images.
    pub(super) fn dag(
        &self,
        words: impl Fn(WordSection) -> Result<Words>,
        blob: impl Fn(LateSection) -> Result<Blob>,
    ) -> Result<(Dag, Head)> {
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
            topology: None,
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
            materials: self.materials(blob)?,
            primitive: Primitive::Triangles,
            grid: metadata.grid,
            pose: None,
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

    /// Where a page lies in the file.
    pub(super) fn place(&self, page: usize) -> Range<u64> {
        let row = &self.rows[page];
        let at = self.pages_at + row.offset;
        at..at + u64::from(row.bytes)
    }

    /// Decodes and checks a page.
    pub(super) fn page(
        &self,
        name: &str,
        page: usize,
        bytes: &[u8],
        decoder: &mut Decoder,
    ) -> Result<PageWords> {
        let row = &self.rows[page];
        let fault = |what: &str| fault(name, self.place(page).start, format!("page {page}: {what}"));
        let end = self.rows.get(page + 1).map_or(self.groups.len(), |next| next.first_group as usize);
        let own = row.first_group as usize..end;
        if validate::members(&self.groups, page, &own) != Some(row.clusters) {
            return Err(fault("its clusters are not those of its groups"));
        }
        if crc32fast::hash(bytes) != row.crc {
            return Err(fault("the checksum does not match"));
        }
        let Metadata { layout, grid, vertex_count, .. } = self.metadata;
        let first_identity = row.first_identity;
        let context = Context { layout, grid, groups: &self.groups, own: own.clone(), first_identity };
        let step = context.step();
        // Bounded by the bytes of the page, which are there: see `page_table`.
        let mut words = vec![0u32; row.words as usize];
        decoder.decode(&context, bytes, row.clusters as usize, &mut words).map_err(fault)?;
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
        validate::triangles(&self.groups[own], records).map_err(fault)?;
        Ok(words.into())
    }
}

/// Parses a mesh, all of it. `name` appears in error messages.
pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Dag> {
    // Sections are inside of the file, and pages of theirs.
    let part = |range: Range<u64>| &bytes[range.start as usize..range.end as usize];
    let parts = |section: &LateSection| section.ranges().into_iter().map(|range| Ok(part(range)));
    let words = |section: WordSection| section.words(name, parts(&section.late)).map(Words::from);
    let blob = |section: LateSection| section.read(name, parts(&section)).map(Blob::from);
    let (dag, head) = Container::new(Source::of_bytes(bytes, name), &FRONT)?.dag(words, blob)?;
    let decode = |decoder: &mut Result<Decoder>, page: usize| match decoder {
        Ok(decoder) => head.page(name, page, part(head.place(page)), decoder),
        Err(error) => Err(Error::Invariant(error.to_string())),
    };
    let pages = (0..head.rows.len()).into_par_iter().map_init(Decoder::new, decode).collect::<Result<_>>()?;
    Ok(Dag { pages: Arc::new(Pages::new(head.entries(), dag.layout(), pages)), ..dag })
}

/// Reads all of a file but pages, channels, face ids and images: see [`Container::dag`].
pub(super) fn front(
    input: &dyn Input,
    name: &str,
    words: impl Fn(WordSection) -> Result<Words>,
    blob: impl Fn(LateSection) -> Result<Blob>,
) -> Result<(Dag, Head)> {
    Container::new(Source::of_input(input, name), &FRONT)?.dag(words, blob)
}
