//! Files: what is written comes back, and nothing that is read is trusted.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use nanite_rs::Error;
use nanite_rs::build::{Silent, build, check};
use nanite_rs::config::BuildOptions;
use nanite_rs::format::encode::contexts;
use nanite_rs::format::file::{HEADER_BYTES, Kind};
use nanite_rs::format::page_decode::Decoder;
use nanite_rs::format::planes::Writer;
use nanite_rs::format::{
    Precision, file_info, from_bytes, open, page_encode, quantize, save, to_bytes, validate,
};
use nanite_rs::limits::{CLUSTER_MAX_VERTICES, PAGE_MAX_BYTES, PAGE_MAX_CLUSTERS, ROOT_PAGE_MAX_BYTES};
use nanite_rs::lod::{cut_error, extract, select};
use nanite_rs::measure::{BoundOptions, Surface, hausdorff_upper};
use nanite_rs::mesh::{Colors, Positions, SourceChannel, SourceMesh};
use nanite_rs::model::cluster::{NO_GROUP, RECORD_WORDS};
use nanite_rs::model::rule::{ROOT_ERROR, SOURCE_ERROR, Threshold};
use nanite_rs::model::{
    Channel, ChannelInfo, ChannelType, ClusterAddress, ColorFormat, Dag, Grid, Group, Node, UNINTERRUPTED,
};
use proptest::prelude::*;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::dag_invariants::{Random, build_mesh};
use crate::damage::{self, reseal};
use crate::shapes;

/// Cases of a test: more where tests soak.
fn cases(short: usize, long: usize) -> usize {
    if std::env::var_os("NANITE_SOAK").is_some() { long } else { short }
}

fn rich_mesh(n: usize) -> Dag {
    let dag = damage::rich_mesh(n);
    check(&dag, UNINTERRUPTED).unwrap();
    dag
}

/// A mesh from a file, all of it.
fn opened(path: &Path) -> Dag {
    let dag = open(path).unwrap();
    assert!((0..dag.pages.table.len()).all(|page| !dag.pages.holds(page)), "opening reads no page");
    dag.load_all(UNINTERRUPTED).unwrap();
    dag
}

/// Runs so many cases on all threads, each with random numbers of its own; in how many of them it was true.
fn count(cases: usize, case: impl Fn(&mut Random) -> bool + Sync) -> usize {
    struct Number(usize);
    impl Drop for Number {
        fn drop(&mut self) {
            if std::thread::panicking() {
                eprintln!("in case {}", self.0);
            }
        }
    }
    let run = |number: usize| {
        let _named = Number(number);
        case(&mut Random(number as u64))
    };
    (0..cases).into_par_iter().filter(|number| run(*number)).count()
}

fn section(bytes: &[u8], kind: Kind) -> std::ops::Range<usize> {
    damage::section(bytes, kind).unwrap()
}

/// What an accepted file has to stand: use, and checks, of which the outcome is open.
fn exercise(dag: Dag) {
    damage::exercise(&dag);
    let _ = check(&dag, UNINTERRUPTED);
    damage::draw(dag);
}

fn rounded(dag: &Dag, precision: Precision) -> Dag {
    let out = quantize(dag, precision).unwrap();
    check(&out, UNINTERRUPTED).unwrap();
    out
}

#[test]
fn bytes_and_files_come_back_equal() {
    for dag in [rich_mesh(20), build_mesh(&shapes::torus(50, 20))] {
        let bytes = to_bytes(&dag).unwrap();
        assert!(from_bytes(&bytes, "x").unwrap() == dag);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nanite");
        std::fs::write(&path, b"an older file").unwrap();
        save(&dag, &path, Precision::Exact, UNINTERRUPTED).unwrap();
        assert!(opened(&path) == dag);
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
        let none = folder.path().join("none/a.nanite");
        assert!(matches!(save(&dag, &none, Precision::Exact, UNINTERRUPTED), Err(Error::Io { .. })));
        assert!(matches!(open(&folder.path().join("b.nanite")), Err(Error::Io { .. })));
    }
}

/// A file holds what `quantize` gives, on whatever grid; once on it, a mesh stays as it is.
#[test]
fn files_hold_the_quantized_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nanite");
    for dag in [rich_mesh(20), build_mesh(&shapes::torus(50, 20))] {
        let exact = to_bytes(&dag).unwrap().len();
        for precision in
            [0.1, 0.001, 1.0e-6, 1.0e-12].map(Precision::Step).into_iter().chain([Precision::Auto])
        {
            let expected = rounded(&dag, precision);
            save(&dag, &path, precision, UNINTERRUPTED).unwrap();
            let read = opened(&path);
            assert!(read == expected, "{precision:?}");
            let info = file_info(&path).unwrap();
            assert_eq!((info.metadata.grid, info.metadata.vertex_count), (read.grid, read.vertex_count));
            assert_eq!(info.bytes, info.parts.iter().map(|part| part.1).sum::<u64>());
            match precision {
                Precision::Step(step) => match read.grid {
                    Some(grid) => assert!(f64::from(grid.step()) * read.frame.scale <= step),
                    // Finer than f32: all is kept.
                    None => assert!(step == 1.0e-12 && read == dag),
                },
                _ => assert!(read.grid.is_some() && info.bytes < exact as u64),
            }
            // Nothing more is lost, whether the mesh, its bytes or a finer grid are asked for.
            let bytes = to_bytes(&read).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), bytes);
            assert!(from_bytes(&bytes, "x").unwrap() == read);
            for again in [Precision::Auto, Precision::Exact, precision, Precision::Step(1.0e-13)] {
                assert!(
                    read.grid.is_none() || rounded(&read, again) == read,
                    "{precision:?}, then {again:?}"
                );
            }
        }
        let twice = rounded(&rounded(&dag, Precision::Step(0.001)), Precision::Step(0.1));
        let once = rounded(&dag, Precision::Step(0.1));
        assert_eq!(twice.grid.unwrap().exponent, once.grid.unwrap().exponent);
        assert!(twice.grid.unwrap().moved >= once.grid.unwrap().moved);
        for step in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(quantize(&dag, Precision::Step(step)), Err(Error::Argument { .. })));
        }
    }
}

#[test]
fn clusters_of_the_most_vertices_come_back() {
    // Triangles that share nothing, three vertices each.
    let corners =
        (0..255).map(|i| [(i / 3 % 20) as f32, (i / 60) as f32, [0.0, 0.3, 0.6][i % 3] * (1 + i % 3) as f32]);
    let positions: Vec<[f32; 3]> =
        corners.zip(0..).map(|([x, y, z], i)| [x + 0.4 * (i % 2) as f32, y, z]).collect();
    let faces: Vec<[u32; 3]> = (0..85).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let dag = build_mesh(&(positions, faces));
    let most = dag.pages.addresses().map(|at| dag.record(at).vertex_count).max();
    assert_eq!(most, Some(CLUSTER_MAX_VERTICES as u8));
    for precision in [Precision::Auto, Precision::Exact] {
        check(&rounded(&dag, precision), UNINTERRUPTED).unwrap();
    }
}

/// Bytes of the clusters of a group.
fn bytes_of(mesh: &Dag, group: &Group) -> usize {
    let words = |at: ClusterAddress| {
        let record = mesh.record(at);
        let counts = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        RECORD_WORDS + mesh.layout().streams(counts.0, counts.1, mesh.geometry(at).widths()).end
    };
    4 * group.members().map(words).sum::<usize>()
}

/// Root pages come first and are small, the last of them filled up with what is coarsest; others are of one level, and
/// end where the next group has no room.
fn pages_are_as_they_should_be(mesh: &Dag) {
    check(mesh, UNINTERRUPTED).unwrap();
    let roots = mesh.root_pages();
    let table = &mesh.pages.table;
    let most = |page: usize| if page < roots { ROOT_PAGE_MAX_BYTES } else { PAGE_MAX_BYTES };
    for (page, entry) in table.iter().enumerate() {
        assert!(4 * entry.words as usize <= most(page) && entry.clusters as usize <= PAGE_MAX_CLUSTERS);
    }
    let is_root = |group: &Group| group.error == ROOT_ERROR;
    assert!(mesh.groups.is_sorted_by_key(|group| !is_root(group)));
    for (group, next) in mesh.groups.iter().zip(&mesh.groups[1..]) {
        let page = group.first.page();
        assert!(group.level >= next.level);
        assert!(page < roots || table[page].level == group.level);
        if next.first.page() != page {
            let room = most(page).saturating_sub(4 * table[page].words as usize);
            let slots = PAGE_MAX_CLUSTERS - table[page].clusters as usize;
            let fits = bytes_of(mesh, next) <= room && next.count as usize <= slots;
            assert!(!fits || page >= roots && next.level != group.level, "page {page}");
        }
    }
}

#[test]
fn root_pages_are_small_and_hold_the_coarsest_of_all_levels() {
    let mut random = Random(3);
    let mut number = |below: usize| (random.next() * below as f64) as u32;
    // Where every vertex has hundreds of triangles nothing can be simplified.
    let positions = (0..90).map(|_| [0, 1, 2].map(|_| number(1000) as f32)).collect();
    let tangle = (positions, (0..9000).map(|_| [0, 1, 2].map(|_| number(90))).collect());
    // Of one root, of many, and all in one page.
    for (mesh, several) in
        [(shapes::bumpy_sphere(160), false), (tangle, true), (shapes::torus(30, 12), false)]
    {
        let dag = build_mesh(&mesh);
        for mesh in [&dag, &rounded(&dag, Precision::Auto)] {
            pages_are_as_they_should_be(mesh);
            assert_eq!(mesh.root_pages() > 1, several);
            let of_roots = |group: &&Group| group.first.page() < mesh.root_pages();
            let levels: BTreeSet<u32> = mesh.groups.iter().filter(of_roots).map(|g| g.level).collect();
            assert!(several || levels.len() > 3, "{levels:?}");
            let used = 4 * mesh.pages.table[..mesh.root_pages()].iter().map(|page| page.words).sum::<u32>();
            let all = 4 * mesh.pages.word_count();
            assert!(
                u64::from(used) == all || used as usize > ROOT_PAGE_MAX_BYTES / 2,
                "{used} of {all} bytes"
            );
            assert!(from_bytes(&to_bytes(mesh).unwrap(), "x").unwrap() == *mesh);
        }
    }
}

#[test]
fn pages_are_filled_anew_when_numbers_take_fewer_bits() {
    let dag = build_mesh(&shapes::bumpy_sphere(160));
    let read = rounded(&dag, Precision::Auto);
    assert!(read.pages.table.len() < dag.pages.table.len());
    assert!(read.pages.word_count() < dag.pages.word_count() * 9 / 10);
    pages_are_as_they_should_be(&dag);
    pages_are_as_they_should_be(&read);
    same_in_another_order(&dag, &read);
}

#[test]
fn what_vertices_and_faces_carry_follows_them_into_other_pages() {
    let dag = damage::rich_mesh(110);
    let read = rounded(&dag, Precision::Auto);
    assert!(read.pages.table.len() < dag.pages.table.len());
    let order = |dag: &Dag| dag.face_ids.as_ref().unwrap().held().to_vec();
    assert!(order(&dag) != order(&read), "no group moved");
    same_in_another_order(&dag, &read);
}

/// Every cluster of a mesh is in what was rounded of it, with the same neighbours above and below; vertices have the
/// same channels under other identities, and faces the same rows.
fn same_in_another_order(dag: &Dag, read: &Dag) {
    let step = read.grid.unwrap().step();
    let key = |dag: &Dag, at| {
        let (record, geometry) = (dag.record(at), dag.geometry(at));
        let snapped = geometry
            .positions
            .iter()
            .map(|p| p.map(|x| ((x / step).round_ties_even() * step + 0.0).to_bits()));
        (record.level, record.error.to_bits(), geometry.triangles.to_vec(), snapped.collect::<Vec<_>>())
    };
    let there: FxHashMap<_, ClusterAddress> = read.pages.addresses().map(|at| (key(read, at), at)).collect();
    assert_eq!(there.len(), dag.cluster_count(), "two clusters are alike, or some are missing");
    let (mut names, mut groups) = (FxHashMap::default(), FxHashMap::default());
    groups.insert(NO_GROUP, NO_GROUP);
    let rows = |dag: &Dag, at| {
        let first = dag.pages.first_face(at);
        let rows = dag.face_ids.as_ref().map(|rows| rows.held()[first..].to_vec()).unwrap_or_default();
        rows.into_iter().take(dag.record(at).triangle_count.into()).collect::<Vec<u32>>()
    };
    for at in dag.pages.addresses() {
        let again = there[&key(dag, at)];
        let (a, b) = (dag.record(at), read.record(again));
        for (before, after) in [(a.group, b.group), (a.refined, b.refined)] {
            assert_eq!(*groups.entry(before).or_insert(after), after);
        }
        assert!(a.level > 0 || rows(dag, at) == rows(read, again));
        for (before, after) in dag.geometry(at).ids.iter().zip(read.geometry(again).ids.iter()) {
            assert_eq!(*names.entry(before).or_insert(after), after);
        }
    }
    assert_eq!(names.values().collect::<BTreeSet<_>>().len(), names.len());
    assert_eq!(groups.values().collect::<BTreeSet<_>>().len(), groups.len());
    for (a, b) in dag.channels.iter().zip(&read.channels) {
        let row =
            |c: &Channel, id: u32| c.words.held()[id as usize * c.info.width()..][..c.info.width()].to_vec();
        assert!(a.info == b.info && names.iter().all(|(before, after)| row(a, *before) == row(b, *after)));
    }
}

#[test]
fn all_positions_lie_on_the_grid_and_the_stated_movement_holds() {
    let dag = build_mesh(&shapes::bumpy_sphere(60));
    let read = rounded(&dag, Precision::Auto);
    let grid = read.grid.unwrap();
    // A sixteenth of the median edge or less: at its poles triangles are thinner.
    let mut edges: Vec<f64> = Vec::new();
    let mut moved = 0f64;
    for (at, again) in dag.pages.addresses().zip(read.pages.addresses()) {
        let (a, b) = (dag.geometry(at), read.geometry(again));
        for (p, q) in a.positions.iter().zip(b.positions.iter()) {
            assert!(q.iter().all(|x| (x / grid.step()).fract() == 0.0));
            let squared = (0..3).map(|k| (f64::from(p[k]) - f64::from(q[k])).powi(2)).sum::<f64>();
            moved = moved.max(squared.sqrt() * dag.frame.scale);
        }
        if dag.record(at).level == 0 {
            edges.extend((0..a.triangles.len()).flat_map(|t| {
                let c = a.corners(t).map(|p| p.map(f64::from));
                [(0, 1), (1, 2), (2, 0)]
                    .map(|(i, j)| (0..3).map(|k| (c[i][k] - c[j][k]).powi(2)).sum::<f64>().sqrt())
            }));
        }
    }
    edges.sort_by(f64::total_cmp);
    let share = f64::from(grid.step()) / edges[edges.len() / 2];
    assert!(share <= 1.0 / 16.0 && share > 1.0 / 128.0, "{share}");
    assert!(moved <= grid.moved && grid.moved <= moved * (1.0 + 1.0e-12), "{moved} of {}", grid.moved);
    assert!(read.rounding() >= dag.frame.rounding + grid.moved);
}

/// The distance between the source and cuts of a mesh that was stored, proven by the measure, against what they state.
#[test]
fn what_cuts_of_stored_meshes_state_holds() {
    let mesh = shapes::bumpy_sphere(40);
    let dag = build_mesh(&mesh);
    for precision in [Precision::Auto, Precision::Step(0.02)] {
        let read = rounded(&dag, precision);
        let largest = dag.groups.iter().map(|g| g.distance()).filter(|e| e.is_finite()).fold(0.0, f32::max);
        for share in [0.0, 0.01, 0.1, 0.5, 1.0] {
            let clusters = select(&read, &Threshold::Uniform(largest * share));
            let cut = extract(&read, &clusters);
            let positions: Vec<[f32; 3]> =
                cut.positions.iter().map(|p| read.frame.to_object(*p).map(|x| x as f32)).collect();
            let a = Surface { positions: &positions, indices: cut.faces.as_flattened() };
            let b = Surface { positions: &mesh.0, indices: mesh.1.as_flattened() };
            let measured = hausdorff_upper(a, b, &[], &BoundOptions::default()).lower;
            let stated = cut_error(&read, &clusters);
            assert!(measured <= stated, "{precision:?} at {share}: {measured} of {stated}");
            assert!(share > 0.0 || stated == read.rounding());
        }
    }
}

#[test]
fn every_truncation_is_a_typed_error() {
    let dag = rich_mesh(4);
    for bytes in [to_bytes(&dag).unwrap(), to_bytes(&rounded(&dag, Precision::Auto)).unwrap()] {
        for length in 0..bytes.len() {
            match from_bytes(&bytes[..length], "short") {
                Err(Error::Format { name, offset, .. }) => {
                    assert_eq!(name, "short");
                    assert!(offset <= bytes.len() as u64);
                }
                other => panic!("length {length}: {:?}", other.map(|_| ())),
            }
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(matches!(from_bytes(&longer, "long"), Err(Error::Format { .. })));
    }
}

#[test]
fn every_flipped_bit_is_found() {
    let dag = rounded(&rich_mesh(4), Precision::Auto);
    let bytes = to_bytes(&dag).unwrap();
    count(cases(2000, 200_000), |random| {
        let mut damaged = bytes.clone();
        let at = pick(bytes.len(), random);
        damaged[at] ^= 1 << pick(8, random);
        match from_bytes(&damaged, "flipped") {
            Err(Error::Format { .. }) => true,
            other => panic!("byte {at}: {:?}", other.map(|_| ())),
        }
    });
}

thread_local! {
    static DECODER: RefCell<Decoder> = RefCell::new(Decoder::new().unwrap());
}

const EVIL: [u32; 9] = [0, 1, 0x7f, 0xff, 0x1_0000, 0x7f80_0000, 0x7fc0_0000, 0x8000_0000, u32::MAX];

fn pick(n: usize, random: &mut Random) -> usize {
    (random.next() * n as f64) as usize
}

/// Damage behind valid checksums: readers may find it or not, but must survive using what they accept.
#[test]
fn hostile_files_never_panic() {
    let dag = rich_mesh(6);
    let kinds = [
        Kind::PageTable,
        Kind::Dependencies,
        Kind::Groups,
        Kind::Nodes,
        Kind::Materials,
        Kind::FaceIds,
        Kind::Channels,
        Kind::Pages,
    ];
    let mut accepted = 0;
    for bytes in [to_bytes(&dag).unwrap(), to_bytes(&rounded(&dag, Precision::Auto)).unwrap()] {
        accepted += count(cases(1500, 400_000), |random| {
            let mut damaged = bytes.clone();
            for _ in 0..=pick(2, random) {
                let place = match pick(2 + kinds.len(), random) {
                    0 => HEADER_BYTES..section(&bytes, Kind::Metadata).start,
                    1 => section(&bytes, Kind::Metadata),
                    k => section(&bytes, kinds[k - 2]),
                };
                let at = place.start + pick(place.len() / 4, random) * 4;
                if place == section(&bytes, Kind::Metadata) {
                    damaged[at] = b"0123456789-e.,"[pick(14, random)];
                } else if pick(2, random) == 0 {
                    damaged[at + pick(4, random)] ^= 1 << pick(8, random);
                } else {
                    let value = EVIL[pick(EVIL.len(), random)];
                    damaged[at..at + 4].copy_from_slice(&value.to_le_bytes());
                }
            }
            reseal(&mut damaged);
            damage::stream(damaged.clone());
            match from_bytes(&damaged, "hostile") {
                Ok(read) => {
                    exercise(read);
                    true
                }
                Err(Error::Format { .. }) => false,
                Err(other) => panic!("{other}"),
            }
        });
    }
    assert!(accepted > 100, "the damage never got past the reader: the test tests nothing");
}

/// The same inside pages, after zstd: bytes of every stream of a page that was written without it.
#[test]
fn hostile_pages_never_panic() {
    let mut accepted = 0;
    for precision in [Precision::Auto, Precision::Exact] {
        let dag = rounded(&rich_mesh(8), precision);

        let contexts = contexts(&dag);
        let each = cases(10_000, 500_000).div_ceil(contexts.len());
        for (p, context) in contexts.iter().enumerate() {
            let entry = dag.pages.table[p];
            let clusters = entry.clusters as usize;
            let mut writer = Writer::new(None).unwrap();
            page_encode::encode(context, dag.pages.page(p), clusters, &mut writer).unwrap();
            let bytes = writer.bytes;
            let decode = |bytes: &[u8]| {
                let mut words = vec![0; entry.words as usize];
                let read =
                    DECODER.with_borrow_mut(|decoder| decoder.decode(context, bytes, clusters, &mut words));
                read.map(|()| words)
            };
            for length in 0..bytes.len() {
                assert!(decode(&bytes[..length]).is_err());
            }
            accepted += count(each, |random| {
                let mut damaged = bytes.clone();
                for _ in 0..=pick(3, random) {
                    let at = pick(bytes.len(), random);
                    damaged[at] = [damaged[at] ^ 1 << pick(8, random), 0, 255][pick(3, random)];
                }
                let Ok(words) = decode(&damaged) else { return false };
                let mut read = dag.clone();
                Arc::make_mut(&mut read.pages).set(p, Some(words.into()));
                let sound = validate::structure(&read).is_ok();
                if sound {
                    exercise(read);
                }
                sound
            });
        }
    }
    assert!(accepted > 100, "the damage never got past the reader: the test tests nothing");
}

/// Rows of the page table that promise more than the file could hold are refused before anything is allocated for them.
#[test]
fn what_is_allocated_is_bounded_by_the_file() {
    let bytes = to_bytes(&rich_mesh(20)).unwrap();
    let table = section(&bytes, Kind::PageTable);
    let refused = |field: std::ops::Range<usize>, value: u64, what: &str| {
        let mut damaged = bytes.clone();
        let row = table.start;
        damaged[row + field.start..row + field.end].copy_from_slice(&value.to_le_bytes()[..field.len()]);
        reseal(&mut damaged);
        match from_bytes(&damaged, "x") {
            Err(Error::Format { message, offset, .. }) => {
                assert!(message.contains(what), "{message}");
                assert!(offset > 0);
            }
            other => panic!("{what}: {:?}", other.map(|_| ())),
        }
    };
    refused(16..20, u64::from(u32::MAX), "too few bytes");
    refused(16..20, 1 + PAGE_MAX_BYTES as u64 / 4, "more than a page");
    refused(16..20, 1, "does not fit");
    refused(8..12, u64::from(u32::MAX), "does not");
    refused(0..8, u64::MAX, "does not follow");
    refused(20..24, u64::from(u32::MAX), "number of clusters");
    refused(28..32, 1, "first group");
    refused(36..40, u64::from(u32::MAX), "number of triangles");
    refused(40..44, u64::from(u32::MAX), "ends before");
    refused(44..48, u64::from(u32::MAX), "too few bytes");
}

/// A frame on a device takes a pass for each node on the longest way down.
#[test]
fn hierarchies_are_not_deeper_than_stated() {
    let dag = rich_mesh(6);
    let below = |links: u32| {
        let mut dag = dag.clone();
        dag.nodes.iter_mut().filter(|n| n.is_leaf == 0).for_each(|n| n.first += links);
        let link = |n: u32| Node { first: n + 1, count: 1, is_leaf: 0, ..dag.nodes[0] };
        dag.nodes.splice(..0, (0..links).map(link).collect::<Vec<_>>());
        dag
    };
    let deep = below(100);
    assert!(from_bytes(&to_bytes(&deep).unwrap(), "x").unwrap() == deep);
    check(&deep, UNINTERRUPTED).unwrap();
    for links in [127, 128, 5000] {
        let deeper = below(links);
        assert!(validate::structure(&deeper).is_err_and(|fault| fault.0 == Kind::Nodes));
        assert!(matches!(to_bytes(&deeper), Err(Error::Invariant(_))));
    }
}

/// What is stated to be too coarse all through would be left out: a statement above any cluster's own error is refused, and
/// one below only costs time.
#[test]
fn least_errors_that_clusters_undercut_are_refused() {
    let dag = rich_mesh(20);
    let fault = |change: &dyn Fn(&mut [Group], &mut [Node])| {
        let mut damaged = dag.clone();
        let mut groups = damaged.groups.to_vec();
        change(&mut groups, &mut damaged.nodes);
        damaged.groups = groups.into();
        validate::structure(&damaged).err().map(|fault| (fault.0, fault.1))
    };
    let coarse = dag.groups.iter().position(|group| group.min_own_error > 0.0).unwrap();
    let (leaf, inner) = (0..dag.nodes.len()).partition::<Vec<_>, _>(|n| dag.nodes[*n].is_leaf == 1);
    assert_eq!(fault(&|_, _| {}), None);
    for value in [f32::NAN, f32::NEG_INFINITY, dag.groups[coarse].min_own_error.next_up()] {
        let refused = fault(&|groups, nodes| {
            groups[coarse].min_own_error = value;
            nodes.iter_mut().for_each(|node| node.min_own_error = SOURCE_ERROR);
        });
        assert!(refused.is_some(), "{value}");
    }
    for n in [leaf[0], inner[0]] {
        for value in [f32::NAN, f32::INFINITY, dag.nodes[n].min_own_error.next_up()] {
            let refused = fault(&|_, nodes| nodes[n].min_own_error = value);
            assert!(refused.is_some_and(|(kind, what)| kind == Kind::Nodes && what.contains("least")));
        }
    }
    assert_eq!(fault(&|_, nodes| nodes.iter_mut().for_each(|node| node.min_own_error = SOURCE_ERROR)), None);
}

#[test]
fn channels_that_do_not_fit_are_refused() {
    let dag = rich_mesh(6);
    let refused = |change: &dyn Fn(&mut Dag), what: &str| {
        let mut damaged = dag.clone();
        change(&mut damaged);
        match to_bytes(&damaged) {
            Err(Error::Invariant(message)) => assert!(message.contains(what), "{message}"),
            other => panic!("{what}: {:?}", other.map(|_| ())),
        }
    };
    let words = |d: &mut Dag, channel: usize, change: &dyn Fn(&mut Vec<u32>)| {
        let mut words = d.channels[channel].words.held().to_vec();
        change(&mut words);
        d.channels[channel].words = words.into();
    };
    refused(&|d| words(d, 0, &|words| words[3] = f32::NAN.to_bits()), "values");
    refused(&|d| d.channels[1].info.dtype = ChannelType::Bool, "values");
    refused(&|d| d.channels[1].info.name = "heat".into(), "name");
    refused(&|d| d.channels[0].info.columns = Some(0), "width");
    refused(&|d| d.channels[0].info.columns = Some(u32::MAX), "rows");
    refused(&|d| words(d, 1, &|words| words.truncate(5)), "rows");
    refused(&|d| words(d, 1, &|words| words.push(0)), "rows");
    let spoil = |d: &mut Dag| {
        let mut words = d.pages.page(0).to_vec();
        words[0] = f32::NAN.to_bits();
        Arc::make_mut(&mut d.pages).set(0, Some(words.into()));
    };
    refused(&spoil, "bounds");
    refused(
        &|d| d.grid = Some(Grid { exponent: 3, normal_bits: 8, uv_exponent: None, moved: 0.0 }),
        "positions",
    );
    let few_bits = |d: &mut Dag| {
        *d = quantize(d, Precision::Auto).unwrap();
        d.grid.as_mut().unwrap().normal_bits = 4;
    };
    refused(&few_bits, "no order");
    refused(&|d| d.grid = Some(Grid { exponent: 99, normal_bits: 8, uv_exponent: None, moved: 0.0 }), "grid");

    // The same of files: lengths in the metadata that the section does not have.
    let bytes = to_bytes(&dag).unwrap();
    let json = section(&bytes, Kind::Metadata);
    let text = std::str::from_utf8(&bytes[json.clone()]).unwrap();
    for (from, to, what) in [
        ("\"columns\": 2", "\"columns\": 1", "bytes for"),
        ("\"columns\": 2", "\"columns\": 9", "bytes for"),
        ("\"int32\"", "\"bool\" ", "values"),
    ] {
        let at = json.start + text.find(from).unwrap();
        let mut damaged = bytes.clone();
        damaged[at..at + to.len()].copy_from_slice(to.as_bytes());
        reseal(&mut damaged);
        match from_bytes(&damaged, "x") {
            Err(Error::Format { message, .. }) => assert!(message.contains(what), "{message}"),
            other => panic!("{what}: {:?}", other.map(|_| ())),
        }
    }
}

/// Any surface, whatever it carries and however its triangles hang together.
#[derive(Clone, Debug)]
struct Anything {
    positions: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
    colors: ColorFormat,
    uv_sets: usize,
    materials: bool,
    channel: bool,
    face_ids: bool,
    triangles: usize,
    step: f64,
}

fn anything() -> impl Strategy<Value = Anything> {
    let face = prop::array::uniform3(0u32..60);
    let position = prop::array::uniform3(-8i32..8).prop_map(|p| p.map(|x| x as f32 * 0.37));
    let mesh = (prop::collection::vec(position, 60), prop::collection::vec(face, 1..300));
    let colors = prop::sample::select(vec![
        ColorFormat::None,
        ColorFormat::Unorm8,
        ColorFormat::Unorm16,
        ColorFormat::Float32,
    ]);
    let carries = (colors, 0usize..3, any::<bool>(), any::<bool>(), any::<bool>());
    (mesh, carries, 16usize..=128, -8.0f64..1.0).prop_map(|(mesh, carries, triangles, step)| Anything {
        positions: mesh.0,
        faces: mesh.1,
        colors: carries.0,
        uv_sets: carries.1,
        materials: carries.2,
        channel: carries.3,
        face_ids: carries.4,
        triangles,
        step: 10f64.powf(step),
    })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: cases(60, 5000) as u32, failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn any_mesh_comes_back(any in anything()) {
        let Anything { positions, faces, .. } = &any;
        let bytes: Vec<[u8; 4]> = (0..positions.len()).map(|i| [i as u8, 3, (i * 77) as u8, 255]).collect();
        let shorts: Vec<[u16; 4]> = bytes.iter().map(|c| c.map(|x| u16::from(x) * 256 + 7)).collect();
        let fine: Vec<[f32; 4]> = bytes.iter().map(|c| c.map(|x| f32::from(x).sqrt() / 16.0)).collect();
        let uvs: Vec<[f32; 2]> = positions.iter().map(|p| [p[0] * 1.0e-3, -p[1] * 1.0e7]).collect();
        let words: Vec<u32> = (0..positions.len() as u32).map(|i| i * 0x0101_0101).collect();
        let materials: Vec<i32> = (0..faces.len() as i32).map(|f| f / 9 - 4).collect();
        let mut source = SourceMesh::new(Positions::F32(positions), faces);
        source.colors = match any.colors {
            ColorFormat::None => None,
            ColorFormat::Unorm8 => Some(Colors::U8(&bytes)),
            ColorFormat::Unorm16 => Some(Colors::U16(&shorts)),
            ColorFormat::Float32 => Some(Colors::F32(&fine)),
        };
        source.uvs = vec![&uvs; any.uv_sets];
        source.materials = any.materials.then_some(&materials);
        if any.channel {
            let info = ChannelInfo { name: "label".into(), dtype: ChannelType::Uint32, columns: None };
            source.channels = vec![SourceChannel { info, words: &words }];
        }
        let options = BuildOptions {
            face_ids: any.face_ids,
            cluster_triangles: any.triangles,
            ..BuildOptions::default()
        };
        // Nothing may be left of such faces.
        if let Ok(dag) = build(&source, &options, &Silent) {
            check(&dag, UNINTERRUPTED).unwrap();
            prop_assert!(from_bytes(&to_bytes(&dag).unwrap(), "x").unwrap() == dag);
            for precision in [Precision::Auto, Precision::Step(any.step)] {
                let expected = quantize(&dag, precision).unwrap();
                prop_assert!(from_bytes(&to_bytes(&expected).unwrap(), "x").unwrap() == expected);
            }
        }
    }
}
