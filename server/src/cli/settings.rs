//! Options of `isopeel serve` from the environment and from a file. An option has the same name and the same meaning everywhere. The
//! command line takes precedence over the environment, the environment over the file, and the file over the built-in defaults.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command, CommandFactory, FromArgMatches};
use toml::Value;

use super::Cli;

/// The command that has these options.
const COMMAND: &str = "serve";

/// The option that names the file.
const OPTION: &str = "config";
/// The environment variable that names the file.
const VARIABLE: &str = "ISOPEEL_CONFIG";

/// Options whose values contain commas. In an environment variable, semicolons separate several values.
const HAVE_COMMAS: [&str; 2] = ["oidc-role", "device"];

/// Repeatable options of which a file may state a single value without a list.
const MAY_BE_SINGLE: [&str; 1] = ["device"];

/// Key of the paths in the file, because paths are arguments without an option name.
const PATHS: &str = "paths";

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The file is not valid TOML.
    #[error("{} is not TOML: {why}", path.display())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Message of the parser.
        why: String,
    },
    /// A key is not an option of the command.
    #[error("{}: {key} is no option of isopeel serve, expected one of {expected}", path.display())]
    UnknownKey {
        /// Path of the file.
        path: PathBuf,
        /// The key.
        key: String,
        /// All valid keys, separated by commas.
        expected: String,
    },
    /// A value has the wrong type.
    #[error("{}: {key} = {value}, expected {expected}", path.display())]
    Kind {
        /// Path of the file.
        path: PathBuf,
        /// The key.
        key: String,
        /// Value of the key.
        value: String,
        /// The expected type.
        expected: &'static str,
    },
}

/// Parses the command line of this process, with its environment and file.
///
/// Like [`clap::Parser::parse`], prints a message and exits the process if the user asks for usage or version, or if an option is wrong.
///
/// # Errors
/// [`SettingsError`].
pub fn parse() -> Result<Cli, SettingsError> {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let file = file_of(&arguments, std::env::var_os(VARIABLE));
    let command = with_variables(Cli::command());
    let command = match &file {
        Some(path) => with_file(command, path)?,
        None => command,
    };
    let parsed = command.try_get_matches_from(arguments);
    let cli = parsed.and_then(|mut matches| Cli::from_arg_matches_mut(&mut matches));
    Ok(cli.unwrap_or_else(|error| {
        let is_wrong = !matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
        if let (Some(path), true) = (&file, is_wrong) {
            eprintln!("note: {} sets options too", path.display());
        }
        error.exit()
    }))
}

/// Returns the path of the file: from the option, or else from the variable. Returns `None` if the command is not [`COMMAND`].
fn file_of(arguments: &[OsString], variable: Option<OsString>) -> Option<PathBuf> {
    let command = arguments.iter().position(|argument| argument == COMMAND)?;
    let option = OsString::from(format!("--{OPTION}"));
    let prefix = format!("--{OPTION}=");
    // Only paths follow `--`.
    let mut options = arguments[command + 1..].iter().take_while(|argument| *argument != "--");
    let mut path = None;
    while let Some(argument) = options.next() {
        if *argument == option {
            path = options.next().cloned();
        } else if let Some(value) = argument.to_str().and_then(|text| text.strip_prefix(&prefix)) {
            path = Some(value.into());
        }
    }
    let path = path.or(variable).filter(|path| path != OsStr::new(""));
    path.map(PathBuf::from)
}

/// Returns the environment variable of an option.
fn variable_of(option: &str) -> String {
    format!("ISOPEEL_{}", option.to_uppercase().replace('-', "_"))
}

/// Lets clap read each option of the command from its environment variable, too.
fn with_variables(command: Command) -> Command {
    command.mut_subcommand(COMMAND, |serve| {
        serve.mut_args(|arg| match arg.get_long() {
            // Excludes `help` and `version`, which are not settings.
            None | Some("help" | "version") => arg,
            Some(long) => {
                let variable = variable_of(long);
                // The variable of a repeatable option contains a list.
                let arg = match arg.get_action() {
                    ArgAction::Append if HAVE_COMMAS.contains(&long) => arg.value_delimiter(';'),
                    ArgAction::Append => arg.value_delimiter(','),
                    _ => arg,
                };
                arg.env(variable).hide_env_values(true)
            }
        })
    })
}

/// Replaces built-in defaults by the values of the file.
fn with_file(command: Command, path: &Path) -> Result<Command, SettingsError> {
    let read = |source| SettingsError::Read {
        path: path.into(),
        source,
    };
    let text = std::fs::read_to_string(path).map_err(read)?;
    let table: toml::Table = toml::from_str(&text).map_err(|error| SettingsError::Syntax {
        path: path.into(),
        why: error.to_string(),
    })?;
    let mut command = command;
    for (key, value) in table {
        let serve = command.find_subcommand(COMMAND);
        let args: Vec<&Arg> = serve.into_iter().flat_map(Command::get_arguments).collect();
        let Some(arg) = args.iter().find(|arg| key_of(arg) == Some(&key)) else {
            let expected = args.iter().filter_map(|arg| key_of(arg));
            return Err(SettingsError::UnknownKey {
                path: path.into(),
                expected: expected.collect::<Vec<_>>().join(", "),
                key,
            });
        };
        let (id, values) = (arg.get_id().to_string(), values_of(arg, &key, &value, path)?);
        command = command.mut_subcommand(COMMAND, |serve| serve.mut_arg(id, |arg| arg.default_values(values)));
    }
    Ok(command)
}

/// Returns the key of an option in a file; `None` if the file cannot set the option.
fn key_of(arg: &Arg) -> Option<&str> {
    match arg.get_long() {
        None => Some(PATHS),
        Some("help" | "version" | OPTION) => None,
        Some(long) => Some(long),
    }
}

/// Converts the value of a key to texts as on the command line.
fn values_of(arg: &Arg, key: &str, value: &Value, path: &Path) -> Result<Vec<String>, SettingsError> {
    let wrong = |expected| SettingsError::Kind {
        path: path.into(),
        key: key.into(),
        value: value.to_string(),
        expected,
    };
    let text = |value: &Value| match value {
        Value::String(text) => Some(text.clone()),
        Value::Integer(number) => Some(number.to_string()),
        Value::Float(number) => Some(number.to_string()),
        _ => None,
    };
    match (arg.get_action(), value) {
        (ArgAction::SetTrue, Value::Boolean(is_set)) => Ok(vec![is_set.to_string()]),
        (ArgAction::SetTrue, _) => Err(wrong("true or false")),
        (ArgAction::Append, Value::Array(values)) => {
            let values: Option<Vec<_>> = values.iter().map(text).collect();
            values.ok_or_else(|| wrong("a list of texts"))
        }
        (ArgAction::Append, value) if MAY_BE_SINGLE.contains(&key) => {
            let value = text(value).ok_or_else(|| wrong("a text, a number or a list of them"))?;
            Ok(vec![value])
        }
        (ArgAction::Append, _) => Err(wrong("a list of texts")),
        _ => text(value)
            .map(|text| vec![text])
            .ok_or_else(|| wrong("a text or a number")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<OsString> {
        line.split_whitespace().map(OsString::from).collect()
    }

    fn served(file: &str, line: &str) -> Result<super::super::serve::Args, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("isopeel.toml");
        std::fs::write(&path, file).expect("a file");
        let command = with_file(with_variables(Cli::command()), &path).map_err(|error| error.to_string())?;
        let parsed = command.try_get_matches_from(words(line));
        let cli = parsed.and_then(|mut matches| Cli::from_arg_matches_mut(&mut matches));
        match cli.map_err(|error| error.to_string())?.command {
            super::super::Command::Serve(args) => Ok(*args),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_file_sets_what_the_command_line_does_not() {
        let file = "listen = \"127.0.0.1:9000\"\nrate-peer = 7\nno-demo = true\nallow-origin = [\"https://a.example\", \"https://b.example\"]\npaths = [\"a b.nrrd\"]\n";
        let args = format!("{:?}", served(file, "isopeel serve").expect("arguments"));
        for expected in [
            "127.0.0.1:9000",
            "rate_peer: 7",
            "no_demo: true",
            "a.example",
            "b.example",
            "a b.nrrd",
        ] {
            assert!(args.contains(expected), "{expected} in {args}");
        }
        let line = "isopeel serve --listen 127.0.0.1:1 --rate-peer=8 other.nrrd";
        let args = format!("{:?}", served(file, line).expect("arguments"));
        for expected in ["127.0.0.1:1)", "rate_peer: 8", "other.nrrd"] {
            assert!(args.contains(expected), "{expected} in {args}");
        }
        assert!(!args.contains("a b.nrrd"), "{args}");
    }

    #[test]
    fn what_is_wrong_in_a_file_is_named() {
        for (file, expected) in [
            (
                "lisen = \"127.0.0.1:9000\"",
                "lisen is no option of isopeel serve, expected one of paths, listen",
            ),
            ("config = \"other.toml\"", "config is no option"),
            ("watch = 1", "watch = 1, expected true or false"),
            ("allow-origin = \"https://a.example\"", "expected a list of texts"),
            ("allow-origin = [true]", "expected a list of texts"),
            ("listen = [1]", "listen = [1], expected a text or a number"),
            ("listen = ", "is not TOML"),
            ("listen = \"nowhere\"", "invalid value 'nowhere' for '--listen"),
            ("rate-peer = -1", "invalid value '-1' for '--rate-peer"),
        ] {
            let error = served(file, "isopeel serve").expect_err(file);
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn roles_of_groups_may_be_several_everywhere() {
        let roles = |line: &str, file: &str| {
            let args = format!("{:?}", served(file, line).expect("arguments"));
            let (_, roles) = args.split_once("oidc_role: ").expect("the option");
            roles.matches("GroupRoles").count()
        };
        assert_eq!(
            roles("isopeel serve --oidc-role staff=edit,export --oidc-role *=view", ""),
            2
        );
        assert_eq!(roles("isopeel serve --oidc-role staff=edit,export;*=view", ""), 2);
        assert_eq!(
            roles("isopeel serve", "oidc-role = [\"staff=edit,export\", \"*=view\"]"),
            2
        );
    }

    #[test]
    fn devices_may_be_several_everywhere_and_one_needs_no_list() {
        let devices = |line: &str, file: &str| {
            let args = format!("{:?}", served(file, line).expect("arguments"));
            let (_, devices) = args.split_once("DevicesArgs { device: ").expect("the option");
            let (devices, _) = devices.split_once(']').expect("a list");
            format!("{devices}]")
        };
        for (line, file, expected) in [
            ("isopeel serve", "", "[]"),
            ("isopeel serve --device 1", "", r#"["1"]"#),
            ("isopeel serve --device 1 --device gfx", "", r#"["1", "gfx"]"#),
            ("isopeel serve --device 1;0", "", r#"["1", "0"]"#),
            ("isopeel serve --device a,b", "", r#"["a,b"]"#),
            (
                "isopeel serve",
                "device = \"llvmpipe (LLVM 15, 256 bits)\"",
                r#"["llvmpipe (LLVM 15, 256 bits)"]"#,
            ),
            ("isopeel serve", "device = 1", r#"["1"]"#),
            ("isopeel serve", "device = [0, \"gfx\"]", r#"["0", "gfx"]"#),
            ("isopeel serve --device all", "device = [0, 1]", r#"["all"]"#),
        ] {
            assert_eq!(devices(line, file), expected, "{line}, {file}");
        }
        let error = served("device = true", "isopeel serve").expect_err("no device");
        assert!(error.contains("a text, a number or a list of them"), "{error}");
    }

    #[test]
    fn other_commands_use_one_device() {
        for command in ["extract a.nrrd --iso 1 -o a.stl", "bench", "batch a.nrrd --iso 1 -o a"] {
            let line = |devices: &str| words(&format!("isopeel {command} {devices}"));
            let all = Cli::command().try_get_matches_from(line("--device all"));
            let all = all.expect_err("several devices").to_string();
            assert!(all.contains("this command uses one device"), "{all}");
            let two = Cli::command().try_get_matches_from(line("--device 0 --device 1"));
            let two = two.expect_err("several devices").to_string();
            assert!(two.contains("cannot be used multiple times"), "{two}");
        }
    }

    /// Lines of code in the documentation that call this program, joined with lines that continue them after a backslash.
    fn documented() -> Vec<(String, String)> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let pages = ["docs", "docs/how-to", "server", "docker"].map(|folder| root.join(folder));
        let pages = pages
            .iter()
            .flat_map(|folder| std::fs::read_dir(folder).expect("a folder"));
        let pages = pages
            .map(|page| page.expect("a page").path())
            .chain([root.join("README.md"), root.join("CONTRIBUTING.md")]);
        let mut found = Vec::new();
        for page in pages.filter(|page| page.extension().is_some_and(|kind| kind == "md")) {
            let text = std::fs::read_to_string(&page).expect("text").replace("\\\n", " ");
            for line in text.lines() {
                let line = line.strip_prefix("    ").unwrap_or_default();
                // In a container: `docker compose … exec cpu isopeel …`, `kubectl … exec isopeel-0 -- isopeel …`.
                let line = match line
                    .rsplit_once(" isopeel ")
                    .filter(|(before, _)| before.contains(" exec "))
                {
                    Some((_, rest)) => &format!("isopeel {rest}"),
                    None => line,
                };
                if line.starts_with("isopeel ") {
                    found.push((page.display().to_string(), line.to_owned()));
                }
            }
        }
        found
    }

    /// The words of a line as a shell has them: what is in quotes is one word.
    fn shell_words(line: &str) -> Vec<String> {
        let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
        for c in line.chars() {
            match c {
                _ if quote == Some(c) => quote = None,
                '\'' | '"' if quote.is_none() => {
                    quote = Some(c);
                    word.get_or_insert_default();
                }
                ' ' if quote.is_none() => words.extend(word.take()),
                _ => word.get_or_insert_default().push(c),
            }
        }
        words.extend(word);
        words
    }

    #[test]
    fn the_commands_of_the_documentation_are_understood() {
        let lines = documented();
        assert!(lines.len() > 15, "{lines:?}");
        for (page, line) in lines {
            let line = line.split(" # ").next().unwrap_or_default();
            let parsed = with_variables(Cli::command()).try_get_matches_from(shell_words(line));
            assert!(parsed.is_ok(), "{page}: {line}: {}", parsed.expect_err("an error"));
        }
    }

    /// `command` and those below it that users see.
    fn all_below(command: &Command) -> Vec<&Command> {
        let shown = command.get_subcommands().filter(|command| !command.is_hide_set());
        let below = shown.flat_map(all_below);
        std::iter::once(command).chain(below).collect()
    }

    #[test]
    fn every_option_is_on_the_page() {
        let page = include_str!("../../../docs/command-line.md");
        let cli = Cli::command();
        for command in all_below(&cli) {
            let options = command.get_arguments().filter(|option| !option.is_hide_set());
            for option in options.filter_map(Arg::get_long) {
                let is_there = page.match_indices(&format!("--{option}")).any(|(at, found)| {
                    !page[at + found.len()..].starts_with(|c: char| c.is_ascii_alphanumeric() || c == '-')
                });
                assert!(
                    is_there || ["help", "version"].contains(&option),
                    "{}: --{option}",
                    command.get_name()
                );
            }
        }
    }

    #[test]
    fn the_configuration_for_kubernetes_is_understood() {
        let text = include_str!("../../../docker/kubernetes/base/isopeel.toml");
        let args = format!("{:?}", served(text, "isopeel serve").expect("arguments"));
        assert!(args.contains("0.0.0.0:9417"), "{args}");
    }

    #[test]
    fn the_configuration_of_the_package_is_understood_with_all_that_it_suggests() {
        let text = include_str!("../../../packaging/isopeel.toml");
        let is_suggestion = |line: &str| line.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '));
        let lines = text.lines().map(|line| match line.strip_prefix("# ") {
            Some(suggested) if is_suggestion(suggested) => suggested,
            _ => line,
        });
        let text = lines.collect::<Vec<_>>().join("\n");
        let args = format!("{:?}", served(&text, "isopeel serve").expect("arguments"));
        assert!(
            args.contains("audit.jsonl") && args.contains("127.0.0.1:9417"),
            "{args}"
        );
    }

    #[test]
    fn the_file_is_named_by_the_last_option_or_the_variable() {
        let variable = || Some(OsString::from("v.toml"));
        for (line, variable, expected) in [
            ("isopeel serve", None, None),
            ("isopeel serve", variable(), Some("v.toml")),
            ("isopeel serve --config a.toml", variable(), Some("a.toml")),
            ("isopeel serve --config=a.toml --config b.toml x", None, Some("b.toml")),
            ("isopeel serve -- --config", None, None),
            ("isopeel info x", variable(), None),
        ] {
            let found = file_of(&words(line), variable);
            assert_eq!(found, expected.map(PathBuf::from), "{line}");
        }
    }

    #[test]
    fn each_option_has_a_variable_of_its_name() {
        let command = with_variables(Cli::command());
        let serve = command.find_subcommand(COMMAND).expect("the command");
        let options = serve.get_arguments().filter_map(|arg| Some((arg.get_long()?, arg)));
        for (long, arg) in options.filter(|(long, _)| !["help", "version"].contains(long)) {
            assert_eq!(arg.get_env(), Some(OsStr::new(&variable_of(long))), "--{long}");
        }
        assert_eq!(variable_of("token-file"), "ISOPEEL_TOKEN_FILE");
    }
}
