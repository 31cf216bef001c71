//! Where the bytes of a file come from: memory, or a file of which parts are read when they are wanted.
//!
//! Files are read and not mapped: when somebody cuts a mapped file short, the process that looks at it dies; a read fails,
//! which can be told.

use std::borrow::Cow;
use std::fs::File;
use std::path::Path;

use crate::error::{Error, Result};

/// Bytes of which parts are read, from any thread.
pub trait Input: Send + Sync {
    /// Number of bytes.
    fn length(&self) -> u64;
    /// Some of them.
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

impl Input for Vec<u8> {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn read(&self, offset: u64, length: usize) -> std::io::Result<Cow<'_, [u8]>> {
        Ok(Cow::Borrowed(&self[offset as usize..][..length]))
    }
}

/// A file that stays open: what is renamed over it later does not change what is read.
#[derive(Debug)]
pub struct OnDisk {
    file: File,
    length: u64,
}

impl OnDisk {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |source| Error::Io { path: path.to_path_buf(), source };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        Ok(Self { file, length })
    }

    #[cfg(unix)]
    fn read_at(&self, bytes: &mut [u8], offset: u64) -> std::io::Result<usize> {
        std::os::unix::fs::FileExt::read_at(&self.file, bytes, offset)
    }

    #[cfg(windows)]
    fn read_at(&self, bytes: &mut [u8], offset: u64) -> std::io::Result<usize> {
        std::os::windows::fs::FileExt::seek_read(&self.file, bytes, offset)
    }
}

impl Input for OnDisk {
    fn length(&self) -> u64 {
        self.length
    }

    fn read(&self, offset: u64, length: usize) -> std::io::Result<Cow<'_, [u8]>> {
        let mut bytes = vec![0; length];
        let mut done = 0;
        while done < length {
            match self.read_at(&mut bytes[done..], offset + done as u64) {
                Ok(0) => return Err(std::io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => done += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(Cow::Owned(bytes))
    }
}
