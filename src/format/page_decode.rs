//! A page from its bytes. They may hold anything: what is wrong is said, and nothing is allocated beyond what the
//! number of clusters allows.

use zstd::bulk::Decompressor;

use super::columns::{Color, Column, Float, Normal, Whole};
use super::page::{
    Context, EARLIER, FIRST, MAX_STEPS, NO_NUMBER, Place, SHARED, Shape, USE_BITS, USES_PER_BYTE,
};
use super::planes::{Read, Reader, unzigzag};
use super::topology;
use crate::error::{Error, Result};
use crate::limits::{CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES};
use crate::math::octahedral::{NORMAL_BITS, widen};
use crate::math::{Bounds, Sphere};
use crate::model::cluster::{NO_GROUP, RECORD_WORDS};
use crate::model::rule::SOURCE_ERROR;
use crate::model::{AttributeLayout, ClusterGeometry, ClusterRecord};

/// What a thread needs to decode pages, used again from one to the next.
pub struct Decoder {
    zstd: Decompressor<'static>,
    buffers: Buffers,
    /// Coordinates of normals in memory, by the low bits that stand for them.
    wide: Vec<u32>,
}

#[derive(Default)]
struct Buffers {
    plane: Vec<u8>,
    codes: [Vec<u32>; 3],
    symbols: Vec<u8>,
    extra: Vec<u8>,
    places: Vec<Place>,
}

/// What is known of a page before its geometry.
#[derive(Default)]
struct Records {
    shapes: Vec<Shape>,
    levels: Vec<u8>,
    refined: Vec<u32>,
    materials: Vec<u32>,
    /// Those of clusters of the source, in order.
    spheres: [Vec<u32>; 4],
}

/// The inverse of differences from one number to the next.
fn sum(codes: &mut [u32]) {
    let mut last = 0u32;
    for code in codes {
        last = last.wrapping_add(unzigzag(*code));
        *code = last;
    }
}

impl Decoder {
    /// A decoder.
    pub fn new() -> Result<Self> {
        let zstd = Decompressor::new().map_err(|e| Error::Invariant(format!("zstd: {e}")))?;
        Ok(Self { zstd, buffers: Buffers::default(), wide: Vec::new() })
    }

    /// Fills the words of a page of so many clusters, all zero before, from bytes.
    pub fn decode(
        &mut self,
        context: &Context<'_>,
        coded: &[u8],
        clusters: usize,
        out: &mut [u32],
    ) -> Read<()> {
        let mut reader = Reader::new(coded, &mut self.zstd);
        let buffers = &mut self.buffers;
        let layout = context.layout;
        let records = read_records(layout, clusters, out.len(), &mut reader, &mut buffers.plane)?;
        let shapes = &records.shapes;
        read_triangles(layout, shapes, &mut reader, buffers, out)?;
        let distinct = read_identities(context, shapes, &mut reader, buffers, out)?;
        let mut rows = Rows { shapes, distinct, reader: &mut reader, buffers, out };

        match context.grid {
            Some(grid) => {
                let (step, mut inside) = (grid.step(), true);
                rows.read(&Whole, |out, shape, i, row: [u32; 3]| {
                    let to = &mut out[shape.data + 3 * i..][..3];
                    for k in 0..3 {
                        let whole = row[k].cast_signed();
                        inside &= whole.unsigned_abs() <= MAX_STEPS.unsigned_abs();
                        to[k] = (whole as f32 * step).to_bits();
                    }
                })?;
                if !inside {
                    return Err("a position beyond the grid");
                }
            }
            None => rows.read(&Float, |out, shape, i, row: [u32; 3]| {
                out[shape.data + 3 * i..][..3].copy_from_slice(&row);
            })?,
        }
        let bits = context.normal_bits();
        if self.wide.len() != 1 << bits {
            let unused = u32::BITS - bits;
            let signed = |low: u32| (low << unused).cast_signed() >> unused;
            self.wide = (0..1 << bits).map(|low| u32::from(widen(signed(low), bits))).collect();
        }
        let wide = |t: u32| self.wide[t as usize & (self.wide.len() - 1)];
        rows.read(&Normal { bits }, |out, shape, i, [x, y]| {
            out[shape.data + 3 * shape.vertices + i] = wide(x) | wide(y) << NORMAL_BITS;
        })?;
        if layout.colors {
            rows.read(&Color, |out, shape, i, [color]| out[shape.data + 5 * shape.vertices + i] = color)?;
        }
        for set in 0..usize::from(layout.uv_sets) {
            let first = 5 + usize::from(layout.colors) + 2 * set;
            rows.read(&Float, |out, shape, i, row: [u32; 2]| {
                out[shape.data + first * shape.vertices + 2 * i..][..2].copy_from_slice(&row);
            })?;
        }
        if reader.rest().iter().any(|byte| *byte != 0) {
            return Err("something follows what the page has");
        }
        write_records(context, &records, out)
    }
}

fn read_records(
    layout: AttributeLayout,
    clusters: usize,
    words: usize,
    reader: &mut Reader<'_>,
    plane: &mut Vec<u8>,
) -> Read<Records> {
    let mut records = Records::default();
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    reader.bytes(clusters, &mut vertices)?;
    reader.bytes(clusters, &mut triangles)?;
    let mut data = clusters * RECORD_WORDS;
    for (vertices, triangles) in vertices.iter().zip(&triangles) {
        let (vertices, triangles) = (usize::from(*vertices), usize::from(*triangles));
        if vertices == 0 || !(1..=CLUSTER_MAX_TRIANGLES).contains(&triangles) {
            return Err("a cluster of no triangles, or of too many");
        }
        records.shapes.push(Shape { vertices, triangles, data });
        data += layout.cluster_words(vertices, triangles);
    }
    if data != words {
        return Err("clusters do not fill the page");
    }
    reader.bytes(clusters, &mut records.levels)?;
    reader.words(clusters, plane, &mut records.refined)?;
    sum(&mut records.refined);
    if layout.materials {
        reader.words(clusters, plane, &mut records.materials)?;
        sum(&mut records.materials);
    }
    let sources = records.refined.iter().filter(|r| **r == NO_GROUP).count();
    records.spheres.iter_mut().try_for_each(|column| reader.words(sources, plane, column))?;
    Ok(records)
}

fn read_triangles(
    layout: AttributeLayout,
    shapes: &[Shape],
    reader: &mut Reader<'_>,
    buffers: &mut Buffers,
    out: &mut [u32],
) -> Read<()> {
    reader.bytes(shapes.iter().map(|s| s.triangles).sum(), &mut buffers.symbols)?;
    reader.bytes(topology::extra_bytes(&buffers.symbols), &mut buffers.extra)?;
    let (mut symbols, mut extra) = (&buffers.symbols[..], &buffers.extra[..]);
    let mut sources = [[0; 3]; CLUSTER_MAX_VERTICES + 1];
    buffers.places.clear();
    for shape in shapes {
        let (own, rest) = symbols.split_at(shape.triangles);
        symbols = rest;
        let first = shape.data + shape.vertices * layout.vertex_words();
        let end = shape.data + layout.cluster_words(shape.vertices, shape.triangles);
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out[first..end]);
        let corners = &mut bytes[..3 * shape.triangles];
        topology::decode(own, &mut extra, shape.vertices, corners, &mut sources)?;
        let places = sources[..shape.vertices].iter();
        buffers.places.extend(places.map(|sources| Place { known: NO_NUMBER, sources: *sources }));
    }
    Ok(())
}

/// Fills in identities and notes who shares what; the number of distinct vertices.
fn read_identities(
    context: &Context<'_>,
    shapes: &[Shape],
    reader: &mut Reader<'_>,
    buffers: &mut Buffers,
    out: &mut [u32],
) -> Read<usize> {
    let Buffers { plane, codes: [shared, earlier, ids], symbols: uses, places, .. } = buffers;
    reader.bytes(places.len().div_ceil(USES_PER_BYTE), plane)?;
    uses.clear();
    for byte in &*plane {
        uses.extend((0..USES_PER_BYTE).map(|k| byte >> (USE_BITS * k) & ((1 << USE_BITS) - 1)));
    }
    uses.truncate(places.len());
    let mut counts = [0; 1 << USE_BITS];
    uses.iter().for_each(|u| counts[usize::from(*u)] += 1);
    reader.words(counts[usize::from(SHARED)], plane, shared)?;
    reader.words(counts[usize::from(EARLIER)], plane, earlier)?;
    sum(shared);
    sum(earlier);
    let (mut shared, mut earlier) = (shared.iter(), earlier.iter());
    let mut next = context.first_identity;
    ids.clear();
    let mut number = 0;
    for shape in shapes {
        for slot in &mut out[shape.data + 4 * shape.vertices..][..shape.vertices] {
            let id = match uses[number] {
                FIRST => {
                    next = next.wrapping_add(1);
                    next.wrapping_sub(1)
                }
                EARLIER => *earlier.next().ok_or("identities end too early")?,
                SHARED => {
                    let known = *shared.next().ok_or("identities end too early")?;
                    places[number].known = known;
                    *ids.get(known as usize).ok_or("a vertex is shared that is not there yet")?
                }
                _ => return Err("identities of an unknown kind"),
            };
            if places[number].known == NO_NUMBER {
                ids.push(id);
            }
            *slot = id;
            number += 1;
        }
    }
    Ok(ids.len())
}

/// Columns of vertices on their way from bytes to words.
struct Rows<'a, 'b> {
    shapes: &'a [Shape],
    distinct: usize,
    reader: &'a mut Reader<'b>,
    buffers: &'a mut Buffers,
    out: &'a mut [u32],
}

impl Rows<'_, '_> {
    fn read<const N: usize>(
        &mut self,
        column: &impl Column<N>,
        mut put: impl FnMut(&mut [u32], &Shape, usize, [u32; N]),
    ) -> Read<()> {
        let Buffers { plane, codes, places, .. } = &mut *self.buffers;
        codes[..N].iter_mut().try_for_each(|codes| self.reader.words(self.distinct, plane, codes))?;
        let codes: [&[u32]; N] = std::array::from_fn(|k| &codes[k][..]);
        let mut rows: Vec<[u32; N]> = Vec::with_capacity(self.distinct);
        let mut local = [[0; N]; CLUSTER_MAX_VERTICES + 1];
        let mut rest = &places[..];
        for shape in self.shapes {
            let (own, after) = rest.split_at(shape.vertices);
            rest = after;
            for (i, place) in own.iter().enumerate() {
                let row = if place.known == NO_NUMBER {
                    let [p, q, r] = place.sources;
                    let (p, q, r) = (local[usize::from(p)], local[usize::from(q)], local[usize::from(r)]);
                    let mut row = column.predict(p, q, r);
                    for k in 0..N {
                        row[k] = column.value(codes[k][rows.len()], row[k]);
                    }
                    rows.push(row);
                    row
                } else {
                    rows[place.known as usize]
                };
                local[i] = row;
                put(self.out, shape, i, row);
            }
        }
        Ok(())
    }
}

fn write_records(context: &Context<'_>, records: &Records, out: &mut [u32]) -> Read<()> {
    let layout = context.layout;
    let mut source = 0;
    let mut groups = context.group_numbers();
    for (c, (shape, refined)) in records.shapes.iter().zip(&records.refined).enumerate() {
        let words = &out[shape.data..][..layout.cluster_words(shape.vertices, shape.triangles)];
        let geometry = ClusterGeometry::new(words, layout, shape.vertices, shape.triangles);
        let bounds = Bounds::of(geometry.positions, geometry.triangles);
        let (lod_sphere, error) = if *refined == NO_GROUP {
            let [x, y, z, radius] = [0, 1, 2, 3].map(|k| f32::from_bits(records.spheres[k][source]));
            source += 1;
            (Sphere { center: [x, y, z], radius }, SOURCE_ERROR)
        } else {
            let group = context.groups.get(*refined as usize).ok_or("a cluster made from no group")?;
            (group.lod_sphere, group.error)
        };
        let record = ClusterRecord {
            center: bounds.center,
            radius: bounds.radius,
            extent: bounds.extent,
            cone: bounds.cone,
            lod_sphere,
            error,
            group: groups.next().ok_or("more clusters than groups have")?,
            vertex_count: shape.vertices as u8,
            triangle_count: shape.triangles as u8,
            level: records.levels[c],
            reserved: 0,
            data: shape.data as u32,
            refined: *refined,
            max_edge: bounds.max_edge,
            material: records.materials.get(c).map_or(0, |m| m.cast_signed()),
            reserved_word: 0,
        };
        out[c * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));
    }
    Ok(())
}
