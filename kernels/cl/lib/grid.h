// Where things are: Morton codes, samples, and the way from coordinates to a node's slot.
#ifndef ISOPEEL_GRID_H
#define ISOPEEL_GRID_H

#include "lib/layout.h"

#pragma OPENCL FP_CONTRACT OFF

// A function whose call on a CPU would wait for copies of its arguments, of `grid` first of all. Compilers for a GPU inline anyway.
#if BRICK_GROUP == 1
#define INLINED inline __attribute__((always_inline))
#else
#define INLINED inline
#endif

// a / b as IEEE 754 rounds it, which some devices do not: an importance that equals the threshold must not tip over it, and a
// plane must come out flat. One step of correction; where that leaves the range of a float, the plain quotient, as on a CPU.
inline float exact_quotient(float a, float b) {
#if BRICK_GROUP == 1
    return a / b;
#endif
    const float plain = a / b, corrected = fma(fma(-plain, b, a), 1.0f / b, plain);
    return isfinite(corrected) ? corrected : plain;
}

// Five bits to every third place, and back.
inline uint spread(uint v) {
    v = (v | v << 8) & 0x100fu;
    v = (v | v << 4) & 0x10c3u;
    return (v | v << 2) & 0x1249u;
}
inline uint gather(uint v) {
    v &= 0x1249u;
    v = (v | v >> 2) & 0x10c3u;
    v = (v | v >> 4) & 0x100fu;
    return (v | v >> 8) & 0x1fu;
}
inline uint morton(uint3 p) { return spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2; }
inline uint3 unmorton(uint m) { return (uint3)(gather(m), gather(m >> 1), gather(m >> 2)); }

// A node's code holds its level and place: a one, then 15 - 3 level Morton bits.
inline uint code_level(uint code) { return (uint)(clz(code) - 16) / 3; }
inline uint node_code(uint level, uint cell) { return 1u << (15 - 3 * level) | cell >> (3 * level); }
// Morton number of the first cell below.
inline uint code_cell(uint code, uint level) { return (code ^ 1u << (15 - 3 * level)) << (3 * level); }

inline uint meta_code(uint meta) { return meta & 0xffffu; }
inline uint meta_signs(uint meta) { return meta >> 16 & 0xffu; }
inline uint meta_missing(uint meta) { return meta >> 24 & 1u; }
inline uint meta_safe(uint meta) { return meta >> 25 & 1u; }
inline uint meta_extras(uint meta) { return meta >> 26 & 3u; }

inline uint3 region_coords(Grid grid, uint region) {
    const uint rx = grid.regions[0], ry = grid.regions[1];
    return (uint3)(region % rx, region / rx % ry, region / rx / ry);
}
inline uint3 region_origin(Grid grid, uint region) { return region_coords(grid, region) * 32; }

// Of 32 numbers in Morton order, four along x and y and two along z, those that are first and last along an axis; one bit each.
#define FIRST_X 0x00550055u
#define FIRST_Y 0x00003333u
#define FIRST_Z 0x0f0f0f0fu
#define LAST_X 0xaa00aa00u
#define LAST_Y 0xcccc0000u
#define LAST_Z 0xf0f0f0f0u

// Bits below place `b` of a 64-bit mask.
inline uint rank64(uint low, uint high, uint b) {
    return b < 32 ? popcount(low & ((1u << b) - 1)) : popcount(low) + popcount(high & ((1u << (b - 32)) - 1));
}
inline bool bit64(uint low, uint high, uint b) { return (b < 32 ? low >> b : high >> (b - 32)) & 1u; }

// One bit for every byte of a word that is not zero.
inline uint nonzero_bytes(uint w) {
    return (uint)((w & 0xffu) != 0) | (uint)((w & 0xff00u) != 0) << 1 | (uint)((w & 0xff0000u) != 0) << 2
        | (uint)((w & 0xff000000u) != 0) << 3;
}

// Active bricks of a region; level-1 cubes and cells of a brick that are active.
inline uint count_bricks(__global const Region *region) {
    return popcount(region->brick_mask[0]) + popcount(region->brick_mask[1]);
}
inline uint count_ones(__global const Brick *brick) { return popcount(brick->twos[0]) + popcount(brick->twos[1]); }
inline uint count_cells(__global const Brick *brick) { return brick->prefix[15] + popcount(brick->cells[15]); }

// Active cells of a level-1 cube, one bit each, and how many come before it.
inline uint cells_of_one(__global const Brick *brick, uint one) { return brick->cells[one >> 2] >> (8 * (one & 3)) & 0xffu; }
inline uint cells_before_one(__global const Brick *brick, uint one) {
    return brick->prefix[one >> 2] + popcount(brick->cells[one >> 2] & ((1u << (8 * (one & 3))) - 1));
}

// Slot of the level-4 node that holds cell `cell`, relative to its level; NONE where there is none.
inline uint rank_level4(uint2 bricks, uint cell) {
    const uint eights = nonzero_bytes(bricks.x) | nonzero_bytes(bricks.y) << 4;
    const uint i = cell >> 12;
    return eights >> i & 1u ? (uint)popcount(eights & ((1u << i) - 1)) : NONE;
}

// Slot of the node of `level`, 0 to 3, that holds cell `cell` of an active brick; NONE where there is none.
inline uint find_in_brick(__global const Region *region, __global const Brick *bricks, uint index, uint level, uint cell) {
    __global const Brick *brick = bricks + index;
    const uint i = (cell & 511) >> (3 * level);
    if (level == 0) {
        const uint word = brick->cells[i >> 5], bit = 1u << (i & 31);
        return word & bit ? region->slot_base + brick->base[0] + brick->prefix[i >> 5] + popcount(word & (bit - 1)) : NONE;
    }
    if (level == 1)
        return bit64(brick->twos[0], brick->twos[1], i)
            ? region->slot_base + brick->base[1] + rank64(brick->twos[0], brick->twos[1], i) : NONE;
    if (level == 2)
        return brick->fours >> i & 1u ? region->slot_base + brick->base[2] + popcount(brick->fours & ((1u << i) - 1)) : NONE;
    return region->slot_base + region->level_base[3] + index - region->brick_base;
}

// The same of an active region, and of any level.
inline uint find_slot(__global const Region *region, __global const Brick *bricks, uint level, uint cell) {
    if (level == 5) return region->slot_base + region->level_base[5];
    const uint2 mask = (uint2)(region->brick_mask[0], region->brick_mask[1]);
    if (level == 4) {
        const uint rank = rank_level4(mask, cell);
        return rank == NONE ? NONE : region->slot_base + region->level_base[4] + rank;
    }
    const uint b = cell >> 9;
    if (!bit64(mask.x, mask.y, b)) return NONE;
    return find_in_brick(region, bricks, region->brick_base + rank64(mask.x, mask.y, b), level, cell);
}

// As find_slot, from a cell's place in the volume, which may lie outside.
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

inline int3 axis_step(uint axis) { return (int3)(axis == 0, axis == 1, axis == 2); }
// Offset of an edge of a unit cube from the cube's low corner: edge = 4 axis + u + 2 v.
inline int3 edge_offset(uint edge) {
    const uint axis = edge >> 2;
    return axis_step((axis + 1) % 3) * (int)(edge & 1) + axis_step((axis + 2) % 3) * (int)(edge >> 1 & 1);
}

// The corner pair of each edge, corner = dx + 2 dy + 4 dz; does it change sign?
inline uint edge_low_corner(uint edge) { return (uint)(0x321051406420ul >> 4 * edge) & 7u; }
inline bool edge_crosses(uint signs, uint edge) {
    const uint low = edge_low_corner(edge), high = low + (1u << (edge >> 2));
    return (signs >> low ^ signs >> high) & 1u;
}


#define EDGES_OWN (1u << 0 | 1u << 4 | 1u << 8) // those that begin at the cube's low corner

// The crossed edges of a cube, one bit each: where the signs of an edge's corners differ.
inline uint crossed_edges(uint signs) {
    const uint x = signs ^ signs >> 1, y = signs ^ signs >> 2, z = signs ^ signs >> 4;
    return (x & 1u) | (x >> 1 & 2u) | (x >> 2 & 4u) | (x >> 3 & 8u) | (y & 1u) << 4 | (y & 16u) << 1 | (y & 2u) << 5
        | (y & 32u) << 2 | (z & 15u) << 8;
}
// How many these are.
inline uint count_crossed(uint signs) {
    return popcount(((signs ^ signs >> 1) & 0x55u) | ((signs ^ signs >> 2) & 0x33u) << 8 | ((signs ^ signs >> 4) & 0xfu) << 16);
}

// One bit for each true lane of a comparison.
inline uint mask8(int8 lanes) {
    return (uint)((as_ulong(convert_char8(lanes)) & 0x8040201008040201ul) * 0x0101010101010101ul >> 56);
}

inline uint lowest_bit(uint mask) { return popcount((mask & -mask) - 1); }

#endif
