//! Distances of a mesh's vertices to the isosurface: of the vertex alone, or of the triangles around it too.

use crate::Pyramid;
use crate::stages::distance;
use crate::{Cancel, Engine, Region, Result, Vertex, Volume};
use std::collections::HashMap;

/// The points of the mesh whose distance a vertex gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum DistanceOf {
    /// The vertex itself.
    Vertex,
    /// The farthest of the vertex and of those points on its triangles that are nearer to it than to their other corners. Vertices at one
    /// position have one distance, in whatever region they are.
    Around,
}

/// Parts of the longest side of a triangle between points, at most.
const MAX_PARTS: usize = 6;

/// Points of one batch, which bounds the memory; a region may go beyond it.
const BATCH_POINTS: usize = 1 << 20;

type Point = [f32; 4];

impl Engine {
    /// Distances of the vertices of regions to the isosurface, world units; infinite if none is near.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], or an error of the device.
    pub fn vertex_distances(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        regions: &[Region],
        of: DistanceOf,
        cancel: &dyn Cancel,
    ) -> Result<Vec<Vec<f32>>> {
        let mut all = Vec::with_capacity(regions.len());
        while all.len() < regions.len() {
            let (mut points, mut owners, mut ends) = (Vec::new(), Vec::new(), Vec::new());
            for region in &regions[all.len()..] {
                push_points(region, of, &mut points, &mut owners);
                ends.push(points.len());
                if points.len() >= BATCH_POINTS {
                    break;
                }
            }
            let distances = distance::run(&self.cx, volume, pyramid, &points, cancel)?;
            let mut first = 0;
            for end in ends {
                let mut own = vec![0.0f32; regions[all.len()].vertices.len()];
                for (&owner, &distance) in owners[first..end].iter().zip(&distances[first..end]) {
                    own[owner as usize] = own[owner as usize].max(distance);
                }
                all.push(own);
                first = end;
            }
        }
        if of == DistanceOf::Around {
            join(regions, &mut all);
        }
        Ok(all)
    }
}

/// Points of a region in cells, with the vertex that each is of.
fn push_points(region: &Region, of: DistanceOf, points: &mut Vec<Point>, owners: &mut Vec<u32>) {
    let in_cells = |at: [i64; 3]| at.map(|x| (x as f64 / f64::from(Vertex::LATTICE)) as f32);
    let vertices: Vec<[f32; 3]> = region
        .vertices
        .iter()
        .map(|v| in_cells(region.position_of(v)))
        .collect();
    points.extend(vertices.iter().map(|&[x, y, z]| [x, y, z, 0.0]));
    owners.extend(0..vertices.len() as u32);
    if of == DistanceOf::Vertex {
        return;
    }
    for triangle in region.indices.chunks_exact(3) {
        let corners = [0, 1, 2].map(|k| vertices[triangle[k] as usize]);
        for weights in inner_points(parts(corners)) {
            let at = |axis: usize| (0..3).map(|k| weights[k] * corners[k][axis]).sum();
            points.push([at(0), at(1), at(2), 0.0]);
            let nearest = (0..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
            owners.push(triangle[nearest]);
        }
    }
}

/// In how many parts a triangle's sides are divided: one has about the length of a cell.
fn parts(corners: [[f32; 3]; 3]) -> usize {
    let side2 = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>();
    let longest2 = (0..3)
        .map(|k| side2(corners[k], corners[(k + 1) % 3]))
        .fold(0.0, f32::max);
    (longest2.sqrt().ceil() as usize).clamp(1, MAX_PARTS)
}

/// Barycentric coordinates of the centroids of the triangles into which `parts` divides one.
fn inner_points(parts: usize) -> impl Iterator<Item = [f32; 3]> {
    let at = move |i: usize, j: usize, third: f32| {
        let [u, v] = [i, j].map(|n| (n as f32 + third) / parts as f32);
        [u, v, 1.0 - u - v]
    };
    let upright = (0..parts).flat_map(move |i| (0..parts - i).map(move |j| at(i, j, 1.0 / 3.0)));
    let turned = (0..parts).flat_map(move |i| (0..(parts - i).saturating_sub(1)).map(move |j| at(i, j, 2.0 / 3.0)));
    upright.chain(turned)
}

/// Gives vertices at one position the largest distance of all.
fn join(regions: &[Region], distances: &mut [Vec<f32>]) {
    let is_outside = |border: i32, vertex: &Vertex| vertex.position.iter().any(|&x| x < 0 || x >= border);
    // A vertex that several regions share lies outside all of them except one.
    let outside = |region: &Region| {
        let border = region.key().lattice();
        let shared = region.vertices.iter().filter(|vertex| is_outside(border, vertex));
        shared
            .map(|vertex| (region.position_of(vertex), 0.0))
            .collect::<Vec<_>>()
    };
    let mut largest: HashMap<[i64; 3], f32> = regions.iter().flat_map(outside).collect();
    for (region, own) in regions.iter().zip(distances.iter()) {
        for (vertex, &distance) in region.vertices.iter().zip(own) {
            if let Some(known) = largest.get_mut(&region.position_of(vertex)) {
                *known = known.max(distance);
            }
        }
    }
    for (region, own) in regions.iter().zip(distances) {
        for (vertex, distance) in region.vertices.iter().zip(own) {
            if let Some(&known) = largest.get(&region.position_of(vertex)) {
                *distance = known;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{MAX_PARTS, inner_points, parts};

    #[test]
    fn points_of_a_triangle_are_inside_and_share_its_area() {
        for n in 1..=MAX_PARTS {
            let points: Vec<_> = inner_points(n).collect();
            assert_eq!(points.len(), n * n);
            let inside = |w: &[f32; 3]| w.iter().all(|&x| x > 0.0) && (w.iter().sum::<f32>() - 1.0).abs() < 1e-6;
            assert!(points.iter().all(inside), "{n}: {points:?}");
            for k in 0..3 {
                let mean = points.iter().map(|w| w[k]).sum::<f32>() / points.len() as f32;
                assert!((mean - 1.0 / 3.0).abs() < 1e-5, "{n}: mean weight {mean}");
            }
        }
    }

    #[test]
    fn long_triangles_have_more_points() {
        let of = |length: f32| parts([[0.0; 3], [length, 0.0, 0.0], [0.0, 0.5, 0.0]]);
        assert_eq!([0.3, 1.0, 2.2, 100.0].map(of), [1, 2, 3, MAX_PARTS]);
    }
}
