//! Device programs: one for each stage in `cl/`, built when one of its kernels is first wanted, so that a driver with a slow
//! compiler compiles only what a surface needs.

use crate::device::Found;
use crate::sources::{self, Source};
use crate::{Error, Result, SampleType};
use opencl3::context::Context;
use opencl3::kernel::Kernel;
use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

/// A built program and its kernels.
pub(crate) struct Program {
    kernels: HashMap<String, Rc<Kernel>>,
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
            .map(|kernel| Ok((kernel.function_name()?, Rc::new(kernel))))
            .collect::<std::result::Result<_, _>>()
            .map_err(failed)?;
        Ok(Self { kernels })
    }

    /// The kernel of that name.
    ///
    /// # Panics
    /// The program has none of that name: every name in this crate is a literal that stands in its source.
    pub fn get(&self, name: &str) -> &Rc<Kernel> {
        let kernel = self.kernels.get(name);
        kernel.unwrap_or_else(|| panic!("no kernel named {name} in its program"))
    }
}

/// What a stage's program is built for.
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
            // Of any type: headers want one.
            Self::Shared => "-DSAMPLE=float".to_owned(),
            Self::Uneven => "-DUNEVEN -DSAMPLE=float".to_owned(),
        }
    }
}

fn name_of((file, variant): &(&'static str, Variant)) -> String {
    format!("{file} {}", variant.options())
}

/// The kernels of a device's stages. A stage's program is built when one of its kernels is first wanted.
pub(crate) struct Programs {
    /// The source of each kernel.
    source_of: HashMap<&'static str, &'static Source>,
    built: RefCell<HashMap<(&'static str, Variant), Rc<Program>>>,
    /// What lets a program be built.
    gate: RefCell<Option<Gate>>,
    /// Whether anything more may be compiled.
    check: RefCell<Option<CompilerCheck>>,
    /// Variants of kernels that were launched: kernel, work-items of a group, and whether there are few work-items.
    launched: RefCell<HashSet<(usize, usize, bool)>>,
}

/// PoCL compiles one variant of a kernel for launches of at most this many work-items, and another one for more.
pub(crate) const FEW_WORK_ITEMS: usize = u16::MAX as usize;

/// Whether the program of that name may be built ([`crate::Engine::programs`]) already, or why it never may.
pub type Gate = Box<dyn Fn(&str) -> std::result::Result<bool, String>>;

/// Says why the driver's compiler is not to run, before it does.
pub type CompilerCheck = Box<dyn Fn() -> std::result::Result<(), String>>;

impl Programs {
    pub fn new(sources: &'static [Source]) -> Self {
        let names = |source: &'static Source| source.kernel_names().map(move |name| (name, source));
        Self {
            source_of: sources.iter().flat_map(names).collect(),
            built: RefCell::default(),
            gate: RefCell::default(),
            check: RefCell::default(),
            launched: RefCell::default(),
        }
    }

    /// No further program is built before `gate` lets it.
    pub fn set_gate(&self, gate: Gate) {
        self.gate.replace(Some(gate));
    }

    /// Nothing more is compiled if `check` says why.
    pub fn check_compiler(&self, check: CompilerCheck) {
        self.check.replace(Some(check));
    }

    fn may_compile(&self) -> Result<()> {
        match &*self.check.borrow() {
            Some(check) => check().map_err(Error::Refused),
            None => Ok(()),
        }
    }

    /// Checks that the program of that name may be built.
    ///
    /// # Errors
    /// [`Error::NotYet`]; [`Error::Refused`]: what the gate or the check of the compiler says.
    pub fn pass(&self, name: &str) -> Result<()> {
        if let Some(gate) = &*self.gate.borrow()
            && !gate(name).map_err(Error::Refused)?
        {
            return Err(Error::NotYet(name.to_owned()));
        }
        self.may_compile()
    }

    /// Checks before the first launch of a variant of a kernel, which PoCL compiles only then: one for each size of work-groups, for few
    /// work-items and for many.
    ///
    /// # Errors
    /// [`Error::Refused`]: what the check of the compiler says.
    pub fn pass_launch(&self, kernel: &Kernel, global: usize, local: usize) -> Result<()> {
        let variant = (kernel.get() as usize, local, global <= FEW_WORK_ITEMS);
        if self.launched.borrow().contains(&variant) {
            return Ok(());
        }
        self.may_compile()?;
        self.launched.borrow_mut().insert(variant);
        Ok(())
    }

    /// Names of the programs that are built, in no order.
    pub fn names(&self) -> Vec<String> {
        self.built.borrow().keys().map(name_of).collect()
    }

    /// The program of the stage that has this kernel, for samples of a type, or for uneven axes.
    ///
    /// # Errors
    /// As [`Program::build`].
    ///
    /// # Panics
    /// No stage has a kernel of that name: every name in this crate is a literal that stands in `cl/`.
    pub fn of_kernel(
        &self,
        name: &str,
        sample_type: Option<SampleType>,
        build: impl FnOnce(&'static Source, &str) -> Result<Program>,
    ) -> Result<Rc<Program>> {
        let source = self.source_of.get(name);
        let source = *source.unwrap_or_else(|| panic!("no kernel named {name} in cl/"));
        let variant = match sample_type {
            Some(sample_type) if source.reads_samples => Variant::Samples(sample_type),
            Some(_) => Variant::Shared,
            None => Variant::Uneven,
        };
        let key = (source.file, variant);
        if let Some(program) = self.built.borrow().get(&key) {
            return Ok(Rc::clone(program));
        }
        self.pass(&name_of(&key))?;
        let program = Rc::new(build(source, &variant.options())?);
        self.built.borrow_mut().insert(key, Rc::clone(&program));
        Ok(program)
    }
}

/// In PoCL's log of a build that a signal interrupted: LLVM's handler of SIGHUP, SIGINT and SIGTERM removes the compiler's temporary files,
/// and then calls the handler of the process, which may go on.
const INTERRUPTED: &str = "unable to rename temporary";

/// Maximum times that an interrupted build is begun again.
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
        if program.build(&[device.handle], options).is_ok() {
            return Ok(program);
        }
        let log = program
            .get_build_log(device.handle)
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

/// Programs that this process has built. Tests open the device again and again, and not every driver keeps what it compiled.
#[cfg(feature = "testing")]
mod built {
    use super::{Context, Found};
    use opencl3::program::Program;
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

        /// Returns the program if it was built before and the driver accepts its binary.
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
            if device.info.platform == crate::device::POCL {
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
