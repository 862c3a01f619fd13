//! What building the vertex tree costs: `sin` or `ml` closed, 256³ by default, isovalue 0.5. `cargo run --release --package
//! isopeel-kernels --example tree_cost [ROUNDS [SHAPE [SIZE [MESH]]]]`. Prints the shortest wall, processor and device time of all
//! rounds, and cuts of the tree: device time, how far they are from the full surface, and a hash, by which two versions are compared.
//! Writes the full mesh to MESH for `simplify_peer`, which times meshoptimizer.

mod common;

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::Instant;

use common::processor_time;
use isopeel_kernels::{
    CutParams, Engine, Feature, Grid, Isovalue, Mesher, Never, PartFilter, Pyramid, Result, SampleType, Shape, Surface,
    Synthetic, TreeGoal, Vertex, VertexTree, Volume,
};

struct Tree<'a> {
    engine: &'a Engine,
    volume: &'a Volume,
    pyramid: &'a Pyramid,
    params: CutParams,
    tree: VertexTree,
}

fn goal(max_triangles: u64) -> TreeGoal {
    TreeGoal {
        tolerance: -1.0,
        max_triangles,
        max_tolerance: f32::INFINITY,
        without: PartFilter::default(),
        may_vanish: false,
        weights: None,
    }
}

impl Tree<'_> {
    fn surface(&self, max_triangles: u64) -> Result<Surface> {
        let (engine, volume, pyramid) = (self.engine, self.volume, self.pyramid);
        let (tree, goal) = (&self.tree, goal(max_triangles));
        Ok(engine
            .tree_surface(volume, pyramid, tree, &self.params, &goal, None, &Never)?
            .surface)
    }

    /// Prints how many triangles cuts have, their distance from the full surface and their hash.
    fn print_cuts(&self) -> Result<()> {
        let full = self.tree.full_triangles();
        for share in [0.5, 0.25, 0.15, 0.08, 0.0] {
            let triangles = (full as f64 * share) as u64;
            let (engine, volume, pyramid) = (self.engine, self.volume, self.pyramid);
            let measured =
                engine.measure_tree_error(volume, pyramid, &self.tree, &self.params, &goal(triangles), &Never)?;
            // The second time buffers are there.
            self.surface(triangles)?;
            let surface = self.surface(triangles)?;
            let milliseconds: f64 = surface.statistics.stages.iter().map(|stage| stage.milliseconds).sum();
            let mut hasher = DefaultHasher::new();
            for region in &surface.regions {
                region.vertices.hash(&mut hasher);
                region.indices.hash(&mut hasher);
            }
            let error = measured.whole;
            println!(
                "{share:4} {:9} triangles, {milliseconds:.1} ms, rms {:.4}, max {:.3}, {:016x}",
                surface.statistics.triangles,
                error.rms,
                error.max,
                hasher.finish()
            );
        }
        Ok(())
    }

    /// Writes the full mesh: the number of vertices and of triangles, positions and normals, indices.
    fn write_mesh(&self, path: &str) -> Result<()> {
        let surface = self.surface(u64::MAX)?;
        let mut numbers = HashMap::new();
        let (mut points, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for region in &surface.regions {
            for &index in region.indices.iter() {
                let vertex = region.vertices[index as usize];
                let at: [i32; 3] = std::array::from_fn(|i| {
                    vertex.position[i]
                        + region.coords[i] as i32 * isopeel_kernels::REGION_CELLS as i32 * Vertex::LATTICE
                });
                let number = *numbers.entry(at).or_insert_with(|| {
                    points.push(at.map(|x| x as f32 / Vertex::LATTICE as f32));
                    normals.push(vertex.unit_normal());
                    points.len() as u32 - 1
                });
                indices.push(number);
            }
        }
        let counts = [points.len() as u32, indices.len() as u32 / 3];
        let vectors = points.iter().chain(&normals).flatten().flat_map(|x| x.to_le_bytes());
        let bytes: Vec<u8> = counts
            .iter()
            .flat_map(|n| n.to_le_bytes())
            .chain(vectors)
            .chain(indices.iter().flat_map(|i| i.to_le_bytes()))
            .collect();
        std::fs::write(path, bytes).expect("a file");
        Ok(())
    }
}

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let rounds = words.first().and_then(|n| n.parse().ok()).unwrap_or(7);
    let shape = match words.get(1).map(String::as_str) {
        Some("ml") => Shape::MarschnerLobb,
        _ => Shape::Sin,
    };
    let size = words.get(2).and_then(|n| n.parse().ok()).unwrap_or(256);
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    let grid = Grid::new([size; 3], [1.0; 3])?;
    let synthetic = Synthetic {
        shape,
        period: size as f32,
        closed: true,
    };
    let volume = engine.generate(&grid, SampleType::F32, &synthetic)?;
    let iso = Isovalue::new(shape.isovalue(SampleType::F32))?;
    let params = CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    };
    let pyramid = engine.build_pyramid(&volume, Feature::None, iso, &Never)?;
    let mut built = None;
    let [mut wall, mut processor, mut device] = [f64::INFINITY; 3];
    for _ in 0..rounds {
        drop(built.take());
        engine.take_times()?;
        let (start, before) = (Instant::now(), processor_time());
        built = Some(engine.build_tree(&volume, &pyramid, &params, &Never)?);
        wall = wall.min(start.elapsed().as_secs_f64());
        processor = processor.min(processor_time() - before);
        device = device.min(engine.take_times()?.iter().map(|stage| stage.milliseconds).sum());
    }
    let Some(tree) = built else { return Ok(()) };
    let full = tree.full_triangles();
    println!(
        "{full} triangles, wall {:.1} ms, processor {:.1} ms, device {device:.1} ms",
        1e3 * wall,
        processor / 1e6
    );
    let tree = Tree {
        engine: &engine,
        volume: &volume,
        pyramid: &pyramid,
        params,
        tree,
    };
    tree.print_cuts()?;
    match words.get(3) {
        Some(path) => tree.write_mesh(path),
        None => Ok(()),
    }
}
