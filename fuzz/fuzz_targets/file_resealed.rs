//! A file with right checksums, whatever it holds: mutations get past the container.

#![no_main]

use libfuzzer_sys::fuzz_target;
use nanite_fuzz::{damage, one_thread};
use nanite_rs::format::{from_bytes, to_bytes};

fuzz_target!(init: one_thread(), |bytes: &[u8]| {
    let mut bytes = bytes.to_vec();
    damage::reseal(&mut bytes);
    damage::stream(bytes.clone());
    if let Ok(dag) = from_bytes(&bytes, "resealed") {
        damage::exercise(&dag);
        // Saved again it may be refused.
        let _ = to_bytes(&dag);
        damage::draw(dag);
    }
});
