//! Expressions: the device, the host and the twin compute the same values, within the errors that OpenCL allows its functions.

use super::recipes::{Random, any_recipe};
use super::*;
use isopeel_kernels::expression::{Binary, Comparison, Expression, Kind, Op, Unary};
use isopeel_kernels::{SampleType, Samples};
use isopeel_reference::expression;

/// Operations of a random expression: the twin walks each path from the last one down.
const OPS: usize = 14;

/// Samples of a volume that are compared at high.
const MAX_SAMPLES: usize = 2000;

/// Three fields on one grid, of types and missing values of their own.
fn fields(engine: &Engine, recipe: &Recipe) -> [Loaded; 3] {
    let kinds = [recipe.kind, SampleType::F32, SampleType::I16];
    [0, 1, 2].map(|i| {
        let own = Recipe {
            kind: kinds[i],
            seed: recipe.seed.wrapping_add(i as u64),
            ..recipe.clone()
        };
        load(engine, &own)
    })
}

/// An expression over three fields.
fn random_expression(seed: u64) -> Expression {
    let mut random = Random(seed);
    let mut pick = |n: usize| (random.next() % n as u64) as usize;
    let mut ops = vec![Op::Field(0), Op::Field(1), Op::Field(2), Op::Number(0.0)];
    while ops.len() < OPS {
        let of = |kind: Kind| -> Vec<u8> {
            let all = ops.iter().enumerate();
            all.filter(|(_, op)| op.kind() == kind)
                .map(|(at, _)| at as u8)
                .collect()
        };
        let (numbers, conditions) = (of(Kind::Number), of(Kind::Condition));
        // Rather what was made last.
        let mut number = || numbers[numbers.len() - 1 - pick(numbers.len()).min(pick(numbers.len()))];
        let (x, y) = (number(), number());
        let op = match pick(10) {
            0 => Op::Number(pick(2000) as f32 / 100.0 - 10.0),
            1..=3 => Op::Unary(Unary::ALL[pick(Unary::ALL.len())], x),
            4 => Op::Compare(Comparison::ALL[pick(Comparison::ALL.len())], x, y),
            5 if !conditions.is_empty() => Op::Not(conditions[pick(conditions.len())]),
            6 if conditions.len() > 1 => Op::And(conditions[0], conditions[1]),
            7 if conditions.len() > 1 => Op::Or(conditions[0], conditions[1]),
            5..=7 if !conditions.is_empty() => Op::Select(conditions[pick(conditions.len())], x, y),
            _ => Op::Binary(Binary::ALL[pick(Binary::ALL.len())], x, y),
        };
        ops.push(op);
    }
    ops.push(Op::Binary(
        Binary::Add,
        0,
        (0..OPS as u8)
            .rfind(|&at| ops[usize::from(at)].kind() == Kind::Number)
            .expect("a number"),
    ));
    Expression::new(ops).expect("an expression")
}

/// Compares the values at every sample; returns how many were compared of how many. `seed`: of what functions are off by.
fn check(engine: &Engine, expression: &Expression, of: &[Loaded; 3], seed: u64) -> Result<[usize; 2], TestCaseError> {
    let volumes = of.each_ref().map(|loaded| &loaded.volume);
    let computed = engine.evaluate(expression, &volumes, &Never).expect("evaluate");
    let planes = computed.grid().dims[2];
    let Samples::F32(device) = engine.download(&computed, 0..planes).expect("download") else {
        panic!("of f32");
    };
    let mut random = Random(seed);
    let mut compared = 0;
    let (step, mut looked_at) = (device.len() / MAX_SAMPLES + 1, 0);
    for (i, &found) in device.iter().enumerate().step_by(step) {
        looked_at += 1;
        let at = of.each_ref().map(|loaded| loaded.field.values[i]);
        let exact = expression::value(expression, &at, &mut |value, _| value);
        let (mut low, mut high, mut is_steady) = (exact, exact, true);
        for _ in 0..6 {
            let off = |value: f32, ulps: f32| value * (1.0 + ulps * [-1.0, 0.0, 1.0][(random.next() % 3) as usize]);
            let value = expression::value(expression, &at, &mut { off });
            is_steady &= value.is_nan() == exact.is_nan();
            (low, high) = (low.min(value), high.max(value));
        }
        // A comparison, or the edge of a function's range, that rounding decides.
        if !is_steady {
            continue;
        }
        let slack = 4.0 * (high - low) + 1e-6 * exact.abs() + 1e-36;
        for (who, value) in [("device", found), ("host", expression.value(&at))] {
            prop_assert!(
                value.is_nan() && exact.is_nan() || (value - exact).abs() <= slack,
                "{} has {} at {:?}, expected {} of {:?}",
                who,
                value,
                at,
                exact,
                expression
            );
        }
        compared += usize::from(!exact.is_nan());
    }
    Ok([compared, looked_at])
}

#[test]
fn random_expressions_have_the_twins_values() {
    let Some(engine) = device() else { return };
    let total = std::cell::Cell::new([0, 0]);
    proptest!(config(12), |(recipe in any_recipe(), seed in any::<u64>())| {
        let of = fields(&engine, &recipe);
        let [compared, all] = check(&engine, &random_expression(seed), &of, seed)?;
        total.set([total.get()[0] + compared, total.get()[1] + all]);
    });
    let [compared, all] = total.get();
    assert!(
        compared > all / 10,
        "{compared} of {all} samples have a value that was compared"
    );
}

#[test]
fn every_function_has_the_twins_values() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        missing: true,
        ..Recipe::plain([37, 11, 9], super::recipes::Pattern::Waves(7), 5)
    };
    let of = fields(&engine, &recipe);
    let of_one = Unary::ALL.iter().map(|&function| vec![Op::Unary(function, 0)]);
    let of_two = Binary::ALL.iter().map(|&function| vec![Op::Binary(function, 0, 1)]);
    let compared = Comparison::ALL.iter().map(|&comparison| {
        let or_not = [Op::Compare(comparison, 0, 1), Op::Compare(comparison, 1, 2), Op::Not(4)];
        [&or_not[..], &[Op::And(3, 4), Op::Or(5, 6), Op::Select(7, 0, 2)]].concat()
    });
    for ops in of_one.chain(of_two).chain(compared) {
        let ops = [&[Op::Field(0), Op::Field(1), Op::Field(2)], &ops[..]].concat();
        let expression = Expression::new(ops).expect("an expression");
        let [compared, all] = check(&engine, &expression, &of, 3).expect("the same values");
        assert!(compared > all / 5, "{compared} of {all} samples of {expression:?}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let Some(engine) = device() else { return };
    let recipe = |dims| Recipe::plain(dims, super::recipes::Pattern::Waves(7), 5);
    let (a, b) = (load(&engine, &recipe([5, 6, 7])), load(&engine, &recipe([5, 6, 8])));
    let sum = Expression::new(vec![Op::Field(0), Op::Field(1), Op::Binary(Binary::Add, 0, 1)]).expect("an expression");
    for fields in [&[&a.volume][..], &[&a.volume, &b.volume], &[]] {
        assert!(engine.evaluate(&sum, fields, &Never).is_err());
    }
}

/// How many expressions that differ in numbers alone; a fiftieth of it is how many have shapes of their own. `ISOPEEL_EXPRESSIONS` sets another
/// number, as `make fuzz` does.
const EXPRESSIONS: u64 = 2000;

/// One program serves all: the process maps no more files, and holds no more memory, however many there were.
#[test]
#[cfg(target_os = "linux")]
fn many_expressions_leave_nothing_behind() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([37, 11, 9], super::recipes::Pattern::Waves(7), 5);
    let of = fields(&engine, &recipe);
    let volumes = of.each_ref().map(|loaded| &loaded.volume);
    let evaluate = |expression: &Expression| drop(engine.evaluate(expression, &volumes, &Never).expect("evaluate"));
    let held = || {
        let read = |name: &str| std::fs::read_to_string(format!("/proc/self/{name}")).expect("proc");
        let pages = read("statm")
            .split_whitespace()
            .nth(1)
            .and_then(|n| n.parse::<u64>().ok());
        (read("maps").lines().count(), pages.expect("a number") * 4096)
    };
    let count = std::env::var("ISOPEEL_EXPRESSIONS").ok().and_then(|n| n.parse().ok());
    let count = count.unwrap_or(EXPRESSIONS);
    // What the first ones compile and allocate stays.
    (0..20).for_each(|seed| evaluate(&random_expression(seed)));
    let (maps, bytes) = held();
    for seed in 0..count / 50 {
        evaluate(&random_expression(seed));
    }
    for n in 0..count {
        let ops = vec![Op::Field(0), Op::Number(n as f32), Op::Binary(Binary::Multiply, 0, 1)];
        evaluate(&Expression::new(ops).expect("an expression"));
    }
    let (maps_after, bytes_after) = held();
    println!("{count} expressions: {maps} mappings became {maps_after}, {bytes} bytes {bytes_after}");
    assert!(maps_after < maps + 50, "{maps} mappings became {maps_after}");
    assert!(bytes_after < bytes + 100_000_000, "{bytes} bytes became {bytes_after}");
}
