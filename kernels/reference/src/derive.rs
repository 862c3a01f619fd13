//! Features at samples that are computed from fields (docs/algorithm.md#21-derived-features). A missing value is NaN.

use crate::Field;
use isopeel_kernels::{DerivedFeature, VectorFeature};

/// A derived feature at every sample.
pub fn derived(field: &Field, feature: DerivedFeature) -> Field {
    match feature {
        DerivedFeature::GradientMagnitude if field.lengths.is_none() => field.gradient_magnitude(),
        DerivedFeature::GradientMagnitude => at_samples(field, |p| {
            let [x, y, z] = gradient(field, p);
            if field.at(p).is_nan() {
                f32::NAN
            } else {
                (x * x + y * y + z * z).sqrt()
            }
        }),
        DerivedFeature::MeanCurvature => at_samples(field, |p| {
            let (steps, bound) = steps(field, p);
            Derivatives::at(field, p, &steps).map_or(f32::NAN, |d| clamp(d.mean_curvature(), bound))
        }),
        DerivedFeature::GaussianCurvature => at_samples(field, |p| {
            let (steps, bound) = steps(field, p);
            Derivatives::at(field, p, &steps).map_or(f32::NAN, |d| clamp(d.gaussian_curvature(), bound * bound))
        }),
        DerivedFeature::LocalVariance => at_samples(field, |p| local_variance(field, p)),
    }
}

/// A feature of a vector field at every sample.
pub fn of_vector(components: [&Field; 3], feature: VectorFeature) -> Field {
    at_samples(components[0], |p| {
        let [u, v, w] = components.map(|component| component.at(p));
        if u.is_nan() || v.is_nan() || w.is_nan() {
            return f32::NAN;
        }
        // Row i: the gradient of component i.
        let d = components.map(|component| gradient(component, p));
        let curl = [d[2][1] - d[1][2], d[0][2] - d[2][0], d[1][0] - d[0][1]];
        match feature {
            VectorFeature::Magnitude => (u * u + v * v + w * w).sqrt(),
            VectorFeature::Divergence => d[0][0] + d[1][1] + d[2][2],
            VectorFeature::VorticityMagnitude => (curl[0] * curl[0] + curl[1] * curl[1] + curl[2] * curl[2]).sqrt(),
            // (|Ω|² − |S|²) / 2 is −tr(J²) / 2.
            VectorFeature::QCriterion => {
                let own = d[0][0] * d[0][0] + d[1][1] * d[1][1] + d[2][2] * d[2][2];
                -0.5 * own - (d[0][1] * d[1][0] + d[0][2] * d[2][0] + d[1][2] * d[2][1])
            }
            VectorFeature::Lambda2 => lambda_2(d),
            VectorFeature::Helicity => u * curl[0] + v * curl[1] + w * curl[2],
        }
    })
}

/// The divisor of differences of neighbouring samples along an axis.
enum Step {
    /// One over the spacing.
    Even(f32),
    /// One over the lengths of the cells before and after a sample.
    Uneven([f32; 2]),
}

impl Step {
    /// One over the lengths of the cells before and after.
    fn ends(&self) -> [f32; 2] {
        match *self {
            Self::Even(per) => [per; 2],
            Self::Uneven(ends) => ends,
        }
    }

    fn first(&self, below: f32, here: f32, above: f32) -> f32 {
        match *self {
            Self::Even(per) => (above - below) * (0.5 * per),
            Self::Uneven([before, after]) => {
                let per_sum = 1.0 / (before + after);
                after * (after * per_sum) * (above - here) + before * (before * per_sum) * (here - below)
            }
        }
    }

    fn second(&self, below: f32, here: f32, above: f32) -> f32 {
        match *self {
            Self::Even(per) => ((above - here) - (here - below)) * (per * per),
            Self::Uneven([before, after]) => {
                let per_sum = 1.0 / (before + after);
                ((above - here) * after - (here - below) * before) * (2.0 * before * (after * per_sum))
            }
        }
    }
}

/// Steps at a sample along x, y and z, and one over the smallest length in them. A cell beyond the grid counts as long as the last one.
fn steps(field: &Field, p: [u32; 3]) -> ([Step; 3], f32) {
    let steps: [Step; 3] = std::array::from_fn(|axis| match &field.lengths {
        None => Step::Even(1.0 / field.grid.spacing[axis]),
        Some(lengths) => {
            let (along, at) = (&lengths[axis], p[axis] as usize);
            Step::Uneven([at.saturating_sub(1), at.min(along.len() - 1)].map(|cell| 1.0 / along[cell]))
        }
    });
    let bound = steps.iter().flat_map(Step::ends).fold(0.0, f32::max);
    (steps, bound)
}

/// The gradient at a sample: as [`Field::gradient`]; on uneven axes it uses the lengths of their cells.
fn gradient(field: &Field, p: [u32; 3]) -> [f32; 3] {
    if field.lengths.is_none() {
        return field.gradient(p);
    }
    let (steps, _) = steps(field, p);
    std::array::from_fn(|axis| {
        let along = |by: i32| neighbour(field, p, std::array::from_fn(|i| if i == axis { by } else { 0 }));
        let (here, below, above) = (field.at(p), along(-1), along(1));
        let [before, after] = steps[axis].ends();
        let slope = match (below.is_nan(), above.is_nan()) {
            (false, false) => steps[axis].first(below, here, above),
            (true, false) => (above - here) * after,
            (false, true) => (here - below) * before,
            (true, true) => 0.0,
        };
        if slope.is_nan() { 0.0 } else { slope }
    })
}

/// The middle eigenvalue of S² + Ω², the symmetric part of the square of `d`.
fn lambda_2(d: [[f32; 3]; 3]) -> f32 {
    let size: f32 = d.iter().flatten().map(|v| v.abs()).sum();
    if size == 0.0 {
        return 0.0;
    }
    let j = d.map(|row| row.map(|v| v / size));
    let square = |i: usize, k: usize| (0..3).map(|m| j[i][m] * j[m][k]).sum::<f32>();
    let mut a: [[f32; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| 0.5 * (square(i, k) + square(k, i))));
    // Jacobi's rotations, each of which makes one entry zero.
    for (p, q) in [(0, 1), (0, 2), (1, 2)].repeat(4) {
        let r = 3 - p - q;
        let (gap, twice) = (a[q][q] - a[p][p], 2.0 * a[p][q]);
        let size = gap.abs() + (gap * gap + twice * twice).sqrt();
        if size == 0.0 {
            continue;
        }
        let t = twice * gap.signum() / size;
        let (c, s) = (1.0 / (t * t + 1.0).sqrt(), t / (t * t + 1.0).sqrt());
        a[p][p] -= t * a[p][q];
        a[q][q] += t * a[p][q];
        let (rp, rq) = (a[r][p], a[r][q]);
        let turned = [(p, q, 0.0), (r, p, c * rp - s * rq), (r, q, s * rp + c * rq)];
        for (i, k, value) in turned {
            (a[i][k], a[k][i]) = (value, value);
        }
    }
    let mut values = [a[0][0], a[1][1], a[2][2]];
    values.sort_by(f32::total_cmp);
    size * (size * values[1])
}

/// A value at every sample; a value that is not finite counts as missing.
fn at_samples(field: &Field, value: impl Fn([u32; 3]) -> f32) -> Field {
    let finite = |p| Some(value(p)).filter(|v: &f32| v.is_finite()).unwrap_or(f32::NAN);
    Field::new(field.grid, field.samples().map(finite).collect())
}

/// Clamps to ±`bound`; NaN stays.
fn clamp(value: f32, bound: f32) -> f32 {
    if value.is_nan() {
        value
    } else {
        value.clamp(-bound, bound)
    }
}

/// The sample at the offset `by` from `p`; NaN outside the grid.
fn neighbour(field: &Field, p: [u32; 3], by: [i32; 3]) -> f32 {
    let q: [i64; 3] = std::array::from_fn(|i| i64::from(p[i]) + i64::from(by[i]));
    if (0..3).any(|i| q[i] < 0 || q[i] >= i64::from(field.grid.dims[i])) {
        return f32::NAN;
    }
    field.at(q.map(|c| c as u32))
}

/// Variance of the 3³ samples around one.
fn local_variance(field: &Field, p: [u32; 3]) -> f32 {
    let here = field.at(p);
    let (mut sum, mut squares) = (0.0f32, 0.0f32);
    for z in -1..=1 {
        for y in -1..=1 {
            for x in -1..=1 {
                let d = neighbour(field, p, [x, y, z]) - here;
                sum += d;
                squares += d * d;
            }
        }
    }
    let variance = (squares - sum * sum * (1.0 / 27.0)) * (1.0 / 27.0);
    if variance < 0.0 { 0.0 } else { variance }
}

/// Derivatives at a sample, divided by the sum of the absolute first ones.
struct Derivatives {
    /// Along x, y, z; all zero if the gradient is.
    first: [f32; 3],
    /// xx, yy, zz.
    second: [f32; 3],
    /// yz, xz, xy.
    mixed: [f32; 3],
    flat: bool,
}

impl Derivatives {
    /// Returns `None` if one of the samples that they need is missing.
    fn at(field: &Field, p: [u32; 3], steps: &[Step; 3]) -> Option<Self> {
        let here = field.at(p);
        // The sample `a` further along axis `i` and `b` along axis `j`.
        let near = |i: usize, a: i32, j: usize, b: i32| {
            let mut offset = [0; 3];
            offset[i] += a;
            offset[j] += b;
            neighbour(field, p, offset)
        };
        let along = |axis: usize, by: i32| near(axis, by, axis, 0);
        let first: [f32; 3] = std::array::from_fn(|i| steps[i].first(along(i, -1), here, along(i, 1)));
        let second: [f32; 3] = std::array::from_fn(|i| steps[i].second(along(i, -1), here, along(i, 1)));
        let mixed = [(1, 2), (0, 2), (0, 1)].map(|(i, j)| match (&steps[i], &steps[j]) {
            (Step::Even(per_i), Step::Even(per_j)) => {
                let across = (near(i, 1, j, 1) - near(i, -1, j, 1)) - (near(i, 1, j, -1) - near(i, -1, j, -1));
                across * (0.25 * per_i * per_j)
            }
            (step_i, step_j) => {
                let [below, here, above] =
                    [-1, 0, 1].map(|b| step_i.first(near(i, -1, j, b), near(i, 0, j, b), near(i, 1, j, b)));
                step_j.first(below, here, above)
            }
        });
        if here.is_nan() || first.iter().chain(&second).chain(&mixed).any(|d| d.is_nan()) {
            return None;
        }
        let size = first[0].abs() + first[1].abs() + first[2].abs();
        let flat = size == 0.0;
        let scale = if flat { 0.0 } else { 1.0 / size };
        Some(Self {
            first: first.map(|d| d * scale),
            second: second.map(|d| d * scale),
            mixed: mixed.map(|d| d * scale),
            flat,
        })
    }

    fn squares(&self) -> ([f32; 3], f32) {
        let squares = self.first.map(|g| g * g);
        (squares, squares[0] + squares[1] + squares[2])
    }

    /// κ = (κ₁ + κ₂) / 2, half the divergence of −∇f / |∇f|.
    fn mean_curvature(&self) -> f32 {
        if self.flat {
            return self.zero();
        }
        let ([x, y, z], [xx, yy, zz], [yz, xz, xy]) = (self.first, self.second, self.mixed);
        let (squares, square) = self.squares();
        let across = 2.0 * (y * z * yz + x * z * xz + x * y * xy);
        let along = squares[0] * (yy + zz) + squares[1] * (xx + zz) + squares[2] * (xx + yy);
        (across - along) / (2.0 * square * square.sqrt())
    }

    /// κ₁ κ₂ = ∇fᵀ adj(H) ∇f / |∇f|⁴.
    fn gaussian_curvature(&self) -> f32 {
        if self.flat {
            return self.zero();
        }
        let ([x, y, z], [xx, yy, zz], [yz, xz, xy]) = (self.first, self.second, self.mixed);
        let (squares, square) = self.squares();
        let along =
            squares[0] * (yy * zz - yz * yz) + squares[1] * (xx * zz - xz * xz) + squares[2] * (xx * yy - xy * xy);
        let across = y * z * (xz * xy - xx * yz) + x * z * (yz * xy - yy * xz) + x * y * (yz * xz - zz * xy);
        (along + 2.0 * across) / (square * square)
    }

    /// If the gradient is zero: 0, unless a second derivative is not finite.
    fn zero(&self) -> f32 {
        self.second.iter().chain(&self.mixed).fold(0.0, |sum, d| sum + d * 0.0)
    }
}
