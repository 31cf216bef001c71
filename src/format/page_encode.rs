//! A page as bytes.

use rustc_hash::FxHashMap;

use super::columns::{Color, Column, Float, Normal, Whole};
use super::page::{
    Context, EARLIER, FIRST, NO_NUMBER, Part, PartBytes, Place, SHARED, Shape, USE_BITS, USES_PER_BYTE,
};
use super::planes::{Writer, zigzag};
use super::topology;
use crate::error::Result;
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::math::octahedral::narrow;
use crate::model::cluster::{NO_GROUP, RECORD_WORDS};
use crate::model::{AttributeLayout, ClusterGeometry, ClusterRecord};

/// Writes columns of all vertices that have to be, as differences from what is expected.
fn write_rows<const N: usize>(
    writer: &mut Writer,
    column: &impl Column<N>,
    shapes: &[Shape],
    places: &[Place],
    value: impl Fn(usize, usize) -> [u32; N],
) -> Result<()> {
    let mut codes: [Vec<u32>; N] = std::array::from_fn(|_| Vec::new());
    let mut local = [[0; N]; CLUSTER_MAX_VERTICES + 1];
    let mut places = places.iter();
    for (c, shape) in shapes.iter().enumerate() {
        for (i, place) in places.by_ref().take(shape.vertices).enumerate() {
            let found = value(c, i);
            if place.known == NO_NUMBER {
                let [p, q, r] = place.sources.map(|s| local[usize::from(s)]);
                let expected = column.predict(p, q, r);
                (0..N).for_each(|k| codes[k].push(column.code(found[k], expected[k])));
            }
            local[i] = found;
        }
    }
    codes.iter().try_for_each(|codes| writer.words(codes))
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
    let shape = |r: &ClusterRecord| Shape {
        vertices: usize::from(r.vertex_count),
        triangles: usize::from(r.triangle_count),
        data: r.data as usize,
    };
    let shapes: Vec<Shape> = records.iter().map(shape).collect();
    let geometry: Vec<ClusterGeometry<'_>> = shapes
        .iter()
        .map(|s| {
            let words = &words[s.data..][..layout.cluster_words(s.vertices, s.triangles)];
            ClusterGeometry::new(words, layout, s.vertices, s.triangles)
        })
        .collect();
    let mut parts = [0; Part::ALL.len()];
    let mut start = writer.bytes.len();
    let mut ended = |part: Part, writer: &Writer| {
        parts[part as usize] = (writer.bytes.len() - start) as u32;
        start = writer.bytes.len();
    };

    write_records(layout, records, writer)?;
    ended(Part::Records, writer);

    let (mut symbols, mut extra, mut sources, mut places) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (geometry, shape) in geometry.iter().zip(&shapes) {
        topology::encode(geometry.triangles, &mut symbols, &mut extra, &mut sources);
        // Vertices that no triangle uses have no place: what is read back is then not what was written, and said so.
        sources.resize(shape.vertices, [0; 3]);
        places.extend(sources.iter().map(|sources| Place { known: NO_NUMBER, sources: *sources }));
    }
    writer.bytes(&symbols)?;
    writer.bytes(&extra)?;
    ended(Part::Topology, writer);

    write_identities(context, &geometry, &mut places, writer)?;
    ended(Part::Identities, writer);

    let position = |c: usize, i: usize| geometry[c].positions[i];
    match context.grid {
        Some(grid) => {
            let steps = grid.steps();
            let value = |c, i| position(c, i).map(|x| ((x * steps) as i32).cast_unsigned());
            write_rows(writer, &Whole, &shapes, &places, value)?;
        }
        None => write_rows(writer, &Float, &shapes, &places, |c, i| position(c, i).map(f32::to_bits))?,
    }
    ended(Part::Positions, writer);

    let bits = context.normal_bits();
    let normal = |c: usize, i: usize| narrow(geometry[c].normals[i], bits).map(i32::cast_unsigned);
    write_rows(writer, &Normal { bits }, &shapes, &places, normal)?;
    ended(Part::Normals, writer);

    if layout.colors {
        let color = |c: usize, i: usize| [u32::from_le_bytes(geometry[c].colors[i])];
        write_rows(writer, &Color, &shapes, &places, color)?;
    }
    ended(Part::Colors, writer);

    for set in 0..usize::from(layout.uv_sets) {
        let uv = |c: usize, i: usize| geometry[c].uvs[set * shapes[c].vertices + i].map(f32::to_bits);
        write_rows(writer, &Float, &shapes, &places, uv)?;
    }
    ended(Part::Uvs, writer);
    Ok(parts)
}

/// Differences from one number to the next, starting at zero.
fn steps(values: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut last = 0;
    values.map(|v| zigzag(v.wrapping_sub(std::mem::replace(&mut last, v)))).collect()
}

fn write_records(layout: AttributeLayout, records: &[ClusterRecord], writer: &mut Writer) -> Result<()> {
    let bytes = |of: fn(&ClusterRecord) -> u8| records.iter().map(of).collect::<Vec<_>>();
    writer.bytes(&bytes(|r| r.vertex_count))?;
    writer.bytes(&bytes(|r| r.triangle_count))?;
    writer.bytes(&bytes(|r| r.level))?;
    writer.words(&steps(records.iter().map(|r| r.refined)))?;
    if layout.materials {
        writer.words(&steps(records.iter().map(|r| r.material.cast_unsigned())))?;
    }
    let spheres = records.iter().filter(|r| r.refined == NO_GROUP).map(|r| r.lod_sphere);
    let spheres: Vec<[u32; 4]> = spheres.map(bytemuck::cast).collect();
    (0..4).try_for_each(|k| writer.words(&spheres.iter().map(|s| s[k]).collect::<Vec<_>>()))
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
    for (id, place) in geometry.iter().flat_map(|g| g.ids).zip(places) {
        let count = known.len() as u32;
        place.known = *known.entry(*id).or_insert(NO_NUMBER);
        if place.known != NO_NUMBER {
            uses.push(SHARED);
            shared.push(place.known);
            continue;
        }
        known.insert(*id, count);
        uses.push(if *id == next { FIRST } else { EARLIER });
        if *id == next {
            next += 1;
        } else {
            earlier.push(*id);
        }
    }
    let packed = |uses: &[u8]| uses.iter().enumerate().fold(0, |byte, (i, u)| byte | u << (USE_BITS * i));
    writer.bytes(&uses.chunks(USES_PER_BYTE).map(packed).collect::<Vec<_>>())?;
    writer.words(&steps(shared.into_iter()))?;
    writer.words(&steps(earlier.into_iter()))
}
