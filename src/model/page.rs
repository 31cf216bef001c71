//! Pages: the unit of storage and of streaming. A page is words: the records of its clusters, then their streams. Pages
//! hold whole groups, coarsest level first: a small root page the coarsest of all levels, each other page those of one.

use std::fmt;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::cluster::{AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord, RECORD_WORDS};
use super::packing::{PACKING_WORDS, Packing};
use super::reading::{InterruptCheck, read_pages};
use super::source::PageSource;
use crate::error::Result;

/// The words of a page, shared by all who look at it.
pub type PageWords = Arc<[u32]>;

/// What is known of a page whether or not its words are there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PageEntry {
    /// Number of words.
    pub words: u32,
    /// Number of clusters.
    pub clusters: u32,
    /// Clusters in all pages before this one.
    pub first_cluster: u32,
    /// Level of its first group, and of all others but those of a root page; a cluster that could not be simplified comes
    /// again at the next.
    pub level: u32,
    /// Triangles of the source: those of its clusters that were never simplified, at whatever level these are grouped.
    pub faces: u32,
    /// Triangles of the source in all pages before this one.
    pub first_face: u32,
}

impl PageEntry {
    /// The entry of a page behind this one.
    #[must_use]
    pub fn next(&self, words: u32, clusters: u32, level: u32, faces: u32) -> Self {
        Self {
            words,
            clusters,
            first_cluster: self.first_cluster.saturating_add(self.clusters),
            level,
            faces,
            first_face: self.first_face.saturating_add(self.faces),
        }
    }
}

/// Pages of a mesh: all of them, or those that are in memory.
#[derive(Clone, Default)]
pub struct Pages {
    /// One entry per page.
    pub table: Arc<[PageEntry]>,
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    words: Vec<OnceLock<PageWords>>,
    source: Option<Arc<dyn PageSource>>,
    /// Set once all are in memory.
    whole: OnceLock<()>,
}

impl Pages {
    /// Pages that are all in memory.
    pub fn new(table: Vec<PageEntry>, layout: AttributeLayout, words: Vec<PageWords>) -> Self {
        debug_assert_eq!(table.len(), words.len());
        Self {
            table: table.into(),
            layout,
            words: words.into_iter().map(OnceLock::from).collect(),
            ..Self::default()
        }
    }

    /// Pages of which none is in memory, and none comes by itself.
    pub fn absent(table: Arc<[PageEntry]>, layout: AttributeLayout) -> Self {
        let words = vec![OnceLock::new(); table.len()];
        Self { table, layout, words, ..Self::default() }
    }

    /// Pages that stay where they are until [`Pages::load`] asks for them.
    pub fn stored(table: Vec<PageEntry>, layout: AttributeLayout, source: Arc<dyn PageSource>) -> Self {
        Self { source: Some(source), ..Self::absent(table.into(), layout) }
    }

    /// Puts the words of a page in their place, or takes them out of it.
    pub fn set(&mut self, page: usize, words: Option<PageWords>) {
        self.words[page] = words.map(OnceLock::from).unwrap_or_default();
    }

    /// Reads those of `pages` that are not in memory, in parallel; they then stay.
    pub fn load(&self, pages: impl Iterator<Item = usize>, proceed: InterruptCheck<'_>) -> Result<()> {
        let Some(source) = &self.source else { return Ok(()) };
        let absent = pages.filter(|page| !self.holds(*page)).collect();
        // Another thread may have been faster, with the same words.
        read_pages(source, absent, proceed, |page, words| drop(self.words[page].set(words)))
    }

    /// Reads all that is not in memory.
    pub fn load_all(&self, proceed: InterruptCheck<'_>) -> Result<()> {
        if self.whole.get().is_none() {
            self.load(0..self.table.len(), proceed)?;
            self.whole.get_or_init(|| ());
        }
        Ok(())
    }

    /// The same pages, all of them in memory and without a source.
    pub fn in_memory(self: &Arc<Self>) -> Arc<Self> {
        if self.source.is_none() {
            Arc::clone(self)
        } else {
            Arc::new(Self { source: None, ..(**self).clone() })
        }
    }

    /// Where pages come from, if not all were in memory from the start.
    pub fn source(&self) -> Option<&Arc<dyn PageSource>> {
        self.source.as_ref()
    }

    /// Whether the words of a page are in memory.
    #[inline]
    pub fn holds(&self, page: usize) -> bool {
        self.words.get(page).is_some_and(|words| words.get().is_some())
    }

    /// Words of all pages together, in memory or not.
    pub fn word_count(&self) -> u64 {
        self.table.iter().map(|entry| u64::from(entry.words)).sum()
    }

    /// Words of the pages that are in memory.
    pub fn words_held(&self) -> u64 {
        let held = self.table.iter().enumerate().filter(|(page, _)| self.holds(*page));
        held.map(|(_, entry)| u64::from(entry.words)).sum()
    }

    /// Number of clusters in all pages.
    pub fn cluster_count(&self) -> usize {
        self.table.last().map_or(0, |p| (p.first_cluster + p.clusters) as usize)
    }

    /// The words of a page; none where it is not in memory.
    #[inline]
    pub fn page(&self, page: usize) -> &[u32] {
        self.words[page].get().map_or(&[], |words| words)
    }

    /// The same, shared.
    pub fn words(&self, page: usize) -> Option<&PageWords> {
        self.words[page].get()
    }

    /// The records of a page, by slot.
    #[inline]
    pub fn records(&self, page: usize) -> &[ClusterRecord] {
        self.records_of(page, self.page(page))
    }

    /// The records among the words of a page.
    #[inline]
    pub fn records_of<'w>(&self, page: usize, words: &'w [u32]) -> &'w [ClusterRecord] {
        bytemuck::cast_slice(&words[..self.table[page].clusters as usize * RECORD_WORDS])
    }

    /// One record.
    #[inline]
    pub fn record(&self, at: ClusterAddress) -> &ClusterRecord {
        &self.records(at.page())[at.slot()]
    }

    /// The streams of one cluster.
    pub fn geometry(&self, at: ClusterAddress) -> ClusterGeometry<'_> {
        self.geometry_of(at, self.page(at.page()))
    }

    /// The same from the words of its page.
    pub fn geometry_of<'w>(&self, at: ClusterAddress, words: &'w [u32]) -> ClusterGeometry<'w> {
        let record = &self.records_of(at.page(), words)[at.slot()];
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        ClusterGeometry::new(&words[record.data as usize..], self.layout, vertices, triangles)
    }

    /// A dense number for a cluster, `0..cluster_count()`, in page order.
    pub fn dense_index(&self, at: ClusterAddress) -> usize {
        self.table[at.page()].first_cluster as usize + at.slot()
    }

    /// Triangles of the source before those of a cluster that was never simplified.
    pub fn first_face(&self, at: ClusterAddress) -> usize {
        let before = &self.records(at.page())[..at.slot()];
        let source = before.iter().filter(|record| record.level == 0);
        let faces: usize = source.map(|record| usize::from(record.triangle_count)).sum();
        self.table[at.page()].first_face as usize + faces
    }

    /// All addresses in page order.
    pub fn addresses(&self) -> impl Iterator<Item = ClusterAddress> + '_ {
        self.table
            .iter()
            .enumerate()
            .flat_map(|(p, e)| (0..e.clusters as usize).map(move |s| ClusterAddress::new(p, s)))
    }
}

/// Where in the words of a page lies what depends on where vertices are: records, and of each cluster positions and normals.
pub fn shape_ranges(
    words: &[u32],
    layout: AttributeLayout,
    clusters: usize,
) -> impl Iterator<Item = Range<usize>> {
    let records: &[ClusterRecord] = bytemuck::cast_slice(&words[..clusters * RECORD_WORDS]);
    let of_cluster = move |record: &ClusterRecord| {
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        let data = record.data as usize;
        let head = bytemuck::cast_slice(&words[data..][..PACKING_WORDS]);
        let packing: Packing = bytemuck::pod_read_unaligned(head);
        let streams = layout.streams(vertices, triangles, packing.widths);
        [data + PACKING_WORDS..data + streams.ids, data + streams.normals..data + streams.colors]
    };
    std::iter::once(0..clusters * RECORD_WORDS).chain(records.iter().flat_map(of_cluster))
}

impl fmt::Debug for Pages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let held = (0..self.table.len()).filter(|page| self.holds(*page)).count();
        write!(f, "Pages({held} of {} in memory)", self.table.len())
    }
}

/// Of what is in memory.
impl PartialEq for Pages {
    fn eq(&self, other: &Self) -> bool {
        self.table == other.table
            && self.layout == other.layout
            && (0..self.table.len()).into_par_iter().all(|page| self.page(page) == other.page(page))
    }
}
