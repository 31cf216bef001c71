//! Cuts that are finished for a number of triangles.

use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, ErrorMeasure, Quality};
use nanite_rs::finish::Finisher;
use nanite_rs::mesh::edges::Edges;
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;

use crate::shapes;

fn built((positions, faces): &shapes::Mesh, options: &BuildOptions) -> Dag {
    build(&SourceMesh::new(Positions::F32(positions), faces), options, &Silent).unwrap()
}

/// Numbers of triangles over the whole range of a mesh, the least of all first.
fn targets(finisher: &Finisher, dag: &Dag) -> Vec<u64> {
    let least = finisher.budget.faces(finisher.budget.beside(0).coarse);
    let steps =
        (0..16).map(|i| least as f64 * (dag.source_faces as f64 / least as f64).powf(f64::from(i) / 15.0));
    steps.map(|x| x as u64).chain([least + 1, least + 3, dag.source_faces - 1]).collect()
}

#[test]
fn budgets_are_met_by_closed_cuts() {
    for (mesh, closed) in [
        (shapes::bumpy_sphere(48), true),
        (shapes::cube(24), true),
        (shapes::torus(120, 60), true),
        (shapes::grid(90, |x, y| 0.2 * (9.0 * x).sin() * (7.0 * y).cos()), false),
    ] {
        for quality in [Quality::Fast, Quality::Best] {
            for error in [ErrorMeasure::Bound, ErrorMeasure::Quadric] {
                let dag = built(&mesh, &BuildOptions { quality, error, ..BuildOptions::default() });
                let finisher = Finisher::new(&dag);
                for target in targets(&finisher, &dag) {
                    let cut = finisher.exact(&dag, target).unwrap();
                    let arrays = cut.extract(&dag);
                    let count = arrays.faces.len() as u64;
                    assert!(count <= target && count + 2.max(target / 200) >= target, "{count} for {target}");
                    let edges = Edges::of(&arrays.faces);
                    let open = edges.iter().filter(|edge| edge.open() != 0).count();
                    assert_eq!(open == 0, closed, "{open} open edges at {target}");
                    assert_eq!(*arrays.first_face.last().unwrap() as u64, count);
                    assert_eq!(arrays.first_face.len(), cut.clusters.len() + cut.parts().len() + 1);
                    assert!(cut.error(&dag).is_finite() && cut.attribute_error(&dag) == 0.0);
                }
            }
        }
    }
}

#[test]
fn what_whole_groups_meet_is_left_to_them() {
    let dag = built(&shapes::bumpy_sphere(48), &BuildOptions::default());
    let finisher = Finisher::new(&dag);
    for replaced in [0, 1, 3] {
        let faces = finisher.budget.faces(replaced);
        let cut = finisher.exact(&dag, faces).unwrap();
        assert!(cut.made.is_none());
        assert_eq!(cut.clusters, finisher.budget.select(&dag, faces));
    }
    assert!(finisher.exact(&dag, u64::MAX).unwrap().made.is_none());
    let least = finisher.exact(&dag, 0).unwrap();
    assert!(least.made.is_none() && !least.clusters.is_empty());
}

/// Each way to come to fewer triangles, from the same clusters, has vertices that are named apart.
#[test]
fn new_vertices_have_names_of_their_own() {
    let dag = built(&shapes::bumpy_sphere(48), &BuildOptions::default());
    let finisher = Finisher::new(&dag);
    let cut = finisher.exact(&dag, dag.source_faces / 3).unwrap();
    let arrays = cut.extract(&dag);
    let mut ids = arrays.ids.clone();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), arrays.ids.len());
    let new = arrays.ids.iter().filter(|id| **id >= dag.vertex_count).count();
    assert!(new > 0 && new < arrays.ids.len() / 4);
    let last = ids.last().unwrap() - dag.vertex_count;
    assert_eq!(last as usize + 1, new, "numbered without gaps");
}
