//! The triangles of a cluster in some three bits each, where they come along a spiral (`build/order.rs`), and without
//! loss in any order.
//!
//! In the manner of Rossignac's Edgebreaker (IEEE TVCG 5(1), 1999): a triangle begins with a gate, an edge of an
//! earlier one, and its third corner is new, or one of the two neighbours of the gate along the front of what was
//! drawn so far, or elsewhere on the front, which then falls in two. A symbol says all of it, so that a decoder looks
//! nothing up but the corner. Where none of that holds a triangle is written out, so no property of the triangles is
//! relied on. Corners refer to the cluster's vertices, which are numbered in the order of their first use.

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
/// It is elsewhere on the front: an extra byte.
const SPLIT: u8 = 3;
/// Gates passed over: the low bits of a symbol, under the above. At [`MANY`] the number is an extra byte.
const SKIP_BITS: u8 = 2;
/// See [`SKIP_BITS`].
const MANY: u8 = (1 << SKIP_BITS) - 1;
/// What would be the front split after many gates: a triangle at no gate, three extra bytes.
const START: u8 = SPLIT << SKIP_BITS | MANY;

/// An edge a, b where a triangle may begin, the third corner of the triangle that it is an edge of, and the vertex that
/// is to follow b along the front once the gate's turn comes; [`NONE`] for the one that follows then.
type Gate = [u8; 4];

/// What a vertex is predicted from, from the low byte up: p, q, r for p + q − r; the last byte says nothing.
pub type Source = u32;

/// The same vertex three times.
fn repeated(v: u8) -> Source {
    u32::from_le_bytes([v; 4])
}

/// A power of two with room for the gates of all triangles, of which each leaves three at most.
const GATES: usize = 512;
const _: () = assert!(GATES >= 3 * CLUSTER_MAX_TRIANGLES);

/// What decoding needs, used again from cluster to cluster.
pub struct Tables {
    next: [u8; 256],
    before: [u8; 256],
    gates: [u32; GATES],
}

impl Default for Tables {
    fn default() -> Self {
        Self { next: [NONE; 256], before: [NONE; 256], gates: [0; GATES] }
    }
}

/// What coding and decoding know alike: gates as a stack, and the front as a list of vertices.
struct Front<'a> {
    next: &'a mut [u8; 256],
    before: &'a mut [u8; 256],
    /// Packed, so that one load finds what one store left.
    gates: &'a mut [u32; GATES],
    depth: usize,
}

impl<'a> Front<'a> {
    /// Nothing drawn.
    fn new(Tables { next, before, gates }: &'a mut Tables) -> Self {
        (*next, *before) = ([NONE; 256], [NONE; 256]);
        Self { next, before, gates, depth: 0 }
    }

    #[inline(always)]
    fn link(&mut self, a: u8, b: u8) {
        self.next[usize::from(a)] = b;
        self.before[usize::from(b)] = a;
    }

    #[inline(always)]
    fn push(&mut self, gate: Gate) {
        self.gates[self.depth % GATES] = u32::from_le_bytes(gate);
        self.depth += 1;
    }

    #[inline(always)]
    fn leave(&mut self, a: u8, b: u8, opposite: u8) {
        self.link(a, b);
        self.push([a, b, opposite, NONE]);
    }

    /// The last gate but `skip`; those above it are gone.
    #[inline(always)]
    fn pop(&mut self, skip: u8) -> Option<Gate> {
        self.depth = self.depth.checked_sub(usize::from(skip) + 1)?;
        let gate = self.gates[self.depth % GATES].to_le_bytes();
        let [a, b, _, next] = gate;
        if next != NONE {
            self.link(a, b);
            self.next[usize::from(b)] = next;
        }
        Some(gate)
    }

    /// A triangle at no gate.
    fn start(&mut self, [a, b, c]: [u8; 3]) {
        self.leave(b, a, c);
        self.leave(a, c, b);
        self.leave(c, b, a);
    }

    /// How a third corner lies to a gate that is about to be the last.
    fn kind(&self, [a, b, _, next]: Gate, c: u8, is_new: bool) -> u8 {
        let next = if next == NONE { self.next[usize::from(b)] } else { next };
        if is_new {
            NEW
        } else if next == c {
            NEXT
        } else if self.before[usize::from(a)] == c {
            BEFORE
        } else {
            SPLIT
        }
    }

    /// A triangle at the gate of its first two corners.
    #[inline(always)]
    fn attach(&mut self, kind: u8, [a, b, c]: [u8; 3]) {
        match kind {
            NEW => {
                self.leave(a, c, b);
                self.leave(c, b, a);
            }
            // Where c comes before the gate as well the triangle fills a hole.
            NEXT if self.before[usize::from(a)] == c => {}
            NEXT => self.leave(a, c, b),
            BEFORE => self.leave(c, b, a),
            // The front falls in two at c. The part behind c comes first; the gate a, c keeps what follows c in the
            // other one.
            _ => {
                let after = self.next[usize::from(c)];
                self.next[usize::from(a)] = c;
                self.push([a, c, b, after]);
                self.leave(c, b, a);
            }
        }
    }
}

/// Appends a symbol for each triangle, and what symbols do not say. For each vertex in turn `sources` gets the three
/// from which it is predicted.
pub fn encode(triangles: &[[u8; 3]], symbols: &mut Vec<u8>, extra: &mut Vec<u8>, sources: &mut Vec<Source>) {
    let mut tables = Tables::default();
    let mut front = Front::new(&mut tables);
    sources.clear();
    for corners in triangles {
        let [a, b, c] = *corners;
        let is_new = usize::from(c) == sources.len();
        let gates = front.gates[..front.depth].iter().rev().map(|gate| gate.to_le_bytes());
        let found = gates.zip(0..NONE).find(|(gate, _)| gate[..2] == [a, b]);
        let found = found.map(|(gate, skip)| (skip, front.kind(gate, c, is_new)));
        match found {
            Some((skip, kind)) if skip < MANY || kind != SPLIT => {
                symbols.push(kind << SKIP_BITS | skip.min(MANY));
                let gate = front.pop(skip).unwrap_or_default();
                if skip >= MANY {
                    extra.push(skip);
                }
                if kind == SPLIT {
                    extra.push(c);
                }
                if kind == NEW {
                    sources.push(u32::from_le_bytes(gate));
                }
                front.attach(kind, *corners);
            }
            _ => {
                symbols.push(START);
                for v in corners {
                    let is_new = usize::from(*v) == sources.len();
                    extra.push(if is_new { NONE } else { *v });
                    if is_new {
                        sources.push(repeated(v.saturating_sub(1)));
                    }
                }
                front.start(*corners);
            }
        }
    }
}

/// How many extra bytes each symbol takes.
const EXTRA_BYTES: [u8; START as usize + 1] = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 3];

/// How many extra bytes symbols take.
pub fn extra_bytes(symbols: &[u8]) -> usize {
    symbols.iter().map(|s| usize::from(EXTRA_BYTES[usize::from(s % (START + 1))])).sum()
}

/// The inverse of [`encode`]: fills `triangles` and the sources of so many vertices, and takes its extra bytes. What
/// of `sources` is not of the cluster's vertices may be anything afterwards.
pub fn decode(
    tables: &mut Tables,
    symbols: &[u8],
    extra: &mut std::slice::Iter<'_, u8>,
    vertices: usize,
    triangles: &mut [[u8; 3]],
    sources: &mut [Source; 256],
) -> Read<()> {
    let mut front = Front::new(tables);
    let mut count = 0usize;
    // There are as many as symbols ask for.
    let mut byte = || extra.next().copied().unwrap_or(NONE);
    for (symbol, corners) in symbols.iter().zip(&mut *triangles) {
        if *symbol == START {
            for v in corners.iter_mut() {
                *v = byte();
                if *v == NONE {
                    *v = count as u8;
                    sources[usize::from(*v)] = repeated(v.saturating_sub(1));
                    count += 1;
                }
            }
            front.start(*corners);
            continue;
        }
        let skip = symbol & MANY;
        let skip = if skip == MANY { byte() } else { skip };
        let gate = front.pop(skip).ok_or("triangles: no such gate")?;
        let [a, b, _, _] = gate;
        // Each kind by itself, so that what follows from it is known.
        let c = match symbol >> SKIP_BITS {
            NEW => {
                let c = count as u8;
                sources[usize::from(c)] = u32::from_le_bytes(gate);
                count += 1;
                front.attach(NEW, [a, b, c]);
                c
            }
            NEXT => {
                let c = front.next[usize::from(b)];
                front.attach(NEXT, [a, b, c]);
                c
            }
            BEFORE => {
                let c = front.before[usize::from(a)];
                front.attach(BEFORE, [a, b, c]);
                c
            }
            _ => {
                let c = byte();
                front.attach(SPLIT, [a, b, c]);
                c
            }
        };
        *corners = [a, b, c];
    }
    if count != vertices {
        return Err("triangles: vertices are more or fewer than the cluster has");
    }
    let largest = triangles.as_flattened().iter().fold(0, |most, v| most.max(*v));
    if usize::from(largest) < vertices { Ok(()) } else { Err("triangles: a corner that is no vertex") }
}
