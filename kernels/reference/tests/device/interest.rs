//! Random regions of interest, and what they do to cuts of cubes by error; the other comparisons use them too.

use super::recipes::{Random, recipes, surfaces};
use super::*;
use isopeel_kernels::{Interest, InterestShape};
use isopeel_reference::{Feature as TwinFeature, construct, cut};

/// Random regions of interest in a volume of `dims` samples: none, a few or the maximum number; with axes of the grid or turned, also
/// with faces and centres exactly on samples.
pub fn interests(random: &mut Random, dims: [u32; 3]) -> Vec<Interest> {
    let count = [0, 0, 1, 2, 5, 64][(random.next() % 6) as usize];
    (0..count).map(|_| interest(random, dims)).collect()
}

fn interest(random: &mut Random, dims: [u32; 3]) -> Interest {
    let is_round = random.next().is_multiple_of(2);
    let mut number = |scale: f32| match random.unit() * scale {
        number if is_round => number.round(),
        number => number,
    };
    let centre = dims.map(|n| number(n as f32));
    let half = [0; 3].map(|_| 1.0 + number(12.0));
    let mut turned = |i: usize, j: usize| match (i == j, is_round) {
        (true, _) => half[i].recip(),
        (false, true) => 0.0,
        (false, false) => (number(1.0) - 0.5) / half[i],
    };
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| turned(i, j)));
    Interest {
        centre,
        rows,
        shape: match random.next() % 2 {
            0 => InterestShape::Ball,
            _ => InterestShape::Cube,
        },
        importance: random.unit(),
    }
}

#[test]
fn cuts_by_error_agree_leaf_for_leaf() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = HostPyramid::read(&engine, &pyramid);
        let mut twin = construct::construct(&loaded.field, TwinFeature::None, loaded.iso);
        host.fill(&mut twin);
        let mut random = Random(seed);
        for _ in 0..4 {
            let tolerance = random.unit() * recipe.spacing[0] * [1.0, 1.0, 20.0][random.next() as usize % 3];
            let interest = interests(&mut random, recipe.dims);
            let params = CutParams { tolerance: Some(tolerance), interest, ..dual_params() };
            let on_device = engine.cut(&loaded.volume, &pyramid, &params, Level::FINEST).expect("cut");
            let state = testing::read_cut(&engine, &on_device).expect("read the cut");
            // The error decides alone.
            let all = CutParams { beta: f32::MAX, ..params.clone() };
            let want = cut::guarded(&twin, &all, Level::FINEST, |leaf| {
                let node = &twin.nodes[usize::from(leaf.level)][&leaf.cube];
                let weight = (1.0 - cut::importance(node, *leaf, twin.dims, &params)).max(1.0 / 64.0);
                let error = host.vertex_records[host.slots[leaf]].error;
                cut::summed_error(node, leaf.level, recipe.spacing, error) / weight <= tolerance
            });
            prop_assert_eq!(&host.cut(&twin, &state).leaf_of, &want.leaf_of, "{:?}", params);
        }
    });
}

#[test]
fn nothing_is_decimated_where_all_is_important() {
    let Some(engine) = device() else { return };
    let loaded = load(&engine, &Recipe::plain([70, 40, 40], recipes::Pattern::Waves(0), 5));
    let pyramid = build(&engine, &loaded, Feature::None);
    let host = HostPyramid::read(&engine, &pyramid);
    let half = |importance| Interest {
        centre: [0.0; 3],
        rows: [[1.0 / 32.0, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]],
        shape: InterestShape::Cube,
        importance,
    };
    let states = |interest: Vec<Interest>| {
        let params = CutParams {
            beta: 0.5,
            interest,
            ..dual_params()
        };
        let cut = engine
            .cut(&loaded.volume, &pyramid, &params, Level::FINEST)
            .expect("cut");
        testing::read_cut(&engine, &cut).expect("read the cut")
    };
    let (plain, raised) = (states(vec![]), states(vec![half(1.0)]));
    assert!(plain == states(vec![half(0.0)]), "an importance of 0 changes nothing");
    let cells = || host.leaves.iter().enumerate().filter(|(_, leaf)| leaf.level == 0);
    // A cube that only touches the region of interest is raised too.
    let (inside, outside): (Vec<_>, Vec<_>) = cells().partition(|(_, leaf)| leaf.cube[0] < 32);
    assert!(inside.iter().all(|(slot, _)| raised[*slot] == 0));
    assert!(inside.iter().any(|(slot, _)| plain[*slot] > 0));
    let beyond: Vec<_> = outside.iter().filter(|(_, leaf)| leaf.cube[0] >= 64).collect();
    assert!(!beyond.is_empty() && beyond.iter().all(|(slot, _)| raised[*slot] == plain[*slot]));
    let many = CutParams {
        interest: vec![half(0.5); 65],
        ..dual_params()
    };
    let error = engine
        .cut(&loaded.volume, &pyramid, &many, Level::FINEST)
        .err()
        .expect("too many");
    assert_eq!(error.to_string(), "interest: 65 regions, expected at most 64");
}
