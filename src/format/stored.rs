//! A mesh whose pages, channels and face ids stay in their file: each is read and checked when it is wanted, on any thread.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::decode::{Container, Head, Source, WordSection};
use super::input::{Input, OnDisk};
use super::page_decode::Decoder;
use crate::error::Result;
use crate::model::{Dag, PageSource, PageWords, Pages, Words};
use crate::threads::Lock;

/// The pages of an open file.
pub struct Stored {
    input: Arc<dyn Input>,
    name: Arc<str>,
    head: Head,
    /// Those that no thread uses.
    decoders: Lock<Vec<Decoder>>,
}

impl fmt::Debug for Stored {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Stored({:?}, {} pages)", self.name, self.head.rows.len())
    }
}

impl PageSource for Stored {
    fn read(&self, page: usize) -> Result<PageWords> {
        let free = || self.decoders.write("the file of the mesh");
        let known = free()?.pop();
        let mut decoder = known.map_or_else(Decoder::new, Ok)?;
        let source = Source::new(&*self.input, &self.name);
        let words = self.head.page(&source, page, &mut decoder);
        free()?.push(decoder);
        words
    }

    fn dependencies(&self, page: usize) -> &[u32] {
        self.head.dependencies.of(page)
    }
}

/// Opens a mesh whose pages, channels and face ids are read when they are wanted; `name` appears in error messages.
/// Nothing in the file is trusted: see [`super::validate`].
pub fn open_input(input: Box<dyn Input>, name: &str) -> Result<Dag> {
    let (input, name): (Arc<dyn Input>, Arc<str>) = (input.into(), name.into());
    let stored = |section: WordSection| {
        let (input, name) = (Arc::clone(&input), Arc::clone(&name));
        Ok(Words::stored(section.count(), move || section.read(&Source::new(&*input, &name))))
    };
    let (dag, head) = Container::new(&*input, &name)?.dag(stored)?;
    let (table, layout) = (head.entries(), head.metadata.layout);
    let source = Stored { input, name, head, decoders: Lock::new(Vec::new()) };
    Ok(Dag { pages: Arc::new(Pages::stored(table, layout, Arc::new(source))), ..dag })
}

/// Opens a file: of pages, channels and face ids none is read.
pub fn open(path: &Path) -> Result<Dag> {
    open_input(Box::new(OnDisk::open(path)?), &path.display().to_string())
}
