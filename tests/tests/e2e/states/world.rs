//! Reference for sequences: a server without caches, which shows each view to a fresh client.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use tempfile::TempDir;

use super::compare::Difference;
use super::model::{Model, View};
use super::seat::{Outcome, Seat};
use super::sequence::Caches;
use super::volumes::{SERIES, VOLUMES, write_all};
use crate::faults::build_layer;
use crate::support::process::{self, Process};

/// The outcome of each surface for a fresh client.
pub type Reference = Arc<[Outcome; 4]>;

/// Volumes and the server without caches; all sequences share it.
pub struct World {
    _folder: TempDir,
    /// Makes a device fail.
    pub layer: PathBuf,
    pub paths: Vec<PathBuf>,
    server: Process,
    /// The view in force from `opened`, by volume.
    openings: HashMap<String, Value>,
    /// References by the messages sent.
    known: Mutex<HashMap<String, Reference>>,
}

impl World {
    /// Starts the server and opens each volume once; `None` if there is no device.
    pub async fn start() -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        let paths = write_all(folder.path());
        let server = start_server(&paths, Caches::Cold)?;
        let mut openings = HashMap::new();
        for volume in VOLUMES {
            let seat = Seat::open(server.address, volume.name, None).await;
            openings.insert(volume.name.to_owned(), Value::Object(seat.model.opening.0.clone()));
            seat.close().await;
        }
        Some(Self {
            layer: build_layer(folder.path()),
            _folder: folder,
            paths,
            server,
            openings,
            known: Mutex::default(),
        })
    }

    /// A model of a volume that was just opened. The model of a changing volume has the values of another volume, except for its field.
    pub fn model(&self, volume: &str) -> Model {
        if let Some(opening) = self.openings.get(volume) {
            return Model::open(volume, opening);
        }
        let mut opening = self.openings[VOLUMES[0].name].clone();
        opening["field"] = if volume == SERIES { "f" } else { volume }.into();
        Model::open(volume, &opening)
    }

    /// Returns the outcomes of these views for a fresh client.
    pub async fn reference(&self, model: &Model) -> Result<Reference, Difference> {
        let messages = model.messages();
        let key = json!([model.volume, model.first_step(), messages]).to_string();
        let known = self.known.lock().expect("not poisoned").get(&key).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        let found = Arc::new(show(&self.server, model).await?);
        self.known.lock().expect("not poisoned").insert(key, Arc::clone(&found));
        Ok(found)
    }
}

/// Starts a server of these volumes.
pub fn start_server(paths: &[PathBuf], caches: Caches) -> Option<Process> {
    process::start(paths, &options(caches))
}

/// Options of all servers.
pub fn options(caches: Caches) -> Vec<&'static str> {
    [&["--no-demo", "--rate-peer", "0"], caches.options()].concat()
}

/// Shows these views to a fresh client of a server; returns the outcomes.
pub async fn show(server: &Process, model: &Model) -> Result<[Outcome; 4], Difference> {
    let mut seat = Seat::connect(server.address, None).await;
    seat.open_step(&model.volume, model.first_step()).await;
    seat.model = model.clone();
    seat.mark_masks(model.surfaces.iter().filter(|(_, view)| View::has_mask(view)));
    for message in model.messages() {
        seat.send(message).await;
    }
    let rested = seat.rest().await;
    let outcomes = std::mem::take(&mut seat.outcomes);
    seat.close().await;
    rested.map_err(|of| Difference::new(format!("fresh client: {}", of.kind), of.detail))?;
    Ok(outcomes)
}
