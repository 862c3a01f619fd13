//! An open device: its queue, programs, memory and stage times.

use crate::activity::Activity;
use crate::buffer::{Buffer, Pool, allocation_error};
use crate::cancel::{Cancel, check_cancelled};
use crate::device::{self, Found};
use crate::error::OPEN;
use crate::lock::lock;
use crate::pace::Pace;
use crate::program::{Program, Programs};
use crate::sources::Source;
use crate::{Error, Result, SampleType, StageTime, Tuning, layout};
use bytemuck::Pod;
use opencl3::command_queue::{CL_QUEUE_PROFILING_ENABLE, CommandQueue};
use opencl3::error_codes::ClError;
use opencl3::event::Event;
use opencl3::kernel::Kernel;
use opencl3::types::{CL_BLOCKING, cl_event};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Instant;

mod large_pages;
pub mod read_back;
#[cfg(feature = "testing")]
pub mod recorder;

use read_back::{Blocks, Returned};

/// A kernel argument.
pub(crate) trait Arg {
    fn set(&self, kernel: &Kernel, index: u32) -> std::result::Result<(), ClError>;

    /// The device memory of this argument, if it is a buffer.
    #[cfg(feature = "testing")]
    fn contents(&self, _context: &Context) -> Option<Result<Vec<u8>>> {
        None
    }
}

impl<T> Arg for Buffer<T> {
    fn set(&self, kernel: &Kernel, index: u32) -> std::result::Result<(), ClError> {
        // SAFETY: the handle is valid while the buffer lives, and OpenCL retains it with the kernel until it ran.
        unsafe { kernel.set_arg(index, &self.handle()) }
    }

    #[cfg(feature = "testing")]
    fn contents(&self, context: &Context) -> Option<Result<Vec<u8>>> {
        Some(context.read_bytes(self))
    }
}

/// A local memory argument: bytes of each work-group.
pub(crate) struct LocalBytes(pub usize);

impl Arg for LocalBytes {
    fn set(&self, kernel: &Kernel, index: u32) -> std::result::Result<(), ClError> {
        // SAFETY: nothing is passed but a size; the parameter is a local pointer.
        unsafe { kernel.set_arg_local_buffer(index, self.0) }
    }
}

macro_rules! value_args {
    ($($kind:ty),*) => {$(
        impl Arg for $kind {
            fn set(&self, kernel: &Kernel, index: u32) -> std::result::Result<(), ClError> {
                // SAFETY: a plain value of the kernel's parameter's size; the driver refuses any other.
                unsafe { kernel.set_arg(index, self) }
            }
        }
    )*};
}
value_args!(u32, f32);

/// A struct that has the same layout in the device's compiler: the test of layouts compares them.
pub(crate) trait ByValue {}

impl<T: ByValue> Arg for T {
    fn set(&self, kernel: &Kernel, index: u32) -> std::result::Result<(), ClError> {
        // SAFETY: a plain value of the size and layout of the kernel's parameter; the driver refuses any other size.
        unsafe { kernel.set_arg(index, self) }
    }
}

impl ByValue for layout::Grid {}
impl ByValue for layout::CutParams {}

/// The share 1 / `IDLE_SHARE` of a device's memory may stay idle between edits.
const IDLE_SHARE: u64 = 16;

/// Stage name of a program of any text; also the name that a gate gets.
const CUSTOM: &str = "custom program";

/// Maximum number of events that are kept before their times are added up.
const MAX_EVENTS: usize = 4096;

/// An open device.
pub(crate) struct Context {
    pub found: Found,
    /// How kernels are built and launched on it.
    pub tuning: Tuning,
    pub context: Arc<opencl3::context::Context>,
    pub queue: CommandQueue,
    pub programs: Programs,
    pub pool: Arc<Pool>,
    pub activity: Arc<Activity>,
    events: Mutex<Vec<(&'static str, Event)>>,
    /// Times of events before these.
    times: Mutex<Vec<StageTime>>,
    /// Pinned memory that meshes are read to.
    pub blocks: Mutex<Blocks>,
    /// Returns memory lent to surfaces: at most two buffers for each of them, or all blocks.
    pub returned: (Sender<Returned>, Mutex<Receiver<Returned>>),
    /// Largest allocation that is tried, in bytes.
    pub limit_bytes: u64,
    #[cfg(feature = "testing")]
    pub recorder: recorder::Recorder,
}

impl Context {
    /// Opens a device. `limit_bytes` lowers the largest allocation (tests force several slabs with it). `tuning`: by default that of
    /// the device's kind. `sources`: the sources of its programs.
    pub fn open(
        selector: Option<&str>,
        limit_bytes: Option<u64>,
        tuning: Option<Tuning>,
        sources: &'static [Source],
    ) -> Result<Self> {
        let found = device::select(selector)?;
        let failed = |source| Error::Launch { stage: OPEN, source };
        let own = || opencl3::context::Context::from_device(&found.device).map(Arc::new);
        #[cfg(feature = "testing")]
        let context = match crate::program::shared::context(&found)? {
            Some(shared) => shared,
            None => own().map_err(failed)?,
        };
        #[cfg(not(feature = "testing"))]
        let context = own().map_err(failed)?;
        // The deprecated call, because the newer one does not exist on OpenCL 1.2 drivers.
        #[allow(deprecated)]
        // SAFETY: the device belongs to the context just made.
        let queue =
            unsafe { CommandQueue::create(&context, found.device.id(), CL_QUEUE_PROFILING_ENABLE) }.map_err(failed)?;
        let limit_bytes = limit_bytes.unwrap_or(u64::MAX).min(found.info.max_allocation_bytes);
        let idle_limit = found.info.memory_bytes / IDLE_SHARE;
        let (returner, returned) = channel();
        Ok(Self {
            tuning: tuning.unwrap_or(Tuning::of(&found.info)),
            found,
            context,
            queue,
            programs: Programs::new(sources),
            pool: Arc::new(Pool::new(idle_limit)),
            activity: Arc::default(),
            events: Mutex::default(),
            times: Mutex::default(),
            blocks: Mutex::default(),
            returned: (returner, Mutex::new(returned)),
            limit_bytes,
            #[cfg(feature = "testing")]
            recorder: Default::default(),
        })
    }

    /// Returns the kernel of that name for samples of a type. Builds its stage's program at the first use.
    ///
    /// # Errors
    /// [`Error::Build`], or an error of the device.
    pub fn kernel(&self, sample_type: SampleType, name: &str) -> Result<Arc<Mutex<Kernel>>> {
        self.find_kernel(name, Some(sample_type))
    }

    /// The kernel of that name for uneven axes; otherwise as [`Context::kernel`].
    ///
    /// # Errors
    /// As [`Context::kernel`].
    pub fn uneven_kernel(&self, name: &str) -> Result<Arc<Mutex<Kernel>>> {
        self.find_kernel(name, None)
    }

    fn find_kernel(&self, name: &str, sample_type: Option<SampleType>) -> Result<Arc<Mutex<Kernel>>> {
        let program = self.programs.of_kernel(name, sample_type, |source, options| {
            let text = format!("#include \"{}\"\n", source.file);
            let options = format!("-cl-std=CL1.2 {options} {}", self.tuning.defines());
            self.activity.begin_compiling();
            Program::build(&self.context, &self.found, &text, &options, source.stage)
        })?;
        Ok(Arc::clone(program.get(name)))
    }

    /// Builds a program of any text, which may include files of `cl/`.
    pub fn build(&self, source: &str, options: &str) -> Result<Program> {
        self.programs.pass(CUSTOM)?;
        self.activity.begin_compiling();
        Program::build(&self.context, &self.found, source, options, CUSTOM)
    }

    /// A buffer of `len` elements, contents undefined.
    pub fn buffer<T>(&self, stage: &'static str, len: usize) -> Result<Buffer<T>> {
        self.reclaim()?;
        let (buffer, is_new) = Buffer::new(&self.context, &self.pool, self.limit_bytes, stage, len)?;
        if is_new {
            self.ask_for_large_pages(&buffer);
        }
        #[cfg(feature = "testing")]
        if self.recorder.is_on() {
            self.clear_bytes(stage, &buffer)?;
        }
        Ok(buffer)
    }

    /// Fills a buffer of any type with zero bytes.
    #[cfg(feature = "testing")]
    fn clear_bytes<T>(&self, stage: &'static str, buffer: &Buffer<T>) -> Result<()> {
        let bytes = buffer.bytes() as usize;
        // SAFETY: the write is blocking and covers the buffer, which is another name of the same memory and not released.
        let event = unsafe {
            let mut raw = std::mem::ManuallyDrop::new(opencl3::memory::Buffer::<u8>::new(buffer.handle()));
            self.queue
                .enqueue_write_buffer(&mut raw, CL_BLOCKING, 0, &vec![0u8; bytes], &[])
        };
        self.record(stage, event, bytes as u64)
    }

    /// All bytes of a buffer of any type.
    #[cfg(feature = "testing")]
    fn read_bytes<T>(&self, buffer: &Buffer<T>) -> Result<Vec<u8>> {
        let mut data = vec![0u8; buffer.bytes() as usize];
        // SAFETY: as above; the read is blocking and covers the buffer.
        let event = unsafe {
            let raw = std::mem::ManuallyDrop::new(opencl3::memory::Buffer::<u8>::new(buffer.handle()));
            self.queue.enqueue_read_buffer(&raw, CL_BLOCKING, 0, &mut data, &[])
        };
        self.record("recorder", event, data.len() as u64)?;
        Ok(data)
    }

    /// `len` elements of zero bits.
    pub fn zeroed<T: Pod>(&self, stage: &'static str, len: usize) -> Result<Buffer<T>> {
        let mut buffer = self.buffer(stage, len)?;
        self.zero(stage, &mut buffer)?;
        Ok(buffer)
    }

    /// `len` elements of `value`.
    pub fn filled(&self, stage: &'static str, len: usize, value: u32) -> Result<Buffer<u32>> {
        let mut buffer = self.buffer(stage, len)?;
        let bytes = buffer.bytes() as usize;
        // SAFETY: the pattern is one element and the size is the whole buffer.
        let event = unsafe {
            self.queue
                .enqueue_fill_buffer(buffer.raw_mut(), &[value], 0, bytes, &[])
        };
        self.record(stage, event, bytes as u64)?;
        Ok(buffer)
    }

    /// Sets every bit to zero.
    pub fn zero<T: Pod>(&self, stage: &'static str, buffer: &mut Buffer<T>) -> Result<()> {
        let bytes = buffer.bytes() as usize;
        // SAFETY: the pattern is one element of zeros and the size is the whole buffer.
        let event = unsafe {
            self.queue
                .enqueue_fill_buffer(buffer.raw_mut(), &[T::zeroed()], 0, bytes, &[])
        };
        self.record(stage, event, bytes as u64)
    }

    /// A buffer that holds `data`.
    pub fn upload<T: Pod>(&self, stage: &'static str, data: &[T]) -> Result<Buffer<T>> {
        let mut buffer = self.buffer(stage, data.len())?;
        self.write(stage, &mut buffer, data)?;
        Ok(buffer)
    }

    /// Overwrites the start of a buffer; returns when `data` may be reused.
    pub fn write<T: Pod>(&self, stage: &'static str, buffer: &mut Buffer<T>, data: &[T]) -> Result<()> {
        self.write_at(stage, buffer, 0, data)
    }

    /// Overwrites a buffer from element `first` on; returns when `data` may be reused.
    pub fn write_at<T: Pod>(
        &self,
        stage: &'static str,
        buffer: &mut Buffer<T>,
        first: usize,
        data: &[T],
    ) -> Result<()> {
        assert!(first + data.len() <= buffer.len());
        if data.is_empty() {
            return Ok(());
        }
        let (bytes, at) = (size_of_val(data) as u64, first * size_of::<T>());
        // SAFETY: the write is blocking and within the buffer.
        let event = unsafe {
            self.queue
                .enqueue_write_buffer(buffer.raw_mut(), CL_BLOCKING, at, data, &[])
        };
        self.record(stage, event, bytes)
    }

    /// Reads the first `len` elements.
    pub fn read<T: Pod>(&self, stage: &'static str, buffer: &Buffer<T>, len: usize) -> Result<Vec<T>> {
        self.read_at(stage, buffer, 0, len)
    }

    /// Reads `len` elements from element `first` on.
    pub fn read_at<T: Pod>(&self, stage: &'static str, buffer: &Buffer<T>, first: usize, len: usize) -> Result<Vec<T>> {
        assert!(first + len <= buffer.len());
        let mut data = bytemuck::zeroed_vec(len);
        if len > 0 {
            let bytes = size_of_val(&data[..]) as u64;
            // SAFETY: the read is blocking and within both buffers.
            let event = unsafe {
                self.queue
                    .enqueue_read_buffer(buffer.raw(), CL_BLOCKING, first * size_of::<T>(), &mut data, &[])
            };
            self.record(stage, event, bytes)?;
            self.activity.all_done();
        }
        Ok(data)
    }

    /// Copies a buffer to another of the same length, on the device.
    pub fn copy<T: Pod>(&self, stage: &'static str, from: &Buffer<T>, to: &mut Buffer<T>) -> Result<()> {
        assert!(from.len() == to.len());
        let bytes = from.bytes();
        // SAFETY: two different buffers, and the size is both of theirs.
        let event = unsafe {
            self.queue
                .enqueue_copy_buffer(from.raw(), to.raw_mut(), 0, 0, bytes as usize, &[])
        };
        self.record(stage, event, bytes)
    }

    /// Starts `groups` work-groups of `local` work-items of a kernel.
    ///
    /// # Panics
    /// The number of arguments differs from the kernel's: missing arguments would keep the values of the last launch.
    pub fn launch(
        &self,
        stage: &'static str,
        kernel: &Arc<Mutex<Kernel>>,
        groups: usize,
        local: usize,
        args: &[&dyn Arg],
    ) -> Result<()> {
        if groups == 0 {
            return Ok(());
        }
        let failed = |source| Error::Launch { stage, source };
        // Held until the launch is enqueued: a kernel has one set of arguments.
        let kernel = &*lock(kernel);
        let expected = kernel.num_args().map_err(failed)? as usize;
        assert_eq!(args.len(), expected, "arguments of a kernel of stage {stage}");
        if self.programs.pass_launch(kernel, groups * local, local)? {
            self.activity.begin_compiling();
        }
        for (index, arg) in args.iter().enumerate() {
            arg.set(kernel, index as u32).map_err(failed)?;
        }
        let (global, local) = ([groups * local], [local]);
        let no_events: &[cl_event] = &[];
        // SAFETY: every argument was set just now; kernels stay inside their buffers (checked with Oclgrind).
        let event = unsafe {
            self.queue.enqueue_nd_range_kernel(
                kernel.get(),
                1,
                std::ptr::null(),
                global.as_ptr(),
                local.as_ptr(),
                no_events,
            )
        };
        self.record(stage, event, 0)?;
        #[cfg(feature = "testing")]
        if self.recorder.is_on() {
            let contents = args.iter().filter_map(|arg| arg.contents(self));
            let buffers = contents.map(|bytes| Ok(recorder::BufferHash::of(&bytes?)));
            self.recorder.add(recorder::Launch {
                kernel: kernel.function_name().map_err(failed)?,
                buffers: buffers.collect::<Result<_>>()?,
            });
        }
        Ok(())
    }

    /// Waits until all enqueued commands are done.
    pub fn finish(&self, stage: &'static str) -> Result<()> {
        self.queue.finish().map_err(|source| Error::Launch { stage, source })?;
        self.activity.all_done();
        Ok(())
    }

    /// Launches `units` of a piece of work, waits for their end, and lets `pace` choose the size of the next launch from their time.
    pub fn paced(
        &self,
        stage: &'static str,
        pace: &mut Pace,
        units: u64,
        launch: impl FnOnce() -> Result<()>,
    ) -> Result<()> {
        let start = Instant::now();
        launch()?;
        self.finish(stage)?;
        pace.took(units, start.elapsed());
        Ok(())
    }

    /// Waits for the launched commands, so that a job that runs in the pause of `cancel` need not wait for them.
    pub fn pause(&self, stage: &'static str, cancel: &dyn Cancel) -> Result<()> {
        self.finish(stage)?;
        check_cancelled(cancel)
    }

    pub fn record(&self, stage: &'static str, event: std::result::Result<Event, ClError>, bytes: u64) -> Result<()> {
        let event = event.map_err(|e| allocation_error(stage, bytes, e))?;
        self.activity.command();
        let mut events = lock(&self.events);
        events.push((stage, event));
        // Some jobs never take their times, such as expressions and histograms.
        let is_full = events.len() >= MAX_EVENTS;
        drop(events);
        if is_full {
            self.sum_times()?;
        }
        Ok(())
    }

    /// Device time of each stage since the last call, in order of first execution. Waits for running work.
    pub fn take_times(&self) -> Result<Vec<StageTime>> {
        self.sum_times()?;
        Ok(std::mem::take(&mut *lock(&self.times)))
    }

    /// Adds up the times of all events, and releases them. Waits for running work.
    fn sum_times(&self) -> Result<()> {
        self.finish("timing")?;
        let mut times = lock(&self.times);
        for (stage, event) in lock(&self.events).drain(..) {
            // A driver without profiling returns an error. A time of zero would be false, so the stage is left out.
            let (Ok(start), Ok(end)) = (event.profiling_command_start(), event.profiling_command_end()) else {
                continue;
            };
            let milliseconds = end.saturating_sub(start) as f64 / 1e6;
            match times.iter_mut().find(|t| t.stage == stage) {
                Some(t) => t.milliseconds += milliseconds,
                None => times.push(StageTime { stage, milliseconds }),
            }
        }
        Ok(())
    }
}
