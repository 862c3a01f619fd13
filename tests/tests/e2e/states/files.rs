//! Files of a sequence that change while a server watches them, and what is uploaded to it.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::compare::Difference;
use super::sequence::Caches;
use super::volumes::{FIRST_STEPS, OWN, SERIES, UPLOADED, write_changing};
use super::world::start_server;
use crate::support::http;
use crate::support::process::Process;
use crate::support::uploader::User;

/// Longest wait until the server offers a written file: it polls every two seconds.
const WATCH_LIMIT: Duration = Duration::from_secs(30);

/// The files, and the upload.
pub struct Files {
    folder: PathBuf,
    steps: u64,
    /// Its address on the server, and the volume's id there.
    upload: Option<(String, String)>,
    /// A server that has read the files as they are now.
    fresh: Option<Process>,
}

impl Files {
    /// Writes the first contents below a folder.
    pub fn write(folder: &Path) -> Self {
        let files = Self {
            folder: folder.to_owned(),
            steps: FIRST_STEPS,
            upload: None,
            fresh: None,
        };
        for name in ["own", SERIES] {
            std::fs::create_dir_all(folder.join(name)).expect("a folder");
        }
        write_changing(&files.own(), 0);
        (0..FIRST_STEPS).for_each(|step| write_changing(&files.step(step), step));
        files
    }

    fn own(&self) -> PathBuf {
        self.folder.join("own").join(format!("{OWN}.npy"))
    }

    fn step(&self, step: u64) -> PathBuf {
        self.folder.join(SERIES).join(format!("f_{step:03}.npy"))
    }

    /// The file that was uploaded, under its name.
    fn uploaded(&self) -> PathBuf {
        self.folder.join(format!("{UPLOADED}.npy"))
    }

    /// The paths that a server watches.
    pub fn paths(&self) -> Vec<PathBuf> {
        vec![self.own(), self.folder.join(SERIES)]
    }

    /// The id of a volume on the sequence's server.
    pub fn id<'a>(&'a self, volume: &'a str) -> &'a str {
        match &self.upload {
            Some((_, id)) if volume == UPLOADED => id,
            _ => volume,
        }
    }

    /// A server that has read the files as they are now.
    pub fn fresh_server(&mut self) -> &Process {
        let uploaded = Some(self.uploaded()).filter(|_| self.upload.is_some());
        let paths = [self.paths(), uploaded.into_iter().collect()].concat();
        self.fresh
            .get_or_insert_with(|| start_server(&paths, Caches::Cold).expect("a device"))
    }

    /// Replaces the file, and waits until the server offers the new one.
    pub async fn replace(&mut self, server: SocketAddr, content: u64) -> Result<(), Difference> {
        let before = describe(server, OWN);
        write_changing(&self.own(), content);
        self.wait_for_change(server, OWN, &before).await
    }

    /// Adds a step, and waits until the server offers it.
    pub async fn grow(&mut self, server: SocketAddr, content: u64, rewrite: bool) -> Result<(), Difference> {
        let before = describe(server, SERIES);
        if rewrite {
            write_changing(&self.step(0), content + 1);
        }
        write_changing(&self.step(self.steps), content);
        self.steps += 1;
        self.wait_for_change(server, SERIES, &before).await
    }

    async fn wait_for_change(&mut self, server: SocketAddr, volume: &str, before: &Value) -> Result<(), Difference> {
        self.fresh = None;
        let start = Instant::now();
        while describe(server, volume) == *before {
            if start.elapsed() > WATCH_LIMIT {
                return Err(Difference::new(
                    "watch",
                    format!("{volume} is as it was after {WATCH_LIMIT:?}"),
                ));
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        Ok(())
    }

    /// Uploads a volume.
    pub fn upload(&mut self, server: SocketAddr, content: u64) {
        write_changing(&self.uploaded(), content);
        let bytes = std::fs::read(self.uploaded()).expect("a file");
        self.upload = Some(user(server).bring(&format!("{UPLOADED}.npy"), &bytes));
        self.fresh = None;
    }

    /// Deletes the upload. A sequence that is being shortened may have none.
    pub fn delete_upload(&mut self, server: SocketAddr) {
        let Some((path, _)) = self.upload.take() else { return };
        let answer = user(server).ask("DELETE", &path, &[], b"");
        assert_eq!(answer.status, 204, "{}", String::from_utf8_lossy(&answer.body));
        self.fresh = None;
    }
}

fn user(server: SocketAddr) -> User {
    User {
        address: server,
        bearer: String::new(),
    }
}

/// A server's description of the samples of a volume: the number of steps, and the values of the first one. Derived values are not in every
/// description.
fn describe(server: SocketAddr, volume: &str) -> Value {
    let described = http::get(server, &format!("/api/v1/volumes/{volume}")).json();
    let fields = described["fields"].as_array().expect("fields");
    let values: Vec<_> = fields
        .iter()
        .map(|field| (&field["range"], &field["histogram"]))
        .collect();
    json!([described["steps"], values])
}
