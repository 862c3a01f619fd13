//! Derived features on uneven axes against functions whose derivatives are known in closed form, which no code of this crate computes.

use isopeel_kernels::{DerivedFeature, Grid, VectorFeature};
use isopeel_reference::{Field, derive};

use super::oracles::length;

const DIMS: [u32; 3] = [30, 26, 22];

/// Positions of the samples along an axis: cells of every length from 0.4 to 1.6, and one of 3.
fn positions(axis: usize) -> Vec<f64> {
    let mut at = -10.0 - axis as f64;
    let cell = |i: u32| {
        if i == 12 {
            3.0
        } else {
            0.4 + 0.1 * f64::from((7 * i + 3 * axis as u32) % 13)
        }
    };
    (0..DIMS[axis])
        .map(|i| {
            let here = at;
            at += cell(i);
            here
        })
        .collect()
}

/// A field of a function of the position in the world.
fn of(value: impl Fn([f64; 3]) -> f64) -> Field {
    let axes = [0, 1, 2].map(positions);
    let mut values = Vec::new();
    for z in &axes[2] {
        for y in &axes[1] {
            values.extend(axes[0].iter().map(|x| value([*x, *y, *z]) as f32));
        }
    }
    // A spacing that no derivative is taken over.
    let grid = Grid::new(DIMS, [77.0; 3]).expect("a valid grid");
    let lengths = axes.map(|axis| axis.windows(2).map(|pair| (pair[1] - pair[0]) as f32).collect());
    Field::new(grid, values).with_lengths(lengths)
}

/// Positions and values of the samples that are not at the volume's border.
fn inside(field: &Field) -> impl Iterator<Item = ([f64; 3], f64)> + '_ {
    let axes = [0, 1, 2].map(positions);
    let inner = field
        .samples()
        .filter(|p| (0..3).all(|i| p[i] > 0 && p[i] + 1 < DIMS[i]));
    inner.map(move |p| ([0, 1, 2].map(|i| axes[i][p[i] as usize]), f64::from(field.at(p))))
}

/// Every value inside is near the expected one, if there is one.
fn check(field: &Field, tolerance: f64, expected: impl Fn([f64; 3]) -> Option<f64>) {
    let mut compared = 0;
    for (p, found) in inside(field) {
        let Some(want) = expected(p) else { continue };
        assert!((found - want).abs() <= tolerance, "{found} at {p:?}, expected {want}");
        compared += 1;
    }
    assert!(compared > 1000, "{compared} samples compared");
}

/// A quadratic function with every product of two coordinates, its gradient and its second derivatives.
fn quadratic([x, y, z]: [f64; 3]) -> f64 {
    0.05 * x * x - 0.04 * y * y + 0.06 * z * z + 0.07 * x * y - 0.03 * x * z + 0.02 * y * z + 2.0 * x - y + 0.5 * z
}

const HESSIAN: [[f64; 3]; 3] = [[0.10, 0.07, -0.03], [0.07, -0.08, 0.02], [-0.03, 0.02, 0.12]];

fn gradient(p: [f64; 3]) -> [f64; 3] {
    let linear = [2.0, -1.0, 0.5];
    std::array::from_fn(|i| linear[i] + (0..3).map(|k| HESSIAN[i][k] * p[k]).sum::<f64>())
}

#[test]
fn derivatives_of_quadratics_are_exact() {
    let field = of(quadratic);
    check(&derive::derived(&field, DerivedFeature::GradientMagnitude), 2e-4, |p| {
        Some(length(&gradient(p)))
    });
    // (n . H n - tr H) / 2 |g|, n the unit normal.
    let steep = |p: [f64; 3]| Some(gradient(p)).filter(|g| length(g) > 0.3);
    check(&derive::derived(&field, DerivedFeature::MeanCurvature), 3e-4, |p| {
        let g = steep(p)?;
        let n = g.map(|c| c / length(&g));
        let along = (0..3)
            .flat_map(|i| (0..3).map(move |k| n[i] * HESSIAN[i][k] * n[k]))
            .sum::<f64>();
        Some((along - (0..3).map(|i| HESSIAN[i][i]).sum::<f64>()) / (2.0 * length(&g)))
    });
    // Minus the determinant of the Hessian bordered by the gradient, over |g|^4: by Laplace's formula along the border.
    check(&derive::derived(&field, DerivedFeature::GaussianCurvature), 3e-4, |p| {
        let g = steep(p)?;
        let minor = |i: usize, k: usize| {
            let rest = |without: usize| (0..3).filter(move |&m| m != without).collect::<Vec<_>>();
            let (rows, columns) = (rest(i), rest(k));
            let h = |r: usize, c: usize| HESSIAN[rows[r]][columns[c]];
            let sign = if i.abs_diff(k) == 1 { -1.0 } else { 1.0 };
            sign * (h(0, 0) * h(1, 1) - h(0, 1) * h(1, 0))
        };
        let along = (0..3)
            .flat_map(|i| (0..3).map(move |k| g[i] * minor(i, k) * g[k]))
            .sum::<f64>();
        Some(along / length(&g).powi(4))
    });
}

/// Errors, relative to the curvature, are proportional to the length of a cell over the radius, because second derivatives are only of
/// first order if cells differ in length. Here cells are up to 3 long.
#[test]
fn spheres_have_their_curvature() {
    let parabola = of(|p| 100.0 - 3.0 * length(&p).powi(2));
    let (ball, hole) = (of(|p| -length(&p)), of(|p| length(&p)));
    for (field, sign, tolerance) in [(parabola, 1.0, 0.01), (ball, 1.0, 1.0), (hole, -1.0, 1.0)] {
        for (feature, power, sign) in [
            (DerivedFeature::MeanCurvature, 1, sign),
            (DerivedFeature::GaussianCurvature, 2, 1.0),
        ] {
            let values = derive::derived(&field, feature);
            let far = inside(&values)
                .map(|(p, found)| (length(&p), found))
                .filter(|(r, _)| *r > 6.0);
            let errors = far.map(|(r, found)| (found * r.powi(power) - sign).abs() * r);
            let worst = errors.max_by(f64::total_cmp).expect("samples");
            assert!(worst < tolerance * f64::from(power), "{feature:?}: {worst}");
        }
    }
}

#[test]
fn ends_are_one_sided_and_so_is_what_is_beside_a_missing_sample() {
    let mut field = of(|[x, _, _]| x * x);
    let [nx, ny, _] = DIMS.map(|n| n as usize);
    field.values[(5 * ny + 5) * nx + 9] = f32::NAN;
    let magnitude = derive::derived(&field, DerivedFeature::GradientMagnitude);
    let x = positions(0);
    // The slope of a parabola between two samples is that in their middle.
    let between = |a: usize, b: usize| (x[a] + x[b]).abs();
    for (at, expected) in [
        ([0, 4, 4], Some(between(0, 1))),
        ([29, 4, 4], Some(between(28, 29))),
        ([8, 5, 5], Some(between(7, 8))),
        ([10, 5, 5], Some(between(10, 11))),
        ([7, 5, 5], Some(2.0 * x[7].abs())),
        ([9, 5, 5], None),
    ] {
        let found = f64::from(magnitude.at(at));
        match expected {
            Some(expected) => assert!(
                (found - expected).abs() < 1e-3,
                "{found} at {at:?}, expected {expected}"
            ),
            None => assert!(found.is_nan(), "{found} at {at:?}"),
        }
    }
    let curvature = derive::derived(&field, DerivedFeature::MeanCurvature);
    for (at, is_missing) in [
        ([0, 4, 4], true),
        ([8, 5, 5], true),
        ([9, 6, 6], true),
        ([7, 5, 5], false),
    ] {
        assert_eq!(curvature.at(at).is_nan(), is_missing, "{at:?}");
    }
}

#[test]
fn curvature_is_bounded_by_the_smallest_cell_beside_a_sample() {
    // A cone's tip in a corner of cells: no grid resolves it.
    let [x, y, z] = [0, 1, 2].map(|axis| positions(axis)[7] + 0.01);
    let field = of(|p| -length(&[p[0] - x, p[1] - y, p[2] - z]));
    let mean = derive::derived(&field, DerivedFeature::MeanCurvature);
    let cells = [0, 1, 2].map(|axis| {
        let at = positions(axis);
        (at[7] - at[6]).min(at[8] - at[7])
    });
    let expected = 1.0 / cells.into_iter().fold(f64::INFINITY, f64::min);
    let found = f64::from(mean.at([7, 7, 7]));
    assert!((found / expected - 1.0).abs() < 1e-5, "{found}, expected {expected}");
}

#[test]
fn features_of_quadratic_flows_are_exact() {
    let flow: [&dyn Fn([f64; 3]) -> f64; 3] = [
        &|[x, y, z]| 0.1 * x * x + 0.5 * y * z,
        &|[x, y, _]| 0.2 * y * y - x,
        &|[x, y, z]| 0.3 * z * z + 0.1 * x * y,
    ];
    let fields = flow.map(of);
    let of_kind = |feature| derive::of_vector(fields.each_ref(), feature);
    // Rows of derivatives, then the curl.
    let matrix = |[x, y, z]: [f64; 3]| {
        [
            [0.2 * x, 0.5 * z, 0.5 * y],
            [-1.0, 0.4 * y, 0.0],
            [0.1 * y, 0.1 * x, 0.6 * z],
        ]
    };
    let curl = move |p| {
        let d = matrix(p);
        [d[2][1] - d[1][2], d[0][2] - d[2][0], d[1][0] - d[0][1]]
    };
    check(&of_kind(VectorFeature::Divergence), 1e-3, |p| {
        Some((0..3).map(|i| matrix(p)[i][i]).sum())
    });
    check(&of_kind(VectorFeature::VorticityMagnitude), 1e-3, |p| {
        Some(length(&curl(p)))
    });
    check(&of_kind(VectorFeature::Helicity), 0.05, |p| {
        Some((0..3).map(|i| flow[i](p) * curl(p)[i]).sum())
    });
    check(&of_kind(VectorFeature::QCriterion), 0.02, |p| {
        let d = matrix(p);
        Some(-0.5 * (0..3).flat_map(|i| (0..3).map(move |k| d[i][k] * d[k][i])).sum::<f64>())
    });
    // A rotation about an axis: lambda-2 is minus the square of the angular velocity.
    let rotation = [of(|p| -0.6 * p[1]), of(|p| 0.6 * p[0]), of(|_| 0.0)];
    let lambda_2 = derive::of_vector(rotation.each_ref(), VectorFeature::Lambda2);
    check(&lambda_2, 1e-4, |_| Some(-0.36));
}
