//! Samples at uneven positions along the axes. Describes the deviations, and interpolates the samples onto an even grid unless that grid is
//! much larger.
//!
//! The even grid has the file's first and last positions along each axis, and the smallest distance of the file's samples between its own,
//! or less. Values between two samples are interpolated; beside a missing sample they are missing. If the even grid would have more than
//! `MAX_GROWTH` times the samples, they stay as they are: surfaces are cut in index space, and their vertices are then moved to world
//! positions.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use isopeel_geometry::UnevenAxes;
use isopeel_kernels::{SampleType, Samples};

use super::parallel::for_each_row;
use super::scalar::Scalar;
use super::{Field, FileLocation, Geometry, LabelRanks, Notices, OpenedFile, ReadError, ReadProgress, Source};

/// Largest deviation from even positions, relative to their distance, that is taken for rounding.
pub(super) const EVEN: f64 = 1e-3;
/// Maximum ratio of samples of the even grid to samples of the file.
const MAX_GROWTH: f64 = 4.0;
/// Notice for viewers of samples at uneven positions in the index frame, which counts the samples.
pub(super) const COUNTED: &str = "positions count samples, which are at uneven positions in the file";

/// Positions of the samples along an axis.
#[derive(Clone, Debug)]
pub(super) struct Positions {
    /// Name for messages.
    name: String,
    values: Vec<f64>,
    /// Mean distance of neighbours; negative if positions decrease.
    step: f64,
    /// Largest distance from even positions, in steps.
    deviation: f64,
}

impl Positions {
    /// Creates positions; an error unless there are at least two and the first and last differ.
    pub(super) fn new(name: impl Into<String>, values: Vec<f64>) -> Result<Self, String> {
        let name = name.into();
        let (&[first, ..], &[.., last]) = (values.as_slice(), values.as_slice()) else {
            return Err(format!("{name:?} has no positions, expected two at least"));
        };
        let step = (last - first) / (values.len().max(2) - 1) as f64;
        let off = |(i, value): (usize, &f64)| ((value - first - i as f64 * step) / step).abs();
        let larger = |a: f64, b: f64| if b > a || b.is_nan() { b } else { a };
        let deviation = values.iter().enumerate().map(off).fold(0.0, larger);
        if deviation.is_nan() {
            return Err(format!("{name:?} has positions that are no numbers, or all the same"));
        }
        Ok(Self {
            name,
            values,
            step,
            deviation,
        })
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn count(&self) -> usize {
        self.values.len()
    }

    pub(super) fn values(&self) -> &[f64] {
        &self.values
    }

    pub(super) fn first(&self) -> f64 {
        self.values.first().copied().unwrap_or_default()
    }

    pub(super) fn step(&self) -> f64 {
        self.step
    }

    /// Returns 1 if most positions are above their predecessor, −1 if most are below it.
    pub(super) fn direction(&self) -> f64 {
        let signs = self.distances().map(|distance| match distance {
            distance if distance > 0.0 => 1,
            distance if distance < 0.0 => -1,
            _ => 0,
        });
        match signs.sum::<i64>() {
            0 => self.step.signum(),
            rising => rising.signum() as f64,
        }
    }

    pub(super) fn is_even(&self) -> bool {
        self.deviation <= EVEN
    }

    /// Returns the centres between neighbouring positions.
    pub(super) fn between(&self) -> Result<Self, String> {
        let centres = self.values.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        Self::new(&self.name, centres.collect())
    }

    fn distances(&self) -> impl Iterator<Item = f64> {
        self.values.windows(2).map(|pair| pair[1] - pair[0])
    }

    /// Describes how far the positions are from even ones, and between which samples the distance deviates most.
    pub(super) fn unevenness(&self) -> String {
        let off = |distance: f64| (distance - self.step).abs();
        let worst = self
            .distances()
            .enumerate()
            .max_by(|a, b| off(a.1).total_cmp(&off(b.1)));
        let (index, found) = worst.unwrap_or_default();
        // In single precision, without the digits of rounding.
        let (name, step, found, deviation) = (&self.name, self.step as f32, found as f32, self.deviation);
        format!(
            "{name:?} is not even, by up to {deviation:.3} of its mean step {step}: {found} between samples {index} and {}, the largest \
             deviation, expected {step}",
            index + 1
        )
    }
}

/// Describes which axes are not even, and by how much.
fn unevenness(positions: &[Positions; 3]) -> String {
    let uneven = positions.iter().filter(|positions| !positions.is_even());
    uneven.map(Positions::unevenness).collect::<Vec<_>>().join("; ")
}

/// Checks that positions are even, or can be interpolated: that they only increase or only decrease.
pub(super) fn check(path: &Path, geometry: &Geometry, positions: &[Positions; 3]) -> Result<(), String> {
    if positions.iter().all(Positions::is_even) {
        return Ok(());
    }
    Interpolation::new(path, geometry, positions).map(|_| ())
}

/// Returns the file with its samples at their uneven positions, and a notice of that.
fn at_uneven_positions(mut file: OpenedFile, positions: &[Positions; 3]) -> OpenedFile {
    let along = |axis: usize| Some(positions[axis].values.as_slice()).filter(|_| !positions[axis].is_even());
    let uneven = UnevenAxes::new([along(0), along(1), along(2)]);
    let notice = format!(
        "samples are at uneven positions, and so are surfaces; distances, areas and errors of these are bounds from above, as if all cells \
         were as large as the largest: {}",
        unevenness(positions)
    );
    file.notices.add(notice);
    OpenedFile {
        uneven: uneven.map(Arc::new),
        ..file
    }
}

/// Places the samples of a file at these positions along x, y and z: interpolated onto an even grid, unless that grid is too large.
pub(super) fn on_even_grid(
    path: &Path,
    mut file: OpenedFile,
    positions: &[Positions; 3],
) -> Result<OpenedFile, String> {
    if positions.iter().all(Positions::is_even) {
        return Ok(file);
    }
    let Some((geometry, interpolation)) = Interpolation::new(path, &file.geometry, positions)? else {
        return Ok(at_uneven_positions(file, positions));
    };
    file.notices.add(interpolation.notice(positions));
    let interpolation = Arc::new(interpolation);
    let fields = file.fields.into_iter().map(|field| interpolation.field(field));
    Ok(OpenedFile {
        geometry,
        fields: fields.collect(),
        ..file
    })
}

/// Place of a sample of the even grid along an axis: the file's sample before it, and the weight of the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Between {
    low: usize,
    weight: f32,
}

/// Interpolates samples of a file at those of an even grid.
#[derive(Debug)]
struct Interpolation {
    path: PathBuf,
    from: [usize; 3],
    axes: [Vec<Between>; 3],
}

impl Interpolation {
    /// Returns the even grid for samples that have these positions along x, y and z, as they are along its axes; `geometry` is of the
    /// file's own samples at their mean distance. `None` if the even grid would have more than [`MAX_GROWTH`] times the samples.
    fn new(path: &Path, geometry: &Geometry, positions: &[Positions; 3]) -> Result<Option<(Geometry, Self)>, String> {
        let mut even = *geometry;
        let uneven = unevenness(positions);
        let mut growth = 1.0;
        let mut counts = [0.0; 3];
        for (axis, positions) in positions.iter().enumerate() {
            let sign = positions.step.signum();
            if positions.distances().any(|distance| distance * sign <= 0.0) {
                return Err(format!(
                    "{uneven}; expected positions that only increase, or only decrease"
                ));
            }
            let smallest = positions.distances().map(f64::abs).fold(f64::INFINITY, f64::min);
            let intervals = (geometry.dims[axis] - 1) as f64;
            let needed = intervals * positions.step.abs() / smallest;
            counts[axis] = if positions.is_even() {
                intervals
            } else {
                (needed - EVEN).ceil()
            } + 1.0;
            growth *= counts[axis] / f64::from(geometry.dims[axis]);
        }
        if growth > MAX_GROWTH {
            return Ok(None);
        }
        for (axis, count) in counts.into_iter().enumerate() {
            even.dims[axis] = count as u32;
            even.spacing[axis] = geometry.spacing[axis] * f64::from(geometry.dims[axis] - 1) / (count - 1.0);
        }
        let axes = std::array::from_fn(|axis| between(&positions[axis], even.dims[axis]));
        let (path, from) = (path.to_owned(), geometry.dims.map(|n| n as usize));
        Ok(Some((even, Self { path, from, axes })))
    }

    /// Returns the notice for viewers.
    fn notice(&self, positions: &[Positions; 3]) -> String {
        let ([x, y, z], [nx, ny, nz]) = (self.from, [0, 1, 2].map(|axis| self.axes[axis].len()));
        format!(
            "samples are interpolated onto an even grid, {x} x {y} x {z} onto {nx} x {ny} x {nz}: {}",
            unevenness(positions)
        )
    }

    /// Converts a field of the file to one of the even grid.
    fn field(self: &Arc<Self>, field: Field) -> Field {
        Field {
            sample_type: SampleType::F32,
            source: Arc::new(Interpolated {
                source: Arc::clone(&field.source),
                missing: field.missing,
                interpolation: Arc::clone(self),
            }),
            ..field
        }
    }

    fn apply<T: Scalar>(&self, samples: &[T], missing: Option<f32>) -> Result<Vec<f32>, ReadError> {
        let [nx, ny, nz] = [0, 1, 2].map(|axis| self.axes[axis].len());
        let mut values: Vec<f32> = bytemuck::allocation::try_zeroed_vec(nx * ny * nz)
            .map_err(|_| ReadError::new(&self.path, "data", format!("no memory for {nx} x {ny} x {nz} samples")))?;
        let [from_x, from_y, _] = self.from;
        let of = |index: usize| {
            let value = samples[index].to_f32();
            if Some(value) == missing { f32::NAN } else { value }
        };
        for_each_row(&mut values, nx, |row, values| {
            let (y, z) = (self.axes[1][row % ny], self.axes[2][row / ny]);
            let start = |dy: usize, dz: usize| ((z.low + dz) * from_y + y.low + dy) * from_x;
            for (value, x) in values.iter_mut().zip(&self.axes[0]) {
                let along_x = |start: usize| x.mix(|dx| of(start + x.low + dx));
                let mixed = z.mix(|dz| y.mix(|dy| along_x(start(dy, dz))));
                *value = match missing {
                    Some(missing) if mixed.is_nan() => missing,
                    _ => mixed,
                };
            }
        });
        Ok(values)
    }
}

impl Between {
    /// Returns the value between two neighbours. A neighbour with weight 0 is not read, as there may be none.
    fn mix(self, value: impl Fn(usize) -> f32) -> f32 {
        let low = value(0);
        if self.weight == 0.0 {
            return low;
        }
        low + self.weight * (value(1) - low)
    }
}

/// Returns for each of the `count` samples of an even grid its place between two samples of the file.
fn between(positions: &Positions, count: u32) -> Vec<Between> {
    let last = positions.values.len() - 1;
    if count as usize == last + 1 && positions.is_even() {
        return (0..=last).map(|low| Between { low, weight: 0.0 }).collect();
    }
    let length = positions.step * last as f64;
    let mut low = 0;
    let neighbours = |i: u32| {
        // Relative to the length, so that positions increase in any case.
        let along = |value: f64| (value - positions.first()) / length;
        let at = f64::from(i) / f64::from(count - 1);
        while low + 1 < last && along(positions.values[low + 1]) <= at {
            low += 1;
        }
        let (a, b) = (along(positions.values[low]), along(positions.values[low + 1]));
        let weight = ((at - a) / (b - a)).clamp(0.0, 1.0);
        // A weight that differs from 0 or 1 only by rounding needs no second sample.
        match weight {
            weight if weight < 1e-6 => Between { low, weight: 0.0 },
            weight if weight > 1.0 - 1e-6 => Between {
                low: low + 1,
                weight: 0.0,
            },
            weight => Between {
                low,
                weight: weight as f32,
            },
        }
    };
    (0..count).map(neighbours).collect()
}

/// A field whose samples are interpolated.
#[derive(Debug)]
struct Interpolated {
    source: Arc<dyn Source>,
    missing: Option<f32>,
    interpolation: Arc<Interpolation>,
}

impl Source for Interpolated {
    fn stored_bytes(&self) -> u64 {
        self.source.stored_bytes()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        self.source.inputs(step)
    }

    fn notices(&self) -> Notices {
        self.source.notices()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.source.ranks()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let (interpolation, missing) = (&self.interpolation, self.missing);
        let values = match self.source.read(step, progress)? {
            Samples::U8(values) => interpolation.apply(&values, missing),
            Samples::I8(values) => interpolation.apply(&values, missing),
            Samples::U16(values) => interpolation.apply(&values, missing),
            Samples::I16(values) => interpolation.apply(&values, missing),
            Samples::F32(values) => interpolation.apply(&values, missing),
        };
        progress.go_on(&interpolation.path)?;
        values.map(Samples::F32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(values: &[f64]) -> Positions {
        Positions::new("z", values.to_vec()).expect("positions")
    }

    fn geometry_of(positions: &[Positions; 3]) -> Geometry {
        let dims = [0, 1, 2].map(|axis| positions[axis].values.len() as u32);
        Geometry {
            spacing: [0, 1, 2].map(|axis| positions[axis].step.abs()),
            ..Geometry::of_index(dims)
        }
    }

    fn grid(positions: &[Positions; 3]) -> Result<(Geometry, Interpolation), String> {
        let found = Interpolation::new(Path::new("a"), &geometry_of(positions), positions)?;
        Ok(found.expect("an even grid that is not too large"))
    }

    #[test]
    fn values_between_samples_are_interpolated() {
        let positions = [axis(&[0.0, 1.0]), axis(&[5.0, 3.0]), axis(&[0.0, 10.0, 30.0])];
        let (geometry, interpolation) = grid(&positions).expect("an even grid");
        assert_eq!((geometry.dims, geometry.spacing), ([2, 2, 4], [1.0, 2.0, 10.0]));
        let samples: Vec<u8> = vec![0, 1, 2, 3, 10, 11, 12, 13, 30, 31, 32, 33];
        let values = interpolation.apply(&samples, None).expect("values");
        let expected: Vec<f32> = [0.0, 10.0, 20.0, 30.0]
            .iter()
            .flat_map(|z| [0.0, 1.0, 2.0, 3.0].map(|i| z + i))
            .collect();
        assert_eq!(values, expected);
        let values = interpolation.apply(&samples, Some(12.0)).expect("values");
        let missing: Vec<usize> = (0..16).filter(|&i| values[i] == 12.0).collect();
        assert_eq!(missing, [6, 10]);
        let notice = interpolation.notice(&positions);
        assert!(notice.contains("2 x 2 x 3 onto 2 x 2 x 4"), "{notice}");
        assert!(
            notice.contains("20 between samples 1 and 2, the largest deviation, expected 15"),
            "{notice}"
        );
    }

    #[test]
    fn decreasing_positions_are_those_of_the_mirrored_grid() {
        let flat = || axis(&[0.0, 1.0]);
        let (_, up) = grid(&[flat(), flat(), axis(&[0.0, 1.0, 4.0])]).expect("an even grid");
        let (_, down) = grid(&[flat(), flat(), axis(&[4.0, 1.0, 0.0])]).expect("an even grid");
        let up: Vec<_> = up.axes[2].iter().map(|at| at.low as f32 + at.weight).collect();
        let down: Vec<_> = down.axes[2]
            .iter()
            .map(|at| 2.0 - (at.low as f32 + at.weight))
            .collect();
        for (a, b) in up.iter().zip(down.iter().rev()) {
            assert!((a - b).abs() < 1e-6, "{up:?} {down:?}");
        }
    }

    #[test]
    fn samples_stay_where_an_even_grid_would_be_large() {
        let positions = [axis(&[0.0, 1.0]), axis(&[5.0, 3.0]), axis(&[100.0, 99.0, 0.0])];
        let file = OpenedFile {
            geometry: geometry_of(&positions),
            steps: 1,
            uneven: None,
            axes: None,
            times: None,
            fields: Vec::new(),
            notices: Notices::default(),
        };
        let read = on_even_grid(Path::new("a"), file.clone(), &positions).expect("a file");
        assert_eq!(read.geometry, file.geometry);
        let uneven = read.uneven.expect("uneven");
        let z = uneven.of_axis(2).expect("z is uneven");
        assert!((z[1] - 0.02).abs() < 1e-12 && z[2] == 2.0, "{z:?}");
        assert_eq!((uneven.of_axis(0), uneven.of_axis(1)), (None, None));
        let notice = read.notices.text().expect("a notice");
        assert!(notice.contains("bounds from above"), "{notice}");
        assert!(
            notice.contains("-99 between samples 1 and 2") || notice.contains("-1 between samples 0 and 1"),
            "{notice}"
        );
    }

    #[test]
    fn what_has_no_even_grid_is_refused() {
        let flat = || axis(&[0.0, 1.0]);
        let refused = |values: &[f64]| grid(&[flat(), flat(), axis(values)]).expect_err("refused");
        let why = refused(&[0.0, 2.0, 1.0, 4.0]);
        assert!(why.contains("only increase, or only decrease"), "{why}");
        assert!(Positions::new("x", vec![1.0, 1.0]).is_err());
        assert!(Positions::new("x", vec![0.0, f64::NAN, 1.0]).is_err());
        assert!(Positions::new("x", vec![]).is_err());
    }
}
