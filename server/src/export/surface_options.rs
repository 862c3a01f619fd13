//! Options of one surface in a request for a file of several surfaces: source, look and edit.

use isopeel_mesh::mesh::{Material, rgb};
use isopeel_view::{Edit, EditError};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::schema::merged_schema;

/// What a surface is of, and what it looks like.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct SurfaceLook {
    /// Another volume than the file's: its id, on the command line its path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume: Option<String>,
    /// Another time step than the file's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<u32>,
    /// As of the file: the surface around labels instead of one at an isovalue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Name of the node or object; volume, field and isovalue if it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Colour, `#rrggbb`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<String>,
    /// From 0, which cannot be seen, to 1, which is opaque; 1 if it is left out. An OBJ holds none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opacity: Option<f32>,
}

impl SurfaceLook {
    /// Names of the options in JSON.
    const NAMES: [&str; 6] = ["volume", "step", "label", "name", "color", "opacity"];

    /// Returns colour and opacity of the surface.
    ///
    /// # Errors
    /// An invalid colour or opacity.
    pub(super) fn material(&self) -> Result<Material, EditError> {
        let refuse = |why| Err(EditError { field: "surfaces", why });
        let color = self.color.as_deref().map(|text| (text, rgb(text)));
        let color = match color {
            Some((text, None)) => return refuse(format!("color {text:?}, expected #rrggbb")),
            Some((_, color)) => color,
            None => None,
        };
        match self.opacity.unwrap_or(1.0) {
            opacity if (0.0..=1.0).contains(&opacity) => Ok(Material { color, opacity }),
            opacity => refuse(format!("opacity {opacity}, expected 0 to 1")),
        }
    }
}

/// One of several surfaces of a file. It may have any of the edit's names; those that it has replace the file's.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SurfaceOptions {
    /// What it is of, and what it looks like.
    #[serde(flatten)]
    pub look: SurfaceLook,
    /// What differs from the file's edit.
    #[serde(flatten)]
    pub edit: Edit,
}

impl<'de> Deserialize<'de> for SurfaceOptions {
    /// Written by hand, because serde cannot flatten and refuse unknown fields at the same time.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (look, edit): (Map<_, _>, Map<_, _>) = Map::deserialize(deserializer)?
            .into_iter()
            .partition(|(name, _)| SurfaceLook::NAMES.contains(&name.as_str()));
        Ok(Self {
            look: SurfaceLook::deserialize(Value::Object(look)).map_err(D::Error::custom)?,
            edit: Edit::deserialize(Value::Object(edit)).map_err(D::Error::custom)?,
        })
    }
}

impl PartialSchema for SurfaceOptions {
    fn schema() -> RefOr<Schema> {
        merged_schema(
            [SurfaceLook::schema(), Edit::schema()],
            "One of several surfaces: what it is of and looks like, beside any of the edit's names that differ from the file's.",
        )
    }
}

impl ToSchema for SurfaceOptions {
    fn name() -> std::borrow::Cow<'static, str> {
        "SurfaceOptions".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        Edit::schemas(schemas);
    }
}
