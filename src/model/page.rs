//! Pages: the unit of storage and, later, of streaming. A page is words: the records of its clusters, then
//! their streams. Pages hold whole groups of one level, coarsest level first.

use bytemuck::{Pod, Zeroable};

use super::cluster::{AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord, RECORD_WORDS};

/// Where a page lies among all words.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PageEntry {
    /// First word.
    pub offset: u64,
    /// Number of words.
    pub words: u32,
    /// Number of clusters.
    pub clusters: u32,
    /// Clusters in all pages before this one.
    pub first_cluster: u32,
    /// Level of every cluster of the page.
    pub level: u32,
}

/// All pages of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pages {
    /// The words of all pages, one after the other.
    pub words: Vec<u32>,
    /// One entry per page.
    pub table: Vec<PageEntry>,
    /// Streams of every cluster.
    pub layout: AttributeLayout,
}

impl Pages {
    /// Number of clusters in all pages.
    pub fn cluster_count(&self) -> usize {
        self.table.last().map_or(0, |p| (p.first_cluster + p.clusters) as usize)
    }

    /// The words of a page.
    pub fn page(&self, page: usize) -> &[u32] {
        let entry = &self.table[page];
        &self.words[entry.offset as usize..][..entry.words as usize]
    }

    /// The records of a page, by slot.
    pub fn records(&self, page: usize) -> &[ClusterRecord] {
        let words = self.page(page);
        bytemuck::cast_slice(&words[..self.table[page].clusters as usize * RECORD_WORDS])
    }

    /// One record.
    pub fn record(&self, at: ClusterAddress) -> &ClusterRecord {
        &self.records(at.page())[at.slot()]
    }

    /// The streams of one cluster.
    pub fn geometry(&self, at: ClusterAddress) -> ClusterGeometry<'_> {
        let record = self.record(at);
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        let words = &self.page(at.page())[record.data as usize..];
        ClusterGeometry::new(
            &words[..self.layout.cluster_words(vertices, triangles)],
            self.layout,
            vertices,
            triangles,
        )
    }

    /// A dense number for a cluster, `0..cluster_count()`, in page order.
    pub fn dense_index(&self, at: ClusterAddress) -> usize {
        self.table[at.page()].first_cluster as usize + at.slot()
    }

    /// All addresses in page order.
    pub fn addresses(&self) -> impl Iterator<Item = ClusterAddress> + '_ {
        self.table
            .iter()
            .enumerate()
            .flat_map(|(p, e)| (0..e.clusters as usize).map(move |s| ClusterAddress::new(p, s)))
    }
}
