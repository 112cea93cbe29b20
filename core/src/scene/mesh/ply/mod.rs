//! PLY, in text and both binary byte orders: `vertex` with `x y z`, `nx ny nz`, `u v` (or `s t`), and `face` with
//! `vertex_indices` (or `vertex_index`). Polygons become fans. Attributes of vertices and faces that are asked for have Mitsuba's names;
//! other elements and properties are skipped.

mod attributes;
mod body;
mod header;
#[cfg(test)]
mod tests;

use super::{MeshFile, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::SceneError;
use crate::scene::faults::FileFaults;
use attributes::{attributes, columns, keep};
use body::Body;
use header::{Element, header};
use std::collections::BTreeSet;

pub(super) fn read(file: &MeshFile, flip_v: bool, faults: &mut FileFaults) -> Result<RawMesh, SceneError> {
    let header = header(file)?;
    let mut body = Body {
        file,
        encoding: header.encoding,
        rest: &file.bytes[header.bytes..],
        line_end: header.line_end,
        line: header.lines + 1,
        faults,
    };
    let mut mesh = RawMesh::default();
    for element in &header.elements {
        body.check_count(element)?;
        match element.name.as_str() {
            "vertex" => vertices(&mut body, element, flip_v, &mut mesh)?,
            "face" => faces(&mut body, element, &mut mesh)?,
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.count {
                    body.record(element, |_, _| Ok(()), |_, _| Ok(()))?;
                }
            }
        }
    }
    if mesh.positions.is_empty() {
        return Err(file.broken(0, "the file has no vertices"));
    }
    let count = mesh.positions.len() as u32;
    let corners = || mesh.triangles.iter().flatten();
    let beyond = match corners().max() {
        Some(largest) if *largest >= count => corners().filter(|index| **index >= count).collect(),
        _ => BTreeSet::new(),
    };
    for bad in beyond {
        let reason = format!("vertex index {bad} is out of range: the file has {count} vertices");
        body.faults.note(file.broken(0, reason))?;
    }
    Ok(mesh)
}

fn vertices(body: &mut Body, element: &Element, flip_v: bool, mesh: &mut RawMesh) -> Result<(), SceneError> {
    if !mesh.positions.is_empty() {
        return Err(body.broken("two elements are named `vertex`"));
    }
    let count = body.file.check_vertices(element.count)? as usize;
    let place =
        columns(element, ["x", "y", "z"]).ok_or_else(|| body.broken("vertices have no properties x, y and z"))?;
    let normal = columns(element, ["nx", "ny", "nz"]);
    let uv = columns(element, ["u", "v"]).or_else(|| columns(element, ["s", "t"]));
    let asked = attributes(body.file, element, "vertex_");
    let mut values = vec![Vec::new(); asked.len()];
    let used: BTreeSet<usize> = place
        .into_iter()
        .chain(normal.into_iter().flatten())
        .chain(uv.into_iter().flatten())
        .chain(asked.iter().flat_map(|attribute| attribute.columns.iter().copied()))
        .collect();
    let used = Vec::from_iter(used);
    let mut row = vec![0.0_f32; element.properties.len()];
    if let Some(rows) = body.rows(element)? {
        mesh.positions = rows.groups(place).map(Vec3::from_array).collect();
        mesh.normals = normal.map_or(Vec::new(), |normal| rows.groups(normal).map(Vec3::from_array).collect());
        mesh.uvs = uv.map_or(Vec::new(), |uv| rows.groups(uv).map(Vec2::from_array).collect());
        let finite = mesh
            .positions
            .iter()
            .chain(&mesh.normals)
            .all(|vector| vector.is_finite())
            && mesh.uvs.iter().all(|uv| uv.is_finite());
        if !finite || !asked.is_empty() {
            for index in 0..count {
                used.iter()
                    .for_each(|column| row[*column] = rows.number(index, *column) as f32);
                note_infinite(body, element, index, &used, &row)?;
                for (values, attribute) in values.iter_mut().zip(&asked) {
                    values.push(attribute.value(&row));
                }
            }
        }
    } else {
        mesh.positions.reserve_exact(count);
        mesh.normals.reserve_exact(if normal.is_some() { count } else { 0 });
        mesh.uvs.reserve_exact(if uv.is_some() { count } else { 0 });
        for index in 0..count {
            let store = |column: usize, number: f64| {
                row[column] = number as f32;
                Ok(())
            };
            body.record(element, store, |_, _| Ok(()))?;
            note_infinite(body, element, index, &used, &row)?;
            mesh.positions.push(Vec3::from_array(place.map(|column| row[column])));
            let normal = normal.map(|normal| Vec3::from_array(normal.map(|column| row[column])));
            mesh.normals.extend(normal);
            mesh.uvs.extend(uv.map(|[u, v]| Vec2::new(row[u], row[v])));
            for (values, attribute) in values.iter_mut().zip(&asked) {
                values.push(attribute.value(&row));
            }
        }
    }
    // A normal without direction is a missing one.
    mesh.normals
        .iter_mut()
        .for_each(|normal| *normal = normal.normalize_or_zero());
    if flip_v {
        mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
    }
    keep(mesh, asked, values, false);
    Ok(())
}

/// Notes the numbers of a vertex that are not finite.
fn note_infinite(
    body: &mut Body,
    element: &Element,
    vertex: usize,
    used: &[usize],
    row: &[f32],
) -> Result<(), SceneError> {
    for column in used.iter().filter(|column| !row[**column].is_finite()) {
        let (name, number) = (&element.properties[*column].name, row[*column]);
        body.note(Err(format!(
            "vertex {vertex}: `{name}` is {number}, not a finite number"
        )))?;
    }
    Ok(())
}

fn faces(body: &mut Body, element: &Element, mesh: &mut RawMesh) -> Result<(), SceneError> {
    body.file.check_triangles(element.count)?;
    let list = element.properties.iter().position(|property| {
        property.length.is_some() && ["vertex_indices", "vertex_index"].contains(&property.name.as_str())
    });
    let list = list.ok_or_else(|| body.broken("faces have no list `vertex_indices`"))?;
    let asked = attributes(body.file, element, "face_");
    let mut values = vec![Vec::new(); asked.len()];
    let mut row = vec![0.0_f32; element.properties.len()];
    let (mut corners, mut polygon): (Vec<f64>, Vec<u32>) = Default::default();
    mesh.triangles.reserve_exact(element.count as usize);
    // Where no attribute is asked for, lists of a binary file are read without what is beside them.
    let layout = body.list_layout(element, list).filter(|_| asked.is_empty());
    let mut faces = 0..element.count;
    loop {
        if let Some(layout) = &layout {
            faces.start += body.triangles(layout, faces.end - faces.start, &mut mesh.triangles);
        }
        let Some(index) = faces.next() else { break };
        polygon.clear();
        corners.clear();
        if let Some(layout) = &layout {
            body.list(layout, &mut corners)?;
        } else {
            let value = |column: usize, number: f64| {
                row[column] = number as f32;
                let used = asked.iter().any(|attribute| attribute.columns.contains(&column));
                if used && !row[column].is_finite() {
                    let name = &element.properties[column].name;
                    return Err(format!("face {index}: `{name}` is {number}, not a finite number"));
                }
                Ok(())
            };
            let item = |column: usize, number: f64| {
                if column == list {
                    corners.push(number);
                }
                Ok(())
            };
            body.record(element, value, item)?;
        }
        for corner in &corners {
            // A broken corner counts as one, so that no other fault follows from it.
            let vertex = *corner as u32;
            let valid = f64::from(vertex) == *corner;
            polygon.push(if valid { vertex } else { 0 });
            if !valid {
                body.note(Err(format!("face {index}: {corner} is not a vertex index")))?;
            }
        }
        if polygon.len() < 3 {
            let reason = format!("face {index} has {} corners; 3 or more are needed", polygon.len());
            body.note(Err(reason))?;
            continue;
        }
        body.file
            .check_triangles((mesh.triangles.len() + polygon.len()) as u64)?;
        match polygon[..] {
            [a, b, c] => mesh.triangles.push([a, b, c]),
            _ => mesh
                .triangles
                .extend(polygon[1..].windows(2).map(|pair| [polygon[0], pair[0], pair[1]])),
        }
        for (values, attribute) in values.iter_mut().zip(&asked) {
            values.resize(mesh.triangles.len(), attribute.value(&row));
        }
    }
    keep(mesh, asked, values, true);
    Ok(())
}
