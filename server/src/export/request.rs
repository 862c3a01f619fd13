//! What is asked for of one file: step and format, beside any of the edit's names.

use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::Format;
use crate::view::{Edit, EditError, View};
use crate::volumes::Dataset;

/// One surface as a file. What is left out has the value that the volume opens with.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileRequest {
    /// Time step.
    pub step: u32,
    /// File format.
    pub format: Format,
    /// The edit.
    #[serde(flatten)]
    pub edit: Edit,
}

impl FileRequest {
    /// The view of a volume.
    ///
    /// # Errors
    /// A value out of its range, or a field that the volume does not have.
    pub fn view(&self, dataset: &Dataset) -> Result<View, EditError> {
        let edit = self.edit.clone().with_default_guards();
        dataset.opening_view()?.apply(&edit, &dataset.field_names())
    }
}

/// The names that are not of the edit.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct What {
    /// Time step.
    #[serde(default)]
    step: u32,
    /// File format.
    format: Format,
}

impl<'de> Deserialize<'de> for FileRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (What { step, format }, edit) = beside_edit(deserializer, &["step", "format"])?;
        Ok(Self { step, format, edit })
    }
}

/// An object that has these names beside the edit's. By hand, because serde cannot flatten and refuse unknown fields at the same time.
pub(crate) fn beside_edit<'de, D: Deserializer<'de>, T: DeserializeOwned>(
    deserializer: D,
    names: &[&str],
) -> Result<(T, Edit), D::Error> {
    let (what, edit): (Map<_, _>, Map<_, _>) = Map::deserialize(deserializer)?
        .into_iter()
        .partition(|(name, _)| names.contains(&name.as_str()));
    let what = T::deserialize(Value::Object(what)).map_err(D::Error::custom)?;
    let edit = Edit::deserialize(Value::Object(edit)).map_err(D::Error::custom)?;
    Ok((what, edit))
}

/// The schema of an object that has the names of `what` beside the edit's.
pub(crate) fn schema_beside_edit(mut what: RefOr<Schema>, description: &str) -> RefOr<Schema> {
    if let (RefOr::T(Schema::Object(what)), RefOr::T(Schema::Object(edit))) = (&mut what, Edit::schema()) {
        what.properties.extend(edit.properties);
        what.description = Some(description.into());
    }
    what
}

impl PartialSchema for FileRequest {
    fn schema() -> RefOr<Schema> {
        schema_beside_edit(What::schema(), "Step and format, beside any of the edit's names.")
    }
}

impl ToSchema for FileRequest {
    fn name() -> std::borrow::Cow<'static, str> {
        "FileRequest".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        What::schemas(schemas);
        Edit::schemas(schemas);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_reads_back_and_names_what_it_does_not_know() {
        let text = r#"{"step":2,"format":"stl","iso":-3.5,"beta":0.5}"#;
        let request: FileRequest = serde_json::from_str(text).unwrap();
        assert_eq!((request.step, request.format), (2, Format::Stl));
        assert_eq!(serde_json::to_string(&request).unwrap(), text);
        for (text, expected) in [
            (r#"{"iso":1}"#, "missing field `format`"),
            (r#"{"format":"ply","isovalue":1}"#, "unknown field `isovalue`"),
        ] {
            let error = serde_json::from_str::<FileRequest>(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
