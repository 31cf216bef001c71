//! Three traversals of the hierarchies of a scene, in turn, on the device: `cargo bench --bench traversal`; with a number
//! n behind `--`, on a mesh of 8·n² triangles. Every frame of
//! every form is compared with the others, and with what the product draws.

use std::sync::Arc;

use bytemuck::Zeroable;
use glam::{DAffine3, DVec3};
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, ErrorMeasure, Raster, Shading};
use nanite_rs::gpu::meshes::Meshes;
use nanite_rs::gpu::{Context, DeviceRenderer, SceneInstance, ViewRequest, Ways};
use nanite_rs::gpu_types::{InstanceMaterial, View, VisibleCluster};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;
use nanite_rs::scene::{Camera, Material, Projection, Scene};
use nanite_rs::stages::Stage;
use nanite_rs::stream::Resident;

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

#[path = "traversal/forms.rs"]
mod forms;
#[path = "traversal/kernels.rs"]
mod kernels;
#[path = "traversal/parts.rs"]
mod parts;

use forms::{FORMS, Form, Forms, Found, INDIRECT_ENTRIES, IndirectEntry, Slots, slots};
use kernels::{RING, Ring};

/// 1.0 M triangles.
const SIZE: usize = 354;
/// Instances: 1 M, 100 M and 10 G triangles.
const CROWDS: [usize; 3] = [1, 100, 10_000];
/// Of the eye from the middle of the first ten: among them, in front of them, and where all is small.
const DISTANCES: [(&str, f64); 3] = [("near", 1.8), ("middle", 9.0), ("far", 80.0)];
const PICTURE: (u32, u32) = (1280, 720);
const TAU: f32 = 1.0;
/// Frames that count, after those that do not: a degree apart.
const FRAMES: usize = 24;
const WARM_UP: usize = 3;
const CAMERA: Camera =
    Camera { projection: Projection::Perspective { yfov: 0.8, aspect: None }, znear: 0.05, zfar: None };

/// Tens of five columns and two rows, one behind the other, as `benchmarks/python/gpu.py` has them.
fn crowd(mesh: &Arc<Dag>, count: usize) -> Slots {
    let mut scene = Scene::new();
    for k in 0..count {
        let (ten, row, column) = (k / 10, k % 10 / 5, k % 5);
        let at = match count {
            1 => [0.0; 3],
            _ => [2.2 * (column as f64 - 2.0), 2.2 * (0.5 - row as f64), -2.2 * ten as f64],
        };
        let row =
            |k: usize| std::array::from_fn(|j| if j == 3 { at[k] } else { f64::from(u8::from(j == k)) });
        let pose = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
        scene.add(Arc::clone(mesh), &pose, Material::default()).expect("an instance");
    }
    slots(&scene)
}

/// From `distance` away, turned by so many degrees about the middle.
fn view(distance: f64, degrees: f64) -> View {
    let turn = DAffine3::from_rotation_y(degrees.to_radians());
    let pose = turn * DAffine3::from_translation(DVec3::Z * distance);
    let (x, t) = (pose.matrix3, pose.translation);
    let row = |k: usize| [x.x_axis[k], x.y_axis[k], x.z_axis[k], t[k]];
    let rows = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
    forms::view(&CAMERA, &rows, PICTURE, TAU).expect("a view")
}

fn sorted(found: &Found) -> Vec<VisibleCluster> {
    let mut list = found.visible.clone();
    list.sort_unstable_by_key(|v| (v.instance, v.cluster));
    list
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Frames of all forms in turn; and of the product with its occlusion culling, ms of the same steps in both passes and
/// clusters drawn.
struct Measured {
    of_form: [Vec<Found>; 3],
    product: Vec<(f64, u64)>,
}

fn measure(forms: &mut Forms, renderer: &mut DeviceRenderer, distance: f64) -> Measured {
    let mut out = Measured { of_form: Default::default(), product: Vec::new() };
    let mut words = vec![0; (PICTURE.0 * PICTURE.1) as usize];
    for frame in 0..WARM_UP + FRAMES {
        let view = view(distance, frame as f64);
        // Who comes first changes.
        let mut found: [Found; 3] = Default::default();
        for k in 0..FORMS.len() {
            let k = (k + frame) % FORMS.len();
            found[k] = forms.run(FORMS[k], &view).expect("a traversal");
        }
        let [levels, queue, flat] = &found;
        assert!(queue.bits == levels.bits && queue.visible == levels.visible, "the queue finds others");
        assert!(sorted(flat) == sorted(levels), "parts find others");
        let mut draw = |occlusion| {
            let ways = Ways {
                int64_atomics: true,
                occlusion,
                raster: Raster::Compute,
                shading: Shading::default(),
                until: None,
                waits: false,
            };
            let drawn = renderer
                .draw(&mut [ViewRequest::new(view, &mut words)], ways, &Resident::default())
                .expect("a frame");
            drawn.into_iter().next().expect("a picture")
        };
        if frame == 0 {
            assert!(draw(false).visible == levels.visible, "the product finds others");
        }
        let drawn = draw(true);
        let steps = [Stage::NodeCull, Stage::ClusterCull];
        let culling = drawn.times.iter().filter(|(stage, ..)| steps.contains(stage));
        if frame >= WARM_UP {
            out.product.push((culling.map(|(.., ms)| ms).sum(), drawn.visible.len() as u64));
            found.into_iter().zip(&mut out.of_form).for_each(|(found, list)| list.push(found));
        }
    }
    out
}

/// Four digits at most, or a few and a unit.
fn thousands(n: f64) -> String {
    match n {
        n if n >= 1e9 => format!("{:.1} G", n / 1e9),
        n if n >= 1e6 => format!("{:.1} M", n / 1e6),
        n if n >= 1e4 => format!("{:.1} k", n / 1e3),
        n => format!("{n:.0}"),
    }
}

fn mebibytes(bytes: f64) -> String {
    format!("{:.2}", bytes / f64::from(1 << 20))
}

fn print(triangles: usize, count: usize, camera: &str, measured: &Measured) {
    for (form, frames) in FORMS.iter().zip(&measured.of_form) {
        let of = |of: &dyn Fn(&Found) -> f64| median(frames.iter().map(of));
        let step = |step: IndirectEntry| {
            INDIRECT_ENTRIES.iter().position(|s| *s == step).map_or(f64::NAN, |k| of(&|f| f.ms[k]))
        };
        let (nodes, groups) = (of(&|f| f.nodes as f64), of(&|f| f.groups as f64));
        println!(
            "| {} | {camera} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.1} | {} | {} | {} | {} | {} | {} | {} |",
            thousands((triangles * count) as f64),
            form.name(),
            step(IndirectEntry::Walk),
            step(IndirectEntry::List),
            step(IndirectEntry::Clusters),
            of(&|f| f.ms[1..].iter().sum()),
            of(&|f| f.wall),
            thousands(nodes),
            if *form == Form::Parts { "–".to_owned() } else { thousands(groups) },
            thousands(of(&|f| f.candidates as f64)),
            thousands(of(&|f| f.clusters as f64)),
            thousands(of(&|f| f.visible.len() as f64)),
            mebibytes(of(&|f| f.read as f64)),
            mebibytes(of(&|f| f.memory as f64)),
        );
    }
    let product = |of: fn(&(f64, u64)) -> f64| median(measured.product.iter().map(of));
    println!(
        "| {} | {camera} | product, two passes |  |  |  | {:.2} |  |  |  |  |  | {} |  |  |",
        thousands((triangles * count) as f64),
        product(|p| p.0),
        thousands(product(|p| p.1 as f64)),
    );
}

fn main() {
    let context = match Context::shared() {
        Ok(context) => context,
        Err(error) => return println!("skipped: {error}"),
    };
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let number = |word: &String| word.parse::<usize>().ok();
    let size = words.iter().find_map(number).unwrap_or(SIZE);
    let (positions, faces) = shapes::bumpy_sphere(size);
    let options = BuildOptions { error: ErrorMeasure::Quadric, ..BuildOptions::default() };
    let mesh = build(&SourceMesh::new(Positions::F32(&positions), &faces), &options, &Silent);
    let mesh = Arc::new(mesh.expect("a sphere builds"));
    println!("{}; {}×{}, τ = {TAU}, medians of {FRAMES} frames", context.name(), PICTURE.0, PICTURE.1);
    println!(
        "A mesh of {} triangles and {} levels of detail: {} clusters, {} groups, {} nodes in {} levels, {} parts",
        faces.len(),
        mesh.nodes[0].level + 1,
        mesh.cluster_count(),
        mesh.groups.len(),
        mesh.nodes.len(),
        depth(&context, &mesh),
        parts::parts(&mesh).len()
    );
    println!(
        "\n| triangles | camera | form | walk ms | list ms | clusters ms | sum ms | wall ms | nodes, or parts | groups | candidates | clusters | visible | MiB read | MiB kept |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for count in CROWDS {
        let slots = crowd(&mesh, count);
        let mut forms = Forms::new(&slots, RING).expect("a scene");
        let mut renderer = DeviceRenderer::new().expect("a device");
        for (slot, instance) in (0..).zip(&slots) {
            let material = InstanceMaterial { first_material: u32::MAX, ..InstanceMaterial::zeroed() };
            let shown = instance.as_ref().map(|(instance_transform, mesh)| SceneInstance {
                transform: *instance_transform,
                material,
                mesh,
                materials: None,
            });
            renderer.set(slot, shown);
        }
        for (camera, distance) in DISTANCES {
            print(faces.len(), count, camera, &measure(&mut forms, &mut renderer, distance));
        }
    }
    workers(&mesh);
}

/// Levels of the hierarchy, and so dispatches of the product's walk.
fn depth(context: &Context, mesh: &Arc<Dag>) -> u32 {
    let mut meshes = Meshes::default();
    meshes.upload(context, std::iter::once(mesh), &Resident::default()).expect("room for a mesh");
    meshes.placement(mesh).map_or(0, |place| place.depth)
}

/// The queue by the number of workgroups that stay and by slots, beside the levels, on the scene with most to do.
fn workers(mesh: &Arc<Dag>) {
    println!(
        "\n| form | workers | slots | walk ms | nodes walked alone | idle claims |\n|---|---|---|---|---|---|"
    );
    let slots = crowd(mesh, CROWDS[2]);
    let rings = [(2, 1 << 16), (8, 1 << 16), (64, 1 << 16), (512, 1 << 16), (64, 1 << 8)];
    let of_ring = |(workers, slots)| (Form::Queue, Ring { workers, slots, ..RING });
    let forms: Vec<_> = [(Form::Levels, RING)].into_iter().chain(rings.map(of_ring)).collect();
    let scene = |ring: &Ring| Forms::new(&slots, *ring).expect("a scene");
    let mut scenes: Vec<Forms> = forms.iter().map(|(_, ring)| scene(ring)).collect();
    let mut found = vec![Vec::new(); forms.len()];
    for frame in 0..WARM_UP + FRAMES {
        let view = view(DISTANCES[1].1, frame as f64);
        let mut runs = vec![Found::default(); forms.len()];
        for k in 0..forms.len() {
            let k = (k + frame) % forms.len();
            runs[k] = scenes[k].run(forms[k].0, &view).expect("a traversal");
        }
        assert!(runs.iter().all(|run| run.bits == runs[0].bits), "a queue finds others");
        if frame >= WARM_UP {
            runs.into_iter().zip(&mut found).for_each(|(run, found)| found.push(run));
        }
    }
    for ((form, ring), found) in forms.iter().zip(&found) {
        let of = |of: fn(&Found) -> f64| median(found.iter().map(of));
        let of_queue = |text: String| if *form == Form::Queue { text } else { String::new() };
        println!(
            "| {} | {} | {} | {:.2} | {} | {} |",
            form.name(),
            of_queue(ring.workers.to_string()),
            of_queue(ring.slots.to_string()),
            of(|f| f.ms[1]),
            of_queue(thousands(of(|f| f.walked as f64))),
            of_queue(thousands(of(|f| f.idle as f64))),
        );
    }
}
