//! How a call from Python runs: without the interpreter lock, on threads of its own, while the calling one looks at signals,
//! so that Ctrl-C works; and behind a wall that no panic passes.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};

use pyo3::prelude::*;

use super::errors::{panic_to_python, to_python};
use crate::build::Progress;
use crate::error::Result;
use crate::model::{INTERRUPT_INTERVAL, InterruptCheck};
use crate::threads::{self, Crew};

/// Progress as the waiting thread sees it.
#[derive(Default)]
struct Shared {
    done: AtomicU64,
    total: AtomicU64,
    cancelled: AtomicBool,
}

impl Progress for Shared {
    fn update(&self, done: u64, total: u64) -> bool {
        self.total.store(total, Ordering::Relaxed);
        self.done.fetch_max(done, Ordering::Relaxed);
        !self.cancelled.load(Ordering::Relaxed)
    }
}

/// Runs `work`.
pub(super) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    run(py, 0, None, |_| work())
}

/// The same for work that waits for a disk, and may be told not to.
pub(super) fn interruptible<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(InterruptCheck<'_>) -> Result<T> + Send,
) -> PyResult<T> {
    interruptible_on(py, 0, work)
}

/// The same on so many threads; 0 for as many as calls have.
pub(super) fn interruptible_on<T: Send>(
    py: Python<'_>,
    threads: usize,
    work: impl FnOnce(InterruptCheck<'_>) -> Result<T> + Send,
) -> PyResult<T> {
    run(py, threads, None, |shared| work(&|| !shared.cancelled.load(Ordering::Relaxed)))
}

/// The same for work that says how far it is; calls `report(done, total)`, which may stop it by raising.
pub(super) fn watched<T: Send>(
    py: Python<'_>,
    threads: usize,
    report: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Progress) -> Result<T> + Send,
) -> PyResult<T> {
    run(py, threads, report, |shared| work(shared))
}

fn run<T: Send>(
    py: Python<'_>,
    threads: usize,
    report: Option<&Py<PyAny>>,
    work: impl FnOnce(&Shared) -> Result<T> + Send,
) -> PyResult<T> {
    let shared = Shared::default();
    let watch = || -> PyResult<()> {
        Python::attach(|py| {
            py.check_signals()?;
            let total = shared.total.load(Ordering::Relaxed);
            if let Some(report) = report.filter(|_| total > 0) {
                report.call1(py, (shared.done.load(Ordering::Relaxed), total))?;
            }
            Ok(())
        })
    };
    let outcome = py.detach(|| {
        let crew = Crew::new(threads)?;
        let (sender, receiver) = channel::<()>();
        let shared = &shared;
        let work = move || {
            let result = catch_unwind(AssertUnwindSafe(|| work(shared)));
            drop(sender);
            result
        };
        let wait = || {
            let mut raised = Ok(());
            while raised.is_ok()
                && receiver.recv_timeout(INTERRUPT_INTERVAL) == Err(RecvTimeoutError::Timeout)
            {
                raised = watch();
                shared.cancelled.store(raised.is_err(), Ordering::Relaxed);
            }
            raised
        };
        Ok(crew.beside(work, wait))
    });
    let (result, raised) = outcome.map_err(|error| to_python(py, error))?;
    raised?;
    match result {
        Ok(result) => {
            let value = result.map_err(|error| to_python(py, error))?;
            if report.is_some() {
                watch()?;
            }
            Ok(value)
        }
        Err(payload) => Err(panic_to_python(py, &*payload)),
    }
}

/// Sets how many threads calls have from now on; 0 leaves it to the environment.
#[pyfunction]
pub(super) fn set_num_threads(threads: usize) {
    threads::set_count(threads);
}

/// How many threads calls have.
#[pyfunction]
pub(super) fn num_threads() -> usize {
    threads::count()
}
