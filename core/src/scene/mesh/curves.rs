//! Curves as tubes of triangles, and the files that hold them.

use super::{MeshFile, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::{SceneError, shortened};
use crate::scene::faults::FileFaults;
use crate::scene::text;
use glam::{DVec3, DVec4};
use std::f64::consts::{PI, TAU};

/// The sides that a tube may have. As many are taken as keep within [`MANY_TRIANGLES`].
const SIDES: [u64; 4] = [32, 16, 8, 6];
/// Triangles from which on the tubes of a shape get fewer sides.
const MANY_TRIANGLES: u64 = 2_000_000;
/// The most pieces of one cubic segment.
const PIECES: f64 = 16.0;
/// By what part of its radius a curve may pass by the middle of a piece.
const DEVIATION: f64 = 0.03;

/// Which curve a file's points are taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum CurveKind {
    /// Uniform cubic B-splines; a line holds x, y, z and the radius.
    BSpline,
    /// Straight pieces; a line holds x, y, z and the radius.
    Linear,
    /// Straight pieces of one radius, as Mitsuba 0.x has them: a line holds x, y and z, or the file is binary.
    Hair(f64),
}

/// A cross-section of a tube.
#[derive(Clone, Copy, Debug)]
struct Ring {
    center: DVec3,
    radius: f64,
    /// Unit direction of the axis.
    tangent: DVec3,
    /// Unit normal of the plane in which the cross-section lies.
    plane: DVec3,
    /// Growth of the radius per length of the axis.
    slope: f64,
    /// How far along the curve it lies, from 0 to 1: the first texture coordinate.
    along: f64,
    /// Whether it begins a piece of its own.
    first: bool,
}

/// Tubes about curves that are round across. Their ends are open.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tubes {
    rings: Vec<Ring>,
    /// Rings that begin no piece: each closes a band of triangles.
    bands: u64,
}

/// The point of a cubic Bezier curve at `t` in [0, 1], and the derivative by `t` (de Casteljau). The fourth coordinate is the radius.
pub(crate) fn cubic_bezier(control: &[DVec4; 4], t: f64) -> (DVec4, DVec4) {
    let [a, b, c] = [0, 1, 2].map(|i| control[i].lerp(control[i + 1], t));
    let (d, e) = (a.lerp(b, t), b.lerp(c, t));
    (d.lerp(e, t), (e - d) * 3.0)
}

/// The Bezier form of each segment of a uniform cubic B-spline (Prautzsch, Boehm and Paluszny 2002, Bezier and B-Spline
/// Techniques, section 5.6).
pub(crate) fn b_spline_segments(points: &[DVec4]) -> impl Iterator<Item = [DVec4; 4]> {
    points.windows(4).map(|p| {
        [
            (p[0] + p[1] * 4.0 + p[2]) / 6.0,
            (p[1] * 2.0 + p[2]) / 3.0,
            (p[1] + p[2] * 2.0) / 3.0,
            (p[1] + p[2] * 4.0 + p[3]) / 6.0,
        ]
    })
}

impl Tubes {
    /// Adds a tube about cubic Bezier segments that join end to end.
    pub(crate) fn add_cubic(&mut self, segments: &[[DVec4; 4]]) {
        let mut first = true;
        for (index, segment) in segments.iter().enumerate() {
            let pieces = pieces(segment);
            let start = usize::from(index > 0);
            for step in start..=pieces {
                let t = step as f64 / pieces as f64;
                let (point, mut derivative) = cubic_bezier(segment, t);
                if derivative.truncate() == DVec3::ZERO {
                    // Where control points coincide the curve still has the direction of what comes next to it.
                    let inside = cubic_bezier(segment, t + 1e-3 * (0.5 - t)).0;
                    derivative = (inside - point) * (0.5 - t).signum();
                }
                let speed = derivative.truncate().length();
                if speed == 0.0 || !speed.is_finite() {
                    continue;
                }
                let tangent = derivative.truncate() / speed;
                self.push(Ring {
                    center: point.truncate(),
                    radius: point.w,
                    tangent,
                    plane: tangent,
                    slope: derivative.w / speed,
                    along: (index as f64 + t) / segments.len() as f64,
                    first: std::mem::take(&mut first),
                });
            }
        }
    }

    /// Adds a tube of straight pieces from point to point, mitred where they meet.
    pub(crate) fn add_straight(&mut self, points: &[DVec4]) {
        let mut points = points.to_vec();
        points.dedup_by(|a, b| a.truncate() == b.truncate());
        let directions: Vec<DVec3> = points
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).truncate().normalize_or(DVec3::Z))
            .collect();
        for (index, tangent) in directions.iter().enumerate() {
            let ends = [points[index], points[index + 1]];
            let length = (ends[1] - ends[0]).truncate().length();
            let neighbours = [
                index.checked_sub(1).map(|before| directions[before]),
                directions.get(index + 1).copied(),
            ];
            for end in 0..2 {
                let across = neighbours[end].map_or(*tangent, |other| mitre(*tangent, other));
                self.push(Ring {
                    center: ends[end].truncate(),
                    radius: ends[end].w,
                    tangent: *tangent,
                    plane: across,
                    slope: (ends[1].w - ends[0].w) / length,
                    along: (index + end) as f64 / directions.len() as f64,
                    first: end == 0,
                });
            }
        }
    }

    fn push(&mut self, ring: Ring) {
        self.bands += u64::from(!ring.first);
        self.rings.push(ring);
    }

    /// How many sides the tubes get, for their number of triangles to be bearable.
    pub(crate) fn sides(&self) -> u64 {
        let bearable = |sides: &&u64| 2 * **sides * self.bands <= MANY_TRIANGLES;
        *SIDES.iter().find(bearable).unwrap_or(&SIDES[SIDES.len() - 1])
    }

    /// Vertices and triangles of the mesh.
    pub(crate) fn counts(&self) -> [u64; 2] {
        let sides = self.sides();
        [self.rings.len() as u64 * (sides + 1), 2 * sides * self.bands]
    }

    /// The tubes as triangles with smooth normals.
    ///
    /// The first texture coordinate runs along the curve, the second about it; it begins where Mitsuba's does at the curve's start,
    /// and is carried along without twist. Corners lie as far outside the curve's radius as leaves a tube its mean width.
    pub(crate) fn mesh(&self) -> RawMesh {
        let sides = self.sides();
        let wide = (PI / sides as f64) / libm::sin(PI / sides as f64);
        let turns: Vec<(f64, f64)> = (0..=sides)
            .map(|side| TAU * (side % sides) as f64 / sides as f64)
            .map(|angle| (libm::cos(angle), libm::sin(angle)))
            .collect();
        let mut mesh = RawMesh::default();
        let (mut radial, mut before) = (DVec3::X, DVec3::ZERO);
        for (index, ring) in self.rings.iter().enumerate() {
            // A strand begins where the axis does not go on from the ring before.
            let begins = ring.first && (index == 0 || ring.center != self.rings[index - 1].center);
            radial = match begins {
                true => first_radial(ring.tangent),
                false => carried(radial, before, ring.tangent),
            };
            before = ring.tangent;
            let second = ring.tangent.cross(radial);
            for (side, (cos, sin)) in turns.iter().enumerate() {
                let outward = radial * *cos + second * *sin;
                let shift = -outward.dot(ring.plane) / ring.tangent.dot(ring.plane);
                let position = ring.center + (outward + ring.tangent * shift) * ring.radius * wide;
                let normal = (outward - ring.tangent * ring.slope).normalize_or(outward);
                mesh.positions.push(position.as_vec3());
                mesh.normals.push(normal.as_vec3());
                mesh.uvs.push(Vec2::new(ring.along as f32, side as f32 / sides as f32));
            }
            if ring.first {
                continue;
            }
            let row = (sides + 1) as u32;
            let this = index as u32 * row;
            for corner in this..this + row - 1 {
                let (a, b, c, d) = (corner - row, corner - row + 1, corner, corner + 1);
                mesh.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
        mesh
    }
}

/// Pieces of a cubic segment, so that its deviation from straight ones, an eighth of the second derivative times the square of the
/// step (Wang 1984), is small beside its radius.
fn pieces(segment: &[DVec4; 4]) -> usize {
    let bend = |i: usize| (segment[i] - segment[i + 1] * 2.0 + segment[i + 2]).length();
    let radius = segment.iter().map(|point| point.w).sum::<f64>() / 4.0;
    let pieces = (0.75 * bend(0).max(bend(1)) / (DEVIATION * radius)).sqrt();
    if pieces.is_nan() {
        return 1;
    }
    pieces.ceil().clamp(1.0, PIECES) as usize
}

/// The normal of the plane in which tubes along two directions meet; of the first's own cross-section where they all but turn back.
fn mitre(tangent: DVec3, other: DVec3) -> DVec3 {
    let middle = (tangent + other).normalize_or(tangent);
    if middle.dot(tangent) > 0.4 { middle } else { tangent }
}

/// The direction across a tube in which Mitsuba's second texture coordinate is 0.
fn first_radial(tangent: DVec3) -> DVec3 {
    let up = (DVec3::Z - tangent * tangent.z).normalize_or(DVec3::Y);
    up.cross(tangent).normalize_or(DVec3::X)
}

/// `radial`, which is perpendicular to `from`, turned as `from` is turned into `to` by the smallest rotation.
fn carried(radial: DVec3, from: DVec3, to: DVec3) -> DVec3 {
    let cosine = from.dot(to);
    let turned = radial - (from + to) * (radial.dot(to) / (1.0 + cosine));
    match cosine > -0.999 {
        true => (turned - to * turned.dot(to)).normalize_or(first_radial(to)),
        false => first_radial(to),
    }
}

/// Reads a file of curves.
pub(super) fn read(file: &MeshFile, kind: CurveKind, faults: &mut FileFaults) -> Result<Tubes, SceneError> {
    let mut strands = Strands {
        file,
        kind,
        tubes: Tubes::default(),
        points: Vec::new(),
    };
    match file.bytes.strip_prefix(BINARY) {
        Some(bytes) if matches!(kind, CurveKind::Hair(_)) => strands.binary(bytes)?,
        _ => strands.text(faults)?,
    }
    if strands.tubes.bands == 0 {
        return Err(file.broken(0, "the file holds no curve"));
    }
    Ok(strands.tubes)
}

/// How binary files of hair begin.
const BINARY: &[u8] = b"BINARY_HAIR";

struct Strands<'a, 'f> {
    file: &'a MeshFile<'f>,
    kind: CurveKind,
    tubes: Tubes,
    /// Points of the curve that is read.
    points: Vec<DVec4>,
}

impl Strands<'_, '_> {
    /// Points one a line; an empty line, or one that begins with `#`, ends a curve.
    fn text(&mut self, faults: &mut FileFaults) -> Result<(), SceneError> {
        let mut end = 0;
        for (number, line) in text::lines(self.file.bytes) {
            let line = line.trim_ascii();
            end = number;
            if line.is_empty() || line.starts_with(b"#") {
                if let Err(fault) = self.finish(number) {
                    faults.note(fault)?;
                }
                continue;
            }
            match self.point(line) {
                Ok(point) => self.points.push(point),
                Err(reason) => faults.note(self.file.broken(number, reason))?,
            }
        }
        self.finish(end)
    }

    fn point(&self, line: &[u8]) -> Result<DVec4, String> {
        let text = std::str::from_utf8(line).map_err(|_| "the line is no text".to_owned())?;
        let mut words = text.split_ascii_whitespace();
        let mut number = |what: &str| -> Result<f64, String> {
            let word = words.next().ok_or_else(|| format!("the {what} is missing"))?;
            match word.parse::<f32>() {
                Ok(value) if value.is_finite() => Ok(f64::from(value)),
                _ => Err(format!("{what}: `{}` is not a finite number", shortened(word))),
            }
        };
        let position = DVec3::new(number("x")?, number("y")?, number("z")?);
        let radius = match self.kind {
            CurveKind::Hair(radius) => radius,
            _ => number("radius")?,
        };
        if radius < 0.0 {
            return Err(format!("the radius is {radius}; allowed: 0 and above"));
        }
        Ok(position.extend(radius))
    }

    /// The number of points, then their coordinates in single precision; an infinity before a point begins a curve.
    fn binary(&mut self, bytes: &[u8]) -> Result<(), SceneError> {
        let CurveKind::Hair(radius) = self.kind else {
            return Ok(());
        };
        let (words, _) = bytes.as_chunks::<4>();
        let Some((count, words)) = words.split_first() else {
            return Err(self.file.broken(0, "the file ends too early"));
        };
        let count = u32::from_le_bytes(*count);
        self.file.check_vertices(u64::from(count))?;
        let mut numbers = words.iter().map(|word| f32::from_le_bytes(*word));
        let mut next = || {
            numbers
                .next()
                .ok_or_else(|| self.file.broken(0, "the file ends too early"))
        };
        let mut curves = vec![Vec::new()];
        for index in 0..count {
            let mut x = next()?;
            if x.is_infinite() {
                curves.push(Vec::new());
                x = next()?;
            }
            let point = Vec3::new(x, next()?, next()?);
            if !point.is_finite() {
                return Err(self.file.broken(0, format!("point {index} is not finite")));
            }
            if let Some(curve) = curves.last_mut() {
                curve.push(point.as_dvec3().extend(radius));
            }
        }
        for curve in curves {
            self.points = curve;
            self.finish(0)?;
        }
        Ok(())
    }

    /// Ends a curve; `line` is where.
    fn finish(&mut self, line: u32) -> Result<(), SceneError> {
        let points = std::mem::take(&mut self.points);
        let (least, name) = match self.kind {
            CurveKind::BSpline => (4, "a B-spline"),
            CurveKind::Linear => (2, "a curve"),
            CurveKind::Hair(_) => (0, "a hair"),
        };
        if !points.is_empty() && points.len() < least {
            let reason = format!("{name} has {} points; it needs at least {least}", points.len());
            return Err(self.file.broken(line, reason));
        }
        match self.kind {
            CurveKind::BSpline => {
                let segments: Vec<_> = b_spline_segments(&points).collect();
                self.tubes.add_cubic(&segments);
            }
            _ => self.tubes.add_straight(&points),
        }
        let [vertices, triangles] = self.tubes.counts();
        self.file.check_vertices(vertices)?;
        self.file.check_triangles(triangles).map(|_| ())
    }
}
