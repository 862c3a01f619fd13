//! Device programs: one of the stages in `cl/` that read samples, built for each sample type, and one of all others.

use crate::device::Found;
use crate::sources::{self, Source};
use crate::{Error, Result, SampleType, Tuning};
use opencl3::context::Context;
use opencl3::kernel::Kernel;
use opencl3::program::Program;
use std::collections::HashMap;
use std::rc::Rc;

/// The kernels for volumes of one sample type.
pub(crate) struct Kernels {
    kernels: HashMap<String, Kernel>,
    /// Those that are the same for all types.
    shared: Option<Rc<Kernels>>,
    _program: Program,
}

pub(crate) fn sample_type_name(sample_type: SampleType) -> &'static str {
    match sample_type {
        SampleType::U8 => "uchar",
        SampleType::I8 => "char",
        SampleType::U16 => "ushort",
        SampleType::I16 => "short",
        SampleType::F32 => "float",
    }
}

impl Kernels {
    /// Builds the files in `cl/` that read samples, for samples of a type.
    pub fn build(
        context: &Context,
        device: &Found,
        tuning: Tuning,
        sample_type: SampleType,
        sources: &[Source],
        shared: Rc<Kernels>,
    ) -> Result<Self> {
        let files = sources.iter().filter(|source| source.reads_samples);
        let kernels = Self::build_files(context, device, tuning, sample_type, "", files)?;
        Ok(Self {
            shared: Some(shared),
            ..kernels
        })
    }

    /// Builds all other files.
    pub fn build_shared(context: &Context, device: &Found, tuning: Tuning, sources: &[Source]) -> Result<Self> {
        let files = sources.iter().filter(|source| !source.reads_samples);
        // Of any type: headers want one.
        Self::build_files(context, device, tuning, SampleType::F32, "", files)
    }

    /// Builds the files of which there is another program for uneven axes, for these.
    pub fn build_uneven(context: &Context, device: &Found, tuning: Tuning, sources: &[Source]) -> Result<Self> {
        let files = sources.iter().filter(|source| source.has_uneven);
        Self::build_files(context, device, tuning, SampleType::F32, "-DUNEVEN ", files)
    }

    fn build_files<'a>(
        context: &Context,
        device: &Found,
        tuning: Tuning,
        sample_type: SampleType,
        more: &str,
        sources: impl Iterator<Item = &'a Source>,
    ) -> Result<Self> {
        let options = format!(
            "-cl-std=CL1.2 {more}-DSAMPLE={} {}",
            sample_type_name(sample_type),
            tuning.defines()
        );
        let text: String = sources
            .map(|source| format!("#include \"{}\"\n", source.file))
            .collect();
        Self::build_source(context, device, &text, &options, "program")
    }

    /// Builds any text, which may include files of `cl/`; `stage` names it in errors.
    pub fn build_source(
        context: &Context,
        device: &Found,
        source: &str,
        options: &str,
        stage: &'static str,
    ) -> Result<Self> {
        let failed = |e| Error::Launch { stage, source: e };
        let text = sources::resolve(stage, source);
        #[cfg(feature = "testing")]
        let built = built::Key::new(device, options, &text);
        #[cfg(feature = "testing")]
        let known = built.program(context, device, options);
        #[cfg(not(feature = "testing"))]
        let known = None;
        let program = match known {
            Some(program) => program,
            None => build(context, device, &text, options, stage)?,
        };
        #[cfg(feature = "testing")]
        built.keep(&program, device);
        let kernels = opencl3::kernel::create_program_kernels(&program)
            .map_err(failed)?
            .into_iter()
            .map(|kernel| Ok((kernel.function_name()?, kernel)))
            .collect::<std::result::Result<_, _>>()
            .map_err(failed)?;
        Ok(Self {
            kernels,
            shared: None,
            _program: program,
        })
    }

    fn find(&self, name: &str) -> Option<&Kernel> {
        let shared = || self.shared.as_ref()?.find(name);
        self.kernels.get(name).or_else(shared)
    }

    /// The kernel of that name; every name in this crate is a literal that stands in `cl/`.
    pub fn get(&self, name: &str) -> &Kernel {
        self.find(name)
            .unwrap_or_else(|| panic!("no kernel named {name} in cl/"))
    }
}

fn build(context: &Context, device: &Found, text: &str, options: &str, stage: &'static str) -> Result<Program> {
    let failed = |e| Error::Launch { stage, source: e };
    let mut program = Program::create_from_source(context, text).map_err(failed)?;
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
    Ok(program)
}

/// Programs that this process has built. Tests open the device again and again, and not every driver keeps what it compiled.
#[cfg(feature = "testing")]
mod built {
    use super::{Context, Found, Program};
    use std::collections::HashMap;
    use std::sync::{LazyLock, Mutex, PoisonError};

    static BUILT: LazyLock<Mutex<HashMap<Key, Vec<u8>>>> = LazyLock::new(Mutex::default);

    /// What a program depends on: driver, options and text.
    #[derive(Clone, PartialEq, Eq, Hash)]
    pub(super) struct Key([String; 3]);

    impl Key {
        pub(super) fn new(device: &Found, options: &str, text: &str) -> Self {
            let driver = format!("{} {}", device.info.name, device.info.driver);
            Self([driver, options.to_owned(), text.to_owned()])
        }

        /// The program, where it was built before and the driver takes its binary back.
        pub(super) fn program(&self, context: &Context, device: &Found, options: &str) -> Option<Program> {
            let built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
            let binary = built.get(self)?;
            // SAFETY: the binary is one that this driver gave for this device.
            let mut program = unsafe { Program::create_from_binary(context, &[device.handle], &[binary]) }.ok()?;
            program.build(&[device.handle], options).ok()?;
            Some(program)
        }

        /// Keeps a program, but not one of PoCL: that driver keeps more than the binary itself, the kernels of each work-group size too.
        pub(super) fn keep(self, program: &Program, device: &Found) {
            if device.info.platform == "Portable Computing Language" {
                return;
            }
            let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
            if let (false, Ok(binaries)) = (built.contains_key(&self), program.get_binaries())
                && let Some(binary) = binaries.into_iter().find(|binary| !binary.is_empty())
            {
                built.insert(self, binary);
            }
        }
    }
}
