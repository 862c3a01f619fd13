//! Device programs: one for each stage in `cl/`, built at the first use of one of its kernels, so that a driver with a slow
//! compiler compiles only the stages that a surface needs.

use crate::device::Found;
use crate::lock::lock;
use crate::sources::{self, Source};
use crate::{Error, Result, SampleType};
use opencl3::context::Context;
use opencl3::kernel::Kernel;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};

/// A built program and its kernels.
pub(crate) struct Program {
    kernels: HashMap<String, Arc<Mutex<Kernel>>>,
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

impl Program {
    /// Builds any text, which may include files of `cl/`; `stage` names it in errors.
    ///
    /// # Errors
    /// [`Error::Build`] with the compiler's log, or [`Error::Launch`].
    pub fn build(context: &Context, device: &Found, source: &str, options: &str, stage: &'static str) -> Result<Self> {
        let failed = |e| Error::Launch { stage, source: e };
        let text = sources::resolve(stage, source);
        let build = || build(context, device, &text, options, stage);
        #[cfg(feature = "testing")]
        let program = shared::program(context, options, &text, build)?;
        #[cfg(not(feature = "testing"))]
        let program = build()?;
        let kernels = opencl3::kernel::create_program_kernels(&program)
            .map_err(failed)?
            .into_iter()
            .map(|kernel| Ok((kernel.function_name()?, Arc::new(Mutex::new(kernel)))))
            .collect::<std::result::Result<_, _>>()
            .map_err(failed)?;
        Ok(Self { kernels })
    }

    /// The kernel of that name.
    ///
    /// # Panics
    /// The program has no kernel of that name. Every name in this crate is a literal from its source.
    pub fn get(&self, name: &str) -> &Arc<Mutex<Kernel>> {
        let kernel = self.kernels.get(name);
        kernel.unwrap_or_else(|| panic!("no kernel named {name} in its program"))
    }
}

/// Variant of a stage's program.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Variant {
    /// Samples of a type.
    Samples(SampleType),
    /// Reads no samples: the same for all types.
    Shared,
    /// Uneven axes.
    Uneven,
}

impl Variant {
    fn options(self) -> String {
        match self {
            Self::Samples(sample_type) => format!("-DSAMPLE={}", sample_type_name(sample_type)),
            // Any type: the headers need one.
            Self::Shared => "-DSAMPLE=float".to_owned(),
            Self::Uneven => "-DUNEVEN -DSAMPLE=float".to_owned(),
        }
    }
}

fn name_of((file, variant): &(&'static str, Variant)) -> String {
    format!("{file} {}", variant.options())
}

/// The kernels of a device's stages. A stage's program is built at the first use of one of its kernels.
pub(crate) struct Programs {
    /// The source of each kernel.
    source_of: HashMap<&'static str, &'static Source>,
    built: Mutex<HashMap<(&'static str, Variant), Arc<Program>>>,
    /// Gate that allows a program to be built.
    gate: Mutex<Option<Gate>>,
    /// Check before the driver's compiler runs.
    check: Mutex<Option<CompilerCheck>>,
    /// Launched variants of kernels: kernel, work-items of a group, and whether there are few work-items.
    launched: Mutex<HashSet<(usize, usize, bool)>>,
}

/// PoCL compiles one variant of a kernel for launches of at most this many work-items, and another one for more.
pub(crate) const FEW_WORK_ITEMS: usize = u16::MAX as usize;

/// Returns whether the program of that name ([`crate::Engine::programs`]) may be built already, or an error with the reason if it never
/// may.
pub type Gate = Box<dyn Fn(&str) -> std::result::Result<bool, String> + Send>;

/// Called before the driver's compiler runs; returns an error with the reason if it must not run.
pub type CompilerCheck = Box<dyn Fn() -> std::result::Result<(), String> + Send>;

impl Programs {
    pub fn new(sources: &'static [Source]) -> Self {
        let names = |source: &'static Source| source.kernel_names().map(move |name| (name, source));
        Self {
            source_of: sources.iter().flat_map(names).collect(),
            built: Mutex::default(),
            gate: Mutex::default(),
            check: Mutex::default(),
            launched: Mutex::default(),
        }
    }

    /// Sets the gate that must allow each further program before it is built.
    pub fn set_gate(&self, gate: Gate) {
        *lock(&self.gate) = Some(gate);
    }

    /// Sets the check that is called before the compiler runs.
    pub fn check_compiler(&self, check: CompilerCheck) {
        *lock(&self.check) = Some(check);
    }

    fn may_compile(&self) -> Result<()> {
        match &*lock(&self.check) {
            Some(check) => check().map_err(Error::Refused),
            None => Ok(()),
        }
    }

    /// Checks that the program of that name may be built.
    ///
    /// # Errors
    /// [`Error::ProgramUnchecked`], or [`Error::Refused`] with the reason of the gate or of the compiler check.
    pub fn pass(&self, name: &str) -> Result<()> {
        if let Some(gate) = &*lock(&self.gate)
            && !gate(name).map_err(Error::Refused)?
        {
            return Err(Error::ProgramUnchecked(name.to_owned()));
        }
        self.may_compile()
    }

    /// Calls the compiler check before the first launch of a variant of a kernel, because PoCL compiles variants at their first launch: one
    /// for each work-group size, for few work-items and for many. Returns whether this is the first launch of the variant.
    ///
    /// # Errors
    /// [`Error::Refused`] with the reason of the compiler check.
    pub fn pass_launch(&self, kernel: &Kernel, global: usize, local: usize) -> Result<bool> {
        let variant = (kernel.get() as usize, local, global <= FEW_WORK_ITEMS);
        if lock(&self.launched).contains(&variant) {
            return Ok(false);
        }
        self.may_compile()?;
        lock(&self.launched).insert(variant);
        Ok(true)
    }

    /// Names of the programs that are built, in no order.
    pub fn names(&self) -> Vec<String> {
        lock(&self.built).keys().map(name_of).collect()
    }

    /// The program of the stage that has this kernel, for samples of a type, or for uneven axes.
    ///
    /// # Errors
    /// As [`Program::build`].
    ///
    /// # Panics
    /// No stage has a kernel of that name. Every name in this crate is a literal from `cl/`.
    pub fn of_kernel(
        &self,
        name: &str,
        sample_type: Option<SampleType>,
        build: impl FnOnce(&'static Source, &str) -> Result<Program>,
    ) -> Result<Arc<Program>> {
        let source = self.source_of.get(name);
        let source = *source.unwrap_or_else(|| panic!("no kernel named {name} in cl/"));
        let variant = match sample_type {
            Some(sample_type) if source.reads_samples => Variant::Samples(sample_type),
            Some(_) => Variant::Shared,
            None => Variant::Uneven,
        };
        let key = (source.file, variant);
        if let Some(program) = lock(&self.built).get(&key) {
            return Ok(Arc::clone(program));
        }
        self.pass(&name_of(&key))?;
        let program = Arc::new(build(source, &variant.options())?);
        lock(&self.built).insert(key, Arc::clone(&program));
        Ok(program)
    }
}

/// Text in PoCL's log of a build that a signal interrupted: LLVM's handler of SIGHUP, SIGINT and SIGTERM removes the compiler's
/// temporary files and then calls the handler of the process, which may continue.
const INTERRUPTED: &str = "unable to rename temporary";

/// Maximum number of retries of an interrupted build.
const BUILD_RETRIES: usize = 3;

fn build(
    context: &Context,
    device: &Found,
    text: &str,
    options: &str,
    stage: &'static str,
) -> Result<opencl3::program::Program> {
    let failed = |e| Error::Launch { stage, source: e };
    let mut retries = BUILD_RETRIES;
    loop {
        let mut program = opencl3::program::Program::create_from_source(context, text).map_err(failed)?;
        if program.build(&[device.device.id()], options).is_ok() {
            return Ok(program);
        }
        let log = program
            .get_build_log(device.device.id())
            .unwrap_or_else(|_| "no log".to_owned());
        if retries == 0 || !log.contains(INTERRUPTED) {
            return Err(Error::Build {
                stage,
                options: options.to_owned(),
                log,
            });
        }
        retries -= 1;
    }
}

/// Programs that tests have built for the context that they share. Tests open the device many times, and building a program takes a driver
/// tens of milliseconds even if its own cache has it.
#[cfg(feature = "testing")]
pub(crate) mod shared {
    use super::{Context, Found};
    use crate::{Result, error::OPEN, lock};
    use opencl3::program::Program;
    use std::collections::HashMap;
    use std::collections::hash_map::Entry;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, LazyLock, Mutex};

    static IS_ON: AtomicBool = AtomicBool::new(false);
    static CONTEXTS: LazyLock<Mutex<HashMap<usize, Arc<Context>>>> = LazyLock::new(Mutex::default);
    static PROGRAMS: LazyLock<Mutex<HashMap<Key, Arc<Program>>>> = LazyLock::new(Mutex::default);

    /// Cache key of a program: context, options and text.
    type Key = (usize, String, String);

    /// From now on, engines of one device share its context, and their programs.
    pub(crate) fn begin() {
        IS_ON.store(true, Ordering::Relaxed);
    }

    /// Returns the context that engines of a device share, if they do.
    pub(crate) fn context(device: &Found) -> Result<Option<Arc<Context>>> {
        if !IS_ON.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let failed = |source| crate::Error::Launch { stage: OPEN, source };
        let context = match lock(&CONTEXTS).entry(device.device.id() as usize) {
            Entry::Occupied(shared) => Arc::clone(shared.get()),
            Entry::Vacant(first) => {
                let context = Context::from_device(&device.device).map_err(failed)?;
                Arc::clone(first.insert(Arc::new(context)))
            }
        };
        Ok(Some(context))
    }

    /// Returns the program, which is built if the engines of this context do not share it yet.
    pub(super) fn program(
        context: &Context,
        options: &str,
        text: &str,
        build: impl FnOnce() -> Result<Program>,
    ) -> Result<Arc<Program>> {
        let is_shared = lock(&CONTEXTS).values().any(|shared| shared.get() == context.get());
        if !is_shared {
            return Ok(Arc::new(build()?));
        }
        let key = (context.get() as usize, options.to_owned(), text.to_owned());
        if let Some(program) = lock(&PROGRAMS).get(&key) {
            return Ok(Arc::clone(program));
        }
        let program = Arc::new(build()?);
        lock(&PROGRAMS).insert(key, Arc::clone(&program));
        Ok(program)
    }
}
