//! STL: bytes, or text between `solid` and `endsolid`. Which of them is told by size: binary files may begin with
//! "solid" too.

use super::polygon::Clipper;
use super::text::{Text, decoded, number};
use super::{fault, name};
use crate::error::Result;

/// All that a file holds. Normals of facets follow from their corners and are left out.
#[derive(Debug, Default)]
pub struct Stl {
    /// Three for each triangle.
    pub corners: Vec<[f64; 3]>,
    /// Of binary files, the number that each triangle has.
    pub attributes: Option<Vec<u16>>,
    /// Of binary files, their first bytes.
    pub header: Vec<u8>,
    /// Names, and the first triangle of each.
    pub solids: Vec<(String, usize)>,
    /// Bytes behind the last triangle.
    pub behind: usize,
}

const HEADER: usize = 80;
const RECORD: usize = 50;

/// Reads a file.
pub fn read(data: &[u8]) -> Result<Stl> {
    let count = data.get(HEADER..HEADER + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let exact = count.is_some_and(|c| data.len() == HEADER + 4 + c * RECORD);
    // Binary files of fewer than 2^24 triangles have a zero in their first 84 bytes, texts have none.
    if !exact {
        let text = decoded(data);
        let zero = text.iter().take(HEADER + 4).any(|b| *b == 0);
        let start = text.trim_ascii_start().get(..5);
        if !zero && start.is_some_and(|w| w.eq_ignore_ascii_case(b"solid")) {
            return ascii(&text);
        }
    }
    match count {
        Some(count) => binary(data, count),
        None => Err(fault("byte 0", "neither \"solid\" nor the 84 bytes that a binary STL begins with")),
    }
}

fn binary(data: &[u8], count: usize) -> Result<Stl> {
    let body = &data[HEADER + 4..];
    if body.len() / RECORD < count {
        let there = body.len() / RECORD;
        let place = format!("byte {}", data.len());
        return Err(fault(
            place,
            format!("the file ends after {there} of the {count} triangles that it promises"),
        ));
    }
    let (rows, behind) = body.split_at(count * RECORD);
    let mut out = Stl {
        corners: Vec::with_capacity(3 * count),
        header: data[..HEADER].to_vec(),
        behind: behind.len(),
        ..Stl::default()
    };
    let mut attributes = Vec::with_capacity(count);
    for row in rows.chunks_exact(RECORD) {
        let value = |k: usize| f64::from(f32::from_le_bytes([row[k], row[k + 1], row[k + 2], row[k + 3]]));
        out.corners.extend([12, 24, 36].map(|k| [value(k), value(k + 4), value(k + 8)]));
        attributes.push(u16::from_le_bytes([row[48], row[49]]));
    }
    out.attributes = Some(attributes);
    Ok(out)
}

fn ascii(data: &[u8]) -> Result<Stl> {
    let mut out = Stl::default();
    let mut text = Text::new(data, false, false);
    let (mut clipper, mut corners) = (Clipper::default(), Vec::new());
    let mut open = false;
    while let Some(word) = text.word_below() {
        match &*word.to_ascii_lowercase() {
            b"solid" => {
                out.solids.push((name(&text.rest()), out.corners.len() / 3));
                open = true;
            }
            b"endsolid" if open => {
                text.rest();
                open = false;
            }
            b"facet" if open => {
                facet(&mut text, &mut corners).map_err(|error| {
                    let facet = out.corners.len() / 3;
                    match error {
                        crate::Error::Source { place, message } => {
                            fault(format!("{place}: facet {facet}"), message)
                        }
                        other => other,
                    }
                })?;
                clipper.polygon(
                    corners.len(),
                    |k| corners[k],
                    |t| {
                        out.corners.extend(t.map(|k| corners[k as usize]));
                    },
                );
            }
            _ => return Err(text.expected(word, if open { "facet or endsolid" } else { "solid" })),
        }
    }
    if open {
        let facets = out.corners.len() / 3;
        let message = format!("the file ends after {facets} facets, without endsolid");
        return Err(text.fault(data.len(), message));
    }
    Ok(out)
}

/// The corners of a facet, whose first word is read.
fn facet(text: &mut Text<'_>, corners: &mut Vec<[f64; 3]>) -> Result<()> {
    corners.clear();
    // Its normal, whatever is written there: programs write "nan" and worse.
    let mut word = text.word_below().unwrap_or_default();
    for _ in 0..8 {
        if word.is_empty() || word.eq_ignore_ascii_case(b"outer") {
            break;
        }
        word = text.word_below().unwrap_or_default();
    }
    if !word.eq_ignore_ascii_case(b"outer") {
        return Err(text.expected(word, "outer loop"));
    }
    let mut next = |expected: &[u8], what: &str| {
        let word = text.word_below().unwrap_or_default();
        if word.eq_ignore_ascii_case(expected) { Ok(()) } else { Err(text.expected(word, what)) }
    };
    next(b"loop", "outer loop")?;
    loop {
        let word = text.word_below().unwrap_or_default();
        if word.eq_ignore_ascii_case(b"endloop") {
            break;
        }
        if !word.eq_ignore_ascii_case(b"vertex") {
            return Err(text.expected(word, "vertex or endloop"));
        }
        let mut corner = [0.0; 3];
        for value in &mut corner {
            let word = text.word_below().unwrap_or_default();
            *value = number(word).ok_or_else(|| text.expected(word, "a coordinate"))?;
        }
        corners.push(corner);
    }
    let word = text.word_below().unwrap_or_default();
    if !word.eq_ignore_ascii_case(b"endfacet") {
        return Err(text.expected(word, "endfacet"));
    }
    if corners.len() < 3 {
        return Err(text.fault(text.offset(), format!("a loop of {} corners", corners.len())));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(in crate::read) fn binary_file(head: &[u8], count: u32, tail: &[u8]) -> Vec<u8> {
        let mut out = head.to_vec();
        out.resize(HEADER, b' ');
        out.extend(count.to_le_bytes());
        for k in 0..count {
            let numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, k as f32, 0.0, 1.0, 0.0f32];
            out.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
            out.extend((k as u16).to_le_bytes());
        }
        out.extend(tail);
        out
    }

    const TEXT: &str = "SOLID a thing\n facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e0 0\n\
        endloop\nendfacet\nendsolid a thing\n solid\nendsolid\n";

    #[test]
    fn size_tells_what_a_file_is() {
        for head in [&b"solid of bytes"[..], b"\n", b"solid facet normal"] {
            let found = read(&binary_file(head, 3, b"")).unwrap();
            assert_eq!((found.corners.len(), found.behind), (9, 0));
            assert_eq!(found.attributes.as_deref(), Some(&[0, 1, 2][..]));
            assert_eq!(read(&binary_file(head, 3, b"more")).unwrap().behind, 4);
            let whole = binary_file(head, 3, b"");
            let error = read(&whole[..whole.len() - 60]).unwrap_err().to_string();
            assert!(error.contains("after 1 of the 3 triangles"), "{error}");
        }
        for end in ["\n", "\r\n", "\r"] {
            let found = read(TEXT.replace('\n', end).as_bytes()).unwrap();
            assert_eq!(found.corners, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
            assert_eq!(found.solids, [("a thing".to_owned(), 0), (String::new(), 1)]);
        }
    }

    #[test]
    fn texts_that_end_early_say_where() {
        let one = &TEXT[..TEXT.find("endsolid").unwrap()];
        for (length, _) in one.char_indices().skip(6) {
            let error = read(&one.as_bytes()[..length]).unwrap_err().to_string();
            assert!(error.contains("line "), "{length}: {error}");
        }
        let error = read(TEXT.replace("1e0", "1,0").as_bytes()).unwrap_err().to_string();
        assert!(error.contains("line 6: facet 0: expected a coordinate, found \"1,0\""), "{error}");
    }
}
