//! Curves and height fields, which become meshes.

use super::Builder;
use crate::geometry::Shape;
use crate::math::{Transform, Vec2};
use crate::scene::error::SceneError;
use crate::scene::image;
use crate::scene::linear_image::Reading;
use crate::scene::mesh::{self, CurveKind, MeshFile, RawMesh};
use crate::scene::reader::{ANY, POSITIVE, Reader};

impl Builder<'_, '_> {
    /// A file of curves as tubes.
    pub(super) fn curves(&mut self, reader: &Reader, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
        let kind = match reader.object.plugin.as_str() {
            "bsplinecurve" => CurveKind::BSpline,
            "linearcurve" => CurveKind::Linear,
            _ => {
                reader.accept(&["angle_threshold"]);
                CurveKind::Hair(reader.float_or("radius", POSITIVE, 0.025)?)
            }
        };
        reader.property("filename");
        if matches!(kind, CurveKind::Hair(_)) && reader.float("reduction", 0.0..=1.0)?.is_some_and(|part| part > 0.0) {
            reader.warn_of("reduction", "all hair is rendered");
        }
        reader.finish();
        let file = self.file(reader)?;
        let source = MeshFile::new(&file, self.loader.limits, self.meshes);
        self.meshes.bytes += file.bytes.len() as u64;
        let tubes = source.curves(kind);
        let tubes = tubes.map_err(|found| self.description.faults.all_but_last(found))?;
        let message = format!(
            "the curves are rendered as tubes of {} sides, open at their ends",
            tubes.sides()
        );
        reader.warn(reader.place(), message);
        let mesh = self.placed_mesh(reader, tubes.mesh(), to_world, flip)?;
        Ok(Shape::Mesh(mesh.into()))
    }

    /// The square [-1, 1]^2 raised along z by an image, as in Mitsuba 0.x: each pixel is a vertex.
    pub(super) fn height_field(
        &mut self,
        reader: &Reader,
        to_world: &Transform,
        flip: bool,
    ) -> Result<Shape, SceneError> {
        let scale = reader.float_or("scale", ANY, 1.0)? as f32;
        let smooth = reader.boolean("shading_normals", true)?;
        reader.property("filename");
        reader.finish();
        let file = self.file(reader)?;
        let image = image::read(&file, &Reading::COLOURS, self.texels_left())
            .map_err(|found| self.description.faults.all_but_last(found))?;
        self.texels += image.texels.len() as u64;
        let (width, height) = (image.width, image.height);
        if width < 2 || height < 2 {
            let reason = format!("the image has {width} x {height} pixels; a height field needs at least 2 x 2");
            return Err(reader.wrong("filename", reason));
        }
        let (columns, rows) = ((width - 1) as u64, (height - 1) as u64);
        self.count_mesh(reader.place(), (columns + 1) * (rows + 1), 2 * columns * rows)?;
        let mut raw = RawMesh::default();
        for (index, texel) in image.texels.iter().enumerate() {
            let at = [index % width, index / width];
            let uv = Vec2::new(at[0] as f32 / (width - 1) as f32, at[1] as f32 / (height - 1) as f32);
            raw.positions
                .push((uv * 2.0 - Vec2::ONE).extend(scale * texel.luminance()));
            raw.uvs.push(uv);
            if at[0] + 1 < width && at[1] + 1 < height {
                let [a, b, c, d] = [0, 1, width, width + 1].map(|step| (index + step) as u32);
                raw.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        let finished = mesh::finish(raw, to_world, !smooth, flip);
        let (mesh, _) = finished.map_err(|reason| reader.wrong("to_world", reason))?;
        Ok(Shape::Mesh(mesh.into()))
    }
}
