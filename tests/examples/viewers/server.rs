//! A server of its own.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncBufReadExt, BufReader};

use crate::Error;

/// Interval and maximum number of looks at devices that are being opened: ten minutes.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);
const MAX_LOOKS: u32 = 6_000;

/// A server of its own, ended when dropped.
pub struct Server {
    child: tokio::process::Child,
    pub address: String,
}

impl Server {
    /// Starts the binary with its demo.
    pub async fn start(binary: &Path) -> Result<Self, Error> {
        Self::start_with(binary, &["--demo".to_owned()]).await
    }

    /// Starts the binary with these arguments of `serve`.
    pub async fn start_with(binary: &Path, arguments: &[String]) -> Result<Self, Error> {
        let mut child = tokio::process::Command::new(binary)
            .args(["serve", "--no-auth", "--listen", "127.0.0.1:0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()?;
        let out = child.stdout.take().ok_or("no output")?;
        let line = BufReader::new(out).lines().next_line().await?.ok_or("no address")?;
        let (_, rest) = line.split_once("://").ok_or("no address")?;
        let address = rest.split('/').next().unwrap_or(rest).to_owned();
        Ok(Self { child, address })
    }

    /// Waits until all of its devices are open.
    pub async fn ready(&self) -> Result<(), Error> {
        for _ in 0..MAX_LOOKS {
            let devices = self.devices().await?;
            if devices.iter().all(|device| device["state"] == "ready") {
                return Ok(());
            }
            tokio::time::sleep(LOOK_INTERVAL).await;
        }
        Err("a device is not ready after ten minutes".into())
    }

    /// Number of volumes on each device.
    pub async fn volumes(&self) -> Result<Vec<u64>, Error> {
        let devices = self.devices().await?;
        Ok(devices.iter().filter_map(|device| device["volumes"].as_u64()).collect())
    }

    async fn devices(&self) -> Result<Vec<Value>, Error> {
        let url = format!("http://{}/api/v1/devices", self.address);
        let text = tokio::task::spawn_blocking(move || ureq::get(url).call()?.body_mut().read_to_string()).await??;
        Ok(serde_json::from_str(&text)?)
    }

    /// Bytes that the process holds, and those of volumes among them.
    pub async fn memory(&self) -> Result<(u64, u64), Error> {
        let url = format!("http://{}/api/v1/memory", self.address);
        let text = tokio::task::spawn_blocking(move || ureq::get(url).call()?.body_mut().read_to_string()).await??;
        let used: Value = serde_json::from_str(&text)?;
        let bytes = |name: &str| used[name].as_u64().ok_or("no number of bytes");
        Ok((bytes("residentBytes")?, bytes("volumeBytes")?))
    }

    /// Seconds of processors that it has used.
    pub fn cpu_seconds(&self) -> Result<f64, Error> {
        let process = self.child.id().ok_or("it has ended")?;
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat"))?;
        let (_, fields) = stat.rsplit_once(')').ok_or("no name in brackets")?;
        let ticks = fields.split_whitespace().skip(11).take(2);
        let ticks: Vec<f64> = ticks.map(str::parse).collect::<Result<_, _>>()?;
        // The system has 100 ticks a second, wherever Linux runs.
        Ok(ticks.iter().sum::<f64>() / 100.0)
    }
}
