//! A check of a device: all stages on a small volume whose answers are known. Drivers have compiled kernels wrongly without a word, so
//! nothing that a new driver computes is believed before.
//!
//! The answers are those of drivers on which all stages agree with their twins (`kernels/reference`). Counts and topology of the full
//! surface are exact on every device. Lengths, areas and errors may differ in their last digits, and so decimation may choose differently.

use crate::expression::{Binary, Comparison, Expression, Op};
use crate::{
    CurvePoint, Cut, CutParams, DerivedFeature, DistanceOf, Engine, Error, Feature, Interest, InterestShape, Isovalue,
    Level, MAX_BINS, Mesher, Never, OverviewMode, OverviewWork, PartFilter, Pyramid, RectilinearGrid, Region,
    RegionWeights, SampleType, ShownCut, Surface, TreeGoal, ValueSet, ValuesOf, Vertex, VertexTree, Volume,
};

use std::sync::Arc;

mod answers;
mod volume;

use answers::*;
use volume::{DIMS, active_cells, block_means, grid, samples, values};

/// Why a device is not to be believed.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// The device failed.
    #[error("stage {stage} fails")]
    Failed {
        /// Stage that failed.
        stage: &'static str,
        /// The driver's error.
        #[source]
        source: Error,
    },
    /// An answer is wrong.
    #[error("stage {stage} computes wrong results: {what} is {found}, expected {expected}")]
    Differs {
        /// Stage whose answer is wrong.
        stage: &'static str,
        /// Which answer.
        what: &'static str,
        /// What the device says.
        found: String,
        /// The right answer.
        expected: String,
    },
}

/// What is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// What a first surface needs.
    FirstSurface,
    /// What all else needs.
    Rest,
}

/// A step of the check: a stage, or several that need each other.
pub struct Step {
    /// Name of the stage.
    pub stage: &'static str,
    /// What needs it.
    pub scope: Scope,
    run: fn(&mut Check<'_>) -> Result<(), Finding>,
}

/// The steps in the order of need. A step uses results of those before it.
pub const STEPS: &[Step] = &[
    step("minmax", Scope::FirstSurface, |check| check.upload()),
    step("construct", Scope::FirstSurface, |check| check.construct()),
    step("dual", Scope::FirstSurface, |check| check.dual()),
    step("histogram", Scope::FirstSurface, |check| check.histogram()),
    step("cut", Scope::Rest, |check| check.cut()),
    step("fit", Scope::Rest, |check| check.fit()),
    step("tree", Scope::Rest, |check| check.tree()),
    step("tree_cut", Scope::Rest, |check| check.tree_cut()),
    step("error", Scope::Rest, |check| check.error()),
    step("derive", Scope::Rest, |check| check.derive()),
    step("probe", Scope::Rest, |check| check.probe()),
    step("slice", Scope::Rest, |check| check.slice()),
    step("overview", Scope::Rest, |check| check.overview()),
    step("distribution", Scope::Rest, |check| check.distribution()),
    step("curve", Scope::Rest, |check| check.curve()),
    step("march", Scope::Rest, |check| check.march()),
    step("distance", Scope::Rest, |check| check.distance()),
    step("interpolate", Scope::Rest, |check| check.interpolate()),
    step("evaluate", Scope::Rest, |check| check.evaluate()),
    step("mask", Scope::Rest, |check| check.mask()),
    step("distance_field", Scope::Rest, |check| check.distance_field()),
];

const fn step(stage: &'static str, scope: Scope, run: fn(&mut Check<'_>) -> Result<(), Finding>) -> Step {
    Step { stage, scope, run }
}

/// What a step found wrong, without its stage.
enum Finding {
    Failed(Error),
    Differs {
        what: &'static str,
        found: String,
        expected: String,
    },
}

impl From<Error> for Finding {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// Runs one step after another on a device.
pub struct Check<'a> {
    engine: &'a Engine,
    sample_type: SampleType,
    volume: Option<Volume>,
    pyramid: Option<Pyramid>,
    tree: Option<VertexTree>,
}

impl<'a> Check<'a> {
    /// A check with samples of a type, for which a device has programs of their own.
    pub fn new(engine: &'a Engine, sample_type: SampleType) -> Self {
        Self {
            engine,
            sample_type,
            volume: None,
            pyramid: None,
            tree: None,
        }
    }

    /// Runs the next step.
    ///
    /// # Errors
    /// [`CheckError`] with the stage.
    ///
    /// # Panics
    /// The steps before it have not run.
    pub fn run(&mut self, step: &Step) -> Result<(), CheckError> {
        let stage = step.stage;
        (step.run)(self).map_err(|finding| match finding {
            Finding::Failed(source) => CheckError::Failed { stage, source },
            Finding::Differs { what, found, expected } => CheckError::Differs {
                stage,
                what,
                found,
                expected,
            },
        })
    }

    fn volume(&self) -> &Volume {
        self.volume.as_ref().expect("step minmax has run")
    }

    fn pyramid(&self) -> &Pyramid {
        self.pyramid.as_ref().expect("step construct has run")
    }

    fn built_tree(&self) -> &VertexTree {
        self.tree.as_ref().expect("step tree has run")
    }

    fn upload(&mut self) -> Result<(), Finding> {
        let samples = samples(self.sample_type);
        let volume = self.engine.upload(grid()?, &samples, None)?;
        let back = self.engine.download(&volume, 0..DIMS[2])?;
        exact("samples that were uploaded and downloaded", back == samples, true)?;
        self.volume = Some(volume);
        Ok(())
    }

    fn construct(&mut self) -> Result<(), Finding> {
        let iso = Isovalue::new(ISOVALUE)?;
        let pyramid = self.engine.build_pyramid(self.volume(), Feature::None, iso, &Never)?;
        exact("number of active bricks", pyramid.active_bricks(), ACTIVE_BRICKS)?;
        exact("number of active cells", pyramid.active_cells(), active_cells())?;
        exact("number of triangles", pyramid.full_triangles(), FULL_TRIANGLES)?;
        self.pyramid = Some(pyramid);
        Ok(())
    }

    fn dual(&mut self) -> Result<(), Finding> {
        FULL.check(&self.peeled(&dual_params(-1.0))?)?;
        DECIMATED.check_nearly(&self.peeled(&dual_params(BETA))?)
    }

    fn peeled(&self, params: &CutParams) -> Result<Surface, Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        Ok(self.engine.peel(volume, pyramid, params, Level::FINEST, &Never)?)
    }

    fn cut_of_cubes(&self, beta: f32) -> Result<Cut, Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        Ok(self.engine.cut(volume, pyramid, &dual_params(beta), Level::FINEST)?)
    }

    fn cut(&mut self) -> Result<(), Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        let (full, decimated) = (self.cut_of_cubes(-1.0)?, self.cut_of_cubes(BETA)?);
        let Some(differences) = self.engine.differences(volume, pyramid, &full, &decimated)? else {
            return exact("cuts can be compared", false, true);
        };
        exact("regions whose leaves differ", &differences.leaves[..], &DIFFERING)?;
        let same = self.engine.differences(volume, pyramid, &decimated, &decimated)?;
        exact(
            "a cut differs from itself",
            same.is_none_or(|same| same.leaves.contains(&true)),
            false,
        )?;
        let first = std::array::from_fn::<_, { DIFFERING.len() }, _>(|region| region == 0);
        let mixed = self.engine.mix(volume, pyramid, &full, &decimated, &first)?;
        let count = self.engine.count(volume, pyramid, &mixed, &Never)?;
        nearly("number of triangles of a mixed cut", count.triangles, MIXED_TRIANGLES)
    }

    fn histogram(&mut self) -> Result<(), Finding> {
        let histogram = self.engine.histogram(self.volume(), Feature::None)?;
        exact("range", histogram.range, [0.0, VALUE_END as f32])?;
        let mut bins = vec![0; 256];
        for value in values() {
            bins[(value as usize * 256 / VALUE_END as usize).min(255)] += 1;
        }
        exact("bins", histogram.bins, bins)
    }

    fn fit(&mut self) -> Result<(), Finding> {
        let params = dual_params(0.0);
        let (_, _, triangles) = self
            .engine
            .fit(self.volume(), self.pyramid(), &params, BUDGET, &Never)?;
        nearly("number of triangles", triangles, FITTED_TRIANGLES)
    }

    fn derive(&mut self) -> Result<(), Finding> {
        let feature = Feature::Derived(DerivedFeature::GradientMagnitude);
        near_histogram(&self.engine.histogram(self.volume(), feature)?, GRADIENT)?;
        let iso = Isovalue::new(ISOVALUE)?;
        let pyramid = self.engine.build_pyramid(self.volume(), feature, iso, &Never)?;
        exact("number of triangles", pyramid.full_triangles(), FULL_TRIANGLES)?;
        let variance = Feature::Derived(DerivedFeature::LocalVariance);
        near_histogram(&self.engine.histogram(self.volume(), variance)?, VARIANCE)?;
        let pyramid = self.engine.build_pyramid(self.volume(), variance, iso, &Never)?;
        let params = CutParams {
            alpha: 1.0,
            feature_range: [0.0, VARIANCE[1]],
            ..dual_params(VARIANCE_BETA)
        };
        let cut = self.engine.cut(self.volume(), &pyramid, &params, Level::FINEST)?;
        nearly(
            "number of leaves by a feature",
            cut.leaves().iter().sum(),
            VARIANCE_LEAVES,
        )?;
        let lengths = DIMS.map(|n| (1..n).map(|i| 1.0 + (i % 3) as f32 / 4.0).collect());
        let uneven = RectilinearGrid::uneven(grid()?, lengths)?;
        let mut upload = self.engine.begin_upload(&uneven, self.sample_type, None)?;
        self.engine.continue_upload(&mut upload, &samples(self.sample_type))?;
        let uneven = self.engine.finish_upload(upload)?;
        near_histogram(&self.engine.histogram(&uneven, feature)?, UNEVEN_GRADIENT)
    }

    fn tree(&mut self) -> Result<(), Finding> {
        let params = dual_params(0.0);
        let tree = self.engine.build_tree(self.volume(), self.pyramid(), &params, &Never)?;
        exact("number of triangles", tree.full_triangles(), FULL.triangles)?;
        let lives = self
            .engine
            .cx
            .read("check", &tree.lives, 2 * tree.point_count() as usize)?;
        let is_empty = |life: &&[u8]| life[0] >= life[1];
        let never = lives.chunks_exact(2).filter(is_empty).count();
        exact("number of points that were leaves in no round", never, 0)?;
        self.tree = Some(tree);
        Ok(())
    }

    fn tree_cut(&mut self) -> Result<(), Finding> {
        let made = self.engine.tree_surface(
            self.volume(),
            self.pyramid(),
            self.built_tree(),
            &tree_params(),
            &tree_goal(),
            None,
            &Never,
        )?;
        TREE.check_nearly(&made.surface)?;
        let built = (self.volume(), self.pyramid(), self.built_tree());
        let moved = self.engine.moved_nodes(built, &tree_params(), &tree_goal())?;
        nearly("number of nodes that move", moved, TREE_MOVED)?;
        // The further a region is along the volume, the coarser it is.
        let weights = RegionWeights {
            of_regions: (0..self.pyramid().active_regions())
                .map(|n| 4f32.powi(n as i32))
                .collect(),
            in_steps: true,
        };
        let goal = TreeGoal {
            tolerance: 0.25,
            max_triangles: u64::MAX,
            weights: Some(Arc::new(weights)),
            ..tree_goal()
        };
        let weighted = self.engine.tree_surface(
            self.volume(),
            self.pyramid(),
            self.built_tree(),
            &tree_params(),
            &goal,
            made.regions.as_ref(),
            &Never,
        )?;
        nearly(
            "triangles of a weighted cut",
            weighted.surface.statistics.triangles,
            WEIGHTED_TRIANGLES,
        )?;
        let remade = weighted.surface.remade.map_or(0, |remade| remade.len() as u64);
        nearly("regions that differ from another cut", remade, WEIGHTED_REGIONS)
    }

    fn error(&mut self) -> Result<(), Finding> {
        let params = dual_params(BETA);
        let measured = self
            .engine
            .measure_error(self.volume(), self.pyramid(), &params, &Never)?;
        roughly("mean error", measured.whole.rms, ERROR[0])?;
        roughly("largest error", measured.whole.max, ERROR[1])?;
        // Outside the region of interest cubes are wider than bricks.
        let params = CutParams {
            beta: WIDE_BETA,
            ..tree_params()
        };
        let measured = self
            .engine
            .measure_error(self.volume(), self.pyramid(), &params, &Never)?;
        roughly("mean error of wide cubes", measured.whole.rms, WIDE_ERROR[0])?;
        roughly("largest error of wide cubes", measured.whole.max, WIDE_ERROR[1])?;
        let measured = self.engine.measure_tree_error(
            self.volume(),
            self.pyramid(),
            self.built_tree(),
            &tree_params(),
            &tree_goal(),
            &Never,
        )?;
        roughly("mean error of a tree's cut", measured.whole.rms, TREE_ERROR)
    }

    fn shown_cut(&self) -> Result<ShownCut<'_>, Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        let cut =
            self.engine
                .shown_tree_cut(volume, pyramid, self.built_tree(), &tree_params(), &tree_goal(), &Never)?;
        Ok(cut)
    }

    fn probe(&mut self) -> Result<(), Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        // Beside the surface.
        let at = [75.3, 21.5, 21.5];
        let cut = self.shown_cut()?;
        let probed = self.engine.probe(volume, pyramid, &tree_params(), at, Some(&cut))?;
        let Some(probed) = probed else {
            return exact("found a vertex", false, true);
        };
        near("distance", probed.distance, PROBED[0])?;
        near("area of the part", probed.part.map_or(0.0, |part| part.area), PROBED[1])
    }

    fn slice(&mut self) -> Result<(), Finding> {
        let bytes = self.engine.slice(self.volume(), 2, 11)?;
        let plane = (DIMS[0] * DIMS[1]) as usize;
        let expected: Vec<u8> = match self.sample_type {
            SampleType::U8 | SampleType::I8 => values().map(|v| v as u8).skip(11 * plane).take(plane).collect(),
            SampleType::U16 | SampleType::I16 => (values().skip(11 * plane).take(plane))
                .flat_map(|v| (v as u16).to_ne_bytes())
                .collect(),
            SampleType::F32 => (values().skip(11 * plane).take(plane))
                .flat_map(|v| (v as f32).to_ne_bytes())
                .collect(),
        };
        exact("samples of a slice", bytes == expected, true)
    }

    fn overview(&mut self) -> Result<(), Finding> {
        let mut work = OverviewWork::new(DIMS, OverviewMode::Mean, OVERVIEW_SIDE);
        while let Some(part) = work.next() {
            work.add(self.engine.overview_values(self.volume(), part)?);
        }
        let Some(found) = work.complete() else {
            return exact("an overview without further parts is complete", false, true);
        };
        let (means, [lo, hi]) = block_means(found.factors, found.dims);
        near("smallest mean", found.range[0], lo)?;
        near("largest mean", found.range[1], hi)?;
        let code = |mean: f32| 1.0 + 254.0 * (mean - lo) / (hi - lo);
        // Rounding may decide otherwise in the middle between two codes.
        let same = |(&found, &mean): (&u8, &f32)| (f32::from(found) - code(mean)).abs() < 0.51;
        exact("means of blocks", found.codes.iter().zip(&means).all(same), true)
    }

    /// Half of the distance between two samples along x.
    fn interpolate(&mut self) -> Result<(), Finding> {
        let at = [7u32, 5, 11];
        let vertex = Vertex {
            position: [
                at[0] as i32 * Vertex::LATTICE + Vertex::LATTICE / 2,
                at[1] as i32 * Vertex::LATTICE,
                at[2] as i32 * Vertex::LATTICE,
            ],
            normal: [0; 2],
            smoothness: 0,
            feature: 0,
        };
        let mut regions = [Region {
            vertices: vec![vertex].into(),
            ..Region::default()
        }];
        self.engine
            .vertex_values(self.volume(), ValuesOf::default(), &mut regions, &Never)?;
        let sample = ((at[2] * DIMS[1] + at[1]) * DIMS[0] + at[0]) as usize;
        let two: Vec<f32> = values().skip(sample).take(2).map(|v| v as f32).collect();
        near(
            "value between two samples",
            regions[0].values[0],
            (two[0] + two[1]) / 2.0,
        )
    }

    fn distribution(&mut self) -> Result<(), Finding> {
        let decimated = self.cut_of_cubes(BETA)?;
        self.distribution_of(&ShownCut::Cubes(&decimated), CUBES_DISTRIBUTION)?;
        self.distribution_of(&self.shown_cut()?, TREE_DISTRIBUTION)
    }

    fn distribution_of(&self, cut: &ShownCut<'_>, [points, coarse, bin]: [f32; 3]) -> Result<(), Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        let counts = self
            .engine
            .distribution(volume, pyramid, &dual_params(0.0), cut, MAX_BINS)?;
        let sum = |bins: &[u32]| bins.iter().map(|&n| n as f32).sum::<f32>();
        exact("number of points", sum(&counts.all), points)?;
        // Equal costs are merged in an order that depends on the compiler's rounding.
        roughly("number of merged points", sum(&counts.coarse), coarse)?;
        let weighted = (0u16..).zip(&counts.all).map(|(bin, &n)| f32::from(bin) * n as f32);
        roughly("mean bin", weighted.sum::<f32>() / points, bin)
    }

    fn curve(&mut self) -> Result<(), Finding> {
        let decimated = self.cut_of_cubes(BETA)?;
        self.curve_of(&ShownCut::Cubes(&decimated), &dual_params(0.0), CUBES_CURVE)?;
        self.curve_of(&self.shown_cut()?, &tree_params(), TREE_CURVE)
    }

    fn curve_of(&self, cut: &ShownCut<'_>, params: &CutParams, [full, end, error]: [f32; 3]) -> Result<(), Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        let curve = self.engine.error_curve(volume, pyramid, params, cut, &Never)?;
        let ends = [curve.first(), curve.last()].map(|point| point.map_or(0, |point| point.triangles) as f32);
        roughly("triangles at the lower end", ends[0], full)?;
        exact(
            "the curve descends",
            curve.is_sorted_by(|a, b| a.triangles >= b.triangles),
            true,
        )?;
        // The coarsest cut depends on rounding.
        exact("few triangles are left at the upper end", ends[1] <= end, true)?;
        roughly("error of half the triangles", error_at(&curve, full / 2.0), error)
    }

    fn march(&mut self) -> Result<(), Finding> {
        FULL_MARCHED.check(&self.peeled(&CutParams::paper(-1.0))?)?;
        let surface = self.peeled(&CutParams::paper(BETA))?;
        let statistics = &surface.statistics;
        nearly("number of triangles", statistics.triangles, MARCHED[0])?;
        nearly("number of vertices", statistics.vertices, MARCHED[1])?;
        nearly(
            "number of unpatched vertices",
            statistics.unpatched_vertices,
            MARCHED[2],
        )
    }

    fn distance(&mut self) -> Result<(), Finding> {
        let (volume, pyramid) = (self.volume(), self.pyramid());
        let surface = self.peeled(&dual_params(BETA))?;
        let distances = self
            .engine
            .vertex_distances(volume, pyramid, &surface.regions, DistanceOf::Vertex, &Never)?;
        let distances: Vec<f32> = distances.into_iter().flatten().collect();
        let finite = distances.iter().filter(|distance| distance.is_finite()).count();
        exact("number of vertices that have a distance", finite, distances.len())?;
        roughly(
            "largest distance of a vertex",
            distances.into_iter().fold(0.0, f32::max),
            VERTEX_DISTANCE,
        )
    }

    fn evaluate(&mut self) -> Result<(), Finding> {
        // 2 v - v
        let doubled = Expression::new(vec![
            Op::Field(0),
            Op::Number(2.0),
            Op::Binary(Binary::Multiply, 0, 1),
            Op::Binary(Binary::Subtract, 2, 0),
        ])?;
        let field = self.engine.evaluate(&doubled, &[self.volume()], &Never)?;
        let found = self.engine.download(&field, 0..DIMS[2])?;
        exact("an expression's values", found == samples(SampleType::F32), true)
    }

    fn mask(&mut self) -> Result<(), Finding> {
        let inside = ValueSet {
            ranges: vec![[f32::NEG_INFINITY, 1.0]],
            is_complement: true,
        };
        let field = self.engine.mask(self.volume(), self.volume(), &inside, &Never)?;
        let found = self.engine.download(&field, 0..DIMS[2])?;
        let own = samples(self.sample_type);
        let (expected, _) = own.clone().masked(None, |i| inside.holds(own.get(i)));
        exact(
            "a masked field's samples",
            found.as_bytes() == expected.as_bytes(),
            true,
        )
    }

    fn distance_field(&mut self) -> Result<(), Finding> {
        let inside = Expression::new(vec![
            Op::Field(0),
            Op::Number(1.0),
            Op::Number(0.0),
            Op::Compare(Comparison::Below, 0, 1),
            Op::Select(3, 1, 2),
        ])?;
        let field = self.engine.distance_field(&inside, &[self.volume()], 1.0, &Never)?;
        let Some(field) = field else {
            return exact("found a distance field", false, true);
        };
        let last = DIMS.map(|n| (n - 1) as f32);
        for (corner, expected) in [[0.0; 3], last].into_iter().zip(CORNER_DISTANCES) {
            let found = self.engine.value_at(&field, corner)?;
            near("distance at a corner", found.unwrap_or(f32::NAN), expected)?;
        }
        Ok(())
    }
}

/// Returns the error of a cut with `triangles`, interpolated between the points of a curve. NaN if the curve ends above it.
fn error_at(curve: &[CurvePoint], triangles: f32) -> f32 {
    let beyond = |two: &&[CurvePoint]| two[1].triangles as f32 <= triangles;
    let Some([before, after]) = curve.windows(2).find(beyond) else {
        return f32::NAN;
    };
    let [from, to] = [before, after].map(|point| point.triangles as f32);
    before.rms + (after.rms - before.rms) * (from - triangles) / (from - to)
}

/// Parameters of the dual mesher; a cut of the tree takes only importance from them.
fn dual_params(beta: f32) -> CutParams {
    CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(beta)
    }
}

/// The surface matters more on one side.
fn tree_params() -> CutParams {
    CutParams {
        interest: vec![Interest {
            centre: INTEREST,
            rows: [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]],
            shape: InterestShape::Ball,
            importance: 1.0,
        }],
        ..dual_params(0.0)
    }
}

/// Leaves the ball out.
fn tree_goal() -> TreeGoal {
    TreeGoal {
        tolerance: 0.0,
        max_triangles: TREE_BUDGET,
        max_tolerance: f32::INFINITY,
        without: PartFilter {
            min_area: BALL_AREA,
            chosen: None,
        },
        may_vanish: false,
        weights: None,
    }
}
