//! Cuts of cubes for a view: fitted to its budget, and refused if their surface would be too large.

use isopeel_kernels::{Cancel, Cut, CutParams, Error, Level, Topology};
use isopeel_view::View;
use isopeel_view::quality::{Fitted, TopologyName};

use super::WorkError;
use super::on_device::OnDevice;

/// A leaf emits at most a quad around each of its twelve edges; marching cubes makes five triangles of a leaf at most.
const MAX_TRIANGLES_PER_LEAF: u64 = 24;

impl OnDevice<'_> {
    /// Returns the cut of cubes of a view, and its parameters. Fits a budget of triangles. Also fits it again if the existing fit was made
    /// for the vertex tree, which is no longer available. Ignores a budget of bytes that has not been fitted.
    ///
    /// # Errors
    /// [`WorkError::OverBudget`] if the smallest cut exceeds the budget, and the device's errors.
    fn target(&self, view: &mut View, cancel: &dyn Cancel) -> Result<(CutParams, Cut), WorkError> {
        let budget = view.max_triangles(self.pyramid.full_triangles());
        let fitted = view.fitted.filter(|fitted| !fitted.is_tree_cut);
        if let (Some(budget), None) = (budget, fitted) {
            let params = self.params_of(&View {
                fitted: None,
                ..view.clone()
            });
            let fitted = self.fitted(&params, budget, cancel)?;
            let gives_way = fitted.2 > budget && view.topology == TopologyName::Auto;
            let (params, cut, minimum) = if gives_way {
                let free = CutParams {
                    topology: Topology::Free,
                    ..params
                };
                self.fitted(&free, budget, cancel)?
            } else {
                fitted
            };
            if minimum == 0 && self.pyramid.full_triangles() > 0 {
                let minimum = self.smallest(&params, budget, cancel)?;
                return Err(WorkError::OverBudget { minimum, budget });
            }
            if minimum > budget {
                return Err(WorkError::OverBudget { minimum, budget });
            }
            view.fitted = Some(Fitted {
                threshold: params.tolerance.unwrap_or(params.beta),
                topology: params.topology,
                triangles: budget,
                is_tree_cut: false,
            });
            return Ok((params, cut));
        }
        let params = self.params_of(view);
        let cut = self.engine.cut(self.volume, self.pyramid, &params, Level::FINEST)?;
        Ok((params, cut))
    }

    /// As [`OnDevice::target`], but refuses a surface of more than `ceiling` triangles. The view is unchanged if it is refused.
    ///
    /// # Errors
    /// [`WorkError::TooManyTriangles`], and those of [`OnDevice::target`].
    pub(crate) fn target_within(
        &self,
        view: &mut View,
        ceiling: u64,
        cancel: &dyn Cancel,
    ) -> Result<(CutParams, Cut), WorkError> {
        let before = view.fitted;
        let (params, cut) = self.target(view, cancel)?;
        self.check_ceiling(&cut, ceiling, cancel)
            .inspect_err(|_| view.fitted = before)?;
        Ok((params, cut))
    }

    /// Returns the triangles of the smallest surface of cubes that is not empty, given that every surface within the budget is empty.
    fn smallest(&self, params: &CutParams, budget: u64, cancel: &dyn Cancel) -> Result<u64, Error> {
        let mut asked = budget;
        while asked < self.pyramid.full_triangles() {
            asked *= 2;
            let (_, _, triangles) = self.fitted(params, asked, cancel)?;
            if triangles > 0 {
                return Ok(triangles.max(budget + 1));
            }
        }
        Ok(self.pyramid.full_triangles())
    }

    /// Returns the parameters and the cut that keep a budget, and the number of triangles. A requested error is the minimum tolerance.
    fn fitted(&self, params: &CutParams, budget: u64, cancel: &dyn Cancel) -> Result<(CutParams, Cut, u64), Error> {
        let (engine, volume, pyramid) = (self.engine, self.volume, self.pyramid);
        let (fitted, cut, triangles) = engine.fit(volume, pyramid, params, budget, cancel)?;
        let (Some(error), found) = (params.tolerance, fitted.tolerance.unwrap_or(-1.0)) else {
            return Ok((fitted, cut, triangles));
        };
        if found >= error {
            return Ok((fitted, cut, triangles));
        }
        let cut = engine.cut(volume, pyramid, params, Level::FINEST)?;
        let triangles = engine.count(volume, pyramid, &cut, cancel)?.triangles;
        Ok((params.clone(), cut, triangles))
    }

    /// Refuses a surface of more than `ceiling` triangles before it is made. Counts triangles only if the number of leaves does not decide.
    fn check_ceiling(&self, cut: &Cut, ceiling: u64, cancel: &dyn Cancel) -> Result<(), WorkError> {
        if cut.leaves().iter().sum::<u64>().saturating_mul(MAX_TRIANGLES_PER_LEAF) <= ceiling {
            return Ok(());
        }
        match self.engine.count(self.volume, self.pyramid, cut, cancel)?.triangles {
            triangles if triangles > ceiling => Err(WorkError::TooManyTriangles { triangles, ceiling }),
            _ => Ok(()),
        }
    }
}
