//! What is kept of views from frame to frame, by their ids.

use rustc_hash::FxHashMap;

use crate::limits::MAX_HISTORIES;

/// What is kept of each view, found by its id.
#[derive(Clone, Debug)]
pub struct Histories<T>(FxHashMap<u64, T>);

impl<T> Default for Histories<T> {
    fn default() -> Self {
        Self(FxHashMap::default())
    }
}

impl<T> Histories<T> {
    /// That of a view, if there is one.
    pub fn get(&self, id: u64) -> Option<&T> {
        self.0.get(&id)
    }

    /// That of a view, made where there is none. An error leaves all as it was.
    pub fn get_or_make<E>(&mut self, id: u64, make: impl FnOnce() -> Result<T, E>) -> Result<&mut T, E> {
        Ok(match self.0.entry(id) {
            std::collections::hash_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::hash_map::Entry::Vacant(place) => place.insert(make()?),
        })
    }

    /// All of them, in any order.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.0.values_mut()
    }

    /// Takes out those of views, in their order.
    pub fn take(&mut self, ids: impl IntoIterator<Item = u64>) -> Vec<T> {
        ids.into_iter().filter_map(|id| self.0.remove(&id)).collect()
    }

    /// Puts them back.
    pub fn give(&mut self, histories: impl IntoIterator<Item = (u64, T)>) {
        self.0.extend(histories);
    }

    /// Where more than [`MAX_HISTORIES`] are kept, those stay that these views have.
    pub fn trim(&mut self, ids: impl Iterator<Item = u64> + Clone) {
        if self.0.len() > MAX_HISTORIES {
            self.0.retain(|id, _| ids.clone().any(|own| own == *id));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_are_kept_leaves_those_of_the_call() {
        let mut histories = Histories::default();
        let all = 0..MAX_HISTORIES as u64 + 1;
        histories.give(all.clone().take(MAX_HISTORIES).map(|id| (id, id)));
        histories.trim(3..5);
        assert_eq!(histories.get(MAX_HISTORIES as u64 - 1), Some(&(MAX_HISTORIES as u64 - 1)));
        assert_eq!(histories.get_or_make(all.end - 1, || Err("none")), Err("none"));
        assert_eq!(histories.get_or_make(all.end - 1, || Ok::<_, ()>(7)), Ok(&mut 7));
        histories.trim(3..5);
        assert_eq!((histories.get(3), histories.get(5)), (Some(&3), None));
        assert_eq!(histories.take([4, 9, 3]), [4, 3]);
    }
}
