//! What expressions mean, and what is said of those that mean nothing.

use super::*;

const FIELDS: &[&str] = &["u", "v", "w", "rho", "flow x", "T2"];

/// The value of an expression for u, v, w, rho, flow x, T2 = 3, 4, 12, 2, 5, 0.5.
fn value(text: &str) -> f32 {
    let of = FieldExpression::parse(text, FIELDS, "field").unwrap_or_else(|e| panic!("{e}"));
    let samples = [3.0, 4.0, 12.0, 2.0, 5.0, 0.5];
    let at: Vec<f32> = (of.fields.iter())
        .map(|name| samples[FIELDS.iter().position(|field| field == name).expect("a field")])
        .collect();
    of.expression.value(&at)
}

#[test]
fn operators_bind_as_in_mathematics() {
    for (text, expected) in [
        ("u", 3.0),
        ("u + v * w", 51.0),
        ("(u + v) * w", 84.0),
        ("w - v - u", 5.0),
        ("w / v / u", 1.0),
        ("-u ^ rho", -9.0),
        ("rho ^ u ^ rho", 512.0),
        ("rho ^ -1", 0.5),
        ("--u", 3.0),
        ("u - -v", 7.0),
        ("1.5e1 * rho + .5 + 2.", 32.5),
        ("log(exp(rho))", 2.0),
        ("magnitude(u, v, w)", 13.0),
        ("magnitude(u,v)", 5.0),
        ("min(u, v) + max(u, v)", 7.0),
        ("clamp(w, u, v)", 4.0),
        ("pow(rho, 3)", 8.0),
        ("if(u < v && !(w <= 4), 1, 2) + 0 * u", 1.0),
        ("if(u == 3 || v != 4, \"flow x\", w)", 5.0),
        ("`flow x` * T2", 2.5),
        (" sqrt( abs( -v ) )\n", 2.0),
        ("floor(T2) + ceil(T2) + u", 4.0),
        ("log2(rho) + log10(100) * u", 7.0),
    ] {
        let found = value(text);
        assert!(
            (found - expected).abs() < 1e-5,
            "{text} is {found}, expected {expected}"
        );
    }
    assert!(value("log(-u)").is_nan());
}

#[test]
fn errors_point_at_the_character() {
    for (text, character, words) in [
        ("", 1, "expected a number, a field, a function or ("),
        ("u +", 4, "expected a number, a field, a function or ("),
        ("u + * v", 5, "expected a number, a field, a function or ("),
        ("(u + v", 7, "expected an operator or )"),
        ("log(u", 6, ": expected an operator or , or )"),
        ("log(u,)", 7, "expected a number, a field, a function or ("),
        ("u v", 3, "expected an operator, or the end"),
        ("u < v < w", 7, "expected an operator, or the end"),
        ("log(q)", 5, "no field \"q\", expected one of \"u\", \"v\""),
        ("ü + u", 1, "no field \"ü\""),
        ("u + sin", 5, "no field \"sin\""),
        (
            "u + erf(v)",
            5,
            "no function \"erf\", expected one of \"abs\", \"sqrt\"",
        ),
        ("log(u, v)", 1, "2 arguments of log, expected 1"),
        ("u * min(u)", 5, "1 arguments of min, expected 2"),
        ("magnitude()", 1, "0 arguments of magnitude"),
        ("u > v", 3, "a condition, expected a number"),
        ("if(u, 1, 2)", 4, "a number, expected a condition"),
        ("if(u > 0 && v, 1, 2)", 13, "a number, expected a condition"),
        ("1 + 2", 1, "no field in it"),
        ("u * 1e99", 5, "expected a number"),
        ("\"flow x", 8, "expected a name in quotation marks"),
        ("u; v", 2, "expected an operator, or the end"),
        ("u[3]", 2, "expected an operator, or the end"),
    ] {
        let error = FieldExpression::parse(text, FIELDS, "field").expect_err(text);
        let place = format!("character {character}: ");
        assert!(
            !error.why.contains(") or a number") && error.why.contains(&place) && error.why.contains(words),
            "{place}{words} in: {}",
            error.why
        );
    }
}

#[test]
fn what_is_too_large_is_refused() {
    let refused = |text: &str, words: &str| {
        let error = FieldExpression::parse(text, FIELDS, "field").expect_err(words);
        assert!(error.why.contains(words), "{words} in: {}", error.why);
    };
    // A number and a sum each.
    let sum = |n: usize| (0..n).map(|i| format!("+{i}")).collect::<String>();
    assert!(FieldExpression::parse(&format!("u{}", sum(31)), FIELDS, "field").is_ok());
    refused(&format!("u{}", sum(32)), "more than 64 operations");
    refused(&format!("u{}", "+1".repeat(600)), "bytes, expected 1024 at most");
    assert!(FieldExpression::parse(&format!("{}u{}", "(".repeat(48), ")".repeat(48)), FIELDS, "field").is_ok());
    for (open, close) in [("(", ")"), ("-", ""), ("abs(", ")"), ("u^", ""), ("!", "")] {
        refused(
            &format!("{}u{}", open.repeat(200), close.repeat(200)),
            "more than 48 parts within each other",
        );
    }
    let names: Vec<String> = (0..9).map(|i| format!("f{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let error = FieldExpression::parse(&names.join("+"), &names, "field").expect_err("nine fields");
    assert!(error.why.contains("character 25: more than 8 fields"), "{}", error.why);
}

proptest::proptest! {
    #[test]
    fn noise_never_panics(text in "[uvw0-9.e+*/^<>=!&|()\", \\-a-z]{0,60}") {
        let _ = FieldExpression::parse(&text, FIELDS, "field");
    }
}

#[test]
fn units_are_those_that_the_operations_keep() {
    // u and v are velocities, w a length, the others unknown.
    let unit = |text: &str| {
        let of = FieldExpression::parse(text, FIELDS, "field").unwrap_or_else(|e| panic!("{e}"));
        let units: Vec<_> = (of.fields.iter())
            .map(|name| match name.as_str() {
                "u" | "v" => Some("m/s"),
                "w" => Some("m"),
                _ => None,
            })
            .collect();
        of.unit(&units).map(str::to_owned)
    };
    for text in [
        "u",
        "-u + v / 2",
        "magnitude(u, v)",
        "if(w > 3, u, 0)",
        "min(u, 4) * 3",
        "u * v / v",
        "clamp(abs(u), 0, v)",
        "2 * (u + 1)",
    ] {
        assert_eq!(unit(text).as_deref(), Some("m/s"), "{text}");
    }
    for text in [
        "u + w",
        "u * v",
        "u / v",
        "log(u)",
        "u ^ 2",
        "rho",
        "u + rho",
        "u * w",
        "1 / u",
        "sqrt(u)",
        "u > v || w < 3",
    ] {
        let text = if text.contains('>') {
            "if(u > v || w < 3, 1, 2)"
        } else {
            text
        };
        assert_eq!(unit(text), None, "{text}");
    }
}

/// Of a condition on the fields of [`value`]: whether it holds there.
fn holds(condition: &str) -> bool {
    let text = format!("distance({condition})");
    let of = FieldExpression::parse(&text, FIELDS, "feature").unwrap_or_else(|e| panic!("{e}"));
    assert!(of.is_distance);
    assert_eq!(
        of.unit(&vec![Some("m"); of.fields.len()]),
        None,
        "that of lengths is not known"
    );
    let samples = [3.0, 4.0, 12.0, 2.0, 5.0, 0.5];
    let at: Vec<f32> = (of.fields.iter())
        .map(|name| samples[FIELDS.iter().position(|field| field == name).expect("a field")])
        .collect();
    assert!(
        of.expression.value(&vec![f32::NAN; at.len()]).is_nan(),
        "missing samples"
    );
    of.expression.value(&at) != 0.0
}

#[test]
fn distances_are_to_where_a_condition_holds() {
    for condition in [
        "u==3",
        " u == 1, 3 ",
        "u==1,2..4,7",
        "u!=1,2",
        "flow x>=5",
        "flow x <= 5",
        "u>2",
        "u<4",
        "u > 2 && v < 5",
        "!(u == 2) || v > 9",
        "\"flow x\" == 5",
        "u - 2",
        "u",
        "if(u > 1, v, 0)",
    ] {
        assert!(holds(condition), "{condition}");
    }
    for condition in [
        "u==2",
        "u==1,4..7",
        "u!=3",
        "u!=2..4",
        "flow x>5",
        "u < 3",
        "u > 3 && v < 5",
        "u - 3",
        "0 * u",
    ] {
        assert!(!holds(condition), "{condition}");
    }
    let plain = FieldExpression::parse("u + v", FIELDS, "feature").expect("an expression");
    assert!(!plain.is_distance);
}

#[test]
fn faults_of_distances_point_at_the_character() {
    for (text, words) in [
        ("distance(bone == 3)", "character 10: no field \"bone\""),
        ("  distance ( u == x)", "character 19: no field \"x\""),
        ("distance(u == 3", "character 16: expected \")\" at the end"),
        ("distance(u == 3) * 2", "character 21: expected \")\" at the end"),
        ("distance(u == 3) + (u)", "character 16: expected"),
        (
            "2 * distance(u == 3)",
            "character 5: distance(CONDITION) inside another expression",
        ),
        (
            "distance(distance(u == 3) < 2)",
            "character 10: distance(CONDITION) inside another expression",
        ),
        ("distance(1 > 0)", "no field in it"),
        ("distance()", "character 10: expected"),
        ("distances(u)", "no function \"distances\", expected one of"),
    ] {
        let error = FieldExpression::parse(text, FIELDS, "feature")
            .expect_err(text)
            .to_string();
        assert!(error.contains(words), "{error}, expected {words}");
    }
    let many: Vec<String> = (0..40).map(|i| format!("{}", 2 * i)).collect();
    let error = FieldExpression::parse(&format!("distance(u=={})", many.join(",")), FIELDS, "feature");
    assert!(error.expect_err("too many").why.contains("more than 64 operations"));
}

#[test]
fn smoothed_conditions_have_a_number_of_samples_first() {
    let smoothed = FieldExpression::parse(" smooth ( 0.8 , u==1,4..7 )", FIELDS, "field").expect("an expression");
    assert_eq!((smoothed.smoothing, smoothed.is_distance), (Some(0.8), false));
    assert_eq!(
        (smoothed.expression.value(&[5.0]), smoothed.expression.value(&[3.0])),
        (1.0, 0.0)
    );
    assert_eq!(smoothed.unit(&[Some("m")]), None);
    for (text, words) in [
        (
            "smooth(u == 3)",
            "character 8: \"u == 3\", expected a number of samples, 0.1 to 10",
        ),
        ("smooth(0, u == 3)", "character 8: \"0\", expected a number"),
        ("smooth(NaN, u == 3)", "character 8: \"NaN\", expected a number"),
        ("smooth(1, bone == 3)", "character 11: no field \"bone\""),
        ("smooth(1,)", "expected"),
        ("smooth(1, u == 3) * 2", "character 22: expected \")\" at the end"),
        (
            "2 * smooth(1, u)",
            "smooth(SAMPLES, CONDITION) inside another expression",
        ),
    ] {
        let error = FieldExpression::parse(text, FIELDS, "field")
            .expect_err(text)
            .to_string();
        assert!(error.contains(words), "{error}, expected {words}");
    }
}

#[test]
fn numbers_beside_a_field_with_ranks_are_those_of_its_file() {
    let rank = |name: &str, number: i128| (name == "labels").then(|| (number - 16_777_210) as f32);
    let value = |text: &str, labels: f32| {
        let fields = &["labels", "p"];
        let parsed = FieldExpression::parse_by(text, fields, "field", &rank).expect(text);
        parsed.expression.value(&vec![labels; parsed.fields.len()])
    };
    for (text, at, expected) in [
        ("if(labels==16777217,1,0)", 7.0, 1.0),
        ("if(labels==16777217,1,0)", 6.0, 0.0),
        ("if(16777216 < labels, 1, 0)", 7.0, 1.0),
        ("if(16777216 < labels, 1, 0)", 6.0, 0.0),
        ("if(labels == -1, 1, 0)", -16_777_211.0, 1.0),
        ("if(p == 7, 1, 0)", 7.0, 1.0),
        ("distance(labels==16777217)", 7.0, 1.0),
        ("distance(labels==16777217)", 6.0, 0.0),
    ] {
        assert_eq!(value(text, at), expected, "{text} at {at}");
    }
}
