//! Bytes as a mesh. Sizes, counts and offsets are checked against the length before anything is allocated.

use std::borrow::Cow;

use bytemuck::AnyBitPattern;
use rayon::prelude::*;

use super::encode::Metadata;
use super::file::{ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, MAX_EXPANSION, PageRow, VERSION};
use super::page::Context;
use super::page_decode::Decoder;
use super::validate;
use crate::error::{Error, Result};
use crate::limits::PAGE_MAX_CLUSTERS;
use crate::math::Aabb;
use crate::model::cluster::RECORD_WORDS;
use crate::model::{Channel, ChannelInfo, Dag, Group, PageEntry, Pages};

/// Where bytes come from: memory, or a file of which only parts are wanted.
pub trait Input: Sync {
    /// Number of bytes.
    fn length(&self) -> u64;
    /// Some of them, which are there.
    fn read(&self, offset: u64, length: usize) -> std::io::Result<Cow<'_, [u8]>>;
}

impl Input for &[u8] {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn read(&self, offset: u64, length: usize) -> std::io::Result<Cow<'_, [u8]>> {
        Ok(Cow::Borrowed(&self[offset as usize..][..length]))
    }
}

/// The bytes with a name for error messages.
pub struct Source<'a> {
    input: &'a dyn Input,
    name: &'a str,
}

impl<'a> Source<'a> {
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
#[derive(Clone, Copy)]
struct Entry {
    kind: u64,
    crc: u64,
    offset: u64,
    length: u64,
}

/// A file whose header and section table hold.
pub struct Container<'a> {
    source: Source<'a>,
    entries: Vec<Entry>,
}

/// A section that passed its checksum.
struct Section<'a> {
    offset: u64,
    data: Cow<'a, [u8]>,
}

impl<'a> Container<'a> {
    /// Reads the header and the section table. `name` appears in error messages.
    pub fn new(input: &'a dyn Input, name: &'a str) -> Result<Self> {
        let source = Source { input, name };
        let header = source.take(0, HEADER_BYTES as u64, "the header")?;
        if header[..8] != MAGIC {
            return Err(source.fail(0, "the magic bytes are missing"));
        }
        if number::<4>(&header, 20) != u64::from(crc32fast::hash(&header[..20])) {
            return Err(source.fail(20, "the header's checksum does not match"));
        }
        let version = number::<4>(&header, 8);
        if version != u64::from(VERSION) {
            return Err(source.fail(8, format!("version {version}; this build reads version {VERSION}")));
        }
        let count = number::<4>(&header, 12);
        if count > Kind::ALL.len() as u64 {
            return Err(source.fail(12, format!("{count} sections; at most {} exist", Kind::ALL.len())));
        }
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
        let out = Self { source, entries };
        out.padding()?;
        Ok(out)
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

    fn entry(&self, kind: Kind) -> Option<Entry> {
        self.entries.iter().copied().find(|entry| entry.kind == kind as u64)
    }

    /// Bytes of a section; none where it is absent.
    pub fn bytes_of(&self, kind: Kind) -> u64 {
        self.entry(kind).map_or(0, |entry| entry.length)
    }

    fn section(&self, kind: Kind) -> Result<Option<Section<'a>>> {
        let Some(Entry { crc, offset, length, .. }) = self.entry(kind) else { return Ok(None) };
        let data = self.source.take(offset, length, &format!("section {kind:?}"))?;
        if u64::from(crc32fast::hash(&data)) != crc {
            return Err(self.source.fail(offset, format!("section {kind:?}: the checksum does not match")));
        }
        Ok(Some(Section { offset, data }))
    }

    fn missing(&self, kind: Kind) -> Error {
        self.source.fail(HEADER_BYTES as u64, format!("section {kind:?} is missing"))
    }

    fn required(&self, kind: Kind) -> Result<Section<'a>> {
        self.section(kind)?.ok_or_else(|| self.missing(kind))
    }

    fn records<T: AnyBitPattern>(&self, kind: Kind) -> Result<Vec<T>> {
        let section = self.required(kind)?;
        self.rows(&section, kind)
    }

    fn rows<T: AnyBitPattern>(&self, section: &Section<'_>, kind: Kind) -> Result<Vec<T>> {
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
        let (mut offset, mut group, mut identity) = (0u64, 0, 0);
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
            offset += u64::from(row.bytes);
            (group, identity) = (row.first_group, row.first_identity);
        }
        if offset != pages.length || pages.crc != 0 {
            return Err(self.source.fail(table_at, "the page table does not cover the section of the pages"));
        }
        Ok(rows)
    }

    /// The channels: what the metadata says of them, and their words.
    fn channels(&self, infos: Vec<ChannelInfo>, vertices: u32) -> Result<Vec<Channel>> {
        let Some(section) = self.section(Kind::Channels)? else {
            return match infos.first() {
                Some(info) => Err(self
                    .source
                    .fail(HEADER_BYTES as u64, format!("channel {:?} has no section", info.name))),
                None => Ok(Vec::new()),
            };
        };
        let fault = |what: String| Err(self.source.fail(section.offset, format!("section Channels {what}")));
        let words: Vec<u32> = self.rows(&section, Kind::Channels)?;
        let mut rest = &words[..];
        let mut channels = Vec::new();
        for info in infos {
            let taken =
                info.width().checked_mul(vertices as usize).and_then(|count| rest.split_at_checked(count));
            let Some((words, after)) = taken else { return fault(format!("ends inside {:?}", info.name)) };
            rest = after;
            channels.push(Channel { info, words: words.to_vec() });
        }
        if rest.is_empty() { Ok(channels) } else { fault(format!("has {} words left over", rest.len())) }
    }

    /// Decodes all pages, each on some thread.
    fn pages(&self, metadata: &Metadata, rows: &[PageRow], groups: &[Group]) -> Result<Pages> {
        let layout = metadata.layout;
        let section = self.entry(Kind::Pages).ok_or_else(|| self.missing(Kind::Pages))?;
        let mut table = Vec::with_capacity(rows.len());
        let (mut offset, mut first_cluster) = (0, 0u32);
        for row in rows {
            let (words, clusters, level) = (row.words, row.clusters, row.level);
            table.push(PageEntry { offset, words, clusters, first_cluster, level });
            offset += u64::from(words);
            first_cluster = first_cluster.saturating_add(clusters);
        }
        // Bounded by the bytes of the pages, which are there: see `page_table`.
        let mut words = vec![0u32; offset as usize];
        let mut slices = Vec::with_capacity(rows.len());
        let mut rest = &mut words[..];
        for row in rows {
            let (page, tail) = rest.split_at_mut(row.words as usize);
            slices.push(page);
            rest = tail;
        }
        let ends = rows.iter().skip(1).map(|row| row.first_group as usize).chain([groups.len()]);
        let tasks: Vec<_> = rows.iter().zip(ends).zip(slices).enumerate().collect();
        let decode = |tools: &mut Result<Decoder>,
                      (p, ((row, end), out)): (usize, ((&PageRow, usize), &mut [u32]))| {
            let decoder = match tools {
                Ok(decoder) => decoder,
                Err(error) => return Err(Error::Invariant(error.to_string())),
            };
            let at = section.offset + row.offset;
            let fault = |what: &'static str| self.source.fail(at, format!("page {p}: {what}"));
            let own = row.first_group as usize..end;
            if validate::members(groups, p, &own) != Some(row.clusters) {
                return Err(fault("its clusters are not those of its groups"));
            }
            if row.words < row.clusters * RECORD_WORDS as u32 {
                return Err(fault("clusters do not fill the page"));
            }
            let bytes = self.source.take(at, u64::from(row.bytes), "a page")?;
            if crc32fast::hash(&bytes) != row.crc {
                return Err(fault("the checksum does not match"));
            }
            let first_identity = row.first_identity;
            let context = Context { layout, grid: metadata.grid, groups, own, first_identity };
            decoder.decode(&context, &bytes, row.clusters as usize, out).map_err(fault)
        };
        tasks.into_par_iter().map_init(Decoder::new, decode).collect::<Result<()>>()?;
        Ok(Pages { words, table, layout })
    }

    /// All of the mesh.
    fn dag(&self) -> Result<Dag> {
        let metadata = self.metadata()?;
        let rows = self.page_table()?;
        let groups: Vec<Group> = self.records(Kind::Groups)?;
        let pages = self.pages(&metadata, &rows, &groups)?;
        let face_ids = match self.section(Kind::FaceIds)? {
            Some(section) => Some(self.rows(&section, Kind::FaceIds)?),
            None => None,
        };
        let dag = Dag {
            frame: metadata.frame,
            bounds: Aabb { min: metadata.bounds[0], max: metadata.bounds[1] },
            pages,
            groups,
            nodes: self.records(Kind::Nodes)?,
            vertex_count: metadata.vertex_count,
            channels: self.channels(metadata.channels, metadata.vertex_count)?,
            source_faces: metadata.source_faces,
            source_vertices: metadata.source_vertices,
            face_ids,
            grid: metadata.grid,
            report: metadata.report,
        };
        validate::structure(&dag).map_err(|(kind, message)| {
            let at = self.entry(kind).map_or(HEADER_BYTES as u64, |entry| entry.offset);
            self.source.fail(at, format!("section {kind:?}: {message}"))
        })?;
        Ok(dag)
    }
}

/// Parses a mesh. `name` appears in error messages.
pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Dag> {
    Container::new(&bytes, name)?.dag()
}
