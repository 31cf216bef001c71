//! When what failed is tried again: after a pause that about doubles from failure to failure.

use std::fmt;
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// The pause after the first failure.
const FIRST_PAUSE: Duration = Duration::from_millis(10);
/// The longest pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
/// How often something is tried that fails for a passing reason before that counts as an error: for a third of a second at
/// most, which is right for disks. What is far away has a number of its own ([`super::PageSource::tries`]).
pub const TRIES: u32 = 6;

/// The longest pause after so many failures and one.
fn longest(failures: u32) -> Duration {
    FIRST_PAUSE.saturating_mul(1 << failures.min(u32::BITS - 1)).min(LONGEST_PAUSE)
}

/// What part of the longest pause is taken, from a half to one. It differs from process to process: readers of a server that
/// was down do not come back at once. It is the same within a process: ranges that failed together are joined again.
fn jitter(failures: u32) -> f64 {
    static SEED: OnceLock<RandomState> = OnceLock::new();
    // Forked processes have the same seed.
    let hash = SEED.get_or_init(RandomState::new).hash_one((std::process::id(), failures));
    0.5 + 0.5 * (hash as f64 / u64::MAX as f64)
}

/// Failures since the last success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retry {
    failures: u32,
    due: Option<Instant>,
}

impl Retry {
    /// Counts a failure.
    pub fn failed(&mut self, now: Instant) {
        self.due = Some(now + longest(self.failures).mul_f64(jitter(self.failures)));
        self.failures += 1;
    }

    /// Number of failures.
    pub fn failures(self) -> u32 {
        self.failures
    }

    /// How long it takes until the next try.
    pub fn pause(self, now: Instant) -> Duration {
        self.due.map_or(Duration::ZERO, |due| due.saturating_duration_since(now))
    }
}

/// The pauses before each try but the first, of what is tried so many times.
pub fn pauses(tries: u32) -> impl Iterator<Item = Duration> {
    let (now, mut retry) = (Instant::now(), Retry::default());
    (1..tries).map(move |_| {
        retry.failed(now);
        retry.pause(now)
    })
}

/// A monotonic clock, which tests set.
#[derive(Clone)]
pub struct Clock(Arc<dyn Fn() -> Instant + Send + Sync>);

impl Clock {
    /// A clock of one's own.
    pub fn new(now: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self(Arc::new(now))
    }

    /// The time.
    pub fn now(&self) -> Instant {
        (self.0)()
    }
}

/// That of the system.
impl Default for Clock {
    fn default() -> Self {
        Self::new(Instant::now)
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Clock({:?})", self.now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longest_pauses_double_and_half_of_them_is_certain() {
        let (now, mut retry) = (Instant::now(), Retry::default());
        assert_eq!(retry.pause(now), Duration::ZERO);
        let mut pauses = Vec::new();
        let mut most = FIRST_PAUSE;
        for failures in 0..80 {
            assert_eq!((longest(failures), retry.failures()), (most, failures));
            retry.failed(now);
            pauses.push(retry.pause(now));
            assert!((most / 2..=most).contains(&pauses[failures as usize]), "{failures}: {pauses:?}");
            most = (2 * most).min(LONGEST_PAUSE);
        }
        assert_eq!((most, retry.failures()), (LONGEST_PAUSE, 80));
        assert_eq!(retry.pause(now + LONGEST_PAUSE), Duration::ZERO);
        // What fails together comes back together.
        assert!(super::pauses(TRIES).eq(pauses[..TRIES as usize - 1].iter().copied()));
        assert_eq!((super::pauses(0).count(), super::pauses(1).count()), (0, 0));
    }
}
