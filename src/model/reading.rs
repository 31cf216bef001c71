//! Reading pages on threads of their own, so that waiting for a disk can be interrupted.

use std::sync::Arc;
use std::time::Duration;

use super::loader::{Arrival, LoadRequest, Loader};
use super::page::PageWords;
use super::retry::{Clock, Retry};
use super::source::PageSource;
use crate::error::Result;

/// The interrupt check: whoever waits for a disk calls it some twenty times a second. It returns whether to proceed. If not,
/// they return [`crate::Error::Cancelled`] at once, however long the disk takes.
pub type InterruptCheck<'a> = &'a dyn Fn() -> bool;

/// Never interrupts.
pub const UNINTERRUPTED: InterruptCheck<'static> = &|| true;

/// How long somebody waits between two checks.
pub const INTERRUPT_INTERVAL: Duration = Duration::from_millis(50);

/// Reads pages, and hands each over on this thread, in any order.
pub fn read_pages(
    source: &Arc<dyn PageSource>,
    pages: Vec<usize>,
    proceed: InterruptCheck<'_>,
    mut take: impl FnMut(usize, PageWords),
) -> Result<()> {
    let count = pages.len();
    let mut loader = Loader::new(count.min(rayon::current_num_threads()), Clock::default());
    let request = |page| LoadRequest { source: Arc::clone(source), page, tag: (), retry: Retry::default() };
    loader.submit(pages.into_iter().map(request).collect())?;
    for _ in 0..count {
        let Arrival { request, words } = loader.wait(proceed)?;
        take(request.page, words?);
    }
    Ok(())
}
