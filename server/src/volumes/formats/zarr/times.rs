//! When the time steps of an array are: by the array of their times beside it, as xarray writes it, or by the scale of an image.

use std::sync::Arc;

use serde_json::Value;

use super::metadata::{Array, Node, node};
use super::ome::{Axis, Level};
use super::samples::ZarrSamples;
use super::store::{Store, join};
use crate::volumes::{ReadError, TimeAxis};

/// Times that are read at most.
const MAX_TIMES: u64 = 1 << 20;

/// `None` where nothing says it, or what does cannot be read: steps are counted then.
pub(super) fn of(
    store: &Arc<Store>,
    path: &str,
    array: &Array,
    axis: usize,
    described: &Axis,
    level: &Level,
) -> Option<TimeAxis> {
    let steps = array.shape[axis];
    let name = array
        .names
        .get(axis)
        .filter(|name| !name.is_empty() && !name.contains('/'));
    let listed = name.and_then(|name| match coordinate(store, path, name, steps) {
        Ok(times) => times,
        Err(error) => {
            tracing::warn!("steps are counted, as their times cannot be read: {error}");
            None
        }
    });
    let unit = described.time_unit.as_deref();
    let even = || {
        TimeAxis::even(
            level.translation[axis],
            level.scale[axis],
            steps.try_into().ok()?,
            unit?,
        )
    };
    listed.or_else(even)
}

/// The array of that name beside another one.
fn coordinate(store: &Arc<Store>, path: &str, name: &str, steps: u64) -> Result<Option<TimeAxis>, ReadError> {
    let group = path.rsplit_once('/').map_or("", |(group, _)| group);
    let beside = join(group, name);
    let Some(Node::Array(times)) = node(store, &beside)? else {
        return Ok(None);
    };
    if beside == path || times.shape != [steps] {
        return Ok(None);
    }
    let attributes = times.attributes.clone();
    let text = |key: &str| attributes.get(key).and_then(Value::as_str);
    let number = |key: &str, default: f64| attributes.get(key).and_then(Value::as_f64).unwrap_or(default);
    let [factor, offset] = [number("scale_factor", 1.0), number("add_offset", 0.0)];
    let values = ZarrSamples::line(Arc::clone(store), beside, *times, MAX_TIMES)?;
    let values = values.into_iter().map(|value| value * factor + offset).collect();
    Ok(TimeAxis::listed(
        values,
        text("units").unwrap_or_default(),
        text("calendar"),
    ))
}
