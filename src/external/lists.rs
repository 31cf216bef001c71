//! Lists of words on disk, one for each block: short appends are gathered, so that few files are open at once.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Words that a list gathers before they are written.
const GATHERED: usize = 1 << 13;

/// A list for each block. Any thread may append; the order of what several append is theirs.
#[derive(Debug)]
pub struct Lists {
    folder: PathBuf,
    name: &'static str,
    gathered: Vec<Mutex<Vec<u32>>>,
}

impl Lists {
    /// Empty lists for so many blocks in a folder.
    pub fn new(folder: &Path, name: &'static str, blocks: usize) -> Self {
        let gathered = (0..blocks).map(|_| Mutex::default()).collect();
        Self { folder: folder.to_path_buf(), name, gathered }
    }

    /// Appends words to the list of a block.
    pub fn append(&self, block: usize, words: &[u32]) -> Result<()> {
        let mut gathered = self.gathered[block].lock().unwrap_or_else(PoisonError::into_inner);
        gathered.extend_from_slice(words);
        if gathered.len() < GATHERED {
            return Ok(());
        }
        self.write(block, &mut gathered)
    }

    fn write(&self, block: usize, words: &mut Vec<u32>) -> Result<()> {
        let path = path(&self.folder, self.name, block);
        let file = OpenOptions::new().create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(bytemuck::cast_slice(words)));
        words.clear();
        written.map_err(|source| Error::Io { path, source })
    }

    /// Writes what was gathered: from here on files hold all.
    pub fn finish(&self) -> Result<()> {
        for (block, gathered) in self.gathered.iter().enumerate() {
            let mut gathered = gathered.lock().unwrap_or_else(PoisonError::into_inner);
            if !gathered.is_empty() {
                self.write(block, &mut gathered)?;
            }
        }
        Ok(())
    }
}

/// Where the finished list of a block lies; nowhere where it is empty.
pub fn path(folder: &Path, name: &str, block: usize) -> PathBuf {
    folder.join(format!("{name}-{block:06}"))
}

/// The finished list of a block: all words; none where there is no file.
pub fn read(folder: &Path, name: &str, block: usize) -> Result<Vec<u32>> {
    Ok(words_of(&path(folder, name, block))?.unwrap_or_default())
}

/// The words of a file; nothing where there is none.
pub fn words_of(path: &Path) -> Result<Option<Vec<u32>>> {
    let read = || -> std::io::Result<_> {
        let mut file = File::open(path)?;
        let mut words = vec![0u32; file.metadata()?.len() as usize / size_of::<u32>()];
        file.read_exact(bytemuck::cast_slice_mut(&mut words))?;
        Ok(words)
    };
    match read() {
        Ok(words) => Ok(Some(words)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(Error::Io { path: path.to_path_buf(), source }),
    }
}

/// A file that takes its name when it is whole, or is gone: of several that write the same at once, as where a worker that was
/// given up lives on, each has its own until then.
#[derive(Debug)]
pub struct Aside {
    path: PathBuf,
    file: NamedTempFile,
}

impl Aside {
    /// A file that becomes the one of this path.
    pub fn create(path: &Path) -> Result<Self> {
        let mut builder = tempfile::Builder::new();
        builder.suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // What the umask leaves of it, as for any new file: others may go on with what is here.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let folder = path.parent().unwrap_or(Path::new("."));
        let file = builder.tempfile_in(folder).map_err(|source| Error::Io { path: path.into(), source })?;
        Ok(Self { path: path.into(), file })
    }

    /// The file.
    pub fn file(&self) -> &File {
        self.file.as_file()
    }

    /// Gives it its name.
    pub fn finish(self) -> Result<()> {
        let Self { path, file } = self;
        let named = file.as_file().sync_all().and_then(|()| Ok(file.persist(&path)?));
        named.map(drop).map_err(|source| Error::Io { path, source })
    }
}

/// Writes a file in one step or not at all.
pub fn write_whole(path: &Path, parts: &[&[u8]]) -> Result<()> {
    let aside = Aside::create(path)?;
    let written = parts.iter().try_for_each(|part| aside.file().write_all(part));
    written.map_err(|source| Error::Io { path: path.into(), source })?;
    aside.finish()
}
