//! Regions of interest, in which importance is raised, in JSON and on the command line.

use std::str::FromStr;

use isopeel_geometry::{DVec3, IndexSpace};
use isopeel_kernels::interest::MAX_INTERESTS;
use isopeel_kernels::{Interest, InterestShape};
use serde::{Deserialize, Serialize};

use super::error::EditError;

/// A region of interest, in world coordinates: a sphere or a box. Importance inside is at least its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "Interest", optional_fields))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct InterestJson {
    /// The sphere; without it, there is a box.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere: Option<SphereJson>,
    /// The box.
    #[serde(default, rename = "box", skip_serializing_if = "Option::is_none")]
    pub cuboid: Option<BoxJson>,
    /// Importance, 0 to 1.
    pub importance: f32,
}

/// A sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "Sphere"))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct SphereJson {
    /// Centre of the sphere.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub center: [f64; 3],
    /// Radius, above 0.
    pub radius: f64,
}

/// A box along the axes of the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "Box"))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct BoxJson {
    /// Minimum along each axis.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub min: [f64; 3],
    /// Maximum along each axis, above the minimum.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub max: [f64; 3],
}

impl InterestJson {
    /// Returns shape, centre, and half the size along each axis of the world.
    ///
    /// # Errors
    /// The invalid value, and the expected one.
    fn extent(&self) -> Result<(InterestShape, DVec3, DVec3), String> {
        match (self.sphere, self.cuboid) {
            (Some(SphereJson { center, radius }), None) => {
                if !is_finite(center) {
                    return Err(format!("center {center:?}, expected finite numbers"));
                }
                if !(radius.is_finite() && radius > 0.0) {
                    return Err(format!("radius {radius}, expected a finite number above 0"));
                }
                Ok((InterestShape::Ball, center.into(), DVec3::splat(radius)))
            }
            (None, Some(BoxJson { min, max })) => {
                if !is_finite(min) || !is_finite(max) || (0..3).any(|i| min[i] >= max[i]) {
                    return Err(format!(
                        "min {min:?} and max {max:?}, expected finite numbers, each of min below that of max"
                    ));
                }
                // The corners are halved before they are added, because their sum could be infinite.
                let [min, max] = [min, max].map(|corner| 0.5 * DVec3::from(corner));
                Ok((InterestShape::Cube, min + max, max - min))
            }
            (Some(_), Some(_)) => Err("a sphere and a box, expected one of both".into()),
            (None, None) => Err("neither a sphere nor a box, expected one of both".into()),
        }
    }

    /// Checks that the region is valid.
    fn check(&self) -> Result<(), String> {
        self.extent()?;
        if !(0.0..=1.0).contains(&self.importance) {
            return Err(format!("importance {}, expected 0 to 1", self.importance));
        }
        Ok(())
    }

    /// Converts to the kernels' type, for a volume with this index space; `None` if the region is not valid. If the samples are unevenly
    /// spaced, a sphere becomes the ellipsoid of index space with the same ends along the axes.
    pub(super) fn to_kernel(&self, index_space: &IndexSpace) -> Option<Interest> {
        let (shape, centre, half_size) = self.extent().ok()?;
        if let Some((centre, half_size)) = index_space.extent(centre, half_size) {
            return Some(Interest {
                centre: to_f32(centre),
                rows: [DVec3::X / half_size.x, DVec3::Y / half_size.y, DVec3::Z / half_size.z].map(to_f32),
                shape,
                importance: self.importance,
            });
        }
        let world_from_index = index_space.world_from_even;
        let rows = world_from_index.matrix3.transpose();
        let rows = [
            rows.x_axis / half_size.x,
            rows.y_axis / half_size.y,
            rows.z_axis / half_size.z,
        ];
        Some(Interest {
            centre: to_f32(world_from_index.inverse().transform_point3(centre)),
            rows: rows.map(to_f32),
            shape,
            importance: self.importance,
        })
    }
}

/// Checks a list of regions.
pub(super) fn check(interest: &[InterestJson]) -> Result<(), EditError> {
    let refuse = |why| EditError { field: "interest", why };
    if interest.len() > MAX_INTERESTS {
        return Err(refuse(format!(
            "{} regions, expected at most {MAX_INTERESTS}",
            interest.len()
        )));
    }
    let mut numbered = interest.iter().enumerate();
    numbered.try_for_each(|(i, region)| region.check().map_err(|why| refuse(format!("region {i} has {why}"))))
}

fn is_finite(numbers: [f64; 3]) -> bool {
    numbers.iter().all(|x| x.is_finite())
}

/// Converts to the nearest finite 32-bit numbers. Only positions that are farther away than any sample are clamped.
fn to_f32(numbers: DVec3) -> [f32; 3] {
    numbers.to_array().map(|x| (x as f32).clamp(f32::MIN, f32::MAX))
}

/// Parses `sphere:X,Y,Z:R=I` or `box:X,Y,Z:X,Y,Z=I` of the command line.
impl FromStr for InterestJson {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = parse(text).ok_or_else(|| {
            format!("{text:?}, expected sphere:X,Y,Z:R=I or box:X,Y,Z:X,Y,Z=I, such as sphere:10,-20,30:5=0.9")
        })?;
        parsed.check().map_err(|why| format!("{text:?} has {why}"))?;
        Ok(parsed)
    }
}

/// Parses a region, without a check of its numbers.
fn parse(text: &str) -> Option<InterestJson> {
    let (extent, importance) = text.split_once('=')?;
    let mut parts = extent.split(':');
    let [kind, first, second] = [parts.next()?, parts.next()?, parts.next()?];
    if parts.next().is_some() {
        return None;
    }
    let (sphere, cuboid) = match kind {
        "sphere" => (
            Some(SphereJson {
                center: triple(first)?,
                radius: second.parse().ok()?,
            }),
            None,
        ),
        "box" => (
            None,
            Some(BoxJson {
                min: triple(first)?,
                max: triple(second)?,
            }),
        ),
        _ => return None,
    };
    Some(InterestJson {
        sphere,
        cuboid,
        importance: importance.parse().ok()?,
    })
}

/// Parses three numbers, `X,Y,Z`.
pub(super) fn triple(text: &str) -> Option<[f64; 3]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.parse().ok()).collect();
    numbers?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use isopeel_geometry::{DAffine3, DMat3};

    use super::*;

    fn sphere(center: [f64; 3], radius: f64, importance: f32) -> InterestJson {
        InterestJson {
            sphere: Some(SphereJson { center, radius }),
            cuboid: None,
            importance,
        }
    }

    fn cuboid(min: [f64; 3], max: [f64; 3], importance: f32) -> InterestJson {
        InterestJson {
            sphere: None,
            cuboid: Some(BoxJson { min, max }),
            importance,
        }
    }

    #[test]
    fn text_and_json_say_the_same() {
        for (text, json, expected) in [
            (
                "sphere:10,-20,30:5=0.9",
                r#"{"sphere":{"center":[10.0,-20.0,30.0],"radius":5.0},"importance":0.9}"#,
                sphere([10.0, -20.0, 30.0], 5.0, 0.9),
            ),
            (
                "box:-1e2,0,0:-1,1.5e-3,10=1",
                r#"{"box":{"min":[-100.0,0.0,0.0],"max":[-1.0,0.0015,10.0]},"importance":1.0}"#,
                cuboid([-100.0, 0.0, 0.0], [-1.0, 0.0015, 10.0], 1.0),
            ),
        ] {
            assert_eq!(text.parse(), Ok(expected.clone()));
            assert_eq!(serde_json::to_string(&expected).expect("JSON"), json);
            assert_eq!(serde_json::from_str::<InterestJson>(json).expect(json), expected);
        }
    }

    #[test]
    fn other_texts_are_refused_with_what_was_expected() {
        for text in [
            "",
            "sphere",
            "sphere:1,2,3:4",
            "sphere:1,2:4=1",
            "sphere:1,2,3,4:4=1",
            "sphere:1,2,3:4:5=1",
            "box:1,2,3:4=1",
            "ball:1,2,3:4=1",
            "sphere:1,2,x:4=1",
            "sphere:1,2,3:4=",
        ] {
            let error = text.parse::<InterestJson>().expect_err(text);
            assert!(
                error.starts_with(&format!("{text:?}, expected sphere:X,Y,Z:R=I or box:X,Y,Z:X,Y,Z=I")),
                "{error}"
            );
        }
        let error = "sphere:1,2,3:-4=1".parse::<InterestJson>().expect_err("below 0");
        assert_eq!(
            error,
            r#""sphere:1,2,3:-4=1" has radius -4, expected a finite number above 0"#
        );
        assert!("sphere:nan,2,3:4=1".parse::<InterestJson>().is_err());
        assert!("sphere:1,2,3:inf=1".parse::<InterestJson>().is_err());
        assert!("sphere:1,2,3:4=1.5".parse::<InterestJson>().is_err());
    }

    #[test]
    fn what_is_wrong_is_named() {
        let both = InterestJson {
            cuboid: Some(BoxJson {
                min: [0.0; 3],
                max: [1.0; 3],
            }),
            ..sphere([0.0; 3], 1.0, 0.5)
        };
        let neither = InterestJson {
            sphere: None,
            ..sphere([0.0; 3], 1.0, 0.5)
        };
        let good = || sphere([0.0; 3], 1.0, 0.5);
        for (interest, why) in [
            (both, "region 1 has a sphere and a box, expected one of both"),
            (neither, "region 1 has neither a sphere nor a box, expected one of both"),
            (
                sphere([0.0, f64::NAN, 0.0], 1.0, 0.5),
                "region 1 has center [0.0, NaN, 0.0], expected finite numbers",
            ),
            (
                sphere([0.0; 3], 0.0, 0.5),
                "region 1 has radius 0, expected a finite number above 0",
            ),
            (
                cuboid([0.0, 2.0, 0.0], [1.0, 2.0, 1.0], 0.5),
                "region 1 has min [0.0, 2.0, 0.0] and max [1.0, 2.0, 1.0], expected finite numbers, each of min below that of max",
            ),
            (
                sphere([0.0; 3], 1.0, 1.5),
                "region 1 has importance 1.5, expected 0 to 1",
            ),
            (
                sphere([0.0; 3], 1.0, f32::NAN),
                "region 1 has importance NaN, expected 0 to 1",
            ),
        ] {
            let error = check(&[good(), interest]).expect_err(why);
            assert_eq!((error.field, error.why.as_str()), ("interest", why));
        }
        assert!(check(&vec![good(); 64]).is_ok());
        let error = check(&vec![good(); 65]).expect_err("too many");
        assert_eq!(error.to_string(), "interest: 65 regions, expected at most 64");
    }

    #[test]
    fn the_kernels_get_it_in_index_space() {
        // x of the grid is y of the world, y is minus x.
        let turned = DAffine3 {
            matrix3: DMat3::from_cols(
                DVec3::new(0.0, 2.0, 0.0),
                DVec3::new(-4.0, 0.0, 0.0),
                DVec3::new(0.0, 0.0, 0.5),
            ),
            translation: DVec3::new(100.0, 10.0, 0.0),
        };
        let kernel = cuboid([84.0, 10.0, 0.0], [92.0, 30.0, 1.0], 0.25)
            .to_kernel(&turned.into())
            .expect("valid");
        assert_eq!(kernel.centre, [5.0, 3.0, 1.0]);
        assert_eq!(kernel.rows, [[0.0, -1.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!((kernel.shape, kernel.importance), (InterestShape::Cube, 0.25));
        let far = sphere([1e300; 3], 1e-300, 0.5)
            .to_kernel(&turned.into())
            .expect("valid");
        assert!(
            far.centre
                .iter()
                .chain(far.rows.iter().flatten())
                .all(|x| x.is_finite())
        );
    }
}
