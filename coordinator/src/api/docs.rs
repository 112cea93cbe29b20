//! The description of this interface for people, at `/v1/docs`: the OpenAPI document as a page.

use super::page::{self, RULES};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::Value;
use std::fmt::Write;
use std::sync::LazyLock;

/// The page, made once.
static PAGE: LazyLock<String> = LazyLock::new(|| page_of(&super::document()));

/// This interface, to be read in a browser: every operation, and every type that goes over the line.
#[utoipa::path(get, path = "/v1/docs", operation_id = "get_docs", responses((status = 200, content_type = "text/html")))]
pub(super) async fn docs() -> Response {
    (RULES, [(header::CONTENT_TYPE, page::HTML)], PAGE.as_str()).into_response()
}

fn page_of(document: &Value) -> String {
    let mut body = String::new();
    for (path, item) in entries(&document["paths"]) {
        for (method, operation) in entries(item) {
            write_operation(&mut body, &method.to_uppercase(), path, operation);
        }
    }
    let mut types = String::new();
    for (name, schema) in entries(&document["components"]["schemas"]) {
        write_schema(&mut types, name, schema);
    }
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Photonfarm's HTTP interface</title>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><link rel=\"stylesheet\" href=\"../page/style.css\">\
         </head><body><main class=\"reference\"><h1>Photonfarm's HTTP interface</h1><p>Answers that are no success are problems \
         (RFC 9457). A farm with tokens asks for one, as <code>Authorization: Bearer TOKEN</code>. Programs read \
         <a href=\"openapi.json\">openapi.json</a>, from which clients can be generated.</p><h2>Operations</h2>{body}<h2>Types</h2>{types}\
         </main></body></html>"
    )
}

// Writing to a string does not fail.
fn write_operation(page: &mut String, method: &str, path: &str, operation: &Value) {
    let id = escaped(text(&operation["operationId"]));
    let _ = write!(
        page,
        "<section id=\"{id}\"><h3><code>{method} {}</code></h3>",
        escaped(path)
    );
    for said in ["summary", "description"] {
        write_prose(page, text(&operation[said]));
    }
    let parameters = operation["parameters"].as_array().map_or(&[][..], Vec::as_slice);
    let rows = parameters.iter().map(|parameter| {
        let (name, place) = (text(&parameter["name"]), text(&parameter["in"]));
        let said = text(&parameter["description"]);
        [
            format!("<code>{}</code>, in the {place}", escaped(name)),
            type_of(&parameter["schema"]),
            escaped(said),
        ]
    });
    write_table(page, "Parameters", rows);
    for (media_type, content) in entries(&operation["requestBody"]["content"]) {
        let _ = write!(
            page,
            "<p>Takes <code>{media_type}</code>: {}</p>",
            type_of(&content["schema"])
        );
    }
    let answers = entries(&operation["responses"]).map(|(status, response)| {
        let content: Vec<String> = entries(&response["content"])
            .map(|(media_type, content)| format!("<code>{media_type}</code> {}", type_of(&content["schema"])))
            .collect();
        [
            escaped(status),
            content.join("<br>"),
            escaped(text(&response["description"])),
        ]
    });
    write_table(page, "Answers", answers);
    page.push_str("</section>");
}

fn write_schema(page: &mut String, name: &str, schema: &Value) {
    let name = escaped(name);
    let _ = write!(page, "<section id=\"type-{name}\"><h3>{name}</h3>");
    write_prose(page, text(&schema["description"]));
    if entries(&schema["properties"]).next().is_none() {
        let _ = write!(page, "<p>{}</p>", type_of(schema));
    }
    let required = schema["required"].as_array().map_or(&[][..], Vec::as_slice);
    let rows = entries(&schema["properties"]).map(|(field, property)| {
        let needed = match required.iter().any(|required| required == field) {
            true => "",
            false => " (optional)",
        };
        [
            format!("<code>{}</code>{needed}", escaped(field)),
            type_of(property),
            escaped(text(&property["description"])),
        ]
    });
    write_table(page, "Fields", rows);
    page.push_str("</section>");
}

fn write_prose(page: &mut String, prose: &str) {
    for paragraph in prose.split("\n\n").filter(|paragraph| !paragraph.is_empty()) {
        let _ = write!(page, "<p>{}</p>", escaped(paragraph));
    }
}

/// A table of three columns; nothing where it has no rows.
fn write_table(page: &mut String, title: &str, rows: impl Iterator<Item = [String; 3]>) {
    let mut rows = rows.peekable();
    if rows.peek().is_none() {
        return;
    }
    let _ = write!(
        page,
        "<table><thead><tr><th scope=\"col\">{title}</th><th scope=\"col\">Type</th><th scope=\"col\">Meaning</th></tr></thead><tbody>"
    );
    for [name, kind, meaning] in rows {
        let _ = write!(page, "<tr><td>{name}</td><td>{kind}</td><td>{meaning}</td></tr>");
    }
    page.push_str("</tbody></table>");
}

/// What a schema allows, in a few words of HTML; types of the document are links.
fn type_of(schema: &Value) -> String {
    if let Some(name) = schema["$ref"].as_str().and_then(|link| link.rsplit('/').next()) {
        let name = escaped(name);
        return format!("<a href=\"#type-{name}\">{name}</a>");
    }
    for several in ["oneOf", "anyOf", "allOf"] {
        if let Some(choices) = schema[several].as_array() {
            let choices: Vec<String> = choices.iter().map(type_of).collect();
            return choices.join(" or ");
        }
    }
    if let Some(constant) = schema.get("const") {
        return format!("<code>{}</code>", escaped(&constant.to_string()));
    }
    if let Some(values) = schema["enum"].as_array() {
        let values: Vec<String> = values.iter().map(|value| escaped(&value.to_string())).collect();
        return values.join(", ");
    }
    let names: Vec<&str> = match &schema["type"] {
        Value::Array(names) => names.iter().map(text).collect(),
        name => vec![text(name)],
    };
    let mut kind = escaped(&names.join(" or "));
    if names.contains(&"array") {
        kind = format!("list of {}", type_of(&schema["items"]));
    }
    if let Some(format) = schema["format"].as_str() {
        let _ = write!(kind, " ({})", escaped(format));
    }
    for (bound, words) in [("minimum", "at least"), ("maximum", "at most"), ("default", "default")] {
        if let Some(value) = schema.get(bound).filter(|value| !value.is_object()) {
            let _ = write!(kind, ", {words} {}", escaped(&value.to_string()));
        }
    }
    kind
}

fn entries(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

/// Text as it may stand in HTML and in its attributes.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Every operation is there, and every link leads to a type that is.
    #[test]
    fn the_page_is_whole() {
        let document = crate::api::document();
        let targets = |mark: &str| -> BTreeSet<String> {
            let after = PAGE.split(mark).skip(1);
            after
                .map(|rest| rest.split('"').next().unwrap_or_default().to_owned())
                .collect()
        };
        let (links, places) = (targets("href=\"#"), targets("id=\""));
        assert!(
            links.len() > 10 && links.is_subset(&places),
            "{:?}",
            links.difference(&places)
        );
        for (_, item) in entries(&document["paths"]) {
            for (_, operation) in entries(item) {
                assert!(places.contains(text(&operation["operationId"])), "{operation}");
            }
        }
        assert_eq!(PAGE.matches("<section").count(), PAGE.matches("</section>").count());
    }

    #[test]
    fn what_is_written_is_no_markup() {
        let document = serde_json::json!({"components": {"schemas": {"<b>": {"description": "a \"<script>\" & more", "type": "object"}}}});
        let page = page_of(&document);
        assert!(!page.contains("<script>") && !page.contains("<b>"), "{page}");
        assert!(page.contains("a &quot;&lt;script&gt;&quot; &amp; more"), "{page}");
    }
}
