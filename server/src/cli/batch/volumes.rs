//! `isopeel batch` with volumes: makes the same surface of many volumes and time steps. A failed surface is recorded and does not end the
//! batch.

use std::collections::{BTreeSet, HashSet};
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

use data_encoding::HEXLOWER;
use futures_util::StreamExt;
use indicatif::ProgressBar;
use isopeel_extraction::ExtractionStatistics;
use isopeel_kernels::SampleType;
use isopeel_volumes::{Dataset, IdentityError, InputIdentity, SeenFiles, VolumeStep};
use sha2::{Digest, Sha256};
use tokio_util::sync::CancellationToken;

use super::inputs::{Input, fold_case, open_all};
use super::manifest::{Line, Manifest};
use super::series::Series;
use super::steps::Steps;
use super::{Args, BatchError, Interrupt};
use crate::cli::jobs::{empty_ones, progress_bar};
use crate::cli::output::{Output, OutputError, WrittenFile};
use crate::export::{self, FileContent, FileRequest, Format, OtherVolumes};
use crate::jobs::{Cause, ExtractionState, MAX_ATTEMPTS, MakeFailure, ManifestEntry, failure};
use crate::pool;
use crate::service::DeviceWorker;

/// Number of concurrent surfaces. While the device makes one, the previous file is written, or the next volume is read.
const CONCURRENT_SURFACES: usize = 2;

/// Time between attempts while the device is busy.
const PAUSE: Duration = Duration::from_secs(1);

/// A volume and time step of which a surface is made.
struct Item {
    /// Path of the volume as on the command line.
    volume: String,
    step: u32,
    /// The time step and its file name, or why the time step cannot be used.
    opened: Result<(VolumeStep, String), Cause>,
}

/// State that all items share.
struct Batch<'a> {
    args: &'a Args,
    request: FileRequest,
    worker: DeviceWorker,
    seen: Arc<SeenFiles>,
    manifest: Arc<Manifest>,
    token: CancellationToken,
}

/// Makes the surfaces of all volumes and time steps.
pub(super) fn run(args: &Args) -> Result<(), BatchError> {
    let surface = args.surface.clone().unwrap_or_default();
    let format = surface.format.ok_or(BatchError::NoFormat)?;
    let request = surface.request(format, 0)?;
    // Refuses options that are invalid for every volume before it reads any volume.
    request.check_alone()?;
    let inputs = open_all(&args.inputs)?;
    args.create_folder()?;
    let output = |source| BatchError::Output {
        path: args.output.clone(),
        source,
    };
    let manifest = Arc::new(Manifest::open(&args.output).map_err(output)?);
    let seen = Arc::new(SeenFiles::default());
    let Plan {
        items, types, series, ..
    } = plan(args, inputs, format.extension(), &seen);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let lines = runtime.block_on(async {
        let mut interrupt = Interrupt::new()?;
        let worker = args.worker(types)?;
        let token = CancellationToken::new();
        let _cancel = token.clone().drop_guard();
        let batch = Batch {
            args,
            request,
            worker: worker.clone(),
            seen,
            manifest: Arc::clone(&manifest),
            token,
        };
        tokio::select! {
            lines = batch.make_all(items) => lines,
            () = interrupt.wait() => Err(BatchError::Interrupted),
            error = worker.unusable() => Err(error.map_or(BatchError::Interrupted, BatchError::Device)),
        }
    })?;
    manifest.rewrite(&lines).map_err(output)?;
    if format == Format::Vtp {
        let existing = lines.iter().filter_map(|line| line.entry.file.as_deref()).collect();
        series
            .iter()
            .try_for_each(|series| series.write(&args.output, &existing))
            .map_err(output)?;
    }
    report(&lines)
}

/// All items of the command, and what they share.
#[derive(Default)]
struct Plan {
    items: Vec<Item>,
    /// Sample types of all fields.
    types: Vec<SampleType>,
    /// The volumes of which several time steps are selected.
    series: Vec<Series>,
    /// Keys of the file names that are already used, by [`fold_case`].
    taken: HashSet<String>,
}

impl Plan {
    /// Returns the prefix of a volume's file names, and the file name of each step. Appends a number to the prefix if another volume
    /// already uses one of these names, for example because its name looks like a name with a step.
    fn files(&mut self, name: &str, dataset: &Dataset, steps: &[u32], extension: &str) -> (String, Vec<String>) {
        let digits = dataset.steps.saturating_sub(1).to_string().len();
        let with_files = |name: String| {
            let file_of = |&step: &u32| match dataset.steps {
                1 => format!("{name}.{extension}"),
                _ => format!("{name}-{step:0digits$}.{extension}"),
            };
            let files = steps.iter().map(file_of).collect();
            (name, files)
        };
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        let mut candidates = std::iter::once(name.to_owned()).chain(numbered).map(with_files);
        let is_unused = |(name, files): &(String, Vec<String>)| {
            let mut all = files.iter().chain([name]).map(|name| fold_case(name));
            all.all(|name| !self.taken.contains(&name))
        };
        let (name, files) = candidates.find(is_unused).unwrap_or_default();
        self.taken
            .extend(files.iter().chain([&name]).map(|name| fold_case(name)));
        (name, files)
    }
}

/// Returns the items of all inputs, in the order of the command line.
fn plan(args: &Args, inputs: Vec<Input>, extension: &str, seen: &SeenFiles) -> Plan {
    let all = Steps::All;
    let steps = args.steps.as_ref().unwrap_or(&all);
    let mut plan = Plan::default();
    for (revision, Input { path, name, dataset }) in (0..).zip(inputs) {
        let volume = path.to_string_lossy().into_owned();
        let item = |step, opened| Item {
            volume: volume.clone(),
            step,
            opened,
        };
        let mut dataset = match dataset {
            Ok(dataset) => dataset,
            Err(error) => {
                let why = cause("unreadable-volume", crate::error::chain(&error));
                plan.items.push(item(0, Err(why)));
                continue;
            }
        };
        dataset.set_frame(args.frame);
        // Distinguishes volumes with the same id in the caches of the device.
        dataset.revision = revision;
        seen.note(&dataset);
        for sample_type in dataset.fields.iter().map(|field| field.sample_type) {
            if !plan.types.contains(&sample_type) {
                plan.types.push(sample_type);
            }
        }
        let chosen = steps.of(dataset.steps);
        let dataset = Arc::new(dataset);
        if chosen.is_empty() {
            let why = format!("it has {} time steps, and none of them was asked for", dataset.steps);
            plan.items.push(item(0, Err(cause("unknown-step", why))));
        }
        let (name, files) = plan.files(&name, &dataset, &chosen, extension);
        if chosen.len() > 1 {
            let files = chosen.iter().copied().zip(files.iter().cloned());
            plan.series.push(Series::new(name, &dataset, files));
        }
        for (step, file) in chosen.into_iter().zip(files) {
            let opened = VolumeStep::new(Arc::clone(&dataset), step);
            let opened = opened.map_err(|error| cause("unknown-step", error.to_string()));
            plan.items.push(item(step, opened.map(|volume| (volume, file))));
        }
    }
    plan
}

fn cause(code: &str, detail: String) -> Cause {
    let code = code.into();
    Cause { code, detail }
}

/// Returns an error if a surface has failed or all are empty. Otherwise prints how many are empty.
fn report(lines: &[Line]) -> Result<(), BatchError> {
    let entries: Vec<ManifestEntry> = lines.iter().map(|line| line.entry.clone()).collect();
    let empty = empty_ones(&entries);
    let mut failed = lines.iter().filter(|line| line.entry.state == ExtractionState::Failed);
    if let Some(first) = failed.next() {
        let why = first.entry.problem.as_ref().map_or("", |problem| &problem.detail);
        let (count, all) = (1 + failed.count(), lines.len());
        let failures = format!(
            "{count} of {all} surfaces failed, the manifest says why; {}: {why}",
            first.volume
        );
        return Err(BatchError::Failed([failures, empty].join("\n").trim_end().to_owned()));
    }
    if entries.iter().all(|entry| entry.state == ExtractionState::Empty) {
        return Err(BatchError::Failed(empty));
    }
    if !empty.is_empty() {
        eprintln!("isopeel: {empty}");
    }
    Ok(())
}

impl Batch<'_> {
    /// Makes all items, and appends a line to the manifest when an item has ended.
    async fn make_all(&self, items: Vec<Item>) -> Result<Vec<Line>, BatchError> {
        self.worker.ready().await?;
        let bar = progress_bar(items.len() as u64);
        let (mut lines, mut failed) = (Vec::with_capacity(items.len()), 0);
        let pending = (0..).zip(items).map(|(number, item)| self.line(number, item));
        let mut outcomes = futures_util::stream::iter(pending).buffered(CONCURRENT_SURFACES);
        while let Some(outcome) = outcomes.next().await {
            let (line, is_new) = outcome?;
            if is_new {
                self.manifest.append(&line).map_err(|source| BatchError::Output {
                    path: self.args.output.clone(),
                    source,
                })?;
            }
            failed += u64::from(line.entry.state == ExtractionState::Failed);
            lines.push(line);
            bar.set_position(lines.len() as u64);
            show_failures(&bar, failed);
        }
        bar.finish_and_clear();
        Ok(lines)
    }

    /// Makes an item, unless an earlier command has made it. Returns the line of the item, and whether it is new.
    async fn line(&self, number: u32, item: Item) -> Result<(Line, bool), BatchError> {
        let mut line = Line {
            volume: item.volume,
            step: item.step,
            identity: None,
            entry: ManifestEntry::waiting(number),
        };
        let outcome = match item.opened {
            Err(why) => Err(Unmade::failed(why)),
            Ok((volume, file)) => match self.input(&volume).await {
                Err(why) => {
                    self.remove_earlier(&file);
                    Err(Unmade::failed(why))
                }
                Ok(input) => {
                    line.identity = input.as_ref().map(|input| self.identity(input));
                    if let Some(finished) = self.finished(&file, line.identity.as_deref()).await {
                        line.entry = ManifestEntry {
                            extraction: number,
                            ..finished.entry
                        };
                        return Ok((line, false));
                    }
                    let outcome = self.make(&volume, &file, input).await?;
                    if outcome.is_err() {
                        self.remove_earlier(&file);
                    }
                    outcome
                }
            },
        };
        match outcome {
            Ok(entry) => {
                line.entry = ManifestEntry {
                    extraction: number,
                    ..entry
                }
            }
            Err(Unmade { state, why }) => (line.entry.state, line.entry.problem) = (state, Some(why)),
        }
        Ok((line, true))
    }

    /// Removes the file of an earlier command, which could be mistaken for a result of this command.
    fn remove_earlier(&self, file: &str) {
        if self.manifest.contains(file) {
            let _ = std::fs::remove_file(self.args.output.join(file));
        }
    }

    /// Returns the identity of the current files of a time step; `None` for a network store.
    async fn input(&self, volume: &VolumeStep) -> Result<Option<InputIdentity>, Cause> {
        let (volume, seen) = (volume.clone(), Arc::clone(&self.seen));
        let identity = move || InputIdentity::of(volume.dataset(), &BTreeSet::from([volume.step()]), &seen);
        match tokio::task::spawn_blocking(identity).await {
            Ok(Ok(input)) => Ok(Some(input)),
            Ok(Err(IdentityError::Network(_))) => Ok(None),
            Ok(Err(error)) => Err(cause("unreadable-volume", crate::error::chain(&error))),
            Err(_) => Err(cause("internal", "its files could not be looked at".to_owned())),
        }
    }

    /// Returns the hash of program version, request and input, which determine the bytes of a file.
    fn identity(&self, input: &InputIdentity) -> String {
        let request = serde_json::to_string(&self.request).unwrap_or_default();
        let text = format!("{} {request} {}", env!("CARGO_PKG_VERSION"), input.content());
        HEXLOWER.encode(&Sha256::digest(text))
    }

    /// Returns the line of a file that an earlier command has made from the same input, if the file is unchanged.
    async fn finished(&self, file: &str, identity: Option<&str>) -> Option<Line> {
        let (manifest, file, identity) = (Arc::clone(&self.manifest), file.to_owned(), identity?.to_owned());
        let task = tokio::task::spawn_blocking(move || manifest.find_finished(&file, &identity));
        task.await.ok().flatten()
    }

    /// Makes the file of a time step.
    ///
    /// # Errors
    /// Errors that concern all items: the folder cannot be written.
    async fn make(
        &self,
        volume: &VolumeStep,
        file: &str,
        input: Option<InputIdentity>,
    ) -> Result<Result<ManifestEntry, Unmade>, BatchError> {
        let start = Instant::now();
        let output = Output::create_of_batch(&self.args.output.join(file)).map_err(BatchError::Write)?;
        let outcome = self.attempts(volume).await;
        // Frees device memory at once, because no other item uses this time step.
        self.worker.release(volume).await;
        let made_file = match outcome {
            Ok(made_file) => made_file,
            Err(unmade) => return Ok(Err(unmade)),
        };
        let (dataset, token) = (Arc::clone(volume.dataset()), self.token.clone());
        let write = move || {
            if let Some(Err(error)) = input.map(|input| input.check_stamps(&dataset)) {
                return Ok(Err(cause("input-changed", crate::error::chain(&error))));
            }
            let written = output.with_checksum().write(&made_file, &token)?;
            Ok(Ok((written, made_file.statistics)))
        };
        let written = pool::run_export(write).await.map_err(io::Error::other)?;
        Ok(match written {
            Ok(Ok((written, statistics))) => Ok(entry(file, &written, statistics, start)),
            Ok(Err(why)) => Err(Unmade::failed(why)),
            Err(OutputError::Export(error)) => Err(Unmade::failed(cause("too-large", error.to_string()))),
            Err(error) => return Err(BatchError::Write(error)),
        })
    }

    /// Extracts a surface and makes its file. Retries if another attempt may succeed.
    async fn attempts(&self, volume: &VolumeStep) -> Result<FileContent, Unmade> {
        let request = FileRequest {
            step: volume.step(),
            ..self.request.clone()
        };
        let mut attempts = 1;
        loop {
            let error = match export::make(&self.worker, volume, &OtherVolumes::new(), &request, &self.token).await {
                Ok(made_file) => return Ok(made_file),
                Err(error) => error,
            };
            match failure(error) {
                MakeFailure::Later => tokio::time::sleep(PAUSE).await,
                // Does not retry an unreadable volume: its file is the same at the next attempt.
                MakeFailure::Retry(why) if attempts == MAX_ATTEMPTS || why.code == "unreadable-volume" => {
                    return Err(Unmade::failed(why));
                }
                MakeFailure::Retry(_) => attempts += 1,
                MakeFailure::Refused(why) | MakeFailure::JobFailed(why) => return Err(Unmade::failed(why)),
                MakeFailure::Empty(why) => {
                    let state = ExtractionState::Empty;
                    return Err(Unmade { state, why });
                }
            }
        }
    }
}

/// Why an item has no file.
struct Unmade {
    state: ExtractionState,
    why: Cause,
}

impl Unmade {
    fn failed(why: Cause) -> Self {
        let state = ExtractionState::Failed;
        Self { state, why }
    }
}

/// Returns the manifest entry of a file that was written.
fn entry(file: &str, written: &WrittenFile, statistics: ExtractionStatistics, start: Instant) -> ManifestEntry {
    ManifestEntry {
        state: ExtractionState::Done,
        file: Some(file.to_owned()),
        triangles: Some(statistics.triangles),
        error: statistics.error,
        bytes: Some(written.bytes),
        sha256: written.sha256.map(|checksum| HEXLOWER.encode(&checksum)),
        seconds: Some(start.elapsed().as_secs_f64()),
        notices: statistics.notices,
        ..ManifestEntry::waiting(0)
    }
}

fn show_failures(bar: &ProgressBar, failed: u64) {
    if failed > 0 {
        bar.set_message(format!("{failed} failed"));
    }
}

#[cfg(test)]
mod tests {
    use isopeel_volumes::testing;

    use super::*;

    #[test]
    fn files_of_steps_and_of_volumes_are_told_apart() {
        let mut plan = Plan::default();
        let mut files = |name: &str, count: u32| {
            let mut dataset = testing::dataset(name, [4; 3], &["t1"]);
            dataset.steps = count;
            plan.files(name, &dataset, &(0..count).collect::<Vec<_>>(), "ply").1
        };
        assert_eq!(files("x", 3), ["x-0.ply", "x-1.ply", "x-2.ply"]);
        assert_eq!(files("X-1", 1), ["X-1-2.ply"]);
        assert_eq!(files("y-0", 1), ["y-0.ply"]);
        assert_eq!(files("y", 2), ["y-2-0.ply", "y-2-1.ply"]);
    }
}
