//! Sample types, grids, and volumes resident on the device.

use crate::buffer::Buffer;
use crate::{Error, REGION_CELLS, Result, layout};
use std::ops::Range;

/// Type of a sample as it lies on the device. Wider file types become [`SampleType::F32`] before upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
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
pub enum Samples {
    /// Unsigned 8 bit.
    U8(Vec<u8>),
    /// Signed 8 bit.
    I8(Vec<i8>),
    /// Unsigned 16 bit.
    U16(Vec<u16>),
    /// Signed 16 bit.
    I16(Vec<i16>),
    /// IEEE 754 single precision.
    F32(Vec<f32>),
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

/// Extent of a volume: samples per axis (at least 2) and the distance between them.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// Least and greatest sample of every brick, region by region, 64 bricks in Morton order.
    pub(crate) table: Buffer<[f32; 2]>,
    /// Bricks that touch a missing sample, 64 bits a region; on the host, where active regions are listed.
    pub(crate) missing_masks: Vec<[u32; 2]>,
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

    pub(crate) fn layout(&self) -> layout::Grid {
        layout::Grid {
            dims: self.grid.dims,
            regions: self.grid.regions(),
            spacing: self.grid.spacing,
            missing: self.missing,
        }
    }
}

/// Planes along z that serve `layers` region layers: corners reach one plane further, gradients one on either side.
pub(crate) fn slab_planes(grid: &Grid, layers: &Range<u32>) -> Range<u32> {
    let first = (layers.start * REGION_CELLS).saturating_sub(1);
    first..layers.end.saturating_mul(REGION_CELLS).saturating_add(2).min(grid.dims[2])
}

/// Cuts a grid into runs of region layers that each fit one allocation. Independent of the sample type, so that fields
/// of one grid are cut alike.
pub(crate) fn slab_layers(grid: &Grid, limit_bytes: u64) -> Result<Vec<Range<u32>>> {
    let plane_bytes = u64::from(grid.dims[0]) * u64::from(grid.dims[1]) * size_of::<f32>() as u64;
    let layers = grid.regions()[2];
    let one = plane_bytes * u64::from(slab_planes(grid, &(0..1)).end.max((REGION_CELLS + 3).min(grid.dims[2])));
    if one > limit_bytes {
        return Err(Error::OutOfDeviceMemory {
            stage: "upload",
            needed_bytes: one,
            limit_bytes,
        });
    }
    let planes = limit_bytes / plane_bytes;
    let step = if planes >= u64::from(grid.dims[2]) {
        layers
    } else {
        ((planes - 3) / u64::from(REGION_CELLS)) as u32
    };
    Ok((0..layers)
        .step_by(step.max(1) as usize)
        .map(|first| first..(first + step).min(layers))
        .collect())
}
