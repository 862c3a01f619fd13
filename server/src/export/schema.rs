//! Schemas of requests that serde flattens.

use utoipa::openapi::schema::{AdditionalProperties, Object, Type};
use utoipa::openapi::{RefOr, Schema};

/// Returns the schema of an object that has the properties of all given schemas.
pub(crate) fn merged_schema(schemas: impl IntoIterator<Item = RefOr<Schema>>, description: &str) -> RefOr<Schema> {
    let mut merged = Object::new();
    for schema in schemas {
        if let RefOr::T(Schema::Object(object)) = schema {
            merged.properties.extend(object.properties);
            merged.required.extend(object.required);
        }
    }
    merged.schema_type = Type::Object.into();
    merged.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
    merged.description = Some(description.into());
    RefOr::T(Schema::Object(merged))
}
