//! Spectra of Mitsuba 2 and 3 that are objects: `<spectrum type="d65" name="radiance"/>`.

use super::super::description::{Object, SpectrumValue, Value};
use super::super::spectrum::blackbody;
use super::values;

/// The value of an object that is a spectrum, or what is wrong with it by property; `None` for another texture.
pub(super) fn value(object: &Object) -> Option<Result<Value, (&'static str, String)>> {
    if !object.children.is_empty() {
        return None;
    }
    let spectrum = match object.plugin.as_str() {
        // The white of the picture.
        "d65" => return Some(number(object, "scale", Some(1.0)).map(|scale| Value::Rgb([scale; 3]))),
        "blackbody" => black_body(object),
        "regular" => regular(object),
        "irregular" => irregular(object),
        _ => return None,
    };
    Some(spectrum.map(Value::Spectrum))
}

fn black_body(object: &Object) -> Result<SpectrumValue, (&'static str, String)> {
    let kelvin = number(object, "temperature", None)?;
    let kelvin = values::temperature(kelvin).map_err(|reason| ("temperature", reason))?;
    let scale = number(object, "scale", Some(1.0))?;
    Ok(SpectrumValue::Sampled(blackbody(kelvin, scale)))
}

/// Values at equal distances.
fn regular(object: &Object) -> Result<SpectrumValue, (&'static str, String)> {
    let first = number(object, "wavelength_min", Some(360.0))?;
    let last = number(object, "wavelength_max", Some(830.0))?;
    let values = numbers(object, "values")?;
    let steps = values.len().max(2) as f64 - 1.0;
    let place = |index: usize| first + (last - first) * index as f64 / steps;
    let pairs = values.into_iter().enumerate();
    values::sampled(pairs.map(|(index, value)| (place(index), value)).collect()).map_err(|reason| ("values", reason))
}

fn irregular(object: &Object) -> Result<SpectrumValue, (&'static str, String)> {
    let (wavelengths, values) = (numbers(object, "wavelengths")?, numbers(object, "values")?);
    if wavelengths.len() != values.len() {
        let reason = format!("there are {} for {} wavelengths", values.len(), wavelengths.len());
        return Err(("values", reason));
    }
    values::sampled(wavelengths.into_iter().zip(values).collect()).map_err(|reason| ("wavelengths", reason))
}

fn number(object: &Object, name: &'static str, default: Option<f64>) -> Result<f64, (&'static str, String)> {
    match (object.properties.get(name).map(|property| &property.value), default) {
        (Some(Value::Float(value)), _) => Ok(*value),
        (Some(Value::Integer(value)), _) => Ok(*value as f64),
        (None, Some(default)) => Ok(default),
        (None, None) => Err((name, "it is missing".to_owned())),
        (Some(other), _) => Err((
            name,
            format!("expected a value of type float, found {}", other.type_name()),
        )),
    }
}

fn numbers(object: &Object, name: &'static str) -> Result<Vec<f64>, (&'static str, String)> {
    match object.properties.get(name).map(|property| &property.value) {
        Some(Value::String(text)) => values::floats(text).map_err(|reason| (name, reason)),
        Some(other) => Err((
            name,
            format!("expected a value of type string, found {}", other.type_name()),
        )),
        None => Err((name, "it is missing".to_owned())),
    }
}
