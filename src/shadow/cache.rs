//! The pages that are kept, and what makes them wrong.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use rustc_hash::{FxHashMap, FxHashSet};

use super::map::{PageKey, ShadowMap};
use crate::limits::SHADOW_PAGE_TEXELS;
use crate::model::Pages;
use crate::scene::{Instance, Materials, Scene};
use crate::stream::Resident;

/// Bytes of a page.
pub const PAGE_BYTES: u64 = 4 * SHADOW_PAGE_TEXELS as u64;

/// What a page shows of an instance changes with this.
#[derive(Clone, Debug, PartialEq)]
struct Caster {
    mesh: u64,
    pose: DAffine3,
    sphere: (DVec3, f64),
    /// What says where it has holes, or where it is blended, if it is anywhere.
    holes: Option<Materials>,
}

impl Caster {
    /// Of an instance that throws a shadow.
    fn new(instance: &Instance) -> Option<Self> {
        let casts = instance.visible && instance.casts_shadows();
        casts.then(|| Self {
            mesh: instance.mesh.id.number(),
            pose: *instance.pose(),
            sphere: instance.sphere(),
            holes: (instance.materials.alpha_tested_bits() != 0 || instance.blends())
                .then(|| instance.materials.clone()),
        })
    }
}

#[derive(Debug)]
struct Page<P> {
    texels: P,
    /// Nothing in it stands in for pages of streamed meshes that were not there: it stays right while those come and go.
    whole: bool,
    /// What mattered to none of the receivers that it was drawn for may be missing: no later frame looks it up. What it hides
    /// from the light stays hidden.
    partial: bool,
    /// Number of the last frame that wanted it.
    wanted: u64,
}

/// Pages of shadow maps, kept from frame to frame, whatever they are held by.
#[derive(Debug)]
pub struct ShadowCache<P> {
    pages: FxHashMap<PageKey, Page<P>>,
    /// The scene and its clock when pages were right.
    known: Option<(u64, u64)>,
    /// By slot.
    casters: Vec<Option<Caster>>,
    /// By slots of lights.
    maps: FxHashMap<u32, ShadowMap>,
    /// Which pages of streamed meshes were there.
    resident: FxHashMap<u64, Arc<Pages>>,
    frame: u64,
}

impl<P> Default for ShadowCache<P> {
    fn default() -> Self {
        Self {
            pages: FxHashMap::default(),
            known: None,
            casters: Vec::new(),
            maps: FxHashMap::default(),
            resident: FxHashMap::default(),
            frame: 0,
        }
    }
}

impl<P: Clone> ShadowCache<P> {
    /// Forgets everything.
    fn clear(&mut self) {
        *self = Self { frame: self.frame, ..Self::default() };
    }

    /// Begins a frame of a scene: drops pages that are wrong by now, and no others. Returns how many.
    pub fn update(&mut self, scene: &Scene, maps: &FxHashMap<u32, ShadowMap>, resident: &Resident) -> u64 {
        self.frame += 1;
        let before = self.pages.len();
        let clock = match self.known {
            Some((identity, clock)) if identity == scene.identity() => clock,
            _ => {
                self.clear();
                0
            }
        };
        self.pages.retain(|key, _| maps.get(&key.light) == self.maps.get(&key.light));
        self.maps.clone_from(maps);
        let mut stale: Vec<(DVec3, f64)> = Vec::new();
        let slots = scene.instances();
        self.casters.resize(slots.capacity(), None);
        for (slot, instance) in slots.changed_since(clock) {
            let (old, new) = (&mut self.casters[slot as usize], instance.and_then(Caster::new));
            if *old != new {
                stale.extend(old.iter().chain(&new).map(|caster| caster.sphere));
                *old = new;
            }
        }
        self.known = Some((scene.identity(), slots.clock()));
        let streamed = self.note_residents(scene, resident);
        let maps = &self.maps;
        self.pages.retain(|key, page| {
            let touched = |spheres: &[(DVec3, f64)]| {
                spheres.iter().any(|(center, radius)| maps[&key.light].touches(key, *center, *radius))
            };
            !(touched(&stale) || (!page.whole && touched(&streamed)))
        });
        (before - self.pages.len()) as u64
    }

    /// Where instances are of meshes of which other pages are there than before.
    fn note_residents(&mut self, scene: &Scene, resident: &Resident) -> Vec<(DVec3, f64)> {
        let mut changed = FxHashSet::default();
        let mut now = FxHashMap::default();
        for (_, instance) in scene.instances().iter().filter(|(_, instance)| resident.streams(&instance.mesh))
        {
            let (id, pages) = (instance.mesh.id.number(), resident.pages(&instance.mesh));
            if self.resident.get(&id).is_none_or(|known| !Arc::ptr_eq(known, pages)) {
                changed.insert(id);
            }
            now.entry(id).or_insert_with(|| Arc::clone(pages));
        }
        self.resident = now;
        let casters = self.casters.iter().flatten().filter(|caster| changed.contains(&caster.mesh));
        casters.map(|caster| caster.sphere).collect()
    }

    /// Takes note that pages are wanted; returns those that are to be drawn, in their order.
    pub fn want(&mut self, keys: &[PageKey]) -> Vec<PageKey> {
        let frame = self.frame;
        let missing = keys.iter().filter(|key| match self.pages.get_mut(*key) {
            Some(page) => {
                page.wanted = frame;
                page.partial
            }
            None => true,
        });
        missing.copied().collect()
    }

    /// Makes room for pages that are to be drawn where there may be `most`: those go that nobody wanted for longest. Returns how
    /// many.
    pub fn make_room(&mut self, missing: &[PageKey], most: usize) -> u64 {
        let more = missing.iter().filter(|key| !self.pages.contains_key(key)).count();
        let over = (self.pages.len() + more).saturating_sub(most);
        if over == 0 {
            return 0;
        }
        let mut old: Vec<(u64, PageKey)> = self
            .pages
            .iter()
            .filter(|(_, page)| page.wanted < self.frame)
            .map(|(key, page)| (page.wanted, *key))
            .collect();
        old.sort_unstable();
        old.truncate(over);
        old.iter().for_each(|(_, key)| drop(self.pages.remove(key)));
        old.len() as u64
    }

    /// Keeps a page that was drawn; `whole` where nothing stands in it for what is not there, and `partial` where nothing was
    /// drawn but what matters to this frame.
    pub fn insert(&mut self, key: PageKey, texels: P, whole: bool, partial: bool) {
        self.pages.insert(key, Page { texels, whole, partial, wanted: self.frame });
    }

    /// The texels of a page.
    pub fn page(&self, key: &PageKey) -> Option<&P> {
        self.pages.get(key).map(|page| &page.texels)
    }

    /// What all pages are held by, in any order.
    pub fn held(&self) -> Vec<P> {
        self.pages.values().map(|page| page.texels.clone()).collect()
    }

    /// Pages that are kept.
    pub fn len(&self) -> usize {
        self.pages.len()
    }

    /// Whether none is.
    pub fn is_empty(&self) -> bool {
        self.pages.is_empty()
    }
}
