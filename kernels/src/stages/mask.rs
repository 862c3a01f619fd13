//! Masked fields: samples outside the mask are missing.

use super::BRICK_GROUP;
use super::args::kernel_args;
use super::construct::type_number;
use super::evaluate::{Input, in_blocks};
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::mask::ValueSet;
use crate::pace::Pace;
use crate::{Cancel, Result, SampleType};

/// Name of the stage.
pub const STAGE: &str = "mask";

kernel_args! {
    /// Arguments of `mask`.
    MaskArgs {
        /// First sample of this launch, in blocks of LAUNCH_BLOCK.
        first: u32,
        /// Samples of this launch.
        count: u32,
        /// Sample type of the field, `TYPE_U8` to `TYPE_F32`.
        samples_type: u32,
        /// Of the labels.
        labels_type: u32,
        /// Of the result.
        out_type: u32,
        /// Ranges of labels.
        ranges: u32,
        /// Whether labels in no range are inside, 1 or 0.
        is_complement: u32,
        /// Labels equal to this are missing.
        missing_label: f32,
        /// Value of the samples outside.
        missing: f32,
    }
}

/// The samples outside the mask.
#[derive(Clone, Copy)]
pub struct Outside {
    /// Type of the result.
    pub sample_type: SampleType,
    /// Value of these samples.
    pub value: f32,
}

/// Fills `out`, which holds `samples` samples, by launches whose sizes `pace` chooses.
pub fn run(
    cx: &Context,
    inside: &ValueSet,
    [field, labels]: [Input<'_>; 2],
    outside: Outside,
    (out, samples): (&Buffer<u8>, u64),
    pace: &mut Pace,
    cancel: &dyn Cancel,
) -> Result<()> {
    let ranges = cx.upload(STAGE, &inside.ranges)?;
    let kernel = cx.kernel(SampleType::F32, "mask")?;
    in_blocks(cx, STAGE, samples, pace, cancel, |first, count, groups| {
        let args = MaskArgs {
            first,
            count,
            samples_type: type_number(field.sample_type),
            labels_type: type_number(labels.sample_type),
            out_type: type_number(outside.sample_type),
            ranges: inside.ranges.len() as u32,
            is_complement: inside.is_complement.into(),
            missing_label: labels.missing,
            missing: outside.value,
        };
        let all: [&dyn Arg; 5] = [&args, field.samples, labels.samples, &ranges, out];
        cx.launch(STAGE, &kernel, groups, BRICK_GROUP, &all)
    })
}
