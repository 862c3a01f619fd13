//! Schemas for OpenAPI of values whose JSON has several forms.

use utoipa::openapi::schema::{ObjectBuilder, OneOfBuilder, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::quality::{ErrorLimit, MaxError};

impl PartialSchema for ErrorLimit {
    fn schema() -> RefOr<Schema> {
        OneOfBuilder::new()
            .item(ObjectBuilder::new().schema_type(Type::Number))
            .item(ObjectBuilder::new().schema_type(Type::String))
            .description(Some(
                "World units, or text like `0.25vx` (multiples of the smallest spacing) or `1px` (pixels of the camera's picture)",
            ))
            .into()
    }
}

impl ToSchema for ErrorLimit {}

impl PartialSchema for MaxError {
    fn schema() -> RefOr<Schema> {
        OneOfBuilder::new()
            .item(ObjectBuilder::new().schema_type(Type::Number))
            .item(ObjectBuilder::new().schema_type(Type::String))
            .item(ObjectBuilder::new().schema_type(Type::Null))
            .description(Some(
                "World units, text like `0.25vx` (multiples of the smallest spacing), `auto`, or null: no guard",
            ))
            .into()
    }
}

impl ToSchema for MaxError {}
