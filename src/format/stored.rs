//! A mesh whose pages, channels and face ids stay in their file: each is read and checked when it is wanted.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::decode::{Head, WordSection, front, io};
use super::input::{Input, OnDisk, RangeRequest, read_now};
use super::page_decode::Decoder;
use crate::error::Result;
use crate::model::{Answer, Dag, PageRequest, PageSource, PageWords, Pages, Traffic, Words, Workers};
use crate::threads::Lock;

/// Ranges of a channel or of the face ids that are read as a batch.
const WORDS_BATCH: usize = 16;

/// The pages of an open file.
pub struct Stored {
    input: Arc<dyn Input>,
    coded: Arc<Coded>,
}

/// What decodes them.
struct Coded {
    name: Arc<str>,
    head: Head,
    /// Those that no thread uses.
    decoders: Lock<Vec<Decoder>>,
}

impl Coded {
    fn decode(&self, page: usize, bytes: &[u8]) -> Result<PageWords> {
        let free = || self.decoders.write("the file of the mesh");
        let known = free()?.pop();
        let mut decoder = known.map_or_else(Decoder::new, Ok)?;
        let words = self.head.page(&self.name, page, bytes, &mut decoder);
        free()?.push(decoder);
        words
    }
}

impl fmt::Debug for Stored {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Stored({:?}, {} pages)", self.coded.name, self.coded.head.rows.len())
    }
}

impl PageSource for Stored {
    fn read(&self, batch: Vec<PageRequest>, workers: &Workers) {
        let range = |PageRequest { page, answer }: PageRequest| {
            let (coded, workers) = (Arc::clone(&self.coded), workers.clone());
            let cancelled = answer.cancelled().clone();
            let take = move |bytes: Option<std::io::Result<Vec<u8>>>| {
                // Who answers may be the one thread of a network.
                let Some(bytes) = bytes else { return };
                workers.first(move || {
                    let bytes = bytes.map_err(io(&coded.name));
                    answer.send(bytes.and_then(|bytes| coded.decode(page, &bytes)));
                });
            };
            RangeRequest {
                range: self.coded.head.place(page),
                answer: Answer::new(take).cancelled_by(&cancelled),
            }
        };
        self.input.read(batch.into_iter().map(range).collect(), workers);
    }

    fn batch_size(&self) -> usize {
        self.input.batch_size()
    }

    fn tries(&self) -> u32 {
        self.input.tries()
    }

    fn traffic(&self) -> Traffic {
        self.input.traffic()
    }

    fn dependencies(&self, page: usize) -> &[u32] {
        self.coded.head.dependencies.of(page)
    }
}

/// Reads and checks the words of a section.
fn words(input: &dyn Input, name: &str, section: &WordSection) -> Result<Vec<u32>> {
    let ranges = section.ranges();
    let parts = ranges.chunks(WORDS_BATCH).flat_map(|batch| match read_now(input, batch) {
        Ok(parts) => parts.into_iter().map(Ok).collect(),
        Err(error) => vec![Err(io(name)(error))],
    });
    section.words(name, parts)
}

/// Opens a mesh whose pages, channels and face ids are read when they are wanted; `name` appears in error messages.
/// Nothing in the file is trusted: see [`super::validate`].
pub fn open_input(input: Box<dyn Input>, name: &str) -> Result<Dag> {
    let (input, name): (Arc<dyn Input>, Arc<str>) = (input.into(), name.into());
    let stored = |section: WordSection| {
        let (input, name) = (Arc::clone(&input), Arc::clone(&name));
        Ok(Words::stored(section.count(), move || words(&*input, &name, &section)))
    };
    let (dag, head) = front(&*input, &name, stored)?;
    let (table, layout) = (head.entries(), head.metadata.layout);
    let source = Stored { input, coded: Arc::new(Coded { name, head, decoders: Lock::new(Vec::new()) }) };
    Ok(Dag { pages: Arc::new(Pages::stored(table, layout, Arc::new(source))), ..dag })
}

/// Opens a file: of pages, channels and face ids none is read.
pub fn open(path: &Path) -> Result<Dag> {
    open_input(Box::new(OnDisk::open(path)?), &path.display().to_string())
}
