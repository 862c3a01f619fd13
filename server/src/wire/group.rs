//! Types in the messages of groups: camera poses and members. `PROTOCOL.md`, section 7, is normative.

use serde::{Deserialize, Serialize};

use isopeel_view::Edit;

/// Maximum characters of the name of a follower.
const MAX_NAME_CHARS: usize = 40;

/// Maximum bytes of [`Pose::page`]. The web client writes some hundred bytes.
const MAX_PAGE_BYTES: usize = 16 << 10;

/// How a camera shows depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum Projection {
    /// What is far is small.
    Perspective,
    /// Parallels stay parallel.
    Orthographic,
}

/// Position and target of a camera, in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Camera {
    /// Position of the camera.
    pub position: [f64; 3],
    /// Position around which the camera orbits.
    pub target: [f64; 3],
    /// How it shows depth.
    pub projection: Projection,
}

/// What the page of the member in control shows beside its surfaces.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Pose {
    /// Camera of the page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub camera: Option<Camera>,
    /// State of the page in a format of its own: the server forwards it without reading it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub page: Option<String>,
}

impl Pose {
    /// Checks a pose that a client has sent.
    ///
    /// # Errors
    /// The page text is too long, a coordinate of the camera is not finite, or its target equals its position.
    pub fn check(&self) -> Result<(), String> {
        if let Some(page) = &self.page
            && page.len() > MAX_PAGE_BYTES
        {
            return Err(format!("page: {} bytes, expected at most {MAX_PAGE_BYTES}", page.len()));
        }
        let Some(camera) = self.camera else { return Ok(()) };
        let is_finite = camera
            .position
            .iter()
            .chain(&camera.target)
            .all(|coordinate| coordinate.is_finite());
        match is_finite && camera.position != camera.target {
            true => Ok(()),
            false => Err("camera: expected finite positions, and another target than its own".into()),
        }
    }
}

/// Credentials with which a leader resumes its group on another connection.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Resume {
    /// Id of the group.
    pub group: String,
    /// Key from the message `group` to the leader.
    pub key: String,
}

impl std::fmt::Debug for Resume {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Resume")
            .field("group", &self.group)
            .finish_non_exhaustive()
    }
}

/// Checks the name of a follower.
///
/// # Errors
/// A message for users that says what is wrong with the name.
pub fn check_name(name: &str) -> Result<(), String> {
    let chars = name.chars().count();
    if chars == 0 || chars > MAX_NAME_CHARS || name.chars().any(char::is_control) || name.trim() != name {
        return Err(format!(
            "name: {chars} characters, expected 1 to {MAX_NAME_CHARS} on one line, none of them blank at an end"
        ));
    }
    Ok(())
}

/// A surface of the member in control.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct LedSurface {
    /// Number of the surface.
    pub surface: u8,
    /// The values of all parameters.
    pub edit: Edit,
}

/// A follower, as the leader sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Follower {
    /// Number of the follower in the group, 1 or more.
    pub number: u32,
    /// Name that the follower has chosen; null if it has none.
    pub name: Option<String>,
    /// Whether the follower asks for control.
    pub asks: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_poses_have_limits() {
        for name in ["Ann", "Jürgen 2", &"x".repeat(40)] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
        for name in ["", " Ann", "a\nb", "\u{7}", &"x".repeat(41)] {
            assert!(check_name(name).is_err(), "{name:?}");
        }
        let camera = |position| Camera {
            position,
            target: [0.0; 3],
            projection: Projection::Perspective,
        };
        let pose = |position, page: usize| Pose {
            camera: Some(camera(position)),
            page: Some("x".repeat(page)),
        };
        assert_eq!(pose([1.0, 0.0, 0.0], MAX_PAGE_BYTES).check(), Ok(()));
        assert!(pose([1.0, 0.0, 0.0], MAX_PAGE_BYTES + 1).check().is_err());
        assert!(pose([0.0; 3], 0).check().is_err());
        assert!(pose([f64::INFINITY, 0.0, 0.0], 0).check().is_err());
    }
}
