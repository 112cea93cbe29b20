//! Line plots as PNG. The font comes with the program: nothing of the system is needed.

mod axis;

use anyhow::{Context, Result, anyhow};
use axis::Axis;
pub(crate) use axis::Scale;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::path::Path;
use std::sync::Once;

/// Size of one chart \[pixels\].
const SIZE: (u32, u32) = (640, 480);

const FONT: &str = "sans-serif";

/// Colours of series, in order, told apart by the colour-blind too (Okabe and Ito 2008).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(60, 60, 60),
];

/// Red, green and blue of series with the number `index`.
pub(crate) fn colour(index: usize) -> [u8; 3] {
    let RGBColor(r, g, b) = COLOURS[index % COLOURS.len()];
    [r, g, b]
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stroke {
    /// A dashed line through the points: what is expected rather than measured.
    Dashes,
    /// A dot at each point and a line through them.
    Dots,
}

/// One curve.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    /// Its name in the legend; none is shown for an empty one.
    pub(crate) name: String,
    /// Points (x, y) from left to right. On a logarithmic axis those that are not positive are left out.
    pub(crate) points: Vec<(f64, f64)>,
    /// Lower and upper end of the confidence interval at each point; empty, or one for each point.
    pub(crate) band: Vec<(f64, f64)>,
    /// How it is drawn.
    pub(crate) stroke: Stroke,
    /// Which colour: series with the same number look alike.
    pub(crate) colour: usize,
}

impl Series {
    /// A curve without a band.
    pub(crate) fn new(name: impl Into<String>, stroke: Stroke, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            points,
            band: Vec::new(),
            stroke,
            colour,
        }
    }
}

/// One pair of axes with its curves.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    /// Heading.
    pub(crate) title: String,
    /// What x is, with its unit.
    pub(crate) x: String,
    /// What y is, with its unit.
    pub(crate) y: String,
    /// Scales of x and of y.
    pub(crate) scales: (Scale, Scale),
    /// Curves; the first is drawn lowest.
    pub(crate) series: Vec<Series>,
}

/// Writes `charts` to the PNG `path`, `columns` in a row, from left to right and top to bottom.
///
/// # Errors
/// A chart without a point that can be drawn, or a file that cannot be written.
pub(crate) fn write(path: &Path, charts: &[Chart], columns: usize) -> Result<()> {
    let rows = charts.len().div_ceil(columns);
    let (width, height) = (SIZE.0 * columns as u32, SIZE.1 * rows as u32);
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        area.fill(&WHITE)?;
        for (area, chart) in area.split_evenly((rows, columns)).iter().zip(charts) {
            draw(area, chart).with_context(|| format!("cannot draw {:?}", chart.title))?;
        }
        area.present()?;
    }
    image::save_buffer(path, &pixels, width, height, image::ExtendedColorType::Rgb8)
        .with_context(|| format!("cannot write {}", path.display()))
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

fn draw(area: &Area, chart: &Chart) -> Result<()> {
    static FONTS: Once = Once::new();
    FONTS.call_once(|| {
        let registered = register_font(FONT, FontStyle::Normal, dejavu::sans::regular());
        assert!(registered.is_ok(), "the font that comes with the program is one");
    });
    let values = |pick: fn(&(f64, f64)) -> f64| {
        chart
            .series
            .iter()
            .flat_map(move |s| s.points.iter().map(pick))
            .collect::<Vec<_>>()
    };
    let mut y_values = values(|p| p.1);
    y_values.extend(chart.series.iter().flat_map(|s| s.band.iter().flat_map(|b| [b.0, b.1])));
    let axis = |scale, values: &[f64]| Axis::around(scale, values).ok_or_else(|| anyhow!("there is nothing to show"));
    let (x_axis, y_axis) = (
        axis(chart.scales.0, &values(|p| p.0))?,
        axis(chart.scales.1, &y_values)?,
    );

    let mut context = ChartBuilder::on(area)
        .caption(&chart.title, (FONT, 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(x_axis.clone(), y_axis.clone())?;
    context
        .configure_mesh()
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .axis_desc_style((FONT, 15))
        .label_style((FONT, 13))
        .bold_line_style(BLACK.mix(0.15))
        .light_line_style(TRANSPARENT)
        .draw()?;
    let shown = |x: f64, y: f64| x_axis.shows(x) && y_axis.shows(y);
    for series in &chart.series {
        let colour = COLOURS[series.colour % COLOURS.len()];
        let band = series.points.iter().zip(&series.band);
        let (lower, upper): (Vec<_>, Vec<_>) = band
            .filter(|(p, b)| x_axis.shows(p.0) && y_axis.shows(b.1))
            .map(|(p, b)| ((p.0, y_axis.clamp(b.0)), (p.0, b.1)))
            .unzip();
        let outline: Vec<_> = upper.into_iter().chain(lower.into_iter().rev()).collect();
        context.draw_series(std::iter::once(Polygon::new(outline, colour.mix(0.2))))?;

        let points: Vec<_> = series.points.iter().copied().filter(|p| shown(p.0, p.1)).collect();
        let style = colour.stroke_width(2);
        let drawn = match series.stroke {
            Stroke::Dashes => context.draw_series(DashedLineSeries::new(points.iter().copied(), 6, 5, style))?,
            Stroke::Dots => context.draw_series(LineSeries::new(points.iter().copied(), style))?,
        };
        if !series.name.is_empty() {
            let dashed = series.stroke == Stroke::Dashes;
            drawn.label(&series.name).legend(move |(x, y)| {
                let right = if dashed { x + 8 } else { x + 20 };
                PathElement::new(vec![(x, y), (right, y)], style)
            });
        }
        if series.stroke == Stroke::Dots {
            context.draw_series(points.iter().map(|&p| Circle::new(p, 3, colour.filled())))?;
        }
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

    #[test]
    fn a_chart_becomes_a_picture_with_its_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plot.png");
        let points = vec![(1.0, 0.1), (10.0, 0.01), (100.0, 0.0)];
        let chart = Chart {
            title: "test".into(),
            x: "N".into(),
            y: "error".into(),
            scales: (Scale::Log, Scale::Log),
            series: vec![Series {
                band: vec![(-1.0, 0.2), (0.005, 0.02), (0.0, 0.0)],
                ..Series::new("a", Stroke::Dots, 1, points)
            }],
        };
        write(&path, &[chart.clone(), chart], 2).unwrap();
        let picture = image::open(&path).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (2 * SIZE.0, SIZE.1));
        let [r, g, b] = [COLOURS[1].0, COLOURS[1].1, COLOURS[1].2];
        assert!(picture.pixels().filter(|p| p.0 == [r, g, b]).count() > 500);
    }

    #[test]
    fn a_chart_of_nothing_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let chart = Chart {
            title: "empty".into(),
            x: String::new(),
            y: String::new(),
            scales: (Scale::Linear, Scale::Log),
            series: vec![Series::new("", Stroke::Dots, 0, vec![(1.0, 0.0)])],
        };
        assert!(write(&folder.path().join("plot.png"), &[chart], 1).is_err());
    }
}
