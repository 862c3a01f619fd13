//! The server that the cases `stream` and `camera` measure, on a free port of this machine.

use std::net::SocketAddr;

use isopeel_volumes::{Catalog, Dataset};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tracing_subscriber::filter::LevelFilter;

use super::StreamError;
use crate::access::Access;
use crate::cli::device::DeviceArgs;
use crate::cli::worker;
use crate::serve::{self, Config, ServeError};
use crate::service::{DeviceOptions, DeviceWorker};

/// A server of one dataset.
pub struct Server {
    pub address: SocketAddr,
    shutdown: CancellationToken,
    task: JoinHandle<Result<(), ServeError>>,
}

impl Server {
    /// Starts a server as `isopeel serve` does, without authentication and without a limit of triangles. `in_process`: whether it uses the
    /// driver itself.
    pub async fn start(dataset: Dataset, device: &DeviceArgs, in_process: bool) -> Result<Self, StreamError> {
        let types = dataset.fields.iter().map(|field| field.sample_type).collect();
        let mut catalog = Catalog::default();
        catalog.add(dataset);
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let address = listener.local_addr()?;
        let options = DeviceOptions {
            arguments: worker::log_level(LevelFilter::WARN),
            ..device.options(types, |_| ())
        };
        let worker = DeviceWorker::start_for_server(options, in_process)?;
        let config = Config::new(catalog.into(), worker, Access::new(address, &[], &[]));
        let shutdown = CancellationToken::new();
        let task = tokio::spawn(serve::run(listener, config, shutdown.clone().cancelled_owned()));
        Ok(Self {
            address,
            shutdown,
            task,
        })
    }

    /// Stops the server and closes its engine, so that this process can open another engine.
    pub async fn stop(self) -> Result<(), StreamError> {
        self.shutdown.cancel();
        Ok(self.task.await.map_err(std::io::Error::other)??)
    }
}
