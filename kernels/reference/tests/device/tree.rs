//! The vertex tree, node for node, on the full dual mesh read back from the device.

use isopeel_kernels::{Cancel, DeviceKind, Error, VertexTree};
use isopeel_reference::tree::{self, BlockTree, Node, NodeId, vanishing_level};

use super::host_tree::HostTree;
use super::recipes::{Pattern, recipes, surfaces};
use super::*;
use std::cell::Cell;

/// A volume with its pyramid and the tree of it.
pub struct Planted {
    pub loaded: Loaded,
    pub pyramid: Pyramid,
    pub tree: VertexTree,
    pub params: CutParams,
}

/// Uploads a volume, padded if it is to be capped, and builds its tree.
pub fn plant(engine: &Engine, recipe: &Recipe, cap: bool) -> Planted {
    let (grid, samples, missing, iso) = recipe.make();
    let (grid, samples) = if cap {
        let (samples, dims) = samples.padded(grid.dims, missing);
        (Grid::new(dims, grid.spacing).expect("a valid grid"), samples)
    } else {
        (grid, samples)
    };
    let loaded = load_samples(engine, grid, &samples, missing, iso);
    let feature = Feature::Derived(DerivedFeature::GradientMagnitude);
    plant_in(engine, loaded, feature, CutParams { cap, ..dual_params() })
}

/// Builds the tree of a volume that is there.
pub fn plant_in(engine: &Engine, loaded: Loaded, feature: Feature, params: CutParams) -> Planted {
    let pyramid = build(engine, &loaded, feature);
    let tree = engine
        .build_tree(&loaded.volume, &pyramid, &params, &Never)
        .expect("build the tree");
    Planted {
        loaded,
        pyramid,
        tree,
        params,
    }
}

fn check_node(got: &Node, want: &Node) -> Result<(), TestCaseError> {
    prop_assert_eq!(
        (got.parent, got.removed, got.level, got.on_border),
        (want.parent, want.removed, want.level, want.on_border)
    );
    let steps = (0..3).map(|i| (got.position[i] - want.position[i]).abs()).max();
    prop_assert!(steps <= Some(1), "{:?}, expected {:?}", got, want);
    prop_assert!(near(got.error, want.error, 1e-4), "{:?}, expected {:?}", got, want);
    prop_assert!(
        near(got.s, want.s.clamp(0.0, 1.0), 1e-4),
        "{:?}, expected {:?}",
        got,
        want
    );
    prop_assert!(near(got.f, want.f, 1e-4), "{:?}, expected {:?}", got, want);
    // A code has seven bits of a mantissa; rounding may decide for the next one.
    let ratio = got.max_move / want.max_move;
    prop_assert!((0.99..1.01).contains(&ratio), "{:?}, expected {:?}", got, want);
    Ok(())
}

fn check_block(got: &BlockTree, want: &BlockTree) -> Result<(), TestCaseError> {
    prop_assert_eq!(got.nodes.len(), want.nodes.len());
    for (i, (got, want)) in got.nodes.iter().zip(&want.nodes).enumerate() {
        check_node(got, want).map_err(|e| TestCaseError::fail(format!("node {i}: {e}")))?;
    }
    prop_assert_eq!(&got.round_ends, &want.round_ends);
    prop_assert!(
        near(got.area, want.area, 1e-4),
        "area {}, expected {}",
        got.area,
        want.area
    );
    Ok(())
}

/// Another compiler rounds sums in its own way, and one other merge changes those after it: of the tree as a whole there is as much.
fn check_loosely(got: &tree::Tree, want: &tree::Tree) -> Result<(), TestCaseError> {
    for (id, want) in &want.blocks {
        let got = &got.blocks[id];
        let [a, b] = [got, want].map(|block| block.nodes.len());
        prop_assert!(a.abs_diff(b) <= 5 + b / 20, "{:?}: {} nodes, expected {}", id, a, b);
        prop_assert!(
            near(got.area, want.area, 1e-3),
            "area {}, expected {}",
            got.area,
            want.area
        );
    }
    Ok(())
}

/// Compares the nodes that triangles collapse with with the twin's, of the same tree.
fn check_collapses(host: &HostTree) -> Result<(), TestCaseError> {
    for (region, triangles) in &host.mesh.triangles {
        for (triangle, &got) in triangles.iter().zip(&host.collapsed_by[region]) {
            prop_assert_eq!(got, host.tree.collapsed_by(*triangle));
        }
    }
    Ok(())
}

/// Compares a tree with the twin's of the same mesh.
pub fn check(engine: &Engine, host: &HostTree) -> Result<(), TestCaseError> {
    check_collapses(host)?;
    let want = tree::build(&host.mesh);
    let device = engine.device();
    if device.kind != DeviceKind::Cpu || device.is_intel_runtime() {
        return check_loosely(&host.tree, &want);
    }
    for (id, want) in &want.blocks {
        let in_block = |e| TestCaseError::fail(format!("{id:?}: {e}"));
        check_block(&host.tree.blocks[id], want).map_err(in_block)?;
    }
    prop_assert!(host.tree.point_parents == want.point_parents, "parents of points");
    Ok(())
}

#[test]
fn nodes_agree_with_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(16), |(recipe in recipes(surfaces()), cap in proptest::bool::weighted(0.3))| {
        let planted = plant(&engine, &recipe, cap);
        check(&engine, &HostTree::read(&engine, &planted))?;
    });
}

#[test]
fn a_tree_is_a_forest_in_order_of_rounds() {
    let Some(engine) = device() else { return };
    let planted = plant(&engine, &Recipe::plain([65, 40, 35], Pattern::Waves(15), 5), false);
    let host = HostTree::read(&engine, &planted);
    let mut children: HashMap<NodeId, u32> = HashMap::default();
    for parent in host.tree.point_parents.iter().flatten() {
        *children.entry(*parent).or_default() += 1;
    }
    for (&id, block) in &host.tree.blocks {
        for (index, node) in block.nodes.iter().enumerate() {
            let round = |node: usize| block.round_ends.partition_point(|&end| end <= node);
            if let Some(parent) = node.parent {
                let is_later = parent.block.level > id.level || round(parent.index) > round(index);
                assert!(is_later, "a parent of a later round");
                *children.entry(parent).or_default() += 1;
            }
            if id.level < vanishing_level(&host.mesh.grid) {
                assert_eq!(children[&NodeId { block: id, index }], 2, "each node merges two");
            }
        }
    }
    let (points, merged) = (host.mesh.points.len(), children.len());
    assert!(merged > points * 3 / 4, "{merged} merges of {points} points");
}

/// Worst cosine between the normals of two triangles at an edge of the node `made`, of the mesh between the corners that `leaf` maps to.
/// Slivers, which the rounding of positions turns, are left out.
fn worst_fold(triangles: &[[[f64; 4]; 3]], made: f64) -> f64 {
    let mut normals: HashMap<[u64; 2], Vec<[f64; 3]>> = HashMap::default();
    for corners in triangles.iter().filter(|t| t.iter().any(|c| c[3] == made)) {
        let [u, v] = [1, 2].map(|k| [0, 1, 2].map(|i| corners[k][i] - corners[0][i]));
        let normal = [0, 1, 2].map(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]);
        for other in corners.iter().filter(|c| c[3] != made) {
            normals
                .entry([made.to_bits(), other[3].to_bits()])
                .or_default()
                .push(normal);
        }
    }
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
    let pairs = normals.values().filter(|at| at.len() == 2).map(|at| (at[0], at[1]));
    let areas = pairs.map(|(a, b)| (dot(a, b), dot(a, a).sqrt(), dot(b, b).sqrt()));
    areas
        .filter(|&(_, a, b)| a.min(b) > 0.02)
        .map(|(product, a, b)| product / (a * b))
        .fold(1.0, f64::min)
}

#[test]
fn merges_hardly_ever_fold_the_surface() {
    let Some(engine) = device() else { return };
    // Two regions: the last level's merges may fold it.
    let planted = plant(&engine, &Recipe::plain([45, 30, 29], Pattern::Waves(60), 5), false);
    let host = HostTree::read(&engine, &planted);
    let (&id, block) = host.tree.blocks.first_key_value().expect("a region");
    assert_eq!(id.level, 0);
    let cells = |p: [i32; 3]| p.map(|x| f64::from(x) / f64::from(tree::LATTICE));
    let (mut merges, mut folds) = (0, 0);
    for (round, &end) in block.round_ends.iter().enumerate() {
        let begin = round.checked_sub(1).map_or(0, |before| block.round_ends[before]);
        // A corner's position, and its number behind those of nodes.
        let leaf = |point: usize| {
            let above = host.tree.above(point).take_while(|node| node.block == id);
            let (at, number) = match above.take_while(|node| node.index < end).last() {
                Some(node) => (block.nodes[node.index].position, node.index),
                None => (host.mesh.points[point].position, block.nodes.len() + point),
            };
            let [x, y, z] = cells(at);
            [x, y, z, number as f64]
        };
        let triangles: Vec<[[f64; 4]; 3]> = host.mesh.triangles[&id.coords]
            .iter()
            .map(|corners| corners.map(leaf))
            .filter(|c| c[0][3] != c[1][3] && c[1][3] != c[2][3] && c[2][3] != c[0][3])
            .collect();
        for node in begin..end {
            let worst = worst_fold(&triangles, node as f64);
            folds += usize::from(worst < -0.85);
            merges += 1;
        }
    }
    assert!(
        merges > 1000 && folds * 100 < merges,
        "{folds} of {merges} merges fold the surface"
    );
}

/// Runs other work on the device in each pause, as jobs do for which a long one pauses.
pub struct Others<'a> {
    pub polls: Cell<usize>,
    /// Gives up at this poll.
    pub given_up_at: usize,
    pub work: &'a dyn Fn(),
}

impl Cancel for Others<'_> {
    fn is_cancelled(&self) -> bool {
        self.polls.get() == self.given_up_at
    }

    fn pause(&self) {
        (self.work)();
        self.polls.set(self.polls.get() + 1);
    }
}

/// A surface that takes several launches on a CPU of a few cores.
fn several_batches() -> Recipe {
    Recipe::plain([130, 97, 97], Pattern::Waves(15), 5)
}

#[test]
fn a_tree_is_the_same_where_others_use_the_device_meanwhile() {
    let Some(engine) = device() else { return };
    let mut planted = plant(&engine, &several_batches(), false);
    let alone = HostTree::read(&engine, &planted);
    let other = plant(&engine, &Recipe::plain([40, 30, 35], Pattern::Waves(5), 9), true);
    let others = Others {
        polls: Cell::new(0),
        given_up_at: usize::MAX,
        work: &|| {
            let loaded = &other.loaded;
            let pyramid = build(&engine, loaded, Feature::None);
            engine
                .build_tree(&loaded.volume, &pyramid, &other.params, &Never)
                .expect("build another tree");
            engine
                .peel(&loaded.volume, &pyramid, &other.params, Level::FINEST, &Never)
                .expect("another surface");
        },
    };
    planted.tree = engine
        .build_tree(&planted.loaded.volume, &planted.pyramid, &planted.params, &others)
        .expect("build the tree");
    // Launches of a GPU are larger.
    assert!(others.polls.get() >= 4, "{} polls", others.polls.get());
    let shared = HostTree::read(&engine, &planted);
    assert!(shared.tree == alone.tree, "another tree");
}

#[test]
fn a_tree_that_is_given_up_half_way_leaves_no_memory() {
    let Some(engine) = device() else { return };
    let planted = plant(&engine, &several_batches(), false);
    let in_use = || engine.memory().expect("the device's memory").in_use;
    let before = in_use();
    let mut given_up_at = 1;
    loop {
        let others = Others {
            polls: Cell::new(0),
            given_up_at,
            work: &|| {},
        };
        match engine.build_tree(&planted.loaded.volume, &planted.pyramid, &planted.params, &others) {
            Err(Error::Cancelled) => assert_eq!(in_use(), before, "given up at poll {given_up_at}"),
            built => {
                assert!(built.is_ok());
                assert!(in_use() > before);
                break;
            }
        }
        // Each of the first ones, and some of many.
        given_up_at += 1 + given_up_at / 6;
    }
    assert!(given_up_at > 4, "{given_up_at} polls");
    assert_eq!(in_use(), before);
}
