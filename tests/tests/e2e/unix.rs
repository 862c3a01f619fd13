//! A server at a Unix socket, which requires no token: the system lets only its own user connect.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use isopeel_client::{Connection, request};

use crate::support::{command, server};

/// A server that is killed when the test ends.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

#[tokio::test]
async fn a_unix_socket_is_its_users_and_asks_for_no_token() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("isopeel.sock");
    let address = format!("unix:{}", path.display());
    let mut running = Running(
        Command::new(command::binary())
            .args(["serve", "--listen", &address])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary starts"),
    );
    let mut printed = String::new();
    let out = running.0.stdout.take().expect("a pipe");
    BufReader::new(out).read_line(&mut printed).expect("a line");
    assert_eq!(printed.trim(), address);
    let mode = std::fs::metadata(&path).expect("a socket").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let status = |host: &str, asked: &str| {
        let mut socket = UnixStream::connect(&path).expect("the server listens");
        let request = format!("GET {asked} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        socket.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        socket.read_to_string(&mut answer).expect("text");
        answer.split_whitespace().nth(1).map(str::to_owned)
    };
    // As by a tunnel of ssh, whose end is a port of another machine.
    assert_eq!(status("localhost:9000", "/api/v1/volumes").as_deref(), Some("200"));
    assert_eq!(status("evil.example", "/api/v1/volumes").as_deref(), Some("421"));
    let request = request("localhost", "", &[]).expect("a request");
    let socket = tokio::net::UnixStream::connect(&path)
        .await
        .expect("the server listens");
    let stream = Connection::handshake_on(socket, request, None).await.expect("a stream");
    stream.close().await.expect("it is open");

    let said = command::fail(["serve", "--listen", &address]);
    assert!(
        said.contains("cannot listen on unix:") && said.contains("in use"),
        "{said}"
    );
    // Waits for the device, so that the shutdown is that of a working server and not delayed by a driver that is being opened.
    let start = Instant::now();
    while status("localhost", "/readyz").as_deref() != Some("200") {
        assert!(start.elapsed() < Duration::from_secs(120), "the device is not ready");
        std::thread::sleep(Duration::from_millis(50));
    }
    let signalled = Command::new("kill").arg(running.0.id().to_string()).status();
    assert!(signalled.expect("kill runs").success());
    let start = Instant::now();
    let ended = loop {
        if let Some(ended) = running.0.try_wait().expect("a child") {
            break ended;
        }
        assert!(start.elapsed() < Duration::from_secs(5), "it ends");
        std::thread::sleep(Duration::from_millis(10));
    };
    assert!(ended.success(), "{ended}");
    assert!(!path.exists(), "its file is gone");
}
