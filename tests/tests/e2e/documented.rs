//! Runs the commands of README, CONTRIBUTING, docs and docker. The list states for each command that it is run here as written, or the test or
//! script that runs it, or why none does. A new or changed command fails until it is in the list.

mod check;
mod list;
mod pages;

use std::collections::{BTreeSet, HashMap};
use std::process::{Command, Stdio};

use self::list::How::{self, By, Form, Not, Run, Serve};
use self::list::{COMMANDS, IN_TEXT};
use crate::support::{command, http, process, repository};

/// A command of the list that ends in dots is the first line of a block.
fn is_equal(found: &str, listed: &str) -> bool {
    listed
        .strip_suffix('…')
        .map_or(found == listed, |beginning| found.starts_with(beginning))
}

#[test]
fn each_command_of_the_documentation_is_in_the_list() {
    let listed: HashMap<&str, &[(&str, How)]> = COMMANDS.iter().copied().collect();
    let pages = pages::pages();
    for (page, commands) in &pages {
        let expected: Vec<&str> = listed
            .get(page.as_str())
            .into_iter()
            .flat_map(|lines| lines.iter().map(|line| line.0))
            .collect();
        let found = &commands.lines;
        let equal = found.len() == expected.len()
            && found
                .iter()
                .zip(&expected)
                .all(|(found, expected)| is_equal(found, expected));
        assert!(
            equal,
            "{page} has the commands\n{}\nexpected\n{}",
            found.join("\n"),
            expected.join("\n")
        );
    }
    let gone = listed
        .keys()
        .find(|listed| !pages.iter().any(|(page, _)| page == *listed));
    assert!(gone.is_none(), "the list has the page {gone:?}, which is not there");
    let in_text: BTreeSet<&str> = pages
        .iter()
        .flat_map(|(_, page)| page.in_text.iter().map(String::as_str))
        .collect();
    let expected: BTreeSet<&str> = IN_TEXT.iter().map(|line| line.0).collect();
    let [new, gone] = [in_text.difference(&expected), expected.difference(&in_text)].map(Vec::from_iter);
    let is_listed = |line: &str| {
        COMMANDS
            .iter()
            .any(|(_, lines)| lines.iter().any(|other| other.0 == line))
    };
    let new: Vec<_> = new.into_iter().filter(|line| !is_listed(line)).collect();
    assert!(
        new.is_empty() && gone.is_empty(),
        "in text, not in the list: {new:#?}; in the list, not in text: {gone:#?}"
    );
}

#[test]
fn what_the_commands_of_the_documentation_name_exists() {
    let mut checker = check::Checker::default();
    let (mut here, mut elsewhere, mut forms, mut none, mut wrong) = (0, 0, 0, Vec::new(), Vec::new());
    let lines = COMMANDS
        .iter()
        .flat_map(|(page, lines)| lines.iter().map(move |line| (*page, line)));
    for (page, (line, how)) in lines.chain(IN_TEXT.iter().map(|line| ("in text", line))) {
        wrong.extend(checker.wrong(line).map(|said| format!("{page}: {line}: {said}")));
        match how {
            Run | Serve => here += 1,
            Form => forms += 1,
            By(file, words) => {
                let text = std::fs::read_to_string(repository().join(file));
                let text = text.unwrap_or_else(|error| panic!("{file}: {error}"));
                if !text.contains(words) {
                    wrong.push(format!("{file} has no {words}, expected it to run: {line}"));
                }
                elsewhere += 1;
            }
            Not(why) => none.push(format!("{page}: {line}: {why}")),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    println!(
        "{} commands: {here} are run here, {elsewhere} by other tests, {forms} are forms, {} are run by none:\n{}",
        here + elsewhere + forms + none.len(),
        none.len(),
        none.join("\n")
    );
}

#[test]
fn pages_and_images_name_this_version() {
    let version = env!("CARGO_PKG_VERSION");
    for (file, words) in [
        (
            "docker/Dockerfile",
            format!("org.opencontainers.image.version=\"{version}\""),
        ),
        (
            "docker/kubernetes/base/kustomization.yaml",
            format!("newTag: {version}-cpu"),
        ),
        (
            "docker/kubernetes/gpu/kustomization.yaml",
            format!("newTag: {version}-gpu"),
        ),
        ("docs/releases.md", format!("isopeel-{version}-x86_64-linux.tar.gz")),
        ("docs/releases.md", format!("isopeel_{version}_amd64.deb")),
        ("CHANGELOG.md", format!("## [{version}]")),
    ] {
        let text = std::fs::read_to_string(repository().join(file)).expect("a file");
        assert!(text.contains(&words), "{file} has no {words}");
    }
}

/// A folder with the files that the pages name.
struct Folder {
    root: tempfile::TempDir,
    server: Option<process::Process>,
    /// Values that replace SERVER, ID and other placeholders in commands of the page.
    names: HashMap<&'static str, String>,
}

/// Falls from 1400 at the centre by 40 a sample.
fn head(at: [f32; 3]) -> i16 {
    let squares = at.map(|x| (x - 31.5) * (x - 31.5));
    (1400.0 - 40.0 * squares.iter().sum::<f32>().sqrt()) as i16
}

fn samples() -> Vec<u8> {
    let at = |n: u32| [n % 64, n / 64 % 64, n / 4096].map(|x| x as f32);
    (0..64 * 64 * 64).flat_map(|n| head(at(n)).to_le_bytes()).collect()
}

/// A NIfTI file of 16-bit samples.
fn nifti(samples: &[u8]) -> Vec<u8> {
    let mut header = vec![0; 352];
    header[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (at, value) in [(40, 3), (42, 64), (44, 64), (46, 64), (70, 4), (72, 16)] {
        header[at..at + 2].copy_from_slice(&i16::to_le_bytes(value));
    }
    for (at, value) in [(80, 1.0_f32), (84, 1.0), (88, 1.0), (108, 352.0), (112, 1.0)] {
        header[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    header[344..348].copy_from_slice(b"n+1\0");
    header.extend(samples);
    header
}

impl Folder {
    fn new() -> Self {
        let root = tempfile::tempdir().expect("a folder");
        let write = |name: &str, bytes: &[u8]| std::fs::write(root.path().join(name), bytes).expect("a file");
        for name in ["scans", "more", "scratch", "scratch/study", "bin", "etc"] {
            std::fs::create_dir(root.path().join(name)).expect("a folder");
        }
        let samples = samples();
        let header = b"NRRD0004\ntype: int16\ndimension: 3\nsizes: 64 64 64\nendian: little\nencoding: raw\n\n";
        write("head.nrrd", &[&header[..], &samples].concat());
        for name in ["scans/a.nii", "scans/b.nii", "more/c.nii", "scratch/study/d.nii"] {
            write(name, &nifti(&samples));
        }
        // 1 inside, 0 outside.
        let labels: Vec<u8> = samples
            .chunks(2)
            .flat_map(|sample| i16::from(sample[1] < 2).to_le_bytes())
            .collect();
        write("labels.nii", &nifti(&labels));
        write("labels.tsv", b"index\tname\tcolor\n1\tHippocampus\t#3465a4\n");
        write("head.mhd", format!("{:<311}\n", "ObjectType = Image\nNDims = 3\nDimSize = 256 256 256\nElementType = MET_UCHAR\nElementSpacing = 1 1 1\nElementDataFile = head.raw").as_bytes());
        write(
            "head.raw",
            &(0..1 << 24)
                .map(|n: u32| if n % 256 < 100 { 200 } else { 10 })
                .collect::<Vec<u8>>(),
        );
        let jobs = std::fs::read_to_string(repository().join("docs/jobs.md")).expect("the page");
        let request = jobs
            .split("```json\n")
            .nth(1)
            .and_then(|rest| rest.split("```").next())
            .expect("a request");
        write("request.json", request.as_bytes());
        // `volume` is an id on a server, and a path without one.
        write("here.json", request.replace("\"head\"", "\"head.nrrd\"").as_bytes());
        write(".curlrc", b"fail\nsilent\nshow-error\n");
        std::os::unix::fs::symlink(command::binary(), root.path().join("bin/isopeel")).expect("a link");
        // In the place of a program that reads STL.
        write("bin/admesh", b"#!/bin/sh\ntest $(wc -c) -gt 1000\n");
        // Accounts of this folder, in the place of those of the machine.
        write(
            "bin/sudo",
            b"#!/bin/sh\ntest \"$1\" = usermod && shift && exec /usr/sbin/usermod --prefix \"$CURL_HOME\" \"$@\"\n",
        );
        write("etc/passwd", b"reader:x:1000:1000::/home/reader:/bin/sh\n");
        write("etc/group", b"reader:x:1000:\nvideo:x:44:\nrender:x:105:\n");
        for name in ["bin/admesh", "bin/sudo"] {
            let all = std::os::unix::fs::PermissionsExt::from_mode(0o755);
            std::fs::set_permissions(root.path().join(name), all).expect("its mode");
        }
        let folder = Self {
            root,
            server: None,
            names: HashMap::new(),
        };
        folder.bash("gzip scans/*.nii more/*.nii scratch/study/*.nii labels.nii");
        folder
    }

    fn path(&self, name: &str) -> String {
        self.root.path().join(name).display().to_string()
    }

    /// Runs a line, which must succeed; returns its output.
    fn bash(&self, line: &str) -> String {
        let path = std::env::var("PATH").expect("a path");
        let name = |name: &str| self.names.get(name).map_or("", String::as_str);
        let output = Command::new("bash")
            .args(["-euo", "pipefail", "-c", line])
            .current_dir(self.root.path())
            .env("PATH", format!("{}:{path}", self.path("bin")))
            .env("CURL_HOME", self.root.path())
            .env("USER", "reader")
            .env("ISOPEEL_SERVER", name("SERVER"))
            .env("ISOPEEL_TOKEN_FILE", self.path("token-of-the-server"))
            .env("AUTH", format!("Authorization: Bearer {}", name("TOKEN")))
            .env("TOKEN_OF_THE_SITE", name("MADE"))
            .stdin(Stdio::null())
            .output()
            .expect("bash");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{line}: {said}{}",
            String::from_utf8_lossy(&output.stdout)
        );
        String::from_utf8(output.stdout).expect("text")
    }

    /// A command with names of this folder and of the server of the page.
    fn here(&self, line: &str) -> String {
        let mut line = line
            .replace("batch request.json", "batch here.json")
            .replace("/var/lib/isopeel", &self.path("lib"))
            .replace("/scratch/", &self.path("scratch/"))
            .replace("make help", &format!("make -C {} help", repository().display()))
            .replace("curl URL", &format!("curl file://{}", self.path("head.nrrd")))
            .replace("completions SHELL", "completions bash")
            // The large one takes this unoptimised binary a minute.
            .replace("--size 192", "--size 48")
            .replace("--size 256 512", "--size 32 48")
            // The measurements take minutes, and may be interrupted.
            .replace("--size 512", "--size 48 --case next")
            .replace("--iso V ", "--iso 300 ");
        for name in ["VOLUME", "FILE", "PATH"] {
            line = line.replace(&format!(" {name}"), " head.nrrd");
        }
        for (name, value) in &self.names {
            line = match *name {
                "SERVER" => line
                    .replace("SERVER/", &format!("{value}/"))
                    .replace("https://volumes.example", value),
                "ID" => line
                    .split(' ')
                    .map(|word| if word == "ID" { value } else { word })
                    .collect::<Vec<_>>()
                    .join(" ")
                    .replace("/ID", &format!("/{value}")),
                _ => line,
            };
        }
        line
    }

    fn run(&mut self, line: &str) {
        let printed = self.bash(&self.here(line));
        if let Some(token) = printed.trim().strip_prefix("isop_") {
            self.names.insert("MADE", printed.trim().to_owned());
            self.names
                .insert("ID", token.split('_').next().unwrap_or_default().to_owned());
        } else if let Some((_, rest)) = printed.split_once("\"id\":\"") {
            self.names
                .insert("ID", rest.split('"').next().unwrap_or_default().to_owned());
        } else if line.contains("jobs submit") {
            let is_id = |word: &&str| word.len() == 32 && word.bytes().all(|b| b.is_ascii_hexdigit());
            let id = printed.split_whitespace().find(is_id);
            self.names
                .insert("ID", id.unwrap_or_else(|| panic!("no id: {printed}")).to_owned());
        }
    }

    fn serve(&mut self, line: &str) {
        self.server = None;
        let line = self.here(line);
        let words = line.split_whitespace().skip(2);
        let words: Vec<String> = words
            .map(|word| {
                if self.root.path().join(word).exists() {
                    self.path(word)
                } else {
                    word.to_owned()
                }
            })
            .collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let Some((server, printed)) = process::begin(&[], &words) else {
            return;
        };
        let token = printed.split_once("#token=").map_or("", |(_, token)| token);
        std::fs::write(self.path("token-of-the-server"), format!("{token}\n")).expect("a file");
        self.names.insert("SERVER", format!("http://{}", server.address));
        self.names.insert("TOKEN", token.to_owned());
        assert_eq!(http::get(server.address, "/").status, 200, "{line}");
        self.server = Some(server);
    }
}

#[test]
fn the_commands_of_the_pages_run_as_they_are_written() {
    for (page, lines) in COMMANDS {
        let mut folder = Folder::new();
        for (line, how) in *lines {
            match how {
                Run => folder.run(line),
                Serve => folder.serve(line),
                By(..) | Form | Not(_) => {}
            }
        }
        println!("{page}");
    }
    let mut folder = Folder::new();
    for (line, how) in IN_TEXT {
        if matches!(how, Run) {
            folder.run(line);
        }
    }
}
