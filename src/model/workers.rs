//! Threads that read and decode for somebody who does not wait for them.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::error::{Error, Result};

type Job = Box<dyn FnOnce() + Send>;

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    threads: usize,
    closed: bool,
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next job; nothing once closed.
    fn next(&self) -> Option<Job> {
        let mut queue = self.lock();
        while !queue.closed {
            if let Some(job) = queue.jobs.pop_front() {
                return Some(job);
            }
            queue = self.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        None
    }
}

/// A panic ends the job, and what it dropped says so: see [`super::Answer`].
fn run(job: Job) {
    drop(catch_unwind(AssertUnwindSafe(job)));
}

/// A queue of jobs and the threads that take them. Copies are the same queue.
#[derive(Clone, Default)]
pub struct Workers(Option<Arc<Shared>>);

impl Workers {
    /// No threads: each job runs where it is given.
    pub fn inline() -> Self {
        Self(None)
    }

    /// Without threads until [`Workers::start`].
    pub fn new() -> Self {
        Self(Some(Arc::default()))
    }

    /// Sees to it that there are so many threads.
    pub fn start(&self, threads: usize) -> Result<()> {
        let Some(shared) = &self.0 else { return Ok(()) };
        let mut queue = shared.lock();
        while queue.threads < threads {
            let shared = Arc::clone(shared);
            let work = move || {
                while let Some(job) = shared.next() {
                    run(job);
                }
            };
            match std::thread::Builder::new().name("nanite-load".into()).spawn(work) {
                Ok(_) => queue.threads += 1,
                // Fewer do as well.
                Err(_) if queue.threads > 0 => break,
                Err(source) => return Err(Error::Io { path: "thread".into(), source }),
            }
        }
        Ok(())
    }

    /// Puts a job behind those that wait.
    pub fn last(&self, job: impl FnOnce() + Send + 'static) {
        self.put(Box::new(job), VecDeque::push_back);
    }

    /// Puts a job before those that wait: what was begun is finished before something else is begun.
    pub fn first(&self, job: impl FnOnce() + Send + 'static) {
        self.put(Box::new(job), VecDeque::push_front);
    }

    fn put(&self, job: Job, place: fn(&mut VecDeque<Job>, Job)) {
        let Some(shared) = &self.0 else { return run(job) };
        let mut queue = shared.lock();
        if queue.closed {
            // What is dropped with the job may come back here.
            drop(queue);
            return drop(job);
        }
        place(&mut queue.jobs, job);
        drop(queue);
        shared.filled.notify_one();
    }

    /// Drops the jobs that no thread has begun. Threads end with the one that they are at; nobody waits for it, since a disk
    /// may take long.
    pub fn close(&self) {
        let Some(shared) = &self.0 else { return };
        let mut queue = shared.lock();
        queue.closed = true;
        let jobs = std::mem::take(&mut queue.jobs);
        drop(queue);
        shared.filled.notify_all();
        drop(jobs);
    }
}
