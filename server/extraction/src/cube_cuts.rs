//! Cuts of cubes for a view. They are fitted to its budget, and refused if their surface would be too large.

use isopeel_kernels::{Cancel, Cut, CutParams, Error, Level, Topology};
use isopeel_view::View;
use isopeel_view::quality::{Fitted, TopologyName};

use super::WorkError;
use super::on_device::OnDevice;

/// Maximum triangles that either mesher makes per leaf. Dual contouring makes at most a quad for each of the twelve edges of a leaf,
/// marching cubes at most five triangles.
const MAX_TRIANGLES_PER_LEAF: u64 = 24;

impl OnDevice<'_> {
    /// Returns the cut of cubes of a view, and its parameters. If the view has a budget of triangles that is not fitted yet, or was fitted
    /// to the vertex tree, fits it to cubes and stores the result in the view. Ignores a budget of bytes that has not been fitted.
    ///
    /// # Errors
    /// [`WorkError::OverBudget`] if the smallest cut exceeds the budget, and the device's errors.
    fn fitted_cut(&self, view: &mut View, cancel: &dyn Cancel) -> Result<(CutParams, Cut), WorkError> {
        let full_triangles = self.pyramid.full_triangles();
        let fitted = view.fitted.filter(|fitted| !fitted.is_tree_cut);
        let (Some(budget), None) = (view.max_triangles(full_triangles), fitted) else {
            let params = self.params_of(view);
            let cut = self.engine.cut(self.volume, self.pyramid, &params, Level::FINEST)?;
            return Ok((params, cut));
        };
        let unfitted = self.params_of(&View {
            fitted: None,
            ..view.clone()
        });
        let may_give_way = view.topology == TopologyName::Auto && unfitted.topology != Topology::Free;
        let free = CutParams {
            topology: Topology::Free,
            ..unfitted.clone()
        };
        let is_free = may_give_way && !self.engine.may_fit(self.volume, self.pyramid, &unfitted, budget)?;
        let (mut params, mut cut, mut triangles) = self.fit(if is_free { &free } else { &unfitted }, budget, cancel)?;
        if triangles > budget && may_give_way && !is_free {
            (params, cut, triangles) = self.fit(&free, budget, cancel)?;
        }
        let is_empty = triangles == 0 && full_triangles > 0;
        if is_empty || triangles > budget {
            let minimum = if is_empty {
                self.smallest_surface(&params, budget, cancel)?
            } else {
                triangles
            };
            return Err(WorkError::OverBudget { minimum, budget });
        }
        view.fitted = Some(Fitted {
            threshold: params.tolerance.unwrap_or(params.beta),
            topology: params.topology,
            triangles: budget,
            is_tree_cut: false,
            pixels: None,
        });
        Ok((params, cut))
    }

    /// As [`OnDevice::fitted_cut`], but refuses a surface of more than `ceiling` triangles. If the surface is refused, the view is
    /// unchanged.
    ///
    /// # Errors
    /// [`WorkError::TooManyTriangles`], and those of [`OnDevice::fitted_cut`].
    pub(crate) fn cut_within(
        &self,
        view: &mut View,
        ceiling: u64,
        cancel: &dyn Cancel,
    ) -> Result<(CutParams, Cut), WorkError> {
        let before = view.fitted;
        let (params, cut) = self.fitted_cut(view, cancel)?;
        self.check_ceiling(&cut, ceiling, cancel)
            .inspect_err(|_| view.fitted = before)?;
        Ok((params, cut))
    }

    /// Returns the number of triangles of the smallest surface of cubes that is not empty. Called only if every surface within the budget
    /// is empty.
    fn smallest_surface(&self, params: &CutParams, budget: u64, cancel: &dyn Cancel) -> Result<u64, Error> {
        let mut larger_budget = budget;
        while larger_budget < self.pyramid.full_triangles() {
            larger_budget *= 2;
            let (_, _, triangles) = self.fit(params, larger_budget, cancel)?;
            if triangles > 0 {
                return Ok(triangles.max(budget + 1));
            }
        }
        Ok(self.pyramid.full_triangles())
    }

    /// Returns the parameters and the cut that keep a budget, and the number of triangles. The tolerance is not below that of `params`,
    /// because a requested error may allow fewer triangles than the budget.
    fn fit(&self, params: &CutParams, budget: u64, cancel: &dyn Cancel) -> Result<(CutParams, Cut, u64), Error> {
        let (engine, volume, pyramid) = (self.engine, self.volume, self.pyramid);
        let (fitted, cut, triangles) = engine.fit(volume, pyramid, params, budget, cancel)?;
        // `fitted` has no tolerance if nothing is decimated.
        if params
            .tolerance
            .is_none_or(|error| fitted.tolerance.is_some_and(|fitted_error| fitted_error >= error))
        {
            return Ok((fitted, cut, triangles));
        }
        let cut = engine.cut(volume, pyramid, params, Level::FINEST)?;
        let triangles = engine.count(volume, pyramid, &cut, cancel)?.triangles;
        Ok((params.clone(), cut, triangles))
    }

    /// Refuses a surface of more than `ceiling` triangles before it is made. Counts the triangles only if the number of leaves does not
    /// rule out that there are too many.
    fn check_ceiling(&self, cut: &Cut, ceiling: u64, cancel: &dyn Cancel) -> Result<(), WorkError> {
        if cut.leaves().iter().sum::<u64>().saturating_mul(MAX_TRIANGLES_PER_LEAF) <= ceiling {
            return Ok(());
        }
        let triangles = self.engine.count(self.volume, self.pyramid, cut, cancel)?.triangles;
        if triangles > ceiling {
            return Err(WorkError::TooManyTriangles { triangles, ceiling });
        }
        Ok(())
    }
}
