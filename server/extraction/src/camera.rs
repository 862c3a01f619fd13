//! A camera's view of a surface: how much error each region may have, and what an error in pixels is in space
//! (docs/algorithm.md#81-cuts-for-a-camera).

use std::sync::Arc;

use isopeel_geometry::{DVec3, IndexSpace};
use isopeel_kernels::{CurvePoint, REGION_CELLS, RegionWeights};
use isopeel_view::quality::PixelLimit;
use isopeel_view::{CameraJson, Projection};

/// Minimum distance that counts, in smallest spacings: what is nearer is as fine as there.
const NEAREST: f64 = 8.0;
/// Weight of what the camera does not see.
const OUTSIDE_WEIGHT: f64 = 16.0;
/// The camera counts as seeing what is up to this share of its half angles beyond the picture, so that small turns show no coarse border.
const MARGIN: f64 = 0.15;
/// Pixels below which an error cannot be seen.
const SEEN_PIXELS: f32 = 0.25;
/// Bounds of weights, so that weighted tolerances are normal floats.
const WEIGHTS: [f64; 2] = [1e-9, 1e9];
/// Nearly all of a surface lies within this multiple of the root mean square that quadrics estimate (`tests/scripts/pixels.py promise`).
const SPREAD: f32 = 2.0;
/// Without a curve, the distance in space is this factor times the tolerance to the power of [`EXPONENT`], in smallest spacings.
const FACTOR: f32 = 0.16;
/// See [`FACTOR`]. Also the slope of a curve beyond its ends.
const EXPONENT: f32 = 0.6;

/// A camera in the world, with the lengths of a volume.
struct Camera {
    position: DVec3,
    /// Sides of the picture with its margin, and the back of a perspective camera: outside, the product of the vector from the camera with
    /// the first value is above the second one.
    sides: Vec<(DVec3, f64)>,
    is_perspective: bool,
    /// Pixels of a world unit; at distance 1 if the picture is perspective.
    pixels: f64,
    /// Distance of the target, smallest spacings.
    target_distance: f64,
    /// World units of the smallest spacing.
    smallest: f64,
}

/// A region as the camera sees it.
struct SeenRegion {
    /// How much more error it may have than what is at the target's distance.
    weight: f32,
    /// Pixels of the smallest spacing at its distance; `None` if it is outside the picture.
    pixels: Option<f32>,
}

/// The regions of a surface as a camera sees them.
pub(crate) struct SeenSurface {
    regions: Vec<SeenRegion>,
    /// Whether weights differ between what the camera sees.
    is_perspective: bool,
}

/// Distance within which nearly all of a cut lies, over the cut's tolerance, both in smallest spacings; distances grow with tolerances.
pub(crate) struct ErrorCurve {
    points: Vec<[f32; 2]>,
}

/// Tolerances of a cut for a camera, in smallest spacings at the distance of the camera's target.
#[derive(Clone, Copy)]
pub(crate) struct CameraTolerances {
    /// That of the error that was asked for; below 0 if there is none.
    pub asked: f32,
    /// That below which an error is too small to see.
    pub seen: f32,
    /// Maximum error over weight of a node, wherever it is.
    pub guard: f32,
}

impl Camera {
    /// Takes a camera of the JSON; `None` if it is not valid.
    fn new(json: &CameraJson, smallest: f64) -> Option<Self> {
        json.check().ok()?;
        let [position, target, up] = [json.position, json.target, json.up].map(DVec3::from);
        let forward = (target - position).normalize();
        let right = forward.cross(up).normalize();
        let upward = right.cross(forward);
        let [width, height] = json.viewport.map(f64::from);
        let (half_height, is_perspective) = match json.projection().ok()? {
            Projection::Perspective(fov) => ((fov / 2.0).tan(), true),
            Projection::Parallel(size) => (size / 2.0, false),
        };
        let [half_width, half_height_seen] =
            [half_height * width / height, half_height].map(|half| half * (1.0 + MARGIN));
        let directions = [
            (right, half_width),
            (-right, half_width),
            (upward, half_height_seen),
            (-upward, half_height_seen),
        ];
        let mut sides: Vec<_> = directions
            .into_iter()
            .map(|(direction, half)| match is_perspective {
                true => (direction - half * forward, 0.0),
                false => (direction, half),
            })
            .collect();
        if is_perspective {
            sides.push((-forward, 0.0));
        }
        Some(Self {
            position,
            sides,
            is_perspective,
            pixels: height / (2.0 * half_height),
            target_distance: (target.distance(position) / smallest).max(NEAREST),
            smallest,
        })
    }

    /// Whether a parallelepiped may be in the picture or its margin: it is not if all of it is beyond one side.
    fn sees(&self, middle: DVec3, half_edges: [DVec3; 3]) -> bool {
        self.sides.iter().all(|&(direction, limit)| {
            let reach: f64 = half_edges.iter().map(|edge| direction.dot(*edge).abs()).sum();
            direction.dot(middle - self.position) - reach <= limit
        })
    }

    /// A region from its lower to its upper corner in index space.
    fn see(&self, space: &IndexSpace, low: DVec3, high: DVec3) -> SeenRegion {
        let origin = space.world(low);
        let half_edges = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
            let end = low + axis * (high - low);
            (space.world(end) - origin) / 2.0
        });
        let is_seen = self.sees(origin + half_edges.into_iter().sum::<DVec3>(), half_edges);
        let outside = if is_seen { 1.0 } else { OUTSIDE_WEIGHT };
        if !self.is_perspective {
            return SeenRegion {
                weight: outside as f32,
                pixels: is_seen.then_some((self.pixels * self.smallest) as f32),
            };
        }
        // The nearest place of the region's inner half: its own distance, on average, also if the camera is inside.
        let quarter = (high - low) / 4.0;
        let nearest = space.index(self.position).clamp(low + quarter, high - quarter);
        let distance = (space.world(nearest).distance(self.position) / self.smallest).max(NEAREST);
        let weight = outside * (distance / self.target_distance).powi(2);
        SeenRegion {
            weight: weight.clamp(WEIGHTS[0], WEIGHTS[1]) as f32,
            pixels: is_seen.then_some((self.pixels / distance) as f32),
        }
    }
}

impl SeenSurface {
    /// Looks at the regions of a surface. `coords`: their positions in units of 32 cells; `dims`: samples of the volume; `smallest`: world
    /// units of the smallest spacing.
    pub(crate) fn new(
        camera: &CameraJson,
        coords: impl Iterator<Item = [u32; 3]>,
        dims: [u32; 3],
        space: &IndexSpace,
        smallest: f64,
    ) -> Option<Self> {
        let camera = Camera::new(camera, smallest)?;
        let corner = |coords: [u32; 3], add: u32| {
            let of = |axis: usize| f64::from(((coords[axis] + add) * REGION_CELLS).min(dims[axis] - 1));
            DVec3::new(of(0), of(1), of(2))
        };
        let see = |coords| camera.see(space, corner(coords, 0), corner(coords, 1));
        Some(Self {
            regions: coords.map(see).collect(),
            is_perspective: camera.is_perspective,
        })
    }

    /// Weights for a cut. What a perspective camera sees changes its weight with each move, so tolerances are in steps.
    pub(crate) fn weights(&self) -> Arc<RegionWeights> {
        Arc::new(RegionWeights {
            of_regions: self.regions.iter().map(|region| region.weight).collect(),
            in_steps: self.is_perspective,
        })
    }

    /// The tolerance at which nearly all lies within this many pixels everywhere in the picture; the largest number if the picture shows
    /// nothing.
    pub(crate) fn tolerance(&self, pixels: f32, curve: &ErrorCurve) -> f32 {
        let of_region = |region: &SeenRegion| Some(curve.tolerance(pixels / region.pixels?) / region.weight);
        let tolerances = self.regions.iter().filter_map(of_region);
        tolerances.fold(f32::INFINITY, f32::min).min(f32::MAX)
    }

    /// The tolerance below which an error is too small to see.
    pub(crate) fn seen_tolerance(&self, pixels: Option<f32>, curve: &ErrorCurve) -> f32 {
        self.tolerance(pixels.unwrap_or(SEEN_PIXELS).min(SEEN_PIXELS), curve)
    }

    /// Whether a guard on the error allows less than a tolerance everywhere in the picture.
    fn is_guarded(&self, tolerance: f32, guard: f32) -> bool {
        let mut seen = self.regions.iter().filter(|region| region.pixels.is_some());
        guard.is_finite() && seen.all(|region| guard < tolerance * region.weight)
    }

    /// Returns the pixels within which nearly all of a cut lies in the picture. `areas`: of each region's full surface; `guard`: maximum error over weight of a node.
    pub(crate) fn pixels_within(
        &self,
        tolerance: f32,
        guard: f32,
        areas: impl Iterator<Item = f32>,
        curve: &ErrorCurve,
    ) -> f32 {
        let (mut sum2, mut weight_sum) = (0.0, 0.0);
        for (region, area) in self.regions.iter().zip(areas) {
            let Some(pixels) = region.pixels else { continue };
            let mut of_region = tolerance.max(0.0) * region.weight;
            if self.is_perspective && of_region.is_normal() {
                of_region = 4f32.powf((of_region.log2() / 2.0).floor());
            }
            // A surface covers more pixels the nearer it is.
            let covered = f64::from(area) * f64::from(pixels).powi(2);
            sum2 += covered * f64::from(curve.distance(of_region.min(guard)) * pixels).powi(2);
            weight_sum += covered;
        }
        if weight_sum > 0.0 {
            (sum2 / weight_sum).sqrt() as f32
        } else {
            0.0
        }
    }

    /// Says what decides a cut of a tolerance.
    pub(crate) fn limit(&self, tolerance: f32, of: CameraTolerances, is_full: bool) -> PixelLimit {
        if is_full {
            PixelLimit::Data
        } else if self.is_guarded(tolerance, of.guard) {
            PixelLimit::Guard
        } else if tolerance > of.asked.max(of.seen) {
            PixelLimit::Budget
        } else if of.asked < of.seen {
            PixelLimit::Pixels
        } else {
            PixelLimit::Error
        }
    }
}

impl ErrorCurve {
    /// Takes the curve of a tree whose weights are all 1.
    pub(crate) fn new(curve: &[CurvePoint]) -> Self {
        let mut points: Vec<[f32; 2]> = Vec::new();
        for point in curve {
            let grows = points
                .last()
                .is_none_or(|last| point.threshold > last[0] && SPREAD * point.rms > last[1]);
            let is_positive = point.threshold > 0.0 && point.rms > 0.0 && point.threshold.is_finite();
            if grows && is_positive {
                points.push([point.threshold, SPREAD * point.rms]);
            }
        }
        Self { points }
    }

    /// The distance at a tolerance.
    fn distance(&self, tolerance: f32) -> f32 {
        if tolerance <= 0.0 {
            return 0.0;
        }
        self.interpolate(0, tolerance, EXPONENT)
            .unwrap_or(FACTOR * tolerance.powf(EXPONENT))
    }

    /// The tolerance of a distance.
    fn tolerance(&self, distance: f32) -> f32 {
        let of_curve = self.interpolate(1, distance, 1.0 / EXPONENT);
        of_curve.unwrap_or((distance / FACTOR).powf(1.0 / EXPONENT))
    }

    /// The other coordinate of the curve where coordinate `axis` is `at`, linear between points on logarithmic scales, with this slope
    /// beyond the ends. `None` if there is no point.
    fn interpolate(&self, axis: usize, at: f32, slope: f32) -> Option<f32> {
        let end = |point: &[f32; 2]| point[1 - axis] * (at / point[axis]).powf(slope);
        let above = self.points.partition_point(|point| point[axis] < at);
        let (Some(low), Some(high)) = (above.checked_sub(1).map(|i| &self.points[i]), self.points.get(above)) else {
            return self.points.get(above).or(self.points.last()).map(end);
        };
        let share = (at / low[axis]).ln() / (high[axis] / low[axis]).ln();
        Some(low[1 - axis] * (high[1 - axis] / low[1 - axis]).powf(share))
    }
}

#[cfg(test)]
mod tests {
    use isopeel_geometry::{DAffine3, DMat3, DVec3, IndexSpace};
    use isopeel_kernels::CurvePoint;
    use isopeel_view::CameraJson;

    use super::{CameraTolerances, ErrorCurve, PixelLimit, SeenSurface};

    /// A row of regions along x, 1 world unit a spacing; the camera is at -100 and looks along it.
    fn seen(projection: &str) -> SeenSurface {
        let json = format!(r#"{{"position":[-100,16,16],"target":[0,16,16],{projection},"viewport":[200,100]}}"#);
        let camera: CameraJson = serde_json::from_str(&json).expect("a camera");
        let space = IndexSpace {
            world_from_even: DAffine3::from_mat3_translation(DMat3::IDENTITY, DVec3::ZERO),
            uneven: None,
        };
        let regions = [[0, 0, 0], [5, 0, 0], [0, 5, 0]].into_iter();
        SeenSurface::new(&camera, regions, [200, 200, 200], &space, 1.0).expect("a camera")
    }

    fn curve() -> ErrorCurve {
        let point = |threshold: f32, rms| CurvePoint {
            threshold,
            triangles: 0,
            rms,
        };
        ErrorCurve::new(&[point(-1.0, 0.0), point(1.0, 0.0625), point(8.0, 0.25), point(9.0, 0.2)])
    }

    #[test]
    fn weights_grow_with_the_square_of_the_distance_and_outside_of_the_picture() {
        let seen = seen(r#""fov":40"#);
        // The inner half of the first region begins at 8, that of the second one at 168.
        let expected = [1.08f32.powi(2), 2.68f32.powi(2)];
        let weights = seen.weights();
        assert!(weights.in_steps);
        for (weight, expected) in weights.of_regions.iter().zip(expected) {
            assert!((weight / expected - 1.0).abs() < 1e-5, "{weight} {expected}");
        }
        assert!(seen.regions[2].pixels.is_none() && weights.of_regions[2] > 16.0);
        let pixels = 50.0 / 20f32.to_radians().tan() / 108.0;
        let found = seen.regions[0].pixels.expect("in the picture");
        assert!((found / pixels - 1.0).abs() < 1e-5, "{found} {pixels}");
    }

    #[test]
    fn a_parallel_picture_has_one_scale() {
        let seen = seen(r#""height":50"#);
        let weights = seen.weights();
        assert_eq!(
            (&weights.of_regions[..], weights.in_steps),
            (&[1.0, 1.0, 16.0][..], false)
        );
        assert_eq!(seen.regions[1].pixels, Some(2.0));
    }

    #[test]
    fn the_curve_is_read_both_ways_and_goes_on_beyond_its_ends() {
        let curve = curve();
        assert_eq!(curve.points.len(), 2, "errors that do not grow are left out");
        for tolerance in [0.01, 0.5, 1.0, 3.0, 8.0, 100.0] {
            let again = curve.tolerance(curve.distance(tolerance));
            assert!((again / tolerance - 1.0).abs() < 1e-4, "{tolerance} {again}");
        }
        assert!((curve.distance(2.0) - 0.125 * 4f32.powf(1.0 / 3.0)).abs() < 1e-5);
        assert!((curve.distance(16.0) - 0.5 * 2f32.powf(0.6)).abs() < 1e-5);
        assert_eq!(curve.distance(-1.0), 0.0);
        let without = ErrorCurve::new(&[]);
        assert!((without.distance(1.0) - 0.16).abs() < 1e-6 && (without.tolerance(0.16) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn pixels_hold_everywhere_in_the_picture() {
        let (seen, curve) = (seen(r#""fov":40"#), curve());
        let tolerance = seen.tolerance(0.5, &curve);
        for region in &seen.regions[..2] {
            let pixels = curve.distance(tolerance * region.weight) * region.pixels.expect("in the picture");
            assert!(pixels <= 0.5001, "{pixels}");
        }
        let within = seen.pixels_within(tolerance, f32::INFINITY, [1.0, 1.0, 1e9].into_iter(), &curve);
        assert!((0.1..=0.5).contains(&within), "{within}");
        // Below a quarter of a pixel nothing is seen, unless less was asked for.
        assert!(seen.seen_tolerance(None, &curve) < tolerance);
        assert!(seen.seen_tolerance(Some(0.1), &curve) < seen.seen_tolerance(Some(3.0), &curve));
    }

    #[test]
    fn what_decides_is_named() {
        let seen = seen(r#""fov":40"#);
        let of = CameraTolerances {
            asked: 2.0,
            seen: 1.0,
            guard: f32::INFINITY,
        };
        assert_eq!(seen.limit(2.0, of, false), PixelLimit::Error);
        assert_eq!(seen.limit(3.0, of, false), PixelLimit::Budget);
        assert_eq!(seen.limit(3.0, of, true), PixelLimit::Data);
        assert_eq!(
            seen.limit(1.0, CameraTolerances { asked: -1.0, ..of }, false),
            PixelLimit::Pixels
        );
        assert_eq!(
            seen.limit(2.0, CameraTolerances { guard: 0.5, ..of }, false),
            PixelLimit::Guard
        );
        assert_eq!(
            seen.limit(2.0, CameraTolerances { guard: 3.0, ..of }, false),
            PixelLimit::Error
        );
    }
}
