//! Files: what is written comes back, and nothing that is read is trusted.

use nanite_rs::Error;
use nanite_rs::build::{Silent, build, check};
use nanite_rs::config::BuildOptions;
use nanite_rs::format::{from_bytes, open, save, to_bytes};
use nanite_rs::mesh::{Positions, SourceChannel, SourceMesh};
use nanite_rs::model::{ChannelInfo, ChannelType, Dag};

use crate::dag_invariants::{Random, build_mesh};
use crate::shapes;

fn rich_mesh(n: usize) -> Dag {
    let (positions, faces) = shapes::bumpy_sphere(n);
    let colors: Vec<[u8; 4]> = (0..positions.len()).map(|i| [i as u8, (i >> 8) as u8, 7, 255]).collect();
    let uvs: Vec<[f32; 2]> = positions.iter().map(|p| [p[0], p[1]]).collect();
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    source.colors = Some(&colors);
    source.uvs = vec![&uvs, &uvs];
    let heat: Vec<u32> = positions.iter().flat_map(|p| [p[2].to_bits(), (1.0e20 * p[0]).to_bits()]).collect();
    let parts: Vec<u32> =
        positions.iter().map(|p| if p[2] > 0.0 { i32::MIN.cast_unsigned() } else { 7 }).collect();
    let info = |name: &str, dtype, columns| ChannelInfo { name: name.into(), dtype, columns };
    source.channels = vec![
        SourceChannel { info: info("heat", ChannelType::Float32, Some(2)), words: &heat },
        SourceChannel { info: info("part", ChannelType::Int32, None), words: &parts },
    ];
    let dag = build(&source, &BuildOptions { face_ids: true, ..BuildOptions::default() }, &Silent).unwrap();
    check(&dag).unwrap();
    dag
}

#[test]
fn bytes_and_files_come_back_equal() {
    for dag in [rich_mesh(20), build_mesh(&shapes::torus(50, 20))] {
        let bytes = to_bytes(&dag);
        assert!(from_bytes(&bytes, "x").unwrap() == dag);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nanite");
        std::fs::write(&path, b"an older file").unwrap();
        save(&dag, &path).unwrap();
        assert!(open(&path).unwrap() == dag);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
        assert!(matches!(save(&dag, &folder.path().join("none/a.nanite")), Err(Error::Io { .. })));
        assert!(matches!(open(&folder.path().join("b.nanite")), Err(Error::Io { .. })));
    }
}

#[test]
fn every_truncation_is_a_typed_error() {
    let bytes = to_bytes(&rich_mesh(4));
    for length in 0..bytes.len() {
        match from_bytes(&bytes[..length], "short") {
            Err(Error::Format { name, offset, .. }) => {
                assert_eq!(name, "short");
                assert!(offset <= bytes.len() as u64);
            }
            other => panic!("length {length}: {:?}", other.map(|_| ())),
        }
    }
}

#[test]
fn every_flipped_bit_that_matters_is_found() {
    let dag = rich_mesh(4);
    let bytes = to_bytes(&dag);
    let mut random = Random(5);
    for _ in 0..2000 {
        let mut damaged = bytes.clone();
        let at = (random.next() * bytes.len() as f64) as usize;
        damaged[at] ^= 1 << (random.next() * 8.0) as u8;
        // Only padding between sections may change unnoticed.
        match from_bytes(&damaged, "flipped") {
            Err(Error::Format { .. }) => {}
            Ok(read) => assert!(read == dag, "byte {at} changed the mesh unnoticed"),
            Err(other) => panic!("{other}"),
        }
    }
}

/// Damage behind valid checksums: readers may find it or not, but must survive cutting what they accept.
#[test]
fn hostile_words_never_panic() {
    let dag = rich_mesh(6);
    let mut random = Random(9);
    let evil = [0, 1, 0x7f, 0xff, 0x1_0000, 0x7f80_0000, 0x7fc0_0000, 0x8000_0000, u32::MAX];
    let mut accepted = 0;
    for _ in 0..3000 {
        let mut damaged = dag.clone();
        let value = evil[(random.next() * evil.len() as f64) as usize];
        let pick = |n: usize, r: &mut Random| (r.next() * n as f64) as usize;
        match pick(6, &mut random) {
            0 => {
                let at = pick(damaged.pages.words.len(), &mut random);
                damaged.pages.words[at] = value;
            }
            1 => {
                let words: &mut [u32] = bytemuck::cast_slice_mut(&mut damaged.groups);
                let at = pick(words.len(), &mut random);
                words[at] = value;
            }
            2 => {
                let words: &mut [u32] = bytemuck::cast_slice_mut(&mut damaged.nodes);
                let at = pick(words.len(), &mut random);
                words[at] = value;
            }
            3 => {
                let channel = pick(damaged.channels.len(), &mut random);
                let words = &mut damaged.channels[channel].words;
                let at = pick(words.len(), &mut random);
                words[at] = value;
            }
            4 => {
                let channel = pick(damaged.channels.len(), &mut random);
                damaged.channels[channel].info.columns = Some(value);
            }
            _ => {
                let words: &mut [u32] = bytemuck::cast_slice_mut(&mut damaged.pages.table);
                let at = pick(words.len(), &mut random);
                words[at] = value;
            }
        }
        if let Ok(read) = from_bytes(&to_bytes(&damaged), "hostile") {
            accepted += 1;
            let clusters = nanite_rs::lod::select(&read, &nanite_rs::model::rule::Threshold::Uniform(0.01));
            let cut = nanite_rs::lod::extract(&read, &clusters);
            read.channels
                .iter()
                .for_each(|c| assert!(nanite_rs::lod::channel_rows(c, &cut.ids).len() >= cut.ids.len()));
            let _ = check(&read);
        }
    }
    assert!(accepted > 100, "the damage never got past the reader: the test tests nothing");
}

#[test]
fn channels_that_do_not_fit_are_refused() {
    let dag = rich_mesh(6);
    let refused = |change: &dyn Fn(&mut Dag), what: &str| {
        let mut damaged = dag.clone();
        change(&mut damaged);
        match from_bytes(&to_bytes(&damaged), "x") {
            Err(Error::Format { message, .. }) => assert!(message.contains(what), "{message}"),
            other => panic!("{what}: {:?}", other.map(|_| ())),
        }
    };
    refused(&|d| d.channels[0].words[3] = f32::NAN.to_bits(), "values");
    refused(&|d| d.channels[1].info.dtype = ChannelType::Bool, "values");
    refused(&|d| d.channels[1].info.name = "heat".into(), "name");
    refused(&|d| d.channels[0].info.columns = Some(0), "left over");
    refused(&|d| d.channels[0].info.columns = Some(u32::MAX), "ends inside");
    refused(&|d| d.channels[1].words.truncate(5), "ends inside");
    refused(&|d| d.channels[1].words.push(0), "left over");
}
