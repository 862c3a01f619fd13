//! Active bricks: their cells as bits, and what is counted of them.

use super::recipes::any_recipe;
use super::*;
use isopeel_kernels::layout::Brick;
use isopeel_reference::classify::{self, Classes};
use isopeel_reference::{minmax, sheets};

/// What the kernel counts of the brick at `at`, in bricks.
fn expected(loaded: &Loaded, classes: &Classes, at: [u32; 3]) -> Brick {
    let cells = loaded.field.grid.cells();
    let mut brick = Brick::default();
    let mut before = 0;
    for cell in 0..512u32 {
        if cell % 32 == 0 {
            brick.cells_before[cell as usize / 32] = before;
        }
        let inside = unmorton(cell);
        let c: [u32; 3] = std::array::from_fn(|k| at[k] * 8 + inside[k]);
        if (0..3).any(|k| c[k] >= cells[k]) {
            continue;
        }
        if let Some(&signs) = classes.active.get(&c) {
            let sheets = sheets::cell_sheets(&loaded.field, loaded.iso, c, signs);
            brick.cells[cell as usize / 32] |= 1 << (cell % 32);
            brick.level1_mask[cell as usize / 256] |= 1 << (cell / 8 % 32);
            brick.level2_mask |= 1 << (cell / 64);
            brick.extra_sheets += u32::from(sheets.count) - 1;
            // From the low corner along x, y and z.
            brick.quad_count += [1, 2, 4].iter().filter(|&k| (signs ^ signs >> k) & 1 == 1).count() as u32;
            before += 1;
        }
        if classes.missing[((c[2] * cells[1] + c[1]) * cells[0] + c[0]) as usize] {
            brick.level1_missing[cell as usize / 256] |= 1 << (cell / 8 % 32);
        }
    }
    brick
}

fn check(host: &HostPyramid, loaded: &Loaded, pyramid: &Pyramid) -> Result<(), TestCaseError> {
    let classes = classify::classify(&loaded.field, loaded.iso);
    let ranges = minmax::minmax(&loaded.field);
    let bricks = minmax::bricks(&loaded.field);
    let is_touched = |range: &minmax::BrickRange| range.min < loaded.iso && range.max >= loaded.iso;
    let touched = ranges.iter().filter(|r| is_touched(r)).count();
    prop_assert_eq!(host.bricks.len(), touched, "active bricks");
    let mut active = 0;
    for (compact, region) in host.regions.iter().enumerate() {
        let mask = u64::from(region.brick_mask[0]) | u64::from(region.brick_mask[1]) << 32;
        for (rank, m) in (0..64u32).filter(|m| mask >> m & 1 == 1).enumerate() {
            let brick = &host.bricks[region.brick_base as usize + rank];
            let in_region = unmorton(m);
            let at: [u32; 3] = std::array::from_fn(|k| region_at(&host.grid, region.region)[k] * 4 + in_region[k]);
            prop_assert!(is_touched(
                &ranges[((at[2] * bricks[1] + at[1]) * bricks[0] + at[0]) as usize]
            ));
            prop_assert_eq!((brick.region as usize, brick.morton), (compact, m));
            let want = expected(loaded, &classes, at);
            let counted = |b: &Brick| {
                let levels = (b.cells, b.cells_before, b.level1_mask, b.level2_mask);
                (levels, b.level1_missing, b.extra_sheets, b.quad_count)
            };
            prop_assert_eq!(counted(brick), counted(&want), "brick {:?}", at);
            active += want.cells.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
        }
    }
    let expected = classes.active.len() as u64;
    prop_assert_eq!(active, expected, "no active cell lies in a brick that is not active");
    prop_assert_eq!(pyramid.active_cells(), active);
    Ok(())
}

#[test]
fn active_bricks_have_the_twins_cells() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in any_recipe())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        check(&HostPyramid::read(&engine, &pyramid), &loaded, &pyramid)?;
    });
}
