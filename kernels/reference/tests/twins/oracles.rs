//! Derived features against volumes whose features are known in closed form, which no code of this crate computes.

use isopeel_kernels::{DerivedFeature, VectorFeature};
use isopeel_reference::{Field, derive};

use super::properties::sampled;

const SPACING: [f32; 3] = [0.5, 0.75, 1.0];

/// A field of a function of the position in world units, from the middle of the volume.
fn of(value: impl Fn([f64; 3]) -> f64) -> Field {
    let dims = [41, 33, 29];
    let at = |p: [f32; 3]| [0, 1, 2].map(|i| (f64::from(p[i]) - f64::from(dims[i] - 1) / 2.0) * f64::from(SPACING[i]));
    sampled(dims, SPACING, |p| value(at(p)) as f32)
}

/// Samples with their position and value, if the value is known.
fn known(field: &Field) -> impl Iterator<Item = ([f64; 3], f64)> + '_ {
    let place = |p: [u32; 3]| {
        [0, 1, 2].map(|i| (f64::from(p[i]) - f64::from(field.grid.dims[i] - 1) / 2.0) * f64::from(SPACING[i]))
    };
    field
        .samples()
        .map(move |p| (place(p), f64::from(field.at(p))))
        .filter(|(_, v)| !v.is_nan())
}

pub fn length(p: &[f64]) -> f64 {
    p.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Every known value is near the expected one, relative to what is large among them; and there are some.
fn check(field: &Field, tolerance: f64, expected: impl Fn([f64; 3]) -> Option<f64>) {
    let mut compared = 0;
    for (p, v) in known(field) {
        let Some(want) = expected(p) else { continue };
        assert!(
            (v - want).abs() <= tolerance * want.abs().max(1e-3),
            "{v} at {p:?}, expected {want}"
        );
        compared += 1;
    }
    assert!(compared > 1000, "{compared} samples compared");
}

#[test]
fn spheres_have_their_curvature_whatever_the_field_is_along_the_radius() {
    // Only radii above 4, at which differences over a cell resolve the sphere to some per cent.
    let far = |p: [f64; 3]| Some(length(&p)).filter(|&r| r > 4.0);
    for field in [
        of(|p| -length(&p)),
        of(|p| 100.0 - 3.0 * length(&p).powi(2)),
        of(|p| 1e4 * (-length(&p) / 20.0).exp()),
    ] {
        check(&derive::derived(&field, DerivedFeature::MeanCurvature), 0.03, |p| {
            Some(1.0 / far(p)?)
        });
        check(&derive::derived(&field, DerivedFeature::GaussianCurvature), 0.06, |p| {
            Some(far(p)?.powi(-2))
        });
    }
    // A ball of low values is a hole: its surface is concave seen from inside; the Gaussian curvature is the same.
    let hole = of(|p| length(&p));
    check(&derive::derived(&hole, DerivedFeature::MeanCurvature), 0.03, |p| {
        Some(-1.0 / far(p)?)
    });
    check(&derive::derived(&hole, DerivedFeature::GaussianCurvature), 0.06, |p| {
        Some(far(p)?.powi(-2))
    });
}

#[test]
fn cylinders_and_planes_and_saddles() {
    let cylinder = of(|[x, y, _]| -x.hypot(y));
    let far = |p: [f64; 3]| Some(length(&p[..2])).filter(|&r| r > 4.0);
    check(&derive::derived(&cylinder, DerivedFeature::MeanCurvature), 0.03, |p| {
        Some(0.5 / far(p)?)
    });
    check(
        &derive::derived(&cylinder, DerivedFeature::GaussianCurvature),
        0.5,
        |p| far(p).map(|_| 0.0),
    );
    let plane = of(|[x, y, z]| 3.0 * x - 2.0 * y + 0.5 * z);
    for feature in [DerivedFeature::MeanCurvature, DerivedFeature::GaussianCurvature] {
        check(&derive::derived(&plane, feature), 0.1, |_| Some(0.0));
    }
    // z = a (x² − y²) at its saddle point: principal curvatures ±2a.
    let saddle = of(|[x, y, z]| 0.05 * (x * x - y * y) - z);
    let gaussian = derive::derived(&saddle, DerivedFeature::GaussianCurvature);
    let normal = |[x, y, _]: [f64; 3]| 1.0 + 0.01 * (x * x + y * y);
    check(&gaussian, 1e-3, |p| Some(-0.01 / normal(p).powi(2)));
}

#[test]
fn a_field_without_gradient_has_no_curvature() {
    let constant = of(|_| 7.0);
    for feature in [
        DerivedFeature::MeanCurvature,
        DerivedFeature::GaussianCurvature,
        DerivedFeature::LocalVariance,
    ] {
        assert!(known(&derive::derived(&constant, feature)).all(|(_, v)| v == 0.0));
    }
}

#[test]
fn variance_of_a_ramp_and_of_a_checkerboard() {
    // Along an axis the values −s, 0, s occur 9 times each: 2/3 s²; axes add up.
    let ramp = of(|[x, y, z]| 4.0 * x + 2.0 * y - 3.0 * z);
    let expected = 2.0 / 3.0 * ((4.0f64 * 0.5).powi(2) + (2.0f64 * 0.75).powi(2) + 9.0);
    check(&derive::derived(&ramp, DerivedFeature::LocalVariance), 1e-4, |_| {
        Some(expected)
    });
    // 13 of 27 samples are 1, or 14: variance 13 · 14 / 27².
    let board = sampled([20, 20, 20], [1.0; 3], |[x, y, z]| (x + y + z) % 2.0);
    let variance = derive::derived(&board, DerivedFeature::LocalVariance);
    assert!(known(&variance).all(|(_, v)| (v - 182.0 / 729.0).abs() < 1e-6));
}

#[test]
fn features_of_a_neighbourhood_are_missing_where_it_is_not_whole() {
    let mut field = of(|[x, y, z]| x * y + z);
    field.values[(10 * 33 + 10) * 41 + 10] = f32::NAN;
    let is_missing = |feature, p| derive::derived(&field, feature).at(p).is_nan();
    for feature in [DerivedFeature::MeanCurvature, DerivedFeature::LocalVariance] {
        assert!(
            is_missing(feature, [0, 5, 5]) && is_missing(feature, [40, 5, 5]),
            "at the volume's border"
        );
        assert!(
            is_missing(feature, [9, 10, 11]) && is_missing(feature, [10, 10, 10]),
            "around the missing sample"
        );
        assert!(!is_missing(feature, [8, 10, 10]) && !is_missing(feature, [5, 5, 5]));
    }
    // Second derivatives do not read the corners of the 3³ samples.
    assert!(
        !is_missing(DerivedFeature::MeanCurvature, [9, 9, 9]) && is_missing(DerivedFeature::LocalVariance, [9, 9, 9])
    );
}

/// Features of a vector field of three functions.
fn features(components: [&dyn Fn([f64; 3]) -> f64; 3]) -> impl Fn(VectorFeature) -> Field + use<> {
    let fields = components.map(of);
    move |feature| derive::of_vector([&fields[0], &fields[1], &fields[2]], feature)
}

#[test]
fn rigid_rotation_has_twice_its_angular_velocity_as_vorticity() {
    // v = ω × r, ω = (0.3, -0.4, 1.2), of length 1.3.
    let of_kind = features([
        &|[_, y, z]| -0.4 * z - 1.2 * y,
        &|[x, _, z]| 1.2 * x - 0.3 * z,
        &|[x, y, _]| 0.3 * y + 0.4 * x,
    ]);
    check(&of_kind(VectorFeature::VorticityMagnitude), 1e-3, |_| Some(2.6));
    check(&of_kind(VectorFeature::Divergence), 0.01, |_| Some(0.0));
    // Ω alone: Q = |ω|².
    check(&of_kind(VectorFeature::QCriterion), 1e-3, |_| Some(1.69));
    let axis = [0.3 / 1.3, -0.4 / 1.3, 1.2 / 1.3];
    check(&of_kind(VectorFeature::Magnitude), 1e-3, |p| {
        let along = axis[0] * p[0] + axis[1] * p[1] + axis[2] * p[2];
        Some(1.3 * (length(&p).powi(2) - along * along).max(0.0).sqrt())
    });
}

#[test]
fn expansion_and_strain_have_no_vorticity() {
    let expansion = features([&|p| 0.5 * p[0], &|p| 0.5 * p[1], &|p| 0.5 * p[2]]);
    check(&expansion(VectorFeature::Divergence), 1e-3, |_| Some(1.5));
    check(&expansion(VectorFeature::VorticityMagnitude), 0.01, |_| Some(0.0));
    check(&expansion(VectorFeature::Magnitude), 1e-4, |p| Some(0.5 * length(&p)));
    // Pure strain: Q = −|S|² / 2 = −a².
    let strain = features([&|p| 0.7 * p[0], &|p| -0.7 * p[1], &|_| 0.0]);
    check(&strain(VectorFeature::QCriterion), 1e-3, |_| Some(-0.49));
    check(&strain(VectorFeature::Divergence), 0.01, |_| Some(0.0));
    // Shear: as much rotation as strain.
    let shear = features([&|p| 2.0 * p[2], &|_| 0.0, &|_| 0.0]);
    check(&shear(VectorFeature::VorticityMagnitude), 1e-3, |_| Some(2.0));
    check(&shear(VectorFeature::QCriterion), 0.01, |_| Some(0.0));
}

/// λ₂ of flows whose derivatives are the same everywhere, by the eigenvalues' closed form in double precision.
#[test]
fn linear_flows_have_the_middle_eigenvalue() {
    let flows: [[[f64; 3]; 3]; 6] = [
        // Strain, rotation, shear, expansion, and two of everything.
        [[0.7, 0.0, 0.0], [0.0, -0.7, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, -1.2, -0.4], [1.2, 0.0, -0.3], [0.4, 0.3, 0.0]],
        [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]],
        [[0.3, -1.1, 0.2], [0.9, -0.5, 0.7], [-0.4, 0.1, 0.2]],
        [[-2.0, 0.4, 1.0], [0.3, 1.1, -3.0], [0.2, 2.5, 0.9]],
    ];
    for (i, j) in flows.into_iter().enumerate() {
        let square = |a: usize, b: usize| (0..3).map(|m| j[a][m] * j[m][b]).sum::<f64>();
        let m: [[f64; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|b| (square(a, b) + square(b, a)) / 2.0));
        let mean = (m[0][0] + m[1][1] + m[2][2]) / 3.0;
        let off = m[0][1].powi(2) + m[0][2].powi(2) + m[1][2].powi(2);
        let spread = (((0..3).map(|a| (m[a][a] - mean).powi(2)).sum::<f64>() + 2.0 * off) / 6.0).sqrt();
        let want = if spread == 0.0 {
            mean
        } else {
            let n: [[f64; 3]; 3] =
                std::array::from_fn(|a| std::array::from_fn(|b| (m[a][b] - if a == b { mean } else { 0.0 }) / spread));
            let determinant = n[0][0] * (n[1][1] * n[2][2] - n[1][2] * n[2][1])
                - n[0][1] * (n[1][0] * n[2][2] - n[1][2] * n[2][0])
                + n[0][2] * (n[1][0] * n[2][1] - n[1][1] * n[2][0]);
            let angle = (determinant / 2.0).clamp(-1.0, 1.0).acos() / 3.0;
            mean + 2.0 * spread * (angle - 2.0 * std::f64::consts::PI / 3.0).cos()
        };
        let known = [Some(0.49), Some(-1.69), Some(0.0), Some(0.25), None, None][i];
        assert!(
            known.is_none_or(|known| (known - want).abs() < 1e-6),
            "{want} of flow {i}"
        );
        let along = |row: usize| move |p: [f64; 3]| (0..3).map(|k| j[row][k] * p[k]).sum::<f64>();
        let flow = features([&along(0), &along(1), &along(2)]);
        check(
            &flow(VectorFeature::Lambda2),
            if want.abs() < 1e-6 { 0.2 } else { 1e-3 },
            |_| Some(want),
        );
    }
}

#[test]
fn helicity_is_that_of_flows_along_their_own_vorticity() {
    // Of a Beltrami flow (Arnold, Beltrami, Childress) the curl is k times the flow.
    let k = 0.25;
    let flow = features([
        &|[_, y, z]| 1.5 * (k * z).sin() + 0.7 * (k * y).cos(),
        &|[x, _, z]| 1.1 * (k * x).sin() + 1.5 * (k * z).cos(),
        &|[x, y, _]| 0.7 * (k * y).sin() + 1.1 * (k * x).cos(),
    ]);
    let inside = |p: [f64; 3]| (0..3).all(|i| p[i].abs() < 9.0);
    check(&flow(VectorFeature::Helicity), 0.02, |[x, y, z]| {
        let u = 1.5 * (k * z).sin() + 0.7 * (k * y).cos();
        let v = 1.1 * (k * x).sin() + 1.5 * (k * z).cos();
        let w = 0.7 * (k * y).sin() + 1.1 * (k * x).cos();
        let expected = k * (u * u + v * v + w * w);
        (inside([x, y, z]) && expected > 0.3).then_some(expected)
    });
    // A rotation that moves along its axis: the screw is right-handed, or left-handed.
    for (pitch, helicity) in [(0.5, 0.6), (-0.5, -0.6)] {
        let screw = features([&|p| -0.6 * p[1], &|p| 0.6 * p[0], &move |_| pitch]);
        check(&screw(VectorFeature::Helicity), 1e-3, |_| Some(helicity));
    }
    let rotation = features([&|p| -0.6 * p[1], &|p| 0.6 * p[0], &|_| 0.0]);
    check(&rotation(VectorFeature::Helicity), 1e-3, |_| Some(0.0));
}

#[test]
fn a_vector_is_missing_where_one_of_its_components_is() {
    let mut fields = [0.0, 1.0, 2.0].map(|factor| of(|[x, _, _]| factor * x));
    fields[1].values[77] = f32::NAN;
    let fields = fields.each_ref();
    for &feature in VectorFeature::ALL {
        let values = derive::of_vector(fields, feature).values;
        let missing: Vec<_> = (0..values.len()).filter(|&i| values[i].is_nan()).collect();
        assert_eq!(missing, [77]);
    }
}
