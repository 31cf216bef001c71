//! PLY: a header that declares elements and their properties, then the rows of each, as text or as bytes.

use super::text::{Text, number, short, whole};
use super::{fault, name};
use crate::error::{Error, Result};

/// All that a file holds.
#[derive(Debug, Default)]
pub struct Ply {
    /// `ascii`, `binary_little_endian` or `binary_big_endian`.
    pub format: String,
    /// Comments of the header, of unknown encoding.
    pub comments: Vec<Vec<u8>>,
    /// Elements in the order of the file.
    pub elements: Vec<Element>,
    /// Bytes behind the last row.
    pub behind: usize,
}

/// Rows of one kind.
#[derive(Debug)]
pub struct Element {
    /// Such as `vertex`.
    pub name: String,
    /// How many.
    pub rows: usize,
    /// Columns in the order of the file.
    pub properties: Vec<Property>,
}

/// A column.
#[derive(Debug)]
pub struct Property {
    /// Such as `x`.
    pub name: String,
    /// One for each row; of a list those of all rows, one row after the other.
    pub values: Values,
    /// Of a list, how many values each row has.
    pub lengths: Option<Vec<u32>>,
    count_type: Type,
}

macro_rules! types {
    ($($type:ident $rust:ty, $($names:literal)|+;)*) => {
        /// A type of the header.
        #[derive(Clone, Copy, Debug, PartialEq)]
        enum Type { $($type,)* }

        /// The values of a column in their type.
        #[derive(Debug)]
        #[allow(missing_docs)]
        pub enum Values { $($type(Vec<$rust>),)* }

        impl Type {
            fn named(word: &[u8]) -> Option<Self> {
                match word { $($($names)|+ => Some(Self::$type),)* _ => None }
            }

            fn size(self) -> usize {
                match self { $(Self::$type => size_of::<$rust>(),)* }
            }

            fn empty(self) -> Values {
                match self { $(Self::$type => Values::$type(Vec::new()),)* }
            }

            /// A value by itself.
            fn read(self, bytes: &[u8], big: bool) -> f64 {
                match self { $(Self::$type => {
                    let bytes = bytes.try_into().unwrap_or_default();
                    (if big { <$rust>::from_be_bytes(bytes) } else { <$rust>::from_le_bytes(bytes) }) as f64
                })* }
            }

            /// The length of a list, or what cannot be one.
            fn length(self, bytes: &[u8], big: bool) -> std::result::Result<usize, f64> {
                let count = self.read(bytes, big);
                let fits = count.fract() == 0.0 && (0.0..4e9).contains(&count);
                if fits { Ok(count as usize) } else { Err(count) }
            }
        }

        impl Values {
            fn reserve(&mut self, more: usize) {
                match self { $(Self::$type(v) => v.reserve(more),)* }
            }

            /// Appends `count` values from the beginning of each `stride` bytes.
            fn extend(&mut self, bytes: &[u8], stride: usize, count: usize, big: bool) {
                match self { $(Self::$type(v) => {
                    const SIZE: usize = size_of::<$rust>();
                    let value = |bytes: &[u8; SIZE]| {
                        if big { <$rust>::from_be_bytes(*bytes) } else { <$rust>::from_le_bytes(*bytes) }
                    };
                    for row in bytes.chunks(stride.max(1)) {
                        v.extend(row[..count * SIZE].as_chunks().0.iter().map(value));
                    }
                })* }
            }
        }
    };
}

types! {
    I8 i8, b"char" | b"int8";
    U8 u8, b"uchar" | b"uint8";
    I16 i16, b"short" | b"int16";
    U16 u16, b"ushort" | b"uint16";
    I32 i32, b"int" | b"int32";
    U32 u32, b"uint" | b"uint32";
    I64 i64, b"long" | b"int64";
    U64 u64, b"ulong" | b"uint64";
    F32 f32, b"float" | b"float32";
    F64 f64, b"double" | b"float64";
}

impl Values {
    /// Appends a word of an ASCII file; false where it is no such value.
    fn push(&mut self, word: &[u8]) -> bool {
        // Whole numbers may be written as 3.0.
        let integer = || {
            let wide = |v: f64| (v.fract() == 0.0 && v.abs() < 9e15).then_some(v as i64);
            whole(word).map_or_else(|| number(word).and_then(wide), Some)
        };
        macro_rules! integers {
            ($v:ident) => {
                integer().and_then(|i| i.try_into().ok()).map(|i| $v.push(i)).is_some()
            };
        }
        match self {
            Self::I8(v) => integers!(v),
            Self::U8(v) => integers!(v),
            Self::I16(v) => integers!(v),
            Self::U16(v) => integers!(v),
            Self::I32(v) => integers!(v),
            Self::U32(v) => integers!(v),
            Self::I64(v) => integers!(v),
            Self::U64(v) => integers!(v),
            Self::F32(v) => number(word).map(|f| v.push(f as f32)).is_some(),
            Self::F64(v) => number(word).map(|f| v.push(f)).is_some(),
        }
    }
}

/// Reads a file.
pub fn read(data: &[u8]) -> Result<Ply> {
    let (mut ply, body) = header(data)?;
    ply.behind = match ply.format.as_str() {
        "ascii" => ascii(&mut ply.elements, Text::new(data, false, false).from(body))?,
        format => binary(&mut ply.elements, data, body, format == "binary_big_endian")?,
    };
    Ok(ply)
}

/// What the header declares, and where the rows begin.
fn header(data: &[u8]) -> Result<(Ply, usize)> {
    if !data.starts_with(b"ply") || !matches!(data.get(3), Some(b'\r' | b'\n' | b' ' | b'\t')) {
        return Err(fault("line 1", format!("expected \"ply\", found {:?}", short(first_line(data)))));
    }
    // A carriage return alone ends lines where the first line ends so: else what follows the header could be taken
    // for the second half of its end.
    let end = first_line(data).len();
    let ending =
        if data.get(end) == Some(&b'\r') && data.get(end + 1) != Some(&b'\n') { b'\r' } else { b'\n' };
    let (mut ply, mut at, mut number) = (Ply::default(), 0, 0);
    loop {
        number += 1;
        let place = format!("line {number}");
        let Some(length) = data[at..].iter().position(|b| *b == ending) else {
            return Err(fault(place, "the file ends before end_header"));
        };
        let line = data[at..at + length].trim_ascii();
        at += length + 1;
        let mut words = line.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty());
        match words.next() {
            _ if number == 1 => {}
            None => {}
            Some(b"comment" | b"obj_info") => ply.comments.push(line.to_vec()),
            Some(b"format") => {
                ply.format = name(words.next().unwrap_or_default());
                if !matches!(&*ply.format, "ascii" | "binary_little_endian" | "binary_big_endian") {
                    return Err(fault(place, format!("{:?} is no format of PLY", ply.format)));
                }
            }
            Some(b"element") => {
                let (element, count) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
                let rows = whole(count).and_then(|c| usize::try_from(c).ok()).ok_or_else(|| {
                    fault(&*place, format!("expected a number of rows, found {:?}", short(count)))
                })?;
                ply.elements.push(Element { name: name(element), rows, properties: Vec::new() });
            }
            Some(b"property") => {
                let element =
                    ply.elements.last_mut().ok_or_else(|| fault(&*place, "a property before any element"))?;
                let property = property(words, &place)?;
                if element.properties.iter().any(|p| p.name == property.name) {
                    return Err(fault(
                        place,
                        format!("element {} has two of {}", element.name, property.name),
                    ));
                }
                element.properties.push(property);
            }
            Some(b"end_header") => break,
            Some(word) => return Err(fault(place, format!("{:?} is no word of a header", short(word)))),
        }
    }
    if ply.format.is_empty() {
        return Err(fault(format!("line {number}"), "the header has no format"));
    }
    Ok((ply, at))
}

fn first_line(data: &[u8]) -> &[u8] {
    let end = data.iter().position(|b| matches!(b, b'\r' | b'\n')).unwrap_or(data.len());
    &data[..end]
}

fn property<'a>(mut words: impl Iterator<Item = &'a [u8]>, place: &str) -> Result<Property> {
    let typed = |word: Option<&[u8]>| {
        let word = word.unwrap_or_default();
        Type::named(&word.to_ascii_lowercase())
            .ok_or_else(|| fault(place, format!("{:?} is no type of PLY", short(word))))
    };
    let first = words.next();
    let list = first == Some(b"list");
    let count_type = if list { typed(words.next())? } else { Type::U8 };
    let own = typed(if list { words.next() } else { first })?;
    let label = words.next().ok_or_else(|| fault(place, "the property has no name"))?;
    let lengths = list.then(Vec::new);
    Ok(Property { name: name(label), values: own.empty(), lengths, count_type })
}

impl Property {
    fn value_type(&self) -> Type {
        match self.values {
            Values::I8(_) => Type::I8,
            Values::U8(_) => Type::U8,
            Values::I16(_) => Type::I16,
            Values::U16(_) => Type::U16,
            Values::I32(_) => Type::I32,
            Values::U32(_) => Type::U32,
            Values::I64(_) => Type::I64,
            Values::U64(_) => Type::U64,
            Values::F32(_) => Type::F32,
            Values::F64(_) => Type::F64,
        }
    }

    /// The fewest bytes that a row of it takes.
    fn least(&self) -> usize {
        if self.lengths.is_some() { self.count_type.size() } else { self.value_type().size() }
    }
}

// --------------------------------------------------------------------------------------------------------- text

fn ascii(elements: &mut [Element], mut text: Text<'_>) -> Result<usize> {
    for element in elements {
        let width = element.properties.len();
        if width == 0 {
            continue;
        }
        for row in 0..element.rows {
            for k in 0..width {
                let property = &mut element.properties[k];
                let count = match &mut property.lengths {
                    None => 1,
                    Some(lengths) => {
                        let word = text.word_below().unwrap_or_default();
                        let count = number(word).filter(|c| c.fract() == 0.0 && (0.0..4e9).contains(c));
                        let Some(count) = count else {
                            return Err(in_text(&text, element, row, k, word, "a length"));
                        };
                        lengths.push(count as u32);
                        count as usize
                    }
                };
                for _ in 0..count {
                    let word = text.word_below().unwrap_or_default();
                    if !element.properties[k].values.push(word) {
                        let kind = format!("{:?}", element.properties[k].value_type()).to_lowercase();
                        return Err(in_text(&text, element, row, k, word, &kind));
                    }
                }
            }
            if !text.line_ends() {
                let at = text.offset();
                let (kind, word) = (&element.name, short(text.word()));
                return Err(
                    text.fault(at, format!("element {kind}, row {row}: {word:?} is one value too many"))
                );
            }
        }
    }
    let mut behind = 0;
    while text.word_below().is_some() {
        behind += 1;
    }
    Ok(behind)
}

fn in_text(text: &Text<'_>, element: &Element, row: usize, k: usize, word: &[u8], kind: &str) -> Error {
    let place = format!("{}, property {}", in_row(element, row), element.properties[k].name);
    text.expected(word, &format!("{kind} of {place}"))
}

/// The name of a row for errors.
fn in_row(element: &Element, row: usize) -> String {
    format!("element {}, row {row} of {}", element.name, element.rows)
}

// -------------------------------------------------------------------------------------------------------- bytes

fn binary(elements: &mut [Element], data: &[u8], mut at: usize, big: bool) -> Result<usize> {
    for element in elements {
        let least: usize = element.properties.iter().map(Property::least).sum();
        if least == 0 {
            continue;
        }
        at = if element.properties.iter().all(|p| p.lengths.is_none()) {
            fixed_rows(element, data, at, least, big)?
        } else {
            rows_with_lists(element, data, at, least, big)?
        };
    }
    Ok(data.len() - at)
}

fn cut_off(element: &Element, row: usize, at: usize, needed: usize, data: &[u8]) -> Error {
    let message = format!("expected {needed} more bytes, but the file ends at byte {}", data.len());
    fault(format!("byte {at}: {}", in_row(element, row)), message)
}

fn fixed_rows(element: &mut Element, data: &[u8], at: usize, stride: usize, big: bool) -> Result<usize> {
    let whole_rows = (data.len() - at) / stride;
    if whole_rows < element.rows {
        return Err(cut_off(element, whole_rows, at + whole_rows * stride, stride, data));
    }
    let end = at + element.rows * stride;
    let mut first = at;
    for property in &mut element.properties {
        property.values.reserve(element.rows);
        let size = property.value_type().size();
        if element.rows > 0 {
            // From its value in the first row to that in the last.
            property.values.extend(&data[first..end - stride + (first - at) + size], stride, 1, big);
        }
        first += size;
    }
    Ok(end)
}

/// Reads rows whose lists are all as long as those of the first, as triangles are; nothing where any differs.
fn equal_rows(element: &mut Element, data: &[u8], at: usize, big: bool) -> Option<usize> {
    // For each property where its values begin in a row, and how many there are.
    let (mut places, mut stride) = (Vec::new(), 0usize);
    for property in &element.properties {
        let mut count = 1;
        if property.lengths.is_some() {
            let size = property.count_type.size();
            count = property.count_type.length(data.get(at + stride..at + stride + size)?, big).ok()?;
            stride += size;
        }
        places.push((stride, count));
        stride = stride.checked_add(count.checked_mul(property.value_type().size())?)?;
        // So that what follows is in the file, and no sum too large.
        data.get(at..at.checked_add(stride)?)?;
    }
    let end = at.checked_add(element.rows.checked_mul(stride)?)?;
    let rows = data.get(at..end)?;
    for (property, (place, _)) in element.properties.iter().zip(&places) {
        if property.lengths.is_some() {
            let count = place - property.count_type.size()..*place;
            let first = &rows.get(..stride)?[count.clone()];
            if !rows.chunks_exact(stride).all(|row| row[count.clone()] == *first) {
                return None;
            }
        }
    }
    for (property, (place, count)) in element.properties.iter_mut().zip(places) {
        property.values.reserve(element.rows * count);
        property.values.extend(rows.get(place..)?, stride, count, big);
        if let Some(lengths) = &mut property.lengths {
            lengths.resize(element.rows, count as u32);
        }
    }
    Some(end)
}

fn rows_with_lists(
    element: &mut Element,
    data: &[u8],
    mut at: usize,
    least: usize,
    big: bool,
) -> Result<usize> {
    if let Some(end) = equal_rows(element, data, at, big) {
        return Ok(end);
    }
    let likely = element.rows.min((data.len() - at) / least);
    for property in &mut element.properties {
        let own = property.value_type().size();
        match &mut property.lengths {
            None => property.values.reserve(likely),
            Some(lengths) => {
                lengths.reserve(likely);
                property.values.reserve((3 * likely).min((data.len() - at) / own));
            }
        }
    }
    for row in 0..element.rows {
        for k in 0..element.properties.len() {
            let property = &mut element.properties[k];
            let own = property.value_type().size();
            let bytes = match &mut property.lengths {
                None => own,
                Some(lengths) => {
                    let size = property.count_type.size();
                    let Some(bytes) = data.get(at..at + size) else {
                        return Err(cut_off(element, row, at, size, data));
                    };
                    let count = match property.count_type.length(bytes, big) {
                        Ok(count) => count,
                        Err(count) => {
                            let place = format!("byte {at}: {}", in_row(element, row));
                            let name = &element.properties[k].name;
                            return Err(fault(place, format!("the list {name} cannot have {count} values")));
                        }
                    };
                    lengths.push(count as u32);
                    at += size;
                    count * own
                }
            };
            let Some(values) = data.get(at..at.saturating_add(bytes)) else {
                return Err(cut_off(element, row, at, bytes, data));
            };
            property.values.extend(values, bytes, bytes / own, big);
            at += bytes;
        }
    }
    Ok(at)
}

/// Rows that are whole in a part of a file.
#[derive(Debug, PartialEq)]
pub struct WholeRows {
    /// How many.
    pub rows: usize,
    /// The bytes that they take behind the header.
    pub bytes: usize,
    /// Whether a row is cut off behind them. What cannot be a row is left to [`read`], which says why.
    pub cut_off: bool,
}

/// Looks for whole rows of the only element that the header declares, of bytes.
pub fn whole_rows(data: &[u8]) -> Result<WholeRows> {
    let (ply, body) = header(data)?;
    let big = ply.format == "binary_big_endian";
    let mut end = body;
    let whole = |rows, end: usize, cut_off| Ok(WholeRows { rows, bytes: end - body, cut_off });
    let Some(element) = ply.elements.first() else {
        return whole(0, end, false);
    };
    for row in 0..element.rows {
        let mut at = end;
        for property in &element.properties {
            let mut count = 1;
            if property.lengths.is_some() {
                let begin = at;
                at = at.saturating_add(property.count_type.size());
                let Some(bytes) = data.get(begin..at) else {
                    return whole(row, end, true);
                };
                match property.count_type.length(bytes, big) {
                    Ok(found) => count = found,
                    Err(_) => return whole(row, end, false),
                }
            }
            at = at.saturating_add(count.saturating_mul(property.value_type().size()));
        }
        if at > data.len() {
            return whole(row, end, true);
        }
        end = at;
    }
    whole(element.rows, end, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "ply\nformat {} 1.0\ncomment a\nelement face 2\nproperty list uchar int vertex_indices\n\
        property short flag\nelement vertex 2\nproperty float x\nproperty double y\nend_header\n";

    fn bytes(big: bool) -> Vec<u8> {
        let mut out =
            HEAD.replace("{}", if big { "binary_big_endian" } else { "binary_little_endian" }).into_bytes();
        let mut put = |little: &[u8]| {
            if big { out.extend(little.iter().rev()) } else { out.extend(little) }
        };
        for (row, flag) in [(&[0i32, 1, 2][..], -1i16), (&[3, 2, 1, 0], 300)] {
            put(&[row.len() as u8]);
            row.iter().for_each(|i| put(&i.to_le_bytes()));
            put(&flag.to_le_bytes());
        }
        for (x, y) in [(0.5f32, 1e-300f64), (-1.0, 2.0)] {
            put(&x.to_le_bytes());
            put(&y.to_le_bytes());
        }
        out
    }

    fn check(ply: &Ply) {
        let [faces, vertices] = &ply.elements[..] else { panic!("{ply:?}") };
        assert_eq!((faces.rows, vertices.rows), (2, 2));
        assert_eq!(faces.properties[0].lengths.as_deref(), Some(&[3, 4][..]));
        assert!(matches!(&faces.properties[0].values, Values::I32(v) if v[..] == [0, 1, 2, 3, 2, 1, 0]));
        assert!(matches!(&faces.properties[1].values, Values::I16(v) if v[..] == [-1, 300]));
        assert!(matches!(&vertices.properties[0].values, Values::F32(v) if v[..] == [0.5, -1.0]));
        assert!(matches!(&vertices.properties[1].values, Values::F64(v) if v[..] == [1e-300, 2.0]));
        assert_eq!((ply.comments.len(), ply.behind), (1, 0));
    }

    #[test]
    fn all_formats_and_line_ends() {
        check(&read(&bytes(false)).unwrap());
        check(&read(&bytes(true)).unwrap());
        let text = HEAD.replace("{}", "ascii") + "3 0 1 2 -1\n4 3 2 1\n 0 300.0\n\n0.5 1e-300\n-1 2";
        for end in ["\n", "\r\n", "\r"] {
            check(&read(text.replace('\n', end).as_bytes()).unwrap());
        }
        // A header of old line ends before bytes that look like the other half of a new one.
        let head = "ply\rformat binary_little_endian 1.0\relement vertex 1\rproperty uchar x\rend_header\r\n";
        let ply = read(head.as_bytes()).unwrap();
        assert!(matches!(&ply.elements[0].properties[0].values, Values::U8(v) if v[..] == [10]));
    }

    #[test]
    fn every_cut_says_where() {
        let whole = bytes(false);
        let body = whole.len() - (24 + 1 + 12 + 2 + 1 + 16 + 2);
        for length in 0..whole.len() {
            let error = read(&whole[..length]).unwrap_err().to_string();
            assert!(length < body || error.contains(&format!("ends at byte {length}")), "{length}: {error}");
            assert!(length < body || error.contains("of 2: "), "{error}");
        }
    }

    #[test]
    fn whole_rows_end_at_every_cut() {
        let head = "ply\nformat binary_big_endian 1.0\nelement face 9\nproperty list uchar short i\n\
            property uchar flag\nend_header\n";
        let ends = [0, 8, 10, 20];
        let body = b"\x03\0\0\0\x01\0\x02\x07\0\x08\x04\0\0\0\x01\0\x02\0\x03\x09";
        for length in 0..=body.len() {
            let found = whole_rows(&[head.as_bytes(), &body[..length]].concat()).unwrap();
            let rows = ends.iter().rposition(|end| *end <= length).unwrap();
            assert_eq!(found, WholeRows { rows, bytes: ends[rows], cut_off: true });
        }
        let all = whole_rows(&[head.replace('9', "3").as_bytes(), &body[..], b"more"].concat()).unwrap();
        assert_eq!(all, WholeRows { rows: 3, bytes: 20, cut_off: false });
        // What is no length is left to the reader.
        let signed = [head.replace("list uchar", "list char").as_bytes(), b"\0\x01\xff\0\0"].concat();
        assert_eq!(whole_rows(&signed).unwrap(), WholeRows { rows: 1, bytes: 2, cut_off: false });
    }

    #[test]
    fn a_promise_takes_no_memory() {
        let head =
            "ply\nformat {} 1.0\nelement vertex 999999999999999\nproperty list uchar int i\nend_header\n\0\0";
        for format in ["ascii", "binary_little_endian"] {
            read(head.replace("{}", format).as_bytes()).unwrap_err();
        }
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty uchar x\nend_header\n";
        for (row, what) in
            [("256", "expected u8"), ("-1", "expected u8"), ("0.5", "u8"), ("1 2", "one value too many")]
        {
            let error = read(format!("{text}{row}\n").as_bytes()).unwrap_err().to_string();
            assert!(error.contains("line 6") && error.contains(what) && error.contains("row 0"), "{error}");
        }
    }
}
