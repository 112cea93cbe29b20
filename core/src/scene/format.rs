//! The formats that scenes are written in: which one a file has, and the front end that reads it.

use super::description::Description;
use super::error::{Place, SceneError};
use super::faults::Faults;
use super::loader::{LoadedFile, Loader};
use super::warning::Warnings;
use super::{gltf, pbrt, xml};
use std::collections::BTreeMap;
use std::rc::Rc;

/// A format of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    /// Mitsuba's XML, of any version.
    Mitsuba,
    /// The text format of pbrt.
    Pbrt,
    /// glTF 2.0, as JSON or binary.
    Gltf,
}

impl Format {
    /// The name for people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Mitsuba => "Mitsuba XML",
            Self::Pbrt => "pbrt",
            Self::Gltf => "glTF 2.0",
        }
    }

    /// By the ending of the name; where that says nothing, by how the file begins.
    pub(crate) fn of(file: &LoadedFile) -> Self {
        let name = file.name.to_ascii_lowercase();
        // pbrt reads scenes that are packed as well.
        let ending = name.strip_suffix(".gz").unwrap_or(&name).rsplit_once('.');
        match ending.map(|(_, ending)| ending) {
            Some("pbrt") => Self::Pbrt,
            Some("gltf" | "glb") => Self::Gltf,
            Some("xml") => Self::Mitsuba,
            _ if file.bytes.starts_with(b"glTF") => Self::Gltf,
            _ => match file.bytes.iter().find(|byte| !byte.is_ascii_whitespace()) {
                Some(b'{') => Self::Gltf,
                Some(b'#' | b'A'..=b'Z') => Self::Pbrt,
                _ => Self::Mitsuba,
            },
        }
    }
}

/// Reads the scene file `main` and what it includes, in whichever format it is.
pub(crate) fn read(
    loader: &mut Loader,
    main: &str,
    defines: &BTreeMap<String, String>,
    faults: &Rc<Faults>,
    warnings: &Rc<Warnings>,
) -> Result<(Format, Description), SceneError> {
    let place = Place::whole(main);
    let file = loader.open(&place, &[String::new()], main)?;
    let format = Format::of(&file);
    if let (Format::Pbrt, Some(name)) = (format, defines.keys().next()) {
        let context = "definitions";
        return Err(SceneError::unknown(&place, context, "parameter", name, []));
    }
    let description = match format {
        Format::Mitsuba => xml::read(loader, &file, defines, faults, warnings),
        Format::Pbrt => pbrt::read(loader, &file, faults, warnings),
        Format::Gltf => gltf::read(loader, &file, defines, faults, warnings),
    };
    Ok((format, description?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_is_that_of_the_name_or_of_how_the_file_begins() {
        for (name, content, format) in [
            ("a.PBRT", "", Format::Pbrt),
            ("a.pbrt.gz", "", Format::Pbrt),
            ("a.glb", "", Format::Gltf),
            ("a.xml", "# no xml", Format::Mitsuba),
            ("a.txt", "\n # Exported\nCamera", Format::Pbrt),
            ("a", "Camera \"perspective\"", Format::Pbrt),
            ("a", "glTF\u{2}", Format::Gltf),
            ("a.json", " {\"asset\": {}}", Format::Gltf),
            ("a", "<?xml?>", Format::Mitsuba),
            ("a", "", Format::Mitsuba),
        ] {
            let (name, bytes) = (name.to_owned(), content.as_bytes().into());
            assert_eq!(Format::of(&LoadedFile { name, bytes }), format, "{content}");
        }
    }
}
