//! What the OpenAPI document says of types of the renderer.

use photonfarm_core::integrator;
use serde_json::json;
use std::borrow::Cow;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// What the OpenAPI document says of an integrator with its settings.
pub(crate) struct IntegratorSchema;

impl PartialSchema for IntegratorSchema {
    fn schema() -> RefOr<Schema> {
        let mut schema = integrator::schema();
        schema["example"] = json!({"type": "pppm", "photons": 200_000});
        serde_json::from_value(schema).expect("a schema of integrators is one of OpenAPI")
    }
}

impl ToSchema for IntegratorSchema {
    fn name() -> Cow<'static, str> {
        Cow::Borrowed("Integrator")
    }
}

/// What the OpenAPI document says of a window of a picture.
pub(super) struct WindowSchema;

impl PartialSchema for WindowSchema {
    fn schema() -> RefOr<Schema> {
        let whole = |least: u32, text: &str| json!({"type": "integer", "format": "int32", "minimum": least, "description": text});
        let schema = json!({
            "type": "object",
            "description": "A window of a picture.",
            "required": ["x", "y", "width", "height"],
            "properties": {
                "x": whole(0, "Columns of the picture to the left of it."),
                "y": whole(0, "Rows of the picture above it."),
                "width": whole(1, "Pixels across."),
                "height": whole(1, "Pixels down."),
            },
            "additionalProperties": false,
        });
        serde_json::from_value(schema).expect("a schema of an object is one of OpenAPI")
    }
}

impl ToSchema for WindowSchema {
    fn name() -> Cow<'static, str> {
        Cow::Borrowed("Window")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_the_schema_of_integrators_as_it_is() {
        let mut shown = serde_json::to_value(IntegratorSchema::schema()).unwrap();
        assert_eq!(
            shown.as_object_mut().unwrap().remove("example").unwrap()["type"],
            "pppm"
        );
        assert_eq!(shown, integrator::schema());
    }
}
