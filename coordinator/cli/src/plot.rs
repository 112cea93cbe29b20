//! Curves on logarithmic axes as PNG. The font comes with the program: nothing of the system is needed.

use anyhow::{Context, Result, anyhow, ensure};
use plotters::prelude::*;
use plotters::style::register_font;
use std::io::Cursor;
use std::sync::OnceLock;

/// Size of one chart \[pixels\].
const SIZE: (u32, u32) = (640, 480);
const FONT: &str = "sans-serif";
/// Colours of curves, told apart by the colour-blind too (Okabe and Ito 2008).
const COLOURS: [RGBColor; 4] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
];

/// One pair of logarithmic axes with its curves. Points that are not above zero are left out.
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) x: &'static str,
    /// Name of each curve, and its points.
    pub(crate) curves: Vec<(&'static str, Vec<(f64, f64)>)>,
}

/// The charts side by side, as a PNG.
pub(crate) fn png(charts: &[Chart]) -> Result<Vec<u8>> {
    static FONTS: OnceLock<bool> = OnceLock::new();
    let registered = FONTS.get_or_init(|| register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok());
    ensure!(registered, "the font of the program cannot be read");
    let (width, height) = (SIZE.0 * charts.len() as u32, SIZE.1);
    let mut samples = vec![0; 3 * width as usize * height as usize];
    {
        let area = BitMapBackend::with_buffer(&mut samples, (width, height)).into_drawing_area();
        area.fill(&WHITE)?;
        for (area, chart) in area.split_evenly((1, charts.len())).iter().zip(charts) {
            draw(area, chart).with_context(|| format!("cannot draw {:?}", chart.title))?;
        }
        area.present()?;
    }
    let mut file = Cursor::new(Vec::new());
    let kind = image::ExtendedColorType::Rgb8;
    image::write_buffer_with_format(&mut file, &samples, width, height, kind, image::ImageFormat::Png)?;
    Ok(file.into_inner())
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

fn draw(area: &Area, chart: &Chart) -> Result<()> {
    let shown = |point: &&(f64, f64)| [point.0, point.1].iter().all(|value| *value > 0.0 && value.is_finite());
    let points = || chart.curves.iter().flat_map(|(_, points)| points).filter(shown);
    let range = |values: &mut dyn Iterator<Item = f64>| {
        let ends = values.fold(None, |ends: Option<(f64, f64)>, value| match ends {
            Some((low, high)) => Some((low.min(value), high.max(value))),
            None => Some((value, value)),
        });
        ends.map(|(low, high)| (low / 1.2)..(high * 1.2))
            .ok_or_else(|| anyhow!("there is nothing to show"))
    };
    let x = range(&mut points().map(|point| point.0))?;
    let y = range(&mut points().map(|point| point.1))?;
    let mut context = ChartBuilder::on(area)
        .caption(&chart.title, (FONT, 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(x.log_scale(), y.log_scale())?;
    context
        .configure_mesh()
        .x_desc(chart.x)
        .y_desc("error")
        .axis_desc_style((FONT, 15))
        .label_style((FONT, 13))
        .bold_line_style(BLACK.mix(0.15))
        .light_line_style(TRANSPARENT)
        .x_label_formatter(&|value| format!("{value}"))
        .y_label_formatter(&|value| format!("{value:.0e}"))
        .draw()?;
    for (index, (name, points)) in chart.curves.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let points: Vec<_> = points.iter().filter(shown).copied().collect();
        let style = colour.stroke_width(2);
        context
            .draw_series(LineSeries::new(points.iter().copied(), style))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 20, y)], style));
        context.draw_series(points.iter().map(|point| Circle::new(*point, 3, colour.filled())))?;
    }
    context
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font((FONT, 13))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> Chart {
        Chart {
            title: "test".into(),
            x: "iterations",
            curves: vec![("MSE", points)],
        }
    }

    #[test]
    fn charts_become_a_picture_with_their_colours() {
        let points = vec![(1.0, 0.1), (10.0, 0.01), (100.0, 0.0)];
        let bytes = png(&[chart(points.clone()), chart(points)]).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (2 * SIZE.0, SIZE.1));
        let RGBColor(r, g, b) = COLOURS[0];
        assert!(picture.pixels().filter(|p| p.0 == [r, g, b]).count() > 300);
        assert!(png(&[chart(vec![(1.0, 0.0)])]).is_err());
    }
}
