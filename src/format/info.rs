//! What a file says of itself before its pages, of which none is read.

use std::borrow::Cow;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::decode::{Container, Input};
use super::encode::Metadata;
use super::file::{Kind, PageRow};
use super::page::Part;
use crate::error::{Error, Result};
use crate::model::{Group, Node};

/// What [`file_info`] tells.
#[derive(Clone, Debug)]
pub struct FileInfo {
    /// The metadata.
    pub metadata: Metadata,
    /// The page table.
    pub pages: Vec<PageRow>,
    /// Number of groups.
    pub groups: u64,
    /// Number of hierarchy nodes.
    pub nodes: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes by what they are about; together all of the file.
    pub parts: Vec<(&'static str, u64)>,
}

/// A file of which only parts are read.
struct OnDisk {
    file: File,
    length: u64,
}

impl Input for OnDisk {
    fn length(&self) -> u64 {
        self.length
    }

    fn read(&self, offset: u64, length: usize) -> std::io::Result<Cow<'_, [u8]>> {
        let mut file = &self.file;
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = vec![0; length];
        file.read_exact(&mut bytes)?;
        Ok(Cow::Owned(bytes))
    }
}

/// Reads the header, the metadata and the page table of a file, whatever its size.
pub fn file_info(path: &Path) -> Result<FileInfo> {
    let io = |source| Error::Io { path: path.to_path_buf(), source };
    let file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let name = path.display().to_string();
    let input = OnDisk { file, length };
    let container = Container::new(&input, &name)?;
    let (metadata, pages) = (container.metadata()?, container.page_table()?);
    let of = |kind| container.bytes_of(kind);
    let mut parts: Vec<(&'static str, u64)> = Part::ALL
        .iter()
        .map(|part| (part.name(), pages.iter().map(|row| u64::from(row.parts[*part as usize])).sum()))
        .collect();
    parts.push(("hierarchy", of(Kind::Groups) + of(Kind::Nodes) + of(Kind::PageTable)));
    parts.push(("metadata", of(Kind::Metadata)));
    parts.push(("face_ids", of(Kind::FaceIds)));
    parts.push(("channels", of(Kind::Channels)));
    let told: u64 = parts.iter().map(|part| part.1).sum();
    parts.push(("padding", length.saturating_sub(told)));
    let count = |kind, size: usize| of(kind) / size as u64;
    Ok(FileInfo {
        groups: count(Kind::Groups, size_of::<Group>()),
        nodes: count(Kind::Nodes, size_of::<Node>()),
        metadata,
        pages,
        bytes: length,
        parts,
    })
}
