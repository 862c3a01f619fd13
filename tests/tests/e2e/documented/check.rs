//! What can be said of a command without running it: options, targets and files that it names exist.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::support::{command, repository};

/// Help of the binary's commands, by their names.
#[derive(Default)]
pub struct Checker {
    help: HashMap<String, Result<String, String>>,
}

impl Checker {
    /// Returns what is wrong with a command, or nothing.
    pub fn wrong(&mut self, line: &str) -> Option<String> {
        let wrong = wrong_paths(line)
            .or_else(|| wrong_make(line))
            .or_else(|| wrong_cargo(line))
            .or_else(|| wrong_docker(line))
            .or_else(|| wrong_script(line));
        wrong.or_else(|| {
            let mut commands = line.split(['|', ';']).filter_map(words_of_isopeel);
            commands.find_map(|words| self.wrong_isopeel(words))
        })
    }

    /// A command of isopeel: its name, that of the command below it, and its options.
    fn wrong_isopeel(&mut self, words: &str) -> Option<String> {
        let words: Vec<&str> = words.split_whitespace().collect();
        let mut names = vec![*words.first()?];
        if !names[0].bytes().all(|b| b.is_ascii_lowercase()) {
            return None;
        }
        if ["jobs", "token"].contains(&names[0]) {
            names.extend(words.get(1).filter(|word| word.bytes().all(|b| b.is_ascii_lowercase())));
        }
        let help = self.help.entry(names.join(" ")).or_insert_with(|| {
            let output = command::run(names.iter().copied().chain(["--help"]));
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            if output.status.success() {
                Ok(text)
            } else {
                Err(String::from_utf8_lossy(&output.stderr).into_owned())
            }
        });
        let help = match help {
            Ok(help) => help,
            Err(error) => return Some(error.clone()),
        };
        let options = options_of(&words);
        let unknown = options.into_iter().find(|option| !has_word(help, option));
        unknown.map(|option| format!("isopeel {} has no {option}", names.join(" ")))
    }
}

/// The words behind `isopeel`, if a command is one of its, as it is or in a container or a substitution.
fn words_of_isopeel(command: &str) -> Option<&str> {
    let (before, words) = command.rsplit_once("isopeel ")?;
    let is_one =
        before.trim().is_empty() || before.ends_with("$(") || (before.contains(" exec ") && before.ends_with(' '));
    is_one.then_some(words)
}

/// Long options among words.
fn options_of<'a>(words: &[&'a str]) -> Vec<&'a str> {
    let options = words.iter().map(|word| word.trim_start_matches(['[', '(', '\'', '"']));
    let options = options.filter(|word| word.len() > 2 && word.starts_with("--"));
    options
        .map(|word| word.split(['=', ']']).next().unwrap_or_default())
        .collect()
}

/// Whether text has an option that is not a part of a longer one.
fn has_word(text: &str, option: &str) -> bool {
    text.match_indices(option)
        .any(|(at, _)| !text[at + option.len()..].starts_with(|c: char| c.is_ascii_alphanumeric() || c == '-'))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(repository().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Files and folders of the repository.
fn wrong_paths(line: &str) -> Option<String> {
    let words = line.split_whitespace().map(|word| word.trim_matches(['\'', '"', ')']));
    let is_own = |word: &&str| {
        [
            "docker/",
            "docs/",
            "tests/",
            "packaging/",
            "server/",
            "web/",
            "kernels/",
        ]
        .iter()
        .any(|folder| word.starts_with(folder))
    };
    // docker/.env is the reader's own.
    let missing = words
        .filter(is_own)
        .find(|word| *word != "docker/.env" && !repository().join(word).exists());
    missing.map(|word| format!("{word} is not there"))
}

/// Targets and variables of the Makefile.
fn wrong_make(line: &str) -> Option<String> {
    let words = line.strip_prefix("make ")?;
    let makefile = read("Makefile");
    // Values may have spaces, in quotes.
    let mut quoted = false;
    let words = words.split(|c| {
        quoted ^= c == '"';
        c == ' ' && !quoted
    });
    for word in words {
        let found = match word.split_once('=') {
            Some((variable, _)) => {
                makefile.contains(&format!("({variable})"))
                    || makefile.contains(&format!("\n{variable} ?="))
                    || makefile.contains(&format!("export {variable} ?="))
                    || makefile.contains(&format!("folder that {variable} names"))
            }
            None => makefile.lines().any(|line| line.starts_with(&format!("{word}:"))),
        };
        if !found {
            return Some(format!("the Makefile has no {word}"));
        }
    }
    None
}

/// The value of each of these options.
fn values<'a>(line: &'a str, options: &[&str]) -> Vec<&'a str> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let pairs = words.windows(2).filter(|pair| options.contains(&pair[0]));
    pairs.map(|pair| pair[1]).collect()
}

/// Folders of this workspace's packages, and their manifests.
fn manifests() -> Vec<(PathBuf, String)> {
    fn collect(folder: &Path, depth: usize, found: &mut Vec<(PathBuf, String)>) {
        if let Ok(text) = std::fs::read_to_string(folder.join("Cargo.toml")) {
            found.push((folder.to_owned(), text));
        }
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        for path in entries.map(|entry| entry.path()) {
            let is_built = path.ends_with("target") || path.ends_with("node_modules");
            if depth < 2 && path.is_dir() && !is_built {
                collect(&path, depth + 1, found);
            }
        }
    }
    let mut found = Vec::new();
    collect(&repository(), 0, &mut found);
    found
}

/// Packages, tests, examples and benchmarks.
fn wrong_cargo(line: &str) -> Option<String> {
    let (_, line) = line.split_once("cargo ")?;
    let manifests = manifests();
    // A name in capitals stands for others.
    let is_name = |name: &&str| !name.bytes().all(|b| b.is_ascii_uppercase());
    let package = values(line, &["-p", "--package"])
        .into_iter()
        .filter(is_name)
        .find(|package| {
            !manifests
                .iter()
                .any(|(_, text)| text.contains(&format!("name = \"{package}\"")))
        });
    if let Some(package) = package {
        return Some(format!("there is no package {package}"));
    }
    [("--test", "tests"), ("--example", "examples"), ("--bench", "benches")]
        .iter()
        .find_map(|(option, folder)| {
            let names = values(line, &[option]);
            let is_there = |name: &&str| {
                manifests.iter().any(|(package, _)| {
                    let path = package.join(folder).join(name);
                    path.with_extension("rs").exists() || path.join("main.rs").exists()
                })
            };
            let missing = names.into_iter().find(|name| !is_there(name));
            missing.map(|name| format!("there is no {option} {name}"))
        })
}

/// Targets and arguments of the Dockerfile, services and profiles of Compose.
fn wrong_docker(line: &str) -> Option<String> {
    let is_build = ["docker build", "docker buildx build", "buildah build"]
        .iter()
        .any(|command| line.contains(command));
    if is_build {
        let dockerfile = read("docker/Dockerfile");
        let target = values(line, &["--target"])
            .into_iter()
            .find(|target| !dockerfile.contains(&format!(" AS {target}\n")));
        let argument = values(line, &["--build-arg"])
            .into_iter()
            .find(|argument| !dockerfile.contains(&format!("ARG {}", argument.split('=').next().unwrap_or_default())));
        return target
            .or(argument)
            .map(|name| format!("docker/Dockerfile has no {name}"));
    }
    let (before, words) = line.split_once("docker compose ")?;
    let compose = read("docker/compose.yaml") + &read("docker/compose.tls.yaml");
    let profile = values(words, &["--profile"])
        .into_iter()
        .find(|profile| !compose.contains(&format!("profiles: [{profile}]")));
    let variable = before
        .split_whitespace()
        .filter_map(|word| Some(word.split_once('=')?.0))
        .find(|variable| !compose.contains(&format!("${{{variable}")));
    let service = words
        .split_once("exec ")
        .and_then(|(_, rest)| rest.split(' ').next())
        .filter(|service| !compose.contains(&format!("\n  {service}:\n")));
    let missing = profile.or(variable).or(service);
    missing.map(|name| format!("docker/compose.yaml has no {name}"))
}

/// Options of scripts of the repository.
fn wrong_script(line: &str) -> Option<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let at = words.iter().position(|word| word.starts_with("tests/scripts/"))?;
    let text = read(words[at]);
    let unknown = options_of(&words[at..])
        .into_iter()
        .find(|option| !has_word(&text, option));
    unknown.map(|option| format!("{} has no {option}", words[at]))
}
