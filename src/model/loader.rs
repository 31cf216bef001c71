//! Loading pages: what is wanted most is asked of its source first, in batches, and again where reading failed for a
//! passing reason.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustc_hash::FxHashMap;

use super::page::PageWords;
use super::reading::{INTERRUPT_INTERVAL, InterruptCheck};
use super::retry::{Clock, Retry};
use super::source::{Answer, Cancelled, PageRequest, PageSource};
use super::workers::Workers;
use crate::error::{Error, Result};

/// Batches of a source that are asked for and not answered: one that is being read, and the next.
const BATCHES: usize = 2;

/// Pages whose pauses are over within such a time are asked for together: what failed as one request is one again.
const TOGETHER: Duration = Duration::from_millis(5);

/// A page to be read, with what whoever asks wants to know of it when it arrives.
#[derive(Clone, Debug)]
pub struct LoadRequest<T> {
    /// Where it comes from.
    pub source: Arc<dyn PageSource>,
    /// Which page.
    pub page: usize,
    /// What whoever asks knows it by.
    pub tag: T,
    /// How often it failed; it is not asked for before its pause is over.
    pub retry: Retry,
}

/// A page that was read, or why not.
#[derive(Debug)]
pub struct Arrival<T> {
    /// What was asked for; where reading failed, that is counted.
    pub request: LoadRequest<T>,
    /// The words.
    pub words: Result<PageWords>,
}

/// What tells sources apart.
fn address(source: &Arc<dyn PageSource>) -> usize {
    Arc::as_ptr(source).addr()
}

struct Queue<T> {
    /// The next one last.
    requests: Vec<LoadRequest<T>>,
    /// Those whose pause is not over.
    paused: Vec<LoadRequest<T>>,
    /// Pages that each source was asked for and has not answered.
    unanswered: FxHashMap<usize, usize>,
    /// A thread is asking sources: another that answers meanwhile leaves that to it.
    asking: bool,
    closed: bool,
}

impl<T> Queue<T> {
    /// The next batch: pages of one source, as soon as it has half of what it may have at once.
    fn next(&mut self, now: Instant, threads: usize) -> Vec<LoadRequest<T>> {
        let Self { requests, paused, unanswered, .. } = self;
        if paused.iter().any(|request| request.retry.pause(now).is_zero()) {
            requests.extend(paused.extract_if(.., |request| request.retry.pause(now) <= TOGETHER));
        }
        let mut batch: Vec<LoadRequest<T>> = Vec::new();
        let mut room = 0;
        let mut at = requests.len();
        while at > 0 && (batch.is_empty() || batch.len() < room) {
            at -= 1;
            let request = &requests[at];
            if batch.first().is_some_and(|first| !Arc::ptr_eq(&first.source, &request.source)) {
                continue;
            }
            if batch.is_empty() {
                let size = request.source.batch_size().max(threads).max(1);
                let open = unanswered.get(&address(&request.source)).copied().unwrap_or(0);
                if open > size * (BATCHES - 1) {
                    continue;
                }
                room = size * BATCHES - open;
            }
            // Almost always the last one.
            batch.push(requests.remove(at));
        }
        if let Some(first) = batch.first() {
            *unanswered.entry(address(&first.source)).or_default() += batch.len();
        }
        batch
    }
}

struct Shared<T> {
    queue: Mutex<Queue<T>>,
    sender: Sender<Arrival<T>>,
    workers: Workers,
    threads: usize,
    clock: Clock,
    /// Nobody waits for pages any more.
    cancelled: Cancelled,
}

impl<T: Send + 'static> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, Queue<T>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks sources for as much as they may have at once.
    fn ask(self: &Arc<Self>) {
        let mut queue = self.lock();
        if std::mem::replace(&mut queue.asking, true) {
            return;
        }
        loop {
            let batch = queue.next(self.clock.now(), self.threads);
            let Some(first) = batch.first() else { break };
            drop(queue);
            let source = Arc::clone(&first.source);
            let wanted = |request: LoadRequest<T>| {
                let (page, shared) = (request.page, Arc::clone(self));
                let answer = Answer::new(move |words| shared.answered(request, words));
                PageRequest { page, answer: answer.cancelled_by(&self.cancelled) }
            };
            let batch = batch.into_iter().map(wanted).collect();
            // A panic drops what is not answered, and that is an answer.
            drop(catch_unwind(AssertUnwindSafe(|| source.read(batch, &self.workers))));
            queue = self.lock();
        }
        queue.asking = false;
    }

    fn answered(self: &Arc<Self>, mut request: LoadRequest<T>, words: Option<Result<PageWords>>) {
        let no_answer = || Err(Error::Invariant(format!("reading page {} panicked", request.page)));
        let words = words.unwrap_or_else(no_answer);
        let mut queue = self.lock();
        if let Some(open) = queue.unanswered.get_mut(&address(&request.source)) {
            *open -= 1;
            if *open == 0 {
                queue.unanswered.remove(&address(&request.source));
            }
        }
        if queue.closed {
            return;
        }
        if words.is_err() {
            request.retry.failed(self.clock.now());
        }
        match words {
            Err(error) if error.is_passing() && request.retry.failures() < request.source.tries() => {
                queue.paused.push(request);
            }
            // Nobody listens any more once the loader goes.
            words => drop(self.sender.send(Arrival { request, words })),
        }
        drop(queue);
        self.ask();
    }

    /// How long it takes until the next page may be asked for again, or an interrupt check is due.
    fn pause(&self) -> Duration {
        let now = self.clock.now();
        let queue = self.lock();
        let pauses = queue.paused.iter().map(|request| request.retry.pause(now));
        pauses.fold(INTERRUPT_INTERVAL, Duration::min)
    }
}

/// Pages that are to be read, and threads for it, which start with the first one.
pub struct Loader<T: Send + 'static> {
    shared: Arc<Shared<T>>,
    /// Behind a lock that nobody takes: who waits has the loader to himself.
    arrivals: Mutex<Receiver<Arrival<T>>>,
}

impl<T: Send + 'static> Loader<T> {
    /// So many threads, and pauses by this clock.
    pub fn new(threads: usize, clock: Clock) -> Self {
        let (sender, arrivals) = channel();
        let queue = Queue {
            requests: Vec::new(),
            paused: Vec::new(),
            unanswered: FxHashMap::default(),
            asking: false,
            closed: false,
        };
        let workers = Workers::new();
        let (queue, cancelled) = (Mutex::new(queue), Cancelled::default());
        let shared = Shared { queue, sender, workers, threads, clock, cancelled };
        Self { shared: Arc::new(shared), arrivals: Mutex::new(arrivals) }
    }

    /// Takes back what no source was asked for yet.
    pub fn take_back(&self) -> Vec<LoadRequest<T>> {
        let mut queue = self.shared.lock();
        let mut requests = std::mem::take(&mut queue.requests);
        requests.append(&mut queue.paused);
        requests
    }

    /// Asks for more pages, before those of earlier calls. What matters most comes first.
    pub fn submit(&mut self, requests: Vec<LoadRequest<T>>) -> Result<()> {
        if requests.is_empty() {
            return Ok(());
        }
        self.shared.workers.start(self.shared.threads)?;
        let now = self.shared.clock.now();
        let due = |request: &LoadRequest<T>| request.retry.pause(now).is_zero();
        let (due, mut paused): (Vec<_>, Vec<_>) = requests.into_iter().rev().partition(due);
        let mut queue = self.shared.lock();
        queue.requests.extend(due);
        queue.paused.append(&mut paused);
        drop(queue);
        self.shared.ask();
        Ok(())
    }

    /// What has arrived.
    pub fn arrivals(&mut self) -> impl Iterator<Item = Arrival<T>> + '_ {
        self.receiver().try_iter()
    }

    fn receiver(&mut self) -> &mut Receiver<Arrival<T>> {
        self.arrivals.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for one of the pages that were asked for.
    pub fn wait(&mut self, proceed: InterruptCheck<'_>) -> Result<Arrival<T>> {
        while proceed() {
            self.shared.ask();
            let pause = self.shared.pause();
            if let Ok(arrival) = self.receiver().recv_timeout(pause) {
                return Ok(arrival);
            }
        }
        Err(Error::Cancelled)
    }
}

impl<T: Send + 'static> Drop for Loader<T> {
    fn drop(&mut self) {
        self.shared.cancelled.set();
        let mut queue = self.shared.lock();
        queue.closed = true;
        drop(queue);
        drop(self.take_back());
        self.shared.workers.close();
    }
}

impl<T: Send + 'static> fmt::Debug for Loader<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Loader({} threads)", self.shared.threads)
    }
}
