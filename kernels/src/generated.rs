//! The headers in `cl/lib/` that are generated from Rust. `make generated` writes them; a test fails when they are stale.

use crate::tables::sheets::Sheets;
use crate::{constants, expression, stages};
use std::path::PathBuf;

/// Compares a generated file with the committed one, or writes it if `UPDATE_GENERATED` is set.
fn check(name: &str, what: &str, body: &str) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("cl/lib").join(name);
    let guard = format!("ISOPEEL_{}", name.to_uppercase().replace('.', "_"));
    let text = format!("// {what} Generated: `make generated`.\n#ifndef {guard}\n#define {guard}\n\n{body}\n#endif\n");
    if std::env::var_os("UPDATE_GENERATED").is_some() {
        std::fs::write(&path, &text).expect("write a generated header");
    }
    let committed = std::fs::read_to_string(&path).expect("read a generated header");
    assert!(committed == text, "cl/lib/{name} is stale: run `make generated`");
}

#[test]
fn constants_header_is_fresh() {
    check(
        "constants.h",
        "Constants that host and device share, from kernels/src/constants.rs.",
        &constants::header(),
    );
}

#[test]
fn operations_header_is_fresh() {
    check(
        "operations.h",
        "Functions and comparisons of expressions, from kernels/src/expression.rs.",
        &expression::header(),
    );
}

#[test]
fn args_header_is_fresh() {
    let structs: String = stages::declarations().into_iter().map(|d| d.text + "\n").collect();
    check(
        "args.h",
        "Structs of kernels' arguments, from the launchers in kernels/src/stages.",
        &format!("#include \"lib/layout.h\"\n\n{}", structs.trim_end().to_owned() + "\n"),
    );
}

#[test]
fn tables_header_is_fresh() {
    check(
        "tables.h",
        "Case tables of the sheets of a cell, from kernels/src/tables; lib/sheets.h says what they mean.",
        &sheet_tables(),
    );
}

#[test]
fn set_bits_header_is_fresh() {
    let positions = |byte: u64| (0..8).filter(move |bit| byte >> bit & 1 == 1);
    let placed = |(i, bit): (u64, u64)| bit << (8 * i);
    let packed = |byte| (0..).zip(positions(byte)).map(placed).sum();
    let bytes: Vec<u64> = (0..256).map(packed).collect();
    let lines: Vec<_> = bytes
        .chunks(8)
        .map(|line| line.iter().map(|n| format!("{n:#x}ul")).collect::<Vec<_>>().join(", "))
        .collect();
    check(
        "set_bits.h",
        "The set bits of every byte, a byte each, lowest first; behind them zeros.",
        &format!(
            "__constant ulong SET_BITS[256] = {{\n    {}\n}};\n",
            lines.join(",\n    ")
        ),
    );
}

/// The tables of `cl/lib/sheets.h`.
fn sheet_tables() -> String {
    let cases: Vec<_> = (0..=255).map(|signs| Sheets::trace(signs, 0)).collect();
    let list = |numbers: Vec<u32>| {
        let lines = numbers
            .chunks(12)
            .map(|line| line.iter().map(|n| format!("{n:#x}u")).collect::<Vec<_>>().join(", "));
        format!("{{\n    {}\n}}", lines.collect::<Vec<_>>().join(",\n    "))
    };
    let (mut rows, mut flipped, mut still_joined) = (Vec::new(), Vec::new(), Vec::new());
    for (signs, sheets) in cases.iter().enumerate() {
        let faces = sheets.joined_faces();
        rows.push(flipped.len() as u32);
        // One entry for each set of those faces, indexed by their packed bits.
        let chosen = |set: u32| {
            (0..6)
                .filter(|&f| faces >> f & 1 == 1)
                .enumerate()
                .filter(move |(i, _)| set >> i & 1 == 1)
        };
        let sets = 0..1u32 << faces.count_ones();
        for set in sets {
            let flips = chosen(set).fold(0, |bits, (_, f)| bits | 1 << f);
            let sheets = Sheets::trace(signs as u8, flips);
            flipped.push(sheets.packed());
            still_joined.push(sheets.joined_faces().into());
        }
    }
    let joined = cases.iter().map(|s| s.joined_faces().into()).collect();
    format!(
        "__constant uint SHEETS[256] = {};\n\
         __constant uchar JOINED[256] = {};\n\
         __constant uint FLIPPED_ROW[256] = {};\n\
         __constant uint FLIPPED[{}] = {};\n\
         __constant uchar STILL_JOINED[{}] = {};\n",
        list(cases.iter().map(Sheets::packed).collect()),
        list(joined),
        list(rows),
        flipped.len(),
        list(flipped),
        still_joined.len(),
        list(still_joined),
    )
}
