//! Everything before the cut: min/max, histogram, active bricks and cells, nodes, vertices.

use super::volumes::{DIMS, Pattern, any_recipe, kinds};
use super::*;
use isopeel_kernels::{BRICK_CELLS, REGION_CELLS, SampleType};
use isopeel_reference::quadric::{self, Vertices};
use isopeel_reference::{classify, construct, histogram, minmax, sheets};

/// Which feature a case looks at.
#[derive(Clone, Debug)]
enum Look {
    Nothing,
    Gradient,
    Other(Recipe),
}

fn looks(of: Recipe) -> impl Strategy<Value = (Recipe, Look)> {
    let other = (kinds(), any::<u64>(), any::<bool>()).prop_map({
        let of = of.clone();
        move |(kind, seed, missing)| {
            Look::Other(Recipe {
                kind,
                seed,
                missing,
                pattern: Pattern::Waves(30),
                ..of.clone()
            })
        }
    });
    (
        Just(of),
        prop_oneof![1 => Just(Look::Nothing), 1 => Just(Look::Gradient), 2 => other],
    )
}

/// Runs `body` with the device's and the twin's form of a feature.
fn with_feature<T>(engine: &Engine, look: &Look, body: impl FnOnce(Feature<'_>, construct::Feature<'_>) -> T) -> T {
    match look {
        Look::Nothing => body(Feature::None, construct::Feature::None),
        Look::Gradient => body(Feature::GradientMagnitude, construct::Feature::GradientMagnitude),
        Look::Other(recipe) => {
            let other = load(engine, recipe);
            body(Feature::Field(&other.volume), construct::Feature::Field(&other.field))
        }
    }
}

fn region_at(grid: &Grid, linear: u32) -> [u32; 3] {
    let [rx, ry, _] = grid.regions();
    [linear % rx, linear / rx % ry, linear / rx / ry]
}

fn unmorton(m: u32) -> [u32; 3] {
    [0, 1, 2].map(|i| gather(m >> i))
}

/// Whether two results agree but for rounding.
fn near(a: f32, b: f32, tolerance: f32) -> bool {
    a == b || (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1.0)
}

fn check_minmax(engine: &Engine, loaded: &Loaded) -> Result<(), TestCaseError> {
    let grid = loaded.volume.grid();
    let (table, missing_masks) = testing::read_minmax(engine, &loaded.volume).expect("read the table");
    let twin = minmax::minmax(&loaded.field);
    let bricks = minmax::bricks(&loaded.field);
    for (i, range) in table.iter().enumerate() {
        let (region, m) = ((i / 64) as u32, (i % 64) as u32);
        let in_region = unmorton(m);
        let at: [u32; 3] =
            std::array::from_fn(|k| region_at(grid, region)[k] * REGION_CELLS / BRICK_CELLS + in_region[k]);
        let missing = missing_masks[region as usize][(m >> 5) as usize] >> (m & 31) & 1 == 1;
        if (0..3).all(|k| at[k] < bricks[k]) {
            let want = twin[((at[2] * bricks[1] + at[1]) * bricks[0] + at[0]) as usize];
            prop_assert_eq!(
                (range[0], range[1], missing),
                (want.min, want.max, want.missing),
                "brick {:?}",
                at
            );
        } else {
            prop_assert_eq!(
                (range[0], range[1], missing),
                (f32::INFINITY, f32::NEG_INFINITY, false),
                "no brick at {:?}",
                at
            );
        }
    }
    Ok(())
}

/// Bins may differ by what lies within rounding of their ends.
fn check_histogram(engine: &Engine, loaded: &Loaded, gradient: bool) -> Result<(), TestCaseError> {
    let derived;
    let (feature, field) = if gradient {
        derived = loaded.field.gradient_magnitude();
        (Feature::GradientMagnitude, &derived)
    } else {
        (Feature::None, &loaded.field)
    };
    let got = engine.histogram(&loaded.volume, feature).expect("histogram");
    let want = histogram::histogram(&field.values);
    let width = (want.range[1] - want.range[0]) / 256.0;
    let exact = !gradient;
    for (g, w) in got.range.iter().zip(want.range) {
        prop_assert!(
            if exact { *g == w } else { near(*g, w, 1e-6) },
            "{:?}, expected {:?}",
            got.range,
            want.range
        );
    }
    prop_assert_eq!(got.bins.iter().sum::<u64>(), want.bins.iter().sum::<u64>());
    if exact {
        prop_assert_eq!(got.bins, want.bins);
    } else if width > 0.0 && width.is_finite() {
        let slack = want.range[1].abs() * 4e-6;
        let finite: Vec<f32> = field.values.iter().copied().filter(|v| v.is_finite()).collect();
        let mut below = 0;
        for (i, n) in got.bins.iter().enumerate().take(255) {
            below += n;
            let end = want.range[0] + width * (i as f32 + 1.0);
            let least = finite.iter().filter(|v| **v < end - slack).count() as u64;
            let most = finite.iter().filter(|v| **v < end + slack).count() as u64;
            prop_assert!(
                (least..=most).contains(&below),
                "{below} values below {end}, expected {least} to {most}"
            );
        }
    }
    Ok(())
}

fn check_bricks(host: &Host, loaded: &Loaded, pyramid: &Pyramid) -> Result<(), TestCaseError> {
    let classes = classify::classify(&loaded.field, loaded.iso);
    let cells = host.grid.cells();
    let ranges = minmax::minmax(&loaded.field);
    let bricks = minmax::bricks(&loaded.field);
    let touched = ranges
        .iter()
        .filter(|r| r.min < loaded.iso && r.max >= loaded.iso)
        .count();
    prop_assert_eq!(host.bricks.len(), touched, "active bricks");
    let mut active = 0;
    for (compact, region) in host.regions.iter().enumerate() {
        let mask = u64::from(region.brick_mask[0]) | u64::from(region.brick_mask[1]) << 32;
        for (rank, m) in (0..64u32).filter(|m| mask >> m & 1 == 1).enumerate() {
            let brick = &host.bricks[region.brick_base as usize + rank];
            let in_region = unmorton(m);
            let at: [u32; 3] = std::array::from_fn(|k| region_at(&host.grid, region.region)[k] * 4 + in_region[k]);
            let range = ranges[((at[2] * bricks[1] + at[1]) * bricks[0] + at[0]) as usize];
            prop_assert!(range.min < loaded.iso && range.max >= loaded.iso);
            prop_assert_eq!((brick.region as usize, brick.morton), (compact, m));
            let mut want = Brick::default();
            let mut before = 0;
            for cell in 0..512u32 {
                if cell % 32 == 0 {
                    want.prefix[cell as usize / 32] = before;
                }
                let inside = unmorton(cell);
                let c: [u32; 3] = std::array::from_fn(|k| at[k] * 8 + inside[k]);
                if (0..3).any(|k| c[k] >= cells[k]) {
                    continue;
                }
                if let Some(&signs) = classes.active.get(&c) {
                    want.cells[cell as usize / 32] |= 1 << (cell % 32);
                    want.twos[cell as usize / 256] |= 1 << (cell / 8 % 32);
                    want.fours |= 1 << (cell / 64);
                    want.extras += u32::from(sheets::cell_sheets(&loaded.field, loaded.iso, c, signs).count) - 1;
                    // From the low corner along x, y and z.
                    want.quads += [1, 2, 4].iter().filter(|&k| (signs ^ signs >> k) & 1 == 1).count() as u32;
                    before += 1;
                }
                if classes.missing[((c[2] * cells[1] + c[1]) * cells[0] + c[0]) as usize] {
                    want.holes[cell as usize / 256] |= 1 << (cell / 8 % 32);
                }
            }
            active += u64::from(before);
            prop_assert_eq!(
                (
                    brick.cells,
                    brick.prefix,
                    brick.twos,
                    brick.holes,
                    brick.fours,
                    brick.extras,
                    brick.quads
                ),
                (
                    want.cells,
                    want.prefix,
                    want.twos,
                    want.holes,
                    want.fours,
                    want.extras,
                    want.quads
                ),
                "brick {:?}",
                at
            );
        }
    }
    prop_assert_eq!(
        active,
        classes.active.len() as u64,
        "no active cell lies in a brick that is not active"
    );
    prop_assert_eq!(pyramid.active_cells(), active);
    Ok(())
}

fn check_nodes(host: &Host, twin: &Twin, vertices: &Vertices, pyramid: &Pyramid) -> Result<(), TestCaseError> {
    prop_assert_eq!(pyramid.full_triangles(), twin.full_triangles());
    for (slot, (node, leaf)) in host.nodes.iter().zip(&host.leaves).enumerate() {
        if host.is_extra(slot) {
            let sheet = node.meta >> 26 & 3;
            prop_assert!((1..u32::from(vertices.sheets[&leaf.cube].count)).contains(&sheet));
            continue;
        }
        let Some(want) = twin.nodes[usize::from(leaf.level)].get(&leaf.cube) else {
            prop_assert_eq!(node.count, 0, "{:?} has no active cell", leaf);
            prop_assert!(leaf.level >= 3);
            continue;
        };
        let (signs, missing) = ((node.meta >> 16 & 0xff) as u8, node.meta >> 24 & 1 == 1);
        let triangles = if leaf.level == 0 { node.count & 0xff } else { node.count };
        prop_assert_eq!(
            (triangles, signs, missing),
            (want.count, want.signs, want.missing),
            "{:?}",
            leaf
        );
        prop_assert!(
            (node.s - want.s).abs() <= 2e-5,
            "s of {:?} is {}, expected {}",
            leaf,
            node.s,
            want.s
        );
        prop_assert!(
            near(node.f, want.f, 2e-5),
            "f of {:?} is {}, expected {}",
            leaf,
            node.f,
            want.f
        );
        if leaf.level > 0 {
            let safe = node.meta >> 25 & 1 == 1;
            prop_assert_eq!(safe, vertices.safe.contains(leaf), "{:?} is safe to merge", leaf);
        } else {
            prop_assert_eq!((node.meta >> 26 & 3) as u8 + 1, vertices.sheets[&leaf.cube].count);
        }
    }
    for brick in &host.bricks {
        let first = (host.regions[brick.region as usize].slot_base + brick.base[3]) as usize;
        for extra in 0..brick.extras {
            let slot = first + extra as usize;
            let begin = host.nodes[host.slots[&host.leaves[slot]]].count >> 8;
            let sheet = host.nodes[slot].meta >> 26 & 3;
            prop_assert_eq!(begin + sheet - 1, extra, "sheet {} of {:?}", sheet, host.leaves[slot]);
        }
    }
    let of_twin: usize = twin.nodes.iter().map(|n| n.len()).sum();
    let extras: usize = vertices.sheets.values().map(|s| usize::from(s.count) - 1).sum();
    let empty = host.nodes.iter().filter(|n| n.count == 0).count();
    prop_assert_eq!(host.nodes.len(), of_twin + extras + empty);
    Ok(())
}

/// Positions within the lattice's rounding where the Newton steps do not jump; errors within f32 sums' rounding.
///
/// On a plateau the gradient is zero but for rounding, and a Newton step goes anywhere: `plateaus` allows one in a hundred.
fn check_placements(host: &Host, field: &Field, vertices: &Vertices, plateaus: bool) -> Result<(), TestCaseError> {
    let mut moved = Vec::new();
    for (slot, leaf) in host.leaves.iter().enumerate() {
        let node = host.nodes[slot];
        if node.count == 0 {
            continue;
        }
        let sheet = if host.is_extra(slot) {
            (node.meta >> 26 & 3) as u8
        } else {
            0
        };
        let want = vertices.placements[&(*leaf, sheet)];
        let place = host.placements[slot];
        let [low, high] = field.cube_samples(usize::from(leaf.level), leaf.cube);
        let longest = field.grid.spacing.into_iter().fold(0.0, f32::max);
        let reach = f64::from(1u32 << leaf.level);
        let mut elsewhere = false;
        for (axis, lattice) in host.position(slot).into_iter().enumerate() {
            let at = lattice as f64 / f64::from(Vertex::LATTICE);
            prop_assert!(
                at > f64::from(low[axis]) && at < f64::from(high[axis]),
                "the vertex of {:?} at {} along axis {}",
                leaf,
                at,
                axis
            );
            // Rounded once where it was placed, a cell's once more where it was moved from there by its neighbours: what they are
            // off along the longest axis is worth more cells along a shorter one.
            let stretch = if leaf.level == 0 {
                f64::from(longest / field.grid.spacing[axis])
            } else {
                1.0
            };
            let tolerance = (1.0 + 1.5 * stretch) / 2048.0 + 2e-4 * reach + 2.0 * stretch * want.spread;
            elsewhere |= (at - want.position[axis]).abs() > tolerance;
        }
        if elsewhere {
            moved.push((*leaf, sheet, host.position(slot), want));
            continue;
        }
        if want.spread < 1e-3 {
            // The quadric's constant term counts distances from the middle of the brick or region.
            let spacing = field.grid.spacing.iter().fold(0.0f64, |m, &s| m.max(s.into()));
            let far = spacing * if leaf.level > 3 { 28.0 } else { 7.0 };
            let off = (f64::from(place.error).powi(2) - want.error.powi(2)).abs();
            let tolerance = 2e-6 * far * far + (2e-3 * reach * spacing) * (want.error + 2e-3 * reach * spacing);
            // Nobody asks for the error of one of several sheets: a cell is never refused.
            let several = leaf.level == 0 && vertices.sheets[&leaf.cube].count > 1;
            prop_assert!(
                off <= tolerance || (several && place.error == 0.0),
                "{:?}: error {}, expected {}",
                leaf,
                place.error,
                want.error
            );
            let length = want.towards.iter().map(|g| g * g).sum::<f64>().sqrt();
            let [x, y] = [place.normal as u8 as i8, (place.normal >> 8) as u8 as i8];
            let packed = Vertex {
                position: [0; 3],
                normal: [x, y].map(|n| (f32::from(n) / 127.0 * 32767.0).round() as i16),
                smoothness: 0,
                feature: 0,
            };
            if length > 0.05 * f64::from(node.count) && !host.is_extra(slot) && leaf.level > 0 {
                let cosine: f64 = packed
                    .unit_normal()
                    .iter()
                    .zip(want.towards)
                    .map(|(n, g)| -f64::from(*n) * g / length)
                    .sum();
                prop_assert!(
                    cosine > 0.998,
                    "{:?}: normal off by {} degrees",
                    leaf,
                    cosine.acos().to_degrees()
                );
            }
        }
    }
    let allowed = if plateaus { 1 + host.leaves.len() / 100 } else { 0 };
    prop_assert!(
        moved.len() <= allowed,
        "{} vertices of {} lie elsewhere, the first: {:?}",
        moved.len(),
        host.leaves.len(),
        moved[0]
    );
    Ok(())
}

#[test]
fn all_before_the_cut() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |((recipe, look) in any_recipe().prop_flat_map(looks))| {
        let loaded = load(&engine, &recipe);
        check_minmax(&engine, &loaded)?;
        check_histogram(&engine, &loaded, false)?;
        with_feature(&engine, &look, |feature, twin_feature| {
            let pyramid = build(&engine, &loaded, feature);
            let host = Host::read(&engine, &pyramid);
            check_bricks(&host, &loaded, &pyramid)?;
            let twin = construct::construct(&loaded.field, twin_feature, loaded.iso);
            let vertices = quadric::vertices(&loaded.field, &twin, loaded.iso);
            check_nodes(&host, &twin, &vertices, &pyramid)?;
            // Infinities have no planes to fit; the vertex must be in its cube all the same, which owners() sees.
            if recipe.pattern == Pattern::Extremes && recipe.kind == SampleType::F32 {
                return Ok(());
            }
            check_placements(&host, &loaded.field, &vertices, !matches!(recipe.pattern, Pattern::Waves(0)))
        })?;
    });
}

#[test]
fn gradients_have_the_twins_histogram() {
    let Some(engine) = device() else { return };
    for (i, dims) in DIMS.into_iter().enumerate() {
        let recipe = Recipe {
            missing: i % 2 == 1,
            spacing: [1.0, 0.3, 7.0],
            ..Recipe::plain(dims, Pattern::Waves(20), i as u64)
        };
        check_histogram(&engine, &load(&engine, &recipe), true).expect("the same histogram");
    }
}
