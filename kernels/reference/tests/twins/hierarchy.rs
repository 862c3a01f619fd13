//! The levels of the vertex tree: how far it merges, and that its cuts keep the topology.

use rustc_hash::FxHashMap as HashMap;
use std::collections::{BTreeMap, BTreeSet};

use isopeel_kernels::{CutParams, Grid, PartFilter, TreeGoal};
use isopeel_reference::tree::{
    self, BlockId, BlockTree, FullMesh, LATTICE, NodeId, Tree, decode_max_move, last_level, vanishing_level,
};
use isopeel_reference::tree_cut::{Cutter, TreeCut, TreeLeaf};

use super::surface_nets::{surface_nets, surface_nets_of};

fn distance(p: [f32; 3], centre: [f32; 3]) -> f32 {
    (0..3).map(|i| (p[i] - centre[i]).powi(2)).sum::<f32>().sqrt()
}

/// A sphere in 2 x 2 x 2 regions.
fn sphere() -> FullMesh {
    surface_nets(64, [1.0; 3], |p| 26.3 - distance(p, [31.7, 32.4, 32.1]))
}

/// A sphere that leaves the volume at one face.
fn bowl() -> FullMesh {
    surface_nets(64, [1.0, 0.8, 1.3], |p| 26.3 - distance(p, [31.7, 32.4, 10.3]))
}

/// A surface with handles in 4 x 4 x 4 regions, and two parts.
fn handles() -> FullMesh {
    surface_nets(100, [1.0; 3], |p| {
        let [x, y, z] = p.map(|x| x * 0.15);
        let waves = x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos() + 0.3;
        let outside = (distance(p, [50.0; 3]) / 40.0).powi(8);
        (waves - outside).max(8.2 - distance(p, [9.3, 9.1, 9.6]))
    })
}

/// Centre and radius of small spheres: some are in one region, others in two or four.
const SMALL_SPHERES: [([f32; 3], f32); 5] = [
    ([50.3, 50.2, 49.8], 6.3),
    ([32.2, 51.1, 52.3], 4.1),
    ([52.1, 12.3, 31.8], 5.2),
    ([12.2, 50.9, 12.4], 2.6),
    ([50.2, 31.7, 10.1], 3.3),
];

/// A large sphere and small ones in 2 x 2 x 2 regions.
fn spheres() -> FullMesh {
    surface_nets(64, [1.0, 0.9, 1.2], |p| {
        let large = 18.2 - distance(p, [22.3, 23.1, 22.7]);
        let small = SMALL_SPHERES.map(|(centre, radius)| radius - distance(p, centre));
        small.into_iter().fold(large, f32::max)
    })
}

/// Cuts to a tolerance and a budget. No part vanishes.
fn cut(mesh: &FullMesh, tree: &Tree, tolerance: f32, max_triangles: u64) -> TreeCut {
    let removed = BTreeSet::new();
    cut_with(&cutter(mesh, tree, &removed), tolerance, max_triangles)
}

/// A cutter that keeps all parts.
fn cutter<'a>(mesh: &'a FullMesh, tree: &'a Tree, removed: &'a BTreeSet<NodeId>) -> Cutter<'a> {
    Cutter {
        mesh,
        tree,
        removed,
        may_vanish: false,
        weights: None,
    }
}

fn cut_with(cutter: &Cutter<'_>, tolerance: f32, max_triangles: u64) -> TreeCut {
    let goal = TreeGoal {
        tolerance,
        max_triangles,
        max_tolerance: f32::INFINITY,
        without: PartFilter::default(),
        may_vanish: false,
        weights: None,
    };
    cutter.cut(None, &goal).expect("a cut")
}

/// Euler characteristic, parts and edges of the border. Each directed edge occurs once.
fn topology(triangles: &[[TreeLeaf; 3]]) -> (i64, usize, bool) {
    let mut above: HashMap<TreeLeaf, TreeLeaf> = HashMap::default();
    fn root(above: &HashMap<TreeLeaf, TreeLeaf>, mut leaf: TreeLeaf) -> TreeLeaf {
        while above[&leaf] != leaf {
            leaf = above[&leaf];
        }
        leaf
    }
    let mut edges: BTreeMap<[TreeLeaf; 2], i64> = BTreeMap::new();
    let mut directed = BTreeSet::new();
    for t in triangles {
        for i in 0..3 {
            let [a, b] = [t[i], t[(i + 1) % 3]];
            assert!(directed.insert([a, b]), "a directed edge twice");
            *edges.entry([a.min(b), a.max(b)]).or_default() += 1;
            for leaf in [a, b] {
                above.entry(leaf).or_insert(leaf);
            }
            let (a, b) = (root(&above, a), root(&above, b));
            above.insert(a.max(b), a.min(b));
        }
    }
    let parts = above.iter().filter(|(leaf, above)| leaf == above).count();
    let euler = above.len() as i64 - edges.len() as i64 + triangles.len() as i64;
    (euler, parts, edges.values().all(|&n| n == 2))
}

fn full_topology(mesh: &FullMesh) -> (i64, usize, bool) {
    let triangles = mesh.triangles.values().flatten();
    topology(&triangles.map(|t| t.map(TreeLeaf::Point)).collect::<Vec<_>>())
}

/// Cuts keep the topology. Returns the number of triangles of the coarsest cut.
fn check_cuts(mesh: &FullMesh, tree: &Tree) -> usize {
    let want = full_topology(mesh);
    let full = mesh.triangles.values().map(Vec::len).sum::<usize>() as u64;
    let tolerances = [0.01, 0.1, 0.5, 2.0, 20.0, f32::INFINITY].map(|tolerance| (tolerance, u64::MAX));
    let budgets = [full / 3, full / 10, full / 50].map(|budget| (-1.0, budget));
    let mut left = 0;
    for (tolerance, budget) in budgets.into_iter().chain(tolerances) {
        let cut = cut(mesh, tree, tolerance, budget);
        let triangles: Vec<_> = cut.triangles.values().flatten().copied().collect();
        assert_eq!(topology(&triangles), want, "cut to {tolerance} and {budget}");
        assert!(
            triangles.len() as u64 <= budget,
            "{} of {budget} triangles",
            triangles.len()
        );
        left = triangles.len();
    }
    left
}

/// The order of nodes, their positions, and what they are above.
fn check_forest(mesh: &FullMesh, tree: &Tree) {
    let mut children: BTreeMap<_, u32> = BTreeMap::new();
    let parents = tree.point_parents.iter().copied();
    let nodes = tree.blocks.iter().flat_map(|(&block, of_block)| {
        assert_eq!(of_block.round_ends.last().copied().unwrap_or(0), of_block.nodes.len());
        let ids = (0..of_block.nodes.len()).map(move |index| NodeId { block, index });
        ids.map(|id| (id, tree.node(id)))
    });
    for (id, node) in nodes.clone() {
        if let Some(parent) = node.parent {
            assert!(parent > id, "a parent comes after its children");
        }
        let (low, extent) = (id.block.low_corner(), id.block.extent());
        for (x, low) in node.position.into_iter().zip(low) {
            assert!((low..=low + extent).contains(&x), "{node:?} in {:?}", id.block);
            assert_eq!(
                (x - low) % (1 << id.block.level),
                0,
                "a position on the level's lattice"
            );
        }
        assert!(node.level <= 5 && node.max_move >= decode_max_move(0));
    }
    for parent in parents.chain(nodes.map(|(_, node)| node.parent)).flatten() {
        *children.entry(parent).or_default() += 1;
    }
    let merges_two = |(id, &n): (&NodeId, &u32)| n == 2 || id.block.level == vanishing_level(&mesh.grid);
    assert!(children.iter().all(merges_two), "each node merges two");
    for (point, at) in mesh.points.iter().enumerate() {
        for node in tree.above(point) {
            assert_eq!(node.block, BlockId::of_region(node.block.level, at.region));
        }
    }
}

#[test]
fn the_last_level_is_the_lowest_with_one_block_or_the_third() {
    let last = |dims| last_level(&Grid::new(dims, [1.0; 3]).expect("a grid"));
    assert_eq!(last([33, 20, 33]), 0);
    assert_eq!(last([34, 20, 33]), 1);
    assert_eq!(last([20, 65, 33]), 1);
    assert_eq!(last([20, 66, 33]), 2);
    assert_eq!(last([20, 66, 32 * 8 + 1]), 3);
    assert_eq!(last([20, 66, 32 * 9 + 1]), 3);
}

#[test]
fn a_sphere_of_several_regions_merges_to_a_tetrahedron() {
    let mesh = sphere();
    assert_eq!(full_topology(&mesh), (2, 1, true));
    let tree = tree::build(&mesh);
    check_forest(&mesh, &tree);
    assert_eq!(tree.blocks.keys().map(|block| block.level).max(), Some(1));
    assert_eq!(check_cuts(&mesh, &tree), 4);
}

/// The only level is the last one.
#[test]
fn a_sphere_of_one_region_merges_to_a_tetrahedron() {
    let mesh = surface_nets(32, [0.5, 1.0, 1.0], |p| 12.1 - distance(p, [15.2, 16.3, 14.6]));
    let tree = tree::build(&mesh);
    check_forest(&mesh, &tree);
    assert_eq!(tree.blocks.len(), 1);
    assert_eq!(check_cuts(&mesh, &tree), 4);
}

#[test]
fn blocks_below_the_last_level_rest() {
    let mesh = sphere();
    let tree = tree::build(&mesh);
    let mut of_blocks: BTreeMap<[u32; 3], usize> = BTreeMap::new();
    mesh.points
        .iter()
        .for_each(|point| *of_blocks.entry(point.region).or_default() += 1);
    for (id, block) in tree.blocks.iter().filter(|(id, _)| id.level == 0) {
        let points = of_blocks[&id.coords];
        let rounds = block.round_ends.len();
        let alive = |round: usize| points - block.round_ends[round];
        assert!(
            rounds > 2 && alive(rounds - 2) * 4 > points,
            "a block rests as soon as it may"
        );
        assert!(
            alive(rounds - 1) * 4 <= points,
            "{} of {points} points",
            alive(rounds - 1)
        );
    }
}

#[test]
fn a_border_goes_on_above_regions() {
    let mesh = bowl();
    let want = full_topology(&mesh);
    assert_eq!(want, (1, 1, false));
    let tree = tree::build(&mesh);
    check_forest(&mesh, &tree);
    let left = check_cuts(&mesh, &tree);
    assert!(left <= 6, "{left} triangles");
    let on_face = |node: &&tree::Node| node.on_border;
    let nodes = tree.blocks.values().flat_map(|block| &block.nodes);
    assert!(nodes.clone().filter(on_face).all(|node| node.position[2] == 0));
    assert!(nodes.filter(on_face).count() > 50);
}

#[test]
fn handles_stay_at_all_levels() {
    let mesh = handles();
    let want = full_topology(&mesh);
    assert!(want.0 < 0 && want.1 > 1 && want.2, "{want:?}");
    let tree = tree::build(&mesh);
    check_forest(&mesh, &tree);
    // The small part may vanish.
    assert_eq!(tree.blocks.keys().map(|block| block.level).max(), Some(3));
    let full: usize = mesh.triangles.values().map(Vec::len).sum();
    let left = check_cuts(&mesh, &tree);
    assert!(left * 50 < full, "{left} of {full} triangles");
}

/// The block of the vanishing nodes.
fn vanishing_block<'a>(mesh: &FullMesh, tree: &'a Tree) -> (BlockId, &'a BlockTree) {
    let id = BlockId {
        level: vanishing_level(&mesh.grid),
        coords: [0; 3],
    };
    (id, &tree.blocks[&id])
}

/// The small sphere that a position in cells is next to.
fn small_sphere_at(mesh: &FullMesh, position: [i32; 3]) -> Option<usize> {
    let at = position.map(|x| x as f32 / LATTICE as f32);
    assert_eq!(mesh.grid.dims, [65; 3]);
    SMALL_SPHERES
        .iter()
        .position(|&(centre, radius)| distance(at, centre) < radius + 1.5)
}

fn remaining(cut: &TreeCut) -> Vec<[TreeLeaf; 3]> {
    cut.triangles.values().flatten().copied().collect()
}

#[test]
fn small_parts_become_chains_of_one_error() {
    let mesh = spheres();
    assert_eq!(full_topology(&mesh), (12, 6, true));
    let tree = tree::build(&mesh);
    check_forest(&mesh, &tree);
    let (id, block) = vanishing_block(&mesh, &tree);
    assert_eq!((id.level, block.area), (2, 0.0));
    // A tetrahedron remains of each part.
    assert_eq!(block.round_ends, [5, 10]);
    let mut points: [usize; 5] = [0; 5];
    for (at, point) in mesh.points.iter().enumerate() {
        let chain: Vec<NodeId> = tree.above(at).filter(|node| node.block == id).collect();
        let Some(sphere) = small_sphere_at(&mesh, point.position) else {
            assert_eq!(chain, [], "a node above the large sphere");
            continue;
        };
        points[sphere] += 1;
        let top = *chain.last().expect("a node above a small sphere");
        assert!(top.index >= 5, "{top:?}");
        for node in chain {
            assert_eq!(node.index % 5, top.index % 5, "a chain of another part");
            let (node, top) = (tree.node(node), tree.node(top));
            assert_eq!((node.error, node.position, node.level), (top.error, top.position, 5));
            assert_eq!(small_sphere_at(&mesh, node.position), Some(sphere));
        }
    }
    assert!(points.iter().all(|&n| n > 50), "{points:?}");
    let removed: Vec<u32> = block.nodes.iter().map(|node| node.removed).collect();
    assert_eq!(removed, [2; 10]);
    // A larger sphere has a greater error. If all points were at the radius r, it would be 3 r √(4 π r²), but merged ones are farther out.
    let mut of_radius: Vec<(f32, f32)> = (block.nodes[..5].iter())
        .map(|node| {
            (
                SMALL_SPHERES[small_sphere_at(&mesh, node.position).expect("a sphere")].1,
                node.error,
            )
        })
        .collect();
    of_radius.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(of_radius.is_sorted_by(|a, b| a.1 < b.1), "{of_radius:?}");
    for (radius, error) in of_radius {
        let want = 3.0 * radius * radius * (4.0 * std::f32::consts::PI).sqrt();
        assert!((1.0..2.0).contains(&(error / want)), "{error} of radius {radius}");
    }
}

#[test]
fn small_parts_vanish_below_four_triangles_a_part() {
    let mesh = spheres();
    let tree = tree::build(&mesh);
    let removed = BTreeSet::new();
    let cutter = Cutter {
        may_vanish: true,
        ..cutter(&mesh, &tree, &removed)
    };
    // The number of triangles to which the large part merges.
    let floor = remaining(&cut_with(&cutter, -1.0, 0)).len() as u64;
    assert!(floor <= 8, "{floor} triangles");
    let mut vanished = 0;
    for budget in (floor..floor + 5 * 4).rev() {
        let cut = cut_with(&cutter, -1.0, budget);
        let triangles = remaining(&cut);
        assert!(triangles.len() as u64 <= budget, "{} of {budget}", triangles.len());
        let parts = 6 - cutter.vanished_parts(&cut.leaves) as usize;
        assert_eq!(topology(&triangles), (2 * parts as i64, parts, true));
        assert!(6 - parts >= vanished, "a part comes back at a smaller budget");
        vanished = 6 - parts;
        let is_of_large = |corner: &TreeLeaf| small_sphere_at(&mesh, cutter.position(*corner)).is_none();
        let large = triangles.iter().filter(|t| t.iter().all(is_of_large));
        assert!(large.count() >= 4, "the large part stays");
        for &leaf in &cut.leaves {
            if let (TreeLeaf::Node(id), true) = (leaf, cutter.is_vanishing(leaf)) {
                assert_eq!(tree.node(id).parent, None, "a part vanishes as a whole");
            }
        }
    }
    assert_eq!(vanished, 5);
}

/// The sums of removed triangles give the number of triangles at every tolerance, also at those at which parts vanish.
#[test]
fn removed_triangles_of_vanishing_nodes_are_exact() {
    let mesh = spheres();
    let tree = tree::build(&mesh);
    let removed = BTreeSet::new();
    for may_vanish in [false, true] {
        let cutter = Cutter {
            may_vanish,
            ..cutter(&mesh, &tree, &removed)
        };
        let keys = cutter.keys(None, &cutter.first_marks());
        let mut tolerances: Vec<f32> = keys.values().flatten().copied().collect();
        tolerances.sort_by(f32::total_cmp);
        tolerances.dedup();
        tolerances.retain(|key| key.is_finite());
        // The largest tolerances, at which parts vanish, and some others.
        let largest = tolerances.iter().rev().take(30);
        for &tolerance in largest.chain(tolerances.iter().step_by(200)).chain(&[f32::MAX]) {
            let leaves = cutter.leaves(&keys, tolerance);
            let left: usize = cutter.triangles(&leaves).values().map(Vec::len).sum();
            assert_eq!(cutter.triangles_at(&keys, tolerance), left as u64, "at {tolerance}");
        }
        let vanished = cutter.vanished_parts(&cutter.leaves(&keys, f32::MAX));
        assert_eq!(vanished, if may_vanish { 5 } else { 0 });
    }
}

#[test]
fn all_parts_stay_unless_they_may_vanish() {
    let mesh = spheres();
    let tree = tree::build(&mesh);
    let left = check_cuts(&mesh, &tree);
    assert!((24..=28).contains(&left), "{left} triangles of 6 parts");
    let (id, block) = vanishing_block(&mesh, &tree);
    let smallest = cut(&mesh, &tree, f32::INFINITY, 0);
    for index in 0..block.nodes.len() {
        assert!(smallest.marks.contains(&NodeId { block: id, index }));
    }
}

/// One point of importance keeps its whole part.
#[test]
fn nodes_of_a_vanishing_part_have_one_importance() {
    let mut mesh = spheres();
    for (at, point) in mesh.points.iter_mut().enumerate() {
        point.s = (at * 37 % 101) as f32 / 200.0;
    }
    let important = (0..mesh.points.len())
        .rfind(|&at| small_sphere_at(&mesh, mesh.points[at].position) == Some(0))
        .expect("a point of the first small sphere");
    mesh.points[important].s = 1.0;
    let tree = tree::build(&mesh);
    let removed = BTreeSet::new();
    let cutter = Cutter {
        may_vanish: true,
        ..cutter(&mesh, &tree, &removed)
    };
    let importances = cutter.importances(&CutParams::paper(0.0));
    let (id, block) = vanishing_block(&mesh, &tree);
    let mut of_parts = [0.0_f32; 5];
    for point in &mesh.points {
        if let Some(sphere) = small_sphere_at(&mesh, point.position) {
            of_parts[sphere] = of_parts[sphere].max(point.s);
        }
    }
    assert_eq!(of_parts[0], 1.0);
    let keys = cutter.keys(Some(&importances), &BTreeSet::new());
    for (index, node) in block.nodes.iter().enumerate() {
        let sphere = small_sphere_at(&mesh, node.position).expect("a small sphere");
        assert_eq!(importances[&id][index], of_parts[sphere]);
        assert_eq!(keys[&id][index], keys[&id][index % 5], "one key a part");
    }
}

/// The only part of a surface stays.
#[test]
fn the_only_part_never_vanishes() {
    let alone = sphere();
    assert!(
        tree::build(&alone)
            .blocks
            .keys()
            .all(|id| id.level <= last_level(&alone.grid))
    );
}

/// A ring is seven points and fourteen triangles or more: more than two a merge.
#[test]
fn a_part_with_a_handle_vanishes_with_all_its_triangles() {
    let ring = surface_nets(64, [1.0; 3], |p| {
        let [x, y, z] = [p[0] - 50.3, p[1] - 50.1, p[2] - 49.7];
        let ring = 3.1 - (x.hypot(y) - 7.2).hypot(z);
        ring.max(18.2 - distance(p, [22.3, 23.1, 22.7]))
    });
    assert_eq!(full_topology(&ring), (2, 2, true));
    let tree = tree::build(&ring);
    let (id, block) = vanishing_block(&ring, &tree);
    let removed: u32 = block.nodes.iter().map(|node| node.removed).sum();
    assert!(removed >= 14 && block.nodes.len() >= 7, "{:?}", block.nodes);
    assert_eq!(vanished(&ring, &tree), 1, "of {id:?}");
}

/// A part that a face of the volume cuts off ends as a few triangles with a border, of any number.
#[test]
fn a_part_with_a_border_vanishes() {
    for radius in [2.2, 3.1, 4.3, 6.2] {
        let mesh = surface_nets(64, [1.0; 3], |p| {
            (18.2 - distance(p, [22.3, 23.1, 22.7])).max(radius - distance(p, [50.3, 50.2, 0.3]))
        });
        assert_eq!(vanished(&mesh, &tree::build(&mesh)), 1, "radius {radius}");
    }
}

/// Parts of two blocks of the last level, and one in both of them.
#[test]
fn parts_vanish_in_all_blocks_of_the_last_level() {
    let mesh = surface_nets_of([19, 18, 300], [1.0; 3], |p| {
        let small = [[8.1, 9.3, 20.2], [9.2, 8.3, 256.1], [8.4, 8.2, 290.3]];
        let large = 7.2 - (p[0] - 9.3).hypot(p[1] - 9.1).max((p[2] - 150.2).abs() - 80.0);
        small.iter().fold(large, |s, &centre| s.max(4.3 - distance(p, centre)))
    });
    assert_eq!(vanished(&mesh, &tree::build(&mesh)), 3);
}

/// How many parts vanish in the coarsest cut. Also checks that as many triangles are left as the tree says.
fn vanished(mesh: &FullMesh, tree: &Tree) -> u64 {
    let nothing = BTreeSet::new();
    let cutter = Cutter {
        may_vanish: true,
        ..cutter(mesh, tree, &nothing)
    };
    let cut = cut_with(&cutter, f32::INFINITY, 0);
    let keys = cutter.keys(None, &cut.marks);
    let left = cut.triangles.values().map(Vec::len).sum::<usize>() as u64;
    assert_eq!(cutter.triangles_at(&keys, f32::MAX), left);
    cutter.vanished_parts(&cut.leaves)
}

#[test]
fn points_and_corners_have_lattice_steps() {
    assert_eq!(BlockId::of_region(1, [2, 3, 5]).coords, [1, 1, 2]);
    assert_eq!(
        BlockId::of_region(1, [2, 3, 5]).low_corner(),
        [64, 64, 128].map(|c| c * LATTICE)
    );
    assert_eq!(decode_max_move(0), 0.04);
    // 16 exponents of 32 codes each: the largest is just below 0.04 * 2^16.
    assert!(
        (2500.0..2621.0).contains(&decode_max_move(511)),
        "{}",
        decode_max_move(511)
    );
}
