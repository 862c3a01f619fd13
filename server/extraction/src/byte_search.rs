//! Finds how many triangles a budget of bytes allows, from trial surfaces that were encoded.

use isopeel_kernels::Surface;
use isopeel_view::View;
use isopeel_view::quality::{Budget, Fitted, TriangleBudget};

use super::WorkError;

/// Bytes of a triangle on the wire that the first trial assumes: between the 4 of a smooth surface and the 7 of a noisy one.
const FIRST_BYTES_PER_TRIANGLE: f64 = 5.0;

/// Estimated bytes of a region without its triangles: header, beginnings of the codecs' streams, and ghosts.
const BYTES_OF_REGION: f64 = 144.0;

/// Minimum share of a budget that a surface must take for the budget to count as filled.
const FILLED: f64 = 0.85;

/// Share of the budget that the second trial should take: the middle of the range that counts as filled.
const TARGET: f64 = (1.0 + FILLED) / 2.0;

/// Share of the budget that the regions may take without their triangles. If they take more, the estimate is uncertain, and the target is
/// lowered by [`CAUTION`] times the excess.
const LARGE_REGIONS: f64 = 0.25;
/// See [`LARGE_REGIONS`].
const CAUTION: f64 = 0.3;

/// If two trials exceed the budget, the next trial has the triangles of the smaller one divided by this number.
const SHRINK: u64 = 4;

/// A surface that was encoded.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    /// Triangles of the surface.
    pub triangles: u64,
    /// Bytes of the surface's chunks.
    pub bytes: u64,
    /// Regions of the surface that are not joined. Their number hardly changes with the triangles; that of joined ones does in proportion.
    pub regions: u64,
}

impl Trial {
    /// `bytes`: of the chunks of a surface.
    pub fn new(surface: &Surface, bytes: u64) -> Self {
        Self {
            triangles: surface.statistics.triangles,
            bytes,
            regions: surface.regions.iter().filter(|region| region.size == 0).count() as u64,
        }
    }
}

/// A search for the surface that fills a budget of bytes. The owner of the search makes and encodes the trial surfaces.
pub struct ByteSearch {
    budget: u64,
    trials: Vec<Trial>,
    /// The fit of each trial.
    fits: Vec<Fitted>,
    /// Triangles of the smallest surface that the guards allow; 0 until a smaller trial was refused.
    minimum: u64,
    /// Whether the current trial was refused.
    is_refused: bool,
}

impl ByteSearch {
    /// Begins a search.
    pub fn new(budget: u64) -> Self {
        Self {
            budget,
            trials: Vec::new(),
            fits: Vec::new(),
            minimum: 0,
            is_refused: false,
        }
    }

    /// Returns `view` with the budget of the surface to try next, which is at most `ceiling_triangles`; `None` if the search is over.
    pub fn next_trial(&self, view: &View, ceiling_triangles: u64) -> Option<View> {
        let triangles = self.next_triangles()?.min(ceiling_triangles);
        Some(View {
            budget: Some(Budget::Triangles(TriangleBudget::AtMost(triangles))),
            fitted: None,
            ..view.clone()
        })
    }

    /// Returns the triangles of the surface to try next; `None` if the search is over.
    fn next_triangles(&self) -> Option<u64> {
        next_triangles(self.budget, &self.trials).map(|triangles| triangles.max(self.minimum))
    }

    /// Records that a trial has failed. If the guards allow no surface that small, the next trial is the smallest surface that they allow.
    ///
    /// # Errors
    /// Returns `error` if another trial would fail as well.
    pub fn refuse(&mut self, error: WorkError) -> Result<(), WorkError> {
        match error {
            WorkError::OverBudget { minimum, .. } if !self.is_refused && self.next_triangles() < Some(minimum) => {
                (self.minimum, self.is_refused) = (minimum, true);
                Ok(())
            }
            error => Err(error),
        }
    }

    /// Returns the fit of a surface; `None` if an earlier trial had the same fit. Then further trials do not help: the surface is the full
    /// one, the smallest one, or one that an error decides.
    pub fn new_fit(&self, view: &View) -> Option<Fitted> {
        let fitted = view.fitted?;
        let is_same = |other: &Fitted| (other.threshold, other.topology) == (fitted.threshold, fitted.topology);
        (!self.fits.iter().any(is_same)).then_some(fitted)
    }

    /// Adds a surface that was encoded.
    pub fn add(&mut self, fitted: Fitted, trial: Trial) {
        let Trial {
            triangles,
            bytes,
            regions,
        } = trial;
        let budget = self.budget;
        tracing::debug!(
            budget,
            bytes,
            triangles,
            regions,
            "a surface was encoded for a budget of bytes"
        );
        self.fits.push(fitted);
        self.trials.push(trial);
        self.is_refused = false;
    }

    /// Returns the fit of the largest surface that keeps the budget.
    ///
    /// # Errors
    /// [`WorkError::OverBytes`] if no trial keeps the budget; [`WorkError::Stopped`] if there was no trial.
    pub fn end(self) -> Result<Fitted, WorkError> {
        if let Some(index) = best(self.budget, &self.trials) {
            return Ok(self.fits[index]);
        }
        let smallest = self.trials.iter().min_by_key(|trial| trial.bytes);
        Err(smallest.map_or(WorkError::Stopped, |smallest| WorkError::OverBytes {
            minimum: smallest.bytes,
            triangles: smallest.triangles,
            budget: self.budget,
        }))
    }
}

/// Returns the triangles of the surface to try next; `None` if the search is over. Two trials suffice unless both exceed the budget. Then
/// the search continues, because the result must keep the budget.
fn next_triangles(budget: u64, trials: &[Trial]) -> Option<u64> {
    let is_within = |trial: &Trial| trial.bytes <= budget;
    let is_filled = |trial: &Trial| is_within(trial) && trial.bytes as f64 >= FILLED * budget as f64;
    match trials {
        [] => Some(((budget as f64 / FIRST_BYTES_PER_TRIANGLE) as u64).max(1)),
        [first] if !is_filled(first) => Some(estimate(budget, first)),
        [_] => None,
        _ if trials.iter().any(is_within) => None,
        _ => {
            let fewest = trials.iter().map(|trial| trial.triangles).min().unwrap_or(0);
            Some(fewest / SHRINK).filter(|&triangles| triangles > 0)
        }
    }
}

/// Returns the index of the best trial that keeps the budget.
fn best(budget: u64, trials: &[Trial]) -> Option<usize> {
    let within = trials.iter().enumerate().filter(|(_, trial)| trial.bytes <= budget);
    within.max_by_key(|(_, trial)| trial.bytes).map(|(index, _)| index)
}

/// Estimates the triangles that fill the budget. Assumes that a triangle takes as many bytes as in the trial, and that the number of
/// regions that are not joined stays the same.
fn estimate(budget: u64, trial: &Trial) -> u64 {
    let budget = budget as f64;
    let region_bytes = BYTES_OF_REGION * trial.regions as f64;
    let triangle_bytes = (trial.bytes as f64 - region_bytes).max(1.0);
    let target_bytes = (TARGET - CAUTION * (region_bytes / budget - LARGE_REGIONS).max(0.0)) * budget;
    let triangles = (target_bytes - region_bytes) / triangle_bytes * trial.triangles as f64;
    // If the bytes of the regions alone exceed the target, the next trial has fewer triangles, which lie in fewer regions.
    let fewest = (trial.triangles / SHRINK).max(1);
    if region_bytes < target_bytes {
        (triangles as u64).max(1)
    } else {
        fewest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The trials of a search among surfaces of at most `full` triangles.
    fn search(budget: u64, full: u64, surface: impl Fn(u64) -> (u64, u64)) -> Vec<Trial> {
        let mut trials = Vec::new();
        while let Some(asked) = next_triangles(budget, &trials) {
            let triangles = asked.min(full);
            let (bytes, regions) = surface(triangles);
            let trial = Trial {
                triangles,
                bytes,
                regions,
            };
            trials.push(trial);
            assert!(trials.len() < 20, "{trials:?}");
        }
        trials
    }

    /// Bytes of `triangles` in `regions`: vertices and indices, headers, and ghosts on the regions' faces.
    fn bytes_of(triangles: u64, regions: u64, per_triangle: f64, ghosts: f64) -> u64 {
        let (triangles, regions) = (triangles as f64, regions as f64);
        (per_triangle * triangles + 96.0 * regions + ghosts * (triangles * regions).sqrt()) as u64
    }

    #[test]
    fn two_trials_fill_a_budget() {
        for regions in [1_u64, 10, 140, 1000] {
            for per_triangle in [2.5, 4.0, 5.0, 7.0] {
                for ghosts in [0.0, 6.0, 15.0] {
                    for budget in [100_000_u64, 400_000, 1_600_000, 25_000_000] {
                        let surface = |n| (bytes_of(n, regions, per_triangle, ghosts), regions);
                        // Else caution comes before filling.
                        if BYTES_OF_REGION * regions as f64 > LARGE_REGIONS * budget as f64 {
                            continue;
                        }
                        let trials = search(budget, u64::MAX, surface);
                        let best = best(budget, &trials).map(|place| trials[place].bytes);
                        let filled = best.is_some_and(|bytes| bytes * 100 >= budget * 85);
                        let case = (regions, per_triangle, ghosts, budget);
                        assert!(filled && trials.len() <= 2, "{case:?}: {trials:?}");
                    }
                }
            }
        }
    }

    /// Triangles, bytes and regions as they were measured, at budgets that differ from them by up to half.
    #[test]
    fn measured_surfaces_are_predicted() {
        let measured: [&[(u64, u64, u64)]; 8] = [
            &[(3999, 25_720, 17), (3077, 21_120, 17), (2841, 19_822, 17)],
            &[(19_999, 143_727, 147), (13_772, 107_238, 145)],
            &[(80_000, 456_244, 149), (69_425, 403_434, 149)],
            &[(19_999, 136_062, 144), (14_549, 107_451, 144), (13_402, 101_329, 144)],
            &[(319_999, 1_356_582, 144), (373_585, 1_507_833, 144)],
            &[(80_000, 464_147, 129), (68_242, 403_722, 129)],
            &[(19_466, 126_487, 153), (14_392, 98_345, 136)],
            &[(319_999, 1_654_694, 260), (306_280, 1_592_900, 260)],
        ];
        for surfaces in measured {
            let ((triangles, bytes, regions), others) = (surfaces[0], &surfaces[1..]);
            let first = Trial {
                triangles,
                bytes,
                regions,
            };
            for &(triangles, bytes, _) in others {
                // A budget whose target is these bytes.
                let budget = (bytes as f64 / TARGET) as u64;
                let estimate = estimate(budget, &first) as f64;
                let off = estimate / triangles as f64 - 1.0;
                assert!(off.abs() < 0.075, "{estimate}, expected {triangles}");
            }
        }
    }

    #[test]
    fn a_surface_that_fits_as_a_whole_is_not_searched_for_long() {
        let trials = search(1_000_000, 5000, |n| (bytes_of(n, 20, 5.0, 0.0), 20));
        assert!(trials.len() <= 2, "{trials:?}");
        assert_eq!(trials[best(1_000_000, &trials).expect("kept")].triangles, 5000);
    }

    #[test]
    fn a_budget_is_kept_where_it_can_be_and_otherwise_nothing_is_found() {
        // Regions that few triangles are left in, as those of a surface that spreads over the volume.
        let spread = |n: u64| (bytes_of(n, n.min(110), 9.0, 15.0), n.min(110));
        for budget in [500_u64, 2000, 8000, 20_000] {
            let trials = search(budget, u64::MAX, spread);
            let found = best(budget, &trials).expect("kept");
            assert!(trials[found].bytes <= budget, "{trials:?}");
        }
        let trials = search(1000, u64::MAX, |n| (bytes_of(n, 110, 5.0, 0.0), 110));
        assert_eq!(best(1000, &trials), None, "headers alone are more: {trials:?}");
    }
}
