//! Files with wrong contents and right checksums: damage that nobody can tell from what was meant. `fuzz/` has a part
//! in this.

use std::ops::Range;
use std::sync::Arc;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, RenderOptions};
use nanite_rs::finish::Finisher;
use nanite_rs::format::file::{ENTRY_BYTES, HEADER_BYTES, Kind, PageRow};
use nanite_rs::format::open_input;
use nanite_rs::lod::{channel_rows, cut_error, extract, select};
use nanite_rs::mesh::{Colors, Positions, SourceChannel, SourceMesh};
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{Blob, ChannelInfo, ChannelType, Dag, Materials};
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Camera, Material, Projection, Scene};

use crate::shapes;

/// A mesh of 8·n² triangles with some of everything that a file can hold.
pub fn rich_mesh(n: usize) -> Dag {
    let (positions, faces) = shapes::bumpy_sphere(n);
    let colors: Vec<[u8; 4]> = (0..positions.len()).map(|i| [i as u8, (i >> 8) as u8, 7, 255]).collect();
    let uvs: Vec<[f32; 2]> = positions.iter().map(|p| [p[0], p[1]]).collect();
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    source.colors = Some(Colors::U8(&colors));
    source.uvs = vec![&uvs, &uvs];
    let heat: Vec<u32> = positions.iter().flat_map(|p| [p[2].to_bits(), (1.0e20 * p[0]).to_bits()]).collect();
    let parts: Vec<u32> =
        positions.iter().map(|p| if p[2] > 0.0 { i32::MIN.cast_unsigned() } else { 7 }).collect();
    let info = |name: &str, dtype, columns| ChannelInfo { name: name.into(), dtype, columns };
    source.channels = vec![
        SourceChannel { info: info("heat", ChannelType::Float32, Some(2)), words: &heat },
        SourceChannel { info: info("part", ChannelType::Int32, None), words: &parts },
    ];
    let materials: Vec<i32> = (0..faces.len() as i32).map(|f| f % 64 / 32 - 1).collect();
    source.materials = Some(&materials);
    let dag = build(&source, &BuildOptions { face_ids: true, ..BuildOptions::default() }, &Silent).unwrap();
    let images = [0, 37, 64].map(|count| Blob::from((0..count).collect::<Vec<u8>>())).into();
    Dag { materials: Materials { table: r#"{"of": "whoever draws"}"#.into(), images }, ..dag }
}

/// A number in the bytes of a file, where the file is so long.
fn number(bytes: &[u8], at: usize, width: usize) -> Option<usize> {
    let bytes = bytes.get(at..at.checked_add(width)?)?;
    Some(bytes.iter().rev().fold(0, |value, byte| value << 8 | usize::from(*byte)))
}

/// Where the rows of the section table are.
pub fn entries(bytes: &[u8]) -> impl Iterator<Item = usize> + use<> {
    let room = bytes.len().saturating_sub(HEADER_BYTES) / ENTRY_BYTES;
    let count = number(bytes, 12, 4).unwrap_or(0).min(room);
    (0..count).map(|i| HEADER_BYTES + i * ENTRY_BYTES)
}

/// What a row of the section table refers to, inside the file or not.
fn place(bytes: &[u8], entry: usize) -> Option<Range<usize>> {
    let start = number(bytes, entry + 8, 8)?;
    Some(start..start.saturating_add(number(bytes, entry + 16, 8)?))
}

/// Where the sections of a kind lie.
pub fn sections(bytes: &[u8], kind: Kind) -> impl Iterator<Item = Range<usize>> {
    let entries = entries(bytes).filter(move |at| number(bytes, *at, 4) == Some(kind as usize));
    entries.filter_map(|entry| place(bytes, entry))
}

/// Where a section lies, or the first of its kind.
pub fn section(bytes: &[u8], kind: Kind) -> Option<Range<usize>> {
    sections(bytes, kind).next()
}

/// Makes all checksums right, as far as what they are of lies inside the file.
pub fn reseal(bytes: &mut [u8]) {
    let put = |bytes: &mut [u8], at: usize, of: Range<usize>| {
        let Some(crc) = bytes.get(of).map(crc32fast::hash) else { return };
        if let Some(field) = bytes.get_mut(at..at.saturating_add(4)) {
            field.copy_from_slice(&crc.to_le_bytes());
        }
    };
    if let (Some(rows), Some(pages)) = (section(bytes, Kind::PageTable), section(bytes, Kind::Pages)) {
        for row in (rows.start..rows.end.min(bytes.len())).step_by(size_of::<PageRow>()) {
            let (Some(start), Some(length)) = (number(bytes, row, 8), number(bytes, row + 8, 4)) else {
                break;
            };
            let start = pages.start.saturating_add(start);
            put(bytes, row + 12, start..start.saturating_add(length));
        }
    }
    for entry in entries(bytes) {
        if number(bytes, entry, 4) != Some(Kind::Pages as usize)
            && let Some(of) = place(bytes, entry)
        {
            put(bytes, entry + 4, of);
        }
    }
    let count = entries(bytes).count();
    put(bytes, 16, HEADER_BYTES..HEADER_BYTES + count * ENTRY_BYTES);
    put(bytes, 20, 0..20);
}

/// What an accepted file has to stand: what its user does next ends without a panic.
pub fn exercise(dag: &Dag) {
    let finisher = Finisher::new(dag);
    let by_size = finisher.budget.select(dag, dag.source_faces / 3);
    drop(finisher.exact(dag, dag.source_faces / 3).map(|cut| cut.extract(dag)));
    let by_error = [0.0, 0.01].map(|error| select(dag, &Threshold::Uniform(error)));
    for clusters in [by_size].iter().chain(&by_error) {
        let cut = extract(dag, clusters);
        let _ = cut_error(dag, clusters);
        dag.channels
            .iter()
            .for_each(|c| assert!(channel_rows(c, &cut.ids, &[]).unwrap().len() >= cut.ids.len()));
    }
}

/// The same of frames, drawn on the CPU from outside, at the surface and from within.
pub fn draw(dag: Dag) {
    render(dag, &mut Renderer::new(48, 32, "cpu").unwrap(), true);
}

/// The same of a file whose pages are read when frames need them, with room for half of them: what a whole reader refuses
/// for a page is drawn without it.
pub fn stream(bytes: Vec<u8>) {
    let Ok(dag) = open_input(Box::new(bytes), "streamed") else { return };
    dag.channels.iter().for_each(|channel| drop(channel.words.load()));
    let mut renderer = Renderer::new(48, 32, "cpu").unwrap();
    renderer.stream(Some(2 * dag.pages.word_count()));
    for wait in [false, true] {
        render(dag.clone(), &mut renderer, wait);
        let streamer = renderer.streamer().unwrap();
        streamer.pool().check().unwrap();
        streamer.read_errors();
    }
}

fn render(dag: Dag, renderer: &mut Renderer, wait: bool) {
    let mut scene = Scene::new();
    let mut pose = [[0.0; 4]; 4];
    (0..4).for_each(|k| pose[k][k] = 1.0);
    // A frame of the source may be too large or too small for a scene.
    if scene.add(Arc::new(dag), &pose, Material::default()).is_err() {
        return;
    }
    let camera =
        Camera { projection: Projection::Perspective { yfov: 0.8, aspect: None }, znear: 0.05, zfar: None };
    let options = RenderOptions { wait, ..RenderOptions::default() };
    for distance in [4.0, 1.1, 0.0] {
        pose[2][3] = distance;
        if let Ok(frame) = renderer.render(&scene, &camera, &pose, &options) {
            let _ = (frame.color(), frame.depth(), frame.normals(), frame.face_ids(), frame.cluster_ids());
        }
    }
}
