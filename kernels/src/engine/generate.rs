//! Device operations for benches, not used by the product: generates volumes from formulas on the device, downloads samples for
//! references, and measures the speed of the device.

use crate::stages::generate;
use crate::synthetic::stored;
use crate::volume::{Slab, slab_layers, slab_planes};
use crate::{
    DeviceKind, DeviceSpeed, Engine, Error, Grid, Never, Result, SampleType, Samples, StageTime, Synthetic, Volume,
};
use std::ops::Range;
use std::time::Instant;

/// Largest buffer for measuring copies: beyond every cache.
const COPY_BYTES: u64 = 4 << 30;

impl Engine {
    /// Makes a volume on the device, its min/max table included.
    ///
    /// # Errors
    /// A period that is no number above 1, or an error of the device.
    pub fn generate(&self, grid: &Grid, sample_type: SampleType, synthetic: &Synthetic) -> Result<Volume> {
        let grid = Grid::new(grid.dims, grid.spacing)?;
        if !(synthetic.period.is_finite() && synthetic.period > 1.0) {
            return Err(Error::Invalid {
                what: "period",
                why: format!("{} samples, expected a finite number above 1", synthetic.period),
            });
        }
        let (name, convert) = match sample_type {
            SampleType::U8 => ("uchar", "convert_uchar_sat_rte"),
            SampleType::I8 => ("char", "convert_char_sat_rte"),
            SampleType::U16 => ("ushort", "convert_ushort_sat_rte"),
            SampleType::I16 => ("short", "convert_short_sat_rte"),
            SampleType::F32 => ("float", "convert_float"),
        };
        // A program of its own: the product's program stays small, as users wait for it at start-up.
        let program = self.cx.build(
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
                &program,
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
        self.resident(grid, sample_type, None, slabs, None, &Never)
    }

    /// Rebuilds the min/max table from the samples on the device, as for a time step that has just been uploaded. Returns the stage
    /// times.
    ///
    /// # Errors
    /// An error of the device.
    pub fn refresh_table(&self, volume: &mut Volume) -> Result<Vec<StageTime>> {
        self.cx.take_times()?;
        self.make_table(volume, &Never)?;
        self.cx.take_times()
    }

    /// Reads planes of samples back to the host.
    ///
    /// # Errors
    /// Planes that the volume does not have, or an error of the device.
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
    /// 4 GiB, less if the device is small.
    ///
    /// # Errors
    /// An error of the device.
    pub fn measure(&self) -> Result<DeviceSpeed> {
        const LAUNCHES: u32 = 200;
        let cx = &self.cx;
        let share = match cx.found.info.kind {
            DeviceKind::Gpu => 16,
            // The host needs memory too, and a smaller buffer already exceeds its caches.
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
