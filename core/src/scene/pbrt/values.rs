//! A parameter as it is written: `"float fov" [45]`.

use super::colour::ColourSpace;
use super::token::{Token, Tokens};
use crate::scene::error::{Place, SceneError, shortened};
use crate::scene::faults::Faults;
use std::cell::Cell;

/// What a parameter is declared as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    Boolean,
    Integer,
    Float,
    /// Points, vectors and normals of two or three coordinates.
    Vector,
    Text,
    Texture,
    Rgb,
    Xyz,
    Spectrum,
    Blackbody,
}

impl Type {
    /// By the name in pbrt-v4 or pbrt-v3.
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Boolean,
            "integer" => Self::Integer,
            "float" => Self::Float,
            "point" | "point2" | "point3" | "vector" | "vector2" | "vector3" | "normal" | "normal3" => Self::Vector,
            "string" => Self::Text,
            "texture" => Self::Texture,
            "rgb" | "color" => Self::Rgb,
            "xyz" => Self::Xyz,
            "spectrum" => Self::Spectrum,
            "blackbody" => Self::Blackbody,
            _ => return None,
        })
    }
}

/// The values of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Numbers(Vec<f64>),
    /// Of long lists of coordinates, which end up in single precision.
    Coordinates(Vec<f32>),
    Integers(Vec<i32>),
    Booleans(Vec<bool>),
    Texts(Vec<String>),
}

impl Values {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Coordinates(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Booleans(values) => values.len(),
            Self::Texts(values) => values.len(),
        }
    }

    /// The numbers among them in double precision.
    pub(super) fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Numbers(values) => values.clone(),
            Self::Coordinates(values) => values.iter().map(|value| f64::from(*value)).collect(),
            Self::Integers(values) => values.iter().map(|value| f64::from(*value)).collect(),
            Self::Booleans(_) | Self::Texts(_) => Vec::new(),
        }
    }
}

/// A parameter as written.
#[derive(Debug)]
pub(super) struct Parameter {
    pub(super) kind: Type,
    /// The type as it is written.
    pub(super) written: String,
    pub(super) name: String,
    pub(super) values: Values,
    pub(super) place: Place,
    pub(super) space: ColourSpace,
    /// Whether it was asked for.
    pub(super) used: Cell<bool>,
}

/// The next parameter, or nothing where it has a fault that was noted.
pub(super) fn parameter(
    tokens: &mut Tokens,
    context: &str,
    space: ColourSpace,
    faults: &Faults,
) -> Result<Option<Parameter>, SceneError> {
    let place = tokens.place();
    let declaration = tokens.required_text("a parameter")?;
    let mut words = declaration.split_ascii_whitespace();
    let (Some(written), Some(name), None) = (words.next(), words.next(), words.next()) else {
        let reason = format!("\"{}\" is not of the form \"type name\"", shortened(&declaration));
        return Err(SceneError::value(&place, context, reason));
    };
    let kind = Type::of(written);
    let values = values(tokens, kind, name)?;
    let Some(kind) = kind else {
        let allowed = [
            "bool",
            "integer",
            "float",
            "point2",
            "point3",
            "vector2",
            "vector3",
            "normal",
            "string",
            "texture",
            "rgb",
            "spectrum",
            "blackbody",
        ];
        faults.note(SceneError::unknown(&place, context, "parameter type", written, allowed))?;
        return Ok(None);
    };
    if values.len() == 0 {
        faults.note(SceneError::value(
            &place,
            format!("{context} `{name}`"),
            "it has no values",
        ))?;
        return Ok(None);
    }
    Ok(Some(Parameter {
        kind,
        written: written.to_owned(),
        name: name.to_owned(),
        values,
        place,
        space,
        used: Cell::new(false),
    }))
}

/// The values of a parameter: one, or a list in brackets.
fn values(tokens: &mut Tokens, kind: Option<Type>, name: &str) -> Result<Values, SceneError> {
    let listed = tokens.peek() == Some(b'[');
    if listed {
        tokens.next()?;
    }
    match tokens.peek() {
        None => Err(tokens.broken(format!("the value of `{}` is missing", shortened(name)))),
        Some(b'"') => texts(tokens, kind, listed),
        Some(b't' | b'f' | b'T' | b'F') => booleans(tokens, listed),
        Some(_) if kind == Some(Type::Integer) => {
            let mut found = Vec::new();
            let mut broken = None;
            let mut add = |found: &mut Vec<i32>, value: f64| {
                // Beyond the range, `as` gives its end.
                let integer = value as i32;
                if f64::from(integer) != value || integer == i32::MIN {
                    broken = Some(value);
                }
                found.push(integer);
            };
            match listed {
                true => {
                    found.reserve_exact(tokens.count());
                    tokens.numbers(|value| add(&mut found, value))?;
                }
                false => add(&mut found, tokens.required_number()?),
            }
            match broken {
                Some(value) => Err(tokens.broken(format!("`{}`: {value} is not an integer", shortened(name)))),
                None => Ok(Values::Integers(found)),
            }
        }
        Some(_) if kind == Some(Type::Vector) || matches!(name, "P" | "N" | "S" | "uv" | "st") => {
            let mut found = Vec::new();
            match listed {
                true => {
                    found.reserve_exact(tokens.count());
                    tokens.numbers(|value| found.push(value as f32))?;
                }
                false => found.push(tokens.required_number()? as f32),
            }
            Ok(Values::Coordinates(found))
        }
        Some(_) => {
            let mut found = Vec::new();
            match listed {
                true => tokens.numbers(|value| found.push(value))?,
                false => found.push(tokens.required_number()?),
            }
            Ok(Values::Numbers(found))
        }
    }
}

/// Texts; those of a `bool` are what pbrt-v3 writes for `true` and `false`.
fn texts(tokens: &mut Tokens, kind: Option<Type>, listed: bool) -> Result<Values, SceneError> {
    let mut found = Vec::new();
    loop {
        match tokens.peek() {
            Some(b']') if listed => {
                tokens.next()?;
                break;
            }
            _ => found.push(tokens.required_text("a value")?),
        }
        if !listed {
            break;
        }
    }
    if kind != Some(Type::Boolean) {
        return Ok(Values::Texts(found));
    }
    let truth = |text: &String| match text.as_str() {
        "true" => Ok(true),
        "false" => Ok(false),
        other => Err(tokens.broken(format!("`{}` is neither true nor false", shortened(other)))),
    };
    found.iter().map(truth).collect::<Result<_, _>>().map(Values::Booleans)
}

fn booleans(tokens: &mut Tokens, listed: bool) -> Result<Values, SceneError> {
    let mut found = Vec::new();
    loop {
        match tokens.next()? {
            Some(Token::Close) if listed => return Ok(Values::Booleans(found)),
            Some(Token::Word(word)) if word == "true" || word == "false" => found.push(word == "true"),
            _ => return Err(tokens.broken("expected true or false")),
        }
        if !listed {
            return Ok(Values::Booleans(found));
        }
    }
}
