//! When what failed is tried again: after a pause that doubles from failure to failure.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The pause after the first failure.
const FIRST_PAUSE: Duration = Duration::from_millis(10);
/// The longest pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
/// How often something is tried that fails for a passing reason before that counts as an error: for a third of a second.
pub const TRIES: u32 = 6;

/// Failures since the last success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retry {
    failures: u32,
    due: Option<Instant>,
}

impl Retry {
    /// Counts a failure.
    pub fn failed(&mut self, now: Instant) {
        let pause = FIRST_PAUSE.saturating_mul(1 << self.failures.min(u32::BITS - 1)).min(LONGEST_PAUSE);
        self.failures += 1;
        self.due = Some(now + pause);
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

/// The pauses before each try but the first, of what is tried [`TRIES`] times.
pub fn pauses() -> impl Iterator<Item = Duration> {
    let (now, mut retry) = (Instant::now(), Retry::default());
    (1..TRIES).map(move |_| {
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
    fn pauses_double_up_to_the_longest() {
        let (now, mut retry) = (Instant::now(), Retry::default());
        assert_eq!(retry.pause(now), Duration::ZERO);
        let mut pauses = Vec::new();
        for _ in 0..80 {
            retry.failed(now);
            pauses.push(retry.pause(now));
        }
        assert!(pauses.iter().zip(&pauses[1..]).all(|(a, b)| *b == (2 * *a).min(LONGEST_PAUSE)));
        assert_eq!((pauses[0], pauses[79], retry.failures()), (FIRST_PAUSE, LONGEST_PAUSE, 80));
        assert_eq!(retry.pause(now + LONGEST_PAUSE), Duration::ZERO);
        assert!(super::pauses().eq(pauses[..TRIES as usize - 1].iter().copied()));
    }
}
