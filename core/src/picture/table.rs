//! Pictures as tables, for what sensors measure.

use crate::scene::Scene;
use crate::sensor::Projection;
use crate::spectrum::Spectrum;
use std::fmt::Write;

/// A picture of `width` pixels across by the sensor of `scene` as comma-separated values: a line for each pixel, row by row from the top
/// left, with its row and column in the whole picture from 0, its linear Rec. 709 channels, and their luminance. The first line names the columns.
#[must_use]
pub fn encode_csv(scene: &Scene, width: u32, pixels: &[Spectrum]) -> String {
    let measured = match scene.sensor.projection {
        Projection::Irradiance { .. } => "illuminance [lux",
        Projection::Perspective { .. } | Projection::Orthographic | Projection::Spherical => "luminance [cd/m^2",
    };
    let mut table = format!("row,column,red,green,blue,{measured} of lights in candela and lengths in metres]\n");
    let [left, above] = scene.film.window.map_or([0; 2], |window| [window.x, window.y]);
    for (index, pixel) in pixels.iter().enumerate() {
        let (row, column) = (index / width as usize, index % width as usize);
        let (row, column) = (row + above as usize, column + left as usize);
        let [red, green, blue] = pixel.to_rgb();
        let _ = writeln!(table, "{row},{column},{red},{green},{blue},{}", pixel.luminance());
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Limits;
    use std::collections::BTreeMap;

    #[test]
    fn a_pixel_is_a_line() {
        let load = |body: &str| {
            let text = format!("<scene version='3.0.0'>{body}</scene>");
            let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
            Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap()
        };
        let pixels = [
            Spectrum::from_rgb([1.0, 2.0, 0.5]),
            Spectrum::ZERO,
            Spectrum::splat(1e-3),
            Spectrum::splat(20.0),
        ];
        let meter = load("<shape type='rectangle'><sensor type='irradiancemeter'/></shape>");
        let table = encode_csv(&meter, 2, &pixels);
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(
            lines[0],
            "row,column,red,green,blue,illuminance [lux of lights in candela and lengths in metres]"
        );
        assert_eq!(lines[1], format!("0,0,1,2,0.5,{}", pixels[0].luminance()));
        assert_eq!(
            lines[2..],
            ["0,1,0,0,0,0", "1,0,0.001,0.001,0.001,0.001", "1,1,20,20,20,20"]
        );
        let camera = load("<sensor type='perspective'/><shape type='sphere'/>");
        assert!(encode_csv(&camera, 2, &pixels).starts_with("row,column,red,green,blue,luminance [cd/m^2 of"));
    }
}
