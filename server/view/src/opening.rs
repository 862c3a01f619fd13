//! Chooses the isovalue with which a field opens, from the field's histogram, and states the reason.

use isopeel_kernels::Histogram;
use serde::Serialize;

/// The isovalue that a field opens with.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct OpeningIso {
    /// Isovalue, in the field's units.
    pub iso: f32,
    /// Stable code of the reason for this isovalue.
    pub reason: IsoReason,
    /// Reason for this isovalue, as text for users.
    pub explanation: String,
}

/// Rule by which an isovalue was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum IsoReason {
    /// The values are those of computed tomography: bone.
    Bone,
    /// The values are a few labels: all that is not background, which is the lowest one.
    Labels,
    /// The two classes of the histogram without the background's peak.
    BackgroundLeftOut,
    /// The two classes of the whole histogram.
    WholeHistogram,
    /// No isovalue has a surface: there are no two different values.
    NoSurface,
}

/// Hounsfield units at which bone begins: above soft tissue and blood with contrast agent, below thin and spongy bone.
const BONE: f64 = 300.0;
/// Minimum share of samples in bone. A smaller share is noise.
const MIN_BONE: f64 = 1e-3;
/// Minimum share of samples in air, if the file declares no unit. With less air, the values do not count as Hounsfield units.
const MIN_AIR: f64 = 0.02;
/// Number of the first bins in which the background's peak must be. The background is air, or the padding of a grid.
const MAX_PEAK: usize = 32;
/// Maximum number of bins from the peak's maximum to its end. A histogram that falls more slowly has no peak.
const MAX_PEAK_WIDTH: usize = 16;
/// A peak ends at the first bin whose count is below this share of the maximum.
const PEAK_END: f64 = 0.02;
/// Minimum share of the samples in a background.
const MIN_BACKGROUND: f64 = 0.25;
/// Minimum share of all samples that are outside of the background. Of these samples, it is also the minimum share that is beyond a valley.
const MIN_REST: f64 = 0.01;
/// Minimum number of bins with samples outside of the background. With fewer bins, the values are labels, and the background is one of
/// them.
const MIN_REST_BINS: usize = 8;
/// Number of bins with samples in a volume of labels. Two bins are a mask, and more than 16 are measured values.
const LABEL_BINS: std::ops::RangeInclusive<usize> = 3..=16;
/// Maximum number of consecutive bins with samples that counts as labels, if a bin has several whole numbers. A longer run is a peak.
const MAX_LABEL_RUN: usize = 4;
/// Minimum number of runs of consecutive bins with samples in a volume of many labels.
const MIN_LABEL_RUNS: usize = 4;
/// Minimum ratio between the counts of neighbouring bins that counts as rough. Bins of two and of three whole numbers differ by less.
const ROUGH: f64 = 2.4;
/// Tolerance of a bin's ends, in the values' unit.
const ROUNDING: f64 = 1e-3;
/// Bins of a valley have at most its lowest count multiplied by this number.
const VALLEY_FLOOR: f64 = 1.5;
/// Number of bins on each side of a bin that are averaged with the bin.
const SMOOTHING: usize = 2;

impl OpeningIso {
    /// Chooses an isovalue. `unit`: unit of the values, if the file declares one. `has_labels`: whether the file says that the values are
    /// labels. There are samples on both sides of the isovalue, unless all samples have the same value.
    pub fn of(histogram: &Histogram, unit: Option<&str>, has_labels: bool) -> Self {
        let bins = Bins::of(histogram);
        let choice = |value, reason, explanation| Self {
            iso: bins.inside_range(value),
            reason,
            explanation,
        };
        if has_labels && bins.low < f64::from(histogram.range[1]) {
            let why = "around all labels, of which the lowest is the background".to_owned();
            return choice(bins.low + 0.5, IsoReason::Labels, why);
        }
        if bins.is_hounsfield(unit) {
            let why = "bone, in the Hounsfield units of computed tomography".to_owned();
            return choice(BONE, IsoReason::Bone, why);
        }
        if bins.are_labels() || bins.are_many_labels() {
            let why = "around all labels: few different values, of which the lowest is the background".to_owned();
            return choice(bins.low + 0.5, IsoReason::Labels, why);
        }
        let background = bins.background();
        let without = |background| bins.otsu(background).map(|value| (background, value));
        if let Some((end, value)) = background.and_then(without) {
            let percent = (100.0 * bins.share(0, end)).round();
            let explanation =
                format!("between two classes of values, without the background ({percent} % of the samples)");
            return choice(value, IsoReason::BackgroundLeftOut, explanation);
        }
        match bins.otsu(0) {
            Some(value) => {
                let why = "between two classes of values".to_owned();
                choice(value, IsoReason::WholeHistogram, why)
            }
            None => {
                let why = "no isovalue has a surface, there are no two different values".to_owned();
                choice(bins.low, IsoReason::NoSurface, why)
            }
        }
    }
}

/// A histogram's bins, in double precision.
struct Bins<'a> {
    /// Minimum and maximum of the values.
    range: [f32; 2],
    low: f64,
    /// Width of a bin, in the values' unit.
    width: f64,
    counts: &'a [u64],
    /// Number of samples in all bins.
    total: f64,
}

impl<'a> Bins<'a> {
    fn of(histogram: &'a Histogram) -> Self {
        let [low, high] = histogram.range.map(f64::from);
        Self {
            range: histogram.range,
            low,
            width: (high - low) / histogram.bins.len().max(1) as f64,
            counts: &histogram.bins,
            total: histogram.bins.iter().sum::<u64>() as f64,
        }
    }

    /// Returns the value at which a bin begins.
    fn start(&self, bin: f64) -> f64 {
        self.low + bin * self.width
    }

    /// Returns the value at the centre of a bin.
    fn centre(&self, bin: usize) -> f64 {
        self.start(bin as f64 + 0.5)
    }

    /// Returns the share of the samples in the bins `from..to`.
    fn share(&self, from: usize, to: usize) -> f64 {
        let to = to.min(self.counts.len());
        let counts = self.counts.get(from..to).unwrap_or_default();
        counts.iter().sum::<u64>() as f64 / self.total.max(1.0)
    }

    /// Clamps a value to above the minimum, so that samples of the minimum are outside, and to at most the maximum, so that samples of the
    /// maximum are inside.
    fn inside_range(&self, value: f64) -> f32 {
        let [low, high] = self.range;
        let value = value as f32;
        if value <= low {
            low.next_up().min(high)
        } else {
            value.min(high)
        }
    }

    /// Whether the values are Hounsfield units, and some are bone. If the file declares no unit, the values decide: there must be air at
    /// -1000, padding at or below that, and most of the other samples in soft tissue or fat, around 0.
    fn is_hounsfield(&self, unit: Option<&str>) -> bool {
        let overlaps = |bin: usize, from: f64, to: f64| {
            let centre = self.centre(bin);
            centre + self.width / 2.0 >= from && centre - self.width / 2.0 <= to
        };
        let bins = || 0..self.counts.len();
        let bone = bins().find(|&bin| self.start(bin as f64) >= BONE);
        let has_bone = bone.is_some_and(|bin| self.share(bin, self.counts.len()) >= MIN_BONE);
        if !has_bone || self.low >= BONE {
            return false;
        }
        match unit.map(|unit| unit.trim().to_lowercase()) {
            Some(unit) if unit == "hu" || unit.contains("hounsfield") => return true,
            Some(unit) if !unit.is_empty() => return false,
            _ => {}
        }
        let air = bins().filter(|&bin| overlaps(bin, -1100.0, -900.0));
        let air = air.map(|bin| self.share(bin, bin + 1)).sum::<f64>();
        let mode = bins()
            .filter(|&bin| self.centre(bin) > -500.0)
            .max_by_key(|&bin| self.counts[bin]);
        let is_tissue = mode.is_some_and(|bin| overlaps(bin, -150.0, 150.0));
        let has_range = (-4096.0..=-900.0).contains(&self.low) && self.range[1] >= 1000.0;
        has_range && air >= MIN_AIR && is_tissue
    }

    /// Whether the values are labels: few different whole numbers, the lowest of which is the background. If a bin has several whole
    /// numbers, the bins are weaker evidence. Then a peak, or too few samples outside of the background, mean measured values.
    fn are_labels(&self) -> bool {
        let occupied: Vec<usize> = (0..self.counts.len()).filter(|&bin| self.counts[bin] > 0).collect();
        let is_whole = |value: f32| value.fract() == 0.0;
        if !self.range.into_iter().all(is_whole)
            || !LABEL_BINS.contains(&occupied.len())
            || self.share(0, 1) < MIN_BACKGROUND
        {
            return false;
        }
        if self.width <= 1.0 {
            let has_whole =
                |&bin: &usize| (self.start(bin as f64) - ROUNDING).ceil() <= self.start(bin as f64 + 1.0) + ROUNDING;
            return occupied.iter().all(has_whole);
        }
        let mut runs = occupied.chunk_by(|a, b| a + 1 == *b);
        let first = runs.clone().next().map_or(0, <[usize]>::len);
        runs.all(|run| run.len() <= MAX_LABEL_RUN) && self.share(first, self.counts.len()) >= MIN_REST
    }

    /// Whether the values are many labels with gaps between them. Measured values have similar counts in neighbouring bins, and labels do
    /// not. Bins with more samples have more weight.
    fn are_many_labels(&self) -> bool {
        let occupied: Vec<usize> = (0..self.counts.len()).filter(|&bin| self.counts[bin] > 0).collect();
        let runs = occupied.chunk_by(|a, b| a + 1 == *b).count();
        let is_whole = |value: f32| value.fract() == 0.0;
        if !self.range.into_iter().all(is_whole) || runs < MIN_LABEL_RUNS || self.share(0, 1) < MIN_BACKGROUND {
            return false;
        }
        let pairs = occupied.windows(2).skip(1).map(|pair| {
            let [a, b] = [self.counts[pair[0]], self.counts[pair[1]]].map(|count| count as f64);
            ((a / b).max(b / a), a + b)
        });
        let (mut rough_weight, mut total_weight) = (0.0, 0.0);
        for (ratio, weight) in pairs {
            total_weight += weight;
            if ratio >= ROUGH {
                rough_weight += weight;
            }
        }
        rough_weight > 0.5 * total_weight
    }

    /// Returns the bin at which the background's peak ends, or the valley behind the peak. `None` if there is no such peak: a peak must be
    /// high, narrow and at the low end, and there must be enough samples beside it.
    fn background(&self) -> Option<usize> {
        let counts = self.counts;
        let (peak, &height) = counts
            .iter()
            .enumerate()
            .max_by_key(|&(bin, &count)| (count, std::cmp::Reverse(bin)))?;
        let has_ended = |count: u64| (count as f64) < PEAK_END * height as f64;
        let width = counts[peak..].iter().position(|&count| has_ended(count))?;
        let end = peak + width;
        let outside = &counts[end..];
        let occupied = outside.iter().filter(|&&count| count > 0).count();
        let is_background = peak < MAX_PEAK
            && width <= MAX_PEAK_WIDTH
            && self.share(0, end) >= MIN_BACKGROUND
            && self.share(end, counts.len()) >= MIN_REST
            && occupied >= MIN_REST_BINS;
        is_background.then(|| self.valley(end).unwrap_or(end))
    }

    /// Returns the end of the valley between the background's peak, which ends at `end`, and the highest peak after it. `None` unless there
    /// are samples beyond that second peak. Values in the valley are partly background, and would otherwise become a class.
    fn valley(&self, end: usize) -> Option<usize> {
        let counts = &self.counts[end..];
        let average = |bin: usize| {
            let window = &counts[bin.saturating_sub(SMOOTHING)..(bin + SMOOTHING + 1).min(counts.len())];
            window.iter().sum::<u64>() as f64 / window.len() as f64
        };
        let smooth: Vec<f64> = (0..counts.len()).map(average).collect();
        let next_peak = (1..smooth.len()).fold(0, |best, bin| if smooth[bin] > smooth[best] { bin } else { best });
        let floor = smooth[..=next_peak].iter().copied().fold(f64::INFINITY, f64::min);
        let valley = smooth[..=next_peak]
            .iter()
            .rposition(|&count| count <= VALLEY_FLOOR * floor)?;
        let beyond = self.share(end + 2 * next_peak - valley, self.counts.len());
        (beyond >= MIN_REST * self.share(end, self.counts.len())).then_some(end + valley)
    }

    /// Returns Otsu's threshold (1979) of the bins from `first` on. It maximizes the variance between the classes below and above the
    /// threshold. Thresholds without samples between them are equally good; then returns their middle. `None` if fewer than two bins have
    /// samples.
    fn otsu(&self, first: usize) -> Option<f64> {
        let counts = || self.counts.iter().enumerate().skip(first);
        let total: f64 = counts().map(|(_, &count)| count as f64).sum();
        // Computes in bins, so that no sum overflows.
        let total_sum: f64 = counts().map(|(bin, &count)| count as f64 * bin as f64).sum();
        let (mut below, mut below_sum) = (0.0, 0.0);
        let (mut best, mut best_bins) = (0.0, None);
        for (bin, &count) in counts() {
            below += count as f64;
            below_sum += count as f64 * bin as f64;
            let above = total - below;
            if below == 0.0 || above == 0.0 {
                continue;
            }
            let difference = below_sum / below - (total_sum - below_sum) / above;
            let variance = below * above * difference * difference;
            match &mut best_bins {
                Some((_, last)) if count == 0 && *last + 1 == bin => *last = bin,
                _ if variance > best => (best, best_bins) = (variance, Some((bin, bin))),
                _ => {}
            }
        }
        best_bins.map(|(first, last)| self.start((first + last) as f64 / 2.0 + 1.0))
    }
}

#[cfg(test)]
mod tests;
