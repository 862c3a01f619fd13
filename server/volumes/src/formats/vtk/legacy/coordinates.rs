//! Positions of a rectilinear grid.

use super::{Parser, stored_type};
use crate::ReadError;
use crate::formats::header::numbers;
use crate::formats::vtk::Grid;
use crate::rectilinear::Positions;
use crate::scalar;
use crate::stored::Endian;

/// Maximum bytes of positions along an axis: no volume has that many samples along one.
const MAX_POSITION_BYTES: u64 = 32 << 20;

impl Parser<'_> {
    /// Reads `X_COORDINATES number type`, or the same for another axis.
    pub(super) fn coordinates(&mut self, keyword: &str, rest: &[&str]) -> Result<(), ReadError> {
        let count = self.number(keyword, rest.first())?;
        let kind = rest.get(1).copied().unwrap_or_default().to_ascii_lowercase();
        let Some(stored) = stored_type(&kind) else {
            return Err(self.error(keyword, format!("type {kind:?}, expected char to double")));
        };
        let begin = self.at;
        self.skip_values(count, stored.bytes())?;
        let length = self.at - begin;
        if length > MAX_POSITION_BYTES {
            let why = format!("{length} bytes of positions, expected {MAX_POSITION_BYTES} at most");
            return Err(self.error(keyword, why));
        }
        let mut bytes = vec![0; length as usize];
        self.blob.read_exact_at(&mut bytes, begin).map_err(|e| self.io(e))?;
        let values = if self.text {
            numbers(self.blob.path(), keyword, &String::from_utf8_lossy(&bytes), None)?
        } else {
            scalar::numbers(&bytes, stored, Endian::Big)
        };
        let axis = keyword[..1].to_ascii_lowercase();
        let positions = Positions::new(axis.as_str(), values).map_err(|why| self.error(keyword, why))?;
        self.positions.insert(axis, positions);
        Ok(())
    }

    /// Returns the grid at the positions that were read. Their number must match `DIMENSIONS`.
    pub(super) fn rectilinear_grid(&mut self) -> Result<Grid, ReadError> {
        let dims = self.grid.dims;
        let positions = ["x", "y", "z"].map(|axis| {
            let found = self.positions.remove(axis);
            found.ok_or_else(|| format!("none along {axis}, expected X_COORDINATES, Y_COORDINATES and Z_COORDINATES"))
        });
        let grid = Grid::of_positions(positions).map_err(|why| self.error("COORDINATES", why))?;
        if grid.dims != dims {
            let why = format!("{:?} positions along x, y and z, expected {dims:?}", grid.dims);
            return Err(self.error("COORDINATES", why));
        }
        Ok(grid)
    }
}
