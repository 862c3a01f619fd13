//! Minimum and maximum of every brick, and which bricks touch a missing sample.

use super::recipes::{Pattern, any_recipe};
use super::*;
use isopeel_kernels::testing::MinmaxContents;
use isopeel_kernels::{BRICK_CELLS, REGION_CELLS};
use isopeel_reference::minmax;

fn check(engine: &Engine, loaded: &Loaded) -> Result<(), TestCaseError> {
    let grid = loaded.volume.grid();
    let MinmaxContents { ranges, missing_masks } =
        testing::read_minmax(engine, &loaded.volume).expect("read the table");
    let twin = minmax::minmax(&loaded.field);
    let bricks = minmax::bricks(&loaded.field);
    for (i, range) in ranges.iter().enumerate() {
        let (region, m) = ((i / 64) as u32, (i % 64) as u32);
        let in_region = unmorton(m);
        let at: [u32; 3] =
            std::array::from_fn(|k| region_at(grid, region)[k] * REGION_CELLS / BRICK_CELLS + in_region[k]);
        let missing = missing_masks[region as usize][(m >> 5) as usize] >> (m & 31) & 1 == 1;
        if (0..3).all(|k| at[k] < bricks[k]) {
            let want = twin[((at[2] * bricks[1] + at[1]) * bricks[0] + at[0]) as usize];
            prop_assert_eq!(
                (range[0], range[1], missing),
                (want.min, want.max, want.missing),
                "brick {:?}",
                at
            );
        } else {
            prop_assert_eq!(
                (range[0], range[1], missing),
                (f32::INFINITY, f32::NEG_INFINITY, false),
                "no brick at {:?}",
                at
            );
        }
    }
    Ok(())
}

#[test]
fn every_brick_has_the_twins_range() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in any_recipe())| check(&engine, &load(&engine, &recipe))?);
}

/// Of several launches.
#[test]
fn every_brick_of_a_large_volume_has_the_twins_range() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([230, 210, 190], Pattern::Waves(20), 3);
    check(&engine, &load(&engine, &recipe)).expect("the same ranges");
}
