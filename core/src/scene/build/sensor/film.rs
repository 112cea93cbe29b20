//! Films, reconstruction filters and samplers.

use crate::film::Filter;
use crate::scene::Limits;
use crate::scene::description::{Description, Kind};
use crate::scene::error::{SceneError, within};
use crate::scene::reader::Reader;

/// A film: the window of an image that is rendered.
pub(super) struct Frame {
    /// Size of the image \[pixels\].
    pub(super) whole: [u32; 2],
    /// Where the window begins.
    pub(super) offset: [u32; 2],
    /// Size of the window.
    pub(super) size: [u32; 2],
    pub(super) filter: Filter,
}

impl Frame {
    pub(super) fn whole(size: [u32; 2]) -> Self {
        Self {
            whole: size,
            offset: [0, 0],
            size,
            filter: DEFAULT_FILTER,
        }
    }

    pub(super) fn is_whole(&self) -> bool {
        self.size == self.whole
    }
}

/// Films, which are all the same here.
const FILMS: [&str; 5] = ["hdrfilm", "ldrfilm", "tiledhdrfilm", "mfilm", "specfilm"];

/// What Mitsuba's films of all ages say of files, of their looks on a screen and of borders.
const FILM_WITHOUT_EFFECT: [&str; 25] = [
    "alpha",
    "attach_log",
    "banner",
    "burn",
    "channel_names",
    "compensate",
    "component_format",
    "contrast",
    "digits",
    "exposure",
    "file_format",
    "filename",
    "gamma",
    "has_alpha",
    "high_quality_edges",
    "key",
    "label",
    "pixel_format",
    "render_time_annotation",
    "sample_border",
    "tonemap_method",
    "variable",
    "view",
    "white_point",
    "write_xyz",
];

pub(super) const DEFAULT_RESOLUTION: [u32; 2] = [768, 576];
pub(super) const DEFAULT_FILTER: Filter = Filter::Gaussian { stddev: 0.5 };

pub(super) fn film_settings(reader: &Reader, description: &Description, limits: &Limits) -> Result<Frame, SceneError> {
    match reader.object.plugin.as_str() {
        "hdrfilm" => {}
        "ldrfilm" | "tiledhdrfilm" | "mfilm" | "exrfilm" | "pngfilm" => {
            reader.remark("the picture is written in this program's own formats");
        }
        other @ "specfilm" => reader.warn(
            reader.place(),
            format_args!("type `{other}`: the picture has red, green and blue, and not the film's spectral channels"),
        ),
        _ => reader.other_type(&FILMS, "the picture is that of an `hdrfilm`")?,
    }
    let size = |name, default: u32| {
        Ok::<_, SceneError>(reader.integer(name, 1..=1 << 16)?.unwrap_or(i64::from(default)) as u32)
    };
    let resolution = [
        size("width", DEFAULT_RESOLUTION[0])?,
        size("height", DEFAULT_RESOLUTION[1])?,
    ];
    let (x, width) = crop_interval(reader, ["crop_offset_x", "crop_width"], resolution[0])?;
    let (y, height) = crop_interval(reader, ["crop_offset_y", "crop_height"], resolution[1])?;
    let pixels = u64::from(width) * u64::from(height);
    within(reader.place(), "number of pixels of the film", pixels, limits.pixels)?;
    // Samples belong to one pixel each, so that edges need no border; and files are written in the formats of this program.
    reader.ignore(&FILM_WITHOUT_EFFECT);
    let filter = match reader.only_child(Kind::Filter)? {
        Some(filter) => {
            let built = reconstruction_filter(&Reader::new(description, filter.target));
            description.attempt(filter.target, built)?.unwrap_or(DEFAULT_FILTER)
        }
        None => DEFAULT_FILTER,
    };
    reader.finish();
    Ok(Frame {
        whole: resolution,
        offset: [x, y],
        size: [width, height],
        filter,
    })
}

/// Where the window of a film of `whole` pixels begins along an axis, and how long it is: the properties `names`, and without them all.
fn crop_interval(reader: &Reader, names: [&str; 2], whole: u32) -> Result<(u32, u32), SceneError> {
    let last = i64::from(whole) - 1;
    let offset = reader.integer(names[0], 0..=last)?.unwrap_or(0) as u32;
    let left = whole - offset;
    let size = reader.integer(names[1], 1..=i64::from(left))?.unwrap_or(left.into());
    Ok((offset, size as u32))
}

fn reconstruction_filter(reader: &Reader) -> Result<Filter, SceneError> {
    let width = |name, default: f64| Ok::<_, SceneError>(reader.float_or(name, 0.01..=16.0, default)? as f32);
    let filter = match reader.object.plugin.as_str() {
        "box" => Filter::Box {
            radius: width("radius", 0.5)?,
        },
        "tent" => Filter::Tent {
            radius: width("radius", 1.0)?,
        },
        "gaussian" => Filter::Gaussian {
            stddev: width("stddev", 0.5)?,
        },
        other @ ("mitchell" | "catmullrom" | "lanczos") => {
            let without = "its negative lobes cannot be sampled";
            reader.warn(
                reader.place(),
                format_args!(
                    "type `{other}`: {without}; the default filter stands in for it, and the picture is a little softer"
                ),
            );
            reader.accept_rest();
            DEFAULT_FILTER
        }
        _ => {
            reader.other_type(&["box", "tent", "gaussian"], "the default filter stands in for it")?;
            DEFAULT_FILTER
        }
    };
    reader.finish();
    Ok(filter)
}

/// The renderer has its own random numbers; of a sampler, whatever its type, only the count matters.
pub(super) fn sample_count(reader: &Reader) -> Result<Option<u32>, SceneError> {
    let count = reader.integer("sample_count", 1..=i64::from(u32::MAX))?;
    reader.remark("the renderer has its own random numbers: only `sample_count` is read");
    reader.accept_rest();
    Ok(count.map(|count| count as u32))
}
