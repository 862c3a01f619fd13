//! `isopeel serve`: starts the server.

mod devices;
pub(super) mod memory;
mod oidc;
mod options;
mod relaunch;
mod servers;
mod signals;
mod uploads;

use std::collections::HashSet;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use isopeel_volumes::watch::{INTERVAL, Watcher};
use isopeel_volumes::{Catalog, ReadError, SharedCatalog, follow_links};

use super::device::DeviceArgs;
use super::log;
use crate::access::{Audit, AuditError, Oidc, PublicUrl, SessionKey, Token, TokenError, TokenFileError, TokenWatch};
use crate::jobs::{Limits, StateFolder, StateFolderError};
use crate::metrics::DeviceNumber;
use crate::pool::{self, ReadPool};
use crate::private_folder::FolderAccessError;
use crate::rest::SpoolFolder;
use crate::serve::{self, Config, ConnectionLimits, ListenAddress, Listener, ServeError, Tls, TlsError};
use crate::service::{DeviceOptions, DevicePool, DeviceWorker};
use crate::uploads::{FolderError, Uploads};
use devices::DevicesError;
pub use options::Args;
use relaunch::Inherited;

/// Why the server did not start, or ended.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A volume cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The arguments name no path, disable the demo, and enable no uploads.
    #[error("no volume to offer: expected a path, --uploads, or no --no-demo")]
    NoVolume,
    /// The server cannot listen on the address.
    #[error("cannot listen on {address}")]
    Listen {
        /// The address.
        address: ListenAddress,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The devices cannot be selected.
    #[error(transparent)]
    Devices(#[from] DevicesError),
    /// The device needs a new process, which cannot be started.
    #[error("another process cannot take the place of this one, which the device's driver asks for")]
    Relaunch(#[source] std::io::Error),
    /// The certificate or its key cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// A certificate is given without its key, or a key without its certificate.
    #[error("--tls-cert and --tls-key belong together, expected both or none")]
    HalfOfTls,
    /// Sign-in through the issuer cannot be set up.
    #[error(transparent)]
    Oidc(#[from] oidc::Error),
    /// The audit log cannot be opened.
    #[error(transparent)]
    Audit(#[from] AuditError),
    /// The token cannot be read or generated.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// Anybody on the network could use a server without authentication.
    #[error(
        "--no-auth works on a loopback address alone, {0} is open to the network: leave it out, and open the address with the token"
    )]
    OpenToNetwork(SocketAddr),
    /// The threads of the export pool cannot be started.
    #[error(transparent)]
    Pool(#[from] rayon::ThreadPoolBuildError),
    /// The state folder cannot be used.
    #[error(transparent)]
    StateFolder(#[from] StateFolderError),
    /// The spool folder cannot be used.
    #[error("spool")]
    Spool(#[from] FolderAccessError),
    /// The folder of uploads cannot be used.
    #[error(transparent)]
    Uploads(#[from] FolderError),
    /// The tokens of the state folder cannot be read.
    #[error(transparent)]
    TokenFile(#[from] TokenFileError),
    /// The server ended.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The address of the server cannot be written to standard output.
    #[error("standard output cannot be written, to which the server's address goes")]
    Output(#[source] std::io::Error),
    /// A thread could not be started, or a signal handler could not be installed.
    #[error("the process could not go on")]
    System(#[from] std::io::Error),
}

/// Maximum time that the device's thread has to end after the last connection. The process does not wait longer for a kernel that is being
/// compiled.
const DEVICE_GRACE: Duration = Duration::from_millis(500);

/// Maximum time for flushing the audit log.
const AUDIT_GRACE: Duration = Duration::from_millis(200);

/// Serves until SIGINT or SIGTERM. `log_arguments`: arguments of the process of the device that make it write its log as this one.
///
/// # Errors
/// [`Error`].
pub fn run(args: &Args, log_arguments: &[String]) -> Result<(), Error> {
    if let Some(file) = &args.config {
        tracing::info!(file = %file.display(), "options of a file are in force");
    }
    if let (true, ListenAddress::Tcp(address)) = (args.no_auth, &args.listen)
        && !address.ip().is_loopback()
    {
        return Err(Error::OpenToNetwork(*address));
    }
    let inherited = relaunch::inherited();
    let token = match &inherited {
        Some(inherited) if args.token_file.is_none() => inherited.token.clone(),
        _ => args.token()?,
    };
    let opened = Opened::new(args, token.is_none())?;
    let audit = opened.audit.clone();
    pool::start_background()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let start = Start {
        args,
        log_arguments,
        inherited: inherited.as_ref(),
        token: token.as_ref(),
    };
    let Ended {
        outcome,
        devices,
        address,
    } = runtime.block_on(start.serve(opened))?;
    // Ends tasks that still read files or write exports, so that they drop their handles of the devices.
    runtime.shutdown_timeout(Duration::from_millis(100));
    if let Some(audit) = audit {
        audit.flush(AUDIT_GRACE);
    }
    let has_ended = devices.end_within(DEVICE_GRACE);
    if matches!(outcome, Err(ServeError::NeedsNewProcess)) {
        tracing::warn!("another process takes the place of this one");
        log::finish();
        return Err(Error::Relaunch(relaunch::relaunch(
            &address,
            token.as_ref(),
            args.devices.next(),
        )));
    }
    if !has_ended {
        tracing::warn!("the device is at work still, the process ends without it");
        log::finish();
        signals::exit_now(outcome.is_ok());
    }
    Ok(outcome?)
}

/// Files and folders of the options, opened before the server listens.
struct Opened {
    tls: Option<Arc<Tls>>,
    session_key: Option<SessionKey>,
    oidc: Option<Oidc>,
    audit: Option<Audit>,
    /// With `--watch`.
    watcher: Option<Watcher>,
    catalog: SharedCatalog,
    uploads: Option<Uploads>,
    /// Tokens that `isopeel token` makes.
    tokens: Option<TokenWatch>,
    spool: Option<SpoolFolder>,
    jobs: Option<(StateFolder, Limits)>,
}

impl Opened {
    fn new(args: &Args, is_without_token: bool) -> Result<Self, Error> {
        let tls = args.tls()?;
        let session_key = args.servers.session_key()?;
        let oidc = args
            .oidc
            .open(args.public_url.first(), is_without_token, session_key.as_ref())?;
        let audit = args.audit_log.as_deref().map(Audit::open).transpose()?;
        args.memory.limit_process();
        if args.follow_links {
            follow_links();
        }
        let watcher = if args.watch {
            Some(Watcher::open(&args.paths, args.has_demo(), args.frame)?)
        } else {
            None
        };
        let catalog = match &watcher {
            Some(watcher) => watcher.catalog(),
            None => Catalog::open(&args.paths, args.has_demo())?.in_frame(args.frame).into(),
        };
        let uploads = args
            .uploads
            .open(&args.paths, args.folder_access, args.frame, &catalog)?;
        let may_get_volumes = args.uploads.are_enabled() || (watcher.is_some() && !args.paths.is_empty());
        if catalog.now().datasets().is_empty() && !may_get_volumes {
            return Err(Error::NoVolume);
        }
        let folder = args.state_folder.as_deref();
        let folder = folder
            .map(|path| StateFolder::open(path, args.folder_access))
            .transpose()?;
        let tokens = args.servers.tokens(folder.as_ref())?;
        let tokens = tokens.map(TokenWatch::open).transpose()?;
        Ok(Self {
            tls,
            session_key,
            oidc,
            watcher,
            catalog,
            uploads,
            tokens: tokens.map(|tokens| tokens.with_audit(audit.clone())),
            audit,
            spool: args.spool(folder.as_ref())?,
            jobs: folder.map(|folder| (folder, args.job_limits())),
        })
    }
}

/// What a server is started with.
struct Start<'a> {
    args: &'a Args,
    log_arguments: &'a [String],
    /// From the process whose place this one takes.
    inherited: Option<&'a Inherited>,
    token: Option<&'a Token>,
}

/// A server that no longer listens.
struct Ended {
    outcome: Result<(), ServeError>,
    devices: DevicePool,
    address: ListenAddress,
}

impl Start<'_> {
    /// Listens, starts the devices, and serves until a signal.
    async fn serve(&self, opened: Opened) -> Result<Ended, Error> {
        let args = self.args;
        let listener = listen(self.inherited.map_or(&args.listen, |inherited| &inherited.listen)).await?;
        let metrics = match &args.metrics_listen {
            Some(address) => Some(listen(address).await?),
            None => None,
        };
        let (half_drain, is_draining) = (Duration::from_secs(args.drain.into()) / 2, Arc::default());
        let drain = signals::Drain {
            time: half_drain,
            has_begun: Arc::clone(&is_draining),
        };
        let shutdown = signals::shutdown(reload(opened.tls.clone(), opened.audit.clone()), drain)?;
        // Comes after the listener, so that an address in use is reported before the device is opened.
        let devices = start_devices(args, self.log_arguments, &opened.catalog, self.inherited.is_some())?;
        let address = listener.address()?;
        warn_of_network(args, &address);
        if self.inherited.is_none() {
            super::print(args.addresses(&address, self.token).as_bytes()).map_err(Error::Output)?;
        }
        let access = args.access(&address, self.token, opened.tokens.as_ref());
        let access = access.with_session_key(opened.session_key.as_ref());
        let access = access.with_oidc(opened.oidc).with_audit(opened.audit);
        let config = Config {
            ceiling_triangles: args.ceiling_triangles,
            live: args.live(),
            tls: opened.tls,
            connections: ConnectionLimits::of_process(),
            metrics,
            uploads: opened.uploads,
            jobs: opened.jobs,
            job_server: args.servers.job_server().map(Arc::from),
            spool: opened.spool,
            is_draining,
            grace: half_drain.max(serve::SHUTDOWN_GRACE),
            ..Config::new(opened.catalog, devices.clone(), access)
        };
        let path_watch = opened.watcher.map(|watcher| tokio::spawn(watch(watcher)));
        let token_watch = opened.tokens.map(|tokens| tokio::spawn(tokens.run()));
        let outcome = serve::run(listener, config, shutdown).await;
        for task in path_watch.into_iter().chain(token_watch) {
            task.abort();
        }
        Ok(Ended {
            outcome,
            devices,
            address,
        })
    }
}

async fn listen(address: &ListenAddress) -> Result<Listener, Error> {
    let listener = Listener::bind(address).await;
    listener.map_err(|source| Error::Listen {
        address: address.clone(),
        source,
    })
}

/// Returns the handler of SIGHUP. It reloads the certificate, reopens the audit log, and returns a text for the log about what it has
/// reloaded.
fn reload(tls: Option<Arc<Tls>>, audit: Option<Audit>) -> impl Fn() -> &'static str + Send + 'static {
    move || {
        if let Some(audit) = &audit {
            audit.reopen();
        }
        match tls.as_ref().map(|tls| tls.reload()) {
            None => "nothing is to be read again",
            Some(Ok(())) => "the certificate was read again",
            Some(Err(error)) => {
                tracing::error!("the certificate stays as it is: {}", crate::error::chain(&error));
                "nothing was read again"
            }
        }
    }
}

/// Logs a warning if more people may use the server than the operator may expect, or if connections on the network are not encrypted.
fn warn_of_network(args: &Args, address: &ListenAddress) {
    let ListenAddress::Tcp(address) = address else {
        if args.token_file.is_none() && !args.public_url.is_empty() {
            tracing::warn!(
                "no token is asked for at {address}: whoever reaches the proxy of --public-url may use all volumes, unless it asks itself"
            );
        }
        return;
    };
    if args.no_auth {
        tracing::warn!("--no-auth: every user of this machine may use all volumes at {address}");
    }
    let is_encrypted = args.tls_cert.is_some() || args.public_url.iter().any(PublicUrl::is_https);
    if !address.ip().is_loopback() && !is_encrypted {
        tracing::warn!(
            "{address} is open to the network and not encrypted: --tls-cert and --tls-key encrypt it, or put a proxy with TLS in front, and name it with --public-url https://…"
        );
    }
}

/// Starts all devices.
fn start_devices(
    args: &Args,
    log_arguments: &[String],
    catalog: &SharedCatalog,
    retries_opening: bool,
) -> Result<DevicePool, Error> {
    let now = catalog.now();
    let fields = now.datasets().iter().flat_map(|dataset| &dataset.fields);
    let types: HashSet<_> = fields.map(|field| field.sample_type).collect();
    let types: Vec<_> = types.into_iter().collect();
    let hidden = if args.in_process { Vec::new() } else { args.hidden(&now) };
    let each = args.devices.each()?;
    let numbers = (0..).map_while(DeviceNumber::new);
    let start = |(number, device): (DeviceNumber, &DeviceArgs)| {
        let options = DeviceOptions {
            number,
            retries_opening,
            surface_bytes: args.memory.surface_bytes(),
            request_time: options::limit_of(args.request_time),
            user_time: options::limit_of(args.user_time),
            arguments: log_arguments.to_vec(),
            hidden: hidden.clone(),
            ..device.server_options(types.clone())
        };
        DeviceWorker::start_for_server(options, args.in_process)
    };
    let devices = numbers.zip(&each).map(start).collect::<Result<_, _>>()?;
    DevicePool::new(devices).ok_or_else(|| DevicesError::Nothing(String::new()).into())
}

/// Checks the paths for new files at intervals. Returns only after a panic.
async fn watch(mut watcher: Watcher) {
    let mut readers = ReadPool::start();
    loop {
        tokio::time::sleep(INTERVAL).await;
        let check = move || {
            readers.run(|| watcher.look());
            (watcher, readers)
        };
        (watcher, readers) = match tokio::task::spawn_blocking(check).await {
            Ok(returned) => returned,
            Err(error) => return tracing::error!(%error, "paths are not watched any more"),
        };
    }
}
