//! From regions to one surface with shared vertices, cut into blocks, and back.

use isopeel_kernels::{Region, Vertex};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::block::Block;
use super::welded::{REGION_LATTICE, Triangle, Welded};
use super::{Blocks, Importance};

/// The region of a block, where blocks are regions, and its triangles by welded vertices.
type BlockTriangles = (Option<[u32; 3]>, Vec<[u32; 3]>);

/// Joins vertices of equal positions and assigns the triangles to blocks.
pub(super) fn weld(
    regions: Vec<Region>,
    spacing: [f64; 3],
    importance: &Importance,
    blocks: Blocks,
) -> (Vec<Welded>, Vec<Block>) {
    let mut welded: Vec<Welded> = Vec::new();
    let mut at: FxHashMap<[i64; 3], u32> = FxHashMap::default();
    let mut block_at: FxHashMap<[u32; 3], usize> = FxHashMap::default();
    let mut triangles: Vec<BlockTriangles> = Vec::new();
    for region in regions {
        let next = triangles.len();
        let block = *block_at.entry(blocks.of(region.coords)).or_insert(next);
        if block == next {
            triangles.push(((blocks == Blocks::Regions).then_some(region.coords), Vec::new()));
        }
        let corner = region.coords.map(|c| i64::from(c) * REGION_LATTICE);
        let joined: Vec<u32> = (region.vertices.iter())
            .map(|vertex| {
                let position = [0, 1, 2].map(|axis| corner[axis] + i64::from(vertex.position[axis]));
                let index = *at.entry(position).or_insert(welded.len() as u32);
                if index as usize == welded.len() {
                    welded.push(Welded {
                        position,
                        vertex: *vertex,
                        level: u8::MAX,
                        block,
                        shared: false,
                    });
                }
                index
            })
            .collect();
        let levels = (0u8..)
            .zip(region.level_triangles)
            .flat_map(|(level, n)| std::iter::repeat_n(level, n as usize));
        for (corners, level) in region.indices.chunks_exact(3).zip(levels) {
            let triangle = [0, 1, 2].map(|i| joined[corners[i] as usize]);
            for v in triangle {
                let v = &mut welded[v as usize];
                v.level = v.level.min(level);
                v.shared |= v.block != block;
            }
            let [a, b, c] = triangle;
            if a != b && b != c && c != a {
                triangles[block].1.push(triangle);
            }
        }
    }
    let blocks = triangles
        .into_par_iter()
        .map(|(region, triangles)| Block::new(region, &triangles, &welded, spacing, importance))
        .collect();
    (welded, blocks)
}

/// Back to regions: a triangle goes to the region of its block or, where a block has several, to that of its centre.
pub(super) fn gather(welded: &[Welded], blocks: &[Block], all: &[Triangle]) -> Vec<Region> {
    let mut triangles: FxHashMap<[u32; 3], Vec<(u8, [u32; 3])>> = FxHashMap::default();
    for &Triangle { block, corners } in all {
        let at = |axis: usize| corners.map(|v| welded[v as usize].position[axis]).iter().sum::<i64>() / 3;
        let centre = || [0, 1, 2].map(|axis| at(axis).div_euclid(REGION_LATTICE).max(0) as u32);
        let coords = blocks[block as usize].region.unwrap_or_else(centre);
        let level = corners.iter().map(|&v| welded[v as usize].level).min().unwrap_or(0);
        triangles.entry(coords).or_default().push((level, corners));
    }
    let mut regions: Vec<Region> = (triangles.into_par_iter())
        .map(|(coords, mut triangles)| {
            triangles.sort_by_key(|t| t.0);
            let corner = coords.map(|c| i64::from(c) * REGION_LATTICE);
            let mut region = Region {
                coords,
                ..Region::default()
            };
            let mut own: FxHashMap<u32, u32> = FxHashMap::default();
            for (level, corners) in triangles {
                region.level_triangles[usize::from(level.min(5))] += 1;
                for v in corners {
                    let index = *own.entry(v).or_insert_with(|| {
                        let Welded { position, vertex, .. } = &welded[v as usize];
                        let position = [0, 1, 2].map(|axis| (position[axis] - corner[axis]) as i32);
                        region.vertices.to_mut().push(Vertex { position, ..*vertex });
                        region.vertices.len() as u32 - 1
                    });
                    region.indices.to_mut().push(index);
                }
            }
            region
        })
        .collect();
    regions.sort_by_key(|region| [region.coords[2], region.coords[1], region.coords[0]]);
    regions
}
