//! What a mask of triangles per side of a cube could leave out: `cargo bench --bench face_mask [file.nanite …]`.
//!
//! Around a cluster lies a cube, and the eye sees it through one of the six sides. A triangle that faces away from every
//! eye behind a side needs no work there; 6 × 128 bits of a cluster would say which do (Haar and Aaltonen, "GPU-Driven
//! Rendering Pipelines", 2015). This counts such triangles among those of clusters that the cone leaves. They are 1 to 13
//! of 100, and end in the rasterizer at the sign of their area; so clusters carry no such masks.

use std::path::Path;
use std::sync::Arc;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, RenderOptions};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::{ClusterAddress, Dag, UNINTERRUPTED};
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Camera, Material, Projection, Scene};

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

type Point = [f64; 3];

fn minus(a: Point, b: Point) -> Point {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Triangles of a cluster, those that face away from the eye (internal units), and those that the mask would leave out.
fn count(mesh: &Dag, at: ClusterAddress, eye: Point) -> [usize; 3] {
    let geometry = mesh.geometry(at);
    let to_eye = minus(eye, mesh.record(at).center.map(f64::from));
    let axis = (0..3).fold(0, |best, k| if to_eye[k].abs() > to_eye[best].abs() { k } else { best });
    let corners = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|[u, v]| {
        let mut corner = [0.0; 3];
        (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (to_eye[axis].signum(), u, v);
        corner
    });
    let mut counts = [geometry.triangles.len(), 0, 0];
    for t in 0..geometry.triangles.len() {
        let [a, b, c] = geometry.corners(t).map(|p| p.map(f64::from));
        let (u, v) = (minus(b, a), minus(c, a));
        let normal: Point =
            std::array::from_fn(|k| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
        counts[1] += usize::from(dot(normal, minus(eye, a)) <= 0.0);
        counts[2] += usize::from(corners.iter().all(|corner| dot(normal, *corner) <= 0.0));
    }
    counts
}

fn look(name: &str, mesh: &Arc<Dag>) {
    let frame = mesh.frame;
    let center: Point = std::array::from_fn(|k| {
        frame.origin[k] + frame.scale * 0.5 * f64::from(mesh.bounds.min[k] + mesh.bounds.max[k])
    });
    let size =
        (0..3).map(|k| f64::from(mesh.bounds.max[k] - mesh.bounds.min[k])).fold(0.0, f64::max) * frame.scale;
    let camera = Camera {
        projection: Projection::Perspective { yfov: 0.8, aspect: None },
        znear: 1e-3 * size,
        zfar: None,
    };
    let identity = std::array::from_fn(|r| std::array::from_fn(|c| f64::from(u8::from(r == c))));
    let mut scene = Scene::new();
    scene.add(Arc::clone(mesh), &identity, Material::default()).expect("an instance");
    let options = RenderOptions { occlusion: false, ..RenderOptions::default() };
    for away in [1.3, 3.0, 10.0] {
        let eye = [center[0], center[1], center[2] + away * size];
        let mut pose: [[f64; 4]; 4] = identity;
        (0..3).for_each(|k| pose[k][3] = eye[k]);
        let mut renderer = Renderer::new(1280, 720, "cpu").expect("a renderer");
        let drawn = renderer.render(&scene, &camera, &pose, &options).expect("a frame");
        let eye = std::array::from_fn(|k| (eye[k] - frame.origin[k]) / frame.scale);
        let sum = |sums: [usize; 3], (_, at): (u32, ClusterAddress)| {
            let own = count(mesh, at, eye);
            std::array::from_fn(|k| sums[k] + own[k])
        };
        let [all, away_from_eye, alpha_tested] = drawn.visible().into_iter().fold([0; 3], sum);
        let share = |n: usize| 100.0 * n as f64 / all.max(1) as f64;
        println!(
            "{name}, {away} sizes away: {all} triangles of drawn clusters, {:.0} % face away, the mask knows {:.1} %",
            share(away_from_eye),
            share(alpha_tested)
        );
    }
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    for file in &files {
        let mesh = nanite_rs::format::open(Path::new(file)).expect("a mesh");
        mesh.pages.load_all(UNINTERRUPTED).expect("its pages");
        look(file, &Arc::new(mesh));
    }
    if files.is_empty() {
        let (positions, faces) = shapes::bumpy_sphere(250);
        let source = SourceMesh::new(Positions::F32(&positions), &faces);
        look("wavy sphere", &Arc::new(build(&source, &BuildOptions::default(), &Silent).expect("it builds")));
    }
}
