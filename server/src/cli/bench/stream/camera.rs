//! The case `camera`: times surfaces that follow the camera of a viewer, from the message to `done`, as the case `stream` times edits.
//!
//! All cameras look at the surface's bounding box, in a picture of [`VIEWPORT`]. From *near*, a voxel in the middle of the box's side
//! covers 8 pixels. From *far*, the whole box is in the picture. No camera is timed twice, because the server would find its surface in
//! the cache.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use isopeel_geometry::DVec3;
use isopeel_view::quality::{ErrorLimit, TriangleBudget};
use isopeel_view::{CameraJson, Edit};
use isopeel_volumes::Dataset;
use isopeel_volumes::open::open_dataset;
use serde::Serialize;

use super::super::volumes::Recipe;
use super::super::{Args, BenchError, Spread, print, round};
use super::client::{Client, Dragged, Request, Streamed};
use super::lines::{best_stages_ms, milliseconds};
use super::server::Server;
use super::{StreamError, dataset, runtime};

/// Width and height of the picture, pixels.
const VIEWPORT: [u32; 2] = [1280, 960];

/// Vertical field of view, degrees.
const FOV: f64 = 45.0;

/// Pixels that a voxel covers at the front of the box from near.
const NEAR_PIXELS: f64 = 8.0;

/// Elevations of the cameras of `rest`, degrees.
const JUMP_ELEVATIONS: [f64; 4] = [35.0, -10.0, 50.0, 5.0];

/// Degrees from one camera of `rest` to the next: the golden angle, so that no camera comes twice.
const JUMP: f64 = 137.507_764;

/// Elevation of an orbit and of a dolly, degrees.
const ELEVATION: f64 = 20.0;

/// Pause before each camera of `rest, measuring`: the server has begun to measure the surface.
const PAUSE: Duration = Duration::from_millis(600);

/// Degrees of an orbit.
const ORBIT: f64 = 90.0;

/// Steps of an orbit.
const ORBIT_STEPS: u32 = 18;

/// Steps of a dolly.
const DOLLY_STEPS: u32 = 20;

/// Factor of the distance to the surface in each step of a dolly.
const DOLLY_FACTOR: f64 = 0.9;

/// Cameras per second of `moving`.
const MOVING_HZ: f64 = 30.0;

/// Cameras of `moving`: an orbit in 2 s.
const MOVING_STEPS: u32 = 60;

/// Opens the files to show.
pub fn open(paths: &[PathBuf]) -> Result<Vec<Dataset>, StreamError> {
    Ok(paths.iter().map(|path| open_dataset(path)).collect::<Result<_, _>>()?)
}

/// Times the cameras of the files, or else of the generated volumes. No other engine may be open.
pub fn run(args: &Args, recipes: &[Recipe], files: Vec<Dataset>) -> Result<(), BenchError> {
    if files.is_empty() {
        return recipes.iter().try_for_each(|recipe| {
            let (dataset, _) = dataset(args, recipe)?;
            run_dataset(args, dataset, Some(recipe.iso))
        });
    }
    files
        .into_iter()
        .try_for_each(|dataset| run_dataset(args, dataset, args.iso))
}

fn run_dataset(args: &Args, dataset: Dataset, iso: Option<f32>) -> Result<(), BenchError> {
    let shown = dataset.clone();
    runtime()?.block_on(async {
        let server = Server::start(dataset, &args.device, args.in_process).await?;
        let mut client = Client::connect(server.address, &shown.id).await?;
        let opening = client.open(0).await?;
        let edit = Edit {
            iso: iso.or(opening.iso),
            error: Some(args.error),
            triangles: Some(TriangleBudget::AtMost(args.triangles)),
            ..Edit::default()
        };
        let bounds = client.tree_cut(&edit).await?;
        let mut bench = Bench {
            args,
            iso: edit.iso,
            scene: Scene::new(&shown, bounds),
            dataset: &shown,
            client,
        };
        bench.rest("rest", 0, Duration::ZERO).await?;
        bench.rest("rest, measuring", 1 + args.repeats, PAUSE).await?;
        let distances = [("far", bench.scene.far()), ("near", bench.scene.near())];
        for (distance, radius) in distances {
            let cameras = bench.scene.orbit(radius, 0.0, ORBIT_STEPS);
            bench.follow("orbit", Some(distance), &cameras, Duration::ZERO).await?;
        }
        let cameras = bench.scene.dolly();
        bench.follow("dolly", None, &cameras, Duration::ZERO).await?;
        for (distance, radius) in distances {
            bench.moving(distance, radius).await?;
        }
        drop(bench);
        Ok(server.stop().await?)
    })
}

/// The surface's bounding box in the world.
struct Scene {
    centre: DVec3,
    /// Half the size of the box.
    half: DVec3,
    /// World units of a voxel: the smallest spacing.
    voxel: f64,
}

impl Scene {
    /// Takes the bounding box in index space: lower and upper corner.
    fn new(dataset: &Dataset, bounds: [DVec3; 2]) -> Self {
        let space = dataset.sample_space();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in 0..8_usize {
            let component = |axis: usize| bounds[corner >> axis & 1][axis];
            let world = space.world(DVec3::new(component(0), component(1), component(2)));
            (low, high) = (low.min(world), high.max(world));
        }
        Self {
            centre: (low + high) / 2.0,
            half: (high - low) / 2.0,
            voxel: dataset.smallest_length(),
        }
    }

    /// Returns the pixels that a voxel covers at this distance from the camera, world units.
    fn pixels(&self, distance: f64) -> f64 {
        let focal = f64::from(VIEWPORT[1]) / 2.0 / (FOV / 2.0).to_radians().tan();
        focal * self.voxel / distance
    }

    /// Returns the distance from the centre from which a voxel in the middle of the box's side covers [`NEAR_PIXELS`].
    fn near(&self) -> f64 {
        // Pixels and distance are inversely proportional, so the same function converts in both directions.
        self.half.max_element() + self.pixels(NEAR_PIXELS)
    }

    /// Returns the distance from the centre at which the whole box is in the picture.
    fn far(&self) -> f64 {
        self.half.length() / (FOV / 2.0).to_radians().sin()
    }

    /// Returns the pixels that a voxel covers at the front of the box, if the camera is at its position.
    fn pixels_of(&self, camera: &CameraJson) -> f64 {
        let ray = DVec3::from(camera.position) - self.centre;
        self.pixels(ray.length() - self.front(ray.normalize()))
    }

    /// Returns the distance from the centre to the side of the box in a direction.
    fn front(&self, direction: DVec3) -> f64 {
        (self.half / direction.abs()).min_element()
    }

    /// Returns a camera at a radius around the centre that looks at the centre.
    fn around(&self, radius: f64, azimuth_elevation: [f64; 2]) -> CameraJson {
        look(self.centre + radius * direction(azimuth_elevation), self.centre)
    }

    /// Returns the start of an orbit around the centre, and its steps. `start`: azimuth, degrees.
    fn orbit(&self, radius: f64, start: f64, steps: u32) -> Vec<CameraJson> {
        let azimuth = |step| start + ORBIT * f64::from(step) / f64::from(steps);
        (0..=steps)
            .map(|step| self.around(radius, [azimuth(step), ELEVATION]))
            .collect()
    }

    /// Returns the start of a dolly from far to the side of the box, and its steps.
    fn dolly(&self) -> Vec<CameraJson> {
        let direction = direction([0.0, ELEVATION]);
        let front = self.front(direction);
        let target = self.centre + front * direction;
        let distance = |step| (self.far() - front) * DOLLY_FACTOR.powf(f64::from(step));
        (0..=DOLLY_STEPS)
            .map(|step| look(target + distance(step) * direction, target))
            .collect()
    }
}

fn direction([azimuth, elevation]: [f64; 2]) -> DVec3 {
    let ((sin, cos), (up, along)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    DVec3::new(along * cos, along * sin, up)
}

fn look(position: DVec3, target: DVec3) -> CameraJson {
    CameraJson {
        position: position.to_array(),
        target: target.to_array(),
        up: DVec3::Z.to_array(),
        fov: Some(FOV),
        height: None,
        viewport: VIEWPORT,
    }
}

/// A viewer whose surface is a tree cut.
struct Bench<'a> {
    args: &'a Args,
    iso: Option<f32>,
    scene: Scene,
    dataset: &'a Dataset,
    client: Client,
}

impl Bench<'_> {
    /// Times jumps between cameras that are near. `first`: number of the first camera; `pause`: time before each camera.
    async fn rest(&mut self, motion: &'static str, first: u32, pause: Duration) -> Result<(), BenchError> {
        let cameras: Vec<_> = (first..=first + self.args.repeats)
            .map(|i| [JUMP * f64::from(i), JUMP_ELEVATIONS[i as usize % JUMP_ELEVATIONS.len()]])
            .map(|angles| self.scene.around(self.scene.near(), angles))
            .collect();
        self.follow(motion, None, &cameras, pause).await
    }

    /// Times each camera after the first one. `pause`: time before each camera.
    async fn follow(
        &mut self,
        motion: &'static str,
        distance: Option<&'static str>,
        cameras: &[CameraJson],
        pause: Duration,
    ) -> Result<(), BenchError> {
        let mut steps = Vec::new();
        for camera in cameras {
            tokio::time::sleep(pause).await;
            steps.push(self.client.camera(camera).await?);
        }
        print(&self.line(motion, distance, &cameras[1..], Measured::steps(&steps[1..])))
    }

    /// Sends the cameras of another orbit at regular intervals.
    async fn moving(&mut self, distance: &'static str, radius: f64) -> Result<(), BenchError> {
        let cameras = self.scene.orbit(radius, ORBIT, MOVING_STEPS);
        self.client.camera(&cameras[0]).await?;
        let requests = cameras[1..].iter().map(|camera| Request::Camera { camera });
        let interval = Duration::from_secs_f64(1.0 / MOVING_HZ);
        let dragged = self.client.drag(requests, interval).await?;
        print(&self.line("moving", Some(distance), &cameras[1..], Measured::moving(&dragged)))
    }

    fn line(
        &self,
        motion: &'static str,
        distance: Option<&'static str>,
        cameras: &[CameraJson],
        measured: Measured,
    ) -> Line<'_> {
        let pixels =
            |camera: Option<&CameraJson>| camera.map_or(f64::NAN, |camera| round(self.scene.pixels_of(camera)));
        Line {
            volume: &self.dataset.title,
            dims: self.dataset.geometry.dims,
            sample_type: self.dataset.fields.first().map(|field| field.sample_type.name()),
            case: "camera",
            motion,
            distance,
            iso: self.iso,
            budget_triangles: self.args.triangles,
            error: self.args.error,
            cameras: cameras.len(),
            pixels_per_voxel: [pixels(cameras.first()), pixels(cameras.last())],
            measured,
        }
    }
}

/// The output line of one motion of the camera.
#[derive(Serialize)]
struct Line<'a> {
    volume: &'a str,
    dims: [u32; 3],
    #[serde(rename = "type")]
    sample_type: Option<&'static str>,
    case: &'static str,
    motion: &'static str,
    /// Distance of an orbit: `far` or `near`.
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<&'static str>,
    iso: Option<f32>,
    budget_triangles: u64,
    error: ErrorLimit,
    cameras: usize,
    /// Pixels of a voxel at the front of the surface's bounding box: of the first camera and of the last one.
    pixels_per_voxel: [f64; 2],
    #[serde(flatten)]
    measured: Measured,
}

/// Measurements of one motion.
#[derive(Serialize)]
#[serde(untagged)]
enum Measured {
    /// Each camera is sent after the `done` of the one before.
    Steps {
        /// Time to `done`.
        done_ms: Spread,
        /// Time of the work in the server.
        wall_ms: Spread,
        /// Sum of the device times of all stages.
        device_ms: Spread,
        /// Device time of each stage in the step with the best device time.
        stages_ms: BTreeMap<String, f64>,
        /// Mean bytes of all chunks of a step.
        encoded_bytes: f64,
        /// Sent regions as a fraction of all regions.
        resent_fraction: f64,
        /// Tolerance of the last step, world units.
        tolerance: Option<f32>,
        full_triangles: u64,
        /// Triangles of the largest step.
        triangles: u64,
    },
    /// Cameras are sent at regular intervals.
    Moving {
        hz: f64,
        /// Surfaces that were committed.
        generations: u64,
        generations_per_second: f64,
        longest_gap_ms: f64,
        settle_ms: f64,
        /// Bytes of all chunks.
        encoded_bytes: u64,
        /// Triangles of the last surface.
        triangles: u64,
    },
}

impl Measured {
    fn steps(steps: &[Streamed]) -> Self {
        let spread = |time_of: fn(&Streamed) -> f64| Spread::of(steps.iter().map(time_of));
        let sum = |count_of: fn(&Streamed) -> u64| steps.iter().map(count_of).sum::<u64>() as f64;
        let last = steps.last().map(|step| step.statistics.clone()).unwrap_or_default();
        Self::Steps {
            done_ms: spread(|step| milliseconds(step.done)),
            wall_ms: spread(|step| step.statistics.wall_ms),
            device_ms: spread(|step| step.statistics.device_ms()),
            stages_ms: best_stages_ms(steps),
            encoded_bytes: round(sum(|step| step.bytes) / steps.len() as f64),
            resent_fraction: round(sum(|step| step.regions) / sum(|step| step.regions + step.unchanged)),
            tolerance: last.tolerance,
            full_triangles: last.full_triangles,
            triangles: steps.iter().map(|step| step.statistics.triangles).max().unwrap_or(0),
        }
    }

    fn moving(dragged: &Dragged) -> Self {
        let seconds = f64::from(MOVING_STEPS) / MOVING_HZ;
        Self::Moving {
            hz: MOVING_HZ,
            generations: dragged.commits,
            generations_per_second: round(dragged.commits as f64 / seconds),
            longest_gap_ms: milliseconds(dragged.longest_gap),
            settle_ms: milliseconds(dragged.settle),
            encoded_bytes: dragged.bytes,
            triangles: dragged.statistics.triangles,
        }
    }
}
