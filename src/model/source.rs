//! Page sources: where pages come from that are not in memory.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::page::PageWords;
use super::retry::TRIES;
use super::workers::Workers;
use crate::error::Result;

/// What takes one answer, once. Dropped without one, as by a panic, it says so: whoever waits for it does not wait for ever.
pub struct Answer<T> {
    take: Option<Box<dyn FnOnce(Option<T>) + Send>>,
    cancelled: Cancelled,
}

/// Whether nobody waits for some answers any more. Copies are the same.
#[derive(Clone, Debug, Default)]
pub struct Cancelled(Arc<AtomicBool>);

impl Cancelled {
    /// Nobody does, from now on.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether so.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl<T> Answer<T> {
    /// `take` gets the answer, or nothing where there will be none. It does not wait.
    pub fn new(take: impl FnOnce(Option<T>) + Send + 'static) -> Self {
        Self { take: Some(Box::new(take)), cancelled: Cancelled::default() }
    }

    /// One that need not be given once it is cancelled: what was not asked for by then is not asked for any more.
    pub fn cancelled_by(self, cancelled: &Cancelled) -> Self {
        Self { take: self.take_out(), cancelled: cancelled.clone() }
    }

    fn take_out(mut self) -> Option<Box<dyn FnOnce(Option<T>) + Send>> {
        self.take.take()
    }

    /// Whether nobody waits for it any more.
    pub fn cancelled(&self) -> &Cancelled {
        &self.cancelled
    }

    /// Gives the answer.
    pub fn send(mut self, answer: T) {
        if let Some(take) = self.take.take() {
            take(Some(answer));
        }
    }
}

impl<T> Drop for Answer<T> {
    fn drop(&mut self) {
        if let Some(take) = self.take.take() {
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

/// What reading from far away has cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Requests that were answered, or failed.
    pub requests: u64,
    /// Of these, those that failed.
    pub failed_requests: u64,
    /// Bytes that arrived.
    pub bytes: u64,
    /// Of these, bytes between ranges that were read as one.
    pub joined_bytes: u64,
    /// Bytes that a cache on disk had.
    pub cached_bytes: u64,
    /// Time from each request to its answer, added up.
    pub nanoseconds: u64,
}

impl Traffic {
    fn zip(self, other: Self, each: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            requests: each(self.requests, other.requests),
            failed_requests: each(self.failed_requests, other.failed_requests),
            bytes: each(self.bytes, other.bytes),
            joined_bytes: each(self.joined_bytes, other.joined_bytes),
            cached_bytes: each(self.cached_bytes, other.cached_bytes),
            nanoseconds: each(self.nanoseconds, other.nanoseconds),
        }
    }

    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        self.zip(other, u64::saturating_add)
    }

    /// What came after.
    pub fn since(self, before: Self) -> Self {
        self.zip(before, u64::saturating_sub)
    }

    /// Milliseconds from a request to its answer, on average; 0 without one.
    pub fn latency_ms(&self) -> f64 {
        self.nanoseconds as f64 * 1e-6 / self.requests.max(1) as f64
    }
}

/// Counts it, from any thread.
#[derive(Debug, Default)]
pub struct TrafficCounter([AtomicU64; 6]);

impl TrafficCounter {
    /// Adds some.
    pub fn add(&self, traffic: Traffic) {
        let Traffic { requests, failed_requests, bytes, joined_bytes, cached_bytes, nanoseconds } = traffic;
        let parts = [requests, failed_requests, bytes, joined_bytes, cached_bytes, nanoseconds];
        for (counter, part) in self.0.iter().zip(parts) {
            counter.fetch_add(part, Ordering::Relaxed);
        }
    }

    /// All so far.
    pub fn get(&self) -> Traffic {
        let [requests, failed_requests, bytes, joined_bytes, cached_bytes, nanoseconds] =
            [0, 1, 2, 3, 4, 5].map(|k: usize| self.0[k].load(Ordering::Relaxed));
        Traffic { requests, failed_requests, bytes, joined_bytes, cached_bytes, nanoseconds }
    }
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

    /// How often a page is tried that fails for a passing reason. Pauses about double: eleven times take up to ten seconds.
    fn tries(&self) -> u32 {
        TRIES
    }

    /// What reading has cost so far, where that is counted.
    fn traffic(&self) -> Traffic {
        Traffic::default()
    }

    /// The other pages with clusters that were made from the groups of a page, ascending, all before it.
    fn dependencies(&self, page: usize) -> &[u32];
}
