//! OBJ: vertices, polygons, and what is said between them: objects, groups, materials, smoothing.
//!
//! Numbers below zero count back from where they stand, others may lie ahead. Faces are put together by object and
//! material; a vertex of a part is a triple of position, UV and normal.

use rustc_hash::FxHashMap;

use super::polygon::Clipper;
use super::text::{Text, decoded, name, short, whole};
use crate::error::{Error, Result};

/// All that a file holds.
#[derive(Debug, Default)]
pub struct Obj {
    /// Parts in the order in which they begin.
    pub parts: Vec<Part>,
    /// Names of objects: those of `o`, or without any those of `g`.
    pub objects: Vec<String>,
    /// Names of `usemtl`, of unknown encoding.
    pub materials: Vec<Vec<u8>>,
    /// Names of groups, if there are objects too.
    pub groups: Vec<String>,
    /// What follows each `mtllib`, of unknown encoding.
    pub libraries: Vec<Vec<u8>>,
    /// What was left out, and how often.
    pub left: Vec<(String, usize)>,
}

/// The faces of an object that have one material.
#[derive(Debug, Default)]
pub struct Part {
    /// A number of `Obj::objects`, or 2³² - 1 before the first.
    pub object: u32,
    /// A number of `Obj::materials`.
    pub material: Option<u32>,
    /// Positions.
    pub positions: Vec<[f64; 3]>,
    /// One for each vertex, if any corner has one; zero for the others.
    pub uvs: Option<Vec<[f32; 2]>>,
    /// One for each vertex, if any corner has one; zero for the others.
    pub normals: Option<Vec<[f32; 3]>>,
    /// RGBA from 0 to 1 for each vertex, if any of the file has one; white for the others.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// A number of `Obj::groups` for each triangle, if there are any; 2³² - 1 before the first.
    pub groups: Option<Vec<u32>>,
    /// The smoothing group of each triangle, 0 for off, if the file has several.
    pub smoothing: Option<Vec<u32>>,
}

const NONE: u32 = u32::MAX;

/// An object and a material: what makes a part.
type Key = (u32, Option<u32>);

/// What holds from a face on.
#[derive(Clone, Copy, PartialEq)]
struct State {
    object: u32,
    group: u32,
    material: Option<u32>,
    smoothing: u32,
}

/// Names in the order in which they are met.
#[derive(Default)]
struct Names(Vec<Vec<u8>>, FxHashMap<Vec<u8>, u32>);

impl Names {
    fn number(&mut self, name: Vec<u8>) -> u32 {
        let next = self.0.len() as u32;
        *self.1.entry(name).or_insert_with_key(|name| {
            self.0.push(name.clone());
            next
        })
    }

    fn texts(&self) -> Vec<String> {
        self.0.iter().map(|n| name(n)).collect()
    }
}

/// The statements of a file.
#[derive(Default)]
struct Statements {
    positions: Vec<[f64; 3]>,
    /// As long as `positions`, or empty.
    colors: Vec<[f32; 4]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// For each corner numbers of a position, a UV and a normal. The latter two are empty until a corner has one.
    corners: [Vec<u32>; 3],
    /// Where the corners of each face begin, and of the last one end.
    starts: Vec<u32>,
    /// First faces, and what holds from there.
    runs: Vec<(usize, State)>,
    objects: Names,
    groups: Names,
    materials: Names,
    libraries: Vec<Vec<u8>>,
    left: FxHashMap<String, usize>,
}

/// Reads a file.
pub fn read(data: &[u8]) -> Result<Obj> {
    let data = &*decoded(data);
    let mut statements = Statements { starts: vec![0], ..Statements::default() };
    statements.read(data)?;
    statements.check(data)?;
    Ok(statements.into_parts())
}

fn text(data: &[u8]) -> Text<'_> {
    Text::new(data, true, true)
}

impl Statements {
    fn read(&mut self, data: &[u8]) -> Result<()> {
        let mut text = text(data);
        let mut state = State { object: NONE, group: NONE, material: None, smoothing: 0 };
        loop {
            let word = text.word();
            self.statement(word, &mut text, &mut state)?;
            if !text.next_line() {
                return Ok(());
            }
        }
    }

    fn statement(&mut self, word: &[u8], text: &mut Text<'_>, state: &mut State) -> Result<()> {
        match word {
            b"" => {}
            b"v" => self.vertex(text)?,
            b"vt" => {
                let (row, count) = numbers(text)?;
                at_least(text, count, 1)?;
                self.uvs.push([row[0] as f32, row[1] as f32]);
                if row[2] != 0.0 {
                    self.leave("third texture coordinates (vt)");
                }
            }
            b"vn" => {
                let (row, count) = numbers(text)?;
                at_least(text, count, 3)?;
                self.normals.push([row[0] as f32, row[1] as f32, row[2] as f32]);
            }
            // The second is the older word.
            b"f" | b"fo" => self.face(text, *state)?,
            b"usemtl" => {
                let name = text.rest();
                state.material = (!name.is_empty()).then(|| self.materials.number(name));
            }
            b"mtllib" => self.libraries.push(text.rest()),
            b"o" => state.object = self.objects.number(text.rest()),
            b"g" => state.group = self.groups.number(text.rest()),
            b"s" => state.smoothing = whole(text.word()).and_then(|s| u32::try_from(s).ok()).unwrap_or(0),
            b"p" | b"l" => self.leave("points and lines"),
            b"vp" | b"cstype" | b"deg" | b"bmat" | b"step" | b"curv" | b"curv2" | b"surf" | b"parm"
            | b"trim" | b"hole" | b"scrv" | b"sp" | b"end" | b"con" => {
                self.leave("curves and free-form surfaces")
            }
            other => {
                let lower = other.to_ascii_lowercase();
                if lower != other {
                    return self.statement(&lower, text, state);
                }
                self.leave(&format!("statements {:?}", short(other)));
            }
        }
        Ok(())
    }

    fn leave(&mut self, what: &str) {
        if let Some(count) = self.left.get_mut(what) {
            *count += 1;
        } else if self.left.len() < 16 {
            self.left.insert(what.to_owned(), 1);
        } else {
            *self.left.entry("further statements".to_owned()).or_default() += 1;
        }
    }

    fn vertex(&mut self, text: &mut Text<'_>) -> Result<()> {
        let (row, count) = numbers(text)?;
        at_least(text, count, 3)?;
        self.positions.push([row[0], row[1], row[2]]);
        // x y z, x y z w, x y z r g b, x y z r g b a or x y z w r g b a.
        let (weight, color) = match count {
            4 => (row[3], None),
            6 => (1.0, Some([row[3], row[4], row[5], f64::NAN])),
            7 => (1.0, Some([row[3], row[4], row[5], row[6]])),
            8 => (row[3], Some([row[4], row[5], row[6], row[7]])),
            _ => (1.0, None),
        };
        if weight != 1.0 {
            self.leave("weights of vertices, which polygons have none of");
        }
        if !matches!(count, 3 | 4 | 6..=8) {
            self.leave("numbers behind coordinates (v)");
        }
        if let Some(color) = color {
            self.colors.resize(self.positions.len() - 1, [f32::NAN; 4]);
            self.colors.push(color.map(|c| c as f32));
        } else if !self.colors.is_empty() {
            self.colors.push([f32::NAN; 4]);
        }
        Ok(())
    }

    fn face(&mut self, text: &mut Text<'_>, state: State) -> Result<()> {
        let face = self.starts.len() - 1;
        if self.runs.last().is_none_or(|(_, last)| *last != state) {
            self.runs.push((face, state));
        }
        let lengths = [self.positions.len(), self.uvs.len(), self.normals.len()];
        loop {
            let word = text.word();
            if word.is_empty() {
                break;
            }
            let mut numbers = [NONE; 3];
            let mut parts = word.split(|b| *b == b'/');
            for k in 0..3 {
                match parts.next() {
                    None => break,
                    // Only the first must be there: 7/ and 7// are written too.
                    Some(b"") if k > 0 => {}
                    Some(part) => {
                        numbers[k] = absolute(part, lengths[k]).ok_or_else(|| {
                            let what = ["a vertex", "a texture vertex", "a normal"][k];
                            text.expected(word, &format!("the number of {what} of {}", lengths[k]))
                        })?;
                    }
                }
            }
            if parts.next().is_some() {
                return Err(text.expected(word, "a corner such as 1/2/3"));
            }
            let corner = self.corners[0].len();
            self.corners[0].push(numbers[0]);
            for k in 1..3 {
                if numbers[k] != NONE || !self.corners[k].is_empty() {
                    self.corners[k].resize(corner, NONE);
                    self.corners[k].push(numbers[k]);
                }
            }
        }
        let end = u32::try_from(self.corners[0].len())
            .map_err(|_| Error::TooLarge("more than 2^32 corners of faces".into()))?;
        if end - self.starts[face] < 3 {
            self.leave("faces of fewer than three corners");
        }
        self.starts.push(end);
        Ok(())
    }

    /// Numbers that lie ahead are known to be there only at the end.
    fn check(&self, data: &[u8]) -> Result<()> {
        let lengths = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let bad = (0..3).find_map(|k| {
            let beyond = |c: &u32| *c != NONE && *c as usize >= lengths[k];
            self.corners[k].iter().position(beyond).map(|corner| (corner, k))
        });
        let Some((corner, k)) = bad else { return Ok(()) };
        // The statement is looked for only now: its number is that of the face.
        let face = self.starts.partition_point(|s| *s as usize <= corner) - 1;
        let (mut text, mut seen) = (text(data), 0);
        loop {
            let (at, word) = (text.offset(), text.word().to_ascii_lowercase());
            if matches!(&*word, b"f" | b"fo") {
                if seen == face {
                    let what = ["vertex", "texture vertex", "normal"][k];
                    let number = u64::from(self.corners[k][corner]) + 1;
                    let message = format!("there is no {what} {number}, only {}", lengths[k]);
                    return Err(text.fault(at, message));
                }
                seen += 1;
            }
            if !text.next_line() {
                return Ok(());
            }
        }
    }
}

/// A number of a face, from 0. Zero itself and what lies before the first are nothing.
fn absolute(part: &[u8], length: usize) -> Option<u32> {
    let number = whole(part)?;
    let place = match number {
        1.. => number - 1,
        0 => return None,
        _ => i64::try_from(length).ok()? + number,
    };
    u32::try_from(place).ok().filter(|p| *p != NONE)
}

/// The numbers of a statement. Of more than eight only their count is known.
fn numbers(text: &mut Text<'_>) -> Result<([f64; 8], usize)> {
    let (mut row, mut count) = ([0.0; 8], 0);
    while !text.line_ends() {
        let value = text.number("a number")?;
        if let Some(to) = row.get_mut(count) {
            *to = value;
        }
        count += 1;
    }
    Ok((row, count))
}

fn at_least(text: &Text<'_>, count: usize, needed: usize) -> Result<()> {
    if count < needed { Err(text.expected(&[], &format!("{needed} numbers"))) } else { Ok(()) }
}

// -------------------------------------------------------------------------------------------------------- parts

impl Statements {
    fn into_parts(mut self) -> Obj {
        self.finish_colors();
        let by_group = self.objects.0.is_empty();
        let mut left: Vec<_> = std::mem::take(&mut self.left).into_iter().collect();
        left.sort_unstable();
        // Faces of an object and a material, in the order of their first.
        let mut places: FxHashMap<Key, usize> = FxHashMap::default();
        let mut rows: Vec<(Key, Vec<usize>)> = Vec::new();
        for (run, (_, state)) in self.runs.iter().enumerate() {
            let key = (if by_group { state.group } else { state.object }, state.material);
            let place = *places.entry(key).or_insert(rows.len());
            if place == rows.len() {
                rows.push((key, Vec::new()));
            }
            rows[place].1.push(run);
        }
        let mut corners = CornerMap { first: vec![NONE; self.positions.len()], ..CornerMap::default() };
        let mut clipper = Clipper::default();
        let smooth = self.runs.iter().any(|(_, s)| s.smoothing != self.runs[0].1.smoothing);
        let grouped = !by_group && !self.groups.0.is_empty();
        let mut parts = Vec::with_capacity(rows.len());
        for ((object, material), runs) in rows {
            let mut part = Part { object, material, ..Part::default() };
            part.groups = grouped.then(Vec::new);
            part.smoothing = smooth.then(Vec::new);
            self.triangulate(&runs, &mut corners, &mut clipper, &mut part);
            self.fill(&mut corners, &mut part);
            if !part.faces.is_empty() {
                parts.push(part);
            }
        }
        let named = if by_group { &self.groups } else { &self.objects };
        Obj {
            parts,
            objects: named.texts(),
            materials: self.materials.0,
            groups: if grouped { self.groups.texts() } else { Vec::new() },
            libraries: self.libraries,
            left,
        }
    }

    /// Colours from 0 to 1, those from 0 to 255 too; white where there are none.
    fn finish_colors(&mut self) {
        let bytes = self.colors.iter().flatten().any(|c| *c > 1.0);
        for value in self.colors.iter_mut().flatten() {
            let own = if bytes { *value / 255.0 } else { *value };
            *value = if own.is_nan() { 1.0 } else { own.clamp(0.0, 1.0) };
        }
    }

    /// Fills in the triangles of some runs, by numbers of the part's vertices in the order of their first use.
    fn triangulate(&self, runs: &[usize], map: &mut CornerMap, clipper: &mut Clipper, part: &mut Part) {
        let [positions, uvs, normals] = &self.corners;
        let mut own = Vec::new();
        for &run in runs {
            let (begin, state) = self.runs[run];
            let end = self.runs.get(run + 1).map_or(self.starts.len() - 1, |next| next.0);
            for face in begin..end {
                let range = self.starts[face] as usize..self.starts[face + 1] as usize;
                own.clear();
                own.extend(range.clone().map(|k| {
                    let at = |column: &Vec<u32>| column.get(k).copied().unwrap_or(NONE);
                    map.vertex([positions[k], at(uvs), at(normals)])
                }));
                let place = |k: usize| self.positions[positions[range.start + k] as usize];
                clipper.polygon(own.len(), place, |t| part.faces.push(t.map(|k| own[k as usize])));
                if let Some(groups) = &mut part.groups {
                    groups.resize(part.faces.len(), state.group);
                }
                if let Some(smoothing) = &mut part.smoothing {
                    smoothing.resize(part.faces.len(), state.smoothing);
                }
            }
        }
    }

    /// Fills in the vertices of a part in the order of the file, and forgets them in the map.
    fn fill(&self, map: &mut CornerMap, part: &mut Part) {
        let triples = map.take();
        let mut order: Vec<u32> = (0..triples.len() as u32).collect();
        // As files mostly are, this is sorted already.
        order.sort_by_key(|k| triples[*k as usize][0]);
        let mut place = vec![0u32; triples.len()];
        for (to, from) in order.iter().enumerate() {
            place[*from as usize] = to as u32;
        }
        for corner in part.faces.as_flattened_mut() {
            *corner = place[*corner as usize];
        }
        let rows = || order.iter().map(|k| triples[*k as usize]);
        part.positions = rows().map(|t| self.positions[t[0] as usize]).collect();
        if triples.iter().any(|t| t[1] != NONE) {
            let uv = |t: [u32; 3]| self.uvs.get(t[1] as usize).copied().unwrap_or_default();
            part.uvs = Some(rows().map(uv).collect());
        }
        if triples.iter().any(|t| t[2] != NONE) {
            let normal = |t: [u32; 3]| self.normals.get(t[2] as usize).copied().unwrap_or_default();
            part.normals = Some(rows().map(normal).collect());
        }
        if !self.colors.is_empty() {
            let color = |t: [u32; 3]| self.colors.get(t[0] as usize).copied().unwrap_or([1.0; 4]);
            part.colors = Some(rows().map(color).collect());
        }
    }
}

/// Vertices of a part by position, UV and normal.
#[derive(Default)]
struct CornerMap {
    /// For each position its first vertex.
    first: Vec<u32>,
    /// For each vertex the next one of the same position.
    next: Vec<u32>,
    triples: Vec<[u32; 3]>,
}

impl CornerMap {
    fn vertex(&mut self, triple: [u32; 3]) -> u32 {
        let made = self.triples.len() as u32;
        let (mut at, mut last) = (self.first[triple[0] as usize], NONE);
        while at != NONE {
            if self.triples[at as usize] == triple {
                return at;
            }
            (last, at) = (at, self.next[at as usize]);
        }
        match last {
            NONE => self.first[triple[0] as usize] = made,
            last => self.next[last as usize] = made,
        }
        self.triples.push(triple);
        self.next.push(NONE);
        made
    }

    fn take(&mut self) -> Vec<[u32; 3]> {
        for triple in &self.triples {
            self.first[triple[0] as usize] = NONE;
        }
        self.next.clear();
        std::mem::take(&mut self.triples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(text: &str) -> Part {
        let mut obj = read(text.as_bytes()).unwrap();
        assert_eq!(obj.parts.len(), 1, "{text}");
        obj.parts.remove(0)
    }

    const V: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

    #[test]
    fn relative_numbers_count_from_where_they_stand() {
        let part = one("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 5 5 5\nv 0 1 0\nf -5 -3 -1\n");
        assert_eq!(part.positions, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(part.faces, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn lines_go_on_after_a_backslash() {
        for end in ["\n", "\r\n", "\r"] {
            for blank in ["", " \t"] {
                let text = format!("# C:\\dir\\\n{V}f 1 2 \\{blank}\n3 4").replace('\n', end);
                assert_eq!(one(&text).faces.len(), 2, "{text:?}");
            }
        }
    }

    #[test]
    fn parts_by_object_and_material() {
        let text = format!(
            "{V}o a\nusemtl x\nf 1 2 3\no b c # d\nf 1 3 4\nusemtl y#1\nf 1 2 4\no a\nusemtl x\nf 2 3 4\n"
        );
        let obj = read(text.as_bytes()).unwrap();
        assert_eq!(obj.objects, ["a", "b c"]);
        assert_eq!(obj.materials, [&b"x"[..], b"y#1"]);
        let found: Vec<_> = obj.parts.iter().map(|p| (p.object, p.material, p.faces.len())).collect();
        assert_eq!(found, [(0, Some(0), 2), (1, Some(0), 1), (1, Some(1), 1)]);
        let obj = read(format!("{V}g left arm\nf 1 2 3\ng\nf 1 3 4\n").as_bytes()).unwrap();
        assert_eq!(obj.objects, ["left arm", ""]);
    }

    #[test]
    fn corners_are_triples() {
        let part = one(&format!("{V}vt 0 0\nvt 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/1\nf 1/2/ 3//1 4\n"));
        assert_eq!(part.positions.len(), 6);
        assert_eq!(part.uvs.unwrap()[1], [1.0, 0.0]);
        assert_eq!(part.normals.unwrap()[5], [0.0; 3]);
        assert_eq!(
            one("v 0 0 0 255 0 51\nv 1 0 0 1\nv 0 1 0\nf 1 2 3").colors.unwrap()[0],
            [1.0, 0.0, 0.2, 1.0]
        );
    }

    #[test]
    fn errors_name_the_line() {
        for (text, what) in [
            ("f 0 1 2\n", "line 5: expected the number of a vertex of 4, found \"0\""),
            ("f 1 2 9\n", "line 5: there is no vertex 9, only 4"),
            ("f -5 1 2\n", "line 5: expected the number of a vertex of 4, found \"-5\""),
            ("f 1/1 2 3\n", "line 5: there is no texture vertex 1, only 0"),
            ("f 1/1/1/1 2 3\n", "line 5: expected a corner"),
            ("v 0,5 1 2\n", "line 5: expected a number, found \"0,5\""),
            ("v 1 2\n", "line 5: expected 3 numbers, found the end of the line"),
        ] {
            let error = read(format!("{V}{text}").as_bytes()).unwrap_err().to_string();
            assert!(error.contains(what), "{text:?}: {error}");
        }
        let obj = read(format!("{V}p 1\nf 1 2\ncurv 0 1 1 2\nxyz\n").as_bytes()).unwrap();
        assert_eq!(obj.left.len(), 4);
    }
}
