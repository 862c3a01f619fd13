//! Regions of interest: parts of space in which importance is raised (`docs/algorithm.md#44-regions-of-interest`).

use crate::{Error, Result};

/// Most regions of interest that a cut may have; bounds the constant memory that its kernels need.
pub const MAX_INTERESTS: usize = 64;

/// Shape of a region of interest after it was moved to the origin and scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InterestShape {
    /// The unit ball.
    Ball,
    /// The cube from -1 to 1 along each axis.
    Cube,
}

/// A region of interest. Inside it, importance is at least the region's importance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interest {
    /// Its centre, in index space.
    pub centre: [f32; 3],
    /// Rows of the matrix that maps cells, relative to the centre, to the shape.
    pub rows: [[f32; 3]; 3],
    /// The shape.
    pub shape: InterestShape,
    /// In [0, 1].
    pub importance: f32,
}

impl Interest {
    /// # Errors
    /// A number that is not finite, or an importance that is not in [0, 1].
    fn check(&self) -> Result<()> {
        let invalid = |why: String| Err(Error::Invalid { what: "interest", why });
        if !self
            .centre
            .iter()
            .chain(self.rows.iter().flatten())
            .all(|x| x.is_finite())
        {
            return invalid(format!(
                "centre {:?} and rows {:?}, expected finite numbers",
                self.centre, self.rows
            ));
        }
        if !(0.0..=1.0).contains(&self.importance) {
            return invalid(format!("importance {}, expected 0 to 1", self.importance));
        }
        Ok(())
    }
}

/// # Errors
/// Too many regions of interest, or one that is not valid.
pub(crate) fn check(interest: &[Interest]) -> Result<()> {
    if interest.len() > MAX_INTERESTS {
        return Err(Error::Invalid {
            what: "interest",
            why: format!("{} regions, expected at most {MAX_INTERESTS}", interest.len()),
        });
    }
    interest.iter().try_for_each(Interest::check)
}
