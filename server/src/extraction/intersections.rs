//! Where triangles of a surface intersect, so that it is refined there.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isopeel_geometry::TriangleSoup;
use isopeel_kernels::{Cancel, Error, REGION_CELLS, Region, RegionVertex, Vertex};

use crate::pool;

/// How often the device's thread lets others run while it waits.
const YIELD_INTERVAL: Duration = Duration::from_millis(1);

/// The vertices of triangles that intersect others. Triangles are tested on the processors, and meanwhile the device's thread lets others run.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn intersecting_vertices(regions: &[Region], cancel: &dyn Cancel) -> Result<Vec<RegionVertex>, Error> {
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let search = scope.spawn(|| pool::install_export(|| find(regions, &|| stop.load(Ordering::Relaxed))));
        while !search.is_finished() {
            std::thread::sleep(YIELD_INTERVAL);
            if cancel.cancelled() {
                stop.store(true, Ordering::Relaxed);
                return Err(Error::Cancelled);
            }
        }
        match search.join() {
            Ok(found) => found.ok_or(Error::Cancelled),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// On the lattice, where positions are exact. Vertices of different regions at one position are one there.
fn find(regions: &[Region], is_cancelled: &(dyn Fn() -> bool + Sync)) -> Option<Vec<RegionVertex>> {
    let (mut positions, mut triangles, mut vertices) = (Vec::new(), Vec::new(), Vec::new());
    for (place, region) in (0u32..).zip(regions) {
        let base = positions.len() as u32;
        let origin = region
            .coords
            .map(|at| f64::from(at) * f64::from(REGION_CELLS as i32 * Vertex::LATTICE));
        for (number, vertex) in (0u32..).zip(&region.vertices) {
            positions.push([0, 1, 2].map(|axis| origin[axis] + f64::from(vertex.position[axis])));
            vertices.push([place, number]);
        }
        let corners = region.indices.chunks_exact(3);
        triangles.extend(corners.map(|corner| [0, 1, 2].map(|i| base + corner[i])));
    }
    let soup = TriangleSoup {
        positions: &positions,
        triangles: &triangles,
    };
    let pairs = soup.intersections(is_cancelled)?;
    let mut found: Vec<u32> = pairs
        .as_flattened()
        .iter()
        .flat_map(|&at| triangles[at as usize])
        .collect();
    found.sort_unstable();
    found.dedup();
    Some(found.into_iter().map(|vertex| vertices[vertex as usize]).collect())
}
