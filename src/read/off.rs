//! OFF of Geomview: counts, vertices with what the keyword in front says they carry, polygons with or without colours.

use super::text::{Text, decoded, number, short, whole};
use crate::error::Result;

/// All that a file holds.
#[derive(Debug, Default)]
pub struct Off {
    /// Positions.
    pub positions: Vec<[f64; 3]>,
    /// One for each vertex, if the keyword has N.
    pub normals: Option<Vec<[f32; 3]>>,
    /// RGBA from 0 to 1 for each vertex, if the keyword has C.
    pub colors: Option<Vec<[f32; 4]>>,
    /// One for each vertex, if the keyword has ST.
    pub uvs: Option<Vec<[f32; 2]>>,
    /// Vertices of all polygons.
    pub corners: Vec<u32>,
    /// Corners of each polygon.
    pub counts: Vec<u32>,
    /// RGBA from 0 to 1 for each polygon, if any has a colour; white for the others.
    pub face_colors: Option<Vec<[f32; 4]>>,
    /// Vertices with more numbers than the keyword says.
    pub more: usize,
    /// Polygons whose colour is a number of a table, which the file does not hold.
    pub by_table: usize,
    /// Words behind the last polygon.
    pub behind: usize,
    /// Whether colours of vertices, and of faces, have fractions.
    fractions: [bool; 2],
}

/// What vertices carry.
#[derive(Default)]
struct Carried {
    uvs: bool,
    colors: bool,
    normals: bool,
}

/// What no colour is given for is white.
const NONE: [f32; 4] = [f32::NAN; 4];

/// Reads a file.
pub fn read(data: &[u8]) -> Result<Off> {
    let data = &*decoded(data);
    let mut text = Text::new(data, true, false);
    let carried = keyword(&mut text)?;
    let [vertices, faces] = counts(&mut text)?;
    let mut out = Off {
        normals: carried.normals.then(Vec::new),
        colors: carried.colors.then(Vec::new),
        uvs: carried.uvs.then(Vec::new),
        ..Off::default()
    };
    // Every number takes two bytes.
    out.positions.reserve(vertices.min(data.len() / 6));
    out.counts.reserve(faces.min(data.len() / 2));
    for vertex in 0..vertices {
        let what = || format!("vertex {vertex} of {vertices}");
        read_vertex(&mut text, &mut out, &carried, &what)?;
    }
    for face in 0..faces {
        let what = || format!("face {face} of {faces}");
        read_face(&mut text, &mut out, &what)?;
    }
    let [of_vertices, of_faces] = out.fractions;
    scaled(out.colors.as_deref_mut().unwrap_or_default(), of_vertices);
    scaled(out.face_colors.as_deref_mut().unwrap_or_default(), of_faces);
    while text.word_below().is_some() {
        out.behind += 1;
    }
    Ok(out)
}

/// Reads the keyword. Geomview lets it be left out.
fn keyword(text: &mut Text<'_>) -> Result<Carried> {
    let mut ahead = text.clone();
    let word = ahead.word_below().unwrap_or_default();
    if whole(word).is_some() {
        return Ok(Carried::default());
    }
    *text = ahead;
    let Some(mut rest) = word.strip_suffix(b"OFF") else {
        return Err(text.expected(word, "OFF"));
    };
    let mut carried = Carried::default();
    loop {
        rest = match rest {
            [] => break,
            [b'S', b'T', rest @ ..] => {
                carried.uvs = true;
                rest
            }
            [b'C', rest @ ..] => {
                carried.colors = true;
                rest
            }
            [b'N', rest @ ..] => {
                carried.normals = true;
                rest
            }
            [b'4' | b'n', ..] => {
                let message = format!("{} has vertices of other than three dimensions", short(word));
                return Err(text.fault(text.offset(), message));
            }
            _ => return Err(text.expected(word, "OFF")),
        };
    }
    let mut ahead = text.clone();
    if ahead.word().eq_ignore_ascii_case(b"BINARY") {
        return Err(text.fault(text.offset(), "binary OFF is not read, only text"));
    }
    Ok(carried)
}

/// Reads the numbers of vertices and faces; that of edges may be missing and means nothing.
fn counts(text: &mut Text<'_>) -> Result<[usize; 2]> {
    let mut out = [0; 2];
    for (count, what) in out.iter_mut().zip(["the number of vertices", "the number of faces"]) {
        let word = text.word_below().unwrap_or_default();
        let found = whole(word).and_then(|c| usize::try_from(c).ok());
        *count = found.ok_or_else(|| text.expected(word, what))?;
    }
    if !text.line_ends() {
        text.number("the number of edges")?;
    }
    if !text.line_ends() {
        let word = text.word();
        return Err(text.expected(word, "the end of the line of counts"));
    }
    Ok(out)
}

fn next_number(text: &mut Text<'_>, what: &dyn Fn() -> String) -> Result<f64> {
    let word = text.word_below().unwrap_or_default();
    number(word).ok_or_else(|| text.expected(word, &format!("a number of {}", what())))
}

fn read_vertex(
    text: &mut Text<'_>,
    out: &mut Off,
    carried: &Carried,
    what: &dyn Fn() -> String,
) -> Result<()> {
    let mut position = [0.0; 3];
    for value in &mut position {
        *value = next_number(text, what)?;
    }
    out.positions.push(position);
    let mut row = [0.0f64; 9];
    let mut words = 0;
    let least = [(carried.normals, 3), (carried.colors, 3), (carried.uvs, 2)];
    let least: usize = least.iter().filter(|(has, _)| *has).map(|(_, count)| count).sum();
    let colors_at = if carried.normals { 3 } else { 0 };
    while !text.line_ends() && words < row.len() {
        let word = text.word();
        row[words] = number(word).ok_or_else(|| text.expected(word, &format!("a number of {}", what())))?;
        // The first three of a colour: which of the last ones is an alpha is not known yet.
        if carried.colors && (colors_at..colors_at + 3).contains(&words) {
            out.fractions[0] |= whole(word).is_none();
        }
        words += 1;
    }
    if words < least {
        return Err(text.expected(&[], &format!("{least} numbers behind the coordinates of {}", what())));
    }
    let mut rest = &row[..words];
    let mut take = |count: usize| {
        let (own, others) = rest.split_at(count);
        rest = others;
        own
    };
    if let Some(normals) = &mut out.normals {
        let n = take(3);
        normals.push([n[0] as f32, n[1] as f32, n[2] as f32]);
    }
    if let Some(colors) = &mut out.colors {
        // Three numbers or, as it is defined, four.
        colors.push(color(take(if words > least { 4 } else { 3 })));
    }
    if let Some(uvs) = &mut out.uvs {
        let t = take(2);
        uvs.push([t[0] as f32, t[1] as f32]);
    }
    out.more += usize::from(!rest.is_empty() || !text.line_ends());
    text.next_line();
    Ok(())
}

fn read_face(text: &mut Text<'_>, out: &mut Off, what: &dyn Fn() -> String) -> Result<()> {
    let word = text.word_below().unwrap_or_default();
    let count = whole(word).and_then(|c| u32::try_from(c).ok());
    let count = count.ok_or_else(|| text.expected(word, &format!("the number of corners of {}", what())))?;
    for _ in 0..count {
        let word = text.word_below().unwrap_or_default();
        let corner = whole(word).and_then(|c| u32::try_from(c).ok());
        let corner = corner.ok_or_else(|| text.expected(word, &format!("a vertex of {}", what())))?;
        if corner as usize >= out.positions.len() {
            let message = format!("{}: there is no vertex {corner}, only {}", what(), out.positions.len());
            return Err(text.fault(text.offset(), message));
        }
        out.corners.push(corner);
    }
    out.counts.push(count);
    let (mut row, mut words) = ([0.0f64; 4], 0);
    while !text.line_ends() && words < row.len() {
        let word = text.word();
        row[words] = number(word).ok_or_else(|| text.expected(word, &format!("the colour of {}", what())))?;
        out.fractions[1] |= whole(word).is_none();
        words += 1;
    }
    match words {
        3 | 4 => {
            let colors = out.face_colors.get_or_insert_default();
            colors.resize(out.counts.len() - 1, NONE);
            colors.push(color(&row[..words]));
        }
        0 => {}
        _ => out.by_table += 1,
    }
    if let Some(colors) = &mut out.face_colors {
        colors.resize(out.counts.len(), NONE);
    }
    text.next_line();
    Ok(())
}

/// Three or four numbers as they stand; without a fourth, alpha is left open.
fn color(values: &[f64]) -> [f32; 4] {
    let mut out = NONE;
    for (to, from) in out.iter_mut().zip(values) {
        *to = *from as f32;
    }
    out
}

/// Makes RGBA from 0 to 1 of colours as they stand. Whole numbers count to 255. Where any has a fraction they count to
/// one, as "1 0 0.5" does, but for rows with more than that.
fn scaled(colors: &mut [[f32; 4]], fractions: bool) {
    for color in colors {
        let bytes = !fractions || color.iter().any(|v| *v > 1.0);
        for value in color {
            *value = if value.is_nan() {
                1.0
            } else if bytes {
                (*value / 255.0).clamp(0.0, 1.0)
            } else {
                value.clamp(0.0, 1.0)
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_vertices_carry_follows_from_the_keyword() {
        let off = read(b"STCNOFF 1 0 0\n1 2 3  0 0 1  255 0 51 255  0.5 0.25\n").unwrap();
        assert_eq!(off.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(off.normals.unwrap(), [[0.0, 0.0, 1.0]]);
        assert_eq!(off.colors.unwrap(), [[1.0, 0.0, 0.2, 1.0]]);
        assert_eq!(off.uvs.unwrap(), [[0.5, 0.25]]);
        let off = read(b"# a\nCOFF # b\n\n2 0\n0 0 0 1 0 0.0 # red\n0 0 0 0 0 255\n").unwrap();
        assert_eq!(off.colors.unwrap(), [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]]);
        let off = read(b"COFF 2 0\n0 0 0 1 0 0 1\n0 0 0 255 0 0 51\n").unwrap();
        assert_eq!(off.colors.unwrap()[1], [1.0, 0.0, 0.0, 0.2]);
    }

    #[test]
    fn faces_may_have_colors() {
        let text = b"OFF 3 3 0\n0 0 0\n1 0 0\n0 1 0 9\n3 0 1 2\n3 0 1 2 255 0 0\n3 0\n1 2 0.0 1.0 0.0 0.5\n";
        let off = read(text).unwrap();
        assert_eq!(off.face_colors.unwrap(), [[1.0; 4], [1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.5]]);
        assert_eq!((off.counts.len(), off.corners.len(), off.more), (3, 9, 1));
    }

    #[test]
    fn errors_say_where() {
        for (text, what) in [
            ("4OFF 1 0 0\n", "line 1: 4OFF has vertices of other than three dimensions"),
            ("OFF BINARY\n", "line 1: binary OFF"),
            ("OFF\n2 1 0\n0 0 0\n", "vertex 1 of 2, found the end of the file"),
            ("OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "line 4: face 0 of 1: there is no vertex 1, only 1"),
            ("OFF\n1 0 0\n0 0,5 0\n", "line 3: expected a number of vertex 0 of 1, found \"0,5\""),
            ("OFF\n99999999999 0 0\n", "vertex 0 of 99999999999"),
            ("PLY\n", "line 1: expected OFF"),
        ] {
            let error = read(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(what), "{text:?}: {error}");
        }
    }
}
