//! Builds in blocks.

use nanite_rs::build::{Meter, Silent, check};
use nanite_rs::config::BuildOptions;
use nanite_rs::external::Work;
use nanite_rs::mesh::{Positions, SourceMesh};
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
fn all_levels_end_in_a_root() {
    let (positions, faces) = shapes::bumpy_sphere(80);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    in_blocks(&source, &BuildOptions::default(), |dag, stages| {
        assert!(stages > 1);
        let last = dag.report.levels.last().unwrap();
        assert!(last.clusters == 1 && last.triangles < 100, "{last:?}");
    });
}
