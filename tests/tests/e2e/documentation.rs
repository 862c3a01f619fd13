//! Lines of bash in docs/how-to, run as they are written: only names of machines and folders are those of the test.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{command, process, repository};

fn text_of(page: &str) -> String {
    let path = repository().join("docs/how-to").join(page);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The blocks of bash of a page, in their order.
fn blocks(page: &str) -> Vec<String> {
    let text = text_of(page);
    let blocks = text.split("```bash\n").skip(1);
    blocks
        .map(|block| block.split("```").next().unwrap_or_default().to_owned())
        .collect()
}

/// The line of a page that starts a server, as words.
fn server_line(page: &str) -> Vec<String> {
    let text = text_of(page);
    let line = text.lines().find_map(|line| line.strip_prefix("    isopeel serve "));
    line.expect("a line").split_whitespace().map(str::to_owned).collect()
}

/// Runs lines of bash in a folder, with the binary under test as `isopeel`; returns what they print.
fn bash(folder: &Path, lines: &str) -> String {
    let programs = folder.join("bin");
    std::fs::create_dir_all(&programs).expect("a folder");
    let program = programs.join("isopeel");
    if !program.exists() {
        std::os::unix::fs::symlink(command::binary(), program).expect("a link");
    }
    let path = std::env::var("PATH").expect("a path");
    let output = Command::new("bash")
        .args(["-euo", "pipefail", "-c", lines])
        .current_dir(folder)
        .env("PATH", format!("{}:{path}", programs.display()))
        .output()
        .expect("bash");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{lines}: {said}");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn the_curl_lines_make_a_decimated_glb() {
    let Some((server, printed)) = process::launch(&[], &[]) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let token = printed.split("#token=").nth(1).expect("a token");
    let [lines] = blocks("glb-by-curl.md").try_into().expect("one block");
    let (first, rest) = lines.split_once('\n').expect("several lines");
    assert!(first.starts_with("SERVER=http://127.0.0.1:8417 TOKEN="), "{first}");
    let listed = bash(
        folder.path(),
        &format!("SERVER=http://{} TOKEN={token}\n{rest}", server.address),
    );
    assert!(listed.contains("\"id\":\"mni152\""), "{listed}");
    let glb = std::fs::read(folder.path().join("brain.glb")).expect("the file");
    assert_eq!(&glb[..4], b"glTF");
    let length = u32::from_le_bytes([glb[12], glb[13], glb[14], glb[15]]) as usize;
    let json: serde_json::Value = serde_json::from_slice(&glb[20..20 + length]).expect("JSON");
    let statistics = json["asset"]["extras"]["statistics"].as_object().expect("statistics");
    let number = |name: &str| {
        statistics[name]
            .as_u64()
            .unwrap_or_else(|| panic!("{name}: {statistics:?}"))
    };
    let (made, full) = (number("triangles"), number("fullTriangles"));
    assert!(made > 0 && made * 10 <= full, "{made} of {full} triangles");
}

#[test]
fn five_people_with_tokens_and_tls() {
    let folder = tempfile::tempdir().expect("a folder");
    let [certificate, tokens] = blocks("five-people.md").try_into().expect("two blocks");
    bash(folder.path(), &certificate);
    let here = |name: &str| folder.path().join(name).display().to_string();
    // On this machine, and with the demo alone.
    let words = server_line("five-people.md");
    let mut options = Vec::new();
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--listen" => drop(words.next()),
            "cert.pem" | "key.pem" | "state" | "uploads" => options.push(here(word)),
            "https://volumes.example:8417" => options.push("https://localhost:8417".to_owned()),
            "/srv/volumes" => {}
            other => options.push(other.to_owned()),
        }
    }
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    let Some((server, printed)) = process::begin(&Vec::<PathBuf>::new(), &options) else {
        return;
    };
    assert!(printed.starts_with("https://"), "{printed}");
    let said = bash(folder.path(), &tokens);
    let people = ["ann", "bob", "cem", "dua", "eva"];
    for user in people {
        let link = said.lines().find(|line| line.starts_with(&format!("{user}: https://")));
        let (_, token) = link.and_then(|link| link.split_once("#token=")).expect("a link");
        let port = server.address.port();
        // The server looks at its tokens every two seconds.
        let session = bash(
            folder.path(),
            &format!(
                "curl --silent --show-error --fail --retry 6 --retry-delay 1 --retry-all-errors --cacert cert.pem \
                 -H 'Authorization: Bearer {token}' https://localhost:{port}/api/v1/session"
            ),
        );
        assert!(
            session.contains("\"edit\"") && session.contains("\"upload\""),
            "{session}"
        );
    }
    let text = text_of("five-people.md");
    let revoke = text
        .split('`')
        .find(|code| code.starts_with("isopeel token revoke --state-folder state "));
    let link = said.lines().find(|line| line.starts_with("eva: ")).expect("a link");
    let token = link.split("#token=").nth(1).expect("a token");
    let id = token.split('_').nth(1).expect("an id");
    bash(folder.path(), &revoke.expect("the command").replace("ID", id));
    // The page promises five seconds.
    let port = server.address.port();
    let status = bash(
        folder.path(),
        &format!(
            "sleep 5; curl --silent --output answer --write-out '%{{http_code}}' --cacert cert.pem \
             -H 'Authorization: Bearer {token}' https://localhost:{port}/api/v1/session"
        ),
    );
    assert_eq!(status, "401", "a token that was revoked");
    assert_eq!(
        said.lines()
            .filter(|line| people.iter().any(|user| line.contains(user)))
            .count(),
        10,
        "{said}"
    );
}
