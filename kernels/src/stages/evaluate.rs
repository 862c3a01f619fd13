//! Fields that are computed from others by an expression.

use super::BRICK_GROUP;
use super::args::kernel_args;
use super::construct::type_number;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::expression::Encoded;
use crate::pace::Pace;
use crate::program::FEW_WORK_ITEMS;
use crate::{Cancel, DeviceKind, Result, SampleType, constants};

/// Name of the stage.
pub const STAGE: &str = "evaluate";

kernel_args! {
    /// Arguments of `evaluate`.
    EvaluateArgs {
        /// First sample of this launch, in blocks of LAUNCH_BLOCK.
        first: u32,
        /// Samples of this launch.
        count: u32,
        /// Operations of the expression.
        operations: u32,
        /// Fields of the expression.
        fields: u32,
        /// Sample type of the first field, `TYPE_U8` to `TYPE_F32`.
        type_0: u32,
        /// Of the second one.
        type_1: u32,
        /// Of the third one.
        type_2: u32,
        /// Of the fourth one.
        type_3: u32,
        /// Of the fifth one.
        type_4: u32,
        /// Of the sixth one.
        type_5: u32,
        /// Of the seventh one.
        type_6: u32,
        /// Of the eighth one.
        type_7: u32,
        /// Samples of the first field equal to this count as NaN.
        missing_0: f32,
        /// Of the second one.
        missing_1: f32,
        /// Of the third one.
        missing_2: f32,
        /// Of the fourth one.
        missing_3: f32,
        /// Of the fifth one.
        missing_4: f32,
        /// Of the sixth one.
        missing_5: f32,
        /// Of the seventh one.
        missing_6: f32,
        /// Of the eighth one.
        missing_7: f32,
    }
}

/// Samples of a block, with which launches begin.
const BLOCK: u64 = constants::LAUNCH_BLOCK as u64;

/// Blocks of the first launch, which measures the cost of the expression.
const FIRST_BLOCKS: u64 = 64;

/// Blocks of one launch at most.
const MAX_BLOCKS: u64 = 1 << 15;

/// Pace of an expression's launches, in blocks. On a CPU the launches stay so small that PoCL uses the kernel variant that the device
/// check has already compiled: compiling another variant would block other jobs for too long.
pub fn pace(cx: &Context) -> Pace {
    let few_blocks = (FEW_WORK_ITEMS / BRICK_GROUP * BRICK_GROUP * cx.tuning.lanes) as u64 / BLOCK;
    let max_blocks = match cx.found.info.kind {
        DeviceKind::Cpu => MAX_BLOCKS.min(few_blocks),
        _ => MAX_BLOCKS,
    };
    Pace::new(FIRST_BLOCKS.min(max_blocks), 1, max_blocks)
}

/// Covers `samples` samples by launches whose sizes `pace` chooses. `launch` takes the first block, the samples and the work-groups of
/// one launch.
pub(super) fn in_blocks(
    cx: &Context,
    stage: &'static str,
    samples: u64,
    pace: &mut Pace,
    cancel: &dyn Cancel,
    launch: impl Fn(u32, u32, usize) -> Result<()>,
) -> Result<()> {
    let mut done = 0;
    while done < samples {
        let count = (pace.units() * BLOCK).min(samples - done);
        let groups = count.div_ceil((BRICK_GROUP * cx.tuning.lanes) as u64) as usize;
        cx.paced(stage, pace, count.div_ceil(BLOCK), || {
            launch((done / BLOCK) as u32, count as u32, groups)
        })?;
        done += count;
        cx.pause(stage, cancel)?;
    }
    Ok(())
}

/// A field of an expression, or of a mask.
pub struct Input<'a> {
    pub samples: &'a Buffer<u8>,
    pub sample_type: SampleType,
    /// Samples equal to this count as NaN.
    pub missing: f32,
}

/// Fills `out`, which holds `samples` samples, by launches whose sizes `pace` chooses. `inputs`: the fields in the same slab; fields that
/// the expression does not use are not read.
pub fn run(
    cx: &Context,
    expression: &Encoded,
    inputs: [Input<'_>; constants::EXPRESSION_FIELDS as usize],
    out: &Buffer<u8>,
    samples: u64,
    pace: &mut Pace,
    cancel: &dyn Cancel,
) -> Result<()> {
    let operations = cx.upload(STAGE, &expression.operations)?;
    let kernel = cx.kernel(SampleType::F32, "evaluate")?;
    let types = inputs.each_ref().map(|input| type_number(input.sample_type));
    let missing = inputs.each_ref().map(|input| input.missing);
    in_blocks(cx, STAGE, samples, pace, cancel, |first, count, groups| {
        let args = EvaluateArgs {
            first,
            count,
            operations: expression.operations.len() as u32,
            fields: expression.fields,
            type_0: types[0],
            type_1: types[1],
            type_2: types[2],
            type_3: types[3],
            type_4: types[4],
            type_5: types[5],
            type_6: types[6],
            type_7: types[7],
            missing_0: missing[0],
            missing_1: missing[1],
            missing_2: missing[2],
            missing_3: missing[3],
            missing_4: missing[4],
            missing_5: missing[5],
            missing_6: missing[6],
            missing_7: missing[7],
        };
        let mut all: Vec<&dyn Arg> = vec![&args, &operations];
        all.extend(inputs.iter().map(|input| input.samples as &dyn Arg));
        all.push(out);
        cx.launch(STAGE, &kernel, groups, BRICK_GROUP, &all)
    })
}
