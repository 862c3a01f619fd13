//! Values at vertices: those of the data there, whatever the cut.

use super::recipes::{Pattern, Random, recipes, surfaces};
use super::tree::plant;
use super::tree_cut::cut;
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{PartFilter, TreeGoal};
use isopeel_reference::cell_values::{self, CellValues};
use isopeel_reference::cut::normalised_feature;
use isopeel_reference::tree::LATTICE;
use rustc_hash::FxHashMap as HashMap;

/// Lattice units of a vertex in one of the twin.
const STEPS: i64 = Vertex::LATTICE as i64 / LATTICE as i64;

/// Smoothness and feature of vertices by position.
type Found = HashMap<[i64; 3], [u16; 2]>;

/// Compares a surface with the twin, and with what was found in other cuts. Returns the vertices that have no cell around.
fn check_surface(
    cells: &CellValues,
    dims: [u32; 3],
    params: &CutParams,
    surface: &Surface,
    found: &mut Found,
) -> Result<usize, TestCaseError> {
    let mut alone = 0;
    for region in &surface.regions {
        for vertex in region.vertices.iter() {
            let place = absolute(region, vertex);
            let values = cell_values::at(cells, dims, place.map(|x| (x / STEPS) as i32));
            let Some([s, f]) = values else {
                alone += 1;
                continue;
            };
            let got = [vertex.smoothness, vertex.feature];
            for (got, want) in got.into_iter().zip([s, normalised_feature(f, params)]) {
                prop_assert!(
                    (f32::from(got) - want.clamp(0.0, 1.0) * 65535.0).abs() <= 0.51,
                    "at {:?}",
                    place
                );
            }
            prop_assert_eq!(*found.entry(place).or_insert(got), got, "another cut, at {:?}", place);
        }
    }
    Ok(alone)
}

/// Returns how many vertices have no cell around, and how many there are.
fn check(engine: &Engine, recipe: &Recipe, seed: u64) -> Result<[usize; 2], TestCaseError> {
    let planted = plant(engine, recipe, false);
    let host = HostPyramid::read(engine, &planted.pyramid);
    let values = |(leaf, slot): (&Leaf, &usize)| (leaf.cube, [host.nodes[*slot].s, host.nodes[*slot].f]);
    let cells: CellValues = host
        .slots
        .iter()
        .filter(|(leaf, _)| leaf.level == 0)
        .map(values)
        .collect();
    let dims = planted.loaded.field.grid.dims;
    let params = CutParams {
        feature_range: [0.0, 1.5],
        ..planted.params.clone()
    };
    let full = planted.tree.full_triangles();
    let goal = |tolerance, max_triangles| TreeGoal {
        tolerance,
        max_triangles,
        max_tolerance: f32::INFINITY,
        without: PartFilter::default(),
        may_vanish: false,
        weights: None,
    };
    let goals = [
        goal(-1.0, full),
        goal(0.1, full),
        goal(-1.0, full / 2),
        goal(-1.0, full / 8),
        goal(-1.0, 0),
    ];
    let trees = goals.iter().map(|goal| cut(engine, &planted, &params, goal).0);
    let state = host.random_state(seed, Topology::Free);
    let cubes = mesh(engine, &planted.loaded, &planted.pyramid, &params, &state);
    let (mut found, mut alone, mut all) = (Found::default(), 0, 0);
    for surface in trees.chain([cubes]) {
        alone += check_surface(&cells, dims, &params, &surface, &mut found)?;
        all += surface
            .regions
            .iter()
            .map(|region| region.vertices.len())
            .sum::<usize>();
    }
    Ok([alone, all])
}

#[test]
fn values_at_vertices_are_the_datas_in_every_cut() {
    let Some(engine) = device() else { return };
    proptest!(config(6), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        check(&engine, &recipe, seed)?;
    });
}

#[test]
fn few_vertices_of_a_smooth_surface_are_far_from_it() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([40, 37, 41], Pattern::Waves(0), 5);
    let of_gpu = with_gpu_kernels(&engine, None);
    for engine in [&engine, &of_gpu] {
        let [alone, all] = check(engine, &recipe, Random(3).next()).expect("the twin's values");
        assert!(alone * 100 <= all && all > 1000, "{alone} of {all} vertices");
    }
}
