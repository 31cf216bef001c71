//! Page sources: where pages come from that are not in memory.

use std::fmt;

use super::page::PageWords;
use super::workers::Workers;
use crate::error::Result;

/// What takes one answer, once. Dropped without one, as by a panic, it says so: whoever waits for it does not wait for ever.
pub struct Answer<T>(Option<Box<dyn FnOnce(Option<T>) + Send>>);

impl<T> Answer<T> {
    /// `take` gets the answer, or nothing where there will be none. It does not wait.
    pub fn new(take: impl FnOnce(Option<T>) + Send + 'static) -> Self {
        Self(Some(Box::new(take)))
    }

    /// Gives the answer.
    pub fn send(mut self, answer: T) {
        if let Some(take) = self.0.take() {
            take(Some(answer));
        }
    }
}

impl<T> Drop for Answer<T> {
    fn drop(&mut self) {
        if let Some(take) = self.0.take() {
            take(None);
        }
    }
}

/// A page that somebody wants.
pub struct PageRequest {
    /// Which.
    pub page: usize,
    /// What takes its words, checked.
    pub answer: Answer<Result<PageWords>>,
}

/// Where pages come from that are not in memory.
pub trait PageSource: fmt::Debug + Send + Sync {
    /// Reads a batch of pages, the most wanted first, and returns before they are there. Each is answered by itself: in any
    /// order, from any thread. What blocks or computes runs on `workers`, the threads of who asks.
    fn read(&self, batch: Vec<PageRequest>, workers: &Workers);

    /// How many pages it wants to be asked for at once, where that is more than there are workers: what is far away answers
    /// many as fast as one.
    fn batch_size(&self) -> usize {
        1
    }

    /// The other pages with clusters that were made from the groups of a page, ascending, all before it.
    fn dependencies(&self, page: usize) -> &[u32];
}
