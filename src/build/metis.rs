//! Calls of METIS (Karypis and Kumar, "A Fast and High Quality Multilevel Scheme for Partitioning Irregular Graphs",
//! 1998) that repeat exactly.
//!
//! METIS draws from `rand` of C, which the threads of a process share, and sets signal handlers while it works.
//! `.cargo/config.toml` has it compiled with these three functions renamed to those below: random numbers are then
//! each thread's own and signals stay as they are. Where it was compiled otherwise, calls take turns.

use std::cell::Cell;
use std::ffi::{c_int, c_uint, c_void};
use std::sync::{Mutex, OnceLock, PoisonError};

use metis::option::Seed;

use crate::threads::PerProcess;

const SEED: i32 = 1;

thread_local! {
    /// State of the generator; `None` until METIS seeds it.
    static STATE: Cell<Option<u32>> = const { Cell::new(None) };
}

// SAFETY: nobody else defines these names, and the signatures are those of the functions they stand for.
#[unsafe(no_mangle)]
extern "C" fn nanite_metis_srand(seed: c_uint) {
    STATE.set(Some(seed));
}

/// SplitMix32, without the sign bit.
// SAFETY: as above.
#[unsafe(no_mangle)]
extern "C" fn nanite_metis_rand() -> c_int {
    let state = STATE.get().unwrap_or(0).wrapping_add(0x9e37_79b9);
    STATE.set(Some(state));
    let mut x = state;
    x = (x ^ x >> 16).wrapping_mul(0x21f0_aaad);
    x = (x ^ x >> 15).wrapping_mul(0x735a_2d97);
    ((x ^ x >> 15) >> 1).cast_signed()
}

/// Leaves all handlers as they are.
// SAFETY: as above.
#[unsafe(no_mangle)]
extern "C" fn nanite_metis_signal(_: c_int, _: *const c_void) -> *const c_void {
    std::ptr::null()
}

/// The part of each node of a graph: `starts` has one more entry than nodes, `neighbours` and `weights` one entry
/// for each direction of each edge. All zero where METIS fails.
pub fn partition(starts: &[i32], neighbours: &[i32], weights: &[i32], parts: usize) -> Vec<u32> {
    static TURN: PerProcess<Mutex<()>> = PerProcess::new();
    let turn = (!is_private()).then(|| TURN.get().lock().unwrap_or_else(PoisonError::into_inner));
    let part = call(starts, neighbours, weights, parts);
    drop(turn);
    part
}

/// Whether METIS draws from the functions above.
fn is_private() -> bool {
    static PRIVATE: OnceLock<bool> = OnceLock::new();
    *PRIVATE.get_or_init(|| {
        call(&[0, 1, 2], &[1, 0], &[1, 1], 2);
        STATE.get().is_some()
    })
}

fn call(starts: &[i32], neighbours: &[i32], weights: &[i32], parts: usize) -> Vec<u32> {
    let mut part = vec![0; starts.len() - 1];
    let graph = metis::Graph::new(1, parts as i32, starts, neighbours);
    let done = graph.map(|g| g.set_adjwgt(weights).set_option(Seed(SEED)).part_recursive(&mut part).is_ok());
    if !done.unwrap_or(false) {
        part.fill(0);
    }
    part.into_iter().map(i32::cast_unsigned).collect()
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    /// A grid of `n` by `n` nodes.
    fn grid(n: i32) -> (Vec<i32>, Vec<i32>) {
        let (mut starts, mut neighbours) = (vec![0], Vec::new());
        for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
            let around = [(y - 1, x), (y, x - 1), (y, x + 1), (y + 1, x)];
            let inside = around.into_iter().filter(|(y, x)| (0..n).contains(y) && (0..n).contains(x));
            neighbours.extend(inside.map(|(y, x)| y * n + x));
            starts.push(neighbours.len() as i32);
        }
        (starts, neighbours)
    }

    #[test]
    fn draws_from_its_own_threads_numbers() {
        assert!(is_private(), "compiled without the CFLAGS of .cargo/config.toml");
    }

    #[test]
    fn repeats_exactly_on_any_number_of_threads() {
        let (starts, neighbours) = grid(64);
        let weights = vec![1; neighbours.len()];
        let first = partition(&starts, &neighbours, &weights, 32);
        let mut sizes = vec![0; 32];
        first.iter().for_each(|p| sizes[*p as usize] += 1);
        assert!(sizes.iter().all(|s| (100..160).contains(s)), "{sizes:?}");
        let again: Vec<_> =
            (0..32).into_par_iter().map(|_| partition(&starts, &neighbours, &weights, 32)).collect();
        assert!(again.iter().all(|part| *part == first));
    }
}
