//! Bounds of steps against the deviation at points, by its definition and over all triangles.

use super::*;
use crate::build::simplify::{Effort, simplify};
use crate::config::{BuildOptions, Quality};
use crate::mesh::{Colors, Positions, SourceChannel, SourceMesh, weld};
use crate::model::{BuildReport, ChannelInfo, ChannelType};

/// Points along an edge of a triangle at which deviations are looked at, corners included.
const ALONG: usize = 9;

/// A curved square of 2·n² triangles, and what it carries.
fn group(kind: &str, n: usize, normal_weight: f32, quality: Quality) -> (LocalMesh, Content, BuildOptions) {
    let seam = n / 2;
    // With UVs the middle column is there twice.
    let columns: Vec<usize> =
        if kind == "seam" { (0..=seam).chain(seam..=n).collect() } else { (0..=n).collect() };
    let wide = columns.len();
    let at = |k: usize| {
        let (x, y) = (columns[k % wide] as f32 / n as f32, (k / wide) as f32 / n as f32);
        // Rows are not straight, so that nothing collapses for free.
        (x, y + 0.02 * (7.0 * x).sin())
    };
    let points: Vec<(f32, f32)> = (0..wide * (n + 1)).map(at).collect();
    let height = if kind == "flat" { 0.0 } else { 0.1 };
    let positions: Vec<[f32; 3]> =
        points.iter().map(|(x, y)| [*x, *y, height * (5.0 * x).sin() * (4.0 * y).cos()]).collect();
    let mut faces = Vec::new();
    for j in 0..n {
        for i in (0..wide - 1).filter(|i| columns[*i] != columns[i + 1]) {
            let a = (j * wide + i) as u32;
            let above = a + wide as u32;
            faces.extend([[a, a + 1, above + 1], [a, above + 1, above]]);
        }
    }
    let inside = |x: f32, y: f32| (x - 0.5).hypot(y - 0.5) < 0.3;
    let hashed = |k: usize| (k as u32).wrapping_mul(0x9e37_79b1) >> 16;
    let byte = |x: f32| (127.0 + 120.0 * x) as u8;
    let colors: Vec<[u8; 4]> = points
        .iter()
        .enumerate()
        .map(|(k, (x, y))| match kind {
            "noise" => [hashed(k) as u8, hashed(k + 7) as u8, 0, 255],
            "smooth" => [byte((6.0 * x).sin()), byte((5.0 * y).cos()), byte((x * y * 9.0).sin()), 255],
            _ => [if inside(*x, *y) { 255 } else { 0 }, 0, 40, 255],
        })
        .collect();
    let uvs: Vec<[f32; 2]> = (0..points.len())
        .map(|k| [points[k].0 + if k % wide > seam { 3.0 } else { 0.0 }, points[k].1])
        .collect();
    let normals: Vec<[f32; 3]> =
        points.iter().map(|(x, y)| [(9.0 * x).sin(), (7.0 * y).cos(), 1.0 + 0.5 * x]).collect();
    let labels: Vec<u32> =
        points.iter().map(|(x, y)| u32::from(inside(*x, *y)) + 2 * u32::from(x + 0.3 * y > 0.7)).collect();
    let floats: Vec<u32> = points.iter().map(|(x, y)| (x * x - 40.0 * y).to_bits()).collect();
    let materials: Vec<i32> = faces.iter().map(|f| i32::from(points[f[0] as usize].0 >= 0.4)).collect();
    let channel = |name: &str, dtype, words| SourceChannel {
        info: ChannelInfo { name: name.into(), dtype, columns: None },
        words,
    };
    let has = |what: &str| kind == what || kind == "all";
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    if ["flat", "noise", "smooth", "colors", "all"].contains(&kind) {
        source.colors = Some(Colors::U8(&colors));
    }
    if kind == "seam" {
        source.uvs.push(&uvs);
    }
    if has("normals") {
        source.normals = Some(&normals);
    }
    if has("labels") {
        source.channels.push(channel("part", ChannelType::Uint32, &labels));
    }
    if has("floats") {
        source.channels.push(channel("heat", ChannelType::Float32, &floats));
    }
    if has("materials") {
        source.materials = Some(&materials);
    }
    let options = BuildOptions { quality, normal_weight, ..BuildOptions::default() };
    let mesh = weld(&source, None, &mut BuildReport::default()).unwrap();
    let content = Content::new(&mesh, source.normals.is_none(), &options);
    let local = LocalMesh {
        ids: (0..mesh.positions.len() as u32).collect(),
        position_ids: hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3),
        locked: vec![false; mesh.positions.len()],
        labels: mesh.channels.label_numbers(),
        indices: mesh.faces.as_flattened().to_vec(),
        positions: mesh.positions,
        attributes: mesh.attributes,
        materials: mesh.materials,
        copies: Vec::new(),
    };
    (local, content, options)
}

/// A point of a surface with what it carries.
struct Probe {
    position: Vec3,
    row: Vec<f32>,
    /// Those it may have: several on a line between them.
    labels: Vec<u32>,
    material: u32,
}

fn corners(mesh: &LocalMesh) -> impl Iterator<Item = [usize; 3]> {
    mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|v| v as usize))
}

fn triangle(mesh: &LocalMesh, t: [usize; 3]) -> [Vec3; 3] {
    t.map(|v| mesh.positions[v].map(f64::from))
}

fn labels_at(labels: [u32; 3], at: Shares) -> Vec<u32> {
    let share = |label: u32| (0..3).filter(|k| labels[*k] == label).map(|k| at[k]).sum::<f64>();
    let most = labels.iter().fold(0.0, |most, label| share(*label).max(most));
    labels.into_iter().filter(|label| share(*label) > most - 1e-9).collect()
}

fn row(mesh: &LocalMesh, content: &Content, t: [usize; 3], at: Shares) -> Vec<f32> {
    let stride = content.stride();
    let mut row: Vec<f64> = (0..stride)
        .map(|c| (0..3).map(|k| at[k] * f64::from(mesh.attributes[t[k] * stride + c])).sum())
        .collect();
    let size = row[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
    row[..3].iter_mut().for_each(|x| *x /= size);
    row.into_iter().map(|x| x as f32).collect()
}

fn probes<'a>(mesh: &'a LocalMesh, content: &'a Content) -> impl Iterator<Item = Probe> + 'a {
    corners(mesh).flat_map(move |t| {
        let places = (0..ALONG).flat_map(|i| (0..ALONG - i).map(move |j| (i, j)));
        places.map(move |(i, j)| {
            let [v, w] = [i, j].map(|x| x as f64 / (ALONG - 1) as f64);
            let at = [1.0 - v - w, v, w];
            let labels =
                if mesh.labels.is_empty() { vec![] } else { labels_at(t.map(|v| mesh.labels[v]), at) };
            Probe {
                position: mix(at, triangle(mesh, t)),
                row: row(mesh, content, t, at),
                labels,
                material: mesh.materials.get(t[0]).copied().unwrap_or(0),
            }
        })
    })
}

/// What a probe deviates from a place of another surface, by the definition, for distances above `free`.
fn deviation(
    probe: &Probe,
    mesh: &LocalMesh,
    content: &Content,
    t: [usize; 3],
    at: Shares,
    edge: f64,
    free: f64,
) -> f64 {
    let q = mix(at, triangle(mesh, t));
    let distance = (0..3).map(|k| (q[k] - probe.position[k]).powi(2)).sum::<f64>().sqrt();
    let scale = edge.max(edge_of_area(area(t.map(|v| mesh.positions[v]))));
    let rows = t.map(|v| &mesh.attributes[v * content.stride()..][..content.stride()]);
    let mut most = f64::from(content.deviation(&probe.row, rows, at.map(|x| x as f32)));
    if mesh.materials.get(t[0]).copied().unwrap_or(0) != probe.material {
        most = most.max(1.0);
    }
    if !mesh.labels.is_empty() {
        let labels = labels_at(t.map(|v| mesh.labels[v]), at);
        if !labels.iter().any(|label| probe.labels.contains(label)) {
            most = most.max(content.label_weight.into());
        }
    }
    (distance - free).max(scale * most)
}

/// The least deviation of a probe over a surface: at the nearest points of triangles, at those of their parts with
/// the label, and, if none is within `enough`, where a search over each triangle ends.
fn least(probe: &Probe, mesh: &LocalMesh, content: &Content, edge: f64, free: f64, enough: f64) -> f64 {
    let mut least = f64::INFINITY;
    for t in corners(mesh) {
        let p = triangle(mesh, t);
        let mut places = vec![place_in(probe.position, p, &CORNER).0];
        if !mesh.labels.is_empty() {
            let labels = t.map(|v| mesh.labels[v]);
            for label in probe.labels.iter().filter(|label| labels.contains(label)) {
                let (region, count) = region_of(*label, labels);
                places.push(place_in(probe.position, p, &region[..count]).0);
            }
        }
        for at in places {
            least = least.min(deviation(probe, mesh, content, t, at, edge, free));
        }
    }
    if least <= enough {
        return least;
    }
    for t in corners(mesh) {
        let mut at = place_in(probe.position, triangle(mesh, t), &CORNER).0;
        let mut here = deviation(probe, mesh, content, t, at, edge, free);
        let mut step = 0.25;
        while step > 1e-4 {
            let around = (0..12).map(|k| {
                let angle = f64::from(k) * std::f64::consts::TAU / 12.0;
                let [v, w] =
                    [at[1] + step * angle.cos(), at[2] + step * angle.sin()].map(|x| x.clamp(0.0, 1.0));
                let over = (v + w).max(1.0);
                [1.0 - (v + w) / over, v / over, w / over]
            });
            let best = around
                .map(|at| (deviation(probe, mesh, content, t, at, edge, free), at))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match best {
                Some((deviation, place)) if deviation < here => (here, at) = (deviation, place),
                _ => step /= 2.0,
            }
        }
        least = least.min(here);
    }
    least
}

/// The largest deviation of a probe of either surface.
fn sampled(before: &LocalMesh, after: &LocalMesh, content: &Content, free: f64, bound: f64) -> f64 {
    let edge = f64::from(mean_edge(before));
    let of = |from: &LocalMesh, onto: &LocalMesh| {
        probes(from, content).map(|p| least(&p, onto, content, edge, free, bound)).fold(0.0, f64::max)
    };
    of(before, after).max(of(after, before))
}

/// What content.deviation, in f32, is off.
const F32: f64 = 1e-5;

const KINDS: [&str; 10] =
    ["flat", "noise", "smooth", "colors", "seam", "normals", "labels", "floats", "materials", "all"];

#[test]
fn no_point_deviates_more_than_bounds_state_and_they_are_near() {
    let mut ratios = Vec::new();
    for kind in KINDS {
        for quality in [Quality::Fast, Quality::Best] {
            let (before, content, options) = group(kind, 10, 1.0, quality);
            let target = before.indices.len() / 6;
            let after = simplify(&before, target, Effort::ANY, &content, &options, None).unwrap().mesh;
            let floor = FLOOR * f64::from(mean_edge(&before));
            for free in [0.0, 0.002, 0.02] {
                let bound = f64::from(step_deviation(&before, &after, &content, free));
                let found = sampled(&before, &after, &content, free.into(), bound);
                assert!(found <= bound + F32, "{kind} {quality:?} {free}: {found} is more than {bound}");
                println!(
                    "{kind} {quality:?} {free}: bound {bound:.5}, sampled {found:.5}, {:.2}",
                    bound / found
                );
                // Below the floor nothing is told apart.
                if found > 10.0 * floor {
                    ratios.push(bound / found);
                }
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    let (median, most) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
    println!("bound ÷ sampled: median {median:.2}, largest {most:.2}");
    assert!(ratios.len() > 40 && median < 1.25 && most < 2.0, "{median} {most}");
}

#[test]
fn what_stays_deviates_by_nothing_but_rounding() {
    for kind in KINDS {
        let (mesh, content, _) = group(kind, 8, 1.0, Quality::Fast);
        let bound = step_deviation(&mesh, &mesh, &content, 0.0);
        assert!(bound < 1e-8, "{kind}: {bound}");
    }
}

#[test]
fn a_point_that_only_interiors_tell_apart_is_seen() {
    // A quad with its other diagonal: the vertices are the same, and the middle is not.
    let (mut before, content, _) = group("colors", 1, 1.0, Quality::Fast);
    let stride = content.stride();
    before.attributes.chunks_exact_mut(stride).enumerate().for_each(|(v, row)| {
        row[3] = f32::from(u8::from(v == 0 || v == 3));
    });
    let mut after = before.clone();
    let [a, b, c, d] = [before.indices[0], before.indices[1], before.indices[2], before.indices[5]];
    after.indices = vec![a, b, d, b, c, d];
    let edge = f64::from(mean_edge(&before));
    let bound = f64::from(step_deviation(&before, &after, &content, 10.0));
    let found = sampled(&before, &after, &content, 0.0, bound);
    assert!(found > 0.3 * edge, "{found} {edge}");
    let close = f64::from(step_deviation(&before, &after, &content, 0.0));
    assert!(close >= found - F32 && bound <= close, "{bound} {close} {found}");
}
