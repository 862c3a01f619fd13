//! Errors of any kind, and how they are printed.

use std::error::Error;

/// Any error; [`chain`] prints it with its causes.
pub type BoxError = Box<dyn Error + Send + Sync>;

/// Formats an error and its causes on one line. A cause that the line already ends with is left out.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let words = error.to_string();
        if !line.ends_with(&words) {
            line.push_str(": ");
            line.push_str(&words);
        }
        cause = error.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct Link {
        text: &'static str,
        source: Option<Box<Link>>,
    }

    fn link(text: &'static str, source: Option<Link>) -> Link {
        Link {
            text,
            source: source.map(Box::new),
        }
    }

    #[test]
    fn a_chain_says_everything_once() {
        let error = link(
            "no surface",
            Some(link("file.nrrd: cut off", Some(link("cut off", None)))),
        );
        assert_eq!(chain(&error), "no surface: file.nrrd: cut off");
    }
}
