//! Parts of the full dual mesh: their areas, what goes with small and chosen ones, and cuts without them.

use super::host_tree::HostTree;
use super::recipes::{Pattern, Random, recipes, surfaces};
use super::tree::{Planted, plant, plant_in};
use super::tree_cut::{check_cuts_without, cut};
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{ChosenParts, PartFilter, Samples, TreeGoal};
use isopeel_reference::tree::LATTICE;
use isopeel_reference::tree_part::{Chosen, Filter, Parts, Remaining, part_near, parts, without};

/// The device's areas are the twin's.
fn check_areas(engine: &Engine, planted: &Planted, want: &Parts) -> Result<(), TestCaseError> {
    let Planted {
        loaded,
        pyramid,
        tree,
        params,
    } = planted;
    let got = testing::part_areas(engine, &loaded.volume, pyramid, tree, params).expect("areas");
    prop_assert_eq!(got.len(), want.areas.len());
    for (point, (&got, (&area, &first))) in got.iter().zip(want.areas.iter().zip(&want.firsts)).enumerate() {
        prop_assert_eq!(got < 0.0, first == Some(point), "the first point of {:?}", first);
        prop_assert_eq!(got == 0.0, first.is_none(), "point {} of {:?}", point, first);
        // A triangle without an area counts a little.
        prop_assert!(near(got.abs(), area as f32, 1e-4), "area {}, expected {}", got, area);
    }
    Ok(())
}

/// Minimum areas between those of parts, so that rounding decides nothing, and one above all.
fn thresholds(parts: &Parts) -> Vec<f32> {
    let mut areas: Vec<f64> = parts.areas.iter().copied().filter(|&area| area > 0.0).collect();
    areas.sort_by(f64::total_cmp);
    areas.dedup_by(|a, b| *a - *b < 1e-3 * *a);
    let middle = areas.len() / 2;
    let between = |i: usize| Some(((areas.get(i)? + areas.get(i + 1)?) / 2.0) as f32);
    [between(0), between(middle), areas.last().map(|&area| 2.0 * area as f32)]
        .into_iter()
        .flatten()
        .collect()
}

/// What is said to be removed is what the twin removes.
fn check_counts(
    engine: &Engine,
    planted: &Planted,
    remaining: &Remaining,
    filter: &PartFilter,
    unmatched: u64,
) -> Result<(), TestCaseError> {
    let Planted {
        loaded,
        pyramid,
        tree,
        params,
    } = planted;
    let removed = engine
        .removed_parts(&loaded.volume, pyramid, tree, params, filter, &Never)
        .expect("removed parts");
    prop_assert_eq!((removed.parts, removed.unmatched), (remaining.parts, unmatched));
    let host = HostPyramid::read(engine, pyramid);
    // Cells are the first slots of a region, and its first points.
    let cells = host
        .regions
        .iter()
        .flat_map(|region| (0..region.level_base[1]).map(|i| (region.point_base + i, region.slot_base + i)));
    let of_removed = cells.filter(|(point, _)| remaining.is_removed[*point as usize]);
    let full: u64 = of_removed
        .map(|(_, slot)| u64::from(host.nodes[slot as usize].count & 0xff))
        .sum();
    prop_assert_eq!(removed.full_triangles, full);
    let goal = TreeGoal {
        max_tolerance: f32::INFINITY,
        tolerance: -1.0,
        max_triangles: u64::MAX,
        without: filter.clone(),
        may_vanish: false,
        weights: None,
    };
    let (surface, _) = cut(engine, planted, params, &goal);
    prop_assert_eq!(surface.statistics.removed, Some(removed));
    prop_assert_eq!(
        surface.statistics.full_triangles + removed.full_triangles,
        pyramid.full_triangles()
    );
    Ok(())
}

fn check(engine: &Engine, planted: &Planted, seed: u64) -> Result<(), TestCaseError> {
    let host = HostTree::read(engine, planted);
    let parts = parts(&host.mesh);
    check_areas(engine, planted, &parts)?;
    let mut random = Random(seed);
    let chosen = choices(&host, &parts, &mut random);
    let by_area = thresholds(&parts).into_iter();
    let filters = by_area.map(|min_area| PartFilter { min_area, chosen: None });
    // The twin takes long for cuts of almost all parts: one choice of several.
    let is_cut = |i: usize| i < filters.len() || i - filters.len() == (seed % chosen.len() as u64) as usize;
    for (i, filter) in filters.clone().chain(chosen.clone()).enumerate() {
        let in_filter = |e: TestCaseError| TestCaseError::fail(format!("without {filter:?}: {e}"));
        let (of_twin, unmatched) = twin_of(&host, &parts, &filter);
        let remaining = without(&host.mesh, &host.tree, &parts, &of_twin);
        check_counts(engine, planted, &remaining, &filter, unmatched).map_err(in_filter)?;
        if is_cut(i) {
            check_cuts_without(engine, planted, &host, &remaining, &filter, seed).map_err(in_filter)?;
        }
    }
    Ok(())
}

/// Positions on vertices, next to them, far from any perhaps, and outside the volume; hidden and kept, the last also with a minimum area.
fn choices(host: &HostTree, parts: &Parts, random: &mut Random) -> [PartFilter; 3] {
    let (points, grid) = (&host.mesh.points, &host.mesh.grid);
    let ends = grid.dims.map(|n| (n - 1) as f32);
    let mut positions = |count: usize| -> Vec<Option<[f32; 3]>> {
        let mut all = vec![None, Some(std::array::from_fn(|i| random.unit() * ends[i]))];
        for i in 0..count.min(points.len()) {
            let at = points[random.next() as usize % points.len()].position;
            let off = if i % 2 == 0 { 0.0 } else { 1.5 };
            let near = |axis: usize| at[axis] as f32 / LATTICE as f32 + off * (random.unit() - 0.5);
            let position: [f32; 3] = std::array::from_fn(near);
            all.push(Some(std::array::from_fn(|axis| position[axis].clamp(0.0, ends[axis]))));
        }
        all
    };
    let filter = |min_area, chosen| PartFilter {
        min_area,
        chosen: Some(chosen),
    };
    [
        filter(0.0, ChosenParts::Hide(positions(2))),
        filter(0.0, ChosenParts::Keep(positions(2))),
        filter(
            thresholds(parts).first().copied().unwrap_or(1.0),
            ChosenParts::Keep(positions(6)),
        ),
    ]
}

/// The filter of the twin, and how many positions have no part next to them.
fn twin_of(host: &HostTree, parts: &Parts, filter: &PartFilter) -> (Filter, u64) {
    let min_area = filter.min_area.into();
    let Some(chosen) = &filter.chosen else {
        return (Filter { min_area, chosen: None }, 0);
    };
    let near = |position: &Option<[f32; 3]>| position.and_then(|at| part_near(&host.mesh, parts, at));
    let found: Vec<Option<usize>> = chosen.positions().iter().map(near).collect();
    let firsts = found.iter().copied().flatten().collect();
    let chosen = Some(match chosen {
        ChosenParts::Hide(_) => Chosen::Hidden(firsts),
        ChosenParts::Keep(_) => Chosen::Kept(firsts),
    });
    let unmatched = found.iter().filter(|part| part.is_none()).count() as u64;
    (Filter { min_area, chosen }, unmatched)
}

#[test]
fn parts_and_cuts_without_some_agree_with_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(3), |(recipe in recipes(surfaces()), cap in proptest::bool::weighted(0.3), seed in any::<u64>())| {
        check(&engine, &plant(&engine, &recipe, cap), seed)?;
    });
}

/// The kernels of a GPU on any device: work-groups of many.
#[test]
fn work_groups_of_a_gpu_find_the_same_parts() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    for (pattern, missing) in [(Pattern::Waves(15), false), (Pattern::Blocks, true)] {
        let recipe = Recipe {
            missing,
            spacing: [1.0, 0.5, 2.0],
            ..Recipe::plain([24, 20, 19], pattern, 9)
        };
        check(&of_gpu, &plant(&of_gpu, &recipe, false), 4).expect("the twin's parts");
    }
}

/// A ball, and a speck that is far from it.
fn ball_and_speck(engine: &Engine) -> Planted {
    let dims = [80u32, 40, 40];
    let distance = |at: [u32; 3]| at.map(|x| (x as f32 - 12.0).powi(2)).iter().sum::<f32>().sqrt();
    let value = |i: u32| {
        let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
        if at == [75, 37, 5] { 1.0 } else { 8.3 - distance(at) }
    };
    let (grid, samples) = (
        Grid::new(dims, [1.0; 3]).expect("a grid"),
        Samples::F32((0..dims.iter().product()).map(value).collect()),
    );
    let loaded = load_samples(engine, grid, &samples, None, 0.0);
    plant_in(engine, loaded, Feature::None, dual_params())
}

/// At the removed parts, which are 50 voxels from the remaining ones, no distance is measured.
#[test]
fn removed_parts_are_not_measured() {
    let Some(engine) = device() else { return };
    let planted = ball_and_speck(&engine);
    let params = CutParams {
        state_error: true,
        ..planted.params.clone()
    };
    let goal = |min_area| TreeGoal {
        max_tolerance: f32::INFINITY,
        tolerance: 0.2,
        max_triangles: u64::MAX,
        without: PartFilter { min_area, chosen: None },
        may_vanish: false,
        weights: None,
    };
    let before = planted.tree.device_bytes();
    let (whole, _) = cut(&engine, &planted, &params, &goal(0.0));
    assert_eq!(whole.statistics.removed, None);
    assert_eq!(
        planted.tree.device_bytes(),
        before,
        "parts are found where they are asked for"
    );
    let (ball, _) = cut(&engine, &planted, &params, &goal(10.0));
    assert_eq!(ball.statistics.removed.map(|removed| removed.parts), Some(1));
    assert!(planted.tree.device_bytes() > before);
    assert!(
        ball.regions.iter().all(|region| region.coords[0] < 1),
        "the speck is gone"
    );
    let (a, b) = (
        whole.statistics.error.expect("asked for"),
        ball.statistics.error.expect("asked for"),
    );
    assert!(
        b.max <= a.max && b.max < 0.5 && b.rms > 0.0,
        "{b:?}, with the speck {a:?}"
    );
    let measured = engine
        .measure_tree_error(
            &planted.loaded.volume,
            &planted.pyramid,
            &planted.tree,
            &params,
            &goal(10.0),
            &Never,
        )
        .expect("measure");
    assert_eq!(measured.whole, b);
    let (nothing, _) = cut(&engine, &planted, &params, &goal(1e6));
    assert_eq!(nothing.statistics.removed.map(|removed| removed.parts), Some(2));
    assert!(nothing.regions.is_empty());
    assert_eq!(
        (
            nothing.statistics.triangles,
            nothing.statistics.vertices,
            nothing.statistics.full_triangles
        ),
        (0, 0, 0)
    );
    assert_eq!(nothing.statistics.error.map(|error| error.max), Some(0.0));
}
