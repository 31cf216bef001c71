//! Encoding a page.

use rustc_hash::FxHashMap;

use super::columns::{Color, Column, Float, Normal, Row, Whole};
use super::page::{
    Context, EARLIER, FIRST, Part, PartBytes, SHARED, SPHERE_BYTES, USE_BITS, USES_PER_BYTE, record_bytes,
};
use super::planes::{Writer, zigzag};
use super::topology::{self, Source};
use crate::error::Result;
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::math::octahedral::narrow;
use crate::model::cluster::{NO_GROUP, RECORD_WORDS};
use crate::model::packing::{number_of, ordered};
use crate::model::{AttributeLayout, ClusterGeometry, ClusterRecord, ColorFormat};

/// Writes rows of all vertices that have to be, as differences from what is expected.
fn write_rows<const N: usize>(
    writer: &mut Writer,
    column: &impl Column,
    geometry: &[ClusterGeometry<'_>],
    places: &[Place],
    value: impl Fn(usize, usize) -> [u32; N],
) -> Result<()> {
    let mut codes: Vec<[u32; N]> = Vec::new();
    let mut local = [Row::default(); CLUSTER_MAX_VERTICES + 1];
    let mut places = places.iter();
    for (c, geometry) in geometry.iter().enumerate() {
        for (i, place) in places.by_ref().take(geometry.positions.len()).enumerate() {
            let found = value(c, i);
            if !place.shared {
                let [p, q, r, _] = place.sources.to_le_bytes().map(|s| local[usize::from(s)]);
                let expected = column.predict(p, q, r);
                codes.push(std::array::from_fn(|k| column.code(found[k], expected[k])));
            }
            local[i][..N].copy_from_slice(&found);
        }
    }
    writer.rows(codes.iter().copied())
}

/// Appends the bytes of a page to `writer`; how many are of which part.
pub fn encode(
    context: &Context<'_>,
    words: &[u32],
    clusters: usize,
    writer: &mut Writer,
) -> Result<PartBytes> {
    let layout = context.layout;
    let records: &[ClusterRecord] = bytemuck::cast_slice(&words[..clusters * RECORD_WORDS]);
    let counts = |r: &ClusterRecord| (usize::from(r.vertex_count), usize::from(r.triangle_count));
    let geometry: Vec<ClusterGeometry<'_>> = records
        .iter()
        .map(|r| ClusterGeometry::new(&words[r.data as usize..], layout, counts(r).0, counts(r).1))
        .collect();
    let mut parts = [0; Part::ALL.len()];
    let mut start = writer.bytes.len();
    let mut ended = |part: Part, writer: &Writer| {
        parts[part as usize] = (writer.bytes.len() - start) as u32;
        start = writer.bytes.len();
    };

    write_records(layout, records, &geometry, writer)?;
    ended(Part::Records, writer);

    let (mut symbols, mut extra, mut sources, mut places) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for geometry in &geometry {
        topology::encode(&geometry.triangles.to_vec(), &mut symbols, &mut extra, &mut sources);
        // Vertices that no triangle uses have no place: what is read back is then not what was written, and said so.
        sources.resize(geometry.positions.len(), Source::default());
        places.extend(sources.iter().map(|sources| Place { shared: false, sources: *sources }));
    }
    writer.symbols(&symbols)?;
    writer.bytes(&extra)?;
    ended(Part::Topology, writer);

    write_identities(context, &geometry, &mut places, writer)?;
    ended(Part::Identities, writer);

    let numbers = |c: usize, i: usize| geometry[c].positions.numbers(i).map(i32::cast_unsigned);
    match context.grid {
        Some(_) => write_rows(writer, &Whole, &geometry, &places, numbers)?,
        None => write_rows(writer, &Float, &geometry, &places, |c, i| numbers(c, i).map(ordered))?,
    }
    ended(Part::Positions, writer);

    let bits = context.normal_bits();
    let normal = |c: usize, i: usize| narrow(geometry[c].normals[i], bits).map(i32::cast_unsigned);
    write_rows(writer, &Normal { bits }, &geometry, &places, normal)?;
    ended(Part::Normals, writer);

    match layout.colors {
        ColorFormat::None => {}
        ColorFormat::Unorm8 => {
            let color = |c: usize, i: usize| geometry[c].colors[i].to_le_bytes().map(u32::from);
            write_rows(writer, &Color, &geometry, &places, color)?;
        }
        ColorFormat::Unorm16 => {
            let half = |c: usize, i: usize| geometry[c].colors[i];
            let color = |c: usize, i: usize| {
                let [rg, ba] = [half(c, 2 * i), half(c, 2 * i + 1)];
                [rg & 0xffff, rg >> 16, ba & 0xffff, ba >> 16]
            };
            write_rows(writer, &Whole, &geometry, &places, color)?;
        }
        ColorFormat::Float32 => {
            let color = |c: usize, i: usize| [0, 1, 2, 3].map(|k| geometry[c].colors[4 * i + k]);
            write_rows(writer, &Float, &geometry, &places, color)?;
        }
    }
    ended(Part::Colors, writer);

    for set in 0..usize::from(layout.uv_sets) {
        let uv = |c: usize, i: usize| geometry[c].uvs[set * geometry[c].positions.len() + i];
        let step = context.uv_step();
        if step > 0.0 {
            let numbers = |c, i| uv(c, i).map(|t| number_of(t, step).cast_unsigned());
            write_rows(writer, &Whole, &geometry, &places, numbers)?;
        } else {
            write_rows(writer, &Float, &geometry, &places, |c, i| uv(c, i).map(f32::to_bits))?;
        }
    }
    ended(Part::Uvs, writer);
    Ok(parts)
}

/// Differences from one number to the next, starting at zero.
fn steps(values: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut last = 0;
    values.map(|v| zigzag(v.wrapping_sub(std::mem::replace(&mut last, v)))).collect()
}

fn write_records(
    layout: AttributeLayout,
    records: &[ClusterRecord],
    geometry: &[ClusterGeometry<'_>],
    writer: &mut Writer,
) -> Result<()> {
    // All first bytes, then all second ones, and so on.
    let transposed = |rows: &[Vec<u8>], width: usize| -> Vec<u8> {
        (0..width).flat_map(|k| rows.iter().map(move |row| row[k])).collect()
    };
    let refined = steps(records.iter().map(|r| r.refined));
    let materials = steps(records.iter().map(|r| r.material.cast_unsigned()));
    let row = |(c, r): (usize, &ClusterRecord)| {
        let mut row = vec![r.vertex_count, r.triangle_count, r.level];
        row.extend(geometry[c].widths());
        row.extend(r.cone.map(i8::cast_unsigned));
        row.extend(r.max_edge.to_le_bytes());
        row.extend(refined[c].to_le_bytes());
        row.extend(layout.materials.then_some(materials[c].to_le_bytes()).into_iter().flatten());
        row
    };
    let rows: Vec<Vec<u8>> = records.iter().enumerate().map(row).collect();
    writer.bytes(&transposed(&rows, record_bytes(layout)))?;
    let spheres = records.iter().filter(|r| r.refined == NO_GROUP);
    let spheres: Vec<Vec<u8>> = spheres.map(|r| bytemuck::bytes_of(&r.lod_sphere).to_vec()).collect();
    writer.bytes(&transposed(&spheres, SPHERE_BYTES))
}

/// A vertex of a cluster while it is coded.
struct Place {
    /// An earlier cluster of the page has it.
    shared: bool,
    /// Vertices of the cluster: p, q, r of p + q − r.
    sources: Source,
}

/// Writes who shares what, and notes it in `places`.
fn write_identities(
    context: &Context<'_>,
    geometry: &[ClusterGeometry<'_>],
    places: &mut [Place],
    writer: &mut Writer,
) -> Result<()> {
    let mut known: FxHashMap<u32, u32> = FxHashMap::default();
    let mut next = context.first_identity;
    let (mut uses, mut shared, mut earlier) = (Vec::new(), Vec::new(), Vec::new());
    for (id, place) in geometry.iter().flat_map(|g| g.ids.iter()).zip(places) {
        let count = known.len() as u32;
        if let Some(number) = known.get(&id) {
            uses.push(SHARED);
            shared.push(*number);
            place.shared = true;
            continue;
        }
        known.insert(id, count);
        uses.push(if id == next { FIRST } else { EARLIER });
        if id == next {
            next += 1;
        } else {
            earlier.push(id);
        }
    }
    let packed = |uses: &[u8]| uses.iter().enumerate().fold(0, |byte, (i, u)| byte | u << (USE_BITS * i));
    writer.bytes(&uses.chunks(USES_PER_BYTE).map(packed).collect::<Vec<_>>())?;
    writer.words(&[steps(shared.into_iter()), steps(earlier.into_iter())].concat())
}
