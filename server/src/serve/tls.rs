//! TLS of the server. Certificate and key are files, which the server can reload while it runs.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

use crate::bounded_read::read_bounded;

/// Certificate and key of a server.
#[derive(Debug)]
pub struct Tls {
    certificate: PathBuf,
    key: PathBuf,
    /// Configuration for the next connection.
    config: RwLock<Arc<ServerConfig>>,
}

/// Why a certificate and key cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A file has invalid content.
    #[error("{} has no {expected}: expected PEM, -----BEGIN …-----", path.display())]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Kind of PEM section that the file must have.
        expected: &'static str,
    },
    /// The key does not match the certificate, or its kind is unknown.
    #[error("{} and {} are not used for TLS", certificate.display(), key.display())]
    Refused {
        /// Path of the certificate.
        certificate: PathBuf,
        /// Path of the key.
        key: PathBuf,
        /// Why rustls refuses them.
        source: rustls::Error,
    },
}

impl Tls {
    /// Reads a certificate and its key. The file of the certificate may continue with the intermediate certificates up to the root.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn open(certificate: &Path, key: &Path) -> Result<Self, TlsError> {
        Ok(Self {
            config: RwLock::new(Arc::new(read(certificate, key)?)),
            certificate: certificate.to_owned(),
            key: key.to_owned(),
        })
    }

    /// Reloads both files. Only new connections use the new certificate.
    ///
    /// # Errors
    /// [`TlsError`]. The previous certificate stays in use.
    pub fn reload(&self) -> Result<(), TlsError> {
        let config = Arc::new(read(&self.certificate, &self.key)?);
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }

    /// Returns an acceptor with the current certificate.
    pub(super) fn acceptor(&self) -> TlsAcceptor {
        let config = self.config.read().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&config).into()
    }
}

/// Maximum bytes of a certificate or key file. Real ones have some kilobytes; the limit catches a wrong path.
const MAX_FILE_BYTES: usize = 1 << 20;

fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    let text = read_bounded(std::fs::File::open(path)?, MAX_FILE_BYTES)?;
    text.ok_or_else(|| {
        io::Error::other(format!(
            "it has more than {MAX_FILE_BYTES} bytes, expected a certificate or a key"
        ))
    })
}

fn read(certificate: &Path, key: &Path) -> Result<ServerConfig, TlsError> {
    let read_pem = |path: &Path| {
        read_file(path).map_err(|source| TlsError::Read {
            path: path.to_owned(),
            source,
        })
    };
    let malformed = |path: &Path, expected| TlsError::Malformed {
        path: path.to_owned(),
        expected,
    };
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&read_pem(certificate)?).collect();
    let chain = chain.ok().filter(|chain| !chain.is_empty());
    let chain = chain.ok_or_else(|| malformed(certificate, "certificate"))?;
    let private_key = PrivateKeyDer::from_pem_slice(&read_pem(key)?).map_err(|_| malformed(key, "private key"))?;
    let refuse = |source| TlsError::Refused {
        certificate: certificate.to_owned(),
        key: key.to_owned(),
        source,
    };
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .and_then(|versions| versions.with_no_client_auth().with_single_cert(chain, private_key))
        .map_err(refuse)?;
    // The server supports HTTP/1.1 alone.
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(config)
}

/// Creates a self-signed certificate for `localhost` and its key, and returns the paths of both files.
#[cfg(test)]
pub(super) fn made_in(folder: &Path, name: &str) -> (PathBuf, PathBuf) {
    let generated = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
    let [certificate, key] = ["crt", "key"].map(|extension| folder.join(name).with_extension(extension));
    std::fs::write(&certificate, generated.cert.pem()).expect("written");
    std::fs::write(&key, generated.signing_key.serialize_pem()).expect("written");
    (certificate, key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_no_certificate_are_refused_and_the_old_one_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = made_in(folder.path(), "a");
        let (other, other_key) = made_in(folder.path(), "b");
        let tls = Tls::open(&certificate, &key).unwrap();
        let config = || Arc::clone(&tls.config.read().unwrap());
        let before = config();
        let of_another = Tls::open(&certificate, &other_key).unwrap_err();
        assert!(matches!(&of_another, TlsError::Refused { .. }), "{of_another}");
        let swapped = Tls::open(&key, &certificate).unwrap_err();
        assert!(swapped.to_string().contains("a.key has no certificate"), "{swapped}");
        std::fs::write(&certificate, "").unwrap();
        assert!(matches!(tls.reload(), Err(TlsError::Malformed { .. })));
        std::fs::remove_file(&certificate).unwrap();
        assert!(matches!(tls.reload(), Err(TlsError::Read { .. })));
        // One that never ends.
        std::os::unix::fs::symlink("/dev/zero", &certificate).unwrap();
        assert!(matches!(tls.reload(), Err(TlsError::Read { .. })));
        std::fs::remove_file(&certificate).unwrap();
        // The key is not replaced yet.
        std::fs::copy(&other, &certificate).unwrap();
        assert!(matches!(tls.reload(), Err(TlsError::Refused { .. })));
        assert!(Arc::ptr_eq(&before, &config()));
        std::fs::copy(&other_key, &key).unwrap();
        tls.reload().unwrap();
        assert!(!Arc::ptr_eq(&before, &config()));
        assert!(!format!("{tls:?}").contains("PRIVATE"), "{tls:?}");
    }
}
