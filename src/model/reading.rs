//! Reading pages on threads of their own, so that waiting for a disk can be interrupted.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use super::page::{PageSource, PageWords};
use crate::error::{Error, Result};

/// The interrupt check: whoever waits for a disk calls it some twenty times a second. It returns whether to proceed. If not,
/// they return [`Error::Cancelled`] at once, however long the disk takes.
pub type InterruptCheck<'a> = &'a dyn Fn() -> bool;

/// Never interrupts.
pub const UNINTERRUPTED: InterruptCheck<'static> = &|| true;

/// How long somebody waits between two checks.
pub const INTERRUPT_INTERVAL: Duration = Duration::from_millis(50);

/// What comes next from other threads; nothing where they have ended.
pub fn wait_for<T>(receiver: &Receiver<T>, proceed: InterruptCheck<'_>) -> Result<Option<T>> {
    while proceed() {
        match receiver.recv_timeout(INTERRUPT_INTERVAL) {
            Ok(next) => return Ok(Some(next)),
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
    Err(Error::Cancelled)
}

/// Reads a page; a panic is an error like others.
pub fn read_page(source: &dyn PageSource, page: usize) -> Result<PageWords> {
    let outcome = catch_unwind(AssertUnwindSafe(|| source.read(page)));
    outcome.unwrap_or_else(|_| Err(Error::Invariant(format!("reading page {page} panicked"))))
}

/// Reads pages on threads of their own, and hands each over on this one, in any order. Where this one goes, they end with
/// the page that they are at.
pub fn read_pages(
    source: &Arc<dyn PageSource>,
    pages: Vec<usize>,
    proceed: InterruptCheck<'_>,
    mut take: impl FnMut(usize, PageWords),
) -> Result<()> {
    let (count, pages, next) = (pages.len(), Arc::new(pages), Arc::new(AtomicUsize::new(0)));
    let (sender, receiver) = channel();
    for _ in 0..count.min(rayon::current_num_threads()) {
        let (source, sender) = (Arc::clone(source), sender.clone());
        let (pages, next) = (Arc::clone(&pages), Arc::clone(&next));
        let read = move || {
            while let Some(&page) = pages.get(next.fetch_add(1, Ordering::Relaxed)) {
                if sender.send((page, read_page(&*source, page))).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("nanite-load".into()).spawn(read);
        thread.map_err(|source| Error::Io { path: "thread".into(), source })?;
    }
    drop(sender);
    for _ in 0..count {
        let ended = || Error::Invariant("a thread that reads pages ended before".to_owned());
        let (page, words) = wait_for(&receiver, proceed)?.ok_or_else(ended)?;
        take(page, words?);
    }
    Ok(())
}
