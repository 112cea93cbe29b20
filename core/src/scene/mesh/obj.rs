//! Wavefront OBJ: `v` (with red, green and blue behind the position, as sRGB values), `vt`, `vn` and `f`. Polygons become fans; groups, smoothing groups and materials are ignored.
//! Of each line the first fault is told.

use super::{MeshFile, RawAttribute, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::{SceneError, nearest, shortened};
use crate::scene::faults::FileFaults;
use crate::scene::linear_image::srgb_to_linear;
use crate::scene::number::{leading_digits, leading_f32};
use crate::scene::text;
use crate::spectrum::Spectrum;
use std::collections::HashMap;

/// Statements that do not change the triangles.
const IGNORED: [&str; 16] = [
    "o",
    "g",
    "s",
    "mg",
    "usemtl",
    "mtllib",
    "usemap",
    "maplib",
    "lod",
    "bevel",
    "c_interp",
    "d_interp",
    "l",
    "p",
    "vp",
    "shadow_obj",
];

/// The attribute that the colours of vertices are.
const COLOUR: &str = "vertex_color";

/// Indices of position, texture coordinates and normal, counted from 0; [`NONE`] where left out.
type Corner = [u32; 3];

/// No index: no file has so many of anything.
const NONE: u32 = u32::MAX;

/// Corners at one position that are looked at one by one. In usual meshes there are few.
const CROWD: usize = 16;

/// Bytes of the shortest vertex or face, `v 0 0 0` with its line end.
const SHORTEST: usize = 8;

#[derive(Default)]
struct ObjReader {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// The corners by number. While there is none, a corner is a position alone, and has its number.
    corners: Option<Corners>,
    /// A colour for each position, where colours are asked for.
    colours: Option<Vec<Spectrum>>,
}

pub(super) fn read(file: &MeshFile, flip_v: bool, faults: &mut FileFaults) -> Result<RawMesh, SceneError> {
    let mut reader = ObjReader::for_file(file);
    for (number, line) in text::lines(file.bytes) {
        let mut words = Words { rest: line };
        let Some(keyword) = words.next() else { continue };
        if let Err(reason) = reader.statement(keyword, words, flip_v) {
            faults.note(file.broken(number, reason))?;
        }
        file.check_triangles(reader.triangles.len() as u64)?;
        let corners = reader.corners.as_ref().map_or(0, |corners| corners.list.len());
        file.check_vertices(reader.positions.len().max(corners) as u64)?;
    }
    Ok(reader.finish())
}

/// The words of a line, which a comment ends.
#[derive(Clone)]
struct Words<'a> {
    rest: &'a [u8],
}

impl<'a> Words<'a> {
    /// Moves to the next word, and tells whether there is one.
    fn skip_blanks(&mut self) -> bool {
        let blanks = self.rest.iter().position(|byte| !byte.is_ascii_whitespace());
        self.rest = &self.rest[blanks.unwrap_or(self.rest.len())..];
        !matches!(self.rest.first(), None | Some(b'#'))
    }

    /// The next number, of single precision and finite; `keyword` has `count` of them.
    fn number(&mut self, keyword: &str, count: usize) -> Result<f32, String> {
        if !self.skip_blanks() {
            return Err(format!("`{keyword}` needs {count} numbers"));
        }
        let mut found = leading_f32(self.rest);
        match found {
            Some((_, length)) if self.rest.get(length).is_none_or(|byte| ends_word(*byte)) => {
                self.rest = &self.rest[length..];
            }
            _ => found = None,
        }
        match found {
            Some((number, _)) if number.is_finite() => Ok(number),
            _ => {
                let word = String::from_utf8_lossy(self.next().unwrap_or_default());
                Err(format!("`{keyword}`: `{}` is not a finite number", shortened(&word)))
            }
        }
    }

    /// The next word as the numbers of a corner, 0 where one is left out; `None` where it is not of such numbers above 0.
    fn corner(&mut self) -> Option<[u32; 3]> {
        let (mut numbers, mut at) = ([0; 3], 0);
        for number in &mut numbers {
            if let Some((found, length)) = leading_digits(&self.rest[at..]) {
                if found == 0 {
                    return None;
                }
                (*number, at) = (found, at + length);
            }
            match self.rest.get(at) {
                Some(b'/') => at += 1,
                Some(byte) if !ends_word(*byte) => return None,
                _ => {
                    self.rest = &self.rest[at..];
                    return Some(numbers);
                }
            }
        }
        None
    }

    fn numbers<const N: usize>(&mut self, keyword: &str) -> Result<[f32; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(keyword, N)?;
        }
        Ok(numbers)
    }
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        if !self.skip_blanks() {
            return None;
        }
        let end = self.rest.iter().position(|byte| ends_word(*byte));
        let (word, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = rest;
        Some(word)
    }
}

fn ends_word(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == b'#'
}

impl ObjReader {
    /// A reader with room for what the file holds, so far as the starts of its lines tell.
    fn for_file(file: &MeshFile) -> Self {
        let (mut vertices, mut normals, mut uvs, mut faces) = (0, 0, 0, 0);
        let mut count = |line: &[u8]| match line {
            [b'v', b' ' | b'\t', ..] => vertices += 1,
            [b'v', b'n', ..] => normals += 1,
            [b'v', b't', ..] => uvs += 1,
            [b'f', b' ' | b'\t', ..] => faces += 1,
            _ => {}
        };
        count(file.bytes);
        memchr::memchr_iter(b'\n', file.bytes).for_each(|end| count(&file.bytes[end + 1..]));
        let most = file.bytes.len() / SHORTEST;
        Self {
            positions: Vec::with_capacity(vertices.min(most)),
            uvs: Vec::with_capacity(uvs.min(most)),
            normals: Vec::with_capacity(normals.min(most)),
            triangles: Vec::with_capacity(faces.min(most)),
            corners: None,
            colours: file.asks_for(COLOUR).then(Vec::new),
        }
    }

    /// A vertex, normal or texture coordinate that cannot be read counts nevertheless: faces further on mean what they meant.
    fn statement(&mut self, keyword: &[u8], mut words: Words, flip_v: bool) -> Result<(), String> {
        match keyword {
            b"v" => {
                let position = words.numbers("v");
                self.positions
                    .push(Vec3::from_array(*position.as_ref().unwrap_or(&[0.0; 3])));
                position?;
                self.colour(words)
            }
            b"vn" => {
                // A normal without direction is a missing one.
                let normal = words.numbers("vn");
                let vector = Vec3::from_array(*normal.as_ref().unwrap_or(&[0.0; 3]));
                self.normals.push(vector.normalize_or_zero());
                normal.map(|_| ())
            }
            b"vt" => {
                let uv = words.numbers("vt");
                let [u, v] = *uv.as_ref().unwrap_or(&[0.0; 2]);
                self.uvs.push(Vec2::new(u, if flip_v { 1.0 - v } else { v }));
                uv.map(|_| ())
            }
            b"f" => self.face(words),
            // Names of objects and materials may be in any encoding.
            other if IGNORED.iter().any(|name| name.as_bytes() == other) => Ok(()),
            other => {
                let read = ["v", "vt", "vn", "f"];
                let other = String::from_utf8_lossy(other);
                let hint = nearest(&other, read.into_iter().chain(IGNORED));
                let hint = hint.map_or(String::new(), |name| format!(" did you mean `{name}`?"));
                Err(format!(
                    "unknown statement `{}`;{hint} read: {}; ignored: {}",
                    shortened(&other),
                    read.join(", "),
                    IGNORED.join(", ")
                ))
            }
        }
    }

    /// The colour behind a position, where colours are asked for; a single number there is a weight. Vertices without one are white.
    fn colour(&mut self, mut words: Words) -> Result<(), String> {
        let Some(colours) = &mut self.colours else {
            return Ok(());
        };
        let mut colour = Ok([1.0; 3]);
        if words.clone().count() >= 3 {
            colour = words.numbers("v");
        }
        let decoded = colour.clone().unwrap_or_default().map(srgb_to_linear);
        colours.resize(self.positions.len() - 1, Spectrum::ONE);
        colours.push(Spectrum::from_rgb(decoded));
        colour.map(|_| ())
    }

    fn face(&mut self, mut words: Words) -> Result<(), String> {
        let (mut first, mut last, mut count) = (0, 0, 0);
        while words.skip_blanks() {
            let mut behind = words.clone();
            let corner = match behind.corner() {
                Some(written) if self.has(written) => {
                    words = behind;
                    // What is left out becomes `NONE`.
                    written.map(|number| number.wrapping_sub(1))
                }
                _ => self.corner(words.next().unwrap_or_default())?,
            };
            let id = self.id(corner, count);
            match count {
                0 => first = id,
                1 => {}
                _ => self.triangles.push([first, last, id]),
            }
            last = id;
            count += 1;
        }
        if count < 3 {
            Err(format!("a face has 3 corners or more, this has {count}"))
        } else {
            Ok(())
        }
    }

    /// Whether the file has had what a corner names by numbers counted from 1.
    fn has(&self, [position, uv, normal]: [u32; 3]) -> bool {
        let within = |number: u32, count: usize| number as usize <= count;
        position > 0
            && within(position, self.positions.len())
            && within(uv, self.uvs.len())
            && within(normal, self.normals.len())
    }

    /// The corner that is written as a word.
    fn corner(&self, word: &[u8]) -> Result<Corner, String> {
        let mut parts = word.split(|byte| *byte == b'/');
        let position = index(parts.next(), self.positions.len(), "vertex")?.ok_or("a corner without a vertex")?;
        let uv = index(parts.next(), self.uvs.len(), "texture coordinate")?;
        let normal = index(parts.next(), self.normals.len(), "normal")?;
        if parts.next().is_some() {
            return Err("a corner has the form `v`, `v/vt`, `v//vn` or `v/vt/vn`".into());
        }
        Ok([position, uv.unwrap_or(NONE), normal.unwrap_or(NONE)])
    }

    /// The number of a corner, before which its face has `before`.
    fn id(&mut self, corner: Corner, before: usize) -> u32 {
        if self.corners.is_none() && corner[1] == NONE && corner[2] == NONE {
            return corner[0];
        }
        let corners = self.corners.get_or_insert_with(|| {
            let none_before = self.triangles.is_empty() && before == 0;
            Corners::of_positions(if none_before { 0 } else { self.positions.len() as u32 })
        });
        corners.id(corner, self.positions.len())
    }

    fn finish(mut self) -> RawMesh {
        let corners = match self.corners.take() {
            Some(corners) => corners.list,
            None => match used(self.positions.len(), &self.triangles) {
                Some(corners) => {
                    let mut numbers = vec![NONE; self.positions.len()];
                    (0..)
                        .zip(&corners)
                        .for_each(|(id, corner)| numbers[corner[0] as usize] = id);
                    let corners_of_faces = self.triangles.iter_mut().flatten();
                    corners_of_faces.for_each(|corner| *corner = numbers[*corner as usize]);
                    corners
                }
                None => return self.finish_positions(),
            },
        };
        let colours = self.colours.take().map(|mut colours| {
            colours.resize(self.positions.len(), Spectrum::ONE);
            corners.iter().map(|corner| colours[corner[0] as usize]).collect()
        });
        // Each list is gone before the next one is made. `NONE` is beyond any list.
        let at = |list: Vec<Vec3>, part: usize| -> Vec<Vec3> {
            let value = |corner: &Corner| list.get(corner[part] as usize).copied().unwrap_or_default();
            corners.iter().map(value).collect()
        };
        let has = |part: usize| corners.iter().any(|corner| corner[part] != NONE);
        let uv = |corner: &Corner| self.uvs.get(corner[1] as usize).copied().unwrap_or_default();
        RawMesh {
            positions: at(self.positions, 0),
            normals: if has(2) { at(self.normals, 2) } else { Vec::new() },
            uvs: if has(1) {
                corners.iter().map(uv).collect()
            } else {
                Vec::new()
            },
            triangles: self.triangles,
            attributes: colours.map(colour_attribute).into_iter().collect(),
        }
    }

    /// The mesh of corners that are all positions alone, of which each is used.
    fn finish_positions(self) -> RawMesh {
        let colours = self.colours.map(|mut colours| {
            colours.resize(self.positions.len(), Spectrum::ONE);
            colours
        });
        RawMesh {
            positions: self.positions,
            triangles: self.triangles,
            attributes: colours.map(colour_attribute).into_iter().collect(),
            ..RawMesh::default()
        }
    }
}

fn colour_attribute(values: Vec<Spectrum>) -> RawAttribute {
    RawAttribute {
        name: COLOUR.to_owned(),
        of_faces: false,
        values,
    }
}

/// The positions that triangles use, as corners; `None` where they use all of them.
fn used(positions: usize, triangles: &[[u32; 3]]) -> Option<Vec<Corner>> {
    let mut used = vec![false; positions];
    triangles
        .iter()
        .flatten()
        .for_each(|corner| used[*corner as usize] = true);
    if used.iter().all(|used| *used) {
        return None;
    }
    let positions = (0..).zip(used).filter(|(_, used)| *used);
    Some(positions.map(|(position, _)| [position, NONE, NONE]).collect())
}

/// The different corners, numbered in the order in which they come.
#[derive(Default)]
struct Corners {
    list: Vec<Corner>,
    /// Of each position the corner there that came last, and of each corner the one before it at its position.
    newest: Vec<u32>,
    older: Vec<u32>,
    /// Corners at positions that have more than `CROWD`, so that a search takes no longer in any file.
    crowded: HashMap<Corner, u32>,
}

impl Corners {
    /// The first `count` positions, each alone and under its number.
    fn of_positions(count: u32) -> Self {
        Self {
            list: (0..count).map(|position| [position, NONE, NONE]).collect(),
            newest: (0..count).collect(),
            older: vec![NONE; count as usize],
            crowded: HashMap::new(),
        }
    }

    /// The number of a corner at one of so many positions, which is a new one where there is no such corner yet.
    fn id(&mut self, corner: Corner, positions: usize) -> u32 {
        if self.newest.len() < positions {
            self.list.reserve_exact(positions - self.newest.len());
            self.older.reserve_exact(positions - self.newest.len());
            self.newest.resize(positions, NONE);
        }
        let newest = self.newest[corner[0] as usize];
        let (mut at, mut looked_at) = (newest, 0);
        while at != NONE && looked_at < CROWD {
            if self.list[at as usize] == corner {
                return at;
            }
            at = self.older[at as usize];
            looked_at += 1;
        }
        let next = self.list.len() as u32;
        if looked_at < CROWD {
            self.newest[corner[0] as usize] = next;
        } else {
            let id = *self.crowded.entry(corner).or_insert(next);
            if id != next {
                return id;
            }
        }
        self.list.push(corner);
        self.older.push(newest);
        next
    }
}

/// An index counted from 1, or from the end where negative; `None` where left out.
fn index(word: Option<&[u8]>, count: usize, what: &str) -> Result<Option<u32>, String> {
    let Some(word) = word.filter(|word| !word.is_empty()) else {
        return Ok(None);
    };
    let number = match leading_digits(word) {
        Some((number, length)) if length == word.len() => i64::from(number),
        _ => {
            let word = String::from_utf8_lossy(word);
            word.parse()
                .map_err(|_| format!("{what} index `{word:.40}` is not an integer"))?
        }
    };
    let found = match number {
        1.. => number - 1,
        _ => (count as i64).saturating_add(number),
    };
    if number == 0 || found < 0 || found >= count as i64 {
        return Err(format!(
            "{what} index {number} is out of range: the file has {count} up to here"
        ));
    }
    Ok(Some(found as u32))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh_error, with_file};
    use super::*;

    fn parse(text: &str) -> Result<RawMesh, Vec<SceneError>> {
        with_file(text.as_bytes(), |file| file.obj(true))
    }

    #[test]
    fn corners_are_shared_and_polygons_become_fans() {
        let text =
            "v 0 0 0\nv 1 0 0\nv 1 1 0 # comment\r\nv 0 1 0\nvt 0 0\nvt 1 0.25\n\ng x\nf 1 2 3 4\nf 1/1 2/2 -2/1\n";
        let mesh = parse(text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6]]);
        assert_eq!(mesh.positions[6], Vec3::new(1.0, 1.0, 0.0));
        assert_eq!(mesh.uvs[5], Vec2::new(1.0, 0.75));
        assert_eq!(mesh.uvs[0], Vec2::ZERO);
        assert!(mesh.normals.is_empty());
        let mesh = parse("v 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 2\nf 1//1 2//1 3\n").unwrap();
        assert_eq!(mesh.normals, [Vec3::Z, Vec3::Z, Vec3::ZERO]);
    }

    /// Positions have their own numbers until a corner has more than one, and those that no face uses go.
    #[test]
    fn positions_alone_are_the_vertices() {
        let square = "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 8 8 8 # not used\nv 0 1 0\n";
        let mesh = parse(&format!("{square}f 2 3 4#6\nf 2\t4 6\n")).unwrap();
        assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        let mesh = parse(&format!("{square}vt 0.5 0\nf 2 3 4\nf 2 4/1 6\nv 7 7 7\nf 2 4/1 7\n")).unwrap();
        let corners = mesh.triangles.iter().flatten();
        let places: Vec<_> = corners
            .map(|corner| mesh.positions[*corner as usize].to_array())
            .collect();
        let [a, b, c, d, e] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [7., 7., 7.]];
        assert_eq!(places, [a, b, c, a, c, d, a, c, e]);
        assert_eq!(mesh.triangles[1][1], mesh.triangles[2][1]);
        assert_ne!(mesh.triangles[0][2], mesh.triangles[1][1]);
        assert_eq!(mesh.uvs[mesh.triangles[1][1] as usize].x, 0.5);
    }

    /// Far more corners at a vertex than are looked at one by one.
    #[test]
    fn corners_are_shared_in_a_crowd() {
        let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned();
        (0..100).for_each(|i| text += &format!("vt {i} 0\n"));
        let faces: String = (1..=100).map(|i| format!("f 1/{i} 2/1 3/1\n")).collect();
        let mesh = parse(&(text + &faces + &faces)).unwrap();
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (102, 200));
        assert_eq!(mesh.triangles[..100], mesh.triangles[100..]);
        assert!((0..100).all(|i| mesh.uvs[mesh.triangles[i][0] as usize].x == i as f32));
    }

    #[test]
    fn errors_name_the_line() {
        for (text, line, reason) in [
            ("v 0 0\n", 1, "needs 3 numbers"),
            ("v 0 0 nan\n", 1, "not a finite number"),
            ("\nv 0 0 1e99\n", 2, "not a finite number"),
            ("v 0 0 0\nf 1 1 2\n", 2, "out of range"),
            ("v 0 0 0\nf 1 1 0\n", 2, "out of range"),
            ("v 0 0 0\nf 1 1 -2\n", 2, "out of range"),
            ("v 0 0 0\nf 1 1 -9223372036854775808\n", 2, "out of range"),
            ("v 0 0 0\nf 1/1 1 1\n", 2, "out of range"),
            ("v 0 0 0\nf 1/0 1 1\n", 2, "out of range"),
            ("v 0 0 0\nf 1/1/1/1 1 1\n", 2, "out of range"),
            ("v 0 0 0\nf 1 1\n", 2, "3 corners"),
            ("v 0 0 0\nf /1 1 1\n", 2, "without a vertex"),
            ("v 0 0 0\nf 1 1 99999999999999999999\n", 2, "not an integer"),
            ("curv 0 1\n", 1, "unknown statement"),
        ] {
            mesh_error(parse(text), line, reason);
        }
        let latin1 = with_file(b"v 1 2 \xff\n", |file| file.obj(true));
        mesh_error(latin1, 1, "`\u{fffd}` is not a finite number");
    }

    /// Later faces count a vertex that cannot be read: 4 is the one after it.
    #[test]
    fn every_broken_line_is_told() {
        let text = "v 0 0 0\nv 1 x 0\nvn 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 4\nf 1 2 5\nfo 1 2\nf 2 3 4\n";
        let told: Vec<String> = parse(text).unwrap_err().iter().map(ToString::to_string).collect();
        assert_eq!(told.len(), 4, "{told:?}");
        for (fault, expected) in told.iter().zip([
            "mesh:2: `v`: `x` is not a finite number",
            "mesh:3: `vn` needs 3 numbers",
            "mesh:7: vertex index 5 is out of range: the file has 4 up to here",
            "mesh:8: unknown statement `fo`; did you mean `f`?",
        ]) {
            assert!(fault.starts_with(expected), "{fault}");
        }
    }

    #[test]
    fn of_many_faults_the_first_are_told_and_the_others_counted() {
        let told = |lines| parse(&"v\n".repeat(lines)).unwrap_err();
        assert_eq!(told(10).len(), 10);
        let faults = told(30);
        assert_eq!((faults.len(), faults[9].line()), (11, Some(10)));
        assert_eq!(faults[10].to_string(), "mesh: and 20 more faults");
        let faults = told(5000);
        assert_eq!(faults.len(), 11);
        assert!(
            faults[10]
                .to_string()
                .starts_with("mesh: and more than 1000 more faults"),
            "{}",
            faults[10]
        );
    }

    /// A byte order mark, names in Latin-1, lone CRs, and normals without direction.
    #[test]
    fn files_of_other_programs_are_read() {
        let text = b"\xef\xbb\xbfv 0 0 0\rv 1 0 0\r\nv 0 1 0\rg St\xfchle\rusemtl gr\xfcn\rvn 0 0 0\rvn 0 0 2\r\rf 1//1 2//2 3//1\rv 0\r";
        let end = text.len() - 4;
        let mesh = with_file(&text[..end], |file| file.obj(true)).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        assert_eq!(mesh.normals, [Vec3::ZERO, Vec3::Z, Vec3::ZERO]);
        mesh_error(with_file(text, |file| file.obj(true)), 10, "needs 3 numbers");
    }
}
