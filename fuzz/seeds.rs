//! Writes what fuzzing starts from into `corpus/`, or a folder given: whole files and pages of small meshes, coded as
//! writers do and without zstd.

use std::path::PathBuf;

use nanite_fuzz::{meshes, page, plain_file};
use nanite_rs::format::encode::contexts;
use nanite_rs::format::planes::ZSTD_LEVEL;
use nanite_rs::format::{from_bytes, to_bytes};

fn main() -> std::io::Result<()> {
    let corpus = std::env::args_os().nth(1).map_or_else(|| "corpus".into(), PathBuf::from);
    let put = |target: &str, name: String, bytes: &[u8]| {
        std::fs::create_dir_all(corpus.join(target))?;
        std::fs::write(corpus.join(target).join(name), bytes)
    };
    let mut which = 0u8;
    for (m, dag) in meshes().iter().enumerate() {
        for (kind, bytes) in [("zstd", to_bytes(dag).unwrap()), ("plain", plain_file(dag))] {
            assert!(from_bytes(&bytes, kind).unwrap() == *dag);
            for target in ["file", "file_resealed"] {
                put(target, format!("mesh{m}-{kind}"), &bytes)?;
            }
        }
        for (p, context) in contexts(dag).iter().enumerate() {
            for (kind, level) in [("zstd", Some(ZSTD_LEVEL)), ("plain", None)] {
                let bytes = [vec![which], page(dag, context, p, level).0].concat();
                put("page", format!("mesh{m}-page{p}-{kind}"), &bytes)?;
            }
            which += 1;
        }
    }
    Ok(())
}
