//! Arguments and output.

use std::path::Path;

use clap::Parser;
use isopeel_kernels::MAX_LEVEL;
use isopeel_view::quality::{Distance, MaxError, TopologyName};
use isopeel_view::{FeatureName, View};
use isopeel_volumes::testing;

use super::super::{Cli, Command};
use super::*;

fn parse(line: &str) -> Result<Args, clap::Error> {
    match Cli::try_parse_from(line.split_whitespace())?.command {
        Command::Extract(args) => Ok(*args),
        other => panic!("{other:?}"),
    }
}

impl Args {
    /// The view of the arguments.
    fn view(&self, dataset: &Dataset) -> Result<View, ExtractError> {
        Ok(self.surface.request(Format::Stl, self.step)?.view(dataset)?)
    }
}

fn dataset() -> Dataset {
    Dataset {
        opening: Some(serde_json::json!({"alpha": 0.9})),
        ..testing::dataset("head", [2; 3], &["t1", "gm"])
    }
}

#[test]
fn negative_numbers_are_values() {
    let args =
        parse("isopeel extract a.nrrd --iso -300 --beta -1 --feature gm --feature-range -5 -2.5 --stats").unwrap();
    assert_eq!((args.surface.iso, args.surface.beta), (Some(-300.0), Some(-1.0)));
    assert_eq!(args.surface.feature_range, Some(vec![-5.0, -2.5]));
}

#[test]
fn a_result_must_be_asked_for_and_ranges_hold() {
    for line in [
        "isopeel extract a.nrrd --iso 1",
        "isopeel extract --iso 1 --stats",
        "isopeel extract a.nrrd --iso 1 --stats --max-level 6",
        "isopeel extract a.nrrd --iso 1 --stats --feature gm --feature-range 1",
        "isopeel extract a.nrrd --iso 1 --stats --feature-range 1 2",
    ] {
        assert!(parse(line).is_err(), "{line}");
    }
}

#[test]
fn beta_alone_means_the_papers_cut_and_all_else_is_guarded() {
    let (off, on) = (
        (MaxError::None, TopologyName::Free),
        (MaxError::Auto, TopologyName::Auto),
    );
    for (options, expected) in [
        ("", on),
        ("--beta 0.02", off),
        ("--mesher marching-cubes --beta 0.02", off),
        ("--triangles 1000", on),
        ("--bytes 1000", on),
        ("--error 0.1vx", on),
        ("--error 0.1vx --triangles 25%", on),
        (
            "--max-error 0.5",
            (MaxError::At(Distance::World(0.5)), TopologyName::Auto),
        ),
        (
            "--beta 0.02 --max-error 0.1vx",
            (MaxError::At(Distance::Spacings(0.1)), TopologyName::Free),
        ),
        (
            "--beta 0.02 --topology preserve",
            (MaxError::None, TopologyName::Preserve),
        ),
        ("--triangles 9 --max-error none --topology free", off),
    ] {
        let args = parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).unwrap();
        let view = args.view(&dataset()).unwrap();
        assert_eq!((view.max_error, view.topology), expected, "{options}");
    }
    for options in [
        "--beta 1 --triangles 1",
        "--beta 1 --error 1",
        "--triangles 1 --bytes 1",
        "--triangles 0",
        "--triangles 101%",
        "--error none",
        "--max-error -1",
        "--max-error x",
        "--bytes 1 --beta 1",
    ] {
        assert!(
            parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).is_err(),
            "{options}"
        );
    }
}

#[test]
fn small_parts_are_removed_where_an_error_or_a_budget_decides() {
    let view = |options: &str| {
        parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}"))
            .unwrap()
            .view(&dataset())
    };
    for options in ["--error 0.1vx", "--triangles 25%", "--bytes 1000"] {
        assert_eq!(view(&format!("{options} --min-part 2.5")).unwrap().min_part, 2.5);
        assert_eq!(view(options).unwrap().min_part, 0.0);
    }
    for (options, refusal) in [
        (
            "--min-part 5",
            "minPart: 5 with beta alone, expected error, triangles or bytes too",
        ),
        ("--min-part 5 --beta 0.1", "minPart: 5 with beta alone"),
        (
            "--min-part 5 --triangles 9 --mesher marching-cubes",
            "minPart: 5 with marching-cubes, expected the dual mesher",
        ),
        (
            "--min-part -1 --error 1",
            "minPart: -1, expected an area in world units, 0 or more",
        ),
        ("--min-part nan --error 1", "minPart: NaN, expected an area"),
        ("--min-part inf --error 1", "minPart: inf, expected an area"),
    ] {
        let error = view(options).unwrap_err().to_string();
        assert!(error.starts_with(refusal), "{options}: {error}");
    }
    assert!(parse("isopeel extract a.nrrd --iso 1 --stats --error 1 --min-part x").is_err());
}

#[test]
fn parts_are_hidden_or_kept_by_positions() {
    let line = "isopeel extract a.nrrd --iso 1 --stats --error 1";
    let parts = |options: &str| {
        parse(&format!("{line} {options}"))
            .unwrap()
            .view(&dataset())
            .unwrap()
            .parts
    };
    assert_eq!(parts(""), None);
    assert_eq!(
        parts("--hide-part -1,2,3e1 --hide-part 4,5,6"),
        Some(ChosenPartsJson::Hide(vec![[-1.0, 2.0, 30.0], [4.0, 5.0, 6.0]]))
    );
    assert_eq!(
        parts("--keep-part 1,2,3"),
        Some(ChosenPartsJson::Keep(vec![[1.0, 2.0, 3.0]]))
    );
    for (options, words) in [
        ("--hide-part 1,2", "expected three numbers X,Y,Z"),
        ("--keep-part 1,2,nan", "expected three numbers X,Y,Z"),
        ("--hide-part 1,2,3 --keep-part 1,2,3", "cannot be used with"),
    ] {
        let error = parse(&format!("{line} {options}")).unwrap_err().to_string();
        assert!(error.contains(words), "{options}: {error}");
    }
    let by_beta = parse("isopeel extract a.nrrd --iso 1 --stats --hide-part 1,2,3").unwrap();
    let error = by_beta.view(&dataset()).unwrap_err().to_string();
    assert!(error.starts_with("parts: given with beta alone"), "{error}");
}

#[test]
fn what_was_removed_is_said_in_words() {
    let of = |removed_parts| ExtractionStatistics {
        removed_parts,
        removed_triangles: removed_parts.map(|parts| 20 * parts),
        full_triangles: 100,
        ..ExtractionStatistics::default()
    };
    let nothing: [String; 0] = [];
    assert_eq!(removed(Some(1.5), None, &of(None)), nothing);
    for (parts, words) in [
        (
            0,
            "0 parts with an area below 1.5 were removed, 0 of the full surface's 100 triangles",
        ),
        (
            1,
            "1 part with an area below 1.5 was removed, 20 of the full surface's 120 triangles",
        ),
        (
            7,
            "7 parts with an area below 1.5 were removed, 140 of the full surface's 240 triangles",
        ),
    ] {
        assert_eq!(removed(Some(1.5), None, &of(Some(parts))), [words]);
    }
    let hide = ChosenPartsJson::Hide(vec![[0.0; 3]; 3]);
    let said = "2 parts were removed, 40 of the full surface's 140 triangles";
    assert_eq!(removed(None, Some(&hide), &of(Some(2))), [said]);
    assert_eq!(removed(Some(1.5), Some(&hide), &of(Some(2))), [said]);
    let unmatched = ExtractionStatistics {
        unmatched_positions: Some(1),
        ..of(Some(2))
    };
    let warning = "1 of the 3 positions of --hide-part chose nothing: there is no surface in the two cells around";
    assert_eq!(removed(None, Some(&hide), &unmatched), [said, warning]);
}

#[test]
fn regions_of_interest_are_collected() {
    let line = "isopeel extract a.nrrd --iso 1 --stats";
    let options = "--interest sphere:-1,2,3e1:4=0.5 --interest box:-2,-2,-2:-1,-1,-1=1";
    let view = parse(&format!("{line} {options}")).unwrap().view(&dataset()).unwrap();
    let expected = ["sphere:-1,2,3e1:4=0.5", "box:-2,-2,-2:-1,-1,-1=1"].map(|text| text.parse().unwrap());
    assert_eq!(view.interest, expected);
    assert_eq!(parse(line).unwrap().view(&dataset()).unwrap().interest, []);
    let error = parse(&format!("{line} --interest ball:1,2,3:4=1"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("expected sphere:X,Y,Z:R=I or box:X,Y,Z:X,Y,Z=I"),
        "{error}"
    );
    let many = format!("{line}{}", " --interest sphere:0,0,0:1=1".repeat(65));
    let error = parse(&many).unwrap().view(&dataset()).unwrap_err().to_string();
    assert_eq!(error, "interest: 65 regions, expected at most 64");
}

#[test]
fn without_a_feature_smoothness_alone_decides() {
    let view = parse("isopeel extract a.nrrd --iso 517 --stats")
        .unwrap()
        .view(&dataset())
        .unwrap();
    assert_eq!(
        (view.field.as_str(), view.feature.clone(), view.alpha),
        ("t1", FeatureName::None, 0.0)
    );
    assert_eq!((view.beta, view.max_level), (0.02, MAX_LEVEL));
    let view = parse("isopeel extract a.nrrd --iso 517 --stats --feature gm")
        .unwrap()
        .view(&dataset())
        .unwrap();
    assert_eq!((view.feature, view.alpha), (FeatureName::Field("gm".into()), 0.3));
}

#[test]
fn what_the_dataset_has_not_is_named() {
    for (options, expected) in [
        ("--field t2", "field: \"t2\", expected one of \"t1\", \"gm\""),
        ("--alpha 2", "alpha: 2, expected 0 to 1"),
        (
            "--feature gm --feature-range 2 1",
            "featureRange: [2, 1], expected two finite numbers",
        ),
        ("--beta nan", "beta: NaN, expected a finite number"),
    ] {
        let args = parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).unwrap();
        let error = args.view(&dataset()).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{options}: {error}");
    }
}

#[test]
fn the_extension_says_the_format() {
    let error = Format::from_path(Path::new("head.xyz")).unwrap_err().to_string();
    assert_eq!(
        error,
        "\"head.xyz\" does not say the format: expected a name that ends in .glb, .ply, .stl, .vtp, .obj, .3mf, .surf.gii, .precomputed.zip or .usdz"
    );
    for (name, format) in [
        ("a.PLY", Format::Ply),
        ("a.3mf", Format::ThreeMf),
        ("lh.white.surf.gii", Format::Gifti),
        ("a.precomputed.zip", Format::Precomputed),
        ("a.usdz", Format::Usdz),
    ] {
        assert_eq!(Format::from_path(Path::new(name)).unwrap(), format);
    }
    assert!(Format::from_path(Path::new("a.zip")).is_err());
}
