//! Viewers with volumes of their own: edits a second with one device, and with several.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use futures_util::{StreamExt, TryStreamExt};
use tokio::time::Instant;

use crate::seen::Seen;
use crate::server::Server;
use crate::viewer::{Random, Viewer};
use crate::{ARRIVALS, Error, Options};

/// Measures edits a second with the first device, then with all of them.
pub async fn measure(options: &Options) -> Result<(), Error> {
    let folder = tempfile::tempdir()?;
    let volumes: Vec<_> = (0..options.viewers).map(|n| format!("own{n}")).collect();
    let paths = volumes.iter().zip(0u8..=255).map(|(volume, number)| {
        let path = folder.path().join(volume).with_extension("npy");
        write(&path, options.side, number).map(|()| path)
    });
    let paths = paths.collect::<Result<Vec<_>, _>>()?;
    if paths.len() < volumes.len() {
        return Err(format!(
            "{} viewers, expected at most 256 with volumes of their own",
            volumes.len()
        )
        .into());
    }
    let one = edits_a_second(options, &options.device[..1], &volumes, &paths).await?;
    let all = edits_a_second(options, &options.device, &volumes, &paths).await?;
    println!("{} devices ÷ one: {:.2}", options.device.len(), all / one);
    Ok(())
}

/// Edits a second of all viewers together with these devices.
async fn edits_a_second(
    options: &Options,
    devices: &[String],
    volumes: &[String],
    paths: &[PathBuf],
) -> Result<f64, Error> {
    let devices_arguments = devices
        .iter()
        .flat_map(|device| ["--device".to_owned(), device.clone()]);
    let rates = ["--no-demo", "--rate-peer", "0"].map(str::to_owned);
    let paths = paths.iter().map(|path| path.display().to_string());
    let arguments: Vec<_> = rates.into_iter().chain(devices_arguments).chain(paths).collect();
    let server = Server::start_with(&options.server, &arguments).await?;
    server.ready().await?;
    let opening = Seen::new()?;
    let open = |volume: String| {
        let (address, opening) = (&server.address, &opening);
        async move { Viewer::open_volume(address, &volume, opening).await }
    };
    let arrivals = futures_util::stream::iter(volumes.to_vec()).map(open);
    let arrivals = arrivals.buffered(ARRIVALS);
    let viewers: Vec<_> = arrivals.try_collect().await?;
    let seen = Seen::new()?;
    let start = Instant::now();
    let until = start + Duration::from_secs(options.seconds);
    let edit = |(mut viewer, seed): (Viewer, u64)| {
        viewer.count_in(&seen);
        tokio::spawn(async move { viewer.edit_on(&mut Random(seed), until).await })
    };
    let tasks: Vec<_> = viewers.into_iter().zip(1000..).map(edit).collect();
    for task in tasks {
        task.await??;
    }
    let rate = seen.done.load(Ordering::Relaxed) as f64 / start.elapsed().as_secs_f64();
    let name = format!("{} viewers, devices {}", volumes.len(), devices.join(" "));
    seen.report(&name);
    println!("{name}: {rate:.1} edits a second");
    println!("volumes of each device: {:?}", server.volumes().await?);
    Ok(rate)
}

/// Writes a NumPy file of bytes whose surfaces differ from those of other numbers.
fn write(path: &Path, side: u16, number: u8) -> std::io::Result<()> {
    let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({side}, {side}, {side}), }}");
    let header = format!("{header:<117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(header.bytes());
    let wave = |at: u16, length: f32| (f32::from(at) / f32::from(side) * length + f32::from(number)).sin();
    let axes = [17.0, 19.0, 23.0].map(|length| (0..side).map(|at| wave(at, length)).collect::<Vec<_>>());
    for z in &axes[2] {
        for y in &axes[1] {
            bytes.extend(axes[0].iter().map(|x| (128.0 + 40.0 * (x + y + z)) as u8));
        }
    }
    std::fs::write(path, bytes)
}
