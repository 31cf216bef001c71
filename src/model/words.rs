//! Words beside the pages: those of a channel, or the rows of the caller's faces.

use std::fmt;
use std::sync::{Arc, OnceLock};

use crate::error::Result;
use crate::threads::Lock;

type Read = Box<dyn Fn() -> Result<Vec<u32>> + Send + Sync>;

/// Words that are in memory, or stay where they are until somebody asks for them. Copies are the same words.
#[derive(Clone)]
pub struct Words(Arc<Shared>);

struct Shared {
    count: usize,
    held: OnceLock<Vec<u32>>,
    /// Where they come from, until they are in memory.
    read: Lock<Option<Read>>,
}

impl Words {
    /// So many words that `read` brings when [`Words::load`] asks for them; it runs on one thread.
    pub fn stored(count: usize, read: impl Fn() -> Result<Vec<u32>> + Send + Sync + 'static) -> Self {
        let read = Lock::new(Some(Box::new(read) as Read));
        Self(Arc::new(Shared { count, held: OnceLock::new(), read }))
    }

    /// Their number, in memory or not.
    pub fn count(&self) -> usize {
        self.0.count
    }

    /// The words, in memory from now on. Of several threads one reads and the others wait for it.
    pub fn load(&self) -> Result<&[u32]> {
        if self.0.held.get().is_none() {
            let mut read = self.0.read.write("the file of the mesh")?;
            if let Some(words) = read.as_ref().map(|read| read()).transpose()? {
                self.0.held.get_or_init(|| words);
                *read = None;
            }
        }
        Ok(self.held())
    }

    /// The words; none where they are not in memory.
    pub fn held(&self) -> &[u32] {
        self.0.held.get().map_or(&[], Vec::as_slice)
    }
}

impl From<Vec<u32>> for Words {
    fn from(words: Vec<u32>) -> Self {
        Self(Arc::new(Shared { count: words.len(), held: words.into(), read: Lock::new(None) }))
    }
}

impl fmt::Debug for Words {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Words({} of {} in memory)", self.held().len(), self.count())
    }
}

/// Of what is in memory.
impl PartialEq for Words {
    fn eq(&self, other: &Self) -> bool {
        self.count() == other.count() && self.held() == other.held()
    }
}
