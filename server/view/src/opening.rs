//! The isovalue that a field opens with, from its histogram, and why it is that one.

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
    /// Why it is that one, for programs.
    pub reason: IsoReason,
    /// Why it is that one, for people.
    pub explanation: String,
}

/// What an isovalue was chosen by.
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
/// Minimum share of bone; less is noise.
const MIN_BONE: f64 = 1e-3;
/// Minimum share of air for values to be taken for Hounsfield units if the file declares no unit.
const MIN_AIR: f64 = 0.02;
/// The background's peak lies within this many of the first bins. It is air, or the padding of a grid.
const MAX_PEAK: usize = 32;
/// Maximum bins from the peak's maximum to its end. A histogram that falls more slowly has no peak there.
const MAX_PEAK_WIDTH: usize = 16;
/// A peak ends at the first bin whose count is below this share of the maximum.
const PEAK_END: f64 = 0.02;
/// Minimum share of the samples in a background.
const MIN_BACKGROUND: f64 = 0.25;
/// Minimum share of all samples outside of the background. Also the minimum share of those samples in the class beyond a valley.
const MIN_REST: f64 = 0.01;
/// Minimum bins with samples outside of the background. With fewer, the values are labels, of which the background is one.
const MIN_REST_BINS: usize = 8;
/// Number of bins with samples in a volume of labels. Two bins are a mask, and more are measured values.
const LABEL_BINS: std::ops::RangeInclusive<usize> = 3..=16;
/// Maximum run of consecutive bins with samples that is taken for labels if a bin has several whole numbers. A longer run is a peak.
const MAX_LABEL_RUN: usize = 4;
/// Minimum runs of consecutive bins with samples in a volume of many labels.
const MIN_LABEL_RUNS: usize = 4;
/// Minimum ratio between the counts of neighbouring bins that is rough. Bins of two and of three whole numbers differ by less.
const ROUGH: f64 = 2.4;
/// Tolerance of a bin's ends, in the values' unit.
const ROUNDING: f64 = 1e-3;
/// A valley is level up to this multiple of its lowest bin.
const VALLEY_FLOOR: f64 = 1.5;
/// Bins on each side of a bin that are averaged with it.
const SMOOTHING: usize = 2;

impl OpeningIso {
    /// Chooses an isovalue. `unit` is that of the values, if the file declares one; `has_labels` is whether the file says that they are
    /// labels. There are samples on both sides of the isovalue, unless all have the same value.
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
    range: [f32; 2],
    low: f64,
    width: f64,
    counts: &'a [u64],
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

    fn centre(&self, bin: usize) -> f64 {
        self.start(bin as f64 + 0.5)
    }

    /// Returns the share of the samples in the bins `from..to`.
    fn share(&self, from: usize, to: usize) -> f64 {
        let to = to.min(self.counts.len());
        let counts = self.counts.get(from..to).unwrap_or_default();
        counts.iter().sum::<u64>() as f64 / self.total.max(1.0)
    }

    /// Clamps a value so that it is above the minimum, whose samples are then outside, and at most the maximum, whose samples are inside.
    fn inside_range(&self, value: f64) -> f32 {
        let [low, high] = self.range;
        let value = value as f32;
        if value <= low {
            low.next_up().min(high)
        } else {
            value.min(high)
        }
    }

    /// Whether the values are Hounsfield units with bone. If the file declares no unit, the values decide: air at -1000, padding at or
    /// below it, and most of the rest in soft tissue or fat, around 0.
    fn is_hounsfield(&self, unit: Option<&str>) -> bool {
        let near = |bin: usize, from: f64, to: f64| {
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
        let air = bins().filter(|&bin| near(bin, -1100.0, -900.0));
        let air = air.map(|bin| self.share(bin, bin + 1)).sum::<f64>();
        let mode = bins()
            .filter(|&bin| self.centre(bin) > -500.0)
            .max_by_key(|&bin| self.counts[bin]);
        let is_tissue = mode.is_some_and(|bin| near(bin, -150.0, 150.0));
        let reaches = (-4096.0..=-900.0).contains(&self.low) && self.range[1] >= 1000.0;
        reaches && air >= MIN_AIR && is_tissue
    }

    /// Whether the values are labels: few different whole numbers, the lowest of which is the background. If a bin has several whole
    /// numbers, bins are less certain evidence: then a peak, or too few samples outside of the background, count as measured values.
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
            let [a, b] = [self.counts[pair[0]], self.counts[pair[1]]].map(|n| n as f64);
            ((a / b).max(b / a), a + b)
        });
        let (mut rough, mut all) = (0.0, 0.0);
        for (ratio, weight) in pairs {
            all += weight;
            if ratio >= ROUGH {
                rough += weight;
            }
        }
        rough > 0.5 * all
    }

    /// Returns the bin at which the background's peak ends, or at which the valley behind it ends. `None` if there is no such peak: it must
    /// be high, narrow and at the low end, with enough samples beside it.
    fn background(&self) -> Option<usize> {
        let counts = self.counts;
        let (peak, &height) = counts
            .iter()
            .enumerate()
            .max_by_key(|&(bin, &n)| (n, std::cmp::Reverse(bin)))?;
        let has_ended = |n: u64| (n as f64) < PEAK_END * height as f64;
        let width = counts[peak..].iter().position(|&n| has_ended(n))?;
        let end = peak + width;
        let rest = &counts[end..];
        let occupied = rest.iter().filter(|&&n| n > 0).count();
        let is_background = peak < MAX_PEAK
            && width <= MAX_PEAK_WIDTH
            && self.share(0, end) >= MIN_BACKGROUND
            && self.share(end, counts.len()) >= MIN_REST
            && occupied >= MIN_REST_BINS;
        is_background.then(|| self.valley(end).unwrap_or(end))
    }

    /// The end of the valley between the background's peak, which ends at `end`, and the highest peak after it. `None` unless there are
    /// samples beyond that peak. Values in the valley are partly background, and would be a class of their own.
    fn valley(&self, end: usize) -> Option<usize> {
        let rest = &self.counts[end..];
        let smooth = |bin: usize| {
            let around = &rest[bin.saturating_sub(SMOOTHING)..(bin + SMOOTHING + 1).min(rest.len())];
            around.iter().sum::<u64>() as f64 / around.len() as f64
        };
        let smooth: Vec<f64> = (0..rest.len()).map(smooth).collect();
        let next = (1..smooth.len()).fold(0, |best, bin| if smooth[bin] > smooth[best] { bin } else { best });
        let floor = smooth[..=next].iter().copied().fold(f64::INFINITY, f64::min);
        let valley = smooth[..=next].iter().rposition(|&n| n <= VALLEY_FLOOR * floor)?;
        let beyond = self.share(end + 2 * next - valley, self.counts.len());
        (beyond >= MIN_REST * self.share(end, self.counts.len())).then_some(end + valley)
    }

    /// Otsu's threshold (1979) of the bins from `first` on, which maximizes the variance between the classes below and above it. If
    /// thresholds without samples between them are equal, returns their middle. `None` if fewer than two bins have samples.
    fn otsu(&self, first: usize) -> Option<f64> {
        let counts = || self.counts.iter().enumerate().skip(first);
        let total: f64 = counts().map(|(_, &n)| n as f64).sum();
        // Computes in bins, so that no sum overflows.
        let total_sum: f64 = counts().map(|(bin, &n)| n as f64 * bin as f64).sum();
        let (mut below, mut below_sum) = (0.0, 0.0);
        let (mut best, mut equal) = (0.0, None);
        for (bin, &n) in counts() {
            below += n as f64;
            below_sum += n as f64 * bin as f64;
            let above = total - below;
            if below == 0.0 || above == 0.0 {
                continue;
            }
            let apart = below_sum / below - (total_sum - below_sum) / above;
            let between = below * above * apart * apart;
            match &mut equal {
                Some((_, last)) if n == 0 && *last + 1 == bin => *last = bin,
                _ if between > best => (best, equal) = (between, Some((bin, bin))),
                _ => {}
            }
        }
        equal.map(|(first, last)| self.start((first + last) as f64 / 2.0 + 1.0))
    }
}

#[cfg(test)]
mod tests;
