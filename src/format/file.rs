//! Files: constants of the container, reading, and atomic writing.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};

use super::encode::FileSink;
use super::page::PartBytes;
use super::quantize::{Precision, Rounded};
use crate::error::{Error, Result};
use crate::model::{Dag, InterruptCheck};

/// First bytes of a file. The high bit and the line ends catch transfers that are not binary-safe.
pub const MAGIC: [u8; 8] = *b"\x89NANITE\n";
/// Version of the layout. Readers refuse newer ones.
pub const VERSION: u32 = 9;
/// The oldest version that is read: its groups have no rank. Version 8 has no materials.
pub const OLDEST_VERSION: u32 = 7;
/// Bytes before the section table.
pub const HEADER_BYTES: usize = 24;
/// Bytes of an entry of the section table.
pub const ENTRY_BYTES: usize = 32;
/// Boundary that sections start on.
pub const ALIGNMENT: usize = 64;

/// A page decodes to at most so many times its bytes, so that the length of a file bounds what reading it allocates.
pub const MAX_EXPANSION: usize = 256;

/// What a section holds. Every kind occurs exactly once, but for `FaceIds` and `Materials`, which may be absent, and those of
/// which there are [`Kind::several`].
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// JSON for people and for what is small: frame, layout, counts, build report.
    Metadata = 1,
    /// [`crate::model::Group`] records.
    Groups = 2,
    /// [`crate::model::Node`] records.
    Nodes = 3,
    /// [`PageRow`] records.
    PageTable = 4,
    /// For each page the numbers of the others with clusters that were made from its groups, ascending.
    Dependencies = 8,
    /// Coded pages without a gap; the checksums are those of the table.
    Pages = 5,
    /// Rows of the caller's faces, one u32 per level-0 triangle.
    FaceIds = 6,
    /// The words of one channel, a row for each vertex identity; as often as there are channels, in their order.
    Channels = 7,
    /// JSON: how surfaces look, see [`crate::model::Materials`].
    Materials = 9,
    /// An image of materials as it was encoded; as often as there are images, in the order of their table.
    Images = 10,
}

impl Kind {
    /// All kinds, in file order.
    pub const ALL: [Self; 10] = [
        Self::Metadata,
        Self::PageTable,
        Self::Dependencies,
        Self::Groups,
        Self::Nodes,
        Self::Materials,
        Self::FaceIds,
        Self::Channels,
        Self::Images,
        Self::Pages,
    ];

    /// Whether a file may have any number of sections of this kind.
    pub fn several(self) -> bool {
        matches!(self, Self::Channels | Self::Images)
    }
}

/// A page in the page table: all that is needed to read and decode it besides the sections before the pages.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PageRow {
    /// First byte, from the start of the section.
    pub offset: u64,
    /// Number of bytes.
    pub bytes: u32,
    /// CRC-32 of the bytes.
    pub crc: u32,
    /// Words that it decodes to.
    pub words: u32,
    /// Number of clusters.
    pub clusters: u32,
    /// Level of its first group.
    pub level: u32,
    /// The first group whose members it holds.
    pub first_group: u32,
    /// One more than the largest identity of the pages before.
    pub first_identity: u32,
    /// Triangles of the source that it holds.
    pub faces: u32,
    /// Number of pages that it depends on, see [`Kind::Dependencies`].
    pub dependencies: u32,
    /// How many bytes are about what, in order ([`super::page::Part`]); what is left is padding.
    pub parts: PartBytes,
}

const _: () = assert!(size_of::<PageRow>() == 72);

fn io(path: &Path) -> impl Fn(std::io::Error) -> Error + '_ {
    |source| Error::Io { path: path.to_path_buf(), source }
}

/// Most symbolic links on the way to a file, as on Linux.
const MAX_LINKS: usize = 40;

/// Where a path leads if it is a symbolic link, there or not.
fn target(path: &Path) -> std::io::Result<PathBuf> {
    let mut target = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        match std::fs::read_link(&target) {
            Ok(next) => target = target.parent().map_or(next.clone(), |folder| folder.join(&next)),
            // No link, or nothing there yet.
            Err(_) => return Ok(target),
        }
    }
    // The system's own words for it.
    Err(std::fs::metadata(path).err().unwrap_or_else(|| std::io::ErrorKind::InvalidInput.into()))
}

/// Whether files of one folder can be renamed to those of another.
fn is_one_disk(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let disk = |folder: &Path| std::fs::metadata(folder).ok().map(|folder| folder.dev());
        disk(a).is_some_and(|own| disk(b) == Some(own))
    }
    #[cfg(not(unix))]
    {
        let _ = (a, b);
        false
    }
}

/// Writes a mesh: to a temporary file beside the target, synced, then renamed over it. Whatever happens, the
/// target is the old file or the new one, whole. It keeps the mode of the old one; a symbolic link goes on being one,
/// and what it leads to is replaced. Returns how many triangles of the source have no area on the grid.
pub fn save(dag: &Dag, path: &Path, precision: Precision, proceed: InterruptCheck<'_>) -> Result<u64> {
    save_by_way_of(dag, path, precision, None, proceed)
}

/// The same, with the temporary file in a folder that is cleared away by others, should the process be killed; as far as files
/// of that folder can be renamed to the target, and otherwise beside it.
pub fn save_by_way_of(
    dag: &Dag,
    path: &Path,
    precision: Precision,
    way: Option<&Path>,
    proceed: InterruptCheck<'_>,
) -> Result<u64> {
    let rounded = Rounded::new(dag, precision, proceed)?;
    let target = target(path).map_err(io(path))?;
    let old = match std::fs::metadata(&target) {
        Ok(old) if old.is_file() || old.is_dir() => Some(old.permissions()),
        Ok(_) => {
            let message = "neither a file nor a place for one";
            return Err(io(path)(std::io::Error::new(std::io::ErrorKind::InvalidInput, message)));
        }
        Err(_) => None,
    };
    let folder = match target.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".nanite-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // What the umask leaves of it, as for any new file; the default of temporary files is 0600.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let file = builder
        .tempfile_in(way.filter(|way| is_one_disk(way, folder)).unwrap_or(folder))
        .map_err(io(path))?;
    let flattened = rounded.flattened;
    rounded.store(FileSink::new(BufWriter::new(file.as_file()), path))?;
    if let Some(permissions) = old {
        file.as_file().set_permissions(permissions).map_err(io(path))?;
    }
    file.as_file().sync_all().map_err(io(path))?;
    file.persist(&target).map_err(|e| io(path)(e.error))?;
    #[cfg(unix)]
    std::fs::File::open(folder).and_then(|d| d.sync_all()).map_err(io(path))?;
    Ok(flattened)
}
