//! Parts of an image that a collection lists for one time: files that lie beside each other on one even grid.

use std::path::Path;

use super::AsStored;
use super::pieces::{Box3, first_free, joined};
use crate::{FileLocation, Geometry, OpenedFile, ReadError};

/// Maximum deviation of a part from the common grid, relative to the distance of samples: the rounding of a header.
const OFF_GRID: f64 = 1e-3;

/// Joins at least two parts to one volume. `path` is the collection's. If parts overlap, the samples of the later one are taken.
///
/// # Errors
/// Which part does not fit the grid of the first one, or which sample is in no part.
pub(super) fn join(path: &Path, parts: Vec<(FileLocation, AsStored)>) -> Result<OpenedFile, ReadError> {
    let Some((_, first)) = parts.first() else {
        return Err(ReadError::new(path, "part", "none, expected one at least"));
    };
    let origin = first.file.geometry;
    let offsets = parts
        .iter()
        .map(|(at, part)| offset(at, part, &origin))
        .collect::<Result<Vec<_>, _>>()?;
    let lowest: [i64; 3] = std::array::from_fn(|axis| offsets.iter().map(|offset| offset[axis]).min().unwrap_or(0));
    let mut boxes = Vec::with_capacity(parts.len());
    let mut dims = [0; 3];
    for ((at, part), offset) in parts.iter().zip(&offsets) {
        let mut of_part = Box3 {
            low: [0; 3],
            high: [0; 3],
        };
        for axis in 0..3 {
            let (low, size) = (offset[axis] - lowest[axis], part.file.geometry.dims[axis]);
            let high = u32::try_from(low).ok().and_then(|low| low.checked_add(size));
            let far = || {
                ReadError::new(
                    at.path(),
                    "Origin",
                    format!("{low} samples from another part, expected fewer"),
                )
            };
            (of_part.low[axis], of_part.high[axis]) = (low as u32, high.ok_or_else(far)?);
            dims[axis] = dims[axis].max(of_part.high[axis]);
        }
        boxes.push(of_part);
    }
    let whole = Box3 {
        low: [0; 3],
        high: dims,
    };
    if let Some(free) = first_free(whole, &boxes) {
        let why = format!("sample {free:?} is in no part, expected all of {dims:?} in one");
        return Err(ReadError::new(path, "part", why));
    }
    let geometry = Geometry {
        dims,
        origin: std::array::from_fn(|row| {
            let along = |axis: usize| lowest[axis] as f64 * origin.spacing[axis] * origin.direction[axis][row];
            origin.origin[row] + along(0) + along(1) + along(2)
        }),
        ..origin
    };
    let sources: Vec<_> = parts.iter().map(|(at, part)| (at, &part.file)).collect();
    let fields = first
        .file
        .fields
        .iter()
        .map(|field| joined(path, field, &sources, &boxes, dims))
        .collect::<Result<_, _>>()?;
    Ok(OpenedFile {
        geometry,
        fields,
        ..first.file.clone()
    })
}

/// Returns the index of a part's first sample on the grid of the first part.
fn offset(at: &FileLocation, part: &AsStored, first: &Geometry) -> Result<[i64; 3], ReadError> {
    let fail = |field: &str, why: String| ReadError::new(at.path(), field, why);
    if part.positions.is_some() {
        let why = "a rectilinear grid, expected images: parts of rectilinear grids are not joined";
        return Err(fail("VTKFile", why.to_owned()));
    }
    let own = part.file.geometry;
    let like_first = Geometry {
        dims: first.dims,
        origin: first.origin,
        ..own
    };
    if !like_first.matches(first) {
        let why = format!(
            "{:?} and axes {:?}, expected those of the first part: {:?} and {:?}",
            own.spacing, own.direction, first.spacing, first.direction
        );
        return Err(fail("Spacing", why));
    }
    let index = first.world_from_index().inverse().transform_point3(own.origin.into());
    let nearest = index.round();
    if (index - nearest).abs().max_element() > OFF_GRID || nearest.abs().max_element() > f64::from(u32::MAX) {
        let why = format!(
            "the first sample is {:?} samples from the first part's, expected whole numbers",
            index.to_array()
        );
        return Err(fail("Origin", why));
    }
    Ok(nearest.to_array().map(|x| x as i64))
}
