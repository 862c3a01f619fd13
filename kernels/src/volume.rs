//! Sample types, grids, and volumes resident on the device.

use crate::buffer::Buffer;
use crate::{Error, REGION_CELLS, Result, layout};
use std::ops::Range;
use std::sync::Arc;

/// Type of a sample on the device. Wider file types become [`SampleType::F32`] before upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SampleType {
    /// Unsigned 8 bit.
    U8,
    /// Signed 8 bit.
    I8,
    /// Unsigned 16 bit.
    U16,
    /// Signed 16 bit.
    I16,
    /// IEEE 754 single precision.
    F32,
}

impl SampleType {
    /// Bytes of one sample.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 => 4,
        }
    }

    /// Short name, as `isopeel info` prints it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::F32 => "f32",
        }
    }
}

/// Samples on the host, x fastest, then y, then z.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Samples {
    /// Unsigned 8 bit.
    U8(#[cfg_attr(feature = "serde", serde(with = "crate::bulk"))] Vec<u8>),
    /// Signed 8 bit.
    I8(#[cfg_attr(feature = "serde", serde(with = "crate::bulk"))] Vec<i8>),
    /// Unsigned 16 bit.
    U16(#[cfg_attr(feature = "serde", serde(with = "crate::bulk"))] Vec<u16>),
    /// Signed 16 bit.
    I16(#[cfg_attr(feature = "serde", serde(with = "crate::bulk"))] Vec<i16>),
    /// IEEE 754 single precision.
    F32(#[cfg_attr(feature = "serde", serde(with = "crate::bulk"))] Vec<f32>),
}

impl Samples {
    /// Type of every sample.
    pub fn sample_type(&self) -> SampleType {
        match self {
            Self::U8(_) => SampleType::U8,
            Self::I8(_) => SampleType::I8,
            Self::U16(_) => SampleType::U16,
            Self::I16(_) => SampleType::I16,
            Self::F32(_) => SampleType::F32,
        }
    }

    /// How many samples there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::I8(v) => v.len(),
            Self::U16(v) => v.len(),
            Self::I16(v) => v.len(),
            Self::F32(v) => v.len(),
        }
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sample `i` as the kernels see it.
    pub fn get(&self, i: usize) -> f32 {
        match self {
            Self::U8(v) => f32::from(v[i]),
            Self::I8(v) => f32::from(v[i]),
            Self::U16(v) => f32::from(v[i]),
            Self::I16(v) => f32::from(v[i]),
            Self::F32(v) => v[i],
        }
    }

    /// The samples' bytes in the machine's order.
    pub fn as_bytes(&self) -> &[u8] {
        match self {
            Self::U8(v) => v,
            Self::I8(v) => bytemuck::cast_slice(v),
            Self::U16(v) => bytemuck::cast_slice(v),
            Self::I16(v) => bytemuck::cast_slice(v),
            Self::F32(v) => bytemuck::cast_slice(v),
        }
    }
}

impl Samples {
    /// Returns the samples padded by one on every side with a value below all of them, and the new extent: surfaces that leave the
    /// volume are closed at its faces. The type is widened if it has no value below the minimum. `missing` is neither counted as a value
    /// nor used for padding.
    pub fn padded(&self, dims: [u32; 3], missing: Option<f32>) -> (Self, [u32; 3]) {
        let present = (0..self.len())
            .map(|i| self.get(i))
            .filter(|v| v.is_finite() && Some(*v) != missing);
        let (minimum, maximum) = present.fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        // Without any value there is no surface to close.
        let (minimum, maximum) = if minimum <= maximum {
            (minimum, maximum)
        } else {
            (0.0, 0.0)
        };
        // Integers: the next lower one. Floats: lower by the range, which rounding cannot absorb.
        let mut below = match self {
            Self::F32(_) => minimum - (maximum - minimum).max(minimum.abs()).max(1.0),
            _ => minimum - 1.0,
        };
        if Some(below) == missing {
            below -= 1.0;
        }
        let floats = || Self::F32((0..self.len()).map(|i| self.get(i)).collect());
        let samples = match self {
            Self::U8(v) if below < 0.0 => Self::I16(v.iter().map(|&v| v.into()).collect()),
            Self::I8(v) if below < f32::from(i8::MIN) => Self::I16(v.iter().map(|&v| v.into()).collect()),
            Self::U16(_) if below < 0.0 => floats(),
            Self::I16(_) if below < f32::from(i16::MIN) => floats(),
            other => other.clone(),
        };
        let grown = dims.map(|n| n + 2);
        // Each cast is exact: the type was chosen so that it holds the value.
        let samples = match samples {
            Self::U8(v) => Self::U8(surround(&v, dims, below as u8)),
            Self::I8(v) => Self::I8(surround(&v, dims, below as i8)),
            Self::U16(v) => Self::U16(surround(&v, dims, below as u16)),
            Self::I16(v) => Self::I16(surround(&v, dims, below as i16)),
            Self::F32(v) => Self::F32(surround(&v, dims, below)),
        };
        (samples, grown)
    }
}

/// Puts one `value` around a box of samples on every side.
fn surround<T: Copy>(samples: &[T], dims: [u32; 3], value: T) -> Vec<T> {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    let mut grown = vec![value; (nx + 2) * (ny + 2) * (nz + 2)];
    for (row, line) in samples.chunks_exact(nx).enumerate() {
        let (y, z) = (row % ny, row / ny);
        let start = ((z + 1) * (ny + 2) + y + 1) * (nx + 2) + 1;
        grown[start..start + nx].copy_from_slice(line);
    }
    grown
}

/// Extent of a volume: samples per axis (at least 2) and the distance between them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Grid {
    /// Samples along x, y, z. Cells are one fewer.
    pub dims: [u32; 3],
    /// World units between neighbouring samples along x, y, z; finite and above zero.
    pub spacing: [f32; 3],
}

impl Grid {
    /// Checks the invariants of the fields.
    pub fn new(dims: [u32; 3], spacing: [f32; 3]) -> Result<Self> {
        if dims.iter().any(|&n| n < 2) {
            return Err(Error::Invalid {
                what: "volume dimensions",
                why: format!("{dims:?} samples, expected at least 2 along every axis"),
            });
        }
        if spacing.iter().any(|s| !s.is_finite() || *s <= 0.0) {
            return Err(Error::Invalid {
                what: "volume spacing",
                why: format!("{spacing:?}, expected finite values above 0"),
            });
        }
        Ok(Self { dims, spacing })
    }

    /// Number of samples; 64-bit because 2048³ passes 2³².
    pub fn sample_count(&self) -> u64 {
        self.dims.iter().map(|&n| u64::from(n)).product()
    }

    /// The smallest of the three spacings.
    pub fn smallest_spacing(&self) -> f32 {
        self.spacing.into_iter().fold(f32::INFINITY, f32::min)
    }

    /// Cells along x, y, z.
    pub fn cells(&self) -> [u32; 3] {
        self.dims.map(|n| n - 1)
    }

    /// Regions of 32³ cells along x, y, z, the last ones cut at the volume's end.
    pub fn regions(&self) -> [u32; 3] {
        self.cells().map(|c| c.div_ceil(crate::REGION_CELLS))
    }
}

/// Samples of consecutive region layers, with the planes around that gradients and cell corners reach.
pub(crate) struct Slab {
    pub samples: Buffer<u8>,
    /// First plane in `samples`.
    pub z0: u32,
    /// Region layers along z whose cells this slab serves.
    pub layers: Range<u32>,
}

/// A field resident on the device in its own type, with the min/max table of its bricks.
pub struct Volume {
    pub(crate) grid: Grid,
    pub(crate) sample_type: SampleType,
    pub(crate) missing: f32,
    pub(crate) slabs: Vec<Slab>,
    /// Minimum and maximum sample of every brick, region by region, 64 bricks in Morton order.
    pub(crate) table: Buffer<[f32; 2]>,
    /// Bricks that touch a missing sample, 64 bits per region. On the host, because the host lists active regions.
    pub(crate) missing_masks: Vec<[u32; 2]>,
    /// One over the lengths of the cells along x, then along y, then along z, if axes are uneven.
    pub(crate) inverse_lengths: Option<Arc<Buffer<f32>>>,
}

impl Volume {
    /// Extent.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Type of the samples on the device.
    pub fn sample_type(&self) -> SampleType {
        self.sample_type
    }

    /// Bytes of the samples on the device.
    pub fn sample_bytes(&self) -> u64 {
        self.slabs.iter().map(|s| s.samples.bytes()).sum()
    }

    /// Bytes on the device beside the samples: the min/max table.
    pub fn table_bytes(&self) -> u64 {
        self.table.bytes()
    }

    /// Whether samples are missing anywhere.
    pub(crate) fn has_missing(&self) -> bool {
        self.missing_masks.iter().any(|mask| *mask != [0, 0])
    }

    pub(crate) fn layout(&self) -> layout::Grid {
        layout::Grid {
            dims: self.grid.dims,
            regions: self.grid.regions(),
            spacing: self.grid.spacing,
            missing: self.missing,
        }
    }
}

/// Planes of a slab that serves one layer of regions inside the volume.
pub(crate) const LAYER_PLANES: u32 = REGION_CELLS + 5;

/// Planes along z that serve `layers` region layers: corners reach one plane further, and sheets of a cell depend on two planes more on either
/// side.
pub(crate) fn slab_planes(grid: &Grid, layers: &Range<u32>) -> Range<u32> {
    let first = (layers.start * REGION_CELLS).saturating_sub(2);
    first
        ..layers
            .end
            .saturating_mul(REGION_CELLS)
            .saturating_add(3)
            .min(grid.dims[2])
}

/// Cuts a grid into runs of region layers that each fit one allocation. Independent of the sample type, so that fields
/// of one grid are cut alike.
pub(crate) fn slab_layers(grid: &Grid, limit_bytes: u64) -> Result<Vec<Range<u32>>> {
    let plane_bytes = u64::from(grid.dims[0]) * u64::from(grid.dims[1]) * size_of::<f32>() as u64;
    let layers = grid.regions()[2];
    let one = plane_bytes * u64::from(slab_planes(grid, &(0..1)).end.max(LAYER_PLANES.min(grid.dims[2])));
    if one > limit_bytes {
        return Err(Error::OutOfDeviceMemory {
            stage: "upload",
            needed_bytes: one,
            limit_bytes: Some(limit_bytes),
        });
    }
    let planes = limit_bytes / plane_bytes;
    let step = if planes >= u64::from(grid.dims[2]) {
        layers
    } else {
        ((planes - u64::from(LAYER_PLANES - REGION_CELLS)) / u64::from(REGION_CELLS)) as u32
    };
    Ok((0..layers)
        .step_by(step.max(1) as usize)
        .map(|first| first..(first + step).min(layers))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::{Error, Grid, SampleType, Samples, slab_layers, slab_planes};

    #[test]
    fn padding_surrounds_and_lies_below() {
        let (padded, dims) = Samples::U8((5..17).collect()).padded([2, 3, 2], None);
        assert_eq!((dims, padded.len()), ([4, 5, 4], 80));
        let at = |x: usize, y: usize, z: usize| padded.get((z * 5 + y) * 4 + x);
        for z in 0..4 {
            for y in 0..5 {
                for x in 0..4 {
                    let inside = (1..3).contains(&x) && (1..4).contains(&y) && (1..3).contains(&z);
                    let expected = if inside {
                        5 + (z - 1) * 6 + (y - 1) * 2 + x - 1
                    } else {
                        4
                    };
                    assert_eq!(at(x, y, z), expected as f32, "{x} {y} {z}");
                }
            }
        }
    }

    #[test]
    fn types_widen_where_nothing_lies_below() {
        let pad = |samples: Samples, missing| {
            let (padded, _) = samples.padded([2, 1, 1], missing);
            (padded.sample_type(), padded.get(0))
        };
        assert_eq!(pad(Samples::U8(vec![0, 9]), None), (SampleType::I16, -1.0));
        assert_eq!(pad(Samples::U8(vec![1, 9]), None), (SampleType::U8, 0.0));
        assert_eq!(pad(Samples::U8(vec![1, 9]), Some(0.0)), (SampleType::I16, -1.0));
        assert_eq!(pad(Samples::I8(vec![-128, 9]), None), (SampleType::I16, -129.0));
        assert_eq!(pad(Samples::U16(vec![0, 65535]), None), (SampleType::F32, -1.0));
        assert_eq!(pad(Samples::I16(vec![i16::MIN, 0]), None), (SampleType::F32, -32769.0));
        assert_eq!(
            pad(Samples::I16(vec![i16::MIN, 7]), Some(-32768.0)),
            (SampleType::I16, 6.0)
        );
        assert_eq!(pad(Samples::F32(vec![2.0, 5.0]), None), (SampleType::F32, -1.0));
        assert!(pad(Samples::F32(vec![1e9, 1e9]), None).1 < 1e9);
        assert_eq!(
            pad(Samples::F32(vec![f32::NAN, f32::NAN]), None),
            (SampleType::F32, -1.0)
        );
    }

    #[test]
    fn slabs_hold_what_their_layers_need() {
        // 8 Gi samples: every product here passes 2^32.
        let grid = Grid::new([2048, 2048, 2048], [1.0; 3]).expect("a grid");
        assert_eq!(grid.sample_count(), 1 << 33);
        assert_eq!(grid.regions(), [64; 3]);
        let plane = 2048 * 2048 * 4u64;
        for limit_bytes in [
            37 * plane,
            38 * plane,
            1 << 30,
            4 << 30,
            34_359_738_367,
            1 << 35,
            u64::MAX,
        ] {
            let slabs = slab_layers(&grid, limit_bytes).expect("slabs");
            assert_eq!(slabs[0].start, 0);
            assert_eq!(slabs.last().map(|s| s.end), Some(64));
            for (i, layers) in slabs.iter().enumerate() {
                assert!(i == 0 || slabs[i - 1].end == layers.start, "layers follow each other");
                let planes = slab_planes(&grid, layers);
                // A cell's corners, and two more beyond for its sheets.
                assert!(planes.start <= (layers.start * 32).saturating_sub(2));
                assert!(planes.end >= (layers.end * 32 + 3).min(2048));
                assert!(u64::from(planes.end - planes.start) * plane <= limit_bytes);
            }
        }
        assert_eq!(slab_layers(&grid, u64::MAX).expect("one slab").len(), 1);
        let e = slab_layers(&grid, 37 * plane - 1).expect_err("one layer is too large");
        assert!(matches!(e, Error::OutOfDeviceMemory { needed_bytes, .. } if needed_bytes == 37 * plane));
        // Taller than 32-bit planes could count once doubled.
        let tall = Grid::new([2, 2, u32::MAX], [1.0; 3]).expect("a grid");
        let layers = slab_layers(&tall, 1 << 30).expect("slabs");
        assert_eq!(layers.last().map(|s| s.end), Some(tall.regions()[2]));
        assert_eq!(slab_planes(&tall, layers.last().expect("one")).end, u32::MAX);
    }
}
