//! The meshes of a reply, which go through shared memory beside the message: they are copied by all processors, and not parsed.

use bytes::Bytes;
use isopeel_extraction::{DeviceReply, JobError};
use isopeel_kernels::{Region, SharedSlice, SurfaceError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::channel::ALIGNMENT;

/// A region without its arrays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RegionHead {
    coords: [u32; 3],
    size: u8,
    /// Number of vertices, of indices and of values.
    lengths: [usize; 3],
    level_triangles: [u32; 6],
    error: Option<SurfaceError>,
}

/// Removes the regions of the surface in a reply, if it has a surface.
pub(super) fn detach(outcome: &mut Result<DeviceReply, JobError>) -> Vec<Region> {
    regions_of(outcome).map(std::mem::take).unwrap_or_default()
}

/// Puts regions back into a reply.
pub(super) fn attach(outcome: &mut Result<DeviceReply, JobError>, regions: Vec<Region>) {
    if let Some(place) = regions_of(outcome) {
        *place = regions;
    }
}

fn regions_of(outcome: &mut Result<DeviceReply, JobError>) -> Option<&mut Vec<Region>> {
    match outcome.as_mut().ok()? {
        DeviceReply::Refine(step) | DeviceReply::Improve(Some(step)) => Some(&mut step.surface.regions),
        DeviceReply::Extract(extraction) => Some(&mut extraction.surface.regions),
        _ => None,
    }
}

/// Returns the heads of regions.
pub(super) fn heads(regions: &[Region]) -> Vec<RegionHead> {
    let head = |region: &Region| RegionHead {
        coords: region.coords,
        size: region.size,
        lengths: [region.vertices.len(), region.indices.len(), region.values.len()],
        level_triangles: region.level_triangles,
        error: region.error,
    };
    regions.iter().map(head).collect()
}

/// Returns the arrays of regions: vertices and indices of each, and values, if it has any.
pub(super) fn arrays(regions: &[Region]) -> Vec<&[u8]> {
    let mut arrays = Vec::with_capacity(3 * regions.len());
    for region in regions {
        arrays.push(bytemuck::cast_slice(&region.vertices));
        arrays.push(bytemuck::cast_slice(&region.indices));
        if !region.values.is_empty() {
            arrays.push(bytemuck::cast_slice(&region.values));
        }
    }
    arrays
}

/// Joins heads with their arrays, which lie one after the other at multiples of [`ALIGNMENT`].
///
/// # Errors
/// The arrays do not fit the heads. The text says why.
pub(super) fn join(heads: Vec<RegionHead>, arrays: &Bytes) -> Result<Vec<Region>, String> {
    let mut begin = 0usize;
    let mut next = |bytes: Option<usize>| {
        let end = begin.checked_add(bytes?)?;
        let array = (end <= arrays.len()).then(|| arrays.slice(begin..end));
        begin = end.checked_next_multiple_of(ALIGNMENT)?;
        array
    };
    let parts: Option<Vec<_>> = heads
        .into_iter()
        .map(|head| {
            let vertices = next(head.lengths[0].checked_mul(size_of::<isopeel_kernels::Vertex>()))?;
            let indices = next(head.lengths[1].checked_mul(size_of::<u32>()))?;
            let values = match head.lengths[2] {
                0 => None,
                values => Some(next(values.checked_mul(size_of::<f32>()))?),
            };
            Some((head, vertices, indices, values))
        })
        .collect();
    let parts = parts.ok_or("the arrays of a surface are cut off")?;
    let region = |(head, vertices, indices, values): (RegionHead, Bytes, Bytes, Option<Bytes>)| {
        let region = Region {
            coords: head.coords,
            size: head.size,
            vertices: SharedSlice::of_bytes(vertices).ok_or("an array is not aligned")?,
            indices: SharedSlice::of_bytes(indices).ok_or("an array is not aligned")?,
            values: match values {
                Some(values) => SharedSlice::of_bytes(values).ok_or("an array is not aligned")?,
                None => SharedSlice::default(),
            },
            level_triangles: head.level_triangles,
            error: head.error,
        };
        region.check()?;
        Ok(region)
    };
    parts.into_par_iter().map(region).collect()
}
