//! Finds the places at which triangles of a surface intersect, so that the surface can be refined there.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isopeel_geometry::TriangleSoup;
use isopeel_kernels::{Cancel, Error, Region, RegionVertex, Vertex, check_cancelled};
use rayon::ThreadPool;

/// Interval at which the device's thread pauses for other work while it waits for the search.
const PAUSE_INTERVAL: Duration = Duration::from_millis(1);

/// The faces at which a capped volume closes surfaces.
#[derive(Clone, Copy)]
pub(crate) struct CapFaces {
    /// Last sample before the padding along each axis; the first one is 1.
    last: [f64; 3],
}

impl CapFaces {
    /// Returns the faces of a padded volume. `dims`: samples along each axis, including the padding.
    pub(crate) fn of_padded(dims: [u32; 3]) -> Self {
        Self {
            last: dims.map(|n| f64::from(n) - 2.0),
        }
    }

    /// Whether a position on the lattice is less than a cell from a face.
    fn are_near(self, position: [f64; 3]) -> bool {
        (position.iter().zip(self.last)).any(|(coordinate, last)| {
            let index = coordinate / f64::from(Vertex::LATTICE);
            index < 2.0 || index > last - 1.0
        })
    }
}

/// Returns the vertices of triangles that intersect others; with `faces`, only the vertices of pairs that have a corner near a face.
/// The processors test the triangles, on `pool` if there is one. Meanwhile the calling thread pauses for other work.
///
/// # Errors
/// [`Error::Cancelled`].
pub(crate) fn intersecting_vertices(
    regions: &[Region],
    faces: Option<CapFaces>,
    pool: Option<&ThreadPool>,
    cancel: &dyn Cancel,
) -> Result<Vec<RegionVertex>, Error> {
    let stop = AtomicBool::new(false);
    let search = || find_vertices(regions, faces, &|| stop.load(Ordering::Relaxed));
    std::thread::scope(|scope| {
        let search = scope.spawn(|| match pool {
            Some(pool) => pool.install(search),
            None => search(),
        });
        while !search.is_finished() {
            std::thread::sleep(PAUSE_INTERVAL);
            check_cancelled(cancel).inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
        }
        match search.join() {
            Ok(vertices) => vertices.ok_or(Error::Cancelled),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// Searches as [`intersecting_vertices`], on the lattice, on which positions are exact. Vertices of different regions at the same position
/// count as one. `None` if the search was cancelled.
fn find_vertices(
    regions: &[Region],
    faces: Option<CapFaces>,
    is_cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<RegionVertex>> {
    let (mut positions, mut triangles, mut vertices) = (Vec::new(), Vec::new(), Vec::new());
    for (region_index, region) in (0u32..).zip(regions) {
        let base = positions.len() as u32;
        for (number, vertex) in (0u32..).zip(&region.vertices) {
            positions.push(region.position_of(vertex).map(|coordinate| coordinate as f64));
            vertices.push([region_index, number]);
        }
        let corners = region.indices.chunks_exact(3);
        triangles.extend(corners.map(|corner| [0, 1, 2].map(|i| base + corner[i])));
    }
    let soup = TriangleSoup {
        positions: &positions,
        triangles: &triangles,
    };
    let pairs = soup.intersections(is_cancelled)?;
    let corners_of = |pair: &[u32; 2]| pair.map(|triangle| triangles[triangle as usize]);
    let is_near = |vertex: &u32| faces.is_none_or(|faces| faces.are_near(positions[*vertex as usize]));
    let pairs = pairs.iter().map(corners_of);
    let relevant = pairs.filter(|corners| corners.as_flattened().iter().any(is_near));
    let mut corners: Vec<u32> = relevant.flat_map(|corners| corners.concat()).collect();
    corners.sort_unstable();
    corners.dedup();
    Some(corners.into_iter().map(|vertex| vertices[vertex as usize]).collect())
}
