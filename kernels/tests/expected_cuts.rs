//! The device against counts from an independent float64 implementation (algorithm, section 9).

mod common;

use isopeel_kernels::{CutParams, Feature, Isovalue, Level, Never};

#[test]
fn leaves_equal_the_expected_counts() {
    let Some(engine) = common::engine() else { return };
    let mut volumes = std::collections::HashMap::new();
    let mut run = 0;
    for line in common::EXPECTED_CUTS.lines() {
        let want: common::ExpectedCut = serde_json::from_str(line).expect("a line of expected-cuts.jsonl");
        let mut load = |name: &str| -> Option<()> {
            if !volumes.contains_key(name) {
                let (grid, samples) = common::volume(name)?;
                volumes.insert(name.to_owned(), engine.upload(&grid, &samples, None).expect("upload"));
            }
            Some(())
        };
        if load(&want.volume).is_none() || want.feature.as_ref().is_some_and(|f| load(f).is_none()) {
            continue;
        }
        let volume = &volumes[&want.volume];
        let feature = want
            .feature
            .as_ref()
            .map_or(Feature::None, |f| Feature::Field(&volumes[f]));
        let pyramid = engine
            .build_pyramid(volume, feature, Isovalue::new(want.iso).unwrap(), &Never)
            .expect("build the pyramid");
        let params = CutParams {
            alpha: want.alpha,
            feature_range: want.feature_range.unwrap_or([0.0, 1.0]),
            ..CutParams::paper(want.beta)
        };
        let surface = engine
            .peel(volume, &pyramid, &params, Level::FINEST, &Never)
            .expect("peel");
        let got = &surface.statistics;
        assert_eq!(got.full_triangles, want.full_triangles, "{line}");
        assert_eq!(got.active_cells, want.active_cells, "{line}");
        for (level, (&got, &want)) in got.leaves.iter().zip(&want.leaves_per_level).enumerate() {
            let allowed = (want as f64 * 1e-3).max(1.0);
            assert!(
                (got as f64 - want as f64).abs() <= allowed,
                "level {level}: {got}, expected {want}: {line}"
            );
        }
        let allowed = want.decimated_triangles as f64 * 1e-3;
        let off = got.triangles as f64 - want.decimated_triangles as f64;
        assert!(off.abs() <= allowed, "{} triangles: {line}", got.triangles);
        let in_regions: usize = surface.regions.iter().map(|r| r.indices.len() / 3).sum();
        assert_eq!(in_regions as u64, got.triangles);
        run += 1;
    }
    println!("{run} settings compared");
}
