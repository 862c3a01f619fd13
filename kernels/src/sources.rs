//! The text of a device program: files of `cl/` with their includes resolved.

use include_dir::{Dir, include_dir};
use std::collections::HashSet;
use std::hash::Hasher;

/// Everything in `cl/`.
static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/cl");

/// A file in `cl/`.
pub(crate) struct Source {
    pub file: &'static str,
    /// Its name in errors and times.
    pub stage: &'static str,
    /// Whether its kernels read the volume's samples, and so are built for each sample type. Other kernels are built once.
    pub reads_samples: bool,
}

impl Source {
    /// The names of its kernels.
    pub fn kernel_names(&self) -> impl Iterator<Item = &'static str> {
        let text = text_of(self.file).unwrap_or_else(|| panic!("cl/{} does not exist", self.file));
        text.split("__kernel").skip(1).filter_map(|rest| {
            let (_, name) = rest.split_once("void ")?;
            Some(name.split_once('(')?.0.trim())
        })
    }
}

/// Hash of all kernels' sources.
pub fn build_id() -> u64 {
    let mut hasher = std::hash::DefaultHasher::new();
    let mut folders = vec![&FILES];
    while let Some(folder) = folders.pop() {
        folders.extend(folder.dirs());
        for file in folder.files() {
            hasher.write(file.contents());
        }
    }
    hasher.finish()
}

fn text_of(file: &str) -> Option<&'static str> {
    FILES.get_file(file).and_then(|file| file.contents_utf8())
}

/// Returns a program's text with its includes of files in `cl/` resolved. Each file appears once, at the place of its first include.
/// `#line` directives make a compiler's messages name the file and line of the source.
///
/// # Panics
/// A file that is not in `cl/`: every name is a literal in this crate or in `cl/`.
pub(crate) fn resolve(name: &str, source: &str) -> String {
    let (mut out, mut included) = (String::new(), HashSet::new());
    append(name, source, &mut included, &mut out);
    out
}

fn append(name: &str, source: &str, included: &mut HashSet<String>, out: &mut String) {
    *out += &format!("#line 1 \"{name}\"\n");
    for (number, line) in (1..).zip(source.lines()) {
        match line.strip_prefix("#include \"").and_then(|rest| rest.strip_suffix('"')) {
            Some(path) => {
                if included.insert(path.to_owned()) {
                    let source =
                        text_of(path).unwrap_or_else(|| panic!("{name} includes cl/{path}, which does not exist"));
                    append(&format!("cl/{path}"), source, included, out);
                }
                *out += &format!("#line {} \"{name}\"\n", number + 1);
            }
            None => {
                *out += line;
                out.push('\n');
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_included_once_and_lines_keep_their_numbers() {
        let text = resolve("probe", "#include \"lib/scan.h\"\n#include \"lib/scan.h\"\nlast");
        assert!(text.starts_with("#line 1 \"probe\"\n#line 1 \"cl/lib/scan.h\"\n"));
        assert_eq!(text.matches("#define ISOPEEL_SCAN_H").count(), 1);
        assert!(text.ends_with("#line 2 \"probe\"\n#line 3 \"probe\"\nlast\n"));
    }
}
