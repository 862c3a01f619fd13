//! Surfaces of which only a part is meshed again: the differences of two cuts, and the surfaces between one cut and the other.

use super::recipes::{recipes, surfaces};
use super::*;
use isopeel_kernels::{Cut as DeviceCut, RegionKey};
use std::cell::Cell;
use std::collections::BTreeMap;

pub type Parts = BTreeMap<RegionKey, Region>;

/// Puts what was made into the surface that was shown, as a client does.
pub fn replace(shown: &Parts, made: &Surface) -> Parts {
    let mut parts = match &made.remade {
        None => Parts::new(),
        Some(remade) => shown
            .iter()
            .filter(|(key, _)| !remade.contains(key))
            .map(|(c, r)| (*c, r.clone()))
            .collect(),
    };
    parts.extend(made.regions.iter().map(|region| (region.key(), region.clone())));
    parts
}

/// A region in which neither its own leaves nor those that touch it differ is not made again.
fn check_differences(host: &HostPyramid, states: [&[u8]; 2], differences: &Differences) -> Result<(), TestCaseError> {
    let mut leaves = vec![false; host.regions.len()];
    let mut meshes = vec![false; host.regions.len()];
    let at: HashMap<[u32; 3], usize> = host
        .regions
        .iter()
        .enumerate()
        .map(|(i, region)| (region_at(&host.grid, region.region), i))
        .collect();
    let changed = host
        .leaves
        .iter()
        .enumerate()
        .filter(|(slot, _)| states[0][*slot] != states[1][*slot]);
    for (_, leaf) in changed {
        leaves[at[&leaf.region()]] = true;
        let size = 1i64 << leaf.level;
        let low = leaf.cube.map(|c| i64::from(c) * size);
        // Every cell of the halo around the cube says which region it touches.
        for corner in 0..27i64 {
            let cell: [i64; 3] = std::array::from_fn(|axis| match corner / 3i64.pow(axis as u32) % 3 {
                0 => low[axis] - 1,
                1 => low[axis],
                _ => low[axis] + size,
            });
            if let Some(&region) = at.get(&cell.map(|c| if c < 0 { u32::MAX } else { c as u32 / 32 })) {
                meshes[region] = true;
            }
        }
    }
    prop_assert_eq!(&differences.leaves, &leaves);
    prop_assert_eq!(&differences.meshes, &meshes);
    Ok(())
}

#[test]
fn a_part_made_anew_fits_the_rest() {
    let Some(engine) = device() else { return };
    // Surfaces of steps in which regions were joined, and in which some were not.
    let (joined, single) = (Cell::new(0), Cell::new(0));
    proptest!(config(24), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = HostPyramid::read(&engine, &pyramid);
        let (first, mut second) = (host.random_state(seed, Topology::Free), host.random_state(seed ^ 1, Topology::Free));
        // Some regions stay as they are.
        for (_, region) in host.regions.iter().enumerate().filter(|(i, _)| seed >> (i % 64) & 1 == 1) {
            let slots = region.slot_base as usize..(region.slot_base + region.level_base[7]) as usize;
            second[slots.clone()].copy_from_slice(&first[slots]);
        }
        let params = dual_params();
        let cuts = [&first, &second].map(|state| testing::upload_cut(&engine, &pyramid, &params, state).expect("upload"));
        let volume = &loaded.volume;
        let surface = |cut: &DeviceCut, kept: Option<Kept<'_>>| engine.surface(volume, &pyramid, &params, cut, kept, &Never).expect("a surface");
        let compare = |before: &DeviceCut, after: &DeviceCut| {
            engine.differences(volume, &pyramid, before, after).expect("compare").expect("of one pyramid")
        };

        let differences = compare(&cuts[0], &cuts[1]);
        check_differences(&host, [&first, &second], &differences)?;

        let shown = replace(&Parts::new(), &surface(&cuts[0], None));
        let whole = surface(&cuts[1], None);
        let want = replace(&Parts::new(), &whole);
        let made = surface(&cuts[1], Some(Kept { shown: &cuts[0], differences: &differences }));
        prop_assert_eq!(&replace(&shown, &made), &want, "at once");
        prop_assert_eq!(made.statistics.triangles, whole.statistics.triangles);
        prop_assert_eq!(made.statistics.vertices, whole.statistics.vertices);

        // Region by region, some at a time: each step is watertight, for it is what a whole mesh of the mixed cut would be.
        let (mut shown, mut before) = (shown, testing::upload_cut(&engine, &pyramid, &params, &first).expect("upload"));
        surface(&before, None);
        for half in 0..2 {
            let take: Vec<bool> = (0..host.regions.len()).map(|i| half == 1 || i % 2 == 0).collect();
            let mixed = engine.mix(volume, &pyramid, &before, &cuts[1], &take).expect("mix");
            let differences = compare(&before, &mixed);
            prop_assert_eq!(&compare(&before, &cuts[1]).to_mix(&pyramid, &take), &differences);
            let made = surface(&mixed, Some(Kept { shown: &before, differences: &differences }));
            shown = replace(&shown, &made);
            let state = testing::read_cut(&engine, &mixed).expect("read");
            let whole = mesh(&engine, &loaded, &pyramid, &params, &state);
            prop_assert_eq!(&shown, &replace(&Parts::new(), &whole), "step {}", half);
            prop_assert_eq!(made.statistics.vertices, whole.statistics.vertices);
            let is_joined = |region: &Region| region.size > 0;
            joined.set(joined.get() + usize::from(shown.values().any(is_joined)));
            single.set(single.get() + usize::from(!shown.values().all(is_joined)));
            before = mixed;
        }
        prop_assert_eq!(&shown, &want, "in steps");
    });
    assert!(
        joined.get() > 0 && single.get() > 0,
        "{joined:?} and {single:?} surfaces"
    );
}
