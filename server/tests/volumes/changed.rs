//! Random changes of files: how many of each format, and how fast they are read.

use std::time::Instant;

use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestRunner;

/// Runs `test` on `cases` random cases of a format. With `ISOPEEL_MUTATIONS`, which `make fuzz` sets, runs that many and prints the rate.
pub fn each<S: Strategy>(format: &str, cases: u32, strategy: &S, test: impl Fn(S::Value)) {
    let more: Option<u32> = std::env::var("ISOPEEL_MUTATIONS").ok().and_then(|n| n.parse().ok());
    let config = ProptestConfig {
        cases: more.unwrap_or(cases),
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let start = Instant::now();
    let result = TestRunner::new(config).run(strategy, |case| {
        test(case);
        Ok(())
    });
    result.unwrap_or_else(|error| panic!("{format}: {error}"));
    if let Some(cases) = more {
        let rate = f64::from(cases) / start.elapsed().as_secs_f64();
        println!("{format}: {cases} cases, {rate:.0} a second");
    }
}

/// Position of a byte that changes, and its new value.
pub type Change = (Index, u8);

/// Changes of 1 to `end` - 1 bytes, at any position.
pub fn bytes(end: usize) -> impl Strategy<Value = Vec<Change>> {
    prop::collection::vec(any::<Change>(), 1..end)
}

/// The same, mostly with extreme values, which make counts and addresses wrong.
pub fn extreme_bytes(end: usize) -> impl Strategy<Value = Vec<Change>> {
    let value = prop_oneof![any::<u8>(), Just(0xff), Just(0)];
    prop::collection::vec((any::<Index>(), value), 1..end)
}

/// Digits that are replaced by digits or other characters of numbers.
pub fn digits() -> impl Strategy<Value = Vec<Change>> {
    let digit = prop::sample::select(b"0123456789-.e ".to_vec());
    prop::collection::vec((any::<Index>(), digit), 1..4)
}

/// Perhaps a length to which a file is cut.
pub fn cut() -> impl Strategy<Value = Option<Index>> {
    prop::option::weighted(0.2, any::<Index>())
}

/// Changes bytes anywhere.
pub fn change(bytes: &mut [u8], changes: Vec<Change>) {
    for (at, value) in changes {
        bytes[at.index(bytes.len())] = value;
    }
}

/// Changes bytes anywhere, then perhaps cuts the file.
pub fn change_and_cut(bytes: &mut Vec<u8>, changes: Vec<Change>, cut: Option<Index>) {
    change(bytes, changes);
    if let Some(cut) = cut {
        bytes.truncate(cut.index(bytes.len()));
    }
}

/// Changes digits of a text, of which there are some.
pub fn change_digits(text: &mut [u8], changes: Vec<Change>) {
    let digits: Vec<usize> = (0..text.len()).filter(|&at| text[at].is_ascii_digit()).collect();
    for (at, value) in changes {
        text[*at.get(&digits)] = value;
    }
}
