//! The cases of the benchmark, except `stream` and `camera`: times them and prints their lines.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use isopeel_codec::chunk::{PrefixId, WireVertex};
use isopeel_codec::encode::{self, MAX_TASK_REGIONS, MeshHash};
use isopeel_kernels::{
    BRICK_CELLS, ControlPoint, CutParams, DeviceSpeed, Engine, Feature, Isovalue, Level, Never, Pyramid, Region,
    StageTime, Surface, SurfaceStatistics, TransferFunction, Volume,
};
use isopeel_view::quality::MesherName;
use rayon::prelude::*;

use super::reference::{check_mesh, count, equal};
use super::volumes::Recipe;
use super::{Args, BenchError, CaseName, Line, Spread, params, print, round};

/// Stage that reads the mesh back to the host.
const READ_BACK: &str = "read back";

/// Times of one run of a case.
struct Timing {
    wall: Duration,
    stages: Vec<StageTime>,
}

/// A volume and the inputs of its cases.
struct Bench<'a> {
    engine: &'a Engine,
    speed: &'a DeviceSpeed,
    args: &'a Args,
    recipe: &'a Recipe,
    volume: Volume,
    feature: Option<Volume>,
}

/// Times the chosen cases of one volume.
pub(super) fn run(engine: &Engine, speed: &DeviceSpeed, args: &Args, recipe: &Recipe) -> Result<(), BenchError> {
    let mut bench = Bench {
        engine,
        speed,
        args,
        recipe,
        volume: recipe.generate(engine)?,
        feature: recipe.generate_feature(engine)?,
    };
    let wanted = |case| args.wants(case);

    let pyramid = bench.check()?;
    if wanted(CaseName::Load) {
        bench.load()?;
    }
    for &fraction in &args.fraction {
        let cut = bench.cut(&pyramid, fraction)?;
        if wanted(CaseName::First) {
            bench.isovalue("first isovalue", fraction, &cut, true)?;
        }
        if wanted(CaseName::Next) {
            bench.isovalue("next isovalue", fraction, &cut, false)?;
        }
        if wanted(CaseName::Step) {
            bench.step(fraction, &cut)?;
        }
        if wanted(CaseName::Edit) {
            bench.edit(&pyramid, fraction, &cut, false)?;
        }
        if wanted(CaseName::Encode) {
            bench.encode(&pyramid, fraction, &cut)?;
        }
        if wanted(CaseName::Bytes) {
            bench.edit(&pyramid, fraction, &cut, true)?;
        }
    }
    Ok(())
}

impl Bench<'_> {
    /// Compares counts and mesh at the recipe's isovalue with the reference. Returns the pyramid.
    fn check(&self) -> Result<Pyramid, BenchError> {
        let counts = count(self.engine, &self.volume, self.recipe.iso)?;
        let pyramid = self.pyramid(self.recipe.iso, None)?;
        equal(
            self.recipe,
            "full triangles",
            pyramid.full_triangles(),
            counts.full_triangles,
        )?;
        equal(self.recipe, "active cells", pyramid.active_cells(), counts.active_cells)?;
        let full = self.peel(&pyramid, &params(self.args, self.recipe))?;
        check_mesh(self.recipe, &full)?;
        let expected = match self.args.mesher {
            MesherName::Dual => counts.dual_triangles,
            MesherName::MarchingCubes => counts.full_triangles,
        };
        equal(
            self.recipe,
            "triangles at full resolution",
            full.statistics.triangles,
            expected,
        )?;
        Ok(pyramid)
    }

    /// Builds a pyramid as the server does: only cells for the full surface, and all levels for any other cut.
    fn pyramid(&self, iso: f32, cut: Option<&CutParams>) -> Result<Pyramid, BenchError> {
        let feature = self.feature.as_ref().map_or(Feature::None, Feature::Field);
        let iso = Isovalue::new(iso)?;
        Ok(if cut.is_some_and(|cut| cut.is_full(Level::FINEST)) {
            self.engine.build_cells(&self.volume, feature, iso, &Never)?
        } else {
            self.engine.build_pyramid(&self.volume, feature, iso, &Never)?
        })
    }

    fn peel(&self, pyramid: &Pyramid, params: &CutParams) -> Result<Surface, BenchError> {
        Ok(self.engine.peel(&self.volume, pyramid, params, Level::FINEST, &Never)?)
    }

    /// Returns the cut that keeps at most `fraction` of the full surface's triangles, or the minimum that decimation can reach.
    fn cut(&self, pyramid: &Pyramid, fraction: f64) -> Result<CutParams, BenchError> {
        let cut = params(self.args, self.recipe);
        if fraction >= 1.0 {
            return Ok(cut);
        }
        let budget = (fraction * pyramid.full_triangles() as f64) as u64;
        Ok(self.engine.fit(&self.volume, pyramid, &cut, budget, &Never)?.0)
    }

    /// Runs a case once to warm up, and then `repeats` times. Returns the times of the latter.
    fn time(&self, mut once: impl FnMut(u32) -> Result<Timing, BenchError>) -> Result<Vec<Timing>, BenchError> {
        once(0)?;
        (1..=self.args.repeats).map(once).collect()
    }

    /// Returns the output line of a case without the values of a surface.
    fn line(&self, case: &'static str, runs: &[Timing], bytes_read: Option<u64>) -> Line {
        let stage_ms = |run: &Timing, read_back: bool| -> f64 {
            let stages = run.stages.iter().filter(|t| (t.stage == READ_BACK) == read_back);
            stages.map(|t| t.milliseconds).sum()
        };
        let device = spread(runs, |run| stage_ms(run, false));
        let mut stages_ms = BTreeMap::new();
        if let Some(best) = runs
            .iter()
            .min_by(|a, b| stage_ms(a, false).total_cmp(&stage_ms(b, false)))
        {
            for time in &best.stages {
                *stages_ms.entry(time.stage).or_default() += time.milliseconds;
            }
            stages_ms.values_mut().for_each(|time| *time = round(*time));
        }
        let has_stages = !stages_ms.is_empty();
        let has_read_back = stages_ms.contains_key(READ_BACK);
        let seconds = device.best / 1e3;
        Line {
            volume: self.recipe.name.clone(),
            dims: self.recipe.grid.dims,
            sample_type: self.recipe.sample_type.name(),
            volume_bytes: self.volume.sample_bytes(),
            iso: self.recipe.iso,
            case,
            repeats: self.args.repeats,
            wall_ms: Some(spread(runs, |run| run.wall.as_secs_f64() * 1e3)),
            device_ms: has_stages.then_some(device),
            read_back_ms: has_read_back.then(|| spread(runs, |run| stage_ms(run, true))),
            stages_ms,
            bytes_read,
            bandwidth_fraction: bytes_read
                .filter(|_| has_stages && seconds > 0.0)
                .map(|bytes| round(bytes as f64 / seconds / self.speed.copy_bytes_per_second)),
            ..Line::default()
        }
    }

    /// Adds the values of a surface to a line.
    fn surface_line(&self, line: Line, fraction: f64, cut: &CutParams, statistics: &SurfaceStatistics) -> Line {
        let full = statistics.full_triangles;
        Line {
            fraction: Some(fraction),
            beta: Some(cut.beta),
            mesher: Some(match self.args.mesher {
                MesherName::Dual => "dual",
                MesherName::MarchingCubes => "marching cubes",
            }),
            device_bytes: Some(statistics.device_bytes),
            device_bytes_per_full_triangle: (full > 0).then(|| round(statistics.device_bytes as f64 / full as f64)),
            full_triangles: Some(full),
            triangles: Some(statistics.triangles),
            vertices: Some(statistics.vertices),
            ..line
        }
    }

    fn load(&mut self) -> Result<(), BenchError> {
        let mut runs = Vec::new();
        for _ in 0..=self.args.repeats {
            let start = Instant::now();
            let stages = self.engine.refresh_table(&mut self.volume)?;
            runs.push(Timing {
                wall: start.elapsed(),
                stages,
            });
        }
        print(&self.line("load", &runs[1..], Some(self.volume.sample_bytes())))
    }

    /// Returns the minimum bytes to read for an isovalue: the samples of the active bricks, and the min/max table.
    fn isovalue_bytes(&self, pyramid: &Pyramid) -> u64 {
        let brick = u64::from(BRICK_CELLS + 1).pow(3);
        let fields = self.recipe.sample_type.bytes() + if self.feature.is_some() { size_of::<f32>() } else { 0 };
        pyramid.active_bricks() * brick * fields as u64 + self.volume.table_bytes()
    }

    /// Times the way from an isovalue to a mesh. If `is_first`, each run follows a load; otherwise the isovalue alternates.
    fn isovalue(
        &mut self,
        case: &'static str,
        fraction: f64,
        cut: &CutParams,
        is_first: bool,
    ) -> Result<(), BenchError> {
        let mut last: Option<(SurfaceStatistics, u64)> = None;
        let mut runs = Vec::new();
        for i in 0..=self.args.repeats {
            let iso = if is_first || i % 2 == 0 {
                self.recipe.iso
            } else {
                self.recipe.next_iso()
            };
            if is_first {
                self.engine.refresh_table(&mut self.volume)?;
            }
            let start = Instant::now();
            let pyramid = self.pyramid(iso, Some(cut))?;
            let surface = self.peel(&pyramid, cut)?;
            runs.push(Timing {
                wall: start.elapsed(),
                stages: surface.statistics.stages.clone(),
            });
            if iso == self.recipe.iso {
                check_mesh(self.recipe, &surface)?;
                if let Some((before, _)) = &last {
                    let found = surface.statistics.triangles;
                    equal(self.recipe, "triangles of a repeated isovalue", found, before.triangles)?;
                }
                last = Some((surface.statistics, self.isovalue_bytes(&pyramid)));
            }
        }
        let (statistics, bytes) = last.unwrap_or_default();
        let line = self.line(case, &runs[1..], Some(bytes));
        print(&self.surface_line(line, fraction, cut, &statistics))
    }

    fn step(&mut self, fraction: f64, cut: &CutParams) -> Result<(), BenchError> {
        let mut runs = Vec::new();
        let mut last = None;
        for _ in 0..=self.args.repeats {
            let start = Instant::now();
            let mut stages = self.engine.refresh_table(&mut self.volume)?;
            let pyramid = self.pyramid(self.recipe.iso, Some(cut))?;
            let surface = self.peel(&pyramid, cut)?;
            stages.extend(surface.statistics.stages.iter().cloned());
            runs.push(Timing {
                wall: start.elapsed(),
                stages,
            });
            last = Some((surface.statistics, self.isovalue_bytes(&pyramid)));
        }
        let Some((statistics, bytes)) = last else { return Ok(()) };
        let line = self.line("time step", &runs[1..], Some(self.volume.sample_bytes() + bytes));
        print(&self.surface_line(line, fraction, cut, &statistics))
    }

    /// Returns three edits that lead to almost the same cut: a slightly higher β; another α, with β scaled by the same factor as
    /// smoothness; and a transfer function that halves importance, with half of β. A β below 0, which means full resolution, does not
    /// change.
    fn edits(&self, cut: &CutParams) -> Result<[CutParams; 3], BenchError> {
        let point = |x, importance| ControlPoint { x, importance };
        let halved = TransferFunction::new(vec![point(0.0, 0.0), point(1.0, 0.5)])?;
        let alpha = if self.recipe.feature.is_some() {
            cut.alpha + 0.01
        } else {
            0.1
        };
        let smoothness_factor = (1.0 - alpha) / (1.0 - cut.alpha);
        let scaled = |factor: f32| if cut.beta < 0.0 { cut.beta } else { cut.beta * factor };
        Ok([
            CutParams {
                beta: scaled(1.001),
                ..cut.clone()
            },
            CutParams {
                alpha,
                beta: scaled(smoothness_factor),
                ..cut.clone()
            },
            CutParams {
                transfer: halved,
                beta: scaled(0.5),
                ..cut.clone()
            },
        ])
    }

    fn edit(&self, pyramid: &Pyramid, fraction: f64, cut: &CutParams, to_bytes: bool) -> Result<(), BenchError> {
        let edits = self.edits(cut)?;
        let expected = self.peel(pyramid, cut)?.statistics;
        let before = pyramid.stages().len();
        let mut last = (SurfaceStatistics::default(), 0);
        let runs = self.time(|i| {
            let start = Instant::now();
            let surface = self.peel(pyramid, &edits[i as usize % edits.len()])?;
            let bytes = if to_bytes {
                encode(&surface)?.iter().map(|frame| frame.len() as u64).sum()
            } else {
                0
            };
            let wall = start.elapsed();
            check_mesh(self.recipe, &surface)?;
            let stages = surface.statistics.stages[before..].to_vec();
            last = (surface.statistics, bytes);
            Ok(Timing { wall, stages })
        })?;
        if fraction >= 1.0 {
            equal(
                self.recipe,
                "triangles after an edit",
                last.0.triangles,
                expected.triangles,
            )?;
        }
        let case = if to_bytes { "edit to bytes" } else { "edit" };
        let line = self.line(case, &runs, Some(pyramid.device_bytes()));
        let mut line = self.surface_line(line, fraction, cut, &last.0);
        if to_bytes {
            line.encoded_bytes = Some(last.1);
            line.bytes_per_triangle = Some(round(last.1 as f64 / last.0.triangles as f64));
        }
        print(&line)
    }

    fn encode(&self, pyramid: &Pyramid, fraction: f64, cut: &CutParams) -> Result<(), BenchError> {
        let surface = self.peel(pyramid, cut)?;
        let mut bytes = 0;
        let runs = self.time(|_| {
            let start = Instant::now();
            let frames = encode(&surface)?;
            let wall = start.elapsed();
            bytes = frames.iter().map(|frame| frame.len() as u64).sum();
            Ok(Timing {
                wall,
                stages: Vec::new(),
            })
        })?;
        let wire: Vec<_> = surface.regions.par_iter().map(quantised).collect();
        let mut meshopt_bytes = 0;
        let meshopt_runs = self.time(|_| {
            let start = Instant::now();
            meshopt_bytes = wire
                .par_iter()
                .with_max_len(MAX_TASK_REGIONS)
                .map(|(region, vertices)| meshopt_encode(region, vertices))
                .sum::<u64>();
            Ok(Timing {
                wall: start.elapsed(),
                stages: Vec::new(),
            })
        })?;
        let mut line = self.surface_line(self.line("encode", &runs, None), fraction, cut, &surface.statistics);
        line.encoded_bytes = Some(bytes);
        line.bytes_per_triangle = Some(round(bytes as f64 / surface.statistics.triangles as f64));
        line.meshopt_wall_ms = Some(spread(&meshopt_runs, |run| run.wall.as_secs_f64() * 1e3));
        line.meshopt_bytes = Some(meshopt_bytes);
        print(&line)
    }
}

fn spread(runs: &[Timing], time_of: impl Fn(&Timing) -> f64) -> Spread {
    Spread::of(runs.iter().map(time_of))
}

/// Encodes a final surface as the session of a viewer does if the client has no mesh yet.
fn encode(surface: &Surface) -> Result<Vec<Bytes>, BenchError> {
    let frames = surface.regions.par_iter().with_max_len(MAX_TASK_REGIONS).map(|region| {
        // A session computes this hash to compare it with the hash of the client's mesh.
        std::hint::black_box(MeshHash::of(region));
        Ok(encode::encode(region, PrefixId::cut(0, 1, 0))?)
    });
    frames.collect()
}

/// Returns a region with its vertices as on the wire.
fn quantised(region: &Region) -> (&Region, Vec<WireVertex>) {
    (region, region.vertices.iter().map(WireVertex::quantise).collect())
}

/// Encodes a region with meshoptimizer alone: strip order inside each level, vertices in the order of their use, and the codecs. Returns
/// the bytes including a chunk header, so that the result is comparable.
fn meshopt_encode(region: &Region, vertices: &[WireVertex]) -> u64 {
    let mut indices = region.indices.to_vec();
    let mut first = 0;
    for triangles in region.level_triangles {
        let end = first + 3 * triangles as usize;
        meshopt::optimize_vertex_cache_strip_in_place(&mut indices[first..end], vertices.len());
        first = end;
    }
    let vertices: Vec<WireVertex> = meshopt::optimize_vertex_fetch(&mut indices, vertices);
    let vertex_bytes = meshopt::encode_vertex_buffer_level(&vertices, 2, Some(1)).map_or(0, |b| b.len());
    let index_bytes = meshopt::encode_index_buffer(&indices, vertices.len()).map_or(0, |b| b.len());
    (isopeel_codec::chunk::HEADER_BYTES + vertex_bytes + index_bytes) as u64
}
