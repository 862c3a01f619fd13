//! Grids whose samples are at uneven positions along the axes.

use crate::{Error, Grid, Result};

/// A grid with the lengths of its cells, if they are not the same along an axis. Features use these lengths for derivatives; everything
/// else uses the grid's spacing.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct RectilinearGrid {
    grid: Grid,
    /// Along x, y and z, world units; `None` if all are the grid's spacing.
    lengths: Option<[Vec<f32>; 3]>,
}

#[cfg(feature = "serde")]
crate::checked_serde!(RectilinearGrid, |grid| {
    Grid::new(grid.grid.dims, grid.grid.spacing)?;
    grid.lengths
        .clone()
        .map(|lengths| RectilinearGrid::uneven(grid.grid, lengths))
        .transpose()
});

impl From<Grid> for RectilinearGrid {
    fn from(grid: Grid) -> Self {
        Self { grid, lengths: None }
    }
}

impl RectilinearGrid {
    /// A grid with the lengths of all cells along x, y and z, world units.
    ///
    /// # Errors
    /// More or fewer lengths than cells along an axis, or one that is not finite and above 0.
    pub fn uneven(grid: Grid, lengths: [Vec<f32>; 3]) -> Result<Self> {
        let fail = |why: String| {
            Err(Error::Invalid {
                what: "lengths of cells",
                why,
            })
        };
        for ((axis, along), cells) in ["x", "y", "z"].into_iter().zip(&lengths).zip(grid.cells()) {
            if along.len() != cells as usize {
                return fail(format!("{} along {axis}, expected {cells}", along.len()));
            }
            let is_usable = |length: &&f32| **length > 0.0 && length.is_finite() && length.recip().is_finite();
            if let Some(length) = along.iter().find(|length| !is_usable(length)) {
                return fail(format!("{length} along {axis}, expected finite values above 0"));
            }
        }
        Ok(Self {
            grid,
            lengths: Some(lengths),
        })
    }

    /// Extent.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Lengths of the cells along x, y and z; `None` if all are the grid's spacing.
    pub fn lengths(&self) -> Option<&[Vec<f32>; 3]> {
        self.lengths.as_ref()
    }

    /// One over the lengths of the cells along x, then along y, then along z: `inverse_lengths` of `cl/lib/steps.h`.
    pub(crate) fn inverse_lengths(&self) -> Option<Vec<f32>> {
        let lengths = self.lengths.as_ref()?;
        Some(lengths.iter().flatten().map(|length| 1.0 / length).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_has_a_length() {
        let grid = Grid::new([3, 2, 2], [2.0, 1.0, 4.0]).expect("a grid");
        let with = |x: &[f32]| RectilinearGrid::uneven(grid, [x.to_vec(), vec![1.0], vec![4.0]]);
        let uneven = with(&[0.5, 2.0]).expect("a rectilinear grid");
        assert_eq!(uneven.inverse_lengths(), Some(vec![2.0, 0.5, 1.0, 0.25]));
        assert_eq!(RectilinearGrid::from(grid).inverse_lengths(), None);
        for (lengths, why) in [
            (&[0.5][..], "1 along x, expected 2"),
            (&[0.5, 0.0], "0 along x, expected finite values above 0"),
            (&[0.5, -1.0], "-1 along x"),
            (&[f32::INFINITY, 1.0], "inf along x"),
            (&[f32::NAN, 1.0], "NaN along x"),
            (&[1e-40, 1.0], "along x, expected finite"),
        ] {
            let error = with(lengths).expect_err("refused").to_string();
            assert!(error.contains(why), "{error}, expected {why}");
        }
    }
}
