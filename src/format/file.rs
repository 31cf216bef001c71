//! Files: constants of the container, reading, and atomic writing.

use std::io::Write;
use std::path::Path;

use super::{from_bytes, to_bytes};
use crate::error::{Error, Result};
use crate::model::Dag;

/// First bytes of a file. The high bit and the line ends catch transfers that are not binary-safe.
pub const MAGIC: [u8; 8] = *b"\x89NANITE\n";
/// Version of the layout. Readers refuse any other.
pub const VERSION: u32 = 2;
/// Bytes before the section table.
pub const HEADER_BYTES: usize = 24;
/// Bytes of an entry of the section table.
pub const ENTRY_BYTES: usize = 32;
/// Boundary that sections start on.
pub const ALIGNMENT: usize = 64;

/// What a section holds. Every kind occurs exactly once, but for `FaceIds` and `Channels`, which may be absent.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// JSON for people and for what is small: frame, layout, counts, build report.
    Metadata = 1,
    /// [`crate::model::Group`] records.
    Groups = 2,
    /// [`crate::model::Node`] records.
    Nodes = 3,
    /// [`crate::model::PageEntry`] records.
    PageTable = 4,
    /// The words of all pages.
    Pages = 5,
    /// Rows of the caller's faces, one u32 per level-0 triangle.
    FaceIds = 6,
    /// The words of all channels, one channel after the other, a row for each vertex identity.
    Channels = 7,
}

impl Kind {
    /// All kinds, in file order.
    pub const ALL: [Self; 7] = [
        Self::Metadata,
        Self::Groups,
        Self::Nodes,
        Self::PageTable,
        Self::Pages,
        Self::FaceIds,
        Self::Channels,
    ];
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> Error + '_ {
    |source| Error::Io { path: path.to_path_buf(), source }
}

/// Writes a mesh: to a temporary file beside the target, synced, then renamed over it. Whatever happens, the
/// target is the old file or the new one, whole.
pub fn save(dag: &Dag, path: &Path) -> Result<()> {
    let folder = match path.parent() {
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
    let mut file = builder.tempfile_in(folder).map_err(io(path))?;
    file.write_all(&to_bytes(dag)).map_err(io(path))?;
    file.as_file().sync_all().map_err(io(path))?;
    file.persist(path).map_err(|e| io(path)(e.error))?;
    #[cfg(unix)]
    std::fs::File::open(folder).and_then(|d| d.sync_all()).map_err(io(path))?;
    Ok(())
}

/// Reads a mesh. Nothing in the file is trusted: see [`super::validate`].
pub fn open(path: &Path) -> Result<Dag> {
    let bytes = std::fs::read(path).map_err(io(path))?;
    from_bytes(&bytes, &path.display().to_string())
}
