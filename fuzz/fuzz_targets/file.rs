//! Any bytes as a file.

#![no_main]

use libfuzzer_sys::fuzz_target;
use nanite_fuzz::{damage, one_thread};
use nanite_rs::format::from_bytes;

fuzz_target!(init: one_thread(), |bytes: &[u8]| {
    if let Ok(dag) = from_bytes(bytes, "any") {
        damage::exercise(&dag);
    }
});
