//! Lists of words on disk, one for each block: short appends are gathered, so that few files are open at once.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

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

    fn path(&self, block: usize) -> PathBuf {
        self.folder.join(format!("{}-{block:06}", self.name))
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
        let path = self.path(block);
        let file = OpenOptions::new().create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(bytemuck::cast_slice(words)));
        words.clear();
        written.map_err(|source| Error::Io { path, source })
    }

    /// All words of a block.
    pub fn read(&self, block: usize) -> Result<Vec<u32>> {
        let mut gathered = self.gathered[block].lock().unwrap_or_else(PoisonError::into_inner);
        let path = self.path(block);
        if !path.exists() {
            return Ok(gathered.clone());
        }
        if !gathered.is_empty() {
            self.write(block, &mut gathered)?;
        }
        let read = |path: &Path| {
            let mut file = File::open(path)?;
            let mut words = vec![0u32; file.metadata()?.len() as usize / size_of::<u32>()];
            file.read_exact(bytemuck::cast_slice_mut(&mut words))?;
            Ok(words)
        };
        read(&path).map_err(|source| Error::Io { path, source })
    }
}
