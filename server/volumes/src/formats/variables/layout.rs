//! Assignment of the axes of a variable to x, y, z, time and channels.

use std::ops::Range;

use super::super::header;
use super::super::named_axes::AxisRoles;

/// Assignment of the axes of a variable to those of a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Samples along x, y, z.
    pub dims: [u32; 3],
    /// Time steps, at least 1.
    pub steps: u32,
    /// Channels, at least 1.
    pub channels: u32,
    /// The axes of the variable that are x, y, z.
    pub axes: [usize; 3],
    /// The axis that is time.
    pub time: Option<usize>,
    /// The axis of the channels.
    pub channel: Option<usize>,
    /// Samples along each axis of the variable; those that are neither space, time nor channels have length 1.
    pub sizes: Vec<u64>,
}

impl Layout {
    /// Assigns the axes by their roles.
    pub fn new(sizes: Vec<u64>, roles: &AxisRoles) -> Result<Self, String> {
        let size = |axis: usize| {
            // Attributes may name more axes than the variable has.
            let samples = sizes.get(axis).copied();
            let samples = samples.ok_or_else(|| format!("{} axes, expected {} or more", sizes.len(), axis + 1))?;
            u32::try_from(samples)
                .ok()
                .filter(|&n| n > 0)
                .ok_or_else(|| format!("{samples} samples along an axis, expected 1 to {}", u32::MAX))
        };
        let [x, y, z] = roles.space;
        let channels = roles.channel.map_or(Ok(1), size)?;
        if u64::from(channels) > header::MAX_CHANNELS {
            let limit = header::MAX_CHANNELS;
            return Err(format!("{channels} channels, expected {limit} at most"));
        }
        Ok(Self {
            dims: [size(x)?, size(y)?, size(z)?],
            steps: roles.time.map_or(Ok(1), size)?,
            channels,
            axes: roles.space,
            time: roles.time,
            channel: roles.channel,
            sizes,
        })
    }

    /// Whether x is stored fastest, then y, then z.
    pub fn is_x_fastest(&self) -> bool {
        let [x, y, z] = self.axes;
        z < y && y < x
    }

    /// Which of x, y and z is stored slowest: 0, 1 or 2.
    pub fn slowest(&self) -> usize {
        (0..3).min_by_key(|&axis| self.axes[axis]).unwrap_or(2)
    }

    /// Returns the box of a channel of a step that has the samples `range` along x, y or z (`along`: 0, 1, 2), and all samples along the
    /// others.
    pub fn selection(&self, step: u32, channel: u32, along: usize, range: Range<u64>) -> Vec<Range<u64>> {
        let mut selection = vec![0..1; self.sizes.len()];
        for (axis, size) in self.axes.into_iter().zip(self.dims) {
            selection[axis] = 0..u64::from(size);
        }
        selection[self.axes[along]] = range;
        for (axis, at) in [(self.time, step), (self.channel, channel)] {
            if let Some(axis) = axis {
                selection[axis] = u64::from(at)..u64::from(at) + 1;
            }
        }
        selection
    }

    /// Returns the distance in samples between neighbours along x, y, z and time, and between channels; `None` above 64 bits.
    pub fn strides(&self) -> Option<([u64; 4], u64)> {
        let mut strides = vec![1u64; self.sizes.len()];
        for axis in (1..self.sizes.len()).rev() {
            strides[axis - 1] = strides[axis].checked_mul(self.sizes[axis])?;
        }
        let [x, y, z] = self.axes.map(|axis| strides[axis]);
        let whole = strides.first()?.checked_mul(*self.sizes.first()?)?;
        let time = self.time.map_or(whole, |axis| strides[axis]);
        Some(([x, y, z, time], self.channel.map_or(0, |axis| strides[axis])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_of_axes_that_a_variable_has_not_are_refused() {
        let roles = AxisRoles {
            space: [2, 1, 0],
            time: None,
            channel: None,
            has_time_in_space: false,
            notices: Vec::new(),
        };
        assert!(Layout::new(vec![2, 3, 4], &roles).is_ok());
        for sizes in [vec![], vec![2, 3]] {
            let axes = sizes.len();
            let error = Layout::new(sizes, &roles).unwrap_err();
            assert_eq!(error, format!("{axes} axes, expected 3 or more"));
        }
    }
}
