//! Budgets of triangles: which β or tolerance keeps them (`docs/algorithm.md#42-budgets`).

use crate::cancel::check_cancelled;
use crate::stages::cut::Criterion;
use crate::stages::fit::{self, INNER_BINS, Keys};
use crate::{Cancel, Cut, CutParams, Engine, Level, Pyramid, Result, Volume};

/// Share of a triangle budget from which [`Engine::fit`] counts it as used and stops searching.
pub const BUDGET_FIT: f64 = 0.97;

/// Share of a triangle budget below which it is not used: the search goes on.
const MIN_BUDGET_FIT: f64 = 0.95;

/// Exact counts of one search: at most `COUNTS` once the budget is nearly used, at most `MAX_COUNTS` otherwise.
const COUNTS: usize = 4;
const MAX_COUNTS: usize = 10;

/// Triangles of a leaf, before any is counted: a closed surface has twice as many triangles as vertices.
const TRIANGLES_PER_LEAF: f64 = 2.0;

/// Triangles that a further leaf adds to a cut, before two cuts are counted. Measured: 1.9 to 2.5.
const TRIANGLES_PER_FURTHER_LEAF: f64 = 2.3;
/// Share of the wanted triangles up to which a cut's number may differ from them so that the next cut is found by the further leaves.
const NEAR: f64 = 0.3;

/// Cuts of fewer leaves than the budget has triangles, divided by this number, may keep the budget.
const MIN_TRIANGLES_PER_LEAF: f64 = 1.5;
/// As [`MIN_TRIANGLES_PER_LEAF`], of the triangles of a leaf of the full surface.
const MIN_SHARE_PER_LEAF: f64 = 0.75;

/// Importance below 2^-20 is rounding; above it, a bin of 2^16 keys spans less than a hundredth of its importance.
pub(super) const IMPORTANCE_KEYS: Keys = Keys {
    first: (127 - 20) << 23,
    shift: 16,
};

/// Errors from 2^-40 to 2^40 world units.
pub(crate) const ERROR_KEYS: Keys = Keys {
    first: (127 - 40) << 23,
    shift: 18,
};

/// A bin that holds more than this share of the wanted leaves is divided once more.
const COARSE_BIN: f64 = 0.01;

/// Leaves of the cuts of a pyramid as a function of the threshold, from all of them downwards.
struct Curve {
    keys: Keys,
    /// Leaves if the threshold is the last key of each bin, from the one before the first inner bin.
    leaves: Vec<i64>,
}

impl Curve {
    /// The first bin with at most `leaves` leaves; `None` if every bin has more.
    fn bin(&self, leaves: i64) -> Option<usize> {
        let bin = self.leaves.partition_point(|&n| n > leaves);
        (bin <= INNER_BINS).then_some(bin)
    }

    /// Threshold of a bin.
    fn threshold(&self, bin: usize) -> f32 {
        f32::from_bits(self.keys.first + ((bin as u32) << self.keys.shift) - 1)
    }
}

/// Bracket of the search: the leaf counts tried so far and their outcomes. The triangles per leaf differ from cut to cut, so a search
/// that used the last cut's ratio alone could oscillate.
struct Bracket {
    /// The most leaves within the budget, and the fewest beyond it.
    fits: f64,
    exceeds: f64,
    /// Thresholds, and whether their triangles are within the budget.
    tried: Vec<(f32, bool)>,
}

impl Default for Bracket {
    fn default() -> Self {
        Self {
            fits: 0.0,
            exceeds: f64::INFINITY,
            tried: Vec::new(),
        }
    }
}

impl Bracket {
    /// Number of leaves to try next: `leaves`, or the middle of the bracket if the outcome of `leaves` is already known.
    fn within(&self, leaves: f64) -> f64 {
        let is_open = self.fits < leaves && leaves < self.exceeds;
        if is_open || self.exceeds.is_infinite() {
            return leaves.max(self.fits * 1.01);
        }
        (self.fits + self.exceeds) / 2.0
    }

    fn add(&mut self, leaves: f64, threshold: f32, fits: bool) {
        self.tried.push((threshold, fits));
        if fits {
            self.fits = self.fits.max(leaves);
        } else {
            self.exceeds = self.exceeds.min(leaves);
        }
    }

    /// Returns whether `threshold` was tried before. If so, records its outcome for `leaves` leaves too.
    fn knows(&mut self, leaves: f64, threshold: f32) -> bool {
        let known = self
            .tried
            .iter()
            .find(|(tried, _)| *tried == threshold)
            .map(|(_, fits)| *fits);
        if let Some(fits) = known {
            self.add(leaves, threshold, fits);
        }
        known.is_some()
    }
}

/// Leaves and triangles of the last two cuts that were counted.
#[derive(Default)]
struct Counted {
    last: Option<[f64; 2]>,
    before: Option<[f64; 2]>,
}

impl Counted {
    fn add(&mut self, leaves: u64, triangles: u64) {
        self.before = self.last.replace([leaves.max(1) as f64, triangles as f64]);
    }

    /// Returns the leaves of a cut of this number of triangles.
    fn leaves_of(&self, wanted: f64) -> f64 {
        let Some([leaves, triangles]) = self.last else {
            return wanted / TRIANGLES_PER_LEAF;
        };
        if (triangles - wanted).abs() > NEAR * wanted {
            return wanted / (triangles / leaves);
        }
        let between = self.before.map(|before| (triangles - before[1]) / (leaves - before[0]));
        let is_likely = |slope: &f64| (0.5..8.0).contains(slope);
        leaves + (wanted - triangles) / between.filter(is_likely).unwrap_or(TRIANGLES_PER_FURTHER_LEAF)
    }
}

impl Engine {
    /// Whether a cut within the guards may have at most `max_triangles`. If not, the coarsest one has so many leaves that counting its
    /// triangles is not worthwhile. As [`Engine::fit`], varies the tolerance or β.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn may_fit(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams, max_triangles: u64) -> Result<bool> {
        let keys = match params.tolerance {
            Some(_) => ERROR_KEYS,
            None => IMPORTANCE_KEYS,
        };
        let curve = self.curve(volume, pyramid, params, keys, pyramid.active_cells)?;
        let of_full = pyramid.full_triangles as f64 / pyramid.active_cells.max(1) as f64;
        let per_leaf = MIN_TRIANGLES_PER_LEAF.min(MIN_SHARE_PER_LEAF * of_full);
        Ok(curve.leaves[INNER_BINS] as f64 * per_leaf <= max_triangles as f64)
    }

    /// Returns the parameters whose surface has at most `max_triangles` and nearly as many, that cut, and its triangles. The search varies
    /// the tolerance if `params` have one, otherwise β; the guards of `params` stay in force. If even the coarsest cut has more triangles,
    /// returns that one.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn fit(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        max_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<(CutParams, Cut, u64)> {
        let with = |threshold: f32| match params.tolerance {
            Some(_) if threshold >= 0.0 => CutParams {
                tolerance: Some(threshold),
                ..params.clone()
            },
            // Without a tolerance, or if nothing is decimated (threshold -1).
            _ => CutParams {
                beta: threshold,
                tolerance: None,
                ..params.clone()
            },
        };
        let counted = |threshold: f32| {
            check_cancelled(cancel)?;
            let cut = self.cut(volume, pyramid, &with(threshold), Level::FINEST)?;
            let triangles = self.count(volume, pyramid, &cut, cancel)?.triangles;
            Ok::<_, crate::Error>((triangles, threshold, cut))
        };
        let (keys, coarsest) = match params.tolerance {
            Some(_) => (ERROR_KEYS, f32::MAX),
            None => (IMPORTANCE_KEYS, 1.0),
        };
        let curve = self.curve(volume, pyramid, params, keys, pyramid.active_cells)?;
        let mut known = Counted::default();
        // The trial with the most triangles within the budget.
        let mut best: Option<(u64, f32, Cut)> = None;
        let mut bracket = Bracket::default();
        // Aims at the middle of the range that counts as used, and lower if that still exceeded the budget.
        let mut aim = (1.0 + BUDGET_FIT) / 2.0;
        for count in 0..MAX_COUNTS {
            let used = best.as_ref().map_or(0.0, |best| best.0 as f64 / max_triangles as f64);
            if count >= COUNTS && used >= MIN_BUDGET_FIT {
                break;
            }
            let leaves = bracket.within(known.leaves_of(aim * max_triangles as f64));
            let threshold = self
                .threshold_of(volume, pyramid, params, &curve, leaves)?
                .unwrap_or(coarsest);
            if bracket.knows(leaves, threshold) {
                continue;
            }
            let trial = counted(threshold)?;
            let (triangles, found) = (trial.0, trial.2.leaves().iter().sum::<u64>());
            let fits = triangles <= max_triangles;
            bracket.add(leaves, threshold, fits);
            if fits {
                let is_used = triangles as f64 >= BUDGET_FIT * max_triangles as f64 || threshold < 0.0;
                if best.as_ref().is_none_or(|best| best.0 < triangles) {
                    best = Some(trial);
                }
                if is_used {
                    break;
                }
            } else {
                aim *= 0.995;
            }
            known.add(found, triangles);
        }
        let (triangles, threshold, cut) = match best {
            Some(best) => best,
            None => counted(coarsest)?,
        };
        Ok((with(threshold), cut, triangles))
    }

    /// Threshold of the finest cut within the given number of leaves; -1 if all may stay, `None` if every cut has more.
    fn threshold_of(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        curve: &Curve,
        leaves: f64,
    ) -> Result<Option<f32>> {
        if pyramid.active_cells as f64 <= leaves {
            return Ok(Some(-1.0));
        }
        let wanted = leaves as i64;
        let Some(bin) = curve.bin(wanted) else { return Ok(None) };
        let before = if bin == 0 {
            pyramid.active_cells as i64
        } else {
            curve.leaves[bin - 1]
        };
        if bin == 0 || (before - curve.leaves[bin]) as f64 <= COARSE_BIN * leaves {
            return Ok(Some(curve.threshold(bin)));
        }
        let inner = Keys {
            first: curve.keys.first + ((bin as u32 - 1) << curve.keys.shift),
            // As many bins as there are, at most one key each.
            shift: curve.keys.shift.saturating_sub(INNER_BINS.ilog2()),
        };
        let inner = self.curve(volume, pyramid, params, inner, pyramid.active_cells)?;
        Ok(inner.bin(wanted).map(|bin| inner.threshold(bin)))
    }

    /// The curve as pairs of β and leaves.
    #[cfg(any(test, feature = "testing"))]
    pub(crate) fn leaves_by_beta(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
    ) -> Result<Vec<(f32, i64)>> {
        let curve = self.curve(volume, pyramid, params, IMPORTANCE_KEYS, pyramid.active_cells)?;
        Ok((0..curve.leaves.len())
            .map(|bin| (curve.threshold(bin), curve.leaves[bin]))
            .collect())
    }

    fn curve(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams, keys: Keys, cells: u64) -> Result<Curve> {
        let criterion = Criterion::upload(&self.cx, params, Level::FINEST)?;
        let (changes, _) = fit::run(&self.cx, volume, pyramid, &criterion, keys)?;
        let mut leaves = cells as i64;
        let leaves = changes[..=INNER_BINS].iter().map(|&change| {
            leaves += i64::from(change);
            leaves
        });
        Ok(Curve {
            keys,
            leaves: leaves.collect(),
        })
    }
}
