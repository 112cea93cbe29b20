//! Curves, as tubes. Files of hair have a directive for each strand: strands that follow each other and are alike make one mesh.

use super::Reading;
use super::parameter::Parameters;
use super::shape::Made;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::mesh::{Tubes, b_spline_segments};
use glam::{DMat4, DVec4};
use std::rc::Rc;

/// Curves that make one mesh.
pub(super) struct Strands {
    tubes: Tubes,
    alike: Alike,
    light: Option<Rc<Parameters>>,
    /// The first curve's place.
    place: Place,
}

/// What curves must have in common to make one mesh.
#[derive(PartialEq)]
struct Alike {
    to_world: [DMat4; 2],
    material: ObjectId,
    group: Option<ObjectId>,
}

const CURVE: &str = "Shape \"curve\"";

impl Reading<'_, '_> {
    /// Adds a curve to those before it, or begins a mesh.
    pub(super) fn curve(&mut self, parameters: &mut Parameters) -> Result<(), SceneError> {
        let Some(segments) = segments(parameters)? else {
            return Ok(());
        };
        match parameters.text("type")? {
            Some("cylinder") => {}
            Some("ribbon") => parameters.warn("ribbons are rendered as tubes of their width"),
            Some("flat") | None => {
                parameters.warn("curves that face the camera are rendered as tubes, which look as wide and are round");
            }
            Some(_) => _ = parameters.fault::<()>("type", "allowed: flat, ribbon, cylinder")?,
        }
        if parameters.has("alpha") {
            parameters.warn_of("alpha", "curves are solid");
        }
        parameters.ignore(&["alpha", "splitdepth", "N"]);
        parameters.finish();
        let alike = Alike {
            to_world: self.state.to_world,
            material: match self.state.material {
                Some(material) => material,
                None => self.default_material(),
            },
            group: self.group,
        };
        let light = self.state.area_light.clone();
        let goes_on = self.strands.as_ref().is_some_and(|strands| {
            strands.alike == alike && strands.light.as_ref().map(Rc::as_ptr) == light.as_ref().map(Rc::as_ptr)
        });
        if !goes_on {
            self.finish_strands()?;
            self.count_shape(&parameters.place)?;
        }
        let strands = self.strands.get_or_insert_with(|| Strands {
            tubes: Tubes::default(),
            alike,
            light,
            place: parameters.place.clone(),
        });
        strands.tubes.add_cubic(&segments);
        let [vertices, triangles] = strands.tubes.counts();
        let limits = self.loader.limits;
        let place = &parameters.place;
        within(place, "number of vertices of the scene", vertices, limits.vertices)?;
        within(place, "number of triangles of the scene", triangles, limits.triangles).map(|_| ())
    }

    /// Makes the mesh of the curves so far.
    pub(super) fn finish_strands(&mut self) -> Result<(), SceneError> {
        let Some(strands) = self.strands.take() else {
            return Ok(());
        };
        let Strands {
            tubes,
            alike,
            light,
            place,
        } = strands;
        let mesh = tubes.mesh();
        if mesh.triangles.is_empty() {
            self.warnings
                .note(&place, format!("{CURVE}: it has no length and is left out"));
            return Ok(());
        }
        let shape = self.draft.add(Kind::Shape, "mesh", Some(CURVE), &place);
        self.set_to_world(shape, alike.to_world)?;
        self.draft.set(shape, "mesh", Value::Mesh(mesh.into()));
        self.draft.link(shape, None, alike.material);
        if let Some(light) = light {
            // The curves shine as one.
            let (object, lights) = (shape, 1);
            self.light_up(Made { object, lights }, &light, alike.group, &place)?;
        }
        self.draft.link(alike.group.unwrap_or(0), None, shape);
        Ok(())
    }
}

/// The cubic Bezier segments of a curve, whose fourth coordinate is the radius (`Curve::Create`).
fn segments(parameters: &mut Parameters) -> Result<Option<Vec<[DVec4; 4]>>, SceneError> {
    let points = parameters.take_vectors("P")?;
    let degree = parameters.integer("degree")?.unwrap_or(3);
    let width = parameters.float_or("width", 1.0)?;
    let widths = [
        parameters.float_or("width0", width)?,
        parameters.float_or("width1", width)?,
    ];
    let spline = match parameters.text("basis")? {
        Some("bspline") => true,
        Some("bezier") | None => false,
        Some(_) => return parameters.fault("basis", "allowed: bezier, bspline"),
    };
    let points: Vec<DVec4> = points.iter().map(|point| point.as_dvec3().extend(0.0)).collect();
    let step = degree as usize;
    let mut segments: Vec<[DVec4; 4]> = match (degree, spline) {
        (2 | 3, false) if points.len() > step && (points.len() - 1).is_multiple_of(step) => {
            let starts = (0..points.len() - 1).step_by(step);
            starts.map(|first| cubic(&points[first..=first + step])).collect()
        }
        // The Bezier form of each segment of a uniform quadratic B-spline: it runs from middle to middle of the legs.
        (2, true) if points.len() > 2 => {
            let middle = |i: usize| 0.5 * (points[i] + points[i + 1]);
            let segment = |i: usize| cubic(&[middle(i), points[i + 1], middle(i + 1)]);
            (0..points.len() - 2).map(segment).collect()
        }
        (3, true) if points.len() > 3 => b_spline_segments(&points).collect(),
        (2 | 3, _) => return parameters.fault("P", format!("{} points make no such curve", points.len())),
        _ => return parameters.fault("degree", format!("{degree} is out of range; allowed: 2 and 3")),
    };
    let count = segments.len() as f64;
    for (index, segment) in segments.iter_mut().enumerate() {
        for (corner, point) in segment.iter_mut().enumerate() {
            let along = (index as f64 + corner as f64 / 3.0) / count;
            point.w = 0.5 * (widths[0] + (widths[1] - widths[0]) * along).max(0.0);
        }
    }
    Ok(Some(segments))
}

/// The cubic form of a Bezier curve of degree 2 or 3.
fn cubic(points: &[DVec4]) -> [DVec4; 4] {
    match *points {
        [a, b, c] => [a, (a + b * 2.0) / 3.0, (b * 2.0 + c) / 3.0, c],
        [a, b, c, d] => [a, b, c, d],
        _ => [DVec4::ZERO; 4],
    }
}
