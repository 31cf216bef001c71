//! Threads that read and decode pages, those first that matter most.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::pool::Ask;
use crate::error::{Error, Result};
use crate::model::{InterruptCheck, PageSource, PageWords, read_page, wait_for};

/// Threads at most: a disk and a few cores are busy with less.
const MOST_THREADS: usize = 4;

/// A page to be read.
#[derive(Clone, Debug)]
pub(super) struct LoadRequest {
    pub(super) ask: Ask,
    /// Which of the meshes that had this number.
    pub(super) generation: u64,
    pub(super) source: Arc<dyn PageSource>,
}

/// A page that was read, or why not.
#[derive(Debug)]
pub(super) struct Arrival {
    pub(super) request: LoadRequest,
    pub(super) words: Result<PageWords>,
}

#[derive(Debug, Default)]
struct Queue {
    /// The next one last.
    requests: Vec<LoadRequest>,
    closed: bool,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next job; nothing once closed.
    fn next(&self) -> Option<LoadRequest> {
        let mut queue = self.lock();
        loop {
            if queue.closed {
                return None;
            }
            if let Some(request) = queue.requests.pop() {
                return Some(request);
            }
            queue = self.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// The threads, started with the first job.
#[derive(Debug)]
pub(super) struct Loader {
    shared: Arc<Shared>,
    sender: Sender<Arrival>,
    /// Behind a lock that nobody takes: who waits has the loader to himself.
    arrivals: Mutex<Receiver<Arrival>>,
    threads: usize,
}

impl Default for Loader {
    fn default() -> Self {
        let (sender, arrivals) = channel();
        Self { shared: Arc::default(), sender, arrivals: Mutex::new(arrivals), threads: 0 }
    }
}

impl Loader {
    /// Takes back the jobs that no thread has begun.
    pub(super) fn take_back(&self) -> Vec<LoadRequest> {
        std::mem::take(&mut self.shared.lock().requests)
    }

    /// Puts jobs in the queue, what matters most first.
    pub(super) fn submit(&mut self, mut requests: Vec<LoadRequest>) -> Result<()> {
        if requests.is_empty() {
            return Ok(());
        }
        self.start()?;
        requests.reverse();
        self.shared.lock().requests = requests;
        self.shared.filled.notify_all();
        Ok(())
    }

    fn start(&mut self) -> Result<()> {
        let count = std::thread::available_parallelism().map_or(1, |n| n.get().min(MOST_THREADS));
        while self.threads < count {
            let (shared, sender) = (Arc::clone(&self.shared), self.sender.clone());
            let thread = std::thread::Builder::new().name("nanite-load".into()).spawn(move || {
                while let Some(request) = shared.next() {
                    let words = read_page(&*request.source, request.ask.page as usize);
                    // Nobody listens any more when the renderer goes.
                    if sender.send(Arrival { request, words }).is_err() {
                        return;
                    }
                }
            });
            match thread {
                Ok(_) => self.threads += 1,
                // Fewer do as well.
                Err(_) if self.threads > 0 => return Ok(()),
                Err(source) => return Err(Error::Io { path: "thread".into(), source }),
            }
        }
        Ok(())
    }

    /// What has arrived.
    pub(super) fn arrivals(&mut self) -> impl Iterator<Item = Arrival> + '_ {
        self.receiver().try_iter()
    }

    fn receiver(&mut self) -> &mut Receiver<Arrival> {
        self.arrivals.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for one of what was submitted.
    pub(super) fn wait(&mut self, proceed: InterruptCheck<'_>) -> Result<Option<Arrival>> {
        wait_for(self.receiver(), proceed)
    }
}

/// The threads end with the page that they are at. Nobody waits for it: a disk may take long.
impl Drop for Loader {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.filled.notify_all();
    }
}
