//! Inputs that Python reads: stores far away, and Python's file objects. What is asked of them, joined and kept is decided in
//! `nanite_rs._remote`; the interpreter lock is held while that is called, and not while anybody waits.

use std::io;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;

use super::errors::Refused;
use crate::format::input::{Input as ByteInput, RangeRequest};
use crate::model::{self, Answer, TrafficCounter, Workers, retry};

/// Counts what reading costs.
#[pyclass(frozen, module = "nanite_rs._core")]
#[derive(Default)]
pub struct Traffic(Arc<TrafficCounter>);

#[pymethods]
impl Traffic {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Counts a request that took so many seconds, and what it brought.
    #[pyo3(signature = (*, seconds, read_bytes=0, joined_bytes=0, failed=false))]
    fn request(&self, seconds: f64, read_bytes: u64, joined_bytes: u64, failed: bool) {
        self.0.add(model::Traffic {
            requests: 1,
            failed_requests: failed.into(),
            bytes: read_bytes,
            joined_bytes,
            cached_bytes: 0,
            nanoseconds: (seconds * 1e9) as u64,
        });
    }

    /// Counts bytes that a cache had.
    fn cached(&self, read_bytes: u64) {
        self.0.add(model::Traffic { cached_bytes: read_bytes, ..model::Traffic::default() });
    }

    /// All so far by name, and the mean time, milliseconds, from a request to its answer.
    fn counts(&self) -> (Vec<(&'static str, u64)>, f64) {
        let traffic = self.0.get();
        let counts = vec![
            ("requests", traffic.requests),
            ("failed_requests", traffic.failed_requests),
            ("read_bytes", traffic.bytes),
            ("joined_bytes", traffic.joined_bytes),
            ("cached_bytes", traffic.cached_bytes),
        ];
        (counts, traffic.latency_ms())
    }
}

/// Seconds of the pauses before each try but the first, of what is tried so many times.
#[pyfunction]
pub fn retry_pauses(tries: u32) -> Vec<f64> {
    retry::pauses(tries).map(|pause| pause.as_secs_f64()).collect()
}

/// Bytes that Python reads.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Input {
    name: String,
    length: u64,
    batch: usize,
    tries: u32,
    read: Py<PyAny>,
    traffic: Arc<TrafficCounter>,
    stopped: Arc<AtomicBool>,
}

#[pymethods]
impl Input {
    /// So many bytes, which `read(ranges, answers)` reads: it gets up to some `batch` ranges as a list of pairs (start, end),
    /// the most wanted first, and returns at once how many the next batch may have. What fails for a passing reason is tried so
    /// many times.
    #[new]
    fn new(name: String, length: u64, batch: usize, tries: u32, read: Py<PyAny>, traffic: &Traffic) -> Self {
        let (traffic, stopped) = (Arc::clone(&traffic.0), Arc::default());
        Self { name, length, batch, tries, read, traffic, stopped }
    }

    /// Nobody waits for it to be opened any more: pauses end.
    fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }
}

impl Input {
    /// What errors call it.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// What reads it.
    pub(super) fn remote(&self, py: Python<'_>) -> Remote {
        let Self { length, batch, tries, .. } = *self;
        let (traffic, stopped) = (Arc::clone(&self.traffic), Arc::clone(&self.stopped));
        let batch = batch.into();
        Remote { length, batch, tries, read: self.read.clone_ref(py), traffic, stopped }
    }
}

/// What asks Python for bytes.
pub(super) struct Remote {
    length: u64,
    batch: AtomicUsize,
    tries: u32,
    read: Py<PyAny>,
    traffic: Arc<TrafficCounter>,
    stopped: Arc<AtomicBool>,
}

impl ByteInput for Remote {
    fn length(&self) -> u64 {
        self.length
    }

    fn read(&self, batch: Vec<RangeRequest>, _: &Workers) {
        let (wanted, answers): (Vec<_>, Vec<_>) =
            batch.into_iter().map(|RangeRequest { range, answer }| (range, answer)).unzip();
        let pairs: Vec<(u64, u64)> = wanted.iter().map(|range| (range.start, range.end)).collect();
        let answers = Answers { wanted, answers: Mutex::new(answers.into_iter().map(Some).collect()) };
        // While the interpreter ends there are no answers.
        let asked = Python::try_attach(|py| -> PyResult<()> {
            let answers = Bound::new(py, answers)?;
            match self.read.call1(py, (pairs, &answers)).and_then(|batch| batch.extract(py)) {
                Ok(batch) => self.batch.store(batch, Ordering::Relaxed),
                Err(error) => answers.get().refuse_all(&error.to_string()),
            }
            Ok(())
        });
        drop(asked);
    }

    fn batch_size(&self) -> usize {
        self.batch.load(Ordering::Relaxed)
    }

    fn tries(&self) -> u32 {
        self.tries
    }

    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    fn traffic(&self) -> model::Traffic {
        self.traffic.get()
    }
}

type Bytes = io::Result<Vec<u8>>;

/// What takes the bytes of a batch of ranges: each once, in any order, from any thread.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Answers {
    wanted: Vec<Range<u64>>,
    answers: Mutex<Vec<Option<Answer<Bytes>>>>,
}

impl Answers {
    fn take(&self, index: usize) -> Option<Answer<Bytes>> {
        self.answers.lock().unwrap_or_else(PoisonError::into_inner).get_mut(index)?.take()
    }

    fn refuse_all(&self, message: &str) {
        for index in 0..self.wanted.len() {
            if let Some(answer) = self.take(index) {
                answer.send(Err(refused("InternalError", message, false)));
            }
        }
    }
}

fn refused(class: &str, message: &str, passing: bool) -> io::Error {
    let kind = if passing { io::ErrorKind::ConnectionReset } else { io::ErrorKind::InvalidData };
    io::Error::new(kind, Refused { class: class.into(), message: message.into() })
}

#[pymethods]
impl Answers {
    /// Gives the bytes of a range, all of them.
    fn give(&self, py: Python<'_>, index: usize, data: &[u8]) {
        let Some(answer) = self.take(index) else { return };
        let length = self.wanted[index].end - self.wanted[index].start;
        let bytes = if data.len() as u64 == length {
            Ok(data.to_vec())
        } else {
            let message = format!("{} bytes were given for {length}", data.len());
            Err(refused("InternalError", &message, false))
        };
        py.detach(|| answer.send(bytes));
    }

    /// Says why there are none: the class of `nanite_rs.exceptions`, what happened, and whether it may pass.
    fn fail(&self, py: Python<'_>, index: usize, class_: &str, message: &str, passing: bool) {
        let Some(answer) = self.take(index) else { return };
        let error = refused(class_, message, passing);
        py.detach(|| answer.send(Err(error)));
    }

    /// Whether somebody still waits for a range.
    fn is_wanted(&self, index: usize) -> bool {
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        answers.get(index).and_then(Option::as_ref).is_some_and(|answer| !answer.cancelled().is_set())
    }
}
