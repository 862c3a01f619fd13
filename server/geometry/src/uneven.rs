//! Uneven positions of samples along the axes: maps between index space and the even grid with the same ends.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};

/// Uneven axes of a grid. Positions are *even coordinates*: in an even grid with the same ends and number of samples, a sample's even
/// coordinate is its index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnevenAxes {
    /// Even coordinate of each sample along x, y and z, ascending; empty for an even axis.
    axes: [Vec<f64>; 3],
}

impl UnevenAxes {
    /// Takes the positions along x, y and z, which all increase or all decrease; `None` for an even axis. Returns `None` if all are even.
    pub fn new(positions: [Option<&[f64]>; 3]) -> Option<Self> {
        let axes = positions.map(|positions| match positions {
            Some([first, .., last]) => {
                let positions = positions.unwrap_or_default();
                let end = (positions.len() - 1) as f64;
                let even = |value: &f64| (value - first) / (last - first) * end;
                positions.iter().map(even).collect()
            }
            _ => Vec::new(),
        });
        axes.iter().any(|axis| !axis.is_empty()).then_some(Self { axes })
    }

    /// Returns the axes with one more sample at each end, at the position that it has in an even grid.
    pub fn padded(&self) -> Self {
        let padded = |axis: &Vec<f64>| {
            let end = axis.len() as f64 + 1.0;
            let inner = axis.iter().map(|even| even + 1.0);
            std::iter::once(0.0).chain(inner).chain([end]).collect()
        };
        Self {
            axes: self
                .axes
                .each_ref()
                .map(|axis| if axis.is_empty() { Vec::new() } else { padded(axis) }),
        }
    }

    /// Returns the even coordinates of the samples of an axis; `None` if it is even.
    pub fn of_axis(&self, axis: usize) -> Option<&[f64]> {
        Some(self.axes[axis].as_slice()).filter(|axis| !axis.is_empty())
    }

    /// Returns the cell that contains an index along an uneven axis, and the position in that cell; `None` outside, as distances there are
    /// even.
    fn cell(samples: &[f64], index: f64) -> Option<(usize, f64)> {
        let last = samples.len().checked_sub(2)?;
        let inside = index >= 0.0 && index <= (last + 1) as f64;
        let low = (index as usize).min(last);
        inside.then_some((low, index - low as f64))
    }

    /// Maps a position of index space to even coordinates.
    pub fn even_of(&self, index: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| {
            let samples = &self.axes[axis];
            match Self::cell(samples, index[axis]) {
                Some((low, t)) => (1.0 - t) * samples[low] + t * samples[low + 1],
                None => index[axis],
            }
        }))
    }

    /// Maps even coordinates to index space.
    pub fn index_of(&self, even: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| {
            let (samples, at) = (&self.axes[axis], even[axis]);
            match samples.as_slice() {
                [first, .., last] if (*first..=*last).contains(&at) => {
                    let low = (samples.partition_point(|&sample| sample <= at)).clamp(1, samples.len() - 1) - 1;
                    low as f64 + (at - samples[low]) / (samples[low + 1] - samples[low])
                }
                _ => at,
            }
        }))
    }

    /// Returns the lengths of the cell around a position of index space, in cells of the even grid.
    pub fn steps(&self, index: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| {
            let samples = &self.axes[axis];
            Self::cell(samples, index[axis]).map_or(1.0, |(low, _)| samples[low + 1] - samples[low])
        }))
    }

    /// Returns the lengths over which the kernels take differences of samples, in cells of the even grid: at a sample half the distance of
    /// its two neighbours, at an end its cell, and linear between samples, as gradients are along an edge.
    pub fn difference_steps(&self, index: DVec3) -> DVec3 {
        let at = |samples: &[f64], sample: usize| {
            let (below, above) = (sample.saturating_sub(1), (sample + 1).min(samples.len() - 1));
            (samples[above] - samples[below]) / (above - below) as f64
        };
        DVec3::from_array(std::array::from_fn(|axis| {
            let samples = &self.axes[axis];
            Self::cell(samples, index[axis])
                .map_or(1.0, |(low, t)| (1.0 - t) * at(samples, low) + t * at(samples, low + 1))
        }))
    }

    /// Returns the length of the largest cell along each axis, in cells of the even grid; at least 1.
    pub fn largest_steps(&self) -> [f64; 3] {
        let largest = |axis: &Vec<f64>| axis.windows(2).map(|pair| pair[1] - pair[0]).fold(1.0, f64::max);
        self.axes.each_ref().map(largest)
    }

    /// Whether both are equal up to the rounding of a header.
    pub fn matches(&self, other: &Self) -> bool {
        const RELATIVE: f64 = 1e-4;
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= RELATIVE;
        (self.axes.iter().zip(&other.axes)).all(|(a, b)| a.len() == b.len() && a.iter().zip(b).all(near))
    }
}

/// Position of a grid's index space in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct IndexSpace {
    /// Map from even coordinates, which are index space if all axes are even.
    pub world_from_even: DAffine3,
    /// The axes that are not even.
    pub uneven: Option<Arc<UnevenAxes>>,
}

impl IndexSpace {
    /// Maps a position of index space to the world.
    pub fn world(&self, index: DVec3) -> DVec3 {
        let even = self.uneven.as_ref().map_or(index, |uneven| uneven.even_of(index));
        self.world_from_even.transform_point3(even)
    }

    /// Maps a position of the world to index space.
    pub fn index(&self, world: DVec3) -> DVec3 {
        let even = self.world_from_even.inverse().transform_point3(world);
        self.uneven.as_ref().map_or(even, |uneven| uneven.index_of(even))
    }

    /// Returns centre and half the size, in index space, of a shape that has these in the world and is symmetric along each axis: of a box
    /// the box, of a ball an ellipsoid with the same ends along the axes. `None` if all axes are even: then one map holds everywhere.
    pub fn extent(&self, centre: DVec3, half: DVec3) -> Option<(DVec3, DVec3)> {
        let uneven = self.uneven.as_ref()?;
        let even_from_world = self.world_from_even.inverse();
        let middle = even_from_world.transform_point3(centre);
        // Uneven axes are parallel to the world's axes, except for their signs.
        let columns = even_from_world.matrix3;
        let reach = columns.x_axis.abs() * half.x + columns.y_axis.abs() * half.y + columns.z_axis.abs() * half.z;
        let (low, high) = (uneven.index_of(middle - reach), uneven.index_of(middle + reach));
        Some((0.5 * (low + high), 0.5 * (high - low)))
    }
}

impl From<DAffine3> for IndexSpace {
    fn from(world_from_even: DAffine3) -> Self {
        Self {
            world_from_even,
            uneven: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes() -> UnevenAxes {
        UnevenAxes::new([None, Some(&[5.0, 3.0]), Some(&[0.0, 1.0, 3.0, 12.0])]).expect("uneven")
    }

    #[test]
    fn positions_are_piecewise_linear_and_go_both_ways() {
        let axes = axes();
        assert_eq!(axes.of_axis(2), Some([0.0, 0.25, 0.75, 3.0].as_slice()));
        assert_eq!(axes.largest_steps(), [1.0, 1.0, 2.25]);
        for (index, even) in [
            (0.0, 0.0),
            (0.5, 0.125),
            (1.5, 0.5),
            (2.0, 0.75),
            (3.0, 3.0),
            (-2.0, -2.0),
            (4.5, 4.5),
        ] {
            let [index, even] = [index, even].map(|z| DVec3::new(7.5, 0.25, z));
            assert_eq!(axes.even_of(index), even);
            assert_eq!(axes.index_of(even), index);
        }
        assert_eq!(axes.steps(DVec3::new(0.0, 0.0, 1.5)), DVec3::new(1.0, 1.0, 0.5));
        assert_eq!(axes.steps(DVec3::new(0.0, 0.0, 3.0)).z, 2.25);
        assert_eq!(axes.steps(DVec3::new(0.0, 0.0, 3.5)).z, 1.0);
    }

    #[test]
    fn differences_are_of_a_samples_neighbours() {
        let axes = axes();
        let along_z = |z: f64| axes.difference_steps(DVec3::new(7.5, 0.25, z)).z;
        assert_eq!([0.0, 1.0, 2.0, 3.0].map(along_z), [0.25, 0.375, 1.375, 2.25]);
        assert_eq!([0.5, 1.75, 3.5].map(along_z), [0.3125, 1.125, 1.0]);
        assert_eq!(axes.difference_steps(DVec3::ZERO), DVec3::new(1.0, 1.0, 0.25));
    }

    #[test]
    fn a_padding_is_where_an_even_one_is() {
        let padded = axes().padded();
        assert_eq!(padded.of_axis(2), Some([0.0, 1.0, 1.25, 1.75, 4.0, 5.0].as_slice()));
        assert_eq!(padded.of_axis(0), None);
    }

    #[test]
    fn even_axes_are_none() {
        assert_eq!(UnevenAxes::new([None, None, None]), None);
    }

    #[test]
    fn a_box_of_the_world_is_one_of_index_space() {
        let space = IndexSpace {
            world_from_even: DAffine3::from_cols(
                DVec3::new(2.0, 0.0, 0.0),
                DVec3::Y,
                // z goes down by 4 a sample of the even grid.
                DVec3::new(0.0, 0.0, -4.0),
                DVec3::new(10.0, 0.0, 100.0),
            ),
            uneven: Some(Arc::new(axes())),
        };
        let at = space.world(DVec3::new(1.0, 1.0, 2.0));
        assert_eq!(at, DVec3::new(12.0, 1.0, 97.0));
        assert_eq!(space.index(at), DVec3::new(1.0, 1.0, 2.0));
        // From z = 100 to 97: samples 0 to 2.
        let (centre, half) = space
            .extent(DVec3::new(12.0, 0.5, 98.5), DVec3::new(2.0, 0.5, 1.5))
            .expect("uneven");
        assert_eq!((centre, half), (DVec3::new(1.0, 0.5, 1.0), DVec3::new(1.0, 0.5, 1.0)));
        assert_eq!(
            IndexSpace::from(DAffine3::IDENTITY).extent(DVec3::ZERO, DVec3::ONE),
            None
        );
    }
}
