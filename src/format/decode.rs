//! Bytes as a mesh. Sizes, counts and offsets are checked against the length before anything is allocated.

use bytemuck::AnyBitPattern;

use super::encode::Metadata;
use super::file::{ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, VERSION};
use super::validate;
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::model::{Channel, ChannelInfo, Dag, Pages};

/// The bytes with a name for error messages.
pub struct Source<'a> {
    bytes: &'a [u8],
    name: &'a str,
}

impl Source<'_> {
    /// A format error at an offset.
    pub fn fail(&self, offset: usize, message: impl Into<String>) -> Error {
        Error::Format { name: self.name.into(), offset: offset as u64, message: message.into() }
    }

    fn take(&self, offset: usize, length: usize, what: &str) -> Result<&[u8]> {
        let end = offset.checked_add(length).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else {
            let size = self.bytes.len();
            return Err(self.fail(offset, format!("{what} needs {length} bytes, the file ends at {size}")));
        };
        Ok(&self.bytes[offset..end])
    }

    fn u32(&self, offset: usize) -> Result<u32> {
        let bytes = self.take(offset, 4, "a number")?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    fn length(&self, offset: usize) -> Result<usize> {
        let value = u64::from(self.u32(offset)?) | u64::from(self.u32(offset + 4)?) << 32;
        usize::try_from(value)
            .map_err(|_| self.fail(offset, format!("{value} exceeds this machine's memory")))
    }
}

/// A section that passed its checksum.
struct Section<'a> {
    offset: usize,
    data: &'a [u8],
}

impl Section<'_> {
    fn records<T: AnyBitPattern>(&self, source: &Source<'_>, what: &str) -> Result<Vec<T>> {
        let size = size_of::<T>();
        if !self.data.len().is_multiple_of(size) {
            let message = format!("{what}: {} bytes are no multiple of {size}", self.data.len());
            return Err(source.fail(self.offset, message));
        }
        // The bytes may lie at any alignment.
        Ok(self.data.chunks_exact(size).map(bytemuck::pod_read_unaligned).collect())
    }
}

/// Parses a mesh. `name` appears in error messages.
pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Dag> {
    let source = Source { bytes, name };
    let header = source.take(0, HEADER_BYTES, "the header")?;
    if header[..8] != MAGIC {
        return Err(source.fail(0, "the magic bytes are missing"));
    }
    if source.u32(20)? != crc32fast::hash(&header[..20]) {
        return Err(source.fail(20, "the header's checksum does not match"));
    }
    let version = source.u32(8)?;
    if version != VERSION {
        return Err(source.fail(8, format!("version {version}; this build reads version {VERSION}")));
    }
    let count = source.u32(12)? as usize;
    if count > Kind::ALL.len() {
        return Err(source.fail(12, format!("{count} sections; at most {} exist", Kind::ALL.len())));
    }
    let table = source.take(HEADER_BYTES, count * ENTRY_BYTES, "the section table")?;
    if source.u32(16)? != crc32fast::hash(table) {
        return Err(source.fail(16, "the section table's checksum does not match"));
    }
    padding(&source, count)?;
    assemble(&source, count)
}

/// Sections follow each other with nothing but zeros between them, so that no damage goes unseen.
fn padding(source: &Source<'_>, count: usize) -> Result<()> {
    let mut end = HEADER_BYTES + count * ENTRY_BYTES;
    for entry in (0..count).map(|i| HEADER_BYTES + i * ENTRY_BYTES) {
        let (offset, length) = (source.length(entry + 8)?, source.length(entry + 16)?);
        let gap = source.take(end, offset.saturating_sub(end), "the space between sections")?;
        if gap.iter().any(|byte| *byte != 0) {
            return Err(source.fail(end, "the space between sections is not empty"));
        }
        end = offset.saturating_add(length);
    }
    Ok(())
}

fn section<'a>(source: &'a Source<'_>, count: usize, kind: Kind) -> Result<Option<Section<'a>>> {
    for entry in (0..count).map(|i| HEADER_BYTES + i * ENTRY_BYTES) {
        if source.u32(entry)? != kind as u32 {
            continue;
        }
        let (offset, length) = (source.length(entry + 8)?, source.length(entry + 16)?);
        let data = source.take(offset, length, &format!("section {kind:?}"))?;
        if crc32fast::hash(data) != source.u32(entry + 4)? {
            return Err(source.fail(offset, format!("section {kind:?}: the checksum does not match")));
        }
        return Ok(Some(Section { offset, data }));
    }
    Ok(None)
}

/// The channels: what the metadata says of them, and their words.
fn channels(
    source: &Source<'_>,
    count: usize,
    infos: Vec<ChannelInfo>,
    vertices: u32,
) -> Result<Vec<Channel>> {
    let Some(section) = section(source, count, Kind::Channels)? else {
        return match infos.first() {
            Some(info) => Err(source.fail(HEADER_BYTES, format!("channel {:?} has no section", info.name))),
            None => Ok(Vec::new()),
        };
    };
    let words: Vec<u32> = section.records(source, "Channels")?;
    let mut rest = &words[..];
    let mut channels = Vec::new();
    for info in infos {
        let taken =
            info.width().checked_mul(vertices as usize).and_then(|count| rest.split_at_checked(count));
        let Some((words, after)) = taken else {
            return Err(source.fail(section.offset, format!("section Channels ends inside {:?}", info.name)));
        };
        rest = after;
        channels.push(Channel { info, words: words.to_vec() });
    }
    if !rest.is_empty() {
        return Err(
            source.fail(section.offset, format!("section Channels has {} words left over", rest.len()))
        );
    }
    Ok(channels)
}

fn assemble(source: &Source<'_>, count: usize) -> Result<Dag> {
    let required = |kind| {
        section(source, count, kind)?
            .ok_or_else(|| source.fail(HEADER_BYTES, format!("section {kind:?} is missing")))
    };
    let json = required(Kind::Metadata)?;
    let metadata: Metadata = serde_json::from_slice(json.data)
        .map_err(|e| source.fail(json.offset, format!("section Metadata: {e}")))?;
    let words = required(Kind::Pages)?;
    let pages_at = words.offset;
    let pages = Pages {
        words: words.records(source, "Pages")?,
        table: required(Kind::PageTable)?.records(source, "PageTable")?,
        layout: metadata.layout,
    };
    let face_ids = match section(source, count, Kind::FaceIds)? {
        Some(rows) => Some(rows.records(source, "FaceIds")?),
        None => None,
    };
    let dag = Dag {
        frame: metadata.frame,
        bounds: Aabb { min: metadata.bounds[0], max: metadata.bounds[1] },
        pages,
        groups: required(Kind::Groups)?.records(source, "Groups")?,
        nodes: required(Kind::Nodes)?.records(source, "Nodes")?,
        vertex_count: metadata.vertex_count,
        channels: channels(source, count, metadata.channels, metadata.vertex_count)?,
        source_faces: metadata.source_faces,
        source_vertices: metadata.source_vertices,
        face_ids,
        report: metadata.report,
    };
    validate::structure(&dag).map_err(|(section, message)| {
        let at = if section == Kind::Pages { pages_at } else { HEADER_BYTES };
        source.fail(at, format!("section {section:?}: {message}"))
    })?;
    Ok(dag)
}
