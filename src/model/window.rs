//! Windows: pages that somebody looks at for a while, and does not keep.

use rustc_hash::FxHashMap;

use super::cluster::{ClusterAddress, ClusterGeometry, ClusterRecord};
use super::page::{PageWords, Pages};
use super::reading::{InterruptCheck, read_pages};
use crate::error::Result;

/// Pages of a window: work for many threads, of 32 MiB at most.
pub const WINDOW_PAGES: usize = 256;

/// Some pages of a mesh, all in memory for as long as somebody looks at them.
#[derive(Debug)]
pub struct Window<'a> {
    pages: &'a Pages,
    words: FxHashMap<usize, PageWords>,
}

impl Pages {
    /// Reads those of some pages that are not in memory, in parallel; they do not stay.
    pub fn window(
        &self,
        pages: impl Iterator<Item = usize>,
        proceed: InterruptCheck<'_>,
    ) -> Result<Window<'_>> {
        let mut words = FxHashMap::default();
        let mut absent = Vec::new();
        for page in pages {
            match self.words(page) {
                Some(known) => drop(words.insert(page, PageWords::clone(known))),
                None => absent.push(page),
            }
        }
        absent.sort_unstable();
        absent.dedup();
        if let Some(source) = self.source() {
            read_pages(source, absent, proceed, |page, read| drop(words.insert(page, read)))?;
        }
        Ok(Window { pages: self, words })
    }
}

impl Window<'_> {
    /// The words of a page; none where it is not in the window.
    pub fn page(&self, page: usize) -> &[u32] {
        self.words.get(&page).map_or(&[], |words| words)
    }

    /// The same, shared.
    pub fn words(&self, page: usize) -> PageWords {
        self.words.get(&page).cloned().unwrap_or_default()
    }

    /// The records of a page, by slot.
    pub fn records(&self, page: usize) -> &[ClusterRecord] {
        self.pages.records_of(page, self.page(page))
    }

    /// One record.
    pub fn record(&self, at: ClusterAddress) -> &ClusterRecord {
        &self.records(at.page())[at.slot()]
    }

    /// The streams of one cluster.
    pub fn geometry(&self, at: ClusterAddress) -> ClusterGeometry<'_> {
        self.pages.geometry_of(at, self.page(at.page()))
    }
}
