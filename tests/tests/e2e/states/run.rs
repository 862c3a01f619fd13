//! Plays a sequence: a server of its own, its viewers and followers, and their events.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use futures_util::future::join_all;
use serde_json::{Value, json};
use tokio::time::Instant;

use super::compare::{self, Difference};
use super::files::Files;
use super::model::Model;
use super::seat::{Outcome, Seat};
use super::sequence::{Event, Sequence};
use super::volumes::{CHANGING, OWN, SERIES, UPLOADED};
use super::world::{Reference, World, options, show};
use crate::faults::{DRIVER_FOLDER, driver_folder};
use crate::support::process::{Process, start_logged_in};

/// Longest wait until followers are shown what the leader shows.
const FOLLOW_LIMIT: Duration = Duration::from_secs(20);

/// Errors and panics of the server, in the sequence's folder.
pub const LOG: &str = "log";

/// Counts of comparisons.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    pub edits: usize,
    pub prefixes: usize,
    pub first_prefixes: usize,
    pub settled_surfaces: usize,
    pub newcomers: usize,
    pub followers: usize,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.edits += other.edits;
        self.prefixes += other.prefixes;
        self.first_prefixes += other.first_prefixes;
        self.settled_surfaces += other.settled_surfaces;
        self.newcomers += other.newcomers;
        self.followers += other.followers;
    }
}

/// A sequence that is being played.
pub struct Run<'a> {
    world: &'a World,
    sequence: &'a Sequence,
    folder: &'a Path,
    /// `None` while it is started again.
    server: Option<Process>,
    files: Files,
    seats: Vec<Seat>,
    followers: Vec<Seat>,
    counts: Counts,
}

impl<'a> Run<'a> {
    /// Plays all events; returns the counts of comparisons, or the first difference.
    pub async fn play(world: &'a World, sequence: &'a Sequence, folder: &'a Path) -> Result<Counts, Difference> {
        let files = Files::write(folder);
        let server = start(world, sequence, folder, &files);
        let mut run = Self {
            world,
            sequence,
            seats: Vec::new(),
            followers: Vec::new(),
            server: Some(server),
            files,
            folder,
            counts: Counts::default(),
        };
        run.seat_all().await;
        for event in &sequence.events {
            run.happen(event).await?;
        }
        for seat in run.seats.drain(..).chain(run.followers.drain(..)) {
            run.counts.prefixes += seat.prefixes;
            seat.close().await;
        }
        match std::fs::read_to_string(folder.join(LOG)) {
            Ok(log) if log.contains("panicked") => Err(Difference::new("panic", log)),
            _ => Ok(run.counts),
        }
    }

    fn address(&self) -> SocketAddr {
        self.server().address
    }

    fn server(&self) -> &Process {
        self.server.as_ref().expect("a running server")
    }

    /// All viewers connect and open their volumes.
    async fn seat_all(&mut self) {
        self.followers.clear();
        self.seats.clear();
        for (number, volume) in self.sequence.volumes.iter().enumerate() {
            let line = self.sequence.line.filter(|_| number == 0);
            self.seats.push(Seat::open(self.address(), volume, line).await);
        }
    }

    async fn happen(&mut self, event: &Event) -> Result<(), Difference> {
        match event {
            Event::Send { viewer, message } => self.send(*viewer, message).await,
            Event::SendBad { viewer, message } | Event::SendLateBad { viewer, message } => {
                let seat = &mut self.seats[*viewer];
                seat.expected_bad_edits += 1;
                // What was shown may have been on its way still.
                seat.is_cancelled |= matches!(event, Event::SendLateBad { .. });
                seat.send(message.clone()).await;
            }
            Event::Open { viewer, volume } => self.reopen(*viewer, volume).await,
            Event::Wait { milliseconds } => self.listen(Duration::from_millis(*milliseconds)).await,
            Event::Settle { newcomer } => self.settle(*newcomer).await?,
            Event::Follow => self.follow().await,
            Event::LoseDevice => self.lose_device(),
            Event::Restart => {
                // Killed, and gone with its locks.
                drop(self.server.take());
                self.server = Some(start(self.world, self.sequence, self.folder, &self.files));
                self.seat_all().await;
            }
            Event::Replace { content } => {
                self.files.replace(self.address(), *content).await?;
                self.reopen_all(OWN, OWN).await;
            }
            Event::Grow { content, rewrite } => {
                self.files.grow(self.address(), *content, *rewrite).await?;
                if *rewrite {
                    self.reopen_all(SERIES, SERIES).await;
                }
            }
            Event::Upload { content } => self.files.upload(self.address(), *content),
            Event::DeleteUpload => self.delete_upload().await?,
        }
        Ok(())
    }

    async fn reopen(&mut self, viewer: usize, volume: &str) {
        let id = self.files.id(volume).to_owned();
        let seat = &mut self.seats[viewer];
        seat.reopen(&id).await;
        seat.model.volume = volume.to_owned();
    }

    /// Viewers that look at one volume open another one, or the same again.
    async fn reopen_all(&mut self, looked_at: &str, volume: &str) {
        for viewer in 0..self.seats.len() {
            if self.seats[viewer].model.volume == looked_at {
                self.reopen(viewer, volume).await;
            }
        }
    }

    /// Viewers of the upload are notified that it was removed, and open their first volume again.
    async fn delete_upload(&mut self) -> Result<(), Difference> {
        self.files.delete_upload(self.address());
        for viewer in 0..self.seats.len() {
            let seat = &mut self.seats[viewer];
            if seat.model.volume == UPLOADED {
                seat.wait_until_removed().await?;
                self.reopen(viewer, &self.sequence.volumes[viewer]).await;
            }
        }
        Ok(())
    }

    /// The surfaces that a fresh client gets.
    async fn reference(&mut self, model: &Model) -> Result<Reference, Difference> {
        if CHANGING.iter().all(|volume| volume.name != model.volume) {
            return self.world.reference(model).await;
        }
        Ok(Reference::new(show(self.files.fresh_server(), model).await?))
    }

    async fn send(&mut self, viewer: usize, message: &Value) {
        let seat = &mut self.seats[viewer];
        match message["type"].as_str() {
            Some("edit") => {
                self.counts.edits += 1;
                return seat.edit(message.clone()).await;
            }
            Some("step") => seat.model.step = message["step"].as_u64().expect("a number"),
            Some("remove") => seat.model.remove(message["surface"].as_u64().expect("a number") as u8),
            Some("cancel") => seat.is_cancelled = true,
            _ => {}
        }
        seat.send(message.clone()).await;
    }

    /// All viewers read for this time.
    async fn listen(&mut self, time: Duration) {
        let until = Instant::now() + time;
        join_all(
            self.seats
                .iter_mut()
                .chain(&mut self.followers)
                .map(|seat| seat.listen(until)),
        )
        .await;
    }

    /// Makes the device fail with its next work.
    fn lose_device(&self) {
        let new = self.folder.join("new");
        std::fs::write(&new, "lost").expect("written");
        std::fs::rename(new, self.fault()).expect("renamed");
    }

    fn fault(&self) -> PathBuf {
        driver_folder(self.folder).join("fault")
    }

    /// One more viewer follows the first.
    async fn follow(&mut self) {
        let leader = &mut self.seats[0];
        if leader.group.is_none() {
            leader.send(json!({"type": "lead"})).await;
            let limit = Instant::now() + FOLLOW_LIMIT;
            while leader.group.is_none() && Instant::now() < limit {
                leader.listen(Instant::now() + Duration::from_millis(20)).await;
            }
        }
        let group = leader.group.clone().expect("a group");
        let mut follower = Seat::connect(self.address(), None).await;
        follower.is_follower = true;
        follower
            .send(json!({"type": "join", "group": group, "codings": ["values"]}))
            .await;
        self.followers.push(follower);
    }

    /// Waits until all viewers rest, and checks that they show the same as a fresh client.
    async fn settle(&mut self, newcomer: bool) -> Result<(), Difference> {
        let rested = join_all(self.seats.iter_mut().map(Seat::rest)).await;
        rested.into_iter().collect::<Result<(), _>>()?;
        assert!(!self.fault().exists(), "the device was lost before all rested");
        for number in 0..self.seats.len() {
            if !self.seats[number].model.edited.is_empty() {
                self.compare(number).await?;
                if newcomer {
                    self.compare_newcomer(number).await?;
                }
            }
        }
        self.settle_followers().await
    }

    /// Checks that a viewer shows the same as a fresh client.
    async fn compare(&mut self, number: usize) -> Result<(), Difference> {
        let model = self.seats[number].model.clone();
        let reference = self.reference(&model).await?;
        let seat = &self.seats[number];
        seat.check_budgets()?;
        seat.check_statistics()?;
        compare_all(&model, &seat.outcomes, &reference)
            .map_err(|of| Difference::new(of.kind, format!("{}\n{}", of.detail, seat.last_frames())))?;
        let both = seat.outcomes.iter().zip(&*reference);
        self.counts.first_prefixes += both.filter(|(a, b)| compare::have_first(a, b)).count();
        self.counts.settled_surfaces += model.edited.len();
        Ok(())
    }

    /// Checks the same for another viewer of the same server.
    async fn compare_newcomer(&mut self, number: usize) -> Result<(), Difference> {
        let model = self.seats[number].model.clone();
        let reference = self.reference(&model).await?;
        let there = Model {
            volume: self.files.id(&model.volume).to_owned(),
            ..model.clone()
        };
        let shown = show(self.server(), &there).await?;
        compare_all(&model, &shown, &reference)
            .map_err(|of| Difference::new(format!("newcomer: {}", of.kind), of.detail))?;
        self.counts.newcomers += 1;
        Ok(())
    }

    /// Waits until followers show the same as the leader.
    async fn settle_followers(&mut self) -> Result<(), Difference> {
        let Some(leader) = self.seats.first() else {
            return Ok(());
        };
        let limit = Instant::now() + FOLLOW_LIMIT;
        for follower in &mut self.followers {
            let surfaces = leader.model.edited.iter();
            let has_failed = |surface: &&u8| leader.outcomes[usize::from(**surface)].failure.is_some();
            let surfaces: Vec<_> = surfaces.filter(|surface| !has_failed(surface)).collect();
            loop {
                follower.listen(Instant::now() + Duration::from_millis(50)).await;
                let mut surfaces = surfaces.iter();
                let compared = surfaces.try_for_each(|&&of| compare::regions(follower.shown(of), leader.shown(of)));
                match compared {
                    Ok(()) => break,
                    Err(_) if Instant::now() < limit => {}
                    Err(of) => return Err(Difference::new(format!("follower: {}", of.kind), of.detail)),
                }
            }
            self.counts.followers += 1;
        }
        Ok(())
    }
}

/// Compares each surface that was edited.
fn compare_all(model: &Model, found: &[Outcome; 4], reference: &Reference) -> Result<(), Difference> {
    for (&surface, view) in model
        .surfaces
        .iter()
        .filter(|(surface, _)| model.edited.contains(surface))
    {
        let at = usize::from(surface);
        compare::outcomes(&found[at], &reference[at]).map_err(|of| {
            let view = Value::Object(view.0.clone());
            let detail = format!(
                "{}; surface {surface} of {} step {}: {view}",
                of.detail, model.volume, model.step
            );
            Difference::new(of.kind, detail)
        })?;
    }
    Ok(())
}

/// A server of the sequence, whose device fails as the folder says.
fn start(world: &World, sequence: &Sequence, folder: &Path, files: &Files) -> Process {
    let driver = driver_folder(folder);
    let environment = [
        ("OPENCL_LAYERS", world.layer.as_path()),
        ("DEVICE_FAULT", &driver.join("fault")),
        (DRIVER_FOLDER, &driver),
    ];
    let log = folder.join(LOG);
    let options = options(sequence.caches);
    if !sequence.has_files {
        return start_logged_in(&world.paths, &options, &environment, "warn", &log).expect("a device");
    }
    let uploads = folder.join("uploads");
    let options = [
        &options[..],
        &["--watch", "--uploads", uploads.to_str().expect("UTF-8")],
    ]
    .concat();
    let paths = [world.paths.clone(), files.paths()].concat();
    start_logged_in(&paths, &options, &environment, "warn", &log).expect("a device")
}
