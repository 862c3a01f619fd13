//! `isopeel serve`: starts the server.

mod devices;
pub(super) mod memory;
mod oidc;
mod relaunch;
mod servers;
mod signals;
mod uploads;

use std::collections::HashSet;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use isopeel_volumes::watch::{INTERVAL, Watcher};
use isopeel_volumes::{Catalog, FileLocation, Frame, ReadError, SharedCatalog, follow_links};

use super::device::DeviceArgs;
use super::log;
use crate::access::{
    Access, AllowedOrigin, Audit, AuditError, PublicUrl, Rates, Token, TokenError, TokenFileError, TokenWatch,
    TrustedProxy,
};
use crate::jobs::{Limits, StateFolder, StateFolderError};
use crate::metrics::DeviceNumber;
use crate::pool::{self, ReadPool};
use crate::private_folder::{self, FolderAccess, FolderAccessError};
use crate::rest::SpoolFolder;
use crate::serve::{self, Config, ConnectionLimits, ListenAddress, Listener, ServeError, Tls, TlsError};
use crate::service::{DeviceOptions, DevicePool, DeviceWorker};
use crate::stream::LiveOptions;
use crate::uploads::FolderError;
use devices::{DevicesArgs, DevicesError};
use memory::MemoryArgs;
use servers::ServersArgs;
use uploads::UploadArgs;

/// Default of `--ceiling-triangles`. More than a browser can draw: 80 MB on the wire, and 1 GB of memory while the surface is made.
const CEILING_TRIANGLES: u64 = 20_000_000;

/// Default of `--request-time`. An expression of 64 operations over 1024³ samples takes less on two cores, except with the slowest
/// functions.
const REQUEST_SECONDS: u32 = 120;

/// Default of `--user-time`: half of the ten minutes for which it holds.
const USER_SECONDS: u32 = 300;

/// Maximum of `--drain`. The second half of it is as long as the deadline of an export.
const MAX_DRAIN_SECONDS: i64 = 1200;

/// Default of `--job-quota`. Enough for some thousand surfaces of a million triangles.
const JOB_QUOTA_MIB: u64 = 64 * 1024;

/// Arguments of `isopeel serve`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volumes to offer: files, folders whose files share one grid and become the fields of one dataset, or addresses of Zarr stores
    /// (https://, http://, s3://) and of Neuroglancer's volumes (precomputed://https://…)
    #[arg(value_name = "PATH")]
    paths: Vec<PathBuf>,

    /// Address and port to listen on; port 0 takes a free one. Or unix:PATH, a socket that this user's processes alone may connect to: it asks for
    /// no token, unless a file has one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8417")]
    listen: ListenAddress,

    #[command(flatten)]
    devices: DevicesArgs,

    /// Frame of all positions: LPS (left, back and head of a patient are positive), RAS (right, front, head), or index, which counts
    /// samples. Volumes that do not say where a patient's sides are keep their own axes in the first two
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    frame: Frame,

    /// Surfaces of more triangles are refused before they are made, with a budget that would be answered
    #[arg(long, value_name = "N", default_value_t = CEILING_TRIANGLES, value_parser = clap::value_parser!(u64).range(1..))]
    ceiling_triangles: u64,

    /// Use the drivers of the devices in the server's own process: a driver that crashes or hangs then ends the server
    #[arg(long)]
    in_process: bool,

    #[command(flatten)]
    memory: MemoryArgs,

    /// Time of the device that a field may take which an expression or a distance gives, in seconds; 0: as much as it takes
    #[arg(long, value_name = "SECONDS", default_value_t = REQUEST_SECONDS)]
    request_time: u32,

    /// Time of the device that all such fields of one user may take within ten minutes, in seconds; 0: as much as they take. Administrators
    /// have no limit
    #[arg(long, value_name = "SECONDS", default_value_t = USER_SECONDS)]
    user_time: u32,

    /// Look at the paths every two seconds: files that appear, as time steps or volumes, are offered without a restart
    #[arg(long)]
    watch: bool,

    /// Let pages of another origin use this server, such as https://viewer.example; may be given again
    #[arg(long, value_name = "ORIGIN")]
    allow_origin: Vec<AllowedOrigin>,

    /// Follow links out of the folders that are served, in which people may be able to make some who may not read what they lead to
    #[arg(long)]
    follow_links: bool,

    /// Address at which a proxy offers this server, such as https://volumes.example: its host is answered, and its pages are the server's own; may be
    /// given again, that of people first
    #[arg(long, value_name = "URL")]
    public_url: Vec<PublicUrl>,

    /// After SIGTERM, answer new requests for half of these seconds, with 503 at /readyz, and give those that run the other half to end; viewers are
    /// closed between both. 0: end within two seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=MAX_DRAIN_SECONDS))]
    drain: u32,

    /// Let pages of another origin show the viewer in a frame, such as https://blog.example; may be given again. Those of --allow-origin may too
    #[arg(long, value_name = "ORIGIN")]
    embed_origin: Vec<AllowedOrigin>,

    /// File whose only line is the token that lets people and programs in; else one is made at each start, and printed as a part of the address
    #[arg(long, value_name = "FILE", env = "ISOPEEL_TOKEN_FILE")]
    token_file: Option<PathBuf>,

    /// Encrypt connections with the certificate in this file, PEM, those between it and its root behind it. SIGHUP reads it and its key again
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,

    /// The certificate's private key, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,

    /// Requests a second of one peer, in units of the cheapest: an export costs 10, a stream 5, a wrong token 100. Ten seconds of it may come at
    /// once; what is more is answered with 429. 0: as many as it likes
    #[arg(long, value_name = "N", default_value_t = Rates::default().peer)]
    rate_peer: u32,

    /// The same of one token
    #[arg(long, value_name = "N", default_value_t = Rates::default().token)]
    rate_token: u32,

    /// Take a proxy's word (X-Forwarded-For, Forwarded) for where requests come from: its address, 10.0.0.7, or its network, 10.0.0.0/8; may be
    /// given again
    #[arg(long, value_name = "ADDRESS")]
    trusted_proxy: Vec<TrustedProxy>,

    /// Write who has signed in, exported and submitted what, and what was refused, at the end of this file, a line of JSON each. SIGHUP opens it anew
    #[arg(long, value_name = "FILE")]
    audit_log: Option<PathBuf>,

    /// Serve /metrics, /healthz and /readyz without a token or TLS at this address and port too, for Prometheus and probes; keep it from strangers
    #[arg(long, value_name = "ADDRESS:PORT")]
    metrics_listen: Option<ListenAddress>,

    #[command(flatten)]
    oidc: oidc::OidcArgs,

    #[command(flatten)]
    servers: ServersArgs,

    /// Ask for no token: whoever reaches the port may use all volumes, every user of this machine among them. Only on a loopback address
    #[arg(long)]
    no_auth: bool,

    /// Keep batch jobs and their results in this folder, and the tokens that `isopeel token` makes, on a disk of this machine; it is made where
    /// there is none. Without it there are none of these
    #[arg(long, value_name = "DIR", env = "ISOPEEL_STATE_FOLDER")]
    state_folder: Option<PathBuf>,

    /// Who may use the folders of state and uploads: this server's user alone, or their group too, as in containers whose volumes belong to a
    /// group. Others may never
    #[arg(long, value_enum, default_value_t, value_name = "WHO")]
    folder_access: FolderAccess,

    /// Folder on a disk of this machine in which exports wait that clients read slowly, up to 8 GiB; else it is `spool` in the state folder, or
    /// the folder of temporary files
    #[arg(long, value_name = "DIR")]
    spool: Option<PathBuf>,

    /// Disk space for the results of batch jobs, in MiB: a job that may take more than is left is refused
    #[arg(long, value_name = "MIB", default_value_t = JOB_QUOTA_MIB, requires = "state_folder")]
    job_quota: u64,

    #[command(flatten)]
    uploads: UploadArgs,

    /// TOML file with any of these options by their names, `paths` too: rate-peer = 500. Each may also be in the environment, ISOPEEL_RATE_PEER; the
    /// command line comes first, then the environment, then the file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Offer the embedded demo volume, a human head [default]
    #[arg(long, overrides_with = "no_demo")]
    demo: bool,

    /// Leave the embedded demo volume out
    #[arg(long, overrides_with = "demo")]
    no_demo: bool,
}

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
        _ => token(args)?,
    };
    let tls = tls(args)?;
    let session_key = args.servers.session_key()?;
    let oidc = args
        .oidc
        .open(args.public_url.first(), token.is_none(), session_key.as_ref())?;
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
    let uploads = args.uploads.open(args, &catalog)?;
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
    let tokens = tokens.map(|tokens| tokens.with_audit(audit.clone()));
    let spool = args.spool(folder.as_ref())?;
    let jobs = folder.map(|folder| (folder, args.job_limits()));
    pool::start_background()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let (half_drain, is_draining) = (Duration::from_secs(args.drain.into()) / 2, Arc::default());
    let drain = signals::Drain {
        time: half_drain,
        has_begun: Arc::clone(&is_draining),
    };
    let (outcome, devices, address) = runtime.block_on(async {
        let listener = listen(inherited.as_ref().map_or(&args.listen, |inherited| &inherited.listen)).await?;
        let metrics = match &args.metrics_listen {
            Some(address) => Some(listen(address).await?),
            None => None,
        };
        let shutdown = signals::shutdown(reload(tls.clone(), audit.clone()), drain)?;
        // Comes after the listener, so that an address in use is reported before the device is opened.
        let devices = start_devices(args, log_arguments, &catalog, inherited.is_some())?;
        let address = listener.address()?;
        warn_of_network(args, &address);
        if inherited.is_none() {
            super::print(addresses(args, &address, token.as_ref()).as_bytes()).map_err(Error::Output)?;
        }
        let access = access(args, &address, token.as_ref(), tokens.as_ref());
        let access = access.with_session_key(session_key.as_ref());
        let access = access.with_oidc(oidc).with_audit(audit.clone());
        let config = Config {
            ceiling_triangles: args.ceiling_triangles,
            live: args.live(),
            tls,
            connections: ConnectionLimits::of_process(),
            metrics,
            uploads,
            jobs,
            job_server: args.servers.job_server().map(Arc::from),
            spool,
            is_draining,
            grace: half_drain.max(serve::SHUTDOWN_GRACE),
            ..Config::new(catalog, devices.clone(), access)
        };
        let path_watch = watcher.map(|watcher| tokio::spawn(watch(watcher)));
        let token_watch = tokens.map(|tokens| tokio::spawn(tokens.run()));
        let outcome = serve::run(listener, config, shutdown).await;
        for task in path_watch.into_iter().chain(token_watch) {
            task.abort();
        }
        Ok::<_, Error>((outcome, devices, address))
    })?;
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

async fn listen(address: &ListenAddress) -> Result<Listener, Error> {
    let listener = Listener::bind(address).await;
    listener.map_err(|source| Error::Listen {
        address: address.clone(),
        source,
    })
}

/// Reads the certificate and its key, if the arguments name them.
fn tls(args: &Args) -> Result<Option<Arc<Tls>>, Error> {
    // clap checks this only for the command line, not for a file of options.
    if args.tls_cert.is_some() != args.tls_key.is_some() {
        return Err(Error::HalfOfTls);
    }
    let files = args.tls_cert.as_ref().zip(args.tls_key.as_ref());
    let tls = files
        .map(|(certificate, key)| Tls::open(certificate, key))
        .transpose()?;
    Ok(tls.map(Arc::new))
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

/// Returns the start token: from a file, or random. Returns `None` without authentication, and for a Unix socket without a token file.
fn token(args: &Args) -> Result<Option<Token>, Error> {
    Ok(match &args.token_file {
        _ if args.no_auth => None,
        Some(file) => Some(Token::read(file)?),
        None if matches!(args.listen, ListenAddress::Unix(_)) => None,
        None => Some(Token::random()?),
    })
}

/// Returns the addresses of the viewer, one per line. An address contains a random token, so that users can open it. It does not contain a
/// token from a file, because users know this token, and because the output may be logged.
fn addresses(args: &Args, listen: &ListenAddress, token: Option<&Token>) -> String {
    let secret = match token {
        Some(token) if args.token_file.is_none() => format!("/#token={}", token.text()),
        _ => String::new(),
    };
    let scheme = if args.tls_cert.is_some() { "https" } else { "http" };
    let local = match listen {
        ListenAddress::Unix(_) => format!("{listen}\n"),
        ListenAddress::Tcp(listen) => format!("{scheme}://{}{secret}\n", reachable(*listen)),
    };
    let public = args.public_url.iter().map(|url| format!("{url}{secret}\n"));
    std::iter::once(local).chain(public).collect()
}

/// Returns an address at which a browser on this machine reaches the server.
fn reachable(listen: SocketAddr) -> SocketAddr {
    match listen.ip() {
        IpAddr::V4(address) if address.is_unspecified() => (Ipv4Addr::LOCALHOST, listen.port()).into(),
        IpAddr::V6(address) if address.is_unspecified() => (Ipv6Addr::LOCALHOST, listen.port()).into(),
        _ => listen,
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
            request_time: limit_of(args.request_time),
            user_time: limit_of(args.user_time),
            arguments: log_arguments.to_vec(),
            hidden: hidden.clone(),
            ..device.server_options(types.clone())
        };
        DeviceWorker::start_for_server(options, args.in_process)
    };
    let devices = numbers.zip(&each).map(start).collect::<Result<_, _>>()?;
    DevicePool::new(devices).ok_or_else(|| DevicesError::Nothing(String::new()).into())
}

/// Converts a limit in seconds. 0 means no limit.
fn limit_of(seconds: u32) -> Option<Duration> {
    (seconds > 0).then(|| Duration::from_secs(seconds.into()))
}

/// Returns the access control of a server that listens on an address.
fn access(args: &Args, address: &ListenAddress, token: Option<&Token>, tokens: Option<&TokenWatch>) -> Access {
    // Requests that reach a Unix socket through a tunnel name this machine in `Host`.
    let address = match address {
        ListenAddress::Tcp(address) => *address,
        ListenAddress::Unix(_) => (Ipv4Addr::LOCALHOST, 0).into(),
    };
    let (peer, token_rate) = (args.rate_peer, args.rate_token);
    let access = Access::new(address, &args.public_url, &args.allow_origin)
        .with_frames(&args.embed_origin)
        .with_proxies(&args.trusted_proxy)
        .with_rates(Rates {
            peer,
            token: token_rate,
        });
    let access = if args.tls_cert.is_some() {
        access.with_tls()
    } else {
        access
    };
    let access = match token {
        Some(token) => access.with_token(token),
        None => access,
    };
    match tokens {
        Some(tokens) => access.with_named(tokens),
        None => access,
    }
}

impl Args {
    /// Whether to offer the demo volume. `--demo` overrides `no-demo` in the environment or in a file.
    fn has_demo(&self) -> bool {
        self.demo || !self.no_demo
    }

    fn live(&self) -> LiveOptions {
        LiveOptions {
            ahead_bytes: self.memory.ahead_bytes(),
            shared_bytes: self.memory.shared_bytes(),
            watches: self.watch,
        }
    }

    /// Returns the folder for spooled exports: `--spool`, or else `spool` in the state folder.
    fn spool(&self, state: Option<&StateFolder>) -> Result<Option<SpoolFolder>, FolderAccessError> {
        let default = state.map(|folder| folder.path().join("spool"));
        let folder = self.spool.clone().or(default);
        let opened = folder.map(|folder| private_folder::open(&folder, self.folder_access));
        Ok(opened.transpose()?.map(SpoolFolder::new))
    }

    /// Returns the files and folders that only the server uses, not the process of its device: secrets, volumes, and what users have sent
    /// or made.
    fn hidden(&self, catalog: &Catalog) -> Vec<PathBuf> {
        let files = [&self.token_file, &self.tls_key, &self.config, &self.audit_log];
        let folders = [&self.state_folder, &self.spool];
        let named = files.into_iter().chain(folders).flatten();
        let named = named.chain(self.oidc.secret_file()).chain(self.uploads.folder());
        let named = named.chain(self.servers.secrets());
        let volumes = self.paths.iter().map(|path| FileLocation::named(path));
        let mut hidden: HashSet<PathBuf> = volumes.filter_map(on_disk).chain(named.cloned()).collect();
        // Other files of a volume, which its path does not name: samples beside a header, and what links lead to.
        for dataset in catalog.datasets() {
            let sources = dataset.fields.iter().map(|field| &field.source);
            let files = sources.flat_map(|source| (0..dataset.steps).flat_map(|step| source.inputs(step)));
            for file in files.filter_map(on_disk) {
                if self.follow_links || !file.ancestors().any(|path| hidden.contains(path)) {
                    hidden.insert(file);
                }
            }
        }
        hidden.into_iter().collect()
    }

    fn job_limits(&self) -> Limits {
        Limits {
            quota_bytes: self.job_quota.saturating_mul(1 << 20),
        }
    }
}

/// Returns the path of a file or folder on disk.
fn on_disk(location: FileLocation) -> Option<PathBuf> {
    let is_on_disk = location.address().is_none() && !location.is_in_memory();
    is_on_disk.then(|| location.path().to_owned())
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn secrets_volumes_and_what_users_have_sent_are_hidden_from_the_process_of_the_device() {
        let folder = tempfile::tempdir().unwrap();
        let header = folder.path().join("a.nhdr");
        let text = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\ndata file: a.raw\n";
        std::fs::write(&header, text).unwrap();
        std::fs::write(folder.path().join("a.raw"), [0; 8]).unwrap();
        let options = [
            ("--token-file", "/a/token"),
            ("--tls-cert", "/a/certificate"),
            ("--tls-key", "/a/key"),
            ("--config", "/a/config"),
            ("--audit-log", "/a/audit"),
            ("--state-folder", "/a/state"),
            ("--spool", "/a/spool"),
            ("--uploads", "/a/uploads"),
            ("--oidc-client-secret-file", "/a/secret"),
            ("--token-folder", "/a/tokens"),
            ("--session-key-file", "/a/session"),
        ];
        let options = options.iter().flat_map(|(name, value)| [*name, *value]);
        let paths = [header.to_str().unwrap(), "/volumes", "https://volumes.example/a.zarr"];
        let args = Command::parse_from(["serve"].into_iter().chain(options).chain(paths)).args;
        let catalog = Catalog::open(std::slice::from_ref(&header), true).unwrap();
        let mut hidden = args.hidden(&catalog);
        hidden.sort();
        let named = [
            "audit", "config", "key", "secret", "session", "spool", "state", "token", "tokens", "uploads",
        ];
        let mut expected: Vec<_> = named.iter().map(|name| Path::new("/a").join(name)).collect();
        expected.extend([header, folder.path().join("a.raw"), "/volumes".into()]);
        expected.sort();
        assert_eq!(hidden, expected);
    }
}
