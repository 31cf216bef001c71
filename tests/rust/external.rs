//! Builds in blocks: of one level, and of all.

use nanite_rs::build::{Meter, Silent, check};
use nanite_rs::config::{BuildOptions, Levels};
use nanite_rs::external::Work;
use nanite_rs::lod::{load, select};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::rule::{ROOT_ERROR, Threshold};
use nanite_rs::model::{Dag, UNINTERRUPTED};

use crate::shapes;

fn in_blocks(source: &SourceMesh<'_>, options: &BuildOptions, then: impl FnOnce(&Dag, usize)) {
    let folder = tempfile::tempdir().unwrap();
    let mut work = Work::begin(source, options, 1 << 20, folder.path(), "a sphere").unwrap();
    let meter = Meter::new(&Silent, 2 * source.faces.len() as u64);
    let mut stages = 1;
    loop {
        let blocks = work.missing();
        assert!(stages > 1 || blocks.len() > 1, "it does not fit");
        blocks.into_iter().for_each(|block| work.make(source, block, &meter).unwrap());
        if !work.advance().unwrap() {
            break;
        }
        stages += 1;
    }
    let dag = work.finish().unwrap();
    check(&dag, UNINTERRUPTED).unwrap();
    then(&dag, stages);
}

#[test]
fn one_level_is_the_source() {
    let (positions, faces) = shapes::bumpy_sphere(80);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    let options = BuildOptions { levels: Levels::One, ..BuildOptions::default() };
    in_blocks(&source, &options, |dag, stages| {
        assert_eq!((stages, dag.report.levels.len()), (1, 1));
        assert!(dag.groups.iter().all(|group| group.level == 0 && group.error == ROOT_ERROR));
        for error in [0.0, 1.0e9] {
            let threshold = Threshold::Uniform(error);
            load(dag, &threshold, UNINTERRUPTED).unwrap();
            let clusters = select(dag, &threshold);
            let triangles = clusters.iter().map(|at| usize::from(dag.record(*at).triangle_count));
            assert_eq!(triangles.sum::<usize>(), faces.len());
        }
    });
}

#[test]
fn all_levels_end_in_a_root() {
    let (positions, faces) = shapes::bumpy_sphere(80);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    in_blocks(&source, &BuildOptions::default(), |dag, stages| {
        assert!(stages > 1);
        let last = dag.report.levels.last().unwrap();
        assert!(last.clusters == 1 && last.triangles < 100, "{last:?}");
    });
}
