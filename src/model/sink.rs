//! Page sinks: where the pages of a mesh go that is built or rounded. Memory is one, a file another.

use std::ops::Range;
use std::sync::Arc;

use super::dag::Dag;
use super::page::{PageWords, Pages};
use super::window::WINDOW_PAGES;
use crate::error::Result;

/// A mesh but for the words of its pages.
#[derive(Clone, Debug)]
pub struct Outline {
    /// The mesh; none of its pages is in memory.
    pub mesh: Dag,
    /// For each page the others with clusters that were made from its groups, ascending.
    pub dependencies: Vec<Vec<u32>>,
}

impl Outline {
    /// Has pages made and hands them to a sink, batch by batch: whoever makes them holds no more than that.
    pub fn fill<S: PageSink>(
        self,
        mut sink: S,
        pages: impl Fn(&Dag, Range<usize>) -> Result<Vec<PageWords>>,
    ) -> Result<S::Output> {
        let count = self.mesh.pages.table.len();
        sink.begin(&self)?;
        for start in (0..count).step_by(WINDOW_PAGES) {
            let words = pages(&self.mesh, start..count.min(start + WINDOW_PAGES))?;
            sink.pages(&self, words)?;
        }
        sink.finish(self)
    }
}

/// For each of so many pages the others with clusters that were made from its groups, ascending. `refined` lists, cluster by
/// cluster, the page that holds what each cluster of a page was made from.
pub fn dependencies<I: Iterator<Item = u32>>(pages: usize, refined: impl Fn(usize) -> I) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); pages];
    for page in 0..pages {
        for refined_page in refined(page).map(|page| page as usize).filter(|refined| *refined != page) {
            if let Some(list) = out.get_mut(refined_page)
                && list.last() != Some(&(page as u32))
            {
                list.push(page as u32);
            }
        }
    }
    out
}

/// Takes a mesh page by page, in the order of the layout: coarsest level first, whole groups.
pub trait PageSink {
    /// What becomes of the mesh.
    type Output;

    /// Before the first page: everything else.
    fn begin(&mut self, outline: &Outline) -> Result<()>;

    /// The words of the next pages.
    fn pages(&mut self, outline: &Outline, words: Vec<PageWords>) -> Result<()>;

    /// After the last page.
    fn finish(self, outline: Outline) -> Result<Self::Output>;
}

/// Keeps pages in memory, where they are a mesh.
#[derive(Debug, Default)]
pub struct MemorySink {
    words: Vec<PageWords>,
}

impl PageSink for MemorySink {
    type Output = Dag;

    fn begin(&mut self, outline: &Outline) -> Result<()> {
        self.words.reserve_exact(outline.mesh.pages.table.len());
        Ok(())
    }

    fn pages(&mut self, _: &Outline, mut words: Vec<PageWords>) -> Result<()> {
        self.words.append(&mut words);
        Ok(())
    }

    fn finish(self, Outline { mesh, .. }: Outline) -> Result<Dag> {
        let pages = Pages::new(mesh.pages.table.to_vec(), mesh.layout(), self.words);
        Ok(Dag { pages: Arc::new(pages), ..mesh })
    }
}
