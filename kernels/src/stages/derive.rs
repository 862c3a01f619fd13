//! Features that are computed before `construct`: of a field's neighbourhoods, or of three fields.

use super::args::kernel_args;
use super::construct::{self, type_number};
use crate::buffer::Buffer;
use crate::context::{Arg, Context, LocalBytes};
use crate::layout::{Grid, Node};
use crate::volume::Slab;
use crate::{Cancel, Feature, Result, Volume, constants};
use opencl3::kernel::Kernel;
use std::sync::{Arc, Mutex};

/// Name of the stage.
pub const STAGE: &str = "derive";

kernel_args! {
    /// Arguments of `derive` and `derive_samples`.
    DeriveArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Number of the feature.
        kind: u32,
        /// Fields that it is computed from, 1 or 3.
        components: u32,
        /// Sample type of the first field, `TYPE_U8` to `TYPE_F32`.
        type_x: u32,
        /// Of the second one.
        type_y: u32,
        /// Of the third one.
        type_z: u32,
        /// Samples of the first field equal to this count as NaN.
        missing_x: f32,
        /// Of the second one.
        missing_y: f32,
        /// Of the third one.
        missing_z: f32,
        /// Compact index of the first brick of this launch; of `derive_samples` its first plane.
        first: u32,
        /// Planes of this launch of `derive_samples`.
        planes: u32,
    }
}

/// The fields from which a feature is computed.
pub struct Source<'a> {
    kind: u32,
    /// A feature of one field has this field three times; only the first is read.
    fields: [&'a Volume; 3],
    components: u32,
}

impl<'a> Source<'a> {
    /// The source of a feature of `volume`; `None` if no stage before `construct` computes it.
    pub fn of(volume: &'a Volume, feature: Feature<'a>) -> Option<Self> {
        let (fields, components) = match feature {
            Feature::Vector(_, fields) => (fields, 3),
            _ => ([volume; 3], 1),
        };
        (feature.kind_after_derive(volume) == constants::FEATURE_STORED).then(|| Self {
            kind: feature.kind(),
            fields,
            components,
        })
    }

    fn args(&self, z0: u32, first: u32, planes: u32) -> DeriveArgs {
        let [x, y, z] = self.fields;
        DeriveArgs {
            grid: x.layout(),
            z0,
            kind: self.kind,
            components: self.components,
            type_x: type_number(x.sample_type),
            type_y: type_number(y.sample_type),
            type_z: type_number(z.sample_type),
            missing_x: x.missing,
            missing_y: y.missing,
            missing_z: z.missing,
            first,
            planes,
        }
    }

    /// The fields' samples in the slab that begins at plane `z0`: fields of one grid have the same slabs.
    fn samples(&self, z0: u32) -> [&'a Buffer<u8>; 3] {
        self.fields.map(|field| {
            let slab = field.slabs.iter().find(|slab| slab.z0 == z0);
            &slab.unwrap_or(&field.slabs[0]).samples
        })
    }

    /// One over the lengths of the cells, if axes are uneven.
    fn inverse_lengths(&self) -> Option<&'a Buffer<f32>> {
        self.fields[0].inverse_lengths.as_deref()
    }

    /// Uneven axes have a program of their own, so that even axes have no extra cost.
    fn kernel(&self, cx: &Context, name: &str) -> Result<Arc<Mutex<Kernel>>> {
        match self.inverse_lengths() {
            Some(_) => cx.uneven_kernel(name),
            None => cx.kernel(self.fields[0].sample_type, name),
        }
    }

    /// Local memory of a work-group: a block a field, one for the feature, and tables of uneven axes.
    fn local_bytes(&self) -> LocalBytes {
        let blocks = (self.components + 1) * constants::DERIVE_BLOCK;
        let tables = self.inverse_lengths().map_or(0, |_| constants::STEP_TABLES);
        LocalBytes((blocks + tables) as usize * size_of::<f32>())
    }

    /// The first arguments of both kernels.
    fn arguments<'b>(&'b self, args: &'b DeriveArgs, z0: u32) -> Vec<&'b dyn Arg> {
        let lengths = self.inverse_lengths().map(|lengths| lengths as &dyn Arg);
        let samples = self.samples(z0).map(|samples| samples as &dyn Arg);
        std::iter::once(args as &dyn Arg)
            .chain(lengths)
            .chain(samples)
            .collect()
    }
}

/// Fills in the feature of the active cells.
pub fn run(
    cx: &Context,
    source: &Source<'_>,
    input: &construct::Input<'_>,
    nodes: &Buffer<Node>,
    cancel: &dyn Cancel,
) -> Result<()> {
    let (kernel, local) = (source.kernel(cx, "derive")?, source.local_bytes());
    for slab in input.work {
        let args = source.args(slab.z0, slab.bricks.start as u32, 0);
        let mut all = source.arguments(&args, slab.z0);
        all.extend([input.regions as &dyn Arg, input.bricks, nodes, &local]);
        cx.launch(STAGE, &kernel, slab.bricks.len(), cx.tuning.brick_group, &all)?;
        cx.pause(STAGE, cancel)?;
    }
    Ok(())
}

/// Returns the feature at all samples of `planes` planes, x fastest; NaN if it is missing. `first`: the first plane, a multiple of 8.
pub fn samples(
    cx: &Context,
    source: &Source<'_>,
    volume: &Volume,
    slab: &Slab,
    first: u32,
    planes: u32,
) -> Result<Buffer<f32>> {
    let [nx, ny, _] = volume.grid.dims.map(|n| n as usize);
    let values = cx.buffer(STAGE, nx * ny * planes as usize)?;
    let args = source.args(slab.z0, first, planes);
    let (groups, local) = (
        nx.div_ceil(8) * ny.div_ceil(8) * planes.div_ceil(8) as usize,
        source.local_bytes(),
    );
    let mut all = source.arguments(&args, slab.z0);
    all.extend([&values as &dyn Arg, &local]);
    cx.launch(
        STAGE,
        &source.kernel(cx, "derive_samples")?,
        groups,
        cx.tuning.brick_group,
        &all,
    )?;
    Ok(values)
}
