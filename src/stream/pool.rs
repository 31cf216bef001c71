//! Which pages are in memory: a budget of bytes, of which those get a place that make the largest difference.
//!
//! Three rules hold at every moment, and tests check them after every step:
//!
//! - what is resident, waits or is being read takes no more bytes than the budget;
//! - a page is resident only while all that it depends on are, so that a cut neither overlaps nor cracks;
//! - what a frame needs and has room is not evicted; of the rest the least recently needed goes first.
//!
//! A page is needed as much as the finest that depends on it, so that dependencies are admitted before dependents and
//! evicted after them by the same order. The pool is a plain value: it neither reads nor waits.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;

use super::request::Request;
use crate::model::PageWords;

/// A page of one of the pool's meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ask {
    /// Number of the mesh in the pool.
    pub mesh: u32,
    /// Its page.
    pub page: u32,
}

#[derive(Clone, Debug, Default)]
enum State {
    #[default]
    Absent,
    /// Asked of the loader.
    Asked,
    /// In memory, while something it depends on is not.
    Waiting(PageWords),
    /// May be drawn.
    Resident,
    /// Could not be read, and is done without until it is tried again.
    Failed,
}

#[derive(Clone, Debug, Default)]
struct Page {
    state: State,
    bytes: u64,
    dependencies: Vec<u32>,
    /// When it was last needed and had room.
    needed: u64,
    /// Resident pages that depend on it.
    dependents: u32,
    /// Always there.
    root: bool,
}

/// What happened to residency since it was last looked at.
#[derive(Clone, Debug)]
pub enum Change {
    /// The page may be drawn now.
    Enter(Ask, PageWords),
    /// It may not any more.
    Leave(Ask),
}

/// What became of a frame's requests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// To be read, what matters most first.
    pub load: Vec<Ask>,
    /// Pages needed, with all they depend on, but for those that could not be read.
    pub needed: usize,
    /// Of these, those that are not resident.
    pub missing: usize,
    /// Of these, those that the budget has no room for.
    pub refused: usize,
}

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct Pool {
    budget: u64,
    used: u64,
    /// By number; those that left are empty.
    meshes: Vec<Vec<Page>>,
    /// Frames so far.
    clock: u64,
    /// Whatever may be evicted: when it was last needed, larger page numbers first, which depend on smaller ones.
    order: BTreeSet<(u64, Reverse<u32>, u32)>,
    /// Waiting pages, in the order in which they could enter.
    waiting: BTreeSet<Ask>,
    changes: Vec<Change>,
    evicted: u64,
    /// Pages that may be drawn.
    resident: usize,
    /// Bytes of those that are always there.
    root_bytes: u64,
}

impl Pool {
    /// An empty pool of so many bytes.
    pub fn new(budget: u64) -> Self {
        Self { budget, ..Self::default() }
    }

    /// Bytes of all that is resident, waits or was asked for.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// Bytes there may be.
    pub fn budget(&self) -> u64 {
        self.budget
    }

    /// Bytes of the pages that are always there.
    pub fn root_bytes(&self) -> u64 {
        self.root_bytes
    }

    /// Pages evicted so far.
    pub fn evicted(&self) -> u64 {
        self.evicted
    }

    /// Pages that may be drawn.
    pub fn resident(&self) -> usize {
        self.resident
    }

    /// Whether a page may be drawn.
    pub fn holds(&self, ask: Ask) -> bool {
        matches!(self.page(ask).state, State::Resident)
    }

    fn page(&self, Ask { mesh, page }: Ask) -> &Page {
        &self.meshes[mesh as usize][page as usize]
    }

    fn page_mut(&mut self, Ask { mesh, page }: Ask) -> &mut Page {
        &mut self.meshes[mesh as usize][page as usize]
    }

    /// Adds a mesh: bytes and dependencies of each page, and the words of those that are always there. Returns its
    /// number; nothing where the pool cannot hold these.
    pub fn attach(&mut self, pages: Vec<(u64, Vec<u32>)>, roots: Vec<(u32, PageWords)>) -> Option<u32> {
        let bytes: u64 = roots.iter().map(|(page, _)| pages[*page as usize].0).sum();
        self.make_room(bytes, u64::MAX);
        if self.used + bytes > self.budget {
            return None;
        }
        let new = |(bytes, dependencies)| Page { bytes, dependencies, ..Page::default() };
        let pages = pages.into_iter().map(new).collect();
        let free = self.meshes.iter().position(Vec::is_empty);
        let mesh = free.unwrap_or(self.meshes.len());
        match free {
            Some(mesh) => self.meshes[mesh] = pages,
            None => self.meshes.push(pages),
        }
        let mesh = mesh as u32;
        for (page, words) in roots {
            let ask = Ask { mesh, page };
            self.used += self.page(ask).bytes;
            self.root_bytes += self.page(ask).bytes;
            self.page_mut(ask).root = true;
            self.waiting.insert(ask);
            self.page_mut(ask).state = State::Waiting(words);
        }
        self.enter(u64::MAX);
        Some(mesh)
    }

    /// Forgets a mesh; what is still read of it is dropped when it arrives.
    pub fn detach(&mut self, mesh: u32) {
        let pages = std::mem::take(&mut self.meshes[mesh as usize]);
        for (page, number) in pages.iter().zip(0..) {
            self.order.remove(&(page.needed, Reverse(number), mesh));
            self.waiting.remove(&Ask { mesh, page: number });
            self.used -= if matches!(page.state, State::Absent | State::Failed) { 0 } else { page.bytes };
            self.resident -= usize::from(matches!(page.state, State::Resident));
            self.root_bytes -= if page.root { page.bytes } else { 0 };
        }
        self.changes.retain(|change| {
            let (Change::Enter(ask, _) | Change::Leave(ask)) = change;
            ask.mesh != mesh
        });
    }

    /// What entered and left since this was last called.
    pub fn changes(&mut self) -> Vec<Change> {
        std::mem::take(&mut self.changes)
    }

    /// A page was asked for, but nobody has begun to read it.
    pub fn take_back(&mut self, ask: Ask) {
        self.drop_asked(ask, State::Absent);
    }

    /// Of all that was asked for nothing will come.
    pub fn take_all_back(&mut self) {
        for page in self.meshes.iter_mut().flatten().filter(|page| matches!(page.state, State::Asked)) {
            self.used -= page.bytes;
            page.state = State::Absent;
        }
    }

    /// A page that was asked for could not be read: it is done without until [`Pool::retry`].
    pub fn failed(&mut self, ask: Ask) {
        self.drop_asked(ask, State::Failed);
    }

    /// A page that could not be read may be asked for again.
    pub fn retry(&mut self, ask: Ask) {
        let page = self.page_mut(ask);
        if matches!(page.state, State::Failed) {
            page.state = State::Absent;
        }
    }

    fn drop_asked(&mut self, ask: Ask, state: State) {
        let Some(page) = self.meshes.get_mut(ask.mesh as usize).and_then(|m| m.get_mut(ask.page as usize))
        else {
            return;
        };
        if matches!(page.state, State::Asked) {
            self.used -= page.bytes;
            page.state = state;
        }
    }

    /// A page that was asked for is here.
    pub fn arrived(&mut self, ask: Ask, words: PageWords) {
        let Some(page) = self.meshes.get_mut(ask.mesh as usize).and_then(|m| m.get_mut(ask.page as usize))
        else {
            return;
        };
        if matches!(page.state, State::Asked) {
            page.state = State::Waiting(words);
            self.order.insert((page.needed, Reverse(ask.page), ask.mesh));
            self.waiting.insert(ask);
        }
    }

    /// Lets those enter that wait and whose dependencies are resident, up to so many bytes of them. Smaller numbers come
    /// first, so that once through is enough.
    pub fn enter(&mut self, mut most: u64) {
        let mut next = self.waiting.first().copied();
        while let Some(ask) = next {
            next = self.waiting.range((Bound::Excluded(ask), Bound::Unbounded)).next().copied();
            let page = self.page(ask);
            let there = |&page: &u32| self.holds(Ask { page, ..ask });
            if !page.dependencies.iter().all(there) {
                continue;
            }
            let Some(rest) = most.checked_sub(page.bytes) else { return };
            most = rest;
            let State::Waiting(words) = std::mem::replace(&mut self.page_mut(ask).state, State::Resident)
            else {
                continue;
            };
            for k in 0..self.page(ask).dependencies.len() {
                let page = self.page(ask).dependencies[k];
                self.page_mut(Ask { page, ..ask }).dependents += 1;
            }
            self.resident += 1;
            self.waiting.remove(&ask);
            self.changes.push(Change::Enter(ask, words));
        }
    }

    /// Evicts what was last needed before a time until so many more bytes fit, as far as there is something.
    fn make_room(&mut self, bytes: u64, before: u64) {
        let mut kept = BTreeSet::new();
        while self.used + bytes > self.budget {
            let Some(&(needed, Reverse(page), mesh)) = self.order.first() else { break };
            if needed >= before {
                break;
            }
            self.order.pop_first();
            let ask = Ask { mesh, page };
            if self.page(ask).root || self.page(ask).dependents > 0 {
                kept.insert((needed, Reverse(page), mesh));
                continue;
            }
            self.used -= self.page(ask).bytes;
            self.evicted += 1;
            if let State::Resident = std::mem::take(&mut self.page_mut(ask).state) {
                for k in 0..self.page(ask).dependencies.len() {
                    let page = self.page(ask).dependencies[k];
                    self.page_mut(Ask { page, ..ask }).dependents -= 1;
                }
                self.resident -= 1;
                self.changes.push(Change::Leave(ask));
            }
            self.waiting.remove(&ask);
        }
        self.order.append(&mut kept);
    }

    /// Takes what a frame needs: for each mesh its pages, ascending. The most needed get room, and of these what is
    /// absent is to be read.
    pub fn request(&mut self, needs: &[(u32, Vec<Request>)]) -> Plan {
        self.clock += 1;
        let mut wanted = Vec::new();
        for (mesh, requests) in needs {
            self.with_dependencies(*mesh, requests, &mut wanted);
        }
        // Dependencies are needed as much and have smaller numbers.
        wanted.sort_unstable_by(|(a, x), (b, y)| y.total_cmp(x).then(a.cmp(b)));
        let mut plan = Plan::default();
        let mut bytes = self.root_bytes;
        let mut full = false;
        let mut absent = Vec::new();
        for (ask, pixels) in wanted {
            let clock = self.clock;
            let page = self.page(ask);
            let there = matches!(page.state, State::Resident);
            let lacks = !there && pixels > 0.0;
            plan.needed += usize::from(pixels > 0.0);
            plan.missing += usize::from(lacks);
            if !page.root {
                // What is only expected leaves room for what nobody expects.
                let budget = if pixels > 0.0 { self.budget } else { self.budget / 2 };
                full |= bytes + page.bytes > budget;
                if full {
                    plan.refused += usize::from(lacks);
                    continue;
                }
                bytes += page.bytes;
            }
            if self.order.remove(&(page.needed, Reverse(ask.page), ask.mesh)) {
                self.order.insert((clock, Reverse(ask.page), ask.mesh));
            } else if matches!(self.page(ask).state, State::Absent) {
                absent.push(ask);
            }
            self.page_mut(ask).needed = clock;
        }
        for ask in absent {
            let bytes = self.page(ask).bytes;
            self.make_room(bytes, self.clock);
            // What is read for an earlier frame may still take the room.
            if self.used + bytes > self.budget {
                break;
            }
            self.used += bytes;
            self.page_mut(ask).state = State::Asked;
            plan.load.push(ask);
        }
        plan
    }

    /// Adds pages with all they depend on, each needed as much as the most needed that depends on it; without those
    /// that could not be read, or depend on such.
    fn with_dependencies(&self, mesh: u32, requests: &[Request], out: &mut Vec<(Ask, f32)>) {
        let mut all: BTreeMap<u32, f32> = requests.iter().map(|r| (r.page, r.pixels)).collect();
        let mut found = Vec::new();
        while let Some((page, pixels)) = all.pop_last() {
            let ask = Ask { mesh, page };
            for dependency in &self.page(ask).dependencies {
                let most = all.entry(*dependency).or_insert(pixels);
                *most = most.max(pixels);
            }
            found.push((ask, pixels));
        }
        // From dependencies to dependents.
        let mut unreadable = BTreeSet::new();
        for (ask, pixels) in found.into_iter().rev() {
            let page = self.page(ask);
            let failed = matches!(page.state, State::Failed);
            if failed || page.dependencies.iter().any(|dependency| unreadable.contains(dependency)) {
                unreadable.insert(ask.page);
            } else {
                out.push((ask, pixels));
            }
        }
    }

    /// The three rules; what breaks them.
    pub fn check(&self) -> Result<(), String> {
        let mut used = 0;
        for (mesh, pages) in self.meshes.iter().enumerate() {
            let mut dependents = vec![0; pages.len()];
            for (number, page) in pages.iter().enumerate() {
                used += if matches!(page.state, State::Absent | State::Failed) { 0 } else { page.bytes };
                if matches!(page.state, State::Resident) {
                    for dependency in &page.dependencies {
                        dependents[*dependency as usize] += 1;
                        if !matches!(pages[*dependency as usize].state, State::Resident) {
                            return Err(format!(
                                "page {number} of mesh {mesh} is resident, {dependency} is not"
                            ));
                        }
                    }
                } else if page.root {
                    return Err(format!("root page {number} of mesh {mesh} is not resident"));
                }
            }
            let counted = pages.iter().map(|page| page.dependents);
            if !counted.eq(dependents) {
                return Err(format!("dependents of mesh {mesh} are miscounted"));
            }
        }
        let resident = |page: &&Page| matches!(page.state, State::Resident);
        let resident = self.meshes.iter().flatten().filter(resident).count();
        if resident != self.resident {
            return Err(format!("{resident} pages are resident, counted {}", self.resident));
        }
        if used != self.used || used > self.budget {
            return Err(format!("{used} bytes, counted {}, of {}", self.used, self.budget));
        }
        Ok(())
    }
}
