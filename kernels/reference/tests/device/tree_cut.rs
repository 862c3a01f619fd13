//! Cuts of the vertex tree: the twin's triangles from the same tree, budgets, and that no cut changes the topology.

use super::differences::{Parts, replace};
use super::host_tree::HostTree;
use super::interest::interests;
use super::recipes::{Pattern, Random, recipes, surfaces};
use super::tree::{Planted, check, plant};
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{
    ControlPoint, PartFilter, RegionKey, RegionWeights, TransferFunction, TreeGoal, TreeRegions, TreeSurface,
};
use isopeel_reference::tree::LATTICE;
use isopeel_reference::tree_cut::{Cutter, TreeCut, TreeLeaf, Weights};
use isopeel_reference::tree_part::{Filter, Remaining, parts, total_area, without};
use isopeel_reference::tree_relax::Relaxer;
use rayon::prelude::*;
use rustc_hash::FxHashSet as HashSet;
use std::sync::Arc;

const NO_LIMIT: u64 = u64::MAX;

/// A triangle between leaves.
type Triangle = [TreeLeaf; 3];

fn importances(points: &[[f32; 2]]) -> TransferFunction {
    let points = points.iter().map(|&[x, importance]| ControlPoint { x, importance });
    TransferFunction::new(points.collect()).expect("a transfer function")
}

/// Tolerances and budgets, each with some importance.
fn goals(planted: &Planted, full: u64, without: &PartFilter, random: &mut Random) -> Vec<(CutParams, TreeGoal)> {
    let regions = planted.pyramid.active_regions();
    let weights: Vec<f32> = (0..2 * regions).map(|_| 2f32.powf(8.0 * random.unit() - 4.0)).collect();
    let weighted = |first: usize, in_steps| {
        let of_regions = weights[first..first + regions].to_vec();
        Some(Arc::new(RegionWeights { of_regions, in_steps }))
    };
    let goal = |tolerance, max_triangles| TreeGoal {
        tolerance,
        max_triangles,
        max_tolerance: f32::INFINITY,
        without: without.clone(),
        may_vanish: false,
        weights: None,
    };
    let goals = [
        goal(-1.0, NO_LIMIT),
        goal(0.0, NO_LIMIT),
        goal(0.05 + random.unit() / 4.0, NO_LIMIT),
        goal(3.0, NO_LIMIT),
        goal(f32::INFINITY, NO_LIMIT),
        goal(-1.0, full / 2),
        goal(0.1, full / 4),
        goal(-1.0, full / 10),
        goal(-1.0, 0),
        TreeGoal {
            max_tolerance: 0.2,
            ..goal(-1.0, full / 3)
        },
        TreeGoal {
            may_vanish: true,
            ..goal(-1.0, 0)
        },
        TreeGoal {
            may_vanish: true,
            ..goal(1.0 + 20.0 * random.unit(), NO_LIMIT)
        },
        TreeGoal {
            weights: weighted(0, true),
            ..goal(0.1 + random.unit(), full / 4)
        },
        TreeGoal {
            weights: weighted(regions, false),
            max_tolerance: 0.5,
            ..goal(-1.0, full / 5)
        },
        TreeGoal {
            weights: weighted(0, true),
            may_vanish: true,
            ..goal(1.0 + 20.0 * random.unit(), NO_LIMIT)
        },
    ];
    let with_params = |goal| {
        let [from, to] = [random.unit(), random.unit()];
        let transfer = match random.next() % 3 {
            0 => importances(&[[0.0, 0.0]]),
            1 => TransferFunction::default(),
            _ => importances(&[[0.0, from], [0.2, to], [0.6, 1.0]]),
        };
        let params = CutParams {
            alpha: [0.0, 0.5, 1.0][(random.next() % 3) as usize],
            feature_range: [0.0, 1.5],
            transfer,
            interest: interests(random, planted.loaded.field.grid.dims),
            ..planted.params.clone()
        };
        (params, goal)
    };
    goals.into_iter().map(with_params).collect()
}

pub fn cut(engine: &Engine, planted: &Planted, params: &CutParams, goal: &TreeGoal) -> (Surface, f32) {
    let made = cut_beside(engine, planted, params, goal, None);
    (made.surface, made.tolerance)
}

/// Makes the regions in which a cut's surface differs from one that is shown.
fn cut_beside(
    engine: &Engine,
    planted: &Planted,
    params: &CutParams,
    goal: &TreeGoal,
    shown: Option<&TreeRegions>,
) -> TreeSurface {
    let (volume, pyramid) = (&planted.loaded.volume, &planted.pyramid);
    engine
        .tree_surface(volume, pyramid, &planted.tree, params, goal, shown, &Never)
        .expect("cut the tree")
}

/// Steps of [`absolute`] in one of positions in the tree.
const STEPS: i64 = (Vertex::LATTICE / LATTICE) as i64;

/// Whether two triangles have the same corners, except for the last digit of nodes that have moved.
fn same_triangle(got: &[[i64; 3]; 3], want: &[[i64; 3]; 3]) -> bool {
    got.iter()
        .flatten()
        .zip(want.iter().flatten())
        .all(|(a, b)| (a - b).abs() <= STEPS)
}

/// The regions of 32³ cells that a region of a mesh consists of, x fastest.
fn members(key: RegionKey) -> impl Iterator<Item = [u32; 3]> {
    let cube = 0..1u32 << (3 * key.size);
    let bits = move |n: u32, axis: u32| n >> (axis * u32::from(key.size)) & ((1 << key.size) - 1);
    cube.map(move |n| std::array::from_fn(|axis| key.coords[axis] + bits(n, axis as u32)))
}

/// The device's triangles are the twin's, in order.
fn check_surface(relaxer: &Relaxer<'_>, surface: &Surface, want: &TreeCut) -> Result<(), TestCaseError> {
    let cutter = &relaxer.cutter;
    let moved = relaxer.positions(&want.leaves);
    let position = |leaf: TreeLeaf| match leaf {
        TreeLeaf::Node(node) => moved[&node],
        TreeLeaf::Point(_) => cutter.position(leaf),
    };
    let corner = |leaf| position(leaf).map(|x| i64::from(x) * STEPS);
    let level_of = |t: &Triangle| t.map(|leaf| cutter.level(leaf)).into_iter().min();
    let mut left = want.triangles.clone();
    for region in &surface.regions {
        let all: Vec<Triangle> = members(region.key())
            .flat_map(|coords| left.remove(&coords).unwrap_or_default())
            .collect();
        let of_level = |level: u8| all.iter().filter(move |t| level_of(t) == Some(level));
        let triangles: Vec<Triangle> = (0..6).flat_map(of_level).copied().collect();
        let got = welded(std::slice::from_ref(region));
        let of_leaves: Vec<_> = triangles.iter().map(|t| t.map(corner)).collect();
        prop_assert_eq!(got.len(), of_leaves.len(), "triangles in {:?}", region.key());
        let other = got.iter().zip(&of_leaves).find(|(got, want)| !same_triangle(got, want));
        prop_assert!(other.is_none(), "in {:?}: {:?}", region.key(), other);
        let of_levels = [0, 1, 2, 3, 4, 5].map(|level| of_level(level).count() as u32);
        prop_assert_eq!(region.level_triangles, of_levels);
        let corners: HashSet<TreeLeaf> = triangles.iter().flatten().copied().collect();
        prop_assert_eq!(
            region.vertices.len(),
            corners.len(),
            "each leaf is one vertex of {:?}",
            region.key()
        );
    }
    prop_assert!(left.values().all(Vec::is_empty));
    Ok(())
}

/// The regions of a surface.
fn parts_of(surface: &Surface) -> Parts {
    surface
        .regions
        .iter()
        .map(|region| (region.key(), region.clone()))
        .collect()
}

/// If only the regions are made in which a surface differs from one that is shown, the result is the same surface, and a surface differs
/// nowhere from itself.
fn check_differences(shown: &Surface, made: &Surface, whole: &Surface) -> Result<(), TestCaseError> {
    let remade = made.remade.as_ref();
    prop_assert!(remade.is_some());
    let replaced = replace(&parts_of(shown), made);
    prop_assert!(
        replaced == parts_of(whole),
        "{} regions were made again",
        remade.map_or(0, Vec::len)
    );
    prop_assert_eq!(made.statistics.triangles, whole.statistics.triangles);
    let is_same = parts_of(shown) == parts_of(whole);
    prop_assert_eq!(
        is_same,
        remade.is_some_and(Vec::is_empty),
        "a region was made again in vain"
    );
    Ok(())
}

/// The twin's weights of the regions.
fn weights_of(planted: &Planted, goal: &TreeGoal) -> Option<Weights> {
    let weights = goal.weights.as_ref()?;
    let regions = planted.pyramid.region_coords();
    Some(Weights {
        of_regions: regions.zip(weights.of_regions.iter().copied()).collect(),
        in_steps: weights.in_steps,
        guard: goal.max_tolerance,
    })
}

/// What no cut changes.
#[derive(Debug, PartialEq)]
struct Invariants {
    euler: i64,
    components: usize,
    /// Loops of edges with a triangle on one side alone.
    borders: usize,
}

/// The smallest of the leaves that are joined, by leaf.
struct Joined(HashMap<TreeLeaf, TreeLeaf>);

impl Joined {
    fn root(&mut self, leaf: TreeLeaf) -> TreeLeaf {
        let above = *self.0.entry(leaf).or_insert(leaf);
        if above == leaf {
            return leaf;
        }
        let root = self.root(above);
        self.0.insert(leaf, root);
        root
    }

    fn join(&mut self, a: TreeLeaf, b: TreeLeaf) {
        let (a, b) = (self.root(a), self.root(b));
        self.0.insert(a.max(b), a.min(b));
    }

    fn count(&self) -> usize {
        self.0.iter().filter(|(leaf, above)| leaf == above).count()
    }
}

/// Invariants of a surface that is closed except for its borders: every edge has one triangle on each side.
fn invariants(triangles: &[Triangle]) -> Result<Invariants, TestCaseError> {
    let mut edges: HashMap<[TreeLeaf; 2], [u32; 2]> = HashMap::default();
    let (mut surface, mut border) = (Joined(HashMap::default()), Joined(HashMap::default()));
    let mut seen = HashSet::default();
    for t in triangles {
        let mut sorted = *t;
        sorted.sort_unstable();
        prop_assert!(seen.insert(sorted), "two triangles {:?}", sorted);
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            surface.join(a, b);
            edges.entry([a.min(b), a.max(b)]).or_default()[usize::from(a > b)] += 1;
        }
    }
    for (&[a, b], uses) in &edges {
        prop_assert!(
            uses[0] <= 1 && uses[1] <= 1,
            "{:?} triangles at the edge {:?}",
            uses,
            [a, b]
        );
        if uses[0] != uses[1] {
            border.join(a, b);
        }
    }
    Ok(Invariants {
        euler: surface.0.len() as i64 - edges.len() as i64 + triangles.len() as i64,
        components: surface.count(),
        borders: border.count(),
    })
}

/// One leaf a point: the full mesh.
fn full_triangles(cutter: &Cutter<'_>) -> Vec<Triangle> {
    let triangles = cutter.mesh.triangles.values().flatten();
    triangles.map(|t| t.map(TreeLeaf::Point)).collect()
}

fn check_cuts(engine: &Engine, planted: &Planted, host: &HostTree, seed: u64) -> Result<(), TestCaseError> {
    let remaining = without(&host.mesh, &host.tree, &parts(&host.mesh), &Filter::default());
    check_cuts_without(engine, planted, host, &remaining, &PartFilter::default(), seed)
}

/// Cuts without the parts that a filter removes, after which `remaining` is left.
pub fn check_cuts_without(
    engine: &Engine,
    planted: &Planted,
    host: &HostTree,
    remaining: &Remaining,
    filter: &PartFilter,
    seed: u64,
) -> Result<(), TestCaseError> {
    let cutter = Cutter {
        mesh: &remaining.mesh,
        tree: &host.tree,
        removed: &remaining.nodes,
        may_vanish: false,
        weights: None,
    };
    let relaxer = Relaxer {
        cutter,
        grid: &planted.loaded.field.grid,
        normals: &host.normals,
    };
    let full_triangles = full_triangles(&cutter);
    let full = invariants(&full_triangles)?;
    // Merges go no further.
    let all = TreeGoal {
        tolerance: f32::INFINITY,
        max_triangles: NO_LIMIT,
        max_tolerance: f32::INFINITY,
        without: filter.clone(),
        may_vanish: false,
        weights: None,
    };
    let of_nodes = host.importances(engine, planted, &cutter, &planted.params)?;
    let floor = cutter.cut(of_nodes.as_ref(), &all);
    let floor = floor.expect("a cut").triangles.values().map(Vec::len).sum::<usize>() as u64;
    let mut shown: Option<TreeSurface> = None;
    let on_device = |(params, goal): (CutParams, TreeGoal)| {
        let whole = cut_beside(engine, planted, &params, &goal, None);
        if let Some(shown) = &shown {
            let made = cut_beside(engine, planted, &params, &goal, shown.regions.as_ref());
            check_differences(&shown.surface, &made.surface, &whole.surface)?;
        }
        let of_nodes = host.importances(engine, planted, &cutter, &params)?;
        let of_device = (whole.surface.clone(), whole.tolerance);
        shown = Some(whole);
        Ok((params, goal, of_device, of_nodes))
    };
    let goals = goals(planted, full_triangles.len() as u64, filter, &mut Random(seed));
    let cuts = goals
        .into_iter()
        .map(on_device)
        .collect::<Result<Vec<_>, TestCaseError>>()?;
    // The twin uses one core a cut.
    cuts.par_iter()
        .try_for_each(|(params, goal, (surface, tolerance), importances)| {
            let check = || {
                let weights = weights_of(planted, goal);
                let cutter = Cutter {
                    may_vanish: goal.may_vanish,
                    weights: weights.as_ref(),
                    ..cutter
                };
                let relaxer = Relaxer { cutter, ..relaxer };
                let want = cutter.cut(importances.as_ref(), goal).expect("a cut");
                prop_assert_eq!(*tolerance, want.tolerance);
                check_surface(&relaxer, surface, &want)?;
                let triangles: Vec<Triangle> = want.triangles.values().flatten().copied().collect();
                let left = invariants(&triangles)?;
                let vanished = cutter.vanished_parts(&want.leaves);
                prop_assert_eq!(surface.statistics.vanished_parts, vanished);
                prop_assert_eq!(left.components + vanished as usize, full.components);
                if vanished == 0 {
                    prop_assert_eq!(&left, &full, "{} marks", want.marks.len());
                }
                prop_assert_eq!(surface.statistics.triangles, triangles.len() as u64);
                if goal.max_triangles >= floor && goal.max_tolerance == f32::INFINITY {
                    prop_assert!(
                        triangles.len() as u64 <= goal.max_triangles,
                        "{} triangles",
                        triangles.len()
                    );
                }
                check_statistics(&cutter, surface, &want, remaining)
            };
            let in_goal = |e| format!("{goal:?}, {:?}, {:?}: {e}", params.transfer, params.interest);
            check().map_err(|e| TestCaseError::fail(in_goal(e)))
        })
}

/// The estimate is the sum over the leaves, and each leaf in use counts once.
fn check_statistics(
    cutter: &Cutter<'_>,
    surface: &Surface,
    want: &TreeCut,
    remaining: &Remaining,
) -> Result<(), TestCaseError> {
    let of_points = want.leaves.iter().zip(&remaining.is_removed);
    let leaves: HashSet<TreeLeaf> = of_points
        .filter(|(_, removed)| !**removed)
        .map(|(leaf, _)| *leaf)
        .collect();
    let mut counts = [0; 6];
    let shown = leaves.iter().filter(|&&leaf| !cutter.is_vanishing(leaf));
    shown
        .into_iter()
        .for_each(|&leaf| counts[usize::from(cutter.level(leaf))] += 1);
    prop_assert_eq!(surface.statistics.leaves, counts);
    let errors = leaves.iter().map(|&leaf| match leaf {
        TreeLeaf::Point(_) => 0.0,
        TreeLeaf::Node(id) => cutter.node(id).error,
    });
    let error2: f64 = errors.clone().map(|e| f64::from(e).powi(2)).sum();
    let area: f64 = total_area(&remaining.mesh);
    let spacing = cutter.mesh.grid.smallest_spacing();
    let rms = f64::from(spacing) * (error2 / area.max(1e-30)).sqrt();
    let estimate = surface.statistics.estimate;
    prop_assert!(
        near(estimate.rms, rms as f32, 1e-3),
        "{:?}, expected rms {}",
        estimate,
        rms
    );
    prop_assert_eq!(estimate.worst_leaf, errors.fold(0.0, f32::max));
    Ok(())
}

#[test]
fn cuts_agree_with_the_twins_and_keep_the_topology() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in recipes(surfaces()), cap in proptest::bool::weighted(0.3), seed in any::<u64>())| {
        let planted = plant(&engine, &recipe, cap);
        let host = HostTree::read(&engine, &planted);
        check_cuts(&engine, &planted, &host, seed)?;
    });
}

/// A volume of more than one block at the last level.
#[test]
fn cuts_of_long_volumes_agree_with_the_twins() {
    let Some(engine) = device() else { return };
    for (dims, seed) in [([14, 11, 300], 3), ([270, 12, 15], 4)] {
        let planted = plant(&engine, &Recipe::plain(dims, Pattern::Waves(10), seed), false);
        let host = HostTree::read(&engine, &planted);
        check(&engine, &host).expect("the twin's nodes");
        check_cuts(&engine, &planted, &host, seed).expect("the twin's cuts");
    }
}

#[test]
fn budgets_are_used_but_for_what_repairs_need() {
    let Some(engine) = device() else { return };
    // Noise, so that hardly two merges have one error.
    let planted = plant(&engine, &Recipe::plain([50, 45, 40], Pattern::Waves(8), 3), false);
    let full = planted.tree.full_triangles();
    let unweighted = CutParams {
        transfer: importances(&[[0.0, 0.0]]),
        ..planted.params.clone()
    };
    for budget in [full - 1, full * 9 / 10, full / 2, full / 2 + 1, full / 4] {
        let goal = TreeGoal {
            tolerance: -1.0,
            max_triangles: budget,
            max_tolerance: f32::INFINITY,
            without: PartFilter::default(),
            may_vanish: false,
            weights: None,
        };
        let (surface, tolerance) = cut(&engine, &planted, &unweighted, &goal);
        let made = surface.statistics.triangles;
        assert!(
            (budget - budget / 64 - 8..=budget).contains(&made),
            "{made} triangles, at most {budget}"
        );
        // The tolerance that comes back makes the same cut.
        let (again, _) = cut(
            &engine,
            &planted,
            &unweighted,
            &TreeGoal {
                tolerance,
                max_triangles: NO_LIMIT,
                ..goal
            },
        );
        assert!(surface.regions == again.regions, "the same bytes");
    }
}

/// What a cut under an impossible budget has is what its refusal names.
#[test]
fn the_minimum_of_triangles_is_a_budget_that_is_kept() {
    let Some(engine) = device() else { return };
    // Of each the repairs on the way to the minimum leave a few triangles more than those at the minimum do.
    for (width, waves, seed) in [(69, 3, 5), (82, 8, 18), (69, 15, 85)] {
        let dims = [width, 70, 66];
        let planted = plant(&engine, &Recipe::plain(dims, Pattern::Waves(waves), seed), false);
        let under = |max_triangles| {
            let goal = TreeGoal {
                tolerance: -1.0,
                max_triangles,
                max_tolerance: f32::INFINITY,
                without: PartFilter::default(),
                may_vanish: false,
                weights: None,
            };
            cut(&engine, &planted, &planted.params, &goal).0.statistics.triangles
        };
        let minimum = under(1);
        for budget in [minimum, minimum + 1, minimum + 4, minimum + 20] {
            let made = under(budget);
            assert!(
                made <= budget,
                "{made} triangles for {budget}, {minimum} can be had ({dims:?}, {seed})"
            );
        }
    }
}

/// The kernels of a GPU on any device: work-groups of many.
#[test]
fn work_groups_of_a_gpu_make_the_same_tree_and_cuts() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    for (pattern, missing) in [(Pattern::Waves(15), false), (Pattern::Blocks, true)] {
        let recipe = Recipe {
            missing,
            ..Recipe::plain([38, 20, 35], pattern, 9)
        };
        let planted = plant(&of_gpu, &recipe, false);
        let host = HostTree::read(&of_gpu, &planted);
        check(&of_gpu, &host).expect("the twin's tree");
        check_cuts(&of_gpu, &planted, &host, 4).expect("the twin's cuts");
    }
}
