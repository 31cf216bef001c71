use super::*;
use crate::build::Silent;
use crate::mesh::Positions;

/// A hilly grid of `n` × `n` squares, with a plain half.
fn hills(n: usize) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let height = |x: f32, y: f32| if x < 0.5 { 0.0 } else { 0.1 * (9.0 * (x - 0.5)).sin() * (8.0 * y).cos() };
    let at = |i: usize| i as f32 / n as f32;
    let row = |j: usize| (0..=n).map(move |i| (at(i), at(j)));
    let points = (0..=n).flat_map(row).map(|(x, y)| [x, y, height(x, y)]).collect();
    let square = |k: usize| {
        let a = (k / n * (n + 1) + k % n) as u32;
        let b = a + n as u32 + 1;
        [[a, a + 1, b + 1], [a, b + 1, b]]
    };
    (points, (0..n * n).flat_map(square).collect())
}

fn decimated(mesh: &(Vec<[f32; 3]>, Vec<[u32; 3]>), goal: Goal, quality: Quality) -> CutArrays {
    let source = SourceMesh::new(Positions::F32(&mesh.0), &mesh.1);
    let options = BuildOptions { quality, ..BuildOptions::default() };
    decimate(&source, goal, &options, &Silent).unwrap().arrays
}

#[test]
fn targets_are_met_in_one_piece_and_in_blocks() {
    for n in [40, 400] {
        let mesh = hills(n);
        for target in [mesh.1.len() * 9 / 10, mesh.1.len() / 10, 100] {
            for quality in [Quality::Best, Quality::Fast] {
                let goal = Goal { target, ..Goal::default() };
                let found = decimated(&mesh, goal, quality).faces.len();
                let short = 2.max(target / 200);
                assert!((target - short..=target).contains(&found), "{found} of {target}, {quality:?}");
            }
        }
    }
}

#[test]
fn an_exact_round_keeps_so_many() {
    let (positions, faces) = hills(300);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    let options = BuildOptions { quality: Quality::Best, ..BuildOptions::default() };
    let mut report = BuildReport::default();
    let mut mesh = weld(&source, None, &mut report).unwrap();
    let content = Content::new(&mesh, true, &options);
    let stride = mesh.stride;
    let channels = std::mem::take(&mut mesh.channels);
    let whole = whole(mesh, &channels, false);
    let meter = Meter::new(&Silent, 1);
    let mut rounds = Rounds { whole, stride, goal: Goal::default(), content, options, meter };
    for (number, wanted) in [(0, 120_000), (1, 100_000)] {
        rounds.round(number, wanted, true).unwrap();
        assert!((wanted - 2..=wanted).contains(&rounds.faces()), "{} of {wanted}", rounds.faces());
    }
}

#[test]
fn what_is_plain_goes_without_loss() {
    let mesh = hills(200);
    let goal = Goal { lossless: true, ..Goal::default() };
    let found = decimated(&mesh, goal, Quality::Fast);
    // The other half is curved all over.
    let plain = found.faces.iter().filter(|t| t.iter().all(|v| found.positions[*v as usize][2] == 0.0));
    assert!(plain.count() < 2_000);
    assert!(found.faces.len() > 30_000 && found.faces.len() < 50_000, "{}", found.faces.len());
}
