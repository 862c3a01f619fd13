//! The device program: one text made of `cl/`, built once for each sample type.

use crate::device::Found;
use crate::tables::{cases, sheets::Sheets};
use crate::{Error, Result, SampleType, Tuning};
use opencl3::context::Context;
use opencl3::kernel::Kernel;
use opencl3::program::Program;
use std::collections::HashMap;

/// Shared headers, then the stages in order of execution.
const SOURCES: [&str; 28] = [
    include_str!("../cl/shared/layout.h"),
    include_str!("../cl/shared/grid.h"),
    include_str!("../cl/shared/samples.h"),
    include_str!("../cl/shared/scan.h"),
    include_str!("../cl/shared/sheets.h"),
    include_str!("../cl/shared/quadric.h"),
    include_str!("../cl/shared/cells.h"),
    include_str!("../cl/shared/cubes.h"),
    include_str!("../cl/shared/sheet_vertices.h"),
    include_str!("../cl/shared/relax.h"),
    include_str!("../cl/shared/nodes.h"),
    include_str!("../cl/shared/leaf.h"),
    include_str!("../cl/shared/polygon.h"),
    include_str!("../cl/shared/part.h"),
    include_str!("../cl/shared/vertices.h"),
    include_str!("../cl/shared/batch.h"),
    include_str!("../cl/shared/corners.h"),
    include_str!("../cl/minmax.cl"),
    include_str!("../cl/histogram.cl"),
    include_str!("../cl/activate.cl"),
    include_str!("../cl/classify.cl"),
    include_str!("../cl/construct.cl"),
    include_str!("../cl/cut.cl"),
    include_str!("../cl/march.cl"),
    include_str!("../cl/patch.cl"),
    include_str!("../cl/pack.cl"),
    include_str!("../cl/dual.cl"),
    include_str!("../cl/error.cl"),
];

/// The kernels for volumes of one sample type.
pub(crate) struct Kernels {
    kernels: HashMap<String, Kernel>,
    _program: Program,
}

fn sample_type_name(sample_type: SampleType) -> &'static str {
    match sample_type {
        SampleType::U8 => "uchar",
        SampleType::I8 => "char",
        SampleType::U16 => "ushort",
        SampleType::I16 => "short",
        SampleType::F32 => "float",
    }
}

impl Kernels {
    /// Builds the program from source.
    pub fn build(context: &Context, device: &Found, tuning: Tuning, sample_type: SampleType) -> Result<Self> {
        let options = format!(
            "-cl-std=CL1.2 -DSAMPLE={} {}",
            sample_type_name(sample_type),
            tuning.defines()
        );
        Self::build_sources(
            context,
            device,
            &[&sheet_tables(), &SOURCES.concat()],
            &options,
            "program",
        )
    }

    /// Builds any text; `stage` names it in errors.
    pub fn build_sources(
        context: &Context,
        device: &Found,
        sources: &[&str],
        options: &str,
        stage: &'static str,
    ) -> Result<Self> {
        let failed = |e| Error::Launch { stage, source: e };
        let mut program = Program::create_from_source(context, &sources.concat()).map_err(failed)?;
        if program.build(&[device.handle], options).is_err() {
            let log = program
                .get_build_log(device.handle)
                .unwrap_or_else(|_| "no log".to_owned());
            return Err(Error::Build {
                stage,
                options: options.to_owned(),
                log,
            });
        }
        let kernels = opencl3::kernel::create_program_kernels(&program)
            .map_err(failed)?
            .into_iter()
            .map(|kernel| Ok((kernel.function_name()?, kernel)))
            .collect::<std::result::Result<_, _>>()
            .map_err(failed)?;
        Ok(Self {
            kernels,
            _program: program,
        })
    }

    /// The kernel of that name; every name in this crate is a literal that stands in `cl/`.
    pub fn get(&self, name: &str) -> &Kernel {
        self.kernels
            .get(name)
            .unwrap_or_else(|| panic!("no kernel named {name} in cl/"))
    }
}

/// The marching-cubes table as the kernels read it: 16 bytes a case, triangles first.
pub(crate) fn case_table() -> Vec<u8> {
    cases::case_triangles().concat()
}

/// One byte a case, four to a word: triangles, sheets << 3, and bit 6 where a face joins two segments in one sheet.
pub(crate) fn case_facts() -> Vec<u32> {
    let triangles = cases::case_triangles();
    let fact = |signs: usize| {
        let sheets = Sheets::trace(signs as u8, 0);
        u32::from(triangles[signs][0]) | u32::from(sheets.count) << 3 | u32::from(sheets.joined_faces() != 0) << 6
    };
    (0..64)
        .map(|word| (0..4).fold(0, |bits, byte| bits | fact(4 * word + byte) << (8 * byte)))
        .collect()
}

/// The tables of `cl/shared/sheets.h` as program text.
fn sheet_tables() -> String {
    let cases: Vec<_> = (0..=255).map(|signs| Sheets::trace(signs, 0)).collect();
    let list = |numbers: Vec<u32>| numbers.iter().map(|n| format!("{n}u")).collect::<Vec<_>>().join(",");
    let mut intricate = vec![0u32; 8];
    let (mut rows, mut flipped) = (Vec::new(), Vec::new());
    for (signs, sheets) in cases.iter().enumerate() {
        let faces = sheets.joined_faces();
        intricate[signs / 32] |= u32::from(sheets.count > 1 || faces != 0) << (signs % 32);
        rows.push(flipped.len() as u32);
        // One entry for each set of those faces, their bits pushed together.
        let chosen = |set: u32| {
            (0..6)
                .filter(|&f| faces >> f & 1 == 1)
                .enumerate()
                .filter(move |(i, _)| set >> i & 1 == 1)
        };
        let sets = 0..1u32 << faces.count_ones();
        let of_set = |set| Sheets::flipped(signs as u8, chosen(set).fold(0, |bits, (_, f)| bits | 1 << f)).packed();
        flipped.extend(sets.map(of_set));
    }
    let joined = cases.iter().map(|s| s.joined_faces().into()).collect();
    format!(
        "__constant unsigned int SHEETS[256] = {{{}}};\n\
         __constant unsigned char JOINED[256] = {{{}}};\n\
         __constant unsigned int INTRICATE[8] = {{{}}};\n\
         __constant unsigned int FLIPPED_ROW[256] = {{{}}};\n\
         __constant unsigned int FLIPPED[{}] = {{{}}};\n",
        list(cases.iter().map(Sheets::packed).collect()),
        list(joined),
        list(intricate),
        list(rows),
        flipped.len(),
        list(flipped),
    )
}
