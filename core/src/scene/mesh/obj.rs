//! Wavefront OBJ: `v` (with red, green and blue behind the position, as sRGB values), `vt`, `vn` and `f`. Polygons become fans; groups, smoothing groups and materials are ignored.
//! Of each line the first fault is told.

use super::{MeshFile, RawAttribute, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::{SceneError, nearest, shortened};
use crate::scene::faults::FileFaults;
use crate::scene::linear_image::srgb_to_linear;
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

#[derive(Default)]
struct ObjReader {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    corners: Vec<Corner>,
    /// Of each position the corner there that came last, and of each corner the one before it at its position.
    newest: Vec<u32>,
    older: Vec<u32>,
    /// Corners at positions that have more than `CROWD`, so that a search takes no longer in any file.
    crowded: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
    /// A colour for each position, where colours are asked for.
    colours: Option<Vec<Spectrum>>,
}

pub(super) fn read(file: &MeshFile, flip_v: bool, faults: &mut FileFaults) -> Result<RawMesh, SceneError> {
    let mut reader = ObjReader {
        colours: file.asks_for(COLOUR).then(Vec::new),
        ..ObjReader::default()
    };
    for (number, line) in text::lines(file.bytes) {
        let hash = line.iter().position(|byte| *byte == b'#').unwrap_or(line.len());
        let line = line[..hash].trim_ascii();
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        // Names of objects and materials may be in any encoding.
        if end == 0 || IGNORED.iter().any(|name| name.as_bytes() == &line[..end]) {
            continue;
        }
        if let Err(reason) = reader.line(line, end, flip_v) {
            faults.note(file.broken(number, reason))?;
        }
        file.check_triangles(reader.triangles.len() as u64)?;
        file.check_vertices(reader.positions.len().max(reader.corners.len()) as u64)?;
    }
    Ok(reader.finish())
}

struct Statement<'a> {
    keyword: &'a str,
    words: std::str::SplitAsciiWhitespace<'a>,
}

impl Statement<'_> {
    fn numbers<const N: usize>(&mut self) -> Result<[f32; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            let word = self
                .words
                .next()
                .ok_or_else(|| format!("`{}` needs {N} numbers", self.keyword))?;
            *number = word
                .parse()
                .ok()
                .filter(|n: &f32| n.is_finite())
                .ok_or_else(|| format!("`{}`: `{}` is not a finite number", self.keyword, shortened(word)))?;
        }
        Ok(numbers)
    }
}

impl ObjReader {
    /// Reads a line whose keyword ends at `end`.
    fn line(&mut self, line: &[u8], end: usize, flip_v: bool) -> Result<(), String> {
        let line = std::str::from_utf8(line).map_err(|_| "the line is not text")?;
        let (keyword, rest) = line.split_at(end);
        let words = rest.split_ascii_whitespace();
        self.statement(Statement { keyword, words }, flip_v)
    }

    /// A vertex, normal or texture coordinate that cannot be read counts nevertheless: faces further on mean what they meant.
    fn statement(&mut self, mut statement: Statement, flip_v: bool) -> Result<(), String> {
        match statement.keyword {
            "v" => {
                let position = statement.numbers();
                self.positions
                    .push(Vec3::from_array(position.clone().unwrap_or_default()));
                self.newest.push(NONE);
                position?;
                self.colour(statement)
            }
            "vn" => {
                // A normal without direction is a missing one.
                let normal = statement.numbers();
                let vector = Vec3::from_array(normal.clone().unwrap_or_default());
                self.normals.push(vector.normalize_or_zero());
                normal.map(|_| ())
            }
            "vt" => {
                let uv = statement.numbers();
                let [u, v] = uv.clone().unwrap_or_default();
                self.uvs.push(Vec2::new(u, if flip_v { 1.0 - v } else { v }));
                uv.map(|_| ())
            }
            "f" => self.face(statement.words),
            other => {
                let read = ["v", "vt", "vn", "f"];
                let hint = nearest(other, read.into_iter().chain(IGNORED));
                let hint = hint.map_or(String::new(), |name| format!(" did you mean `{name}`?"));
                Err(format!(
                    "unknown statement `{}`;{hint} read: {}; ignored: {}",
                    shortened(other),
                    read.join(", "),
                    IGNORED.join(", ")
                ))
            }
        }
    }

    /// The colour behind a position, where colours are asked for; a single number there is a weight. Vertices without one are white.
    fn colour(&mut self, mut statement: Statement) -> Result<(), String> {
        let Some(colours) = &mut self.colours else {
            return Ok(());
        };
        let mut colour = Ok([1.0; 3]);
        if statement.words.clone().count() >= 3 {
            colour = statement.numbers();
        }
        let decoded = colour.clone().unwrap_or_default().map(srgb_to_linear);
        colours.resize(self.positions.len() - 1, Spectrum::ONE);
        colours.push(Spectrum::from_rgb(decoded));
        colour.map(|_| ())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let (mut first, mut last, mut count) = (0, 0, 0);
        for word in words {
            let id = self.corner(word)?;
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

    fn corner(&mut self, word: &str) -> Result<u32, String> {
        let mut parts = word.split('/');
        let position = index(parts.next(), self.positions.len(), "vertex")?.ok_or("a corner without a vertex")?;
        let uv = index(parts.next(), self.uvs.len(), "texture coordinate")?;
        let normal = index(parts.next(), self.normals.len(), "normal")?;
        if parts.next().is_some() {
            return Err("a corner has the form `v`, `v/vt`, `v//vn` or `v/vt/vn`".into());
        }
        Ok(self.id([position, uv.unwrap_or(NONE), normal.unwrap_or(NONE)]))
    }

    /// The number of a corner, which is a new one where there is no such corner yet.
    fn id(&mut self, corner: Corner) -> u32 {
        let newest = self.newest[corner[0] as usize];
        let (mut at, mut looked_at) = (newest, 0);
        while at != NONE && looked_at < CROWD {
            if self.corners[at as usize] == corner {
                return at;
            }
            at = self.older[at as usize];
            looked_at += 1;
        }
        let next = self.corners.len() as u32;
        if looked_at < CROWD {
            self.newest[corner[0] as usize] = next;
        } else {
            let id = *self.crowded.entry(corner).or_insert(next);
            if id != next {
                return id;
            }
        }
        self.corners.push(corner);
        self.older.push(newest);
        next
    }

    fn finish(mut self) -> RawMesh {
        let attributes = self.colours.take().map(|mut colours| {
            colours.resize(self.positions.len(), Spectrum::ONE);
            RawAttribute {
                name: COLOUR.to_owned(),
                of_faces: false,
                values: self.corners.iter().map(|corner| colours[corner[0] as usize]).collect(),
            }
        });
        (self.newest, self.older, self.crowded) = Default::default();
        // `NONE` is beyond any list.
        let uv = |corner: &Corner| self.uvs.get(corner[1] as usize).copied().unwrap_or_default();
        let normal = |corner: &Corner| self.normals.get(corner[2] as usize).copied().unwrap_or_default();
        let has_uvs = self.corners.iter().any(|corner| corner[1] != NONE);
        let has_normals = self.corners.iter().any(|corner| corner[2] != NONE);
        RawMesh {
            positions: self
                .corners
                .iter()
                .map(|corner| self.positions[corner[0] as usize])
                .collect(),
            normals: if has_normals {
                self.corners.iter().map(normal).collect()
            } else {
                Vec::new()
            },
            uvs: if has_uvs {
                self.corners.iter().map(uv).collect()
            } else {
                Vec::new()
            },
            triangles: self.triangles,
            attributes: attributes.into_iter().collect(),
        }
    }
}

/// An index counted from 1, or from the end where negative; `None` where left out.
fn index(word: Option<&str>, count: usize, what: &str) -> Result<Option<u32>, String> {
    let Some(word) = word.filter(|word| !word.is_empty()) else {
        return Ok(None);
    };
    let number = match text::digits(word.as_bytes()) {
        Some(number) => i64::from(number),
        None => word
            .parse()
            .map_err(|_| format!("{what} index `{word:.40}` is not an integer"))?,
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
            ("v 0 0 0\nf 1/1/1/1 1 1\n", 2, "out of range"),
            ("v 0 0 0\nf 1 1\n", 2, "3 corners"),
            ("v 0 0 0\nf /1 1 1\n", 2, "without a vertex"),
            ("v 0 0 0\nf 1 1 99999999999999999999\n", 2, "not an integer"),
            ("curv 0 1\n", 1, "unknown statement"),
        ] {
            mesh_error(parse(text), line, reason);
        }
        mesh_error(with_file(b"v 1 2 \xff\n", |file| file.obj(true)), 1, "not text");
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
