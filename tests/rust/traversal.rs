//! The forms of traversal that `benchmarks/rust/traversal/` keeps: they find what the product finds.

use bytemuck::Zeroable;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use nanite_rs::config::{Raster, Shading};
use nanite_rs::gpu::{DeviceRenderer, SceneInstance, ViewRequest, Ways};
use nanite_rs::gpu_types::{Group, InstanceMaterial, View};
use nanite_rs::model::ClusterAddress;
use nanite_rs::scene::{Material, Scene};
use nanite_rs::stream::Resident;

use crate::gpu_parity::device;
use crate::render_frames::{AnyView, CAMERA, any_views, at, city, crowd, dag, turned};
use crate::shapes::{bumpy_sphere, torus};

#[path = "../../benchmarks/rust/traversal/forms.rs"]
#[allow(dead_code)]
mod forms;
#[path = "../../benchmarks/rust/traversal/kernels.rs"]
#[allow(dead_code)]
mod kernels;
#[path = "../../benchmarks/rust/traversal/parts.rs"]
mod parts;

use forms::{FORMS, Forms, Found, slots, view};
use kernels::{OWN, RING, Ring, Sizes};
use parts::{PART, parts};

/// Clusters of a list, without regard to their order.
fn set(found: &Found) -> Vec<(u32, u32, u32)> {
    let mut set: Vec<_> = found.visible.iter().map(|v| (v.instance, v.cluster, v.large)).collect();
    set.sort_unstable();
    set
}

/// What the forms find in a view; the same, and what the product draws.
fn agree(forms: &mut Forms, renderer: &mut DeviceRenderer, view: &View) -> [Found; 3] {
    let found = FORMS.map(|form| forms.run(form, view).unwrap());
    let [levels, queue, flat] = &found;
    assert!(queue.bits == levels.bits, "other groups");
    assert!(queue.visible == levels.visible, "another list");
    assert_eq!((queue.nodes, queue.groups), (levels.nodes, levels.groups));
    assert!(set(flat) == set(levels), "other clusters");
    let ways = Ways {
        int64_atomics: true,
        occlusion: false,
        raster: Raster::Compute,
        shading: Shading::default(),
        until: None,
        waits: false,
    };
    let mut words = vec![0; (view.width * view.height) as usize];
    assert!(
        renderer.draw(&mut [ViewRequest::new(*view, &mut words)], ways, &Resident::default()).unwrap()[0]
            .visible
            == levels.visible,
        "not the product's"
    );
    found
}

fn both(scene: &Scene, ring: Ring) -> (Forms, DeviceRenderer) {
    let slots = slots(scene);
    let mut renderer = DeviceRenderer::new().unwrap();
    for (slot, instance) in (0..).zip(&slots) {
        renderer.set(
            slot,
            instance.as_ref().map(|(instance_transform, mesh)| {
                let material = InstanceMaterial { first_material: u32::MAX, ..InstanceMaterial::zeroed() };
                SceneInstance { transform: *instance_transform, material, mesh, materials: None }
            }),
        );
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
    let members = |part: &Group| (part.first..part.first + part.count).map(ClusterAddress);
    assert!(parts.iter().flat_map(members).eq(mesh.pages.addresses()));
    for part in &parts {
        assert!(part.count as usize <= PART);
        for at in members(part) {
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
    let Some(context) = device("forms_find_the_same") else { return };
    let (mut found, mut walked) = (0, 0);
    let scenes = [(crowd(), at(0.0, 0.0, 6.0)), (city(24), turned(at(34.5, 1.7, -34.5), 0.9))];
    for (scene, pose) in &scenes {
        let (mut forms, mut renderer) = both(scene, RING);
        for tau in [0.0, 1.0, 4.0] {
            let [levels, queue, _] =
                agree(&mut forms, &mut renderer, &view(&CAMERA, pose, (639, 361), tau).unwrap());
            found += levels.visible.len();
            walked += queue.walked;
        }
    }
    assert!(found > 5_000, "{found}");
    // The ring is large enough for these. Where workgroups run at once some find it empty and give up waiting: on an
    // H100 some 6,000 nodes are walked by others.
    if context.software() {
        assert_eq!(walked, 0);
    }
}

#[test]
fn forms_find_the_same_in_any_view() {
    if device("forms_find_the_same_in_any_view").is_none() {
        return;
    }
    let mut found = 0;
    for AnyView { scene, camera, pose, picture, options } in any_views(12) {
        let (mut forms, mut renderer) = both(&scene, RING);
        let view = view(&camera, &pose, picture, options.pixel_error).unwrap();
        found += agree(&mut forms, &mut renderer, &view)[0].visible.len();
    }
    assert!(found > 100, "{found}");
}

/// Whatever the ring and the workers: it ends, and finds the same. Lanes that find no room walk themselves.
#[test]
fn a_queue_of_any_size_ends() {
    if device("a_queue_of_any_size_ends").is_none() {
        return;
    }
    let mut scene = crowd();
    let ball = dag(&bumpy_sphere(120));
    scene.add(ball, &at(0.0, 0.0, 2.0), Material::default()).unwrap();
    let view = view(&CAMERA, &at(0.0, 0.0, 6.0), (639, 361), 0.5).unwrap();
    let rings = [(1, 1, 0), (1, 40, 50), (2, 3, 1), (64, 40, 0), (64, 3, 50), (1 << 12, 40, 1)];
    for (slots, workers, patience) in rings {
        let (mut forms, mut renderer) = both(&scene, Ring { slots, workers, patience });
        let [_, queue, _] = agree(&mut forms, &mut renderer, &view);
        assert!(queue.nodes > 500, "{}", queue.nodes);
        assert!(slots > 2 || queue.walked > 100, "{}", queue.walked);
    }
}

/// The queue of `work_queue.wgsl`, an atomic operation at a time, so that any of them may be the next.
mod model {
    /// Bits of an item; words of few bits more, so that laps run out.
    const PAYLOAD_BITS: u32 = 8;
    const LAPS: u32 = 5;
    /// Item i has the children 3i + 1 to 3i + 3.
    pub const ITEMS: u32 = 200;
    const PATIENCE: u32 = 4;

    #[derive(Clone, Copy, PartialEq, Eq)]
    enum Next {
        Tail,
        Head,
        Compare,
        Add,
        Root,
        Take(u32),
        InstanceMaterial(u32),
        Put { first: u32, ticket: u32, more: u32 },
        Left,
    }

    struct Worker {
        next: Next,
        tries: u32,
        tail: u32,
        head: u32,
        /// Operations since the last claim that gave something.
        alone: u32,
    }

    /// What happened besides.
    #[derive(Default)]
    pub struct Events {
        /// A put came after its pop.
        pub late: u32,
        /// A put found an item of an earlier lap.
        pub displaced: u32,
        /// Tickets ran out.
        pub spent: u32,
        /// A pop by force.
        pub forced: u32,
    }

    pub struct Queue {
        ring: Vec<u32>,
        tail: u32,
        head: u32,
        root: bool,
        outstanding: u32,
        pub done: Vec<u32>,
        workers: Vec<Worker>,
        pub events: Events,
    }

    fn replaced(old: u32, word: u32) -> Option<u32> {
        let payload = old & ((1 << PAYLOAD_BITS) - 1);
        (old <= word && payload != 0).then(|| payload - 1)
    }

    impl Queue {
        pub fn new(slots: usize, workers: usize) -> Self {
            let worker = |_| Worker { next: Next::Tail, tries: 0, tail: 0, head: 0, alone: 0 };
            Self {
                ring: vec![0; slots],
                tail: 0,
                head: 0,
                root: true,
                outstanding: 0,
                done: vec![0; ITEMS as usize],
                workers: (0..workers).map(worker).collect(),
                events: Events::default(),
            }
        }

        pub fn at_work(&self, worker: usize) -> bool {
            self.workers[worker].next != Next::Left
        }

        fn tickets(&self) -> u32 {
            self.ring.len() as u32 * LAPS
        }

        fn maximum(&mut self, ticket: u32, lap: u32, payload: u32) -> (u32, u32) {
            let slots = self.ring.len() as u32;
            let word = (ticket / slots + lap) << PAYLOAD_BITS | payload;
            let slot = &mut self.ring[(ticket % slots) as usize];
            let old = *slot;
            *slot = old.max(word);
            (old, word)
        }

        fn take(&mut self, ticket: u32) -> Option<u32> {
            if ticket >= self.tickets() {
                return None;
            }
            let (old, word) = self.maximum(ticket, 1, 0);
            replaced(old, word)
        }

        fn put(&mut self, ticket: u32, item: u32) -> Option<u32> {
            if ticket >= self.tickets() {
                self.events.spent += 1;
                return Some(item);
            }
            let (old, word) = self.maximum(ticket, 0, item + 1);
            if old > word {
                self.events.late += 1;
                return Some(item);
            }
            let older = replaced(old, word);
            self.events.displaced += u32::from(older.is_some());
            older
        }

        fn walk(&mut self, item: u32) {
            if item < ITEMS {
                self.done[item as usize] += 1;
                (1..=3).for_each(|k| self.walk(3 * item + k));
            }
        }

        /// One operation of a worker.
        pub fn step(&mut self, worker: usize) {
            let Worker { next, tries, tail, head, alone } = self.workers[worker];
            let forced = tries >= PATIENCE;
            let mut now = Worker { next, tries, tail, head, alone: alone + 1 };
            now.next = match next {
                Next::Tail => {
                    now.tail = self.tail.min(self.tickets());
                    Next::Head
                }
                Next::Head => {
                    now.head = self.head;
                    match now.head < tail {
                        true if forced => Next::Add,
                        true => Next::Compare,
                        false => Next::Root,
                    }
                }
                Next::Compare if self.head == head => {
                    self.head += 1;
                    Next::Take(head)
                }
                Next::Compare => {
                    now.tries += 1;
                    Next::Tail
                }
                Next::Add => {
                    self.events.forced += 1;
                    self.head += 1;
                    Next::Take(self.head - 1)
                }
                Next::Root if self.root => {
                    (self.root, self.outstanding) = (false, self.outstanding + 1);
                    Next::InstanceMaterial(0)
                }
                Next::Root if self.outstanding == 0 || forced => Next::Left,
                Next::Root => {
                    now.tries += 1;
                    Next::Tail
                }
                Next::Take(ticket) => self.take(ticket).map_or(Next::Tail, Next::InstanceMaterial),
                Next::InstanceMaterial(item) => {
                    self.done[item as usize] += 1;
                    let children = (3 * item + 1..3 * item + 4).filter(|child| *child < ITEMS).count();
                    self.tail += children as u32;
                    Next::Put { first: 3 * item + 1, ticket: self.tail - children as u32, more: 0 }
                }
                Next::Put { first, ticket, more } => {
                    // Its tickets are those up to the next multiple of three; the last of all has fewer.
                    let kept = match first < ITEMS {
                        true => {
                            let left = self.put(ticket, first);
                            left.inspect(|item| self.walk(*item)).is_none()
                        }
                        false => false,
                    };
                    let more = more + u32::from(kept);
                    match first % 3 == 0 || first + 1 >= ITEMS {
                        true => {
                            self.outstanding = self.outstanding.wrapping_add(more).wrapping_sub(1);
                            Next::Tail
                        }
                        false => Next::Put { first: first + 1, ticket: ticket + 1, more },
                    }
                }
                Next::Left => Next::Left,
            };
            if matches!(next, Next::Take(_) | Next::InstanceMaterial(_)) {
                (now.tries, now.alone) = (0, 0);
            }
            // Nobody waits: a claim is a bounded number of operations.
            assert!(now.alone <= 5 * (PATIENCE + 2), "a worker waits");
            self.workers[worker] = now;
        }
    }
}

/// Whoever runs when, and however long others stand still: every item is done once, and all leave.
#[test]
fn any_order_of_workers_does_every_item_once() {
    let mut random = 1u32;
    let mut dice = move |sides: u32| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) % sides
    };
    let mut seen = [0; 4];
    for round in 0..4000 {
        let workers = 1 + dice(6) as usize;
        let mut queue = model::Queue::new(1 << dice(4), workers);
        // The slower ones move once in a while, or, in every seventh round, only when the others have left.
        let slow: Vec<u32> = (0..workers).map(|_| if dice(3) == 0 { 1 + dice(300) } else { 1 }).collect();
        while let Some(last) = (0..workers).find(|worker| queue.at_work(*worker)) {
            let worker = if round % 7 == 0 { last } else { dice(workers as u32) as usize };
            if queue.at_work(worker) && dice(slow[worker]) == 0 {
                queue.step(worker);
            }
        }
        assert!(queue.done.iter().all(|times| *times == 1), "{:?}", queue.done);
        let events = queue.events;
        let of_round = [events.late, events.displaced, events.spent, events.forced];
        seen.iter_mut().zip(of_round).for_each(|(seen, more)| *seen += more);
    }
    assert!(seen.iter().all(|times| *times > 100), "{seen:?}");
}
