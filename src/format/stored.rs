//! A mesh whose pages, channels, face ids and images stay in their file: each is read and checked when it is wanted.

use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use super::decode::{Head, LateSection, WordSection, front, io};
use super::input::{Input, OnDisk, RangeRequest, read_now};
use super::page_decode::Decoder;
use crate::error::Result;
use crate::model::{Answer, Blob, Dag, PageRequest, PageSource, PageWords, Pages, Traffic, Words, Workers};
use crate::threads::Lock;

/// Ranges of a section that are read as a batch.
const BATCH: usize = 16;

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

/// The bytes of a section, a range after the other.
fn parts(input: &dyn Input, name: &str, section: &LateSection) -> impl Iterator<Item = Result<Vec<u8>>> {
    let ranges = section.ranges();
    let batches: Vec<Vec<Range<u64>>> = ranges.chunks(BATCH).map(<[_]>::to_vec).collect();
    batches.into_iter().flat_map(move |batch| match read_now(input, &batch) {
        Ok(parts) => parts.into_iter().map(Ok).collect(),
        Err(error) => vec![Err(io(name)(error))],
    })
}

/// Opens a mesh whose pages, channels, face ids and images are read when they are wanted; `name` appears in error messages.
/// Nothing in the file is trusted: see [`super::validate`].
pub fn open_input(input: Box<dyn Input>, name: &str) -> Result<Dag> {
    let (input, name): (Arc<dyn Input>, Arc<str>) = (input.into(), name.into());
    let words = |section: WordSection| {
        let (input, name) = (Arc::clone(&input), Arc::clone(&name));
        let count = section.count();
        let read = move || section.words(&name, parts(&*input, &name, &section.late));
        Ok(Words::stored(count, read))
    };
    let blob = |section: LateSection| {
        let (input, name) = (Arc::clone(&input), Arc::clone(&name));
        Ok(Blob::stored(section.count(), move || section.read(&name, parts(&*input, &name, &section))))
    };
    let (dag, head) = front(&*input, &name, words, blob)?;
    let (table, layout) = (head.entries(), head.metadata.layout);
    let source = Stored { input, coded: Arc::new(Coded { name, head, decoders: Lock::new(Vec::new()) }) };
    Ok(Dag { pages: Arc::new(Pages::stored(table, layout, Arc::new(source))), ..dag })
}

/// Opens a file: of pages, channels, face ids and images none is read.
pub fn open(path: &Path) -> Result<Dag> {
    open_input(Box::new(OnDisk::open(path)?), &path.display().to_string())
}
