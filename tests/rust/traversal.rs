//! The forms of traversal that `benchmarks/rust/traversal/` keeps: they find what the product finds.

use std::sync::Arc;

use naga::valid::{Capabilities, ValidationFlags, Validator};
use nanite_rs::cpu::project::Screen;
use nanite_rs::gpu::{Renderer, Ways};
use nanite_rs::gpu_types::{Placed, View};
use nanite_rs::model::Dag;
use nanite_rs::render::{placed, view_record};
use nanite_rs::scene::placement::Eye;
use nanite_rs::scene::{Camera, Scene};

use crate::gpu_parity::device;
use crate::render_frames::{AnyView, CAMERA, Pose, any_views, at, city, crowd, dag, turned};
use crate::shapes::{bumpy_sphere, torus};

#[path = "../../benchmarks/rust/traversal/forms.rs"]
#[allow(dead_code)]
mod forms;
#[path = "../../benchmarks/rust/traversal/kernels.rs"]
#[allow(dead_code)]
mod kernels;
#[path = "../../benchmarks/rust/traversal/parts.rs"]
mod parts;

use forms::{FORMS, Forms, Found};
use kernels::{OWN, RING, Ring, Sizes};
use parts::{PART, parts};

type Slots = Vec<Option<(Placed, Arc<Dag>)>>;

fn slots(scene: &Scene) -> Slots {
    let all = scene.instances();
    let of = |slot| all.at(slot).map(|instance| (placed(instance), Arc::clone(&instance.mesh)));
    (0..all.capacity()).map(of).collect()
}

fn view(camera: &Camera, pose: &Pose, size: (u32, u32), tau: f32) -> View {
    let view = camera.view(pose, size.0, size.1).unwrap();
    view_record(&Screen::new(&view), &Eye::new(&view), tau)
}

/// Clusters of a list, without regard to their order.
fn set(found: &Found) -> Vec<(u32, u32, u32)> {
    let mut set: Vec<_> = found.visible.iter().map(|v| (v.instance, v.cluster, v.large)).collect();
    set.sort_unstable();
    set
}

/// What the forms find in a view; the same, and what the product draws.
fn agree(forms: &mut Forms, renderer: &mut Renderer, view: &View) -> [Found; 3] {
    let found = FORMS.map(|form| forms.run(form, view).unwrap());
    let [levels, queue, flat] = &found;
    assert!(queue.bits == levels.bits, "other groups");
    assert!(queue.visible == levels.visible, "another list");
    assert_eq!((queue.nodes, queue.groups), (levels.nodes, levels.groups));
    assert!(set(flat) == set(levels), "other clusters");
    let ways = Ways { wide_atomics: true, occlusion: false };
    let mut words = vec![0; (view.width * view.height) as usize];
    assert!(renderer.draw(view, ways, &mut words).unwrap().visible == levels.visible, "not the product's");
    found
}

fn both(scene: &Scene, ring: Ring) -> (Forms, Renderer) {
    let slots = slots(scene);
    let mut renderer = Renderer::new().unwrap();
    for (slot, instance) in (0..).zip(&slots) {
        renderer.set(slot, instance.as_ref().map(|(placed, mesh)| (*placed, mesh)));
    }
    (Forms::new(&slots, ring).unwrap(), renderer)
}

#[test]
fn own_kernels_are_valid() {
    let sizes = Sizes { instances: 1000, nodes: 300, depth: 5, parts: 2000 };
    for kernel in OWN {
        for array_bits in [None, Some(25)] {
            let source = sizes.source(kernel, RING, array_bits).unwrap();
            let module = naga::front::wgsl::parse_str(&source)
                .unwrap_or_else(|error| panic!("{kernel:?}: {}", error.emit_to_string(&source)));
            let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
            if let Err(error) = validator.validate(&module) {
                panic!("{kernel:?}: {}", error.emit_to_string(&source));
            }
        }
    }
    let listed = sizes.source(OWN[3], RING, None).unwrap();
    assert!(listed.contains(&format!("GROUPS_PER_WORKGROUP: u32 = {}u", 64 / PART)));
    let many = Sizes { instances: 1 << 20, nodes: 1 << 12, ..sizes };
    assert_eq!(many.source(OWN[0], RING, None), None);
}

#[test]
fn parts_hold_every_cluster_once_and_bound_it() {
    let mesh = dag(&torus(200, 80));
    let parts = parts(&mesh);
    let members = parts.iter().flat_map(|part| part.members());
    assert!(members.eq(mesh.pages.addresses()));
    for part in &parts {
        assert!(part.count as usize <= PART);
        for at in part.members() {
            let (record, group) = (mesh.record(at), mesh.group_of(at));
            assert!(part.lod_sphere.contains(&group.lod_sphere) && part.error >= group.error);
            for k in 0..3 {
                let [center, extent] = [record.center[k], record.extent[k]].map(f64::from);
                let [around, half] = [part.center[k], part.extent[k]].map(f64::from);
                assert!((center - around).abs() + extent <= half);
            }
        }
    }
}

#[test]
fn forms_find_the_same() {
    if device("forms_find_the_same").is_none() {
        return;
    }
    let (mut found, mut walked) = (0, 0);
    let scenes = [(crowd(), at(0.0, 0.0, 6.0)), (city(24), turned(at(34.5, 1.7, -34.5), 0.9))];
    for (scene, pose) in &scenes {
        let (mut forms, mut renderer) = both(scene, RING);
        for tau in [0.0, 1.0, 4.0] {
            let [levels, queue, _] = agree(&mut forms, &mut renderer, &view(&CAMERA, pose, (639, 361), tau));
            found += levels.visible.len();
            walked += queue.walked;
        }
    }
    assert!(found > 5_000, "{found}");
    assert_eq!(walked, 0, "the ring is large enough for these");
}

#[test]
fn forms_find_the_same_in_any_view() {
    if device("forms_find_the_same_in_any_view").is_none() {
        return;
    }
    let mut found = 0;
    for AnyView { scene, camera, pose, picture, options } in any_views(12) {
        let (mut forms, mut renderer) = both(&scene, RING);
        let view = view(&camera, &pose, picture, options.pixel_error);
        found += agree(&mut forms, &mut renderer, &view)[0].visible.len();
    }
    assert!(found > 300, "{found}");
}

/// Whatever the ring and the workers: it ends, and finds the same. Lanes that find no room walk themselves.
#[test]
fn a_queue_of_any_size_ends() {
    if device("a_queue_of_any_size_ends").is_none() {
        return;
    }
    let mut scene = crowd();
    let ball = dag(&bumpy_sphere(120));
    scene.add(ball, &at(0.0, 0.0, 2.0), nanite_rs::scene::Material::default()).unwrap();
    let view = view(&CAMERA, &at(0.0, 0.0, 6.0), (639, 361), 0.5);
    let rings = [(1, 1, 0), (1, 40, 50), (2, 3, 1), (64, 40, 0), (64, 3, 50), (1 << 12, 40, 1)];
    for (slots, workers, patience) in rings {
        let (mut forms, mut renderer) = both(&scene, Ring { slots, workers, patience });
        let [_, queue, _] = agree(&mut forms, &mut renderer, &view);
        assert!(queue.nodes > 500, "{}", queue.nodes);
        assert!(slots > 2 || queue.walked > 100, "{}", queue.walked);
    }
}
