//! The queue of edges: a 4-ary heap that knows where each edge stands, so that costs change in place.

const ABSENT: u32 = u32::MAX;
const ARITY: usize = 4;

/// Edges by cost, then by number: the order never depends on how the queue came about.
#[derive(Debug, Default)]
pub struct Queue {
    /// The bits of the cost, which order like the cost as it is not negative, above the number of the edge.
    keys: Vec<u64>,
    /// Where each edge stands in `keys`.
    places: Vec<u32>,
}

impl Queue {
    /// An empty queue for edges below `edges`.
    pub fn reset(&mut self, edges: usize) {
        self.keys.clear();
        self.places.clear();
        self.places.resize(edges, ABSENT);
    }

    /// Makes room for edges below `edges`.
    pub fn extend(&mut self, edges: usize) {
        self.places.resize(edges.max(self.places.len()), ABSENT);
    }

    /// Puts an edge at its cost, whether it was there or not. A cost that is not a number counts as infinite.
    pub fn set(&mut self, edge: u32, cost: f32) {
        let cost = if cost.is_nan() { f32::INFINITY } else { cost.max(0.0) };
        let key = u64::from(cost.to_bits()) << 32 | u64::from(edge);
        match self.places[edge as usize] {
            ABSENT => {
                self.keys.push(key);
                self.up(self.keys.len() - 1, key);
            }
            place if key < self.keys[place as usize] => self.up(place as usize, key),
            place => self.down(place as usize, key),
        }
    }

    /// Takes an edge out, if it is there.
    pub fn remove(&mut self, edge: u32) {
        let place = std::mem::replace(&mut self.places[edge as usize], ABSENT);
        if place == ABSENT {
            return;
        }
        let place = place as usize;
        if let Some(last) = self.keys.pop()
            && place < self.keys.len()
        {
            if last < self.keys[place] { self.up(place, last) } else { self.down(place, last) }
        }
    }

    /// Whether an edge is in the queue.
    pub fn holds(&self, edge: u32) -> bool {
        self.places[edge as usize] != ABSENT
    }

    /// The cheapest edge and its cost; it stays.
    pub fn peek(&self) -> Option<(u32, f32)> {
        self.keys.first().map(|k| (*k as u32, f32::from_bits((*k >> 32) as u32)))
    }

    fn put(&mut self, place: usize, key: u64) {
        self.keys[place] = key;
        self.places[key as u32 as usize] = place as u32;
    }

    fn up(&mut self, mut place: usize, key: u64) {
        while place > 0 {
            let parent = (place - 1) / ARITY;
            if self.keys[parent] <= key {
                break;
            }
            self.put(place, self.keys[parent]);
            place = parent;
        }
        self.put(place, key);
    }

    fn down(&mut self, mut place: usize, key: u64) {
        loop {
            let first = ARITY * place + 1;
            let children = first..(first + ARITY).min(self.keys.len());
            let Some(least) = children.min_by_key(|c| self.keys[*c]) else { break };
            if self.keys[least] >= key {
                break;
            }
            self.put(place, self.keys[least]);
            place = least;
        }
        self.put(place, key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yields_in_order_after_any_changes() {
        let mut queue = Queue::default();
        queue.reset(200);
        let mut costs = [None; 200];
        let mut state = 1u32;
        for _ in 0..5000 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let (edge, cost) = ((state >> 8) % 200, (state >> 20) as f32);
            if state >> 30 == 0 {
                queue.remove(edge);
                costs[edge as usize] = None;
            } else {
                queue.set(edge, cost);
                costs[edge as usize] = Some(cost);
            }
            assert_eq!(queue.holds(edge), costs[edge as usize].is_some());
        }
        let mut left: Vec<_> =
            (0..200).filter_map(|e| costs[e as usize].map(|c: f32| (c.to_bits(), e))).collect();
        left.sort_unstable();
        for (cost, edge) in left {
            assert_eq!(queue.peek(), Some((edge, f32::from_bits(cost))));
            queue.remove(edge);
        }
        assert_eq!(queue.peek(), None);
        queue.set(3, f32::NAN);
        queue.set(4, -1.0);
        assert_eq!(queue.peek(), Some((4, 0.0)));
    }
}
