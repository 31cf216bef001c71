//! Readers under damage: whatever the bytes, an answer or an error.

use proptest::prelude::*;

use super::{obj, off, ply, polygon, stl};

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n\
    0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1\n4 0 1 2 3 0\n";
const OBJ: &str = "mtllib a b.mtl\no one\nv 0 0 0\nv 1 0 0 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl x\n\
    s 1\nf 1/1/1 2/1/1 3/1/1 \\\n 4/1/1\ng two\nf -1 -2//1 -3/1\n";
const STL: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
    endfacet\nendsolid a\n";
const OFF: &str =
    "COFF\n4 1 0\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n1 1 0 1 0 0 1\n0 1 0 1 0 0 1\n4 0 1 2 3 255 0 0\n";

fn binary_ply() -> Vec<u8> {
    let body = PLY.find("end_header\n").unwrap() + "end_header\n".len();
    let mut out = PLY[..body].replace("ascii", "binary_big_endian").into_bytes();
    out.extend([0.0f32, 1.0, 0.5].iter().cycle().take(12).flat_map(|v| v.to_be_bytes()));
    for _ in 0..2 {
        out.push(3);
        out.extend([0u32, 1, 2].iter().flat_map(|v| v.to_be_bytes()));
        out.push(0);
    }
    out
}

fn binary_stl() -> Vec<u8> {
    let mut out = vec![b' '; 80];
    out.extend(2u32.to_le_bytes());
    out.extend([7; 100]);
    out
}

fn read_all(data: &[u8]) {
    let _ = (ply::read(data), stl::read(data), obj::read(data), off::read(data));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn any_damage_ends(
        seed in 0usize..6,
        cut in 0usize..1000,
        changes in prop::collection::vec((0usize..1000, prop_oneof![any::<u8>(), prop::sample::select(&b" \n\r-/\\#9.e\0"[..])]), 0..8),
    ) {
        let seeds = [PLY.as_bytes().to_vec(), binary_ply(), STL.as_bytes().to_vec(), binary_stl(),
            OBJ.as_bytes().to_vec(), OFF.as_bytes().to_vec()];
        let mut data = seeds[seed].clone();
        for (at, byte) in changes {
            let length = data.len();
            data[at % length] = byte;
        }
        if cut < data.len() {
            data.truncate(cut);
        }
        read_all(&data);
    }

    #[test]
    fn any_bytes_end(data in prop::collection::vec(any::<u8>(), 0..300)) {
        read_all(&data);
    }

    #[test]
    fn any_polygons_end(
        points in prop::collection::vec(prop::array::uniform3(prop::num::f64::ANY), 1..9),
        corners in prop::collection::vec(0u32..9, 0..30),
        counts in prop::collection::vec(0u32..12, 0..6),
    ) {
        let _ = polygon::triangulate(&points, &corners, &counts);
    }
}

#[test]
fn the_seeds_are_read() {
    assert_eq!(ply::read(PLY.as_bytes()).unwrap().elements.len(), 2);
    assert_eq!(ply::read(&binary_ply()).unwrap().behind, 0);
    assert_eq!(stl::read(STL.as_bytes()).unwrap().corners.len(), 3);
    assert_eq!(stl::read(&binary_stl()).unwrap().corners.len(), 6);
    assert_eq!(obj::read(OBJ.as_bytes()).unwrap().parts.len(), 1);
    assert_eq!(off::read(OFF.as_bytes()).unwrap().counts, [4]);
}
