//! Slots addressed by index and generation: adding, changing and removing one entry touches no other.

use crate::error::{Error, Result};

/// Names one entry for as long as it lives. The index is reused after removal, the pair never is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Handle {
    /// Slot number.
    pub index: u32,
    /// How often the slot was given away before.
    pub generation: u32,
}

#[derive(Clone, Debug)]
struct Slot<T> {
    generation: u32,
    value: Option<T>,
}

/// A growable set of entries with stable handles.
#[derive(Clone, Debug)]
pub struct Slots<T> {
    slots: Vec<Slot<T>>,
    /// When each slot's entry was last added, lent for a change or removed: apart, so that asking touches no entry.
    changed: Vec<u64>,
    free: Vec<u32>,
    /// Slots in use.
    used: usize,
    /// What an entry is called in messages.
    noun: &'static str,
    /// Changes so far.
    clock: u64,
}

impl<T> Slots<T> {
    /// An empty set; `noun` names an entry in errors.
    pub fn new(noun: &'static str) -> Self {
        Self { slots: Vec::new(), changed: Vec::new(), free: Vec::new(), used: 0, noun, clock: 0 }
    }

    /// Number of entries.
    pub fn len(&self) -> usize {
        self.used
    }

    /// True when there is no entry.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One more than the largest slot number in use so far.
    pub fn capacity(&self) -> usize {
        self.slots.len()
    }

    /// Adds an entry in the slot that was freed last, or in a new one.
    pub fn insert(&mut self, value: T) -> Result<Handle> {
        self.clock += 1;
        self.used += 1;
        if let Some(index) = self.free.pop() {
            self.changed[index as usize] = self.clock;
            let slot = &mut self.slots[index as usize];
            slot.value = Some(value);
            return Ok(Handle { index, generation: slot.generation });
        }
        let index = u32::try_from(self.slots.len())
            .map_err(|_| Error::TooLarge(format!("a scene holds at most 2³² of {}", self.noun)))?;
        self.slots.push(Slot { generation: 0, value: Some(value) });
        self.changed.push(self.clock);
        Ok(Handle { index, generation: 0 })
    }

    /// Puts an entry, or nothing, where the caller wants it: in a set that follows another, which nothing is inserted into.
    pub fn put(&mut self, Handle { index, generation }: Handle, value: Option<T>) {
        self.clock += 1;
        let at = index as usize;
        if self.slots.len() <= at {
            self.slots.resize_with(at + 1, || Slot { generation: 0, value: None });
            self.changed.resize(at + 1, 0);
        }
        self.changed[at] = self.clock;
        let slot = &mut self.slots[at];
        self.used = self.used + usize::from(value.is_some()) - usize::from(slot.value.is_some());
        *slot = Slot { generation, value };
    }

    /// The handle of what is in a slot, or was last.
    pub fn handle(&self, index: u32) -> Handle {
        Handle { index, generation: self.slots.get(index as usize).map_or(0, |slot| slot.generation) }
    }

    fn stale(&self, handle: Handle) -> Error {
        Error::StaleHandle(format!("{} {} (generation {})", self.noun, handle.index, handle.generation))
    }

    /// The entry of a handle.
    pub fn get(&self, handle: Handle) -> Result<&T> {
        self.slots
            .get(handle.index as usize)
            .filter(|slot| slot.generation == handle.generation)
            .and_then(|slot| slot.value.as_ref())
            .ok_or_else(|| self.stale(handle))
    }

    /// The entry of a handle, to be changed.
    pub fn get_mut(&mut self, handle: Handle) -> Result<&mut T> {
        self.get(handle)?;
        let noun = self.noun;
        self.clock += 1;
        self.changed[handle.index as usize] = self.clock;
        self.slots[handle.index as usize]
            .value
            .as_mut()
            .ok_or_else(|| Error::StaleHandle(format!("{noun} {}", handle.index)))
    }

    /// Removes an entry; its handle is stale from now on.
    pub fn remove(&mut self, handle: Handle) -> Result<T> {
        self.get(handle)?;
        self.clock += 1;
        self.changed[handle.index as usize] = self.clock;
        self.used -= 1;
        let slot = &mut self.slots[handle.index as usize];
        let value = slot.value.take();
        // A slot whose generations are used up is retired: it is never given away again.
        if let Some(next) = slot.generation.checked_add(1) {
            slot.generation = next;
            self.free.push(handle.index);
        }
        value.ok_or_else(|| self.stale(handle))
    }

    /// Changes so far: what [`Slots::changed_since`] is asked with later.
    pub fn clock(&self) -> u64 {
        self.clock
    }

    /// Slots that changed after a time, with what is in them now.
    pub fn changed_since(&self, clock: u64) -> impl Iterator<Item = (u32, Option<&T>)> {
        // Mostly none.
        let changed = if self.clock > clock { &self.changed[..] } else { &[] };
        let slots = changed.iter().zip(0..).filter(move |(changed, _)| **changed > clock);
        slots.map(|(_, index)| (index, self.slots[index as usize].value.as_ref()))
    }

    /// The entry in a slot, if the slot is in use.
    pub fn at(&self, index: usize) -> Option<&T> {
        self.slots.get(index).and_then(|slot| slot.value.as_ref())
    }

    /// All entries with their slot numbers, in slot order.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &T)> {
        self.slots.iter().enumerate().filter_map(|(i, s)| s.value.as_ref().map(|v| (i as u32, v)))
    }

    /// The handles of all entries, in slot order.
    pub fn handles(&self) -> impl Iterator<Item = Handle> + '_ {
        self.slots
            .iter()
            .enumerate()
            .filter(|(_, s)| s.value.is_some())
            .map(|(i, s)| Handle { index: i as u32, generation: s.generation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reused_slot_does_not_answer_to_the_old_handle() {
        let mut slots = Slots::new("thing");
        let (a, b) = (slots.insert('a').unwrap(), slots.insert('b').unwrap());
        assert_eq!(slots.remove(a).unwrap(), 'a');
        let c = slots.insert('c').unwrap();
        assert_eq!(c.index, a.index);
        assert!(matches!(slots.get(a), Err(Error::StaleHandle(_))));
        assert!(matches!(slots.remove(a), Err(Error::StaleHandle(_))));
        assert_eq!((*slots.get(b).unwrap(), *slots.get(c).unwrap()), ('b', 'c'));
        assert!(slots.get(Handle { index: 9, generation: 0 }).is_err());
        assert_eq!(slots.len(), 2);
        assert_eq!(slots.iter().map(|(_, v)| *v).collect::<Vec<_>>(), ['c', 'b']);
    }
}
