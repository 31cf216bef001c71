//! Materials of files: a table and images, of which none is read before somebody asks for it.

use nanite_rs::Error;
use nanite_rs::format::file::{HEADER_BYTES, Kind};
use nanite_rs::format::{Precision, from_bytes, input_info, open_input, quantize, to_bytes};
use nanite_rs::model::{Blob, Dag, Materials};

use crate::damage::{entries, reseal, rich_mesh, section, sections};

/// What a mesh looks like: its table, and its images.
fn looks(dag: &Dag) -> (String, Vec<Vec<u8>>) {
    let images = dag.materials.images.iter().map(|image| image.read().unwrap().into_owned());
    (dag.materials.table.to_string(), images.collect())
}

fn lazy(bytes: Vec<u8>) -> Dag {
    open_input(Box::new(bytes), "lazy").unwrap()
}

#[test]
fn they_come_back_from_bytes_and_files() {
    let dag = rich_mesh(6);
    assert_eq!(dag.materials.images.len(), 3);
    for dag in [dag.clone(), quantize(&dag, Precision::Auto).unwrap()] {
        let bytes = to_bytes(&dag).unwrap();
        let (whole, stored) = (from_bytes(&bytes, "x").unwrap(), lazy(bytes.clone()));
        assert_eq!(looks(&whole), looks(&dag));
        assert_eq!(looks(&stored), looks(&dag));
        // What was opened is written as it is, images of the file too.
        assert_eq!(to_bytes(&whole).unwrap(), bytes);
        let parts = input_info(&bytes, "x").unwrap().parts;
        let of = |name| parts.iter().find(|part| part.0 == name).unwrap().1;
        let sizes: u64 = dag.materials.images.iter().map(Blob::count).sum();
        assert_eq!((of("materials"), of("images")), (dag.materials.table.len() as u64, sizes));
    }
}

#[test]
fn a_mesh_without_them_has_no_section() {
    let dag = Dag { materials: Materials::default(), ..rich_mesh(4) };
    let bytes = to_bytes(&dag).unwrap();
    assert!(section(&bytes, Kind::Materials).is_none() && section(&bytes, Kind::Images).is_none());
    assert_eq!(looks(&from_bytes(&bytes, "x").unwrap()), Default::default());
    let images = vec![Blob::from(vec![1])];
    let without = Dag { materials: Materials { images, ..Materials::default() }, ..dag };
    assert!(matches!(to_bytes(&without), Err(Error::Argument { .. })));
}

#[test]
fn a_damaged_image_is_its_own_affair() {
    let mut bytes = to_bytes(&rich_mesh(4)).unwrap();
    let place = sections(&bytes, Kind::Images).nth(2).unwrap();
    bytes[place.start + 5] ^= 1;
    let stored = lazy(bytes.clone());
    assert!(stored.materials.images[..2].iter().all(|image| image.read().is_ok()));
    for result in [stored.materials.images[2].read().map(drop), from_bytes(&bytes, "x").map(drop)] {
        let Err(Error::Format { offset, message, .. }) = result else { panic!("{result:?}") };
        assert_eq!(offset, place.start as u64);
        assert!(message.contains("section Images, number 2: the checksum"), "{message}");
    }
}

#[test]
fn a_table_that_is_no_text_or_missing_is_refused() {
    let bytes = to_bytes(&rich_mesh(4)).unwrap();
    let at = section(&bytes, Kind::Materials).unwrap().start;
    let mut no_text = bytes.clone();
    no_text[at] = 0xff;
    reseal(&mut no_text);
    let mut missing = bytes.clone();
    let row = entries(&bytes).find(|row| bytes[*row] == Kind::Materials as u8).unwrap();
    // A kind that may be there any number of times.
    missing[row] = Kind::Images as u8;
    reseal(&mut missing);
    for (bytes, offset, what) in [(no_text, at, "utf-8"), (missing, HEADER_BYTES, "Materials is missing")] {
        for result in [from_bytes(&bytes, "x"), open_input(Box::new(bytes.clone()), "x")] {
            let Err(Error::Format { offset: found, message, .. }) = result else { panic!("{what}") };
            assert_eq!(found, offset as u64, "{message}");
            assert!(message.contains(what), "{message}");
        }
    }
}
