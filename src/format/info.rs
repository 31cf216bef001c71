//! What a file says of itself before its pages, of which none is read.

use std::path::Path;

use super::decode::{Container, Source};
use super::encode::Metadata;
use super::file::{Kind, PageRow};
use super::input::{Input, OnDisk};
use super::page::Part;
use crate::error::Result;
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

/// Reads the header, the metadata and the page table of a file, whatever its size.
pub fn file_info(path: &Path) -> Result<FileInfo> {
    input_info(&OnDisk::open(path)?, &path.display().to_string())
}

/// The same of an input; `name` appears in error messages.
pub fn input_info(input: &dyn Input, name: &str) -> Result<FileInfo> {
    let length = input.length();
    let container = Container::new(Source::of_input(input, name), &[Kind::Metadata, Kind::PageTable])?;
    let (metadata, pages) = (container.metadata()?, container.page_table()?);
    let of = |kind| container.bytes_of(kind);
    let mut parts: Vec<(&'static str, u64)> = Part::ALL
        .iter()
        .map(|part| (part.name(), pages.iter().map(|row| u64::from(row.parts[*part as usize])).sum()))
        .collect();
    parts.push((
        "hierarchy",
        of(Kind::Groups) + of(Kind::Nodes) + of(Kind::PageTable) + of(Kind::Dependencies),
    ));
    parts.push(("metadata", of(Kind::Metadata)));
    parts.push(("face_ids", of(Kind::FaceIds)));
    parts.push(("channels", of(Kind::Channels)));
    parts.push(("materials", of(Kind::Materials)));
    parts.push(("images", of(Kind::Images)));
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
