//! Splits sheets of a surface that the simplifier joined along an edge.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::welded::{Triangle, Welded, world};
use crate::math::{DVec3, triangle_normal};

/// Maximum rounds of [`split_sheets`]; in each, a triangle with several joined edges takes part at one of them.
const MAX_ROUNDS: usize = 16;

/// An edge's lower end, then its higher.
fn edge_key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

/// Splits the sheets at edges with more than two triangles. The simplifier does not check the link condition (that the ends of a
/// collapsed edge have no common neighbours outside its triangles), so a thin neck can end as one edge with four triangles.
/// Each sheet but one gets a vertex of its own on that edge; no point of the surface moves.
pub(super) fn split_sheets(welded: &mut Vec<Welded>, triangles: &mut Vec<Triangle>, spacing: [f64; 3]) {
    // After the first round, only edges that it left or made are examined.
    let mut remaining: Option<FxHashSet<u64>> = None;
    for _ in 0..MAX_ROUNDS {
        let mut edges: Vec<(u64, u32)> = (triangles.par_iter().enumerate())
            .flat_map_iter(|(t, triangle)| {
                let [a, b, c] = triangle.corners;
                [(a, b), (b, c), (c, a)].map(|(a, b)| (edge_key(a, b), t as u32))
            })
            .filter(|(edge, _)| remaining.as_ref().is_none_or(|remaining| remaining.contains(edge)))
            .collect();
        edges.par_sort_unstable();
        let mut touched = FxHashSet::default();
        let mut next = FxHashSet::default();
        for edge in edges.chunk_by(|a, b| a.0 == b.0).filter(|edge| edge.len() > 2) {
            // The corners of a triangle that was cut in this round have changed.
            if edge.iter().any(|e| touched.contains(&e.1)) {
                next.insert(edge[0].0);
                continue;
            }
            touched.extend(edge.iter().map(|e| e.1));
            let (a, b) = ((edge[0].0 >> 32) as u32, edge[0].0 as u32);
            let sheets = sheets(edge.iter().map(|e| e.1), [a, b], welded, triangles, spacing);
            let count = sheets.len();
            for (i, sheet) in sheets.into_iter().enumerate().skip(1) {
                let middle = welded.len() as u32;
                welded.push(Welded::between(
                    &welded[a as usize],
                    &welded[b as usize],
                    i as i64,
                    count as i64,
                ));
                for t in sheet {
                    let Triangle { block, corners } = triangles[t as usize];
                    let with = |old: u32| corners.map(|v| if v == old { middle } else { v });
                    triangles[t as usize].corners = with(a);
                    triangles.push(Triangle {
                        block,
                        corners: with(b),
                    });
                    next.extend(corners.map(|v| edge_key(v, middle)));
                }
            }
        }
        if next.is_empty() {
            break;
        }
        remaining = Some(next);
    }
}

/// Pairs the triangles of an edge into sheets: those of a pair traverse the edge in opposite directions and have the smallest angle
/// between their normals. An unpaired triangle is a sheet that ends there, at the border of the volume.
fn sheets(
    around: impl Iterator<Item = u32>,
    [a, b]: [u32; 2],
    welded: &[Welded],
    triangles: &[Triangle],
    spacing: [f64; 3],
) -> Vec<Vec<u32>> {
    let forward = |t: u32| {
        let [x, y, z] = triangles[t as usize].corners;
        [(x, y), (y, z), (z, x)].contains(&(a, b))
    };
    let normal = |t: u32| {
        let corners = triangles[t as usize].corners;
        let n: DVec3 = triangle_normal(corners.map(|v| world(&welded[v as usize], spacing)));
        n / n.length().max(f64::MIN_POSITIVE)
    };
    let (ahead, mut back): (Vec<u32>, Vec<u32>) = around.partition(|&t| forward(t));
    let mut sheets = Vec::new();
    for t in ahead {
        let n = normal(t);
        let alignment = |&(_, &other): &(usize, &u32)| n.dot(normal(other));
        let partner = back
            .iter()
            .enumerate()
            .max_by(|x, y| alignment(x).total_cmp(&alignment(y)));
        sheets.push(match partner.map(|(at, _)| at) {
            Some(at) => vec![t, back.swap_remove(at)],
            None => vec![t],
        });
    }
    sheets.extend(back.into_iter().map(|t| vec![t]));
    sheets
}
