//! Attributes of elements, and the grid that the attributes of an image describe.

use std::path::Path;

use quick_xml::XmlVersion;
use quick_xml::events::BytesStart;

use super::super::Grid;
use crate::ReadError;
use crate::formats::header;

/// Returns the text of an attribute, if the element has it.
pub(in crate::formats::vtk) fn attribute(
    path: &Path,
    element: &BytesStart<'_>,
    name: &str,
) -> Result<Option<String>, ReadError> {
    let error = |e: String| ReadError::new(path, name, e);
    let found = element.try_get_attribute(name).map_err(|e| error(e.to_string()))?;
    let text = found.map(|a| {
        a.normalized_value(XmlVersion::Implicit1_0)
            .map(|value| value.into_owned())
    });
    text.transpose().map_err(|e| error(e.to_string()))
}

/// Returns the `count` numbers of an attribute, if the element has it.
pub(in crate::formats::vtk) fn list<T: std::str::FromStr>(
    path: &Path,
    element: &BytesStart<'_>,
    name: &str,
    count: usize,
) -> Result<Option<Vec<T>>, ReadError>
where
    T::Err: std::fmt::Display,
{
    let text = attribute(path, element, name)?;
    text.map(|text| header::numbers(path, name, &text, Some(count)))
        .transpose()
}

/// First and last index along x, y and z.
pub(in crate::formats::vtk) type Extent = [[i64; 2]; 3];

/// Converts six numbers to an extent. Errors name the attribute `name`.
pub(in crate::formats::vtk) fn extent(path: &Path, name: &str, numbers: &[i64]) -> Result<Extent, ReadError> {
    let &[x0, x1, y0, y1, z0, z1] = numbers else {
        let why = "missing, expected the first and last index along x, y and z";
        return Err(ReadError::new(path, name, why));
    };
    Ok([[x0, x1], [y0, y1], [z0, z1]])
}

/// Returns the samples along each axis of an extent.
pub(in crate::formats::vtk) fn dims(path: &Path, extent: Extent) -> Result<[u32; 3], ReadError> {
    let mut sizes = [0; 3];
    for (size, [first, last]) in sizes.iter_mut().zip(extent) {
        let count = last.checked_sub(first).and_then(|n| n.checked_add(1));
        *size = count.and_then(|n| u64::try_from(n).ok()).ok_or_else(|| {
            let why = format!("{first} to {last} along an axis, expected the first index, then the last");
            ReadError::new(path, "Extent", why)
        })?;
    }
    let sizes = header::sizes(path, "Extent", &sizes)?;
    Ok([sizes[0], sizes[1], sizes[2]])
}

/// Position of the sample of index 0, and the distances and directions of the others from it.
#[derive(Clone, Debug)]
pub(in crate::formats::vtk) struct GridAttributes {
    pub spacing: Vec<f64>,
    pub origin: Vec<f64>,
    /// Rows of the matrix whose columns are the axes.
    pub direction: Vec<f64>,
}

impl Default for GridAttributes {
    fn default() -> Self {
        Self {
            spacing: vec![1.0; 3],
            origin: vec![0.0; 3],
            direction: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        }
    }
}

impl GridAttributes {
    /// Sets the properties that the attributes of an image state; others keep their values.
    pub fn read(&mut self, path: &Path, element: &BytesStart<'_>) -> Result<(), ReadError> {
        let named = [
            ("Origin", 3, &mut self.origin),
            ("Spacing", 3, &mut self.spacing),
            ("Direction", 9, &mut self.direction),
        ];
        for (name, count, own) in named {
            if let Some(values) = list(path, element, name, count)? {
                *own = values;
            }
        }
        Ok(())
    }

    /// Returns the grid of an extent, whose first sample may have another index than 0.
    pub fn grid(&self, path: &Path, extent: Extent) -> Result<Grid, ReadError> {
        let columns = std::array::from_fn(|axis| std::array::from_fn(|row| self.direction[3 * row + axis]));
        let (scale, direction) = header::split_axes(columns);
        let spacing: [f64; 3] = std::array::from_fn(|axis| self.spacing[axis] * scale[axis]);
        let origin = std::array::from_fn(|row| {
            let start = |axis: usize| extent[axis][0] as f64 * spacing[axis] * direction[axis][row];
            self.origin[row] + start(0) + start(1) + start(2)
        });
        Ok(Grid {
            dims: dims(path, extent)?,
            spacing,
            origin,
            direction,
            positions: None,
        })
    }
}
