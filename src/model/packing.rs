//! How a cluster holds positions and identities: as whole numbers above the least of each column, in as many bits as
//! the largest of the cluster needs; and triangles, a corner in seven bits or eight. Reading one takes a few instructions,
//! on any processor, and unpacks nothing else.

use bytemuck::{Pod, Zeroable};

use crate::limits::CLUSTER_MAX_TRIANGLES;

/// Bits of x, y, z and of an identity in a cluster, 0 to 32 each.
pub type Widths = [u8; 4];

/// More than any cluster needs.
pub const WIDEST: Widths = [u32::BITS as u8; 4];

/// Of one vertex: x, y, z as whole numbers, and the bits of its identity.
pub type VertexRow = [i32; 4];

/// The head of a cluster's streams: what its packed numbers count from.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Packing {
    /// The least of each column.
    pub anchor: VertexRow,
    /// Bits of each column.
    pub widths: Widths,
    /// Internal units per whole number, a power of two; 0 where numbers are those of [`ordered`].
    pub step: f32,
}

/// Words of a [`Packing`].
pub const PACKING_WORDS: usize = size_of::<Packing>() / 4;

/// Words of so many numbers of so many bits.
pub fn packed_words(count: usize, bits: usize) -> usize {
    (count * bits).div_ceil(32)
}

/// Bits of f32 as a whole number in the order of the values, and such a number as bits: the same thing.
#[inline(always)]
pub fn ordered(bits: u32) -> u32 {
    bits ^ ((bits.cast_signed() >> 31).cast_unsigned() >> 1)
}

/// The whole number of a coordinate, which is a multiple of `step` unless that is 0.
#[inline(always)]
pub fn number_of(x: f32, step: f32) -> i32 {
    // Divisions by powers of two are exact.
    if step == 0.0 { ordered(x.to_bits()).cast_signed() } else { (x / step) as i32 }
}

/// The coordinate of a whole number.
#[inline(always)]
pub fn coordinate_of(number: i32, step: f32) -> f32 {
    if step == 0.0 { f32::from_bits(ordered(number.cast_unsigned())) } else { number as f32 * step }
}

/// The row of a vertex.
pub fn vertex_row(position: [f32; 3], id: u32, step: f32) -> VertexRow {
    let [x, y, z] = position.map(|x| number_of(x, step));
    [x, y, z, id.cast_signed()]
}

/// The least and the largest number of each column.
#[inline(always)]
pub fn range(rows: &[VertexRow]) -> (VertexRow, VertexRow) {
    let (mut least, mut most) = ([i32::MAX; 4], [i32::MIN; 4]);
    for row in rows {
        for k in 0..4 {
            least[k] = if row[k] < least[k] { row[k] } else { least[k] };
            most[k] = if row[k] > most[k] { row[k] } else { most[k] };
        }
    }
    (least, most)
}

impl Packing {
    /// What holds rows in the fewest bits.
    pub fn of(rows: &[VertexRow], step: f32) -> Self {
        let (least, most) = range(rows);
        Self::between(least, most, step)
    }

    /// What holds rows of which these are the least and the largest numbers.
    pub fn between(least: VertexRow, most: VertexRow, step: f32) -> Self {
        let widths = std::array::from_fn(|k| {
            let range = most[k].wrapping_sub(least[k]).cast_unsigned();
            (u32::BITS - range.leading_zeros()) as u8
        });
        Self { anchor: least, widths, step }
    }

    /// Bits of a position.
    #[inline(always)]
    fn position_bits(&self) -> u32 {
        self.widths[..3].iter().map(|w| u32::from(*w)).sum()
    }

    /// Writes itself and rows to the head of a cluster's streams, which is zero.
    pub fn write(&self, rows: &[VertexRow], out: &mut [u32]) {
        let (head, out) = out.split_at_mut(PACKING_WORDS);
        head.copy_from_slice(bytemuck::cast_slice(&[*self]));
        let bits = self.position_bits();
        let (positions, ids) = out.split_at_mut(packed_words(rows.len(), bits as usize));
        let (mut positions, mut ids) = (BitWriter::new(positions), BitWriter::new(ids));
        let [x, y, z, id] = self.widths.map(u32::from);
        for row in rows {
            let code: [u32; 4] = std::array::from_fn(|k| row[k].wrapping_sub(self.anchor[k]).cast_unsigned());
            if bits <= u32::BITS {
                let joined = u64::from(code[0]) | u64::from(code[1]) << x | u64::from(code[2]) << (x + y);
                positions.put(joined as u32, bits);
            } else {
                (0..3).for_each(|k| positions.put(code[k], [x, y, z][k]));
            }
            ids.put(code[3], id);
        }
        positions.write();
        ids.write();
    }
}

/// Fields of up to 32 bits, one behind the other from the lowest bit up.
struct BitWriter<'a> {
    out: &'a mut [u32],
    word: usize,
    /// Bits of the word that is being filled, and how many there are of them.
    bits: u64,
    count: u32,
}

impl<'a> BitWriter<'a> {
    fn new(out: &'a mut [u32]) -> Self {
        Self { out, word: 0, bits: 0, count: 0 }
    }

    #[inline(always)]
    fn put(&mut self, value: u32, width: u32) {
        self.bits |= u64::from(value) << self.count;
        self.count += width;
        self.write();
        let full = self.count / u32::BITS;
        self.word += full as usize;
        self.bits >>= u32::BITS * full;
        self.count %= u32::BITS;
    }

    /// What is there of the word that is being filled.
    #[inline(always)]
    fn write(&mut self) {
        // Past the end there is nothing left.
        if let Some(word) = self.out.get_mut(self.word) {
            *word = self.bits as u32;
        }
    }
}

/// Bytes that a field is read from, at any bit: seven bits more than a field has.
const READ_BYTES: usize = 8;
/// The longest series of fields that one read holds, wherever it begins.
const READ_BITS: u32 = 57;

/// The bits from a bit on, at least [`READ_BITS`] of them.
#[inline(always)]
fn bits_at(bytes: &[u8], bit: usize) -> u64 {
    let mut word = [0; READ_BYTES];
    word.copy_from_slice(&bytes[bit / 8..][..READ_BYTES]);
    u64::from_le_bytes(word) >> (bit % 8)
}

#[inline(always)]
fn mask(width: u32) -> u64 {
    (1 << width) - 1
}

/// Bits of a corner of a triangle where they number all vertices of a cluster, which is as good as always.
pub const CORNER_BITS: u32 = 7;
/// Bits of a corner elsewhere.
pub const WIDE_CORNER_BITS: u32 = u8::BITS;

/// Bits of a corner of a triangle in a cluster of so many vertices.
pub fn corner_bits(vertices: usize) -> u32 {
    if vertices <= 1 << CORNER_BITS { CORNER_BITS } else { WIDE_CORNER_BITS }
}

/// Writes triangles of a cluster of so many vertices to the head of words.
pub fn write_triangles(triangles: &[[u8; 3]], vertices: usize, out: &mut [u32]) {
    match corner_bits(vertices) {
        CORNER_BITS => write_corners::<CORNER_BITS>(triangles, out),
        _ => write_corners::<WIDE_CORNER_BITS>(triangles, out),
    }
}

fn write_corners<const BITS: u32>(triangles: &[[u8; 3]], out: &mut [u32]) {
    /// They begin and end with a byte.
    const TOGETHER: usize = 8;
    let four = |four: &[[u8; 3]]| {
        four.iter().rev().fold(0u128, |bits, triangle| {
            let [a, b, c] = triangle.map(u32::from);
            bits << (3 * BITS) | u128::from(a | b << BITS | c << (2 * BITS))
        })
    };
    let (whole, rest) = triangles.as_chunks::<TOGETHER>();
    let mut last = [[0; 3]; TOGETHER];
    last[..rest.len()].copy_from_slice(rest);
    let mut bytes = [0; 3 * (CLUSTER_MAX_TRIANGLES + TOGETHER) + size_of::<u128>()];
    for (number, eight) in whole.iter().chain([&last]).enumerate() {
        let (first, second) = (four(&eight[..4]), four(&eight[4..]));
        let (begun, bits) = (12 * BITS as usize / 8, 12 * BITS % 8);
        let to = &mut bytes[3 * BITS as usize * number..][..begun + size_of::<u128>()];
        to[..size_of::<u128>()].copy_from_slice(&first.to_le_bytes());
        to[begun..].copy_from_slice(&(first >> (8 * begun) | second << bits).to_le_bytes());
    }
    let words = packed_words(triangles.len(), 3 * BITS as usize);
    let out: &mut [u8] = bytemuck::cast_slice_mut(&mut out[..words]);
    out.copy_from_slice(&bytes[..out.len()]);
}

/// Triangles of a cluster.
#[derive(Clone, Copy, Debug)]
pub struct Triangles<'a> {
    /// From the first one on, with at least a word behind the last.
    bytes: &'a [u8],
    count: usize,
    /// Of a corner.
    bits: u32,
}

impl<'a> Triangles<'a> {
    /// So many, of a cluster of so many vertices; `bytes` go on behind them.
    pub(super) fn new(bytes: &'a [u8], count: usize, vertices: usize) -> Self {
        Self { bytes, count, bits: corner_bits(vertices) }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The corners of a triangle, counter-clockwise seen from the front.
    #[inline(always)]
    pub fn get(&self, triangle: usize) -> [u8; 3] {
        let bit = triangle * 3 * self.bits as usize;
        // At most seven bits before it and three bytes of its own: one word, wherever it begins.
        let mut word = [0; size_of::<u32>()];
        word.copy_from_slice(&self.bytes[bit / 8..][..size_of::<u32>()]);
        let corners = u32::from_le_bytes(word) >> (bit % 8);
        if self.bits == CORNER_BITS {
            [0, 1, 2].map(|k| (corners >> (k * CORNER_BITS)) as u8 & ((1 << CORNER_BITS) - 1))
        } else {
            [0, 1, 2].map(|k| (corners >> (k * WIDE_CORNER_BITS)) as u8)
        }
    }

    /// All of them.
    #[inline(always)]
    pub fn iter(self) -> impl ExactSizeIterator<Item = [u8; 3]> + 'a {
        (0..self.count).map(move |triangle| self.get(triangle))
    }

    /// All of them in memory of their own.
    pub fn to_vec(self) -> Vec<[u8; 3]> {
        self.iter().collect()
    }
}

/// Positions of a cluster.
#[derive(Clone, Copy, Debug)]
pub struct Positions<'a> {
    /// From the first one on, with at least [`READ_BYTES`] bytes behind the last.
    bytes: &'a [u8],
    count: usize,
    packing: Packing,
    /// Bits of a position, and where y and z begin in it.
    width: u32,
    starts: [u32; 2],
    masks: [u64; 3],
}

/// Identities of a cluster's vertices.
#[derive(Clone, Copy, Debug)]
pub struct Identities<'a> {
    bytes: &'a [u8],
    count: usize,
    anchor: u32,
    width: u32,
}

impl<'a> Positions<'a> {
    /// Of so many vertices; `bytes` go on behind them.
    pub(super) fn new(bytes: &'a [u8], count: usize, packing: Packing) -> Self {
        let [x, y, z, _] = packing.widths.map(u32::from);
        let (starts, masks) = ([x, x + y], [mask(x), mask(y), mask(z)]);
        Self { bytes, count, packing, width: x + y + z, starts, masks }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// What their numbers count from.
    pub fn packing(&self) -> Packing {
        self.packing
    }

    /// The whole numbers of a vertex.
    #[inline(always)]
    pub fn numbers(&self, vertex: usize) -> [i32; 3] {
        let bit = vertex * self.width as usize;
        let [y, z] = self.starts;
        let bits = bits_at(self.bytes, bit);
        let codes = if self.width <= READ_BITS {
            [bits, bits >> y, bits >> z]
        } else {
            let from = |start: u32| bits_at(self.bytes, bit + start as usize);
            [bits, if z <= READ_BITS { bits >> y } else { from(y) }, from(z)]
        };
        std::array::from_fn(|k| self.packing.anchor[k].wrapping_add((codes[k] & self.masks[k]) as i32))
    }

    /// The position of a vertex, internal units.
    #[inline(always)]
    pub fn get(&self, vertex: usize) -> [f32; 3] {
        self.numbers(vertex).map(|number| coordinate_of(number, self.packing.step))
    }

    /// All of them.
    #[inline(always)]
    pub fn iter(self) -> impl ExactSizeIterator<Item = [f32; 3]> + 'a {
        (0..self.count).map(move |vertex| self.get(vertex))
    }

    /// All of them in memory of their own.
    pub fn to_vec(self) -> Vec<[f32; 3]> {
        self.iter().collect()
    }
}

impl<'a> Identities<'a> {
    pub(super) fn new(bytes: &'a [u8], count: usize, packing: Packing) -> Self {
        let [.., anchor] = packing.anchor;
        let [.., width] = packing.widths;
        Self { bytes, count, anchor: anchor.cast_unsigned(), width: u32::from(width) }
    }

    /// The identity of a vertex.
    #[inline(always)]
    pub fn get(&self, vertex: usize) -> u32 {
        let code = bits_at(self.bytes, vertex * self.width as usize) & mask(self.width);
        self.anchor.wrapping_add(code as u32)
    }

    /// All of them.
    #[inline(always)]
    pub fn iter(self) -> impl ExactSizeIterator<Item = u32> + 'a {
        (0..self.count).map(move |vertex| self.get(vertex))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of which each column takes so many bits.
    fn rows(count: usize, widths: Widths) -> Vec<VertexRow> {
        let mut seed = 7u32;
        let mut random = |width: u8| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            seed.rotate_left(9).checked_shr(32 - u32::from(width)).unwrap_or(0)
        };
        let mut rows: Vec<VertexRow> =
            (0..count).map(|_| widths.map(|w| (random(w).wrapping_sub(1 << 31)).cast_signed())).collect();
        // The least and the largest number there is.
        rows[0] = [i32::MIN; 4];
        rows[count - 1] = widths
            .map(|w| i32::MIN.wrapping_add(u32::MAX.checked_shr(32 - u32::from(w)).unwrap_or(0) as i32));
        rows
    }

    #[test]
    fn rows_are_read_as_they_were_written() {
        for widths in
            [[0, 0, 0, 0], [9, 8, 7, 21], [11, 11, 10, 32], [20, 19, 18, 5], [25, 24, 1, 0], [32; 4]]
        {
            for count in [2, 3, 75, 255] {
                let rows = rows(count, widths);
                let packing = Packing::of(&rows, 0.25);
                assert_eq!(packing.widths, widths);
                let bits = packing.position_bits() as usize;
                let first_id = PACKING_WORDS + packed_words(count, bits);
                let end = first_id + packed_words(count, usize::from(widths[3]));
                let mut out = vec![0; end];
                packing.write(&rows, &mut out);
                assert_eq!(out[..PACKING_WORDS], *bytemuck::cast_slice::<_, u32>(&[packing]));
                // What follows is not read as a part of it.
                out.extend([u32::MAX; 2]);
                let positions = Positions::new(bytemuck::cast_slice(&out[PACKING_WORDS..]), count, packing);
                let ids = Identities::new(bytemuck::cast_slice(&out[first_id..]), count, packing);
                for (v, row) in rows.iter().enumerate() {
                    assert_eq!((positions.numbers(v), ids.get(v)), ([row[0], row[1], row[2]], row[3] as u32));
                }
                assert_eq!((positions.iter().len(), ids.iter().len()), (count, count));
            }
        }
    }

    #[test]
    fn triangles_are_read_as_they_were_written() {
        for vertices in 1..=255usize {
            let corner = |i: usize| ((i * 37 + 11) % vertices) as u8;
            let mut triangles: Vec<[u8; 3]> =
                (0..128).map(|t| [corner(t), corner(t + 5), corner(2 * t)]).collect();
            triangles[127] = [(vertices - 1) as u8; 3];
            for count in [1, 2, 3, 11, 128] {
                let triangles = &triangles[128 - count..];
                let words = packed_words(count, 3 * corner_bits(vertices) as usize);
                assert!(0 < words && words <= (3 * count).div_ceil(4));
                let mut out = vec![u32::MAX; words + 1];
                write_triangles(triangles, vertices, &mut out);
                assert_eq!(out[words], u32::MAX);
                let read = Triangles::new(bytemuck::cast_slice(&out), count, vertices);
                assert_eq!(read.to_vec(), triangles);
            }
        }
    }

    #[test]
    fn numbers_of_floats_are_in_their_order() {
        let values =
            [f32::MIN, -2.5, -1.0, -f32::MIN_POSITIVE, -1.0e-45, -0.0, 0.0, 1.0e-45, 0.1, 3.0, f32::MAX];
        for pair in values.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|x| number_of(x, 0.0));
            assert!(a < b, "{pair:?}");
        }
        for value in values {
            assert_eq!(coordinate_of(number_of(value, 0.0), 0.0).to_bits(), value.to_bits());
        }
        assert_eq!((number_of(-0.375, 0.125), coordinate_of(-3, 0.125)), (-3, -0.375));
    }
}
