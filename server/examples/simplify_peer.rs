//! Times meshoptimizer's simplification and encoding of a mesh, for `tests/scripts/bench.py`: the alternative to isopeel's
//! cuts is to extract the full surface first. Usage: `simplify_peer MESH FRACTION REPEATS`. MESH is little-endian: the numbers
//! of vertices and of triangles as u32, positions and then normals as f32, and indices as u32. Prints one JSON object for each
//! way: the whole mesh on one thread, and locked bricks of 64³ on all threads; the bricks are then encoded for a wire.
//! FRACTION 1 only encodes.

use std::collections::HashMap;
use std::time::Instant;

use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error>;

struct Mesh {
    points: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

fn read(path: &str) -> Result<Mesh, Failure> {
    let bytes = std::fs::read(path)?;
    let words: Vec<u32> = bytes
        .chunks_exact(4)
        .map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]))
        .collect();
    let [points, triangles] = [words.first(), words.get(1)].map(|n| n.copied().unwrap_or(0) as usize);
    let expected = 2 + 6 * points + 3 * triangles;
    if words.len() != expected {
        return Err(format!("{path}: {} words, expected {expected}", words.len()).into());
    }
    let (positions, rest) = words[2..].split_at(3 * points);
    let (normals, indices) = rest.split_at(3 * points);
    let point = |p: &[u32]| [0, 1, 2].map(|axis| f32::from_bits(p[axis]));
    Ok(Mesh {
        points: positions.chunks_exact(3).map(point).collect(),
        normals: normals.chunks_exact(3).map(point).collect(),
        indices: indices.to_vec(),
    })
}

/// The indices that are left.
fn simplified(mesh: &Mesh, fraction: f64, options: SimplifyOptions) -> Result<Vec<u32>, String> {
    if fraction >= 1.0 {
        return Ok(mesh.indices.clone());
    }
    let target = (mesh.indices.len() as f64 / 3.0 * fraction) as usize * 3;
    let bytes: Vec<u8> = mesh.points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let vertices = VertexDataAdapter::new(&bytes, 12, 0).map_err(|e| e.to_string())?;
    Ok(simplify(&mesh.indices, &vertices, target, f32::MAX, options, None))
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
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        let indices = indices
            .into_iter()
            .map(|i| {
                *local_index.entry(i).or_insert_with(|| {
                    points.push(mesh.points[i as usize]);
                    normals.push(mesh.normals[i as usize]);
                    points.len() as u32 - 1
                })
            })
            .collect();
        Mesh {
            points,
            normals,
            indices,
        }
    };
    parts.into_values().map(local).collect()
}

/// A vertex of 12 bytes, of the precision that isopeel sends: positions in 64ths of a cell, octahedral normals in bytes.
fn packed([x, y, z]: [f32; 3], normal: [f32; 3], brick: [f32; 3]) -> [u8; 12] {
    let mut bytes = [0; 12];
    for (axis, value) in [x - brick[0], y - brick[1], z - brick[2]].into_iter().enumerate() {
        bytes[2 * axis..2 * axis + 2].copy_from_slice(&((value * 64.0).round() as i16).to_le_bytes());
    }
    let scale = normal.iter().map(|v| v.abs()).sum::<f32>().max(f32::MIN_POSITIVE);
    let [a, b, c] = normal.map(|v| v / scale);
    let folded = |v: f32, other: f32| if c < 0.0 { (1.0 - other.abs()).copysign(v) } else { v };
    for (at, v) in [(6, folded(a, b)), (7, folded(b, a))] {
        bytes[at] = (v * 127.0).round() as i8 as u8;
    }
    bytes
}

/// Strip order, vertices in the order of their use, codecs. How many bytes come out.
fn encoded(mesh: &Mesh, mut indices: Vec<u32>) -> Result<usize, String> {
    let brick = mesh
        .points
        .first()
        .map_or([0.0; 3], |p| p.map(|v| (v / 64.0).floor() * 64.0));
    let vertices: Vec<[[f32; 3]; 2]> = mesh.points.iter().zip(&mesh.normals).map(|(&p, &n)| [p, n]).collect();
    meshopt::optimize_vertex_cache_strip_in_place(&mut indices, vertices.len());
    let used = meshopt::optimize_vertex_fetch(&mut indices, &vertices);
    let vertices: Vec<[u8; 12]> = used
        .into_iter()
        .map(|[point, normal]| packed(point, normal, brick))
        .collect();
    let vertex_bytes = meshopt::encode_vertex_buffer_level(&vertices, 2, Some(1)).map_err(|e| e.to_string())?;
    let index_bytes = meshopt::encode_index_buffer(&indices, vertices.len()).map_err(|e| e.to_string())?;
    Ok(vertex_bytes.len() + index_bytes.len())
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
        let (mut best, mut encode_best, mut triangles, mut bytes) = (f64::INFINITY, None, 0, None);
        for _ in 0..repeats {
            let start = Instant::now();
            if way == "whole" {
                triangles = simplified(&mesh, fraction, SimplifyOptions::None)?.len() / 3;
                best = best.min(start.elapsed().as_secs_f64());
                continue;
            }
            let simple = parts.par_iter();
            let simple = simple.map(|part| simplified(part, fraction, SimplifyOptions::LockBorder));
            let simple = simple.collect::<Result<Vec<_>, _>>()?;
            best = best.min(start.elapsed().as_secs_f64());
            triangles = simple.iter().map(Vec::len).sum::<usize>() / 3;
            let start = Instant::now();
            let encode = parts.par_iter().zip(simple);
            bytes = Some(
                encode
                    .map(|(part, kept)| encoded(part, kept))
                    .sum::<Result<usize, _>>()?,
            );
            let seconds = start.elapsed().as_secs_f64();
            encode_best = Some(encode_best.map_or(seconds, |best: f64| best.min(seconds)));
        }
        let threads = rayon::current_num_threads();
        println!(
            "{}",
            serde_json::json!({"way": way, "best_s": best, "triangles": triangles, "threads": threads,
                "encode_best_s": encode_best, "encoded_bytes": bytes})
        );
    }
    Ok(())
}
