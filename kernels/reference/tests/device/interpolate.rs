//! Values of a field at points and at vertices, from fields of every type and from several slabs.

use super::recipes::{Pattern, any_recipe};
use super::*;
use isopeel_kernels::ValuesOf;
use isopeel_reference::interpolate::interpolate;

fn same(a: f32, b: f32) -> bool {
    a == b || (a.is_nan() && b.is_nan())
}

/// A region of vertices without triangles, at random places of the volume and at its samples, and some outside.
fn points(recipe: &Recipe, seed: u64) -> Region {
    let mut random = Random(seed);
    let vertex = |position| Vertex {
        position,
        normal: [0; 2],
        smoothness: 0,
        feature: 0,
    };
    let mut any = |i: usize| {
        let extent = |axis: usize| ((recipe.dims[axis] - 1) as i32 * Vertex::LATTICE) as f32;
        let at = [0, 1, 2].map(|axis| (extent(axis) * (1.1 * random.unit() - 0.05)) as i32);
        vertex(if i.is_multiple_of(3) {
            at.map(|x| x / Vertex::LATTICE * Vertex::LATTICE)
        } else {
            at
        })
    };
    Region {
        vertices: (0..500).map(&mut any).collect::<Vec<_>>().into(),
        ..Region::default()
    }
}

fn check(engine: &Engine, recipe: &Recipe, seed: u64, of: ValuesOf) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let mut regions = [points(recipe, seed), Region::default(), points(recipe, seed + 1)];
    engine
        .vertex_values(&loaded.volume, of, &mut regions, &Never)
        .expect("values");
    for region in &regions {
        prop_assert_eq!(region.values.len(), region.vertices.len());
        for (vertex, &got) in region.vertices.iter().zip(region.values.iter()) {
            let at = vertex
                .position
                .map(|x| x as f32 / Vertex::LATTICE as f32 - of.padding as f32);
            let at = if of.nearest { at.map(f32::round) } else { at };
            let want = interpolate(&loaded.field, at);
            prop_assert!(same(got, want), "{} at {:?}, expected {}", got, at, want);
        }
    }
    Ok(())
}

#[test]
fn values_have_the_twins_bits() {
    let Some(engine) = device() else { return };
    proptest!(config(16), |(recipe in any_recipe(), seed in any::<u32>(), padding in 0u32..2, nearest in any::<bool>())| {
        check(&engine, &recipe, seed.into(), ValuesOf { padding, nearest })?;
    });
}

#[test]
fn values_from_several_slabs_are_those_of_one() {
    let Some(mut engine) = device() else { return };
    let before = testing::limit_allocations(&mut engine, 40 * 40 * 70 * 4);
    let recipe = Recipe::plain([40, 40, 140], Pattern::Waves(5), 3);
    assert!(testing::slab_count(&load(&engine, &recipe).volume) > 1);
    check(&engine, &recipe, 33, ValuesOf::default()).expect("the twin's values");
    testing::limit_allocations(&mut engine, before);
}

/// A linear field has at each vertex of a surface the value that its position says.
#[test]
fn a_linear_field_has_its_own_value_at_each_vertex() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([40, 37, 35], Pattern::Waves(10), 7);
    let loaded = load(&engine, &recipe);
    let pyramid = build(&engine, &loaded, Feature::None);
    let host = HostPyramid::read(&engine, &pyramid);
    let state = host.random_state(5, Topology::Free);
    let mut surface = mesh(&engine, &loaded, &pyramid, &dual_params(), &state);
    let (grid, ..) = recipe.make();
    let [nx, ny, nz] = recipe.dims;
    let at = |x: u32, y: u32, z: u32| 3.0 + 2.0 * x as f32 - y as f32 + 0.5 * z as f32;
    let values = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| at(x, y, z))));
    let linear = isopeel_kernels::Samples::F32(values.collect());
    let linear = load_samples(&engine, grid, &linear, None, 0.0);
    let before = surface.regions.clone();
    engine
        .vertex_values(&linear.volume, ValuesOf::default(), &mut surface.regions, &Never)
        .expect("values");
    assert!(before.iter().map(|region| region.vertices.len()).sum::<usize>() > 1000);
    for (region, before) in surface.regions.iter().zip(&before) {
        assert!(region.vertices[..] == before.vertices[..] && region.indices[..] == before.indices[..]);
        for (vertex, value) in region.vertices.iter().zip(region.values.iter()) {
            let ends = recipe.dims.map(|n| f64::from(n - 1));
            let [x, y, z] = [0, 1, 2].map(|axis| {
                (region.position_of(vertex)[axis] as f64 / f64::from(Vertex::LATTICE)).clamp(0.0, ends[axis])
            });
            let want = 3.0 + 2.0 * x - y + 0.5 * z;
            assert!((f64::from(*value) - want).abs() < 1e-3, "{value}, expected {want}");
        }
    }
}
