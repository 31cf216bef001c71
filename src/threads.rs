//! Threads that share the work of a call, and what a forked process does without those that it does not have.
//!
//! A fork copies memory and one thread. Pools of the parent look alive in the child and never answer; a lock that another
//! thread held then is held for ever. So pools belong to a process ([`PerProcess`]), what a call may wait for says when
//! nobody will ever give it back ([`Lock`]), and what tells threads and devices when it goes is left alone ([`Own`]).
//!
//! Each call has a pool to itself as long as it runs: what it holds a lock on is never waited for by work that one of its
//! threads has taken from another call.

use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError};
use std::time::{Duration, Instant};

use rayon::ThreadPool;

use crate::error::{Error, Result};

/// Environment variables that say how many threads there are, the first that does.
pub const COUNT_VARIABLES: [&str; 2] = ["NANITE_NUM_THREADS", "RAYON_NUM_THREADS"];

/// Stack of each thread: METIS and deep trees of joins.
const STACK_BYTES: usize = 16 << 20;
/// Threads of a call, at most: more have no cores to run on, and take the system minutes to make.
pub const MOST_THREADS: usize = 1024;
/// Pools that wait for a call, at most.
const MOST_IDLE: usize = 4;
/// How long a lock may be held by those who are just looking at it first.
const GLANCE: Duration = Duration::from_millis(200);

/// The number of this process.
fn process() -> u32 {
    std::process::id()
}

/// A value that each process makes for itself. That of a process before it was forked is never touched or freed again.
pub struct PerProcess<T: 'static>(AtomicPtr<(u32, T)>);

impl<T: Default + Sync> Default for PerProcess<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Default + Sync> PerProcess<T> {
    /// Made when it is first asked for.
    pub const fn new() -> Self {
        Self(AtomicPtr::new(std::ptr::null_mut()))
    }

    /// That of this process.
    pub fn get(&self) -> &'static T {
        let known = self.0.load(Ordering::Acquire);
        // SAFETY: it is null or comes from `Box::leak` below, and nothing is freed that was stored here.
        if let Some((owner, value)) = unsafe { known.as_ref() }
            && *owner == process()
        {
            return value;
        }
        let new = Box::into_raw(Box::new((process(), T::default())));
        match self.0.compare_exchange(known, new, Ordering::AcqRel, Ordering::Acquire) {
            // SAFETY: `new` is a box that was just made and that nobody frees.
            Ok(_) => unsafe { &(*new).1 },
            Err(_) => {
                // SAFETY: nobody else has seen this one.
                drop(unsafe { Box::from_raw(new) });
                self.get()
            }
        }
    }
}

/// What is computed once. Two threads may both compute it; none waits for another, which might not be there in a forked
/// process, or be this one: a thread that waits for its part of a sum may take work that asks for the same.
pub fn once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    match cell.get() {
        Some(value) => value,
        None => {
            let made = make();
            cell.get_or_init(|| made)
        }
    }
}

// ------------------------------------------------------------------------------------------------- pools

static IDLE: PerProcess<Mutex<Vec<ThreadPool>>> = PerProcess::new();

/// What [`set_count`] was given; 0 for nothing.
static COUNT: AtomicUsize = AtomicUsize::new(0);

/// How many threads a call has that names no number: what was set, what the environment says, or one for each core.
pub fn count() -> usize {
    static FOUND: OnceLock<usize> = OnceLock::new();
    let found = || {
        let named = COUNT_VARIABLES.iter().filter_map(|name| std::env::var(name).ok()?.trim().parse().ok());
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        named.into_iter().find(|count| *count > 0).unwrap_or(cores)
    };
    match COUNT.load(Ordering::Relaxed) {
        0 => *once(&FOUND, found),
        set => set,
    }
}

/// Sets it for all calls to come; 0 gives it back to the environment.
pub fn set_count(count: usize) {
    COUNT.store(count, Ordering::Relaxed);
}

/// Threads of one call.
pub struct Crew(Option<ThreadPool>);

impl Crew {
    /// So many threads, or [`count`] of them for 0.
    pub fn new(threads: usize) -> Result<Self> {
        let threads = if threads == 0 { count() } else { threads }.min(MOST_THREADS);
        let mut idle = idle();
        if let Some(at) = idle.iter().position(|pool| pool.current_num_threads() == threads) {
            return Ok(Self(Some(idle.swap_remove(at))));
        }
        drop(idle);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .stack_size(STACK_BYTES)
            .thread_name(|number| format!("nanite-{number}"))
            .build();
        let refused = |error: rayon::ThreadPoolBuildError| {
            Error::argument("threads", format!("the system does not give {threads} threads: {error}"))
        };
        Ok(Self(Some(pool.map_err(refused)?)))
    }

    /// The pool.
    fn pool(&self) -> &ThreadPool {
        // Taken in `drop` alone.
        self.0.as_ref().unwrap_or_else(|| unreachable!())
    }

    /// Runs `work` on its threads while the calling one runs `wait`, which must end when the work has, or when it has told
    /// it to. Returns what both return.
    pub fn beside<T: Send, W>(&self, work: impl FnOnce() -> T + Send, wait: impl FnOnce() -> W) -> (T, W) {
        let mut made = None;
        let place = &mut made;
        let waited = self.pool().in_place_scope(|scope| {
            scope.spawn(move |_| *place = Some(work()));
            wait()
        });
        // The scope ends when what it spawned has, and goes on with its panic.
        (made.unwrap_or_else(|| unreachable!()), waited)
    }
}

fn idle() -> std::sync::MutexGuard<'static, Vec<ThreadPool>> {
    IDLE.get().lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for Crew {
    fn drop(&mut self) {
        let Some(pool) = self.0.take() else { return };
        let mut idle = idle();
        idle.push(pool);
        // The one that has waited longest goes; its threads end by themselves.
        let gone = (idle.len() > MOST_IDLE).then(|| idle.remove(0));
        drop(idle);
        drop(gone);
    }
}

/// Runs `work` on so many threads, 0 for as many as calls have: on those that it is on already, if they are as many.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    let on_some = rayon::current_thread_index().is_some();
    if on_some && (threads == 0 || threads == rayon::current_num_threads()) {
        return Ok(work());
    }
    Ok(Crew::new(threads)?.pool().install(work))
}

// ------------------------------------------------------------------------------------------------- locks

/// A lock on which a forked process does not wait for a thread that it does not have.
#[derive(Debug, Default)]
pub struct Lock<T> {
    /// The last process in which nobody held it when it was first asked for.
    seen: AtomicU32,
    inner: RwLock<T>,
}

impl<T> Lock<T> {
    /// Around a value.
    pub fn new(value: T) -> Self {
        Self { seen: AtomicU32::new(process()), inner: RwLock::new(value) }
    }

    /// To look, with others who do. `what` is named where it is held for ever.
    pub fn read(&self, what: &'static str) -> Result<RwLockReadGuard<'_, T>> {
        // Those who will look at it for ever do not keep others from looking.
        match self.inner.try_read() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(guard)) => return Ok(guard.into_inner()),
            Err(TryLockError::WouldBlock) => self.look(what)?,
        }
        Ok(self.inner.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// To change, alone.
    pub fn write(&self, what: &'static str) -> Result<RwLockWriteGuard<'_, T>> {
        self.look(what)?;
        Ok(self.inner.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// In a new process nobody holds it, unless a thread of the parent did when that was forked.
    fn look(&self, what: &'static str) -> Result<()> {
        let started = Instant::now();
        while self.seen.load(Ordering::Acquire) != process() {
            match self.inner.try_write() {
                Ok(_) | Err(TryLockError::Poisoned(_)) => self.seen.store(process(), Ordering::Release),
                Err(TryLockError::WouldBlock) if started.elapsed() > GLANCE => {
                    return Err(Error::Forked(what));
                }
                Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
            }
        }
        Ok(())
    }
}

/// A value that goes in the process that made it, and is left alone in those forked from it.
#[derive(Debug)]
pub struct Own<T> {
    owner: u32,
    value: ManuallyDrop<T>,
}

impl<T> Own<T> {
    /// Of this process.
    pub fn new(value: T) -> Self {
        Self { owner: process(), value: ManuallyDrop::new(value) }
    }

    /// Whether this process was forked from the one that made it.
    pub fn is_inherited(&self) -> bool {
        self.owner != process()
    }
}

impl<T> Deref for Own<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Own<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T> Drop for Own<T> {
    fn drop(&mut self) {
        if !self.is_inherited() {
            // SAFETY: nothing looks at it after this.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn what_many_threads_make_may_be_asked_for_by_all_of_them() {
        // With a lock around it, a thread that waits for its part of the sum takes work that waits for the lock.
        for _ in 0..50 {
            let made = OnceLock::new();
            let sum = || (0..20_000u64).into_par_iter().map(|n| n % 7).sum::<u64>();
            let ask = |_| *once(&made, sum);
            let found = install(2, || (0..64).into_par_iter().map(ask).collect::<Vec<_>>()).unwrap();
            assert!(found.iter().all(|sum| *sum == found[0]));
        }
    }

    #[test]
    fn calls_have_as_many_threads_as_they_ask_for_and_each_its_own() {
        let threads = |n| install(n, rayon::current_num_threads).unwrap();
        assert_eq!((threads(1), threads(3), threads(0)), (1, 3, count()));
        let inner =
            install(2, || (install(0, rayon::current_num_threads), install(3, rayon::current_num_threads)));
        let (same, other) = inner.unwrap();
        assert_eq!((same.unwrap(), other.unwrap()), (2, 3));
        // Two calls at once: neither waits for the other.
        let (sender, receiver) = std::sync::mpsc::channel();
        let first = std::thread::spawn(move || install(1, move || receiver.recv().unwrap()).unwrap());
        install(1, move || sender.send(7).unwrap()).unwrap();
        assert_eq!(first.join().unwrap(), 7);
        let crew = Crew::new(2).unwrap();
        assert_eq!(crew.beside(rayon::current_num_threads, || 5), (2, 5));
    }

    #[test]
    fn what_another_process_held_is_an_error_and_what_it_left_is_not() {
        let lock = Lock::new(1);
        let other = process() + 1;
        lock.seen.store(other, Ordering::Relaxed);
        *lock.write("it").unwrap() += 1;
        assert_eq!(*lock.read("it").unwrap(), 2);
        lock.seen.store(other, Ordering::Relaxed);
        let held = lock.inner.write().unwrap();
        assert!(matches!(lock.read("it"), Err(Error::Forked("it"))));
        drop(held);
        let looking = lock.inner.read().unwrap();
        assert!(matches!(lock.write("it"), Err(Error::Forked("it"))));
        assert_eq!(*lock.read("it").unwrap(), 2);
        drop(looking);
        assert_eq!(*lock.read("it").unwrap(), 2);
    }

    #[test]
    fn each_process_has_its_own() {
        let value: PerProcess<AtomicUsize> = PerProcess::new();
        value.get().store(3, Ordering::Relaxed);
        assert_eq!(value.get().load(Ordering::Relaxed), 3);
        let of_another = Box::into_raw(Box::new((process() + 1, AtomicUsize::new(9))));
        value.0.store(of_another, Ordering::Release);
        assert_eq!(value.get().load(Ordering::Relaxed), 0);
    }

    #[test]
    fn what_is_inherited_is_left_alone() {
        struct Goes<'a>(&'a AtomicUsize);
        impl Drop for Goes<'_> {
            fn drop(&mut self) {
                self.0.fetch_add(1, Ordering::Relaxed);
            }
        }
        let gone = AtomicUsize::new(0);
        drop(Own::new(Goes(&gone)));
        let mut inherited = Own::new(Goes(&gone));
        inherited.owner += 1;
        drop(inherited);
        assert_eq!(gone.load(Ordering::Relaxed), 1);
    }
}
