//! Between frames: what has arrived takes its place, what frames need is asked for.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::pool::{Ask, Change, Plan, Pool};
use super::request::Needs;
use super::resident::Resident;
use crate::error::{Error, Result};
use crate::limits::PAGE_MAX_BYTES;
use crate::model::{
    Arrival, Clock, Dag, InterruptCheck, LoadRequest, Loader, PageSource, PageWords, Pages, Retry, Traffic,
    read_pages,
};
use crate::threads::Own;

/// Threads that read and decode, at most: a disk and a few cores are busy with less.
const MOST_THREADS: usize = 4;

/// Bytes of pages that enter before a frame that does not wait: what a device takes in a few milliseconds.
const ENTER_BYTES: u64 = 16 << 20;

/// How a renderer streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamOptions {
    /// Bytes of pages in memory.
    pub pool_bytes: u64,
    /// Every page but those of roots counts as the largest there may be: a device keeps them in places of one size.
    pub equal_pages: bool,
}

/// A page that could not be read, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// What was wrong.
    pub message: String,
}

/// What streaming did for a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamStats {
    /// Pages that the frame could draw.
    pub resident_pages: u64,
    /// Bytes of the pool in use, with what is being read.
    pub pool_bytes: u64,
    /// Pages that the frame needed, with those that they depend on.
    pub needed_pages: u64,
    /// Of these, those that were not there.
    pub missing_pages: u64,
    /// Of these, those that the pool has no room for.
    pub refused_pages: u64,
    /// Pages that arrived before the frame.
    pub arrived_pages: u64,
    /// Pages that left before the frame.
    pub evicted_pages: u64,
    /// Pages so far that could not be read; one that still cannot be is not counted again.
    pub read_errors: u64,
    /// Largest error, pixels, of what was drawn in place of something finer; 0 where nothing was.
    pub coarsest_pixels: f32,
    /// Frames that were drawn until all was there; 1 without waiting.
    pub draws: u64,
    /// What reading from far away has cost since the frame before, whoever read.
    pub traffic: Traffic,
}

/// A mesh that is streamed.
#[derive(Debug)]
struct Mesh {
    dag: Arc<Dag>,
    source: Arc<dyn PageSource>,
    /// Its number in the pool.
    number: u32,
    generation: u64,
    /// What is resident; changed in place unless a frame still looks at it.
    pages: Arc<Pages>,
    /// Number of its root pages.
    roots: usize,
    /// Pages that could not be read the last time.
    failing: BTreeMap<u32, Failing>,
    /// What reading had cost before the frame.
    traffic_before: Traffic,
}

/// A page that could not be read the last time.
#[derive(Debug, Default)]
struct Failing {
    retry: Retry,
    /// It counts as a read error, and the pool does without it until the next try.
    told: bool,
}

/// What an arrival belongs to.
#[derive(Clone, Copy, Debug)]
struct Tag {
    ask: Ask,
    /// Which of the meshes that had this number.
    generation: u64,
}

/// See the module's documentation.
#[derive(Debug)]
pub struct Streamer {
    pool: Pool,
    equal_pages: bool,
    clock: Clock,
    loader: Own<Loader<Tag>>,
    meshes: Vec<Mesh>,
    generations: u64,
    /// Jobs that threads have or will have.
    asked: usize,
    read_errors: Vec<Fault>,
    fault_count: u64,
    arrived: u64,
    evicted_before: u64,
    draws: u64,
}

impl Streamer {
    /// A streamer with an empty pool.
    pub fn new(options: StreamOptions) -> Self {
        Self::with_clock(options, Clock::default())
    }

    /// One whose pauses after failures go by this clock.
    pub fn with_clock(options: StreamOptions, clock: Clock) -> Self {
        Self {
            pool: Pool::new(options.pool_bytes),
            equal_pages: options.equal_pages,
            loader: loader(&clock),
            clock,
            meshes: Vec::new(),
            generations: 0,
            asked: 0,
            read_errors: Vec::new(),
            fault_count: 0,
            arrived: 0,
            evicted_before: 0,
            draws: 0,
        }
    }

    /// The pool.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }

    /// Faults since this was last called.
    pub fn read_errors(&mut self) -> Vec<Fault> {
        std::mem::take(&mut self.read_errors)
    }

    /// Takes in what has arrived, and says what of `meshes` a frame may draw. Those with files are streamed from now on:
    /// what must always be there of a new one is read at once. Those that are not among `meshes` are forgotten. Without
    /// `wait`, what enters is bounded, so that no frame takes long for it.
    pub fn resident<'a>(
        &mut self,
        meshes: impl Iterator<Item = &'a Arc<Dag>>,
        wait: bool,
        proceed: InterruptCheck<'_>,
    ) -> Result<Resident> {
        self.start_anew();
        let mut seen = BTreeSet::new();
        let mut new = Vec::new();
        for dag in meshes {
            if let Some(source) = dag.pages.source()
                && seen.insert(dag.id.number())
                && !self.meshes.iter().any(|mesh| mesh.dag.id.number() == dag.id.number())
            {
                new.push((Arc::clone(dag), Arc::clone(source)));
            }
        }
        for gone in self.meshes.extract_if(.., |mesh| !seen.contains(&mesh.dag.id.number())) {
            self.pool.detach(gone.number);
        }
        for (dag, source) in new {
            self.attach(dag, source, proceed)?;
        }
        self.collect();
        self.pool.enter(if wait { u64::MAX } else { ENTER_BYTES });
        self.apply();
        let roots: usize = self.meshes.iter().map(|mesh| mesh.roots).sum();
        let held = self.pool.resident() - roots;
        let places = (self.pool.budget() - self.pool.root_bytes()) / PAGE_MAX_BYTES as u64;
        let mut out = Resident { held, most: held.max(places as usize), ..Resident::default() };
        for mesh in &self.meshes {
            out.set(&mesh.dag, Arc::clone(&mesh.pages));
        }
        Ok(out)
    }

    /// In a process that was forked, threads stay behind, and so does what they read.
    fn start_anew(&mut self) {
        if self.loader.is_inherited() {
            self.loader = loader(&self.clock);
            self.asked = 0;
            self.pool.take_all_back();
        }
    }

    fn attach(
        &mut self,
        dag: Arc<Dag>,
        source: Arc<dyn PageSource>,
        proceed: InterruptCheck<'_>,
    ) -> Result<()> {
        let traffic_before = source.traffic();
        let count = dag.root_pages();
        let bytes = |page: usize| match self.equal_pages && page >= count {
            true => PAGE_MAX_BYTES as u64,
            false => u64::from(dag.pages.table[page].words) * size_of::<u32>() as u64,
        };
        let page = |page: usize| (bytes(page), source.dependencies(page).to_vec());
        let pages: Vec<(u64, Vec<u32>)> = (0..dag.pages.table.len()).map(page).collect();
        let least: u64 = pages[..count].iter().map(|page| page.0).sum();
        let mut roots: Vec<(u32, PageWords)> = Vec::new();
        let numbers = (0..count).collect();
        read_pages(&source, numbers, proceed, |page, words| roots.push((page as u32, words)))?;
        if self.pool.used() + least > self.pool.budget() {
            // What is being read cannot leave before it is here.
            self.take_back();
            self.wait(proceed)?;
        }
        let Some(number) = self.pool.attach(pages, roots) else {
            let message = format!(
                "the pool has {} bytes; the root pages of the meshes of the scene, which are always there, take {} more \
                 than are left",
                self.pool.budget(),
                least
            );
            return Err(Error::argument("pool_bytes", message));
        };
        self.generations += 1;
        let pages = Arc::new(Pages::absent(Arc::clone(&dag.pages.table), dag.layout()));
        let generation = self.generations;
        let failing = BTreeMap::new();
        self.meshes.push(Mesh {
            dag,
            source,
            number,
            generation,
            pages,
            roots: count,
            failing,
            traffic_before,
        });
        Ok(())
    }

    /// Takes in what has arrived.
    fn collect(&mut self) {
        let arrivals: Vec<Arrival<Tag>> = self.loader.arrivals().collect();
        arrivals.into_iter().for_each(|arrival| self.take(arrival));
    }

    fn take(&mut self, Arrival { request, words }: Arrival<Tag>) {
        self.asked -= 1;
        let LoadRequest { tag: Tag { ask, generation }, retry, .. } = request;
        let Some(mesh) = self.meshes.iter_mut().find(|mesh| mesh.generation == generation) else { return };
        match words {
            Ok(words) => {
                mesh.failing.remove(&ask.page);
                self.arrived += 1;
                self.pool.arrived(ask, words);
            }
            Err(error) => {
                let failing = mesh.failing.entry(ask.page).or_default();
                failing.retry = retry;
                self.pool.failed(ask);
                if !std::mem::replace(&mut failing.told, true) {
                    self.fault_count += 1;
                    self.read_errors.push(Fault { message: error.to_string() });
                }
            }
        }
    }

    /// What could not be read may be asked for again where its pause is over.
    fn retry(&mut self) {
        let now = self.clock.now();
        for mesh in &self.meshes {
            let over = |failing: &Failing| failing.told && failing.retry.pause(now).is_zero();
            let pages = mesh.failing.iter().filter(|(_, failing)| over(failing));
            pages.for_each(|(page, _)| self.pool.retry(Ask { mesh: mesh.number, page: *page }));
        }
    }

    /// Brings what frames look at up to date with the pool.
    fn apply(&mut self) {
        for change in self.pool.changes() {
            let (ask, words) = match change {
                Change::Enter(ask, words) => (ask, Some(words)),
                Change::Leave(ask) => (ask, None),
            };
            if let Some(mesh) = self.meshes.iter_mut().find(|mesh| mesh.number == ask.mesh) {
                Arc::make_mut(&mut mesh.pages).set(ask.page as usize, words);
            }
        }
    }

    /// Asks for what a frame needed. Says what it had, and what happened since the frame before.
    pub fn request(&mut self, needs: &Needs) -> Result<StreamStats> {
        // Once for a frame: one that waits ends, whatever goes on failing.
        if self.draws == 0 {
            self.retry();
        }
        self.draws += 1;
        self.take_back();
        let needed: Vec<_> = self.meshes.iter().map(|mesh| (mesh.number, needs.of(&mesh.dag))).collect();
        let (resident, used) = (self.pool.resident(), self.pool.used());
        let Plan { load, needed: count, missing, refused } = self.pool.request(&needed);
        let request = |ask: &Ask| {
            let mesh = self.meshes.iter().find(|mesh| mesh.number == ask.mesh)?;
            Some(LoadRequest {
                source: Arc::clone(&mesh.source),
                page: ask.page as usize,
                tag: Tag { ask: *ask, generation: mesh.generation },
                retry: mesh.failing.get(&ask.page).map(|failing| failing.retry).unwrap_or_default(),
            })
        };
        let requests: Vec<LoadRequest<Tag>> = load.iter().filter_map(request).collect();
        self.asked += requests.len();
        self.loader.submit(requests)?;
        Ok(StreamStats {
            resident_pages: resident as u64,
            pool_bytes: used,
            needed_pages: count as u64,
            missing_pages: missing as u64,
            refused_pages: refused as u64,
            arrived_pages: self.arrived,
            evicted_pages: self.pool.evicted() - self.evicted_before,
            read_errors: self.fault_count,
            coarsest_pixels: needs.coarsest,
            draws: self.draws,
            traffic: self.traffic(),
        })
    }

    /// What reading has cost since the frame before.
    fn traffic(&self) -> Traffic {
        let of = |mesh: &Mesh| mesh.source.traffic().since(mesh.traffic_before);
        self.meshes.iter().map(of).fold(Traffic::default(), Traffic::plus)
    }

    /// What no source was asked for yet is not asked for any more.
    fn take_back(&mut self) {
        for LoadRequest { tag: Tag { ask, generation }, retry, .. } in self.loader.take_back() {
            self.asked -= 1;
            if let Some(mesh) = self.meshes.iter_mut().find(|mesh| mesh.generation == generation) {
                self.pool.take_back(ask);
                if retry != Retry::default() {
                    mesh.failing.entry(ask.page).or_default().retry = retry;
                }
            }
        }
    }

    /// A frame is done: what is counted from frame to frame starts again.
    pub fn finish(&mut self) {
        (self.arrived, self.draws, self.evicted_before) = (0, 0, self.pool.evicted());
        self.meshes.iter_mut().for_each(|mesh| mesh.traffic_before = mesh.source.traffic());
    }

    /// Waits until all that was asked for has arrived, or cannot be read. Where it does not go on, what has not yet comes
    /// later.
    pub fn wait(&mut self, proceed: InterruptCheck<'_>) -> Result<()> {
        while self.asked > 0 {
            let arrival = self.loader.wait(proceed)?;
            self.take(arrival);
        }
        Ok(())
    }
}

fn loader(clock: &Clock) -> Own<Loader<Tag>> {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(MOST_THREADS));
    Own::new(Loader::new(threads, clock.clone()))
}
