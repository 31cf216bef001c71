//! Materials of a mesh as its file has them: a table, and the images that it names, as they were encoded.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use crate::error::Result;

type Read = Box<dyn Fn() -> Result<Vec<u8>> + Send + Sync>;

/// What surfaces look like. Nothing here looks into it: `docs/format.md` specifies it, for those who draw.
#[derive(Clone, Debug, Default)]
pub struct Materials {
    /// JSON; empty where nothing is said.
    pub table: Arc<str>,
    /// The images, in the order of the table.
    pub images: Vec<Blob>,
}

/// Meshes are compared by what they are, not by how they look.
impl PartialEq for Materials {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Bytes that are in memory, or are read whenever somebody asks for them. Copies are the same bytes.
#[derive(Clone)]
pub struct Blob(Arc<Place>);

enum Place {
    Memory(Vec<u8>),
    File { count: u64, read: Read },
}

impl Blob {
    /// So many bytes that `read` brings.
    pub fn stored(count: u64, read: impl Fn() -> Result<Vec<u8>> + Send + Sync + 'static) -> Self {
        Self(Arc::new(Place::File { count, read: Box::new(read) }))
    }

    /// Their number.
    pub fn count(&self) -> u64 {
        match &*self.0 {
            Place::Memory(bytes) => bytes.len() as u64,
            Place::File { count, .. } => *count,
        }
    }

    /// The bytes; those of a file are read again each time.
    pub fn read(&self) -> Result<Cow<'_, [u8]>> {
        match &*self.0 {
            Place::Memory(bytes) => Ok(bytes.into()),
            Place::File { read, .. } => read().map(Cow::Owned),
        }
    }
}

impl From<Vec<u8>> for Blob {
    fn from(bytes: Vec<u8>) -> Self {
        Self(Arc::new(Place::Memory(bytes)))
    }
}

impl fmt::Debug for Blob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Blob({} bytes)", self.count())
    }
}
