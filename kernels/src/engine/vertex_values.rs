//! Values of a field at a mesh's vertices.

use crate::stages::interpolate;
use crate::{Cancel, Engine, Region, Result, Vertex, Volume};

/// Points of one batch, which bounds the memory; a region may go beyond it.
const BATCH_POINTS: usize = 1 << 21;

/// How a field's values at vertices are found; by default between the samples of a volume without padding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ValuesOf {
    /// Index coordinates of the field's first sample in the volume of the surface, on each axis.
    pub padding: u32,
    /// Whether a vertex gets the value of the nearest sample, as labels need it, instead of one between samples.
    pub nearest: bool,
}

impl Engine {
    /// Sets the values of a field at the vertices of regions. Vertices at one position have the same bits, in whatever region they are.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], or an error of the device.
    pub fn vertex_values(
        &self,
        field: &Volume,
        of: ValuesOf,
        regions: &mut [Region],
        cancel: &dyn Cancel,
    ) -> Result<()> {
        let mut rest = regions;
        while !rest.is_empty() {
            let (mut points, mut ends) = (Vec::new(), Vec::new());
            for region in rest.iter() {
                points.extend(region.vertices.iter().map(|vertex| point(region, vertex, of)));
                ends.push(points.len());
                if points.len() >= BATCH_POINTS {
                    break;
                }
            }
            let values = match points.is_empty() {
                true => Vec::new(),
                false => interpolate::run(&self.cx, field, &points, cancel)?,
            };
            let (batch, others) = rest.split_at_mut(ends.len());
            let mut first = 0;
            for (region, end) in batch.iter_mut().zip(ends) {
                region.values = values[first..end].to_vec().into();
                first = end;
            }
            rest = others;
        }
        Ok(())
    }
}

/// Returns the position of a vertex in the field, in cells.
fn point(region: &Region, vertex: &Vertex, of: ValuesOf) -> [f32; 4] {
    let cells = region.position_of(vertex).map(|at| {
        let at = (at as f64 / f64::from(Vertex::LATTICE) - f64::from(of.padding)) as f32;
        if of.nearest { at.round() } else { at }
    });
    [cells[0], cells[1], cells[2], 0.0]
}

#[cfg(test)]
mod tests {
    use super::{ValuesOf, point};
    use crate::{Region, Vertex};

    #[test]
    fn points_are_in_cells_of_the_field() {
        let region = Region {
            coords: [2, 0, 4],
            size: 1,
            ..Region::default()
        };
        let vertex = Vertex {
            position: [Vertex::LATTICE / 4, 3 * Vertex::LATTICE / 4, -Vertex::LATTICE],
            normal: [0; 2],
            smoothness: 0,
            feature: 0,
        };
        let at = |padding, nearest| point(&region, &vertex, ValuesOf { padding, nearest });
        assert_eq!(at(0, false), [64.25, 0.75, 127.0, 0.0]);
        assert_eq!(at(1, false), [63.25, -0.25, 126.0, 0.0]);
        assert_eq!(at(0, true), [64.0, 1.0, 127.0, 0.0]);
    }
}
