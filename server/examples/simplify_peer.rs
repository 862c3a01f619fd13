//! Times meshoptimizer's simplification of a mesh, for `tests/scripts/bench.py`: what one would do after extracting the
//! full surface. `simplify_peer MESH FRACTION REPEATS`, where MESH holds, little-endian, the number of vertices and of
//! triangles as u32, positions as f32 and indices as u32. Prints a JSON object a way: the whole mesh on one thread, and
//! locked bricks of 64³ on all threads.

use std::collections::HashMap;
use std::time::Instant;

use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error>;

struct Mesh {
    points: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

fn read(path: &str) -> Result<Mesh, Failure> {
    let bytes = std::fs::read(path)?;
    let words: Vec<u32> = bytes
        .chunks_exact(4)
        .map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]))
        .collect();
    let [points, triangles] = [words.first(), words.get(1)].map(|n| n.copied().unwrap_or(0) as usize);
    if words.len() != 2 + 3 * points + 3 * triangles {
        return Err(format!(
            "{path}: {} words, expected {}",
            words.len(),
            2 + 3 * points + 3 * triangles
        )
        .into());
    }
    let (positions, indices) = words[2..].split_at(3 * points);
    let point = |p: &[u32]| [0, 1, 2].map(|axis| f32::from_bits(p[axis]));
    Ok(Mesh {
        points: positions.chunks_exact(3).map(point).collect(),
        indices: indices.to_vec(),
    })
}

fn simplified(mesh: &Mesh, fraction: f64, options: SimplifyOptions) -> Result<usize, String> {
    let target = (mesh.indices.len() as f64 / 3.0 * fraction) as usize * 3;
    let bytes: Vec<u8> = mesh.points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let vertices = VertexDataAdapter::new(&bytes, 12, 0).map_err(|e| e.to_string())?;
    Ok(simplify(&mesh.indices, &vertices, target, f32::MAX, options, None).len() / 3)
}

/// Triangles by the brick of their first vertex, each brick a mesh of its own.
fn bricks(mesh: &Mesh) -> Vec<Mesh> {
    let mut parts: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    for triangle in mesh.indices.chunks_exact(3) {
        let brick = mesh.points[triangle[0] as usize].map(|v| (v / 64.0).floor() as i32);
        parts.entry(brick).or_default().extend(triangle);
    }
    let local = |indices: Vec<u32>| {
        let mut local_index = HashMap::new();
        let mut points = Vec::new();
        let indices = indices
            .into_iter()
            .map(|i| {
                *local_index.entry(i).or_insert_with(|| {
                    points.push(mesh.points[i as usize]);
                    points.len() as u32 - 1
                })
            })
            .collect();
        Mesh { points, indices }
    };
    parts.into_values().map(local).collect()
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, fraction, repeats] = arguments.as_slice() else {
        return Err("expected MESH FRACTION REPEATS".into());
    };
    let (mesh, fraction, repeats) = (read(path)?, fraction.parse::<f64>()?, repeats.parse::<u32>()?);
    // Cutting the mesh into bricks is not timed: an extractor could emit them so.
    let parts = bricks(&mesh);
    for way in ["whole", "bricks"] {
        let (mut best, mut triangles) = (f64::INFINITY, 0);
        for _ in 0..repeats {
            let start = Instant::now();
            triangles = if way == "whole" {
                simplified(&mesh, fraction, SimplifyOptions::None)?
            } else {
                let counts = parts
                    .par_iter()
                    .map(|part| simplified(part, fraction, SimplifyOptions::LockBorder));
                counts.sum::<Result<usize, String>>()?
            };
            best = best.min(start.elapsed().as_secs_f64());
        }
        println!(
            "{{\"way\":\"{way}\",\"best_s\":{best:.4},\"triangles\":{triangles},\"threads\":{}}}",
            rayon::current_num_threads()
        );
    }
    Ok(())
}
