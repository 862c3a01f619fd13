//! What benches need of a device beside the product: volumes made of formulas where they are used, the samples back on the
//! host for references, and how fast the device itself is.

use crate::stages::generate;
use crate::volume::{Slab, slab_layers, slab_planes};
use crate::{DeviceKind, Engine, Error, Grid, Result, SampleType, Samples, StageTime, Volume};
use std::ops::Range;
use std::time::Instant;

/// A formula. Its values are of the order of −2 to 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Eight plane waves and white noise, of 1 % at a period of 256 samples and less where that is longer: its size in
    /// samples, and so its share of wrong signs, stays. Isovalue 0.5.
    Sin,
    /// Eight other plane waves with uniform noise, of a quarter more surface. Isovalue 0.5.
    Waves,
    /// The Marschner-Lobb signal, smooth. Isovalue 0.5.
    MarschnerLobb,
    /// Two gyroids of different period. Isovalue 0.1.
    Gyroid,
    /// Balls of radius 40 samples, so many along every axis. Isovalue 0.
    Spheres(u32),
}

impl Shape {
    /// Number of the shape in `cl/generate.cl`, and how many of it along every axis.
    pub(crate) fn numbers(self) -> (u32, u32) {
        match self {
            Self::Sin => (0, 1),
            Self::Waves => (1, 1),
            Self::MarschnerLobb => (2, 1),
            Self::Gyroid => (3, 1),
            Self::Spheres(count) => (4, count.max(1)),
        }
    }

    /// The isovalue it is meant for, as samples of that type store it; of integers between two of them.
    pub fn isovalue(self, sample_type: SampleType) -> f32 {
        let value = match self {
            Self::Sin | Self::Waves | Self::MarschnerLobb => 0.5,
            Self::Gyroid => 0.1,
            Self::Spheres(_) => 0.0,
        };
        let [factor, offset] = stored(sample_type);
        let value = value * factor + offset;
        if sample_type == SampleType::F32 {
            value
        } else {
            value.floor() + 0.5
        }
    }
}

/// Factor and offset that bring −2 to 2 into a sample type's range.
fn stored(sample_type: SampleType) -> [f32; 2] {
    match sample_type {
        SampleType::U8 => [63.75, 127.5],
        SampleType::I8 => [63.75, -0.5],
        SampleType::U16 => [16383.75, 32767.5],
        SampleType::I16 => [16383.75, -0.5],
        SampleType::F32 => [1.0, 0.0],
    }
}

/// A volume to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Synthetic {
    /// The formula.
    pub shape: Shape,
    /// Samples after which waves repeat or the signal ends; above 1. Spheres have none.
    pub period: f32,
    /// The outermost samples are below every surface, so that all surfaces are closed.
    pub closed: bool,
}

/// How fast a device is at what every program on it is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceSpeed {
    /// Bytes read plus bytes written a second by copies from buffer to buffer, by the device's events.
    pub copy_bytes_per_second: f64,
    /// Size of the copied buffer in bytes.
    pub copied_bytes: u64,
    /// Seconds from one launch to the next of kernels that do nothing, with nothing to wait for.
    pub launch_seconds: f64,
    /// Seconds to launch such a kernel and wait for its end.
    pub launch_and_wait_seconds: f64,
}

/// Largest buffer for measuring copies: beyond every cache.
const COPY_BYTES: u64 = 4 << 30;

impl Engine {
    /// Makes a volume on the device, its min/max table included.
    ///
    /// # Errors
    /// A period that is no number above 1, or what the device says.
    pub fn generate(&self, grid: &Grid, sample_type: SampleType, synthetic: &Synthetic) -> Result<Volume> {
        let grid = Grid::new(grid.dims, grid.spacing)?;
        if !(synthetic.period.is_finite() && synthetic.period > 1.0) {
            return Err(Error::Invalid {
                what: "period",
                why: format!("{} samples, expected a finite number above 1", synthetic.period),
            });
        }
        self.warm_up(sample_type)?;
        let (name, convert) = match sample_type {
            SampleType::U8 => ("uchar", "convert_uchar_sat_rte"),
            SampleType::I8 => ("char", "convert_char_sat_rte"),
            SampleType::U16 => ("ushort", "convert_ushort_sat_rte"),
            SampleType::I16 => ("short", "convert_short_sat_rte"),
            SampleType::F32 => ("float", "convert_float"),
        };
        // Not part of the product's program, which a user waits for at the start.
        let kernels = self.cx.build(
            "#include \"generate.cl\"\n",
            &format!("-cl-std=CL1.2 -DSAMPLE={name} -DSTORE={convert}"),
        )?;
        let layout = crate::layout::Grid {
            dims: grid.dims,
            regions: grid.regions(),
            spacing: grid.spacing,
            missing: f32::NAN,
        };
        let plane = u64::from(grid.dims[0]) * u64::from(grid.dims[1]) * sample_type.bytes() as u64;
        let mut slabs = Vec::new();
        for layers in slab_layers(&grid, self.cx.limit_bytes)? {
            let planes = slab_planes(&grid, &layers);
            let samples = self.cx.buffer(generate::STAGE, planes.len() * plane as usize)?;
            generate::run(
                &self.cx,
                &kernels,
                &layout,
                synthetic,
                stored(sample_type),
                &samples,
                planes.clone(),
            )?;
            slabs.push(Slab {
                samples,
                z0: planes.start,
                layers,
            });
        }
        self.resident(grid, sample_type, None, slabs)
    }

    /// Makes the min/max table again from the samples on the device, as for a time step that just arrived there, and
    /// answers what that took.
    ///
    /// # Errors
    /// What the device says.
    pub fn refresh_table(&self, volume: &mut Volume) -> Result<Vec<StageTime>> {
        self.cx.take_times()?;
        self.make_table(volume)?;
        self.cx.take_times()
    }

    /// Planes of samples back on the host.
    ///
    /// # Errors
    /// Planes that the volume does not have, or what the device says.
    pub fn download(&self, volume: &Volume, planes: Range<u32>) -> Result<Samples> {
        let grid = volume.grid;
        if planes.start > planes.end || planes.end > grid.dims[2] {
            return Err(Error::Invalid {
                what: "planes",
                why: format!("{planes:?}, expected some of 0..{}", grid.dims[2]),
            });
        }
        let plane = grid.dims[0] as usize * grid.dims[1] as usize * volume.sample_type.bytes();
        let mut bytes = Vec::with_capacity(planes.len() * plane);
        let mut next = planes.start;
        for slab in &volume.slabs {
            let held = slab_planes(&grid, &slab.layers);
            let end = held.end.min(planes.end);
            if held.contains(&next) && next < end {
                let (from, len) = ((next - held.start) as usize * plane, (end - next) as usize * plane);
                bytes.extend(self.cx.read_at("download", &slab.samples, from, len)?);
                next = end;
            }
        }
        Ok(match volume.sample_type {
            SampleType::U8 => Samples::U8(bytes),
            SampleType::I8 => Samples::I8(bytemuck::pod_collect_to_vec(&bytes)),
            SampleType::U16 => Samples::U16(bytemuck::pod_collect_to_vec(&bytes)),
            SampleType::I16 => Samples::I16(bytemuck::pod_collect_to_vec(&bytes)),
            SampleType::F32 => Samples::F32(bytemuck::pod_collect_to_vec(&bytes)),
        })
    }

    /// Measures the device: the yardstick of a bench. Takes about a second and two buffers of at most
    /// 4 GiB, less where the device is small.
    ///
    /// # Errors
    /// What the device says.
    pub fn measure(&self) -> Result<DeviceSpeed> {
        const LAUNCHES: u32 = 200;
        let cx = &self.cx;
        let share = match cx.found.info.kind {
            DeviceKind::Gpu => 16,
            // The host needs its memory too, and its caches are passed sooner.
            _ => 32,
        };
        let bytes = COPY_BYTES.min(cx.limit_bytes).min(cx.found.info.memory_bytes / share);
        let from = cx.zeroed::<u32>("measure", bytes as usize / 4)?;
        let mut to = cx.zeroed::<u32>("measure", bytes as usize / 4)?;
        let mut best = f64::INFINITY;
        for _ in 0..6 {
            cx.take_times()?;
            cx.copy("measure", &from, &mut to)?;
            let milliseconds: f64 = cx.take_times()?.iter().map(|t| t.milliseconds).sum();
            best = best.min(milliseconds / 1e3);
        }
        let nothing = cx.build("__kernel void nothing(__global uint *unused) {}", "-cl-std=CL1.2")?;
        let launch = || cx.launch("measure", nothing.get("nothing"), 1, 1, &[&to]);
        launch()?;
        cx.take_times()?;
        let start = Instant::now();
        for _ in 0..LAUNCHES {
            launch()?;
        }
        cx.finish("measure")?;
        let launch_seconds = start.elapsed().as_secs_f64() / f64::from(LAUNCHES);
        let start = Instant::now();
        for _ in 0..LAUNCHES {
            launch()?;
            cx.finish("measure")?;
        }
        let launch_and_wait_seconds = start.elapsed().as_secs_f64() / f64::from(LAUNCHES);
        cx.take_times()?;
        Ok(DeviceSpeed {
            copy_bytes_per_second: 2.0 * from.bytes() as f64 / best,
            copied_bytes: from.bytes(),
            launch_seconds,
            launch_and_wait_seconds,
        })
    }
}
