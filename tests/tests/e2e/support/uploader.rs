//! A server that takes uploads, and users who bring some: written from `docs/uploads.md` alone.

use std::io::Write;
use std::net::{SocketAddr, TcpStream};

use serde_json::{Value, json};

use super::process::{self, Process};
use super::{ball, command, http};

/// Content type of parts.
pub const PART: &str = "application/offset+octet-stream";

/// A folder for uploads and state, and the bytes of a volume.
pub struct Setting {
    pub folder: tempfile::TempDir,
    pub volume: Vec<u8>,
}

/// A user, who has a token.
pub struct User {
    pub address: SocketAddr,
    pub bearer: String,
}

impl Setting {
    /// A small ball, and a folder for the server's state.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("ball.npy");
        ball::write_field(&file, [30, 28, 26], |at| {
            let [u, v, w] = [at[0] - 15.0, at[1] - 14.0, at[2] - 13.0];
            10.0 - (u * u + v * v + w * w).sqrt()
        });
        let volume = std::fs::read(&file).expect("a file");
        Self { folder, volume }
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> String {
        let path = self.folder.path().join(name);
        path.to_str().expect("UTF-8").to_owned()
    }

    /// Starts a server with two users who may upload volumes and view them, with these options too.
    pub fn server(&self, options: &[&str]) -> Option<(Process, [User; 2], User)> {
        let (state, uploads) = (self.path("state"), self.path("uploads"));
        let token = |user: &str| {
            let arguments = ["token", "create", "--state-folder", &state, "--user", user];
            let roles = ["edit", "export", "upload"]
                .into_iter()
                .flat_map(|role| ["--role", role]);
            command::succeed(arguments.into_iter().chain(roles)).trim().to_owned()
        };
        let tokens = ["ann", "bob"].map(token);
        let given = ["--state-folder", &state, "--uploads", &uploads, "--no-demo"];
        let (server, printed) = process::launch(&[], &[&given, options].concat())?;
        let start = printed.split("/#token=").nth(1).expect("a token").to_owned();
        let address = server.address;
        let user = |token: String| User {
            address,
            bearer: format!("Bearer {token}"),
        };
        Some((server, tokens.map(user), user(start)))
    }
}

impl User {
    /// A request with the token.
    pub fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> http::Answer {
        let own = [("authorization", self.bearer.as_str())];
        http::send(self.address, method, path, &[&own, headers].concat(), body).expect("an answer")
    }

    /// A request without a body.
    pub fn get(&self, path: &str) -> http::Answer {
        self.ask("GET", path, &[], b"")
    }

    /// A request with JSON.
    pub fn post(&self, path: &str, body: &Value) -> http::Answer {
        let body = body.to_string();
        self.ask("POST", path, &[("content-type", "application/json")], body.as_bytes())
    }

    /// Declares files; returns the upload's path.
    pub fn create(&self, files: &[(&str, usize)]) -> String {
        let answer = self.post("/api/v1/uploads", &declared(files));
        assert_eq!(answer.status, 201, "{}", String::from_utf8_lossy(&answer.body));
        let path = answer.header("location").to_owned();
        assert_eq!(
            path,
            format!("/api/v1/uploads/{}", answer.json()["id"].as_str().expect("an id"))
        );
        path
    }

    /// Sends a part, as tus 1.0 has it.
    pub fn send(&self, path: &str, offset: usize, bytes: &[u8]) -> http::Answer {
        let offset = offset.to_string();
        let headers = [
            ("content-type", PART),
            ("upload-offset", &offset),
            ("tus-resumable", "1.0.0"),
        ];
        self.ask("PATCH", path, &headers, bytes)
    }

    /// Returns the offset at which to continue an upload.
    pub fn offset(&self, path: &str) -> usize {
        let answer = self.ask("HEAD", path, &[("tus-resumable", "1.0.0")], b"");
        assert_eq!((answer.status, answer.header("tus-resumable")), (200, "1.0.0"));
        assert_eq!(answer.header("cache-control"), "no-store");
        answer.header("upload-offset").parse().expect("a number")
    }

    /// Asks for the files to be read.
    pub fn finish(&self, path: &str) -> http::Answer {
        self.post(&format!("{path}/finish"), &json!({}))
    }

    /// Uploads a volume; returns the upload's path and the volume's id.
    pub fn bring(&self, name: &str, bytes: &[u8]) -> (String, String) {
        let path = self.create(&[(name, bytes.len())]);
        assert_eq!(self.send(&path, 0, bytes).status, 204);
        let upload = self.finish(&path);
        assert_eq!(upload.status, 200, "{}", String::from_utf8_lossy(&upload.body));
        let volume = upload.json()["volumes"][0].as_str().expect("an id").to_owned();
        (path, volume)
    }

    /// Ids of the volumes that they see.
    pub fn volumes(&self) -> Vec<String> {
        let list = self.get("/api/v1/volumes").json();
        let ids = list.as_array().expect("a list").iter().map(|volume| &volume["id"]);
        ids.map(|id| id.as_str().expect("an id").to_owned()).collect()
    }
}

/// JSON of a declaration of files.
pub fn declared(files: &[(&str, usize)]) -> Value {
    let file = |(name, bytes): &(&str, usize)| json!({"name": name, "bytes": bytes});
    json!({"files": files.iter().map(file).collect::<Vec<_>>()})
}

/// Sends the head of a part of `length` bytes, but fewer bytes, as if the connection was lost.
pub fn send_half(user: &User, path: &str, offset: usize, length: usize, bytes: &[u8]) -> TcpStream {
    let mut tcp = TcpStream::connect(user.address).expect("the server listens");
    let head = format!(
        "PATCH {path} HTTP/1.1\r\nHost: {}\r\nAuthorization: {}\r\nContent-Type: {PART}\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: {offset}\r\nContent-Length: {length}\r\n\r\n",
        user.address, user.bearer
    );
    tcp.write_all(head.as_bytes()).expect("written");
    tcp.write_all(bytes).expect("written");
    tcp
}
