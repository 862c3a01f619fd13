// Polygons of a cut (algorithm, section 6): which leaves stand around an edge, and how a region names those of others.
#ifndef ISOPEEL_POLYGON_H
#define ISOPEEL_POLYGON_H

#define SHELL_CELLS 6536 // 34^3 - 32^3
#define SHELL_WORDS 817  // four sheets a cell, 32 bits a word
#define ON_BORDER 0x80000000u // beside a corner's slot: it is a border vertex

// A cut; for polygons also the 27 bricks around each brick, and which of its cells are leaves themselves.
#define CUT_PARAMS                                                                                                     \
    __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,                  \
        __global const Node *nodes, __global const uchar *state
#define POLYGON_PARAMS CUT_PARAMS, __global const uint *near, __global const Fine *fine
#define POLYGON_ARGS region_index, regions, bricks, nodes, state, near, fine

// Which cells of a brick are leaves: its level-1 cubes, 64 bits, and whether that is all.
typedef struct {
    uint ones[2], all;
} Fine;

typedef struct {
    uint slot[4];   // the leaves' slots in the order around the edge, each once
    uint region[4]; // their compact regions
    uint faces[4];  // of a border vertex the volume's faces, bit 2 axis + side
    uint count;     // 0: no polygon; 3 or 4
} Polygon;

inline uint shell_cell(int3 p) {
    if (p.z < 0) return (uint)((p.y + 1) * 34 + p.x + 1);
    if (p.z > 31) return (uint)(34 * 34 + (p.y + 1) * 34 + p.x + 1);
    const uint ring = 2 * 34 * 34 + 132 * (uint)p.z;
    if (p.y < 0) return ring + (uint)(p.x + 1);
    if (p.y > 31) return ring + 34 + (uint)(p.x + 1);
    return ring + 68 + 2 * (uint)p.y + (p.x > 31);
}

// Slot of the sheet of an active cell to which one of its edges belongs.
inline uint sheet_slot(__global const Region *region, __global const Brick *bricks, __global const Node *nodes, uint slot,
                       uint edge) {
    const uint b = code_cell(meta_code(nodes[slot].meta), 0) >> 9;
    return sheet_in_brick(region, bricks + region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], b), nodes,
                          slot, edge);
}

// The bricks around a brick: x + 3 y + 9 z, itself at 13. `low`: its first cell in the volume.
inline uint near_brick(__global const uint *near, int3 low, int3 cell) {
    const int3 d = (cell - low + 8) >> 3;
    return near[d.x + 3 * d.y + 9 * d.z];
}

inline bool is_cell_active(__global const Brick *brick, uint cell) { return brick->cells[cell >> 5] >> (cell & 31) & 1u; }

// As find_slot, in a brick at hand.
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

// The polygon around an edge of a leaf, if this leaf is the one to emit it: the first of the finest around the edge.
// `low`: the leaf's low corner in the volume; of leaves up to level 3 `near` are the bricks around that at `brick_low`.
inline Polygon edge_polygon(Grid grid, POLYGON_PARAMS, int3 brick_low, uint own_region, uint own_slot, uint level,
                            int3 low, uint edge) {
    Polygon polygon;
    polygon.count = 0;
    const uint axis = edge >> 2, own = edge & 3, size = 1u << level;
    const uint b = (axis + 1) % 3, c = (axis + 2) % 3;
    const int3 at = low + edge_offset(edge) * (int)size;
    // Cubes on one side of the edge may lie beyond a face.
    const int at_b = b == 0 ? at.x : b == 1 ? at.y : at.z, at_c = c == 0 ? at.x : c == 1 ? at.y : at.z;
    const uint beyond_b = at_b == 0 ? 2u : at_b + 1 >= (int)grid.dims[b] ? 1u : 0u; // k & 1 of these cubes, plus 1
    const uint beyond_c = at_c == 0 ? 2u : at_c + 1 >= (int)grid.dims[c] ? 1u : 0u;
    uint slots[4], in_regions[4], faces[4];
    for (uint k = 0; k < 4; k++) {
        const uint out_b = beyond_b == (k & 1) + 1, out_c = beyond_c == (k >> 1) + 1;
        faces[k] = (out_b ? 1u << (2 * b + (beyond_b == 1)) : 0) | (out_c ? 1u << (2 * c + (beyond_c == 1)) : 0);
        if (faces[k]) continue;
        if (k == own) {
            in_regions[k] = own_region;
            slots[k] = level == 0 ? sheet_in_brick(regions + own_region, bricks + near[13], nodes, own_slot, edge) : own_slot;
            continue;
        }
        const int3 cube = at - (axis_step(b) * (int)(k & 1) + axis_step(c) * (int)(k >> 1)) * (int)size;
        const uint cell = morton(convert_uint3(cube) & 31u);
        uint brick = NONE;
        if (level < 4) {
            brick = near_brick(near, brick_low, cube);
            if (brick == NONE) return polygon; // samples are missing: an open border
            if (level == 0) {
                if (!is_cell_active(bricks + brick, cell & 511)) return polygon;
                if (k < own && bit64(fine[brick].ones[0], fine[brick].ones[1], cell >> 3 & 63)) return polygon;
            }
            in_regions[k] = bricks[brick].region;
            slots[k] = find_in_brick(regions + in_regions[k], bricks, brick, level, cell);
        } else slots[k] = find_slot_at(grid, region_index, regions, bricks, level, cube, &in_regions[k]);
        if (slots[k] == NONE) return polygon;
        const uint covers = state[slots[k]];
        if (covers == INTERNAL || (covers == level && k < own)) return polygon;
        if (covers > level) slots[k] = find_slot(regions + in_regions[k], bricks, covers, cell);
        else if (level == 0)
            slots[k] = sheet_in_brick(regions + in_regions[k], bricks + brick, nodes, slots[k], 4 * axis + k);
    }
    // Beyond a face stands the mirror image, across b, then across c.
    if (beyond_b | beyond_c) {
        for (uint k = 0; k < 4; k += 2) {
            if (beyond_b == 1) { slots[k] = slots[k + 1]; in_regions[k] = in_regions[k + 1]; }
            if (beyond_b == 2) { slots[k + 1] = slots[k]; in_regions[k + 1] = in_regions[k]; }
        }
        for (uint k = 0; k < 2; k++) {
            if (beyond_c == 1) { slots[k] = slots[k + 2]; in_regions[k] = in_regions[k + 2]; }
            if (beyond_c == 2) { slots[k + 2] = slots[k]; in_regions[k + 2] = in_regions[k]; }
        }
    }
    // Once around the edge: 0 1 3 2. A coarser leaf may stand at two neighbouring places, of which one is left out.
#define SAME(i, j) (slots[i] == slots[j] && faces[i] == faces[j])
    const bool without_first = SAME(0, 1), without_second = without_first || SAME(1, 3);
    const bool without_last = SAME(3, 2) || SAME(2, 0);
#undef SAME
#define TAKE(place, k)                                                                                                 \
    polygon.slot[place] = slots[k];                                                                                    \
    polygon.region[place] = in_regions[k];                                                                             \
    polygon.faces[place] = faces[k];
    TAKE(0, 0)
    if (without_first) { TAKE(1, 3) } else { TAKE(1, 1) }
    if (without_second) { TAKE(2, 2) } else { TAKE(2, 3) }
    TAKE(3, 2)
#undef TAKE
    polygon.count = without_second || without_last ? 3 : 4;
    return polygon;
}

// The same between cells that all are leaves, around the edge along `axis` from a cell's low corner.
inline Polygon plain_polygon(__global const Region *regions, __global const Brick *bricks, __global const Node *nodes,
                             __global const uint *near, int3 brick_low, uint own_slot, int3 low, uint axis) {
    Polygon polygon;
    polygon.count = 4;
    const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
    for (uint i = 0; i < 4; i++) {
        const uint k = i ^ i >> 1;
        const int3 at = low - b * (int)(k & 1) - c * (int)(k >> 1);
        const uint brick = k == 0 ? near[13] : near_brick(near, brick_low, at);
        const uint in = bricks[brick].region;
        const uint slot = k == 0 ? own_slot
            : find_in_brick(regions + in, bricks, brick, 0, morton(convert_uint3(at) & 7u));
        polygon.region[i] = in;
        polygon.faces[i] = 0;
        polygon.slot[i] = sheet_in_brick(regions + in, bricks + brick, nodes, slot, 4 * axis + k);
    }
    return polygon;
}

// Bit that names a ghost, or a border vertex at `faces`, of the region at `origin`.
inline uint ghost_bit(Grid grid, __global const Region *regions, __global const Node *nodes, int3 origin, uint region,
                      uint slot, uint faces) {
    const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code);
    int3 low = convert_int3(region_origin(grid, regions[region].region) + unmorton(code_cell(code, level))) - origin;
    low = max(low, (int3)(-1));
    if (faces) {
        low.x = faces & 1u ? -1 : faces & 2u ? 32 : low.x;
        low.y = faces & 4u ? -1 : faces & 8u ? 32 : low.y;
        low.z = faces & 16u ? -1 : faces & 32u ? 32 : low.z;
    }
    const bool extra = slot - regions[region].slot_base >= regions[region].level_base[6];
    return 4 * shell_cell(low) + (extra ? meta_extras(meta) : 0);
}

#endif
