//! The pipeline of "GPU-Driven Rendering Pipelines" (Haar and Aaltonen, SIGGRAPH 2015) beside the product's, on the CPU's
//! stages: `cargo bench --bench gpu_driven [-- detail folder]`. Meshes have 8 to 12 · detail² triangles; the worst frame of
//! each form and motion goes into the folder, wrong pixels red.
//!
//! Occlusion culling in one pass, against the depth of the last frame, beside the two passes: every picture is compared with
//! that of a frame without occlusion culling, which the two passes must equal. Then a compacted index buffer with one draw
//! beside the visible cluster list, whose pictures must be equal. Contestants take turns, another one first in every frame.
//! `docs/occlusion.md` says what follows.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use nanite_rs::config::{Outputs, RenderOptions};
use nanite_rs::cpu::visibility::{Nearest, Pixel};
use nanite_rs::cpu::{cluster_cull, hzb::Hzb, instance_cull, node_cull, raster_small};
use nanite_rs::model::ClusterAddress;
use nanite_rs::render::{Frame, Renderer};
use nanite_rs::scene::placement::Eye;
use nanite_rs::scene::{Instance, View};
use nanite_rs::stages::Stage;
use nanite_rs::stream::Resident;
use nanite_rs::views::{InstanceView, Screen, Visible, decode};

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

#[path = "gpu_driven/city.rs"]
mod city;
#[path = "gpu_driven/index_buffer.rs"]
mod index_buffer;
#[path = "gpu_driven/one_pass.rs"]
mod one_pass;

use city::{CAMERA, City, MOTIONS, Motion};
use index_buffer::Seen;
use one_pass::{Care, Drawn, Form, OnePass};

const DETAIL: usize = 48;
const PICTURE: (u32, u32) = (1280, 720);
const TAU: f32 = 1.0;
/// Frames that count, after those that do not.
const FRAMES: usize = 12;
const WARM_UP: usize = 2;
/// How often each motion is run through.
const REPEATS: usize = 2;
const FORMS: [(&str, Form); 5] = [
    ("last depth", Form { care: Care::Least, occluders: 0 }),
    ("last depth + 16", Form { care: Care::Least, occluders: 16 }),
    ("last depth + 300", Form { care: Care::Least, occluders: 300 }),
    ("careful", Form { care: Care::Most, occluders: 0 }),
    ("careful + 16", Form { care: Care::Most, occluders: 16 }),
];

/// What a pixel shows, whatever lists it is numbered by: key, slot of the instance, cluster, triangle.
type Shown = (u32, u32, ClusterAddress, u32);

fn shown(word: u64, list: &[(u32, ClusterAddress)]) -> Option<Shown> {
    let hit = decode(word)?;
    let (slot, cluster) = list[hit.visible as usize];
    Some((hit.key, slot, cluster, hit.triangle))
}

/// One frame of one contestant.
#[derive(Clone, Copy, Default)]
struct Row {
    /// Depth, culling, rasterizers, everything.
    ms: [f64; 4],
    /// Clusters drawn; of them without a pixel; clusters with pixels that were not drawn.
    clusters: [f64; 3],
    triangles: f64,
    /// Of those of clusters without a pixel.
    needless: f64,
    wrong: f64,
}

/// The frame that others are compared with: everything is drawn.
struct Truth {
    words: Vec<u64>,
    list: Vec<(u32, ClusterAddress)>,
    /// Which of the list have pixels, in ascending order.
    seen: Vec<(u32, ClusterAddress)>,
}

impl Truth {
    fn new(frame: &Frame) -> Self {
        let (words, list) = (frame.words().expect("words").to_vec(), frame.visible());
        let mut marks = vec![false; list.len()];
        words.iter().filter_map(|word| word.visible()).for_each(|number| marks[number as usize] = true);
        let seen = list.iter().zip(marks).filter(|(_, seen)| *seen).map(|(at, _)| *at);
        let mut seen: Vec<_> = seen.collect();
        seen.sort_unstable();
        Self { words, list, seen }
    }

    /// Which pixels are wrong.
    fn wrong(&self, words: &[u64], list: &[(u32, ClusterAddress)]) -> Vec<bool> {
        assert!(words.len() == self.words.len());
        let pairs = words.iter().zip(&self.words);
        pairs.map(|(own, truth)| shown(*own, list) != shown(*truth, &self.list)).collect()
    }

    fn row(&self, city: &City, list: &[(u32, ClusterAddress)], triangles: u64, wrong: usize) -> Row {
        let mut own = list.to_vec();
        own.sort_unstable();
        // No slot is empty.
        let meshes: Vec<_> = city.scene.instances().iter().map(|(_, instance)| &instance.mesh).collect();
        let of = |(slot, cluster): (u32, ClusterAddress)| {
            f64::from(meshes[slot as usize].record(cluster).triangle_count)
        };
        let needless = own.iter().filter(|at| self.seen.binary_search(at).is_err());
        let missing = self.seen.iter().filter(|at| own.binary_search(at).is_err()).count();
        Row {
            clusters: [list.len() as f64, needless.clone().count() as f64, missing as f64],
            triangles: triangles as f64,
            needless: needless.map(|at| of(*at)).sum(),
            wrong: wrong as f64,
            ..Row::default()
        }
    }
}

/// A frame of the product.
fn product_row(city: &City, truth: &Truth, frame: &Frame) -> Row {
    let stats = &frame.stats;
    let of = |stages: &[Stage]| {
        stats.stages.iter().filter(|s| stages.contains(&s.stage)).fold(0.0, |sum, s| sum + s.ms)
    };
    let list = frame.visible();
    let wrong = truth.wrong(frame.words().expect("words"), &list).iter().filter(|wrong| **wrong).count();
    assert!(wrong == 0, "{wrong} pixels of two passes are not those of one without occlusion culling");
    let ms = [
        of(&[Stage::Hzb]),
        of(&[Stage::InstanceCull, Stage::NodeCull, Stage::ClusterCull]),
        of(&[Stage::RasterSmall, Stage::RasterLarge]),
        stats.total_ms,
    ];
    Row { ms, ..truth.row(city, &list, stats.triangles, wrong) }
}

/// The picture of depth, with wrong pixels in red, as a portable pixmap.
fn write(path: &Path, words: &[u64], wrong: &[bool]) {
    let mut bytes = format!("P6 {} {} 255\n", PICTURE.0, PICTURE.1).into_bytes();
    for (word, wrong) in words.iter().zip(wrong) {
        // A unit away is white, thirty are black.
        let distance = CAMERA.znear as f32 / f32::from_bits(word.key());
        let gray = (255.0 * (1.0 - distance.max(1.0).ln() / 30f32.ln()).max(0.0)) as u8;
        bytes.extend(if *wrong { [255, 0, 0] } else { [gray; 3] });
    }
    std::fs::File::create(path).and_then(|mut file| file.write_all(&bytes)).expect("a file");
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

fn options(occlusion: bool) -> RenderOptions {
    RenderOptions { pixel_error: TAU, occlusion, outputs: Outputs::default(), ..RenderOptions::default() }
}

/// Frames of the product with and without occlusion culling, and of every form.
fn occlusion(city: &mut City, motion: Motion, folder: Option<&Path>) {
    let (width, height) = PICTURE;
    let renderer = || Renderer::new(width, height, "cpu").expect("a renderer");
    let mut renderers = [renderer(), renderer()];
    let mut forms = FORMS.map(|(_, form)| (OnePass::new(form), Vec::new()));
    let mut rows: Vec<Vec<Row>> = vec![Vec::new(); 2 + FORMS.len()];
    let mut worst = [0; FORMS.len()];
    for frame in (0..REPEATS).flat_map(|_| 0..WARM_UP + FRAMES) {
        city.set(motion, frame);
        let pose = motion.camera(frame);
        let view = CAMERA.view(&pose, width, height).expect("a view");
        let draw = |renderer: &mut Renderer, occlusion| {
            renderer.render(&city.scene, &CAMERA, &pose, &options(occlusion)).expect("a frame")
        };
        // Who comes first changes.
        let (mut frames, mut drawn): ([Option<Frame>; 2], [Option<Drawn>; FORMS.len()]) = Default::default();
        for k in 0..2 + FORMS.len() {
            match (k + frame) % (2 + FORMS.len()) {
                k @ 0..2 => frames[k] = Some(draw(&mut renderers[k], k == 1)),
                k => {
                    let (form, memory) = &mut forms[k - 2];
                    drawn[k - 2] = Some(form.draw(&city.scene, &view, TAU, std::mem::take(memory)));
                }
            }
        }
        let frames = frames.map(|frame| frame.expect("it was drawn"));
        let truth = Truth::new(&frames[0]);
        let counts = frame >= WARM_UP;
        for (k, frame) in frames.iter().enumerate().filter(|_| counts) {
            rows[k].push(product_row(city, &truth, frame));
        }
        for (k, drawn) in drawn.into_iter().enumerate() {
            let drawn = drawn.expect("it was drawn");
            let wrong = truth.wrong(&drawn.words, &drawn.list);
            let count = wrong.iter().filter(|wrong| **wrong).count();
            let times = drawn.times;
            let ms = [times.depth, times.cull, times.raster, times.wall];
            if counts {
                rows[k + 2].push(Row { ms, ..truth.row(city, &drawn.list, drawn.triangles, count) });
            }
            if counts && count > worst[k] {
                worst[k] = count;
                if let Some(folder) = folder {
                    let name = format!("{}-{}.ppm", motion.name(), FORMS[k].0.replace(' ', ""));
                    write(&folder.join(name), &drawn.words, &wrong);
                }
            }
            forms[k].1 = forms[k].0.keep(&city.scene, &view, drawn);
        }
    }
    let names = ["all drawn", "two passes"].into_iter().chain(FORMS.map(|(name, _)| name));
    for (name, rows) in names.zip(&rows) {
        print_row(motion, name, rows);
    }
}

fn print_row(motion: Motion, name: &str, rows: &[Row]) {
    let ms = |k: usize| median(rows.iter().map(|row| row.ms[k]));
    let mean = |of: &dyn Fn(&Row) -> f64| rows.iter().map(of).sum::<f64>() / rows.len() as f64;
    let share = 100.0 * rows.iter().filter(|row| row.wrong > 0.0).count() as f64 / rows.len() as f64;
    let most = rows.iter().map(|row| row.wrong).fold(0.0, f64::max);
    println!(
        "| {} | {name} | {:.1} | {:.1} | {:.1} | {:.1} | {:.0} | {:.0} | {:.1} | {:.0} | {:.0} | {:.1} | {:.1} | {most:.0} | {share:.0} |",
        motion.name(),
        ms(0),
        ms(1),
        ms(2),
        ms(3),
        mean(&|row| row.clusters[0]),
        mean(&|row| row.clusters[1]),
        100.0 * mean(&|row| row.clusters[1]) / mean(&|row| row.clusters[0]),
        mean(&|row| row.triangles),
        mean(&|row| row.needless),
        mean(&|row| row.clusters[2]),
        mean(&|row| row.wrong),
    );
}

/// What the rasterizer of small triangles gets in a frame.
struct Small {
    views: Vec<InstanceView>,
    visible: Vec<Visible>,
    numbers: Vec<u32>,
    screen: Screen,
}

impl Small {
    /// Of the clusters that the product draws.
    fn new(city: &City, view: &View, frame: &Frame) -> Self {
        let (eye, screen) = (Eye::new(view), Screen::new(view));
        let instances: Vec<(u32, &Instance)> = city.scene.instances().iter().collect();
        let views = instance_cull::run(&instances, view, &eye, &screen, &Resident::default());
        let all: Vec<u32> = (0..views.len() as u32).collect();
        let walk = node_cull::run(&all, &views, &screen, TAU, None::<&Hzb>);
        let culled = cluster_cull::run(&walk.groups, &views, &screen, TAU, None::<&Hzb>);
        let mut list = culled.candidates;
        list.sort_unstable();
        let mut drawn = frame.visible();
        drawn.sort_unstable();
        list.retain(|c| {
            let at = (views[c.visible.instance as usize].slot, c.visible.cluster);
            drawn.binary_search(&at).is_ok()
        });
        assert!(list.len() == drawn.len());
        let numbers = (0..).zip(&list).filter(|(_, c)| !c.large).map(|(number, _)| number).collect();
        Self { views, visible: list.iter().map(|c| c.visible).collect(), numbers, screen }
    }

    /// Triangles, and bytes of the list, of positions and of triangles.
    fn sizes(&self) -> [usize; 4] {
        let mut out = [0, 8 * self.numbers.len(), 0, 0];
        for &number in &self.numbers {
            let Visible { instance, cluster } = self.visible[number as usize];
            let view = &self.views[instance as usize];
            let geometry = view.cluster(cluster);
            let (vertices, triangles) = (geometry.positions.len(), geometry.triangles.len());
            let streams = view.mesh.layout().streams(vertices, triangles, geometry.widths());
            out[0] += triangles;
            out[2] += 4 * streams.ids;
            out[3] += 4 * (streams.normals - streams.triangles);
        }
        out
    }
}

/// The visible list against the compacted index buffer.
fn index_buffer(city: &mut City, motion: Motion) {
    let (width, height) = PICTURE;
    let mut renderer = Renderer::new(width, height, "cpu").expect("a renderer");
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut pictures = [0, 1].map(|_| vec![0u64; width as usize * height as usize]);
    let mut buffer = Vec::new();
    let (mut times, mut counts) = (Vec::new(), Vec::new());
    for frame in 0..WARM_UP + FRAMES {
        city.set(motion, frame);
        let pose = motion.camera(frame);
        let view = CAMERA.view(&pose, width, height).expect("a view");
        let drawn = renderer.render(&city.scene, &CAMERA, &pose, &options(true)).expect("a frame");
        let small = Small::new(city, &view, &drawn);
        let Small { views, visible, numbers, screen } = &small;
        let seen = Seen { visible, views, screen };
        let mut best = [f64::INFINITY; 3];
        for repeat in 0..6 {
            let way = (repeat + frame) % 2;
            pictures[way].fill(0);
            let sink = Nearest(u64::cells(&mut pictures[way]));
            let start = Instant::now();
            let ms = |start: Instant| start.elapsed().as_secs_f64() * 1e3;
            if way == 0 {
                raster_small::run(numbers, visible, views, screen, &sink);
                best[0] = best[0].min(ms(start));
            } else {
                index_buffer::compact(numbers, seen, &mut buffer);
                let compacted = ms(start);
                index_buffer::draw(&buffer, seen, &sink);
                (best[1], best[2]) = (best[1].min(compacted), best[2].min(ms(start) - compacted));
            }
        }
        assert!(pictures[0] == pictures[1], "the index buffer draws another picture");
        let mut again = Vec::new();
        one_thread.install(|| index_buffer::compact(numbers, seen, &mut again));
        assert!(again == buffer, "the index buffer depends on threads");
        if frame >= WARM_UP {
            let [triangles, list, positions, corners] = small.sizes();
            times.push(best);
            counts.push([numbers.len(), triangles, buffer.len(), list, positions, corners].map(|n| n as f64));
        }
    }
    let mean = |k: usize| counts.iter().map(|c| c[k]).sum::<f64>() / counts.len() as f64;
    let ms = |k: usize| median(times.iter().map(|t| t[k]));
    let entries = mean(2) * size_of::<index_buffer::Entry>() as f64;
    // Corners are read by both; positions once by the list, twice by the other; bits of what stays are written and read.
    let (list, positions, corners, bits) = (mean(3), mean(4), mean(5), 16.0 * mean(0));
    let mebibytes = |bytes: f64| bytes / f64::from(1 << 20);
    println!(
        "| {} | {:.0} | {:.0} | {:.0} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
        motion.name(),
        mean(0),
        mean(1),
        mean(2),
        ms(0),
        ms(1),
        ms(2),
        (ms(1) + ms(2)) / ms(0),
        mebibytes(list + positions + corners),
        mebibytes(list),
        mebibytes(list + 2.0 * positions + 2.0 * corners + bits + entries),
        mebibytes(list + bits + entries),
    );
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let detail = words.iter().find_map(|word| word.parse().ok()).unwrap_or(DETAIL);
    let folder = words.iter().find(|word| word.parse::<usize>().is_err()).map(Path::new);
    let mut city = City::new(detail);
    println!(
        "{} instances, {}×{}, τ = {TAU}, {REPEATS} × {FRAMES} frames, {} threads",
        city.scene.instances().len(),
        PICTURE.0,
        PICTURE.1,
        rayon::current_num_threads()
    );
    println!(
        "\n| motion | form | depth ms | cull ms | raster ms | frame ms | clusters | needless | % | triangles | needless | missing | wrong pixels | most | % of frames |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for motion in MOTIONS {
        occlusion(&mut city, motion, folder);
    }
    println!(
        "\n| motion | clusters | triangles | in the buffer | list ms | compact ms | draw ms | ratio | list: MiB read | written | buffer: MiB read | written |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for motion in MOTIONS {
        index_buffer(&mut city, motion);
    }
}
