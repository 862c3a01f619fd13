//! Reference counts, which the host computes from the samples, and checks of meshes. A case is timed only after they have passed.

use std::collections::HashMap;
use std::fmt::Display;

use isopeel_kernels::tables::cases::case_triangles;
use isopeel_kernels::{CutParams, Engine, Feature, Isovalue, Level, Never, Samples, Surface, Volume};
use isopeel_view::quality::MesherName;
use rayon::prelude::*;

use super::volumes::Recipe;
use super::{Args, BenchError, params};

/// Maximum number of planes that are in host memory at the same time.
const PLANES: u32 = 64;

/// Samples along each axis of the volume whose surface must be watertight.
const WATERTIGHT_SIZE: u32 = 96;

/// Reference counts of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counts {
    /// Cells whose corners differ in sign.
    pub active_cells: u64,
    /// Triangles of marching cubes.
    pub full_triangles: u64,
    /// Triangles of the dual mesh: two for every grid edge that changes sign.
    pub dual_triangles: u64,
}

impl std::ops::Add for Counts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            active_cells: self.active_cells + other.active_cells,
            full_triangles: self.full_triangles + other.full_triangles,
            dual_triangles: self.dual_triangles + other.dual_triangles,
        }
    }
}

/// Computes the counts of a volume at an isovalue. Reads the samples back from the device.
pub(super) fn count(engine: &Engine, volume: &Volume, iso: f32) -> Result<Counts, BenchError> {
    let [nx, ny, nz] = volume.grid().dims.map(|n| n as usize);
    let triangles = case_triangles().map(|case| u64::from(case[0]));
    let mut counts = Counts::default();
    for first in (0..nz as u32 - 1).step_by(PLANES as usize) {
        let end = (first + PLANES + 1).min(nz as u32);
        let samples = engine.download(volume, first..end)?;
        let inside = signs(&samples, iso);
        let is_inside = |x: usize, y: usize, z: usize| u64::from(inside[(z * ny + y) * nx + x]);
        // Excludes the last plane, unless it is the last of the volume, because it is also the first plane of the next iteration.
        let planes = 0..(end - first) as usize - usize::from(end < nz as u32);
        let below_end = (end - first) as usize - 1;
        counts = counts
            + planes
                .into_par_iter()
                .map(|z| {
                    let mut counts = Counts::default();
                    for y in 0..ny {
                        for x in 0..nx {
                            let here = is_inside(x, y, z);
                            let mut edges = 0;
                            if x + 1 < nx {
                                edges += here ^ is_inside(x + 1, y, z);
                            }
                            if y + 1 < ny {
                                edges += here ^ is_inside(x, y + 1, z);
                            }
                            if z < below_end {
                                edges += here ^ is_inside(x, y, z + 1);
                            }
                            counts.dual_triangles += 2 * edges;
                            if x + 1 < nx && y + 1 < ny && z < below_end {
                                let case = here
                                    | is_inside(x + 1, y, z) << 1
                                    | is_inside(x, y + 1, z) << 2
                                    | is_inside(x + 1, y + 1, z) << 3
                                    | is_inside(x, y, z + 1) << 4
                                    | is_inside(x + 1, y, z + 1) << 5
                                    | is_inside(x, y + 1, z + 1) << 6
                                    | is_inside(x + 1, y + 1, z + 1) << 7;
                                counts.active_cells += u64::from(case != 0 && case != 255);
                                counts.full_triangles += triangles[case as usize];
                            }
                        }
                    }
                    counts
                })
                .reduce(Counts::default, |a, b| a + b);
    }
    Ok(counts)
}

/// Returns 1 for each sample at or above the isovalue, and 0 for each one below.
fn signs(samples: &Samples, iso: f32) -> Vec<u8> {
    fn signs_of<T: Copy + Into<f32> + Sync>(samples: &[T], iso: f32) -> Vec<u8> {
        samples.par_iter().map(|&v| u8::from(v.into() >= iso)).collect()
    }
    match samples {
        Samples::U8(v) => signs_of(v, iso),
        Samples::I8(v) => signs_of(v, iso),
        Samples::U16(v) => signs_of(v, iso),
        Samples::I16(v) => signs_of(v, iso),
        Samples::F32(v) => signs_of(v, iso),
    }
}

/// Returns an error unless two results are equal. `what` names the result in the error.
pub(super) fn equal<T: PartialEq + Display>(
    recipe: &Recipe,
    what: &'static str,
    found: T,
    expected: T,
) -> Result<(), BenchError> {
    if found == expected {
        return Ok(());
    }
    Err(BenchError::Wrong {
        volume: recipe.title(),
        what,
        found: found.to_string(),
        expected: expected.to_string(),
    })
}

/// Returns an error if a mesh is not consistent: wrong numbers of indices, or indices beyond the vertices.
pub(super) fn check_mesh(recipe: &Recipe, surface: &Surface) -> Result<(), BenchError> {
    let indices: u64 = surface.regions.iter().map(|r| r.indices.len() as u64).sum();
    equal(recipe, "indices of the mesh", indices, 3 * surface.statistics.triangles)?;
    for region in &surface.regions {
        let levels: u64 = region.level_triangles.iter().map(|&n| u64::from(n)).sum();
        equal(recipe, "indices of a region", region.indices.len() as u64, 3 * levels)?;
        let outside = region
            .indices
            .iter()
            .filter(|&&i| i as usize >= region.vertices.len())
            .count();
        equal(recipe, "indices past a region's vertices", outside, 0)?;
    }
    Ok(())
}

/// Returns the number of edges with an odd number of triangles. Edges with the same ends count as one, even in different regions.
fn odd_edges(surface: &Surface) -> usize {
    type Point = [i64; 3];
    let mut odd: HashMap<(Point, Point), bool> = HashMap::new();
    for region in &surface.regions {
        let point = |index: u32| region.position_of(&region.vertices[index as usize]);
        for triangle in region.indices.chunks_exact(3) {
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (a, b) = (point(triangle[a]), point(triangle[b]));
                if a != b {
                    *odd.entry((a.min(b), a.max(b))).or_default() ^= true;
                }
            }
        }
    }
    odd.values().filter(|&&odd| odd).count()
}

/// Returns an error if the surface of a small, closed variant of the volume is not watertight. Checks only the dual mesher, because
/// marching cubes does not guarantee this.
pub(super) fn check_watertight(engine: &Engine, args: &Args, recipe: &Recipe) -> Result<(), BenchError> {
    if args.mesher != MesherName::Dual {
        return Ok(());
    }
    let small = recipe.small_and_closed(WATERTIGHT_SIZE);
    let volume = small.generate(engine)?;
    let iso = Isovalue::new(small.iso)?;
    let pyramid = engine.build_pyramid(&volume, Feature::None, iso, &Never)?;
    for beta in [-1.0, 0.01, 0.05] {
        let params = CutParams {
            beta,
            ..params(args, recipe)
        };
        let surface = engine.peel(&volume, &pyramid, &params, Level::FINEST, &Never)?;
        check_mesh(&small, &surface)?;
        equal(&small, "edges with an odd number of triangles", odd_edges(&surface), 0)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isopeel_kernels::{Region, SurfaceStatistics, Vertex};

    fn surface(triangles: &[[u32; 3]]) -> Surface {
        let vertex = |x: i32, y: i32, z: i32| Vertex {
            position: [x, y, z],
            normal: [0; 2],
            smoothness: 0,
            feature: 0,
        };
        Surface {
            remade: None,
            regions: vec![Region {
                coords: [0; 3],
                size: 0,
                vertices: vec![vertex(0, 0, 0), vertex(9, 0, 0), vertex(0, 9, 0), vertex(0, 0, 9)].into(),
                indices: triangles.concat().into(),
                values: Vec::new().into(),
                level_triangles: [triangles.len() as u32, 0, 0, 0, 0, 0],
                error: None,
            }],
            prefix: Level::FINEST,
            statistics: SurfaceStatistics {
                triangles: triangles.len() as u64,
                ..SurfaceStatistics::default()
            },
        }
    }

    #[test]
    fn a_hole_is_found() {
        let whole = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(odd_edges(&surface(&whole)), 0);
        assert_eq!(odd_edges(&surface(&whole[..3])), 3);
    }
}
