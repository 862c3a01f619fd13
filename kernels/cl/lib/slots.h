// From cells and cubes to the slots of their nodes.
#ifndef ISOPEEL_SLOTS_H
#define ISOPEEL_SLOTS_H

#include "lib/bits.h"
#include "lib/layout.h"
#include "lib/morton.h"

// Number of active bricks of a region, of active level-1 cubes and of active cells of a brick.
inline uint count_bricks(__global const Region *region) {
    return popcount(region->brick_mask[0]) + popcount(region->brick_mask[1]);
}
inline uint count_level1(__global const Brick *brick) { return popcount(brick->level1_mask[0]) + popcount(brick->level1_mask[1]); }
inline uint count_cells(__global const Brick *brick) { return brick->cells_before[15] + popcount(brick->cells[15]); }

// Active cells of a level-1 cube, one bit each, and how many come before it.
inline uint level1_cells(__global const Brick *brick, uint one) { return brick->cells[one >> 2] >> (8 * (one & 3)) & 0xffu; }
inline uint cells_before_level1(__global const Brick *brick, uint one) {
    return brick->cells_before[one >> 2] + popcount(brick->cells[one >> 2] & ((1u << (8 * (one & 3))) - 1));
}

// Slot of the level-4 node that holds cell `cell`, relative to its level; NONE if there is none.
inline uint rank_level4(uint2 bricks, uint cell) {
    const uint level4_mask = nonzero_bytes(bricks.x) | nonzero_bytes(bricks.y) << 4;
    const uint i = cell >> 12;
    return level4_mask >> i & 1u ? (uint)popcount(level4_mask & ((1u << i) - 1)) : NONE;
}

// Slot of the node of `level`, 0 to 3, that holds cell `cell` of an active brick; NONE if there is none.
inline uint find_in_brick(__global const Region *region, __global const Brick *bricks, uint index, uint level, uint cell) {
    __global const Brick *brick = bricks + index;
    const uint i = (cell & 511) >> (3 * level);
    if (level == 0) {
        const uint word = brick->cells[i >> 5], bit = 1u << (i & 31);
        return word & bit
            ? region->slot_base + brick->level_base[0] + brick->cells_before[i >> 5] + popcount(word & (bit - 1)) : NONE;
    }
    if (level == 1)
        return test_bit64(brick->level1_mask[0], brick->level1_mask[1], i)
            ? region->slot_base + brick->level_base[1] + rank64(brick->level1_mask[0], brick->level1_mask[1], i) : NONE;
    if (level == 2)
        return brick->level2_mask >> i & 1u
            ? region->slot_base + brick->level_base[2] + popcount(brick->level2_mask & ((1u << i) - 1)) : NONE;
    return region->slot_base + region->level_base[3] + index - region->brick_base;
}

// Slot of the node of any level that holds cell `cell` of an active region; NONE if there is none.
inline uint find_slot(__global const Region *region, __global const Brick *bricks, uint level, uint cell) {
    if (level == 5) return region->slot_base + region->level_base[5];
    const uint2 mask = (uint2)(region->brick_mask[0], region->brick_mask[1]);
    if (level == 4) {
        const uint rank = rank_level4(mask, cell);
        return rank == NONE ? NONE : region->slot_base + region->level_base[4] + rank;
    }
    const uint b = cell >> 9;
    if (!test_bit64(mask.x, mask.y, b)) return NONE;
    return find_in_brick(region, bricks, region->brick_base + rank64(mask.x, mask.y, b), level, cell);
}

// As find_slot, from a cell's coordinates in the volume, which may lie outside. `region` receives the compact index or NONE.
inline uint find_slot_at(Grid grid, __global const uint *region_index, __global const Region *regions,
                         __global const Brick *bricks, uint level, int3 cell, uint *region) {
    *region = NONE;
    if (any(cell < 0) || cell.x >= (int)grid.dims[0] - 1 || cell.y >= (int)grid.dims[1] - 1
        || cell.z >= (int)grid.dims[2] - 1)
        return NONE;
    const uint3 c = convert_uint3(cell);
    *region = region_index[((c.z >> 5) * grid.regions[1] + (c.y >> 5)) * grid.regions[0] + (c.x >> 5)];
    if (*region == NONE) return NONE;
    return find_slot(regions + *region, bricks, level, morton(c & 31u));
}

#endif
