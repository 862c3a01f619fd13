//! Finds the commands of README, CONTRIBUTING, docs and docker.

use std::path::Path;

use crate::support::repository;

/// Programs that commands begin with. Other indented lines are formulas, answers and files.
const PROGRAMS: [&str; 60] = [
    "admesh",
    "apptainer",
    "apt-cache",
    "apt-get",
    "buildah",
    "cargo",
    "cat",
    "chmod",
    "chown",
    "clinfo",
    "cmake",
    "cp",
    "curl",
    "docker",
    "dpkg",
    "echo",
    "export",
    "gh",
    "git",
    "grep",
    "helm",
    "id",
    "install",
    "isopeel",
    "journalctl",
    "kill",
    "kubectl",
    "kustomize",
    "ls",
    "make",
    "mkdir",
    "mv",
    "nginx",
    "ninja",
    "node",
    "npm",
    "npx",
    "openssl",
    "pip",
    "podman",
    "python3",
    "rm",
    "rustup",
    "sbatch",
    "scancel",
    "sed",
    "skopeo",
    "squeue",
    "srun",
    "ssh",
    "sudo",
    "sudoedit",
    "systemctl",
    "systemd-analyze",
    "systemd-run",
    "tar",
    "ulimit",
    "usermod",
    "wget",
    "xz",
];
/// Languages of blocks that have no commands.
const OTHER_LANGUAGES: [&str; 6] = ["html", "ini", "js", "json", "nginx", "toml"];
/// Folders whose programs are called by their path.
const FOLDERS: [&str; 6] = ["tests/", "packaging/", "docs/", "driver-tests/", ".ci/", "~/"];

/// Whether a line begins with a program, behind variables.
fn is_command(line: &str) -> bool {
    program_of(line)
        .is_some_and(|program| PROGRAMS.contains(&program) || FOLDERS.iter().any(|folder| program.starts_with(folder)))
}

/// The first word of a line that sets no variable.
fn program_of(line: &str) -> Option<&str> {
    let is_variable = |word: &&str| {
        let name = word.split_once('=').map(|(name, _)| name);
        name.is_some_and(|name| name.bytes().all(|b| b.is_ascii_uppercase() || b == b'_'))
    };
    line.split_whitespace().find(|word| !is_variable(word))
}

/// Removes the trailing comment.
fn shortened(line: &str) -> String {
    line.split(" # ").next().unwrap_or_default().trim().to_owned()
}

/// Joins a line with those on which it continues.
fn joined<'a>(line: &str, lines: &mut impl Iterator<Item = &'a str>) -> String {
    let mut command = line.to_owned();
    while let Some(beginning) = command.strip_suffix('\\') {
        let next = lines.next().unwrap_or_default();
        command = format!("{} {}", beginning.trim_end(), next.trim_start());
    }
    command
}

/// The commands of a page in lines of their own, in their order, and those within its text: indented lines and blocks of bash, and code in
/// paragraphs and tables.
#[derive(Default)]
pub struct Page {
    pub lines: Vec<String>,
    pub in_text: Vec<String>,
}

fn page_of(name: &str, text: &str) -> Page {
    let mut page = Page::default();
    let (mut prose, mut fence) = (String::new(), None::<bool>);
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            if fence.take().is_none() {
                let is_bash = language == "bash";
                assert!(
                    is_bash || OTHER_LANGUAGES.contains(&language),
                    "{name}: a block is of '{language}', expected bash for commands, or one of {OTHER_LANGUAGES:?}"
                );
                fence = Some(is_bash);
                if is_bash {
                    // The first line of a block may be of bash itself.
                    let first = lines.next().unwrap_or_default();
                    page.lines.push(shortened(&joined(first, &mut lines)));
                }
            }
            continue;
        }
        let command = match fence {
            Some(is_bash) => Some(line).filter(|line| is_bash && !line.starts_with(' ')),
            None => line.strip_prefix("    "),
        };
        if let Some(command) = command {
            let command = joined(command, &mut lines);
            page.lines.extend(is_command(&command).then(|| shortened(&command)));
        } else if fence.is_none() {
            prose.push_str(line);
            prose.push('\n');
        }
    }
    for code in prose.split('`').skip(1).step_by(2) {
        let code = code.split_whitespace().collect::<Vec<_>>().join(" ");
        // A program's name alone is no command, a script's is one.
        let is_script = || code.ends_with(".sh") || code.ends_with(".py") || code.ends_with(".mjs");
        if is_command(&code) && (program_of(&code) != code.split(' ').next_back() || is_script()) {
            page.in_text.push(code);
        }
    }
    page
}

/// The commands of another file: lines of its comments with three spaces before them, of isopeel.def its help.
fn comments_of(name: &str, text: &str) -> Page {
    let comment = if name.ends_with(".def") { "     " } else { "#" };
    let commands = text.lines().filter_map(|line| line.strip_prefix(comment));
    let commands = commands.filter_map(|line| line.strip_prefix("   "));
    let lines = commands.filter(|line| is_command(line)).map(shortened).collect();
    Page {
        lines,
        in_text: Vec::new(),
    }
}

/// All pages with commands, by path.
pub fn pages() -> Vec<(String, Page)> {
    let root = repository();
    let mut paths = vec!["README.md".to_owned(), "CONTRIBUTING.md".to_owned()];
    for folder in ["docs", "docs/how-to", "docker"] {
        let entries = std::fs::read_dir(root.join(folder)).expect("a folder");
        let entries = entries.map(|entry| entry.expect("an entry"));
        let files = entries.filter(|entry| entry.path().is_file());
        let names = files.map(|entry| entry.file_name().into_string().expect("UTF-8"));
        paths.extend(names.map(|name| format!("{folder}/{name}")));
    }
    let read =
        |path: &Path| std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut pages = Vec::new();
    for path in paths {
        let is_page = path.ends_with(".md");
        // Scripts are run themselves.
        if !is_page && (!path.starts_with("docker/") || path.ends_with(".sh")) {
            continue;
        }
        let text = read(&root.join(&path));
        let page = if is_page {
            page_of(&path, &text)
        } else {
            comments_of(&path, &text)
        };
        pages.push((path, page));
    }
    pages
}
