//! Decoding a page. Its bytes may hold anything: errors name what is wrong, and no allocation exceeds what the
//! number of clusters allows.

use bytemuck::Zeroable;

use super::columns::{Color, Column, Float, Normal, Row, Whole};
use super::page::{
    Context, EARLIER, MAX_STEPS, SHARED, SPHERE_BYTES, Shape, USE_BITS, USE_MASK, USES_PER_BYTE, record_bytes,
};
use super::planes::{Read, Reader, SLACK, Tools, grow, unzigzag};
use super::topology::{self, Source, Tables};
use crate::error::Result;
use crate::limits::{CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, PAGE_MAX_CLUSTERS};
use crate::math::octahedral::{NORMAL_BITS, widen};
use crate::math::{Aabb, Ball, Sphere};
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS};
use crate::model::packing::{self, VertexRow, coordinate_of, ordered, write_triangles};
use crate::model::rule::SOURCE_ERROR;
use crate::model::{ClusterRecord, ColorFormat, Packing};

/// Room for a row of every vertex of a page, and for zeros before them, so that any number of 16 bits is one of a row.
const ROWS: usize = 1 << 16;
const _: () = assert!(PAGE_MAX_CLUSTERS * CLUSTER_MAX_VERTICES < ROWS);
type Rows = [Row; ROWS];

/// The scratch buffers of a thread that decodes pages.
pub struct Decoder {
    tools: Tools,
    tables: Tables,
    buffers: Buffers,
    /// What the distinct vertices of a page have of what is being read, from 1 on.
    rows: Box<Rows>,
    /// Coordinates of normals in memory, by their low bits in files.
    wide: Vec<u16>,
}

/// A number for each row.
type Numbers = [u32; ROWS];

struct Buffers {
    /// Arrays on their way.
    bytes: Vec<u8>,
    extra: Vec<u8>,
    shapes: Vec<Shape>,
    /// For each vertex of the page the three of its cluster that it is predicted from.
    sources: Vec<Source>,
    /// For each vertex its row.
    numbers: Vec<u16>,
    /// For each row the three that it is predicted from.
    places: Box<[[u16; 4]; ROWS]>,
    /// Numbers of shared vertices, then identities of those that earlier pages have.
    others: Box<Numbers>,
    /// The identity of each row.
    ids: Box<Numbers>,
    /// One more than there are distinct vertices: rows start at 1.
    rows: usize,
}

/// Zeros that take no memory before they are written.
fn zeros<T: Zeroable + Clone>() -> Box<[T; ROWS]> {
    bytemuck::zeroed_box()
}

impl Decoder {
    /// A decoder.
    pub fn new() -> Result<Self> {
        let tools = Tools::new()?;
        let buffers = Buffers {
            bytes: Vec::new(),
            extra: Vec::new(),
            shapes: Vec::new(),
            sources: Vec::new(),
            numbers: Vec::new(),
            places: zeros(),
            others: zeros(),
            ids: zeros(),
            rows: 1,
        };
        Ok(Self { tools, tables: Tables::default(), buffers, rows: zeros(), wide: Vec::new() })
    }

    /// Fills the words of a page of so many clusters, all zero before, from bytes.
    pub fn decode(
        &mut self,
        context: &Context<'_>,
        coded: &[u8],
        clusters: usize,
        out: &mut [u32],
    ) -> Read<()> {
        let mut reader = Reader::new(coded, &mut self.tools);
        let (buffers, rows) = (&mut self.buffers, &mut *self.rows);
        let layout = context.layout;
        read_records(context, clusters, &mut reader, buffers, out)?;
        read_triangles(&mut reader, &mut self.tables, buffers, out)?;
        read_identities(context, &mut reader, buffers)?;

        match context.grid {
            Some(_) => read_rows::<3>(&Whole, &mut reader, buffers, rows)?,
            None => read_rows::<3>(&Float, &mut reader, buffers, rows)?,
        }
        put_vertices(context.step(), buffers, rows, out)?;
        let bits = context.normal_bits();
        if self.wide.len() != 1 << bits {
            let unused = u32::BITS - bits;
            let signed = |low: u32| (low << unused).cast_signed() >> unused;
            self.wide = (0..1 << bits).map(|low| widen(signed(low), bits)).collect();
        }
        read_rows::<2>(&Normal { bits }, &mut reader, buffers, rows)?;
        let wide = |t: u32| u32::from(self.wide[t as usize & (self.wide.len() - 1)]);
        for row in &mut rows[..buffers.rows] {
            row[0] = wide(row[0]) | wide(row[1]) << NORMAL_BITS;
        }
        put_rows::<1>(|s| s.streams.normals, buffers, rows, out);
        let stream = |s: &Shape| s.streams.colors;
        match layout.colors {
            ColorFormat::None => {}
            ColorFormat::Unorm8 => {
                read_rows::<4>(&Color, &mut reader, buffers, rows)?;
                for row in &mut rows[..buffers.rows] {
                    row[0] = u32::from_le_bytes(row.map(|byte| byte as u8));
                }
                put_rows::<1>(stream, buffers, rows, out);
            }
            ColorFormat::Unorm16 => {
                read_rows::<4>(&Whole, &mut reader, buffers, rows)?;
                for row in &mut rows[..buffers.rows] {
                    let [r, g, b, a] = *row;
                    if r | g | b | a > 0xffff {
                        return Err("a colour of more than 16 bits");
                    }
                    [row[0], row[1]] = [r | g << 16, b | a << 16];
                }
                put_rows::<2>(stream, buffers, rows, out);
            }
            ColorFormat::Float32 => {
                read_rows::<4>(&Float, &mut reader, buffers, rows)?;
                put_rows::<4>(stream, buffers, rows, out);
            }
        }
        for set in 0..usize::from(layout.uv_sets) {
            let step = context.uv_step();
            if step > 0.0 {
                read_rows::<2>(&Whole, &mut reader, buffers, rows)?;
                let mut outside = 0;
                for row in &mut rows[..buffers.rows] {
                    let numbers = row.map(u32::cast_signed);
                    *row = numbers.map(|t| coordinate_of(t, step).to_bits());
                    // Negative where one is beyond.
                    numbers.iter().for_each(|t| outside |= MAX_STEPS.wrapping_sub(t.wrapping_abs()));
                }
                if outside < 0 {
                    return Err("a UV beyond its grid");
                }
            } else {
                read_rows::<2>(&Float, &mut reader, buffers, rows)?;
            }
            let stream = |s: &Shape| s.streams.uvs + 2 * set * s.vertices;
            put_rows::<2>(stream, buffers, rows, out);
        }
        if reader.rest().iter().any(|byte| *byte != 0) {
            return Err("something follows what the page has");
        }
        Ok(())
    }
}

/// Fills in records, but for what follows from positions, and notes where clusters lie.
fn read_records(
    context: &Context<'_>,
    clusters: usize,
    reader: &mut Reader<'_>,
    buffers: &mut Buffers,
    out: &mut [u32],
) -> Read<()> {
    let layout = context.layout;
    let Buffers { bytes, extra, shapes, .. } = buffers;
    if clusters > PAGE_MAX_CLUSTERS || out.len() < clusters * RECORD_WORDS {
        return Err("clusters do not fill the page");
    }
    let length = clusters * record_bytes(layout);
    grow(bytes, length);
    reader.bytes(&mut bytes[..length])?;
    // Bytes of all clusters follow each other, first the first ones of all.
    let (words, mut groups) = (out.len(), context.group_numbers());
    let byte = |k: usize, c: usize| bytes[k * clusters + c];
    let word = |k: usize, c: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| byte(k + i, c)));
    let sum = |last: u32, k: usize, c: usize| last.wrapping_add(unzigzag(word(k, c)));
    let (mut refined, mut material, mut sources) = (0, 0, 0);
    let mut data = clusters * RECORD_WORDS;
    shapes.clear();
    for c in 0..clusters {
        let (vertex_count, triangle_count) = (byte(0, c), byte(1, c));
        let (vertices, triangles) = (usize::from(vertex_count), usize::from(triangle_count));
        if vertices == 0 || !(1..=CLUSTER_MAX_TRIANGLES).contains(&triangles) {
            return Err("a cluster of no triangles, or of too many");
        }
        refined = sum(refined, 15, c);
        if layout.materials {
            material = sum(material, 19, c);
        }
        let made_from = context.groups.get(refined as usize);
        let (lod_sphere, error) = if refined == NO_GROUP {
            sources += 1;
            (Sphere { center: [0.0; 3], radius: 0.0 }, SOURCE_ERROR)
        } else {
            let group = made_from.ok_or("a cluster made from no group")?;
            (group.lod_sphere, group.error)
        };
        let record = ClusterRecord {
            center: [0.0; 3],
            radius: 0.0,
            extent: [0.0; 3],
            cone: [7, 8, 9, 10].map(|k| byte(k, c).cast_signed()),
            lod_sphere,
            error,
            group: groups.next().ok_or("more clusters than groups have")?,
            vertex_count,
            triangle_count,
            level: byte(2, c),
            reserved: 0,
            data: data as u32,
            refined,
            max_edge: f32::from_bits(word(11, c)),
            material: material.cast_signed(),
            refined_page: made_from.map_or(NO_PAGE, |group| group.first.page() as u32),
        };
        out[c * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));
        let widths = [3, 4, 5, 6].map(|k| byte(k, c));
        let streams = layout.streams(vertices, triangles, widths);
        shapes.push(Shape { vertices, triangles, widths, data, streams });
        data += streams.end;
    }
    if data != words {
        return Err("clusters do not fill the page");
    }
    let spheres = sources * SPHERE_BYTES;
    grow(extra, spheres);
    reader.bytes(&mut extra[..spheres])?;
    let records: &mut [ClusterRecord] = bytemuck::cast_slice_mut(&mut out[..clusters * RECORD_WORDS]);
    for (s, record) in records.iter_mut().filter(|r| r.refined == NO_GROUP).enumerate() {
        let sphere: [u8; SPHERE_BYTES] = std::array::from_fn(|k| extra[k * sources + s]);
        record.lod_sphere = bytemuck::cast(sphere);
    }
    Ok(())
}

fn read_triangles(
    reader: &mut Reader<'_>,
    tables: &mut Tables,
    buffers: &mut Buffers,
    out: &mut [u32],
) -> Read<()> {
    let Buffers { bytes, extra, shapes, sources, .. } = buffers;
    let count: usize = shapes.iter().map(|s| s.triangles).sum();
    reader.symbols(count, bytes)?;
    let symbols = &bytes[..count];
    let count = topology::extra_bytes(symbols);
    grow(extra, count);
    let extra = &mut extra[..count];
    reader.bytes(extra)?;
    let (mut symbols, mut extra) = (symbols, extra.iter());
    let mut triangles = [[0; 3]; CLUSTER_MAX_TRIANGLES];
    // Each cluster takes 256, of which the next one overwrites those that are too many.
    let (vertices, mut first) = (shapes.iter().map(|s| s.vertices).sum::<usize>(), 0);
    sources.resize(vertices + 256, Source::default());
    for shape in &*shapes {
        let (own, after) = symbols.split_at(shape.triangles);
        symbols = after;
        let triangles = &mut triangles[..shape.triangles];
        let window = sources[first..].first_chunk_mut().ok_or("more vertices than there are")?;
        topology::decode(tables, own, &mut extra, shape.vertices, triangles, window)?;
        let stream = shape.data + shape.streams.triangles..shape.data + shape.streams.normals;
        write_triangles(triangles, shape.vertices, &mut out[stream]);
        first += shape.vertices;
    }
    sources.truncate(vertices);
    Ok(())
}

/// Reads identities, numbers the distinct vertices, and finds out what each is predicted from.
fn read_identities(context: &Context<'_>, reader: &mut Reader<'_>, buffers: &mut Buffers) -> Read<()> {
    let Buffers { bytes, extra, shapes, sources, numbers, places, others, ids, .. } = buffers;
    let vertices = sources.len();
    let packed = vertices.div_ceil(USES_PER_BYTE);
    grow(bytes, packed);
    reader.bytes(&mut bytes[..packed])?;
    grow(extra, packed * USES_PER_BYTE);
    for (uses, byte) in extra.chunks_exact_mut(USES_PER_BYTE).zip(&bytes[..packed]) {
        (0..USES_PER_BYTE).for_each(|k| uses[k] = byte >> (USE_BITS * k) & USE_MASK);
    }
    let uses = &extra[..vertices];
    if uses.contains(&(SHARED | EARLIER)) {
        return Err("identities of an unknown kind");
    }
    let count = |kind: u8| uses.iter().map(|u| u32::from(u & kind)).sum::<u32>() / u32::from(kind);
    let (count_shared, count_earlier) = (count(SHARED) as usize, count(EARLIER) as usize);
    let others = &mut **others;
    reader.words(bytes, &mut others[..count_shared + count_earlier])?;
    sum(&mut others[..count_shared]);
    sum(&mut others[count_shared..][..count_earlier]);

    // No branches: what a vertex has no use for is overwritten by the next.
    let either = |second: u32, a: u32, b: u32| a ^ (a ^ b) & second.wrapping_neg();
    let (mut n, mut s, mut e, mut unknown) = (1u32, 0u32, count_shared as u32, 0u32);
    // What to add for the number of vertices of the first kind.
    let next = context.first_identity.wrapping_add(e).wrapping_sub(n);
    numbers.resize(vertices, 0);
    for (kind, number) in uses.iter().zip(&mut *numbers) {
        let (is_shared, is_earlier) = (u32::from(kind & SHARED), u32::from(kind / EARLIER));
        let (before, other) = (others[s as usize % ROWS], others[e as usize % ROWS]);
        ids[n as usize % ROWS] = either(is_earlier, next.wrapping_add(n).wrapping_sub(e), other);
        unknown |= is_shared & u32::from(before >= n - 1);
        *number = either(is_shared, n, before.wrapping_add(1)) as u16;
        n += 1 - is_shared;
        s += is_shared;
        e += is_earlier;
    }
    if unknown != 0 {
        return Err("a vertex is shared that is not there yet");
    }

    let mut n = 1;
    let mut local = [0u16; 256];
    let mut vertex = sources.iter().zip(&*numbers);
    for shape in &*shapes {
        // The numbers come second: of 255 vertices no number follows the last.
        for ((sources, number), local_number) in vertex.by_ref().take(shape.vertices).zip(0u8..) {
            let row = usize::from(*number);
            places[n % ROWS] = sources.to_le_bytes().map(|v| local[usize::from(v)]);
            n += usize::from(row == n);
            local[usize::from(local_number)] = *number;
        }
    }
    buffers.rows = n;
    Ok(())
}

/// The inverse of differences from one number to the next.
fn sum(codes: &mut [u32]) {
    let mut last = 0u32;
    for code in codes {
        last = last.wrapping_add(unzigzag(*code));
        *code = last;
    }
}

/// Reads what distinct vertices have in so many columns.
fn read_rows<const N: usize>(
    column: &impl Column,
    reader: &mut Reader<'_>,
    buffers: &mut Buffers,
    rows: &mut Rows,
) -> Read<()> {
    let Buffers { bytes, places, rows: end, .. } = buffers;
    let places = &places[1..*end];
    let planes = reader.planes(N * places.len(), bytes)?;
    match planes {
        0 => fill_rows::<N, 0>(column, bytes, places, rows),
        1 => fill_rows::<N, 1>(column, bytes, places, rows),
        2 => fill_rows::<N, 2>(column, bytes, places, rows),
        3 => fill_rows::<N, 3>(column, bytes, places, rows),
        _ => fill_rows::<N, 4>(column, bytes, places, rows),
    }
    Ok(())
}

fn fill_rows<const N: usize, const PLANES: usize>(
    column: &impl Column,
    bytes: &[u8],
    places: &[[u16; 4]],
    rows: &mut Rows,
) {
    let size = N * places.len();
    let planes: [&[u8]; PLANES] = std::array::from_fn(|p| &bytes[p * size..][..size + SLACK]);
    for (i, place) in places.iter().enumerate() {
        let mut code = Row::default();
        for (p, plane) in planes.iter().enumerate() {
            let four = &plane[N * i..][..4];
            (0..4).for_each(|k| code[k] |= if k < N { u32::from(four[k]) << (8 * p) } else { 0 });
        }
        let [p, q, r, _] = place.map(|number| rows[usize::from(number)]);
        let expected = column.predict(p, q, r);
        rows[(i + 1) % ROWS] = std::array::from_fn(|k| column.value(code[k], expected[k]));
    }
}

/// Copies rows to the vertices that have them: a stream of so many columns.
fn put_rows<const N: usize>(
    stream: impl Fn(&Shape) -> usize,
    buffers: &Buffers,
    rows: &Rows,
    out: &mut [u32],
) {
    let mut numbers = buffers.numbers.iter();
    for shape in &buffers.shapes {
        let stream = &mut out[shape.data + stream(shape)..][..N * shape.vertices];
        for (to, number) in stream.chunks_exact_mut(N).zip(&mut numbers) {
            to.copy_from_slice(&rows[usize::from(*number)][..N]);
        }
    }
}

/// Packs positions and identities, and fills in what follows from positions.
fn put_vertices(step: f32, buffers: &Buffers, rows: &Rows, out: &mut [u32]) -> Read<()> {
    let (records, streams) = out.split_at_mut(buffers.shapes.len() * RECORD_WORDS);
    let before = records.len();
    let records: &mut [ClusterRecord] = bytemuck::cast_slice_mut(records);
    let mut numbers = buffers.numbers.iter();
    let mut own = [VertexRow::default(); 256];
    let mut points = [[0f32; 3]; 256];
    for (record, shape) in records.iter_mut().zip(&buffers.shapes) {
        let numbers = numbers.by_ref().take(shape.vertices).map(|number| usize::from(*number));
        for ((row, point), number) in own.iter_mut().zip(&mut points).zip(numbers) {
            let value = rows[number];
            *row = if step > 0.0 { value } else { value.map(ordered) }.map(u32::cast_signed);
            point.copy_from_slice(&row.map(|x| coordinate_of(x, step))[..3]);
            row[3] = buffers.ids[number].cast_signed();
        }
        let (own, points) = (&own[..shape.vertices], &points[..shape.vertices]);
        let (least, most) = packing::range(own);
        let packing = Packing::between(least, most, step);
        if packing.widths != shape.widths {
            return Err("numbers of other widths than are said");
        }
        packing.write(own, &mut streams[shape.data - before..][..shape.streams.triangles]);
        let ball = if step > 0.0 {
            if least[..3].iter().any(|x| *x < -MAX_STEPS) || most[..3].iter().any(|x| *x > MAX_STEPS) {
                return Err("a position beyond the grid");
            }
            let [min, max] = [least, most].map(|[x, y, z, _]| [x, y, z].map(|x| coordinate_of(x, step)));
            Ball::in_box(Aabb { min, max }, points)
        } else {
            Ball::of(points)
        };
        (record.center, record.extent, record.radius) = (ball.center, ball.extent, ball.radius);
    }
    Ok(())
}
