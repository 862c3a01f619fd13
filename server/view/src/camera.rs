//! Cameras for which a surface is made, in JSON and on the command line.

use std::str::FromStr;

use isopeel_geometry::DVec3;
use serde::{Deserialize, Serialize};

use super::error::EditError;

/// Maximum pixels of a viewport along an axis.
const MAX_PIXELS: u32 = 65_536;

/// Which parts of a surface are fine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum Detail {
    /// What the camera sees from near is finer, if there is a camera
    #[default]
    View,
    /// Every part alike, from wherever it is seen
    Uniform,
}

/// A camera that looks at a surface, in world coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(
    feature = "typescript",
    derive(ts_rs::TS),
    ts(rename = "ViewCamera", optional_fields)
)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct CameraJson {
    /// Position of the camera.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub position: [f64; 3],
    /// Position that the camera looks at.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub target: [f64; 3],
    /// Direction that is up in the picture; not that in which the camera looks.
    #[serde(default = "z_axis")]
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    #[cfg_attr(feature = "typescript", ts(optional, as = "Option<[f64; 3]>"))]
    pub up: [f64; 3],
    /// Vertical field of view of a perspective picture, in degrees, above 0 and below 180. Either this or `height` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov: Option<f64>,
    /// Height of a parallel picture, in world units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<f64>,
    /// Width and height of the picture in pixels.
    #[cfg_attr(feature = "openapi", schema(min_items = 2, max_items = 2))]
    pub viewport: [u32; 2],
}

fn z_axis() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// How a camera shows depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Vertical field of view, radians.
    Perspective(f64),
    /// Height of the picture, world units.
    Parallel(f64),
}

impl CameraJson {
    /// Returns how the camera shows depth.
    ///
    /// # Errors
    /// The invalid value, and the expected one.
    pub fn projection(&self) -> Result<Projection, String> {
        match (self.fov, self.height) {
            (Some(fov), None) if fov > 0.0 && fov < 180.0 => Ok(Projection::Perspective(fov.to_radians())),
            (None, Some(height)) if height > 0.0 && height.is_finite() => Ok(Projection::Parallel(height)),
            (Some(fov), None) => Err(format!("fov {fov}, expected degrees above 0 and below 180")),
            (None, Some(height)) => Err(format!("height {height}, expected a finite number above 0")),
            (Some(_), Some(_)) => Err("fov and height, expected one of both".into()),
            (None, None) => Err("neither fov nor height, expected one of both".into()),
        }
    }

    /// Checks that the camera is valid.
    ///
    /// # Errors
    /// The first invalid value.
    pub fn check(&self) -> Result<(), EditError> {
        let refuse = |why| Err(EditError { field: "camera", why });
        let [position, target, up] = [self.position, self.target, self.up].map(DVec3::from);
        for (name, vector) in [("position", position), ("target", target), ("up", up)] {
            if !vector.is_finite() {
                return refuse(format!("{name} {:?}, expected finite numbers", vector.to_array()));
            }
        }
        let distance = (target - position).length();
        if !(distance > 0.0 && distance.is_finite()) {
            return refuse("target equals position, expected another one at a finite distance".into());
        }
        let side = ((target - position) / distance).cross(up.normalize_or_zero());
        if side.length_squared() < 1e-12 {
            return refuse(format!(
                "up {:?}, expected another direction than that in which the camera looks",
                self.up
            ));
        }
        if self.viewport.iter().any(|pixels| !(1..=MAX_PIXELS).contains(pixels)) {
            return refuse(format!(
                "viewport {:?}, expected 1 to {MAX_PIXELS} pixels",
                self.viewport
            ));
        }
        self.projection().map(drop).or_else(refuse)
    }
}

/// Parses position and target of the command line, with up behind them if it is not the z axis: six or nine numbers, separated by commas.
/// Returns a camera without projection and viewport.
impl FromStr for CameraJson {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("{text:?}, expected six or nine numbers: X,Y,Z of position, target and up");
        let numbers: Vec<f64> = text
            .split(',')
            .map(|number| number.trim().parse().map_err(|_| expected()))
            .collect::<Result<_, _>>()?;
        let vector = |i: usize| -> Option<[f64; 3]> { numbers.get(3 * i..3 * i + 3)?.try_into().ok() };
        let up = match numbers.len() {
            6 => Some(z_axis()),
            9 => vector(2),
            _ => None,
        };
        let (Some(position), Some(target), Some(up)) = (vector(0), vector(1), up) else {
            return Err(expected());
        };
        Ok(Self {
            position,
            target,
            up,
            fov: None,
            height: None,
            viewport: [0; 2],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{CameraJson, Projection};

    const CAMERA: &str = r#"{"position":[0,-9,0],"target":[0,0,0],"fov":90,"viewport":[640,480]}"#;

    fn changed(from: &str, to: &str) -> String {
        assert!(CAMERA.contains(from), "{from}");
        CAMERA.replace(from, to)
    }

    fn refusal(json: &str) -> String {
        let camera: CameraJson = serde_json::from_str(json).expect(json);
        camera.check().expect_err(json).to_string()
    }

    #[test]
    fn a_camera_is_perspective_or_parallel() {
        let camera: CameraJson = serde_json::from_str(CAMERA).expect("a camera");
        camera.check().expect("a good camera");
        assert_eq!(camera.up, [0.0, 0.0, 1.0]);
        assert_eq!(camera.projection(), Ok(Projection::Perspective(90f64.to_radians())));
        let parallel: CameraJson = serde_json::from_str(&changed("\"fov\":90", "\"height\":5")).expect("a camera");
        assert_eq!(parallel.projection(), Ok(Projection::Parallel(5.0)));
        let json = serde_json::to_string(&camera).expect("JSON");
        assert_eq!(serde_json::from_str::<CameraJson>(&json).expect("JSON"), camera);
    }

    #[test]
    fn cameras_that_show_nothing_are_refused_with_what_was_expected() {
        for (from, to, why) in [
            ("[0,-9,0]", "[0,0,0]", "target equals position"),
            ("[0,-9,0]", "[0,0,-9]", "up [0.0, 0.0, 1.0], expected another direction"),
            ("[0,-9,0]", "[1e308,-1e308,0]", "finite distance"),
            ("\"fov\":90", "\"fov\":180", "fov 180, expected degrees"),
            (
                "\"fov\":90",
                "\"height\":0",
                "height 0, expected a finite number above 0",
            ),
            ("\"fov\":90", "\"fov\":90,\"height\":1", "fov and height"),
            ("\"fov\":90,", "", "neither fov nor height"),
            ("640", "0", "viewport [0, 480], expected 1 to"),
        ] {
            let error = refusal(&changed(from, to));
            assert!(error.contains(why), "{error}");
        }
    }

    #[test]
    fn the_command_line_has_six_or_nine_numbers() {
        let camera: CameraJson = "1,2,3, 4,5,6".parse().expect("a camera");
        assert_eq!((camera.position, camera.target), ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
        let camera: CameraJson = "1,2,3,4,5,6,0,1,0".parse().expect("a camera");
        assert_eq!(camera.up, [0.0, 1.0, 0.0]);
        for text in ["", "1,2,3", "1,2,3,4,5,6,7", "1,2,3,4,5,x"] {
            assert!(text.parse::<CameraJson>().is_err(), "{text}");
        }
    }
}
