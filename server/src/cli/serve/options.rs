//! Options of `isopeel serve`, and what they stand for.

use std::collections::HashSet;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use isopeel_volumes::{Catalog, FileLocation, Frame};

use super::Error;
use super::devices::DevicesArgs;
use super::memory::MemoryArgs;
use super::oidc::OidcArgs;
use super::servers::ServersArgs;
use super::uploads::UploadArgs;
use crate::access::{Access, AllowedOrigin, PublicUrl, Rates, Token, TokenWatch, TrustedProxy};
use crate::jobs::{Limits, StateFolder};
use crate::private_folder::{self, FolderAccess, FolderAccessError};
use crate::rest::SpoolFolder;
use crate::serve::{ListenAddress, Tls};
use crate::stream::LiveOptions;

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
    pub(super) paths: Vec<PathBuf>,

    /// Address and port to listen on; port 0 takes a free one. Or unix:PATH, a socket that this user's processes alone may connect to: it asks for
    /// no token, unless a file has one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8417")]
    pub(super) listen: ListenAddress,

    #[command(flatten)]
    pub(super) devices: DevicesArgs,

    /// Frame of all positions: LPS (left, back and head of a patient are positive), RAS (right, front, head), or index, which counts
    /// samples. Volumes that do not say where a patient's sides are keep their own axes in the first two
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    pub(super) frame: Frame,

    /// Surfaces of more triangles are refused before they are made, with a budget that would be answered
    #[arg(long, value_name = "N", default_value_t = CEILING_TRIANGLES, value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) ceiling_triangles: u64,

    /// Use the drivers of the devices in the server's own process: a driver that crashes or hangs then ends the server
    #[arg(long)]
    pub(super) in_process: bool,

    #[command(flatten)]
    pub(super) memory: MemoryArgs,

    /// Time of the device that a field may take which an expression or a distance gives, in seconds; 0: as much as it takes
    #[arg(long, value_name = "SECONDS", default_value_t = REQUEST_SECONDS)]
    pub(super) request_time: u32,

    /// Time of the device that all such fields of one user may take within ten minutes, in seconds; 0: as much as they take. Administrators
    /// have no limit
    #[arg(long, value_name = "SECONDS", default_value_t = USER_SECONDS)]
    pub(super) user_time: u32,

    /// Look at the paths every two seconds: files that appear, as time steps or volumes, are offered without a restart
    #[arg(long)]
    pub(super) watch: bool,

    /// Let pages of another origin use this server, such as https://viewer.example; may be given again
    #[arg(long, value_name = "ORIGIN")]
    pub(super) allow_origin: Vec<AllowedOrigin>,

    /// Follow links out of the folders that are served, in which people may be able to make some who may not read what they lead to
    #[arg(long)]
    pub(super) follow_links: bool,

    /// Address at which a proxy offers this server, such as https://volumes.example: its host is answered, and its pages are the server's own; may be
    /// given again, that of people first
    #[arg(long, value_name = "URL")]
    pub(super) public_url: Vec<PublicUrl>,

    /// After SIGTERM, answer new requests for half of these seconds, with 503 at /readyz, and give those that run the other half to end; viewers are
    /// closed between both. 0: end within two seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=MAX_DRAIN_SECONDS))]
    pub(super) drain: u32,

    /// Let pages of another origin show the viewer in a frame, such as https://blog.example; may be given again. Those of --allow-origin may too
    #[arg(long, value_name = "ORIGIN")]
    pub(super) embed_origin: Vec<AllowedOrigin>,

    /// File whose only line is the token that lets people and programs in; else one is made at each start, and printed as a part of the address
    #[arg(long, value_name = "FILE", env = "ISOPEEL_TOKEN_FILE")]
    pub(super) token_file: Option<PathBuf>,

    /// Encrypt connections with the certificate in this file, PEM, those between it and its root behind it. SIGHUP reads it and its key again
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub(super) tls_cert: Option<PathBuf>,

    /// The certificate's private key, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub(super) tls_key: Option<PathBuf>,

    /// Requests a second of one peer, in units of the cheapest: an export costs 10, a stream 5, a wrong token 100. Ten seconds of it may come at
    /// once; what is more is answered with 429. 0: as many as it likes
    #[arg(long, value_name = "N", default_value_t = Rates::default().peer)]
    pub(super) rate_peer: u32,

    /// The same of one token
    #[arg(long, value_name = "N", default_value_t = Rates::default().token)]
    pub(super) rate_token: u32,

    /// Take a proxy's word (X-Forwarded-For, Forwarded) for where requests come from: its address, 10.0.0.7, or its network, 10.0.0.0/8; may be
    /// given again
    #[arg(long, value_name = "ADDRESS")]
    pub(super) trusted_proxy: Vec<TrustedProxy>,

    /// Write who has signed in, exported and submitted what, and what was refused, at the end of this file, a line of JSON each. SIGHUP opens it anew
    #[arg(long, value_name = "FILE")]
    pub(super) audit_log: Option<PathBuf>,

    /// Serve /metrics, /healthz and /readyz without a token or TLS at this address and port too, for Prometheus and probes; keep it from strangers
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub(super) metrics_listen: Option<ListenAddress>,

    #[command(flatten)]
    pub(super) oidc: OidcArgs,

    #[command(flatten)]
    pub(super) servers: ServersArgs,

    /// Ask for no token: whoever reaches the port may use all volumes, every user of this machine among them. Only on a loopback address
    #[arg(long)]
    pub(super) no_auth: bool,

    /// Keep batch jobs and their results in this folder, and the tokens that `isopeel token` makes, on a disk of this machine; it is made where
    /// there is none. Without it there are none of these
    #[arg(long, value_name = "DIR", env = "ISOPEEL_STATE_FOLDER")]
    pub(super) state_folder: Option<PathBuf>,

    /// Who may use the folders of state and uploads: this server's user alone, or their group too, as in containers whose volumes belong to a
    /// group. Others may never
    #[arg(long, value_enum, default_value_t, value_name = "WHO")]
    pub(super) folder_access: FolderAccess,

    /// Folder on a disk of this machine in which exports wait that clients read slowly, up to 8 GiB; else it is `spool` in the state folder, or
    /// the folder of temporary files
    #[arg(long, value_name = "DIR")]
    pub(super) spool: Option<PathBuf>,

    /// Disk space for the results of batch jobs, in MiB: a job that may take more than is left is refused
    #[arg(long, value_name = "MIB", default_value_t = JOB_QUOTA_MIB, requires = "state_folder")]
    pub(super) job_quota: u64,

    #[command(flatten)]
    pub(super) uploads: UploadArgs,

    /// TOML file with any of these options by their names, `paths` too: rate-peer = 500. Each may also be in the environment, ISOPEEL_RATE_PEER; the
    /// command line comes first, then the environment, then the file
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,

    /// Offer the embedded demo volume, a human head [default]
    #[arg(long, overrides_with = "no_demo")]
    pub(super) demo: bool,

    /// Leave the embedded demo volume out
    #[arg(long, overrides_with = "demo")]
    pub(super) no_demo: bool,
}

impl Args {
    /// Whether to offer the demo volume. `--demo` overrides `no-demo` in the environment or in a file.
    pub(super) fn has_demo(&self) -> bool {
        self.demo || !self.no_demo
    }

    pub(super) fn live(&self) -> LiveOptions {
        LiveOptions {
            ahead_bytes: self.memory.ahead_bytes(),
            shared_bytes: self.memory.shared_bytes(),
            watches: self.watch,
        }
    }

    /// Returns the folder for spooled exports: `--spool`, or else `spool` in the state folder.
    pub(super) fn spool(&self, state: Option<&StateFolder>) -> Result<Option<SpoolFolder>, FolderAccessError> {
        let default = state.map(|folder| folder.path().join("spool"));
        let folder = self.spool.clone().or(default);
        let opened = folder.map(|folder| private_folder::open(&folder, self.folder_access));
        Ok(opened.transpose()?.map(SpoolFolder::new))
    }

    /// Returns the files and folders that only the server uses, not the process of its device: secrets, volumes, and what users have sent
    /// or made.
    pub(super) fn hidden(&self, catalog: &Catalog) -> Vec<PathBuf> {
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

    pub(super) fn job_limits(&self) -> Limits {
        Limits {
            quota_bytes: self.job_quota.saturating_mul(1 << 20),
        }
    }

    /// Reads the certificate and its key, if the arguments name them.
    pub(super) fn tls(&self) -> Result<Option<Arc<Tls>>, Error> {
        // clap checks this only for the command line, not for a file of options.
        if self.tls_cert.is_some() != self.tls_key.is_some() {
            return Err(Error::HalfOfTls);
        }
        let files = self.tls_cert.as_ref().zip(self.tls_key.as_ref());
        let tls = files
            .map(|(certificate, key)| Tls::open(certificate, key))
            .transpose()?;
        Ok(tls.map(Arc::new))
    }

    /// Returns the start token: from a file, or random. Returns `None` without authentication, and for a Unix socket without a token file.
    pub(super) fn token(&self) -> Result<Option<Token>, Error> {
        Ok(match &self.token_file {
            _ if self.no_auth => None,
            Some(file) => Some(Token::read(file)?),
            None if matches!(self.listen, ListenAddress::Unix(_)) => None,
            None => Some(Token::random()?),
        })
    }

    /// Returns the addresses of the viewer, one per line. An address contains a random token, so that users can open it. It does not contain a
    /// token from a file, because users know this token, and because the output may be logged.
    pub(super) fn addresses(&self, listen: &ListenAddress, token: Option<&Token>) -> String {
        let secret = match token {
            Some(token) if self.token_file.is_none() => format!("/#token={}", token.text()),
            _ => String::new(),
        };
        let scheme = if self.tls_cert.is_some() { "https" } else { "http" };
        let local = match listen {
            ListenAddress::Unix(_) => format!("{listen}\n"),
            ListenAddress::Tcp(listen) => format!("{scheme}://{}{secret}\n", reachable(*listen)),
        };
        let public = self.public_url.iter().map(|url| format!("{url}{secret}\n"));
        std::iter::once(local).chain(public).collect()
    }

    /// Returns the access control of a server that listens on an address.
    pub(super) fn access(&self, address: &ListenAddress, token: Option<&Token>, tokens: Option<&TokenWatch>) -> Access {
        // Requests that reach a Unix socket through a tunnel name this machine in `Host`.
        let address = match address {
            ListenAddress::Tcp(address) => *address,
            ListenAddress::Unix(_) => (Ipv4Addr::LOCALHOST, 0).into(),
        };
        let (peer, token_rate) = (self.rate_peer, self.rate_token);
        let access = Access::new(address, &self.public_url, &self.allow_origin)
            .with_frames(&self.embed_origin)
            .with_proxies(&self.trusted_proxy)
            .with_rates(Rates {
                peer,
                token: token_rate,
            });
        let access = if self.tls_cert.is_some() {
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
}

/// Returns an address at which a browser on this machine reaches the server.
fn reachable(listen: SocketAddr) -> SocketAddr {
    match listen.ip() {
        IpAddr::V4(address) if address.is_unspecified() => (Ipv4Addr::LOCALHOST, listen.port()).into(),
        IpAddr::V6(address) if address.is_unspecified() => (Ipv6Addr::LOCALHOST, listen.port()).into(),
        _ => listen,
    }
}

/// Converts a limit in seconds. 0 means no limit.
pub(super) fn limit_of(seconds: u32) -> Option<Duration> {
    (seconds > 0).then(|| Duration::from_secs(seconds.into()))
}

/// Returns the path of a file or folder on disk.
fn on_disk(location: FileLocation) -> Option<PathBuf> {
    let is_on_disk = location.address().is_none() && !location.is_in_memory();
    is_on_disk.then(|| location.path().to_owned())
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
