//! The triangles of a cluster in two to three bits each, where they come along a spiral (`build/order.rs`), and
//! without loss in any order.
//!
//! In the manner of Rossignac's Edgebreaker (IEEE TVCG 5(1), 1999): a triangle begins with a gate, an edge of an
//! earlier one, and its third corner is new, or one of the two neighbours of the gate along the front of what was
//! drawn so far. Where none of that holds it is written out, so no property of the triangles is relied on. Corners
//! refer to the cluster's vertices, which are numbered in the order of their first use.

use super::planes::Read;
use crate::limits::{CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES};

/// No vertex; among extra bytes a new one.
const NONE: u8 = u8::MAX;
const _: () = assert!(CLUSTER_MAX_VERTICES == NONE as usize);

/// The third corner is new.
const NEW: u8 = 0;
/// It is the vertex that follows the gate along the front.
const NEXT: u8 = 1;
/// It is the one before the gate.
const BEFORE: u8 = 2;
/// It is an extra byte.
const OTHER: u8 = 3;
/// Gates passed over, in units of this; from [`MANY`] on the number is an extra byte, before that of the corner.
const SKIP: u8 = 4;
/// See [`SKIP`].
const MANY: u8 = 3;
/// A triangle at no gate: three extra bytes.
const START: u8 = SKIP * (MANY + 1);

/// An edge where a triangle may begin, and the third corner of the triangle that it is an edge of.
type Gate = [u8; 3];

/// What coding and decoding know alike: open edges, as a stack and as a list along the front.
struct Front {
    next: [u8; 256],
    before: [u8; 256],
    gates: [Gate; 3 * CLUSTER_MAX_TRIANGLES],
    depth: usize,
}

impl Front {
    fn new() -> Self {
        let gates = [[0; 3]; 3 * CLUSTER_MAX_TRIANGLES];
        Self { next: [NONE; 256], before: [NONE; 256], gates, depth: 0 }
    }

    fn push(&mut self, [a, b, opposite]: Gate) {
        self.next[usize::from(a)] = b;
        self.before[usize::from(b)] = a;
        // A triangle leaves three at most, and there is room for those of all.
        if let Some(slot) = self.gates.get_mut(self.depth) {
            *slot = [a, b, opposite];
            self.depth += 1;
        }
    }

    fn is_open(&self, [a, b, _]: Gate) -> bool {
        self.next[usize::from(a)] == b && self.before[usize::from(b)] == a
    }

    /// The last open gate but `skip`, and those above it gone.
    fn pop(&mut self, mut skip: u8) -> Option<Gate> {
        while self.depth > 0 {
            self.depth -= 1;
            let gate = self.gates[self.depth];
            if self.is_open(gate) {
                if skip == 0 {
                    return Some(gate);
                }
                skip -= 1;
            }
        }
        None
    }

    /// A triangle at no gate.
    fn start(&mut self, [a, b, c]: [u8; 3]) {
        self.push([b, a, c]);
        self.push([a, c, b]);
        self.push([c, b, a]);
    }

    /// A triangle at the gate of its first two corners.
    fn attach(&mut self, [a, b, c]: [u8; 3]) {
        let closes_next = self.next[usize::from(b)] == c;
        let closes_before = self.before[usize::from(a)] == c;
        if closes_next && closes_before {
            [a, b, c].iter().for_each(|v| self.next[usize::from(*v)] = NONE);
            return;
        }
        if !closes_before {
            self.push([a, c, b]);
        }
        if !closes_next {
            self.push([c, b, a]);
        }
    }
}

/// Appends a symbol for each triangle, and what symbols do not say. For each vertex in turn `sources` gets the three
/// from which it is predicted: p, q, r for p + q − r.
pub fn encode(triangles: &[[u8; 3]], symbols: &mut Vec<u8>, extra: &mut Vec<u8>, sources: &mut Vec<[u8; 3]>) {
    let mut front = Front::new();
    sources.clear();
    for corners in triangles {
        let [a, b, c] = *corners;
        let mut open = front.gates[..front.depth].iter().rev().filter(|g| front.is_open(**g));
        let skip = open.position(|g| [g[0], g[1]] == [a, b]).and_then(|skip| u8::try_from(skip).ok());
        let Some(skip) = skip else {
            symbols.push(START);
            for v in corners {
                let is_new = usize::from(*v) == sources.len();
                extra.push(if is_new { NONE } else { *v });
                if is_new {
                    sources.push([v.saturating_sub(1); 3]);
                }
            }
            front.start(*corners);
            continue;
        };
        let gate = front.pop(skip).unwrap_or_default();
        let kind = if usize::from(c) == sources.len() {
            sources.push(gate);
            NEW
        } else if front.next[usize::from(b)] == c {
            NEXT
        } else if front.before[usize::from(a)] == c {
            BEFORE
        } else {
            OTHER
        };
        symbols.push(SKIP * skip.min(MANY) + kind);
        if skip >= MANY {
            extra.push(skip);
        }
        if kind == OTHER {
            extra.push(c);
        }
        front.attach(*corners);
    }
}

/// How many extra bytes each symbol takes.
const EXTRA_BYTES: [u8; START as usize + 1] = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 2, 3];

/// How many extra bytes symbols take.
pub fn extra_bytes(symbols: &[u8]) -> usize {
    let mut counts = [0; 256];
    symbols.iter().for_each(|s| counts[usize::from(*s)] += 1);
    counts.iter().zip(EXTRA_BYTES).map(|(count, bytes)| count * usize::from(bytes)).sum()
}

/// The inverse of [`encode`]: fills the corners of `triangles` and the sources of so many vertices, and takes its extra
/// bytes.
pub fn decode(
    symbols: &[u8],
    extra: &mut &[u8],
    vertices: usize,
    triangles: &mut [u8],
    sources: &mut [[u8; 3]; 256],
) -> Read<()> {
    let mut front = Front::new();
    let mut count = 0usize;
    let mut byte = || -> Read<u8> {
        let (first, rest) = extra.split_first().ok_or("triangles: extra bytes end too early")?;
        *extra = rest;
        Ok(*first)
    };
    let known = |v: u8, count: usize| {
        if usize::from(v) < count { Ok(v) } else { Err("triangles: a corner that no vertex was given to") }
    };
    for (symbol, corners) in symbols.iter().zip(triangles.chunks_exact_mut(3)) {
        let triangle = if *symbol < START {
            let (skip, kind) = (symbol / SKIP, symbol % SKIP);
            let skip = if skip == MANY { byte()? } else { skip };
            let gate = front.pop(skip).ok_or("triangles: no such gate")?;
            let [a, b, _] = gate;
            let c = match kind {
                NEW => {
                    sources[count & 255] = gate;
                    count += 1;
                    (count - 1) as u8
                }
                NEXT => front.next[usize::from(b)],
                BEFORE => front.before[usize::from(a)],
                _ => byte()?,
            };
            let triangle = [a, b, known(c, count)?];
            front.attach(triangle);
            triangle
        } else if *symbol == START {
            let mut triangle = [0; 3];
            for v in &mut triangle {
                *v = byte()?;
                if *v == NONE {
                    sources[count & 255] = [count.saturating_sub(1) as u8; 3];
                    *v = count as u8;
                    count += 1;
                }
                known(*v, count)?;
            }
            front.start(triangle);
            triangle
        } else {
            return Err("triangles: no such symbol");
        };
        if count > vertices {
            return Err("triangles: more vertices than the cluster has");
        }
        corners.copy_from_slice(&triangle);
    }
    if count == vertices { Ok(()) } else { Err("triangles: fewer vertices than the cluster has") }
}
