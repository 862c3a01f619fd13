// Polygons of a cut (algorithm, section 6): which leaves stand around an edge, and how a region names those of others.
#ifndef ISOPEEL_POLYGON_H
#define ISOPEEL_POLYGON_H

#include "lib/bits.h"
#include "lib/cells.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/sheets.h"
#include "lib/slots.h"

#define ON_BORDER 0x80000000u // beside a corner's slot: it is a border vertex

#define CUT_PARAMS                                                                                                     \
    __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,                  \
        __global const Node *nodes, __global const uchar *state
// A cut, and the 27 bricks around each brick.
#define POLYGON_PARAMS CUT_PARAMS, __global const uint *near
#define POLYGON_ARGS region_index, regions, bricks, nodes, state, near

// What stands at the level-1 cubes in a brick and one beyond on every side, by x + 6 y + 36 z from the one before its first.
#define HALO_CUBES 216
#define HALO_EMPTY 7u // no active cell there
#define HALO_EXTRA_SHEETS 16u
typedef struct {
    uint slot[HALO_CUBES]; // of the leaf that stands there; of the first active cell where these are leaves themselves
    // The leaf's level, or HALO_EMPTY; of cells, level 0, also which are active, from bit 8 on, and HALO_EXTRA_SHEETS where some cells of their
    // brick have several sheets.
    ushort what[HALO_CUBES];
} LeafHalo;

typedef struct {
    uint slot[4];   // the leaves' slots in the order around the edge, each once
    uint region[4]; // their compact regions
    uint faces[4];  // of a border vertex the volume's faces, bit 2 axis + side
    uint count;     // 0: no polygon; 3 or 4
} Polygon;

inline uint halo_cell(int3 p) {
    if (p.z < 0) return (uint)((p.y + 1) * 34 + p.x + 1);
    if (p.z > 31) return (uint)(34 * 34 + (p.y + 1) * 34 + p.x + 1);
    const uint ring = 2 * 34 * 34 + 132 * (uint)p.z;
    if (p.y < 0) return ring + (uint)(p.x + 1);
    if (p.y > 31) return ring + 34 + (uint)(p.x + 1);
    return ring + 68 + 2 * (uint)p.y + (p.x > 31);
}

// The bricks around a brick: x + 3 y + 9 z, itself at 13. `low`: its first cell in the volume.
inline uint near_brick(__global const uint *near, int3 low, int3 cell) {
    const int3 d = (cell - low + 8) >> 3;
    return near[d.x + 3 * d.y + 9 * d.z];
}

// Puts an active level-1 cube of a brick into the halo, at place `to`; `own`: its slot.
INLINED void set_halo_cube(__local LeafHalo *halo, uint to, __global const Region *regions, __global const Brick *bricks,
                      __global const uchar *state, uint index, uint one, uint own) {
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const uint level = state[own];
    if (level == INTERNAL) {
        halo->what[to] = (ushort)((brick->extra_sheets ? HALO_EXTRA_SHEETS : 0) | level1_cells(brick, one) << 8);
        halo->slot[to] = region->slot_base + brick->level_base[0] + cells_before_level1(brick, one);
        return;
    }
    halo->what[to] = (ushort)level;
    halo->slot[to] = level == 1 ? own
        : level < 4 ? find_in_brick(region, bricks, index, level, one << 3)
                    : find_slot(region, bricks, level, brick->morton << 9);
}

// By how much each of half a brick's 32 cubes lies behind its first, in x + 6 y + 36 z.
__constant uchar CUBE_IN_HALO[32] = {
    0,  1,  6,  7,  36, 37, 42, 43, 2,  3,  8,  9,  38, 39, 44, 45,
    12, 13, 18, 19, 48, 49, 54, 55, 14, 15, 20, 21, 50, 51, 56, 57,
};

// Fills the halo of a brick, if `wanted`. To be called by all work-items. One alone goes from active cube to active cube,
// many take a place of the halo each.
inline void find_halo(__local LeafHalo *halo, __global const Region *regions, __global const Brick *bricks,
                      __global const uchar *state, __global const uint *near, bool wanted) {
#if BRICK_GROUP == 1
    for (uint i = 0; wanted && i < HALO_CUBES; i++) halo->what[i] = HALO_EMPTY;
    for (uint i = 0; wanted && i < 27; i++) {
        const uint index = near[i], x = i % 3, y = i / 3 % 3, z = i / 9;
        if (index == NONE) continue;
        __global const Brick *brick = bricks + index;
        // Of the bricks before this one the last cubes, of those behind it the first.
        const uint within = (x == 0 ? LAST_X : x == 2 ? FIRST_X : ~0u) & (y == 0 ? LAST_Y : y == 2 ? FIRST_Y : ~0u)
            & (z == 0 ? LAST_Z : z == 2 ? FIRST_Z : ~0u);
        uint first = regions[brick->region].slot_base + brick->level_base[1];
        const uint corner = 4 * (x + 6 * y + 36 * z) - 3 * (1 + 6 + 36);
        for (uint side = 0; side < 2; side++) {
            const uint ones = brick->level1_mask[side];
            for (uint rest = z == 2 * side ? 0 : ones & within; rest; rest &= rest - 1) {
                const uint bit = lowest_bit(rest), one = side << 5 | bit, own = first + popcount(ones & ((1u << bit) - 1));
                set_halo_cube(halo, corner + CUBE_IN_HALO[bit] + 72 * side, regions, bricks, state, index, one, own);
            }
            first += popcount(ones);
        }
    }
#else
    for (uint i = get_local_id(0); wanted && i < HALO_CUBES; i += BRICK_GROUP) {
        // From the low corner of the first brick, in cubes.
        const uint3 at = (uint3)(i % 6, i / 6 % 6, i / 36) + 3, of = at >> 2;
        const uint index = near[of.x + 3 * of.y + 9 * of.z], one = morton(at & 3);
        const uint own = index == NONE ? NONE : find_in_brick(regions + bricks[index].region, bricks, index, 1, one << 3);
        if (own == NONE) halo->what[i] = HALO_EMPTY;
        else set_halo_cube(halo, i, regions, bricks, state, index, one, own);
    }
#endif
    barrier(CLK_LOCAL_MEM_FENCE);
}

// The four cubes of the halo that touch an edge's low end. `at`: that end, in cells from the brick's low corner.
typedef struct {
    int b, c; // the end across the edge
    uint first, step; // the cube along it, and the way to the next one
    uint step_b, step_c;
} Around;

#define ALONG(v, axis) ((axis) == 0 ? (v).x : (axis) == 1 ? (v).y : (v).z)
inline Around around_edge(int3 at, uint axis) {
    Around around;
    around.b = axis == 0 ? at.y : axis == 1 ? at.z : at.x;
    around.c = axis == 0 ? at.z : axis == 1 ? at.x : at.y;
    around.step = axis == 0 ? 1 : axis == 1 ? 6 : 36;
    around.step_b = axis == 0 ? 6 : axis == 1 ? 36 : 1;
    around.step_c = axis == 0 ? 36 : axis == 1 ? 1 : 6;
    around.first = (uint)(ALONG(at, axis) + 2) / 2 * around.step;
    return around;
}
inline uint cube_around(Around around, uint k) {
    return around.first + (uint)(around.b + 2 - (int)(k & 1)) / 2 * around.step_b
        + (uint)(around.c + 2 - (int)(k >> 1)) / 2 * around.step_c;
}

// Edges of a cube that touch the next ones, those before it, and those between two of both.
#define EDGES_HIGH_X (1u << 6 | 1u << 7 | 1u << 9 | 1u << 11)
#define EDGES_HIGH_Y (1u << 1 | 1u << 3 | 1u << 10 | 1u << 11)
#define EDGES_HIGH_Z (1u << 2 | 1u << 3 | 1u << 5 | 1u << 7)
#define EDGES_LOW_X (1u << 4 | 1u << 5 | 1u << 8 | 1u << 10)
#define EDGES_LOW_Y (1u << 0 | 1u << 2 | 1u << 8 | 1u << 9)
#define EDGES_LOW_Z (1u << 0 | 1u << 1 | 1u << 4 | 1u << 6)

// Edges of a leaf of level 0 or 1 that other leaves emit: finer ones, or of its own level those earlier around the edge. `cell`:
// its low corner from the brick's.
inline uint edges_of_neighbours(__local const LeafHalo *halo, uint level, uint3 cell) {
    const uint i = cell.x / 2 + 1 + 6 * (cell.y / 2 + 1) + 36 * (cell.z / 2 + 1);
    uint taken = 0;
    if (level == 0) {
        const uint x = cell.x & 1, y = cell.y & 1, z = cell.z & 1, here = x | y << 1 | z << 2;
        // Is the neighbour a leaf? A step along an axis leads into the next cube, or stays in this one.
#define TAKE_CELL(step, flip, edges) if (halo->what[i + (step)] >> (8 + (here ^ (flip))) & 1u) taken |= edges;
        TAKE_CELL(x, 1, EDGES_HIGH_X)
        TAKE_CELL(6 * y, 2, EDGES_HIGH_Y)
        TAKE_CELL(36 * z, 4, EDGES_HIGH_Z)
        TAKE_CELL(x + 6 * y, 3, 1u << 11)
        TAKE_CELL(6 * y + 36 * z, 6, 1u << 3)
        TAKE_CELL(x + 36 * z, 5, 1u << 7)
        TAKE_CELL(6 * y - 6 + 36 * z, 6, 1u << 2)
        TAKE_CELL(36 * z - 36 + x, 5, 1u << 6)
        TAKE_CELL(x - 1 + 6 * y, 3, 1u << 10)
#undef TAKE_CELL
        return taken;
    }
#define TAKE_CUBE(step, finer, same)                                                                                   \
    {                                                                                                                  \
        const uint covers = halo->what[i + (step)] & 7u;                                                               \
        taken |= covers == 0 ? (finer) : covers == 1 ? (same) : 0u;                                                    \
    }
    TAKE_CUBE(1, EDGES_HIGH_X, EDGES_HIGH_X)
    TAKE_CUBE(6, EDGES_HIGH_Y, EDGES_HIGH_Y)
    TAKE_CUBE(36, EDGES_HIGH_Z, EDGES_HIGH_Z)
    TAKE_CUBE(-1, EDGES_LOW_X, 0u)
    TAKE_CUBE(-6, EDGES_LOW_Y, 0u)
    TAKE_CUBE(-36, EDGES_LOW_Z, 0u)
    TAKE_CUBE(1 + 6, 1u << 11, 1u << 11)
    TAKE_CUBE(6 + 36, 1u << 3, 1u << 3)
    TAKE_CUBE(36 + 1, 1u << 7, 1u << 7)
    TAKE_CUBE(-1 + 6, 1u << 10, 1u << 10)
    TAKE_CUBE(-6 + 36, 1u << 2, 1u << 2)
    TAKE_CUBE(-36 + 1, 1u << 6, 1u << 6)
    TAKE_CUBE(1 - 6, 1u << 9, 0u)
    TAKE_CUBE(6 - 36, 1u << 1, 0u)
    TAKE_CUBE(36 - 1, 1u << 5, 0u)
    TAKE_CUBE(-1 - 6, 1u << 8, 0u)
    TAKE_CUBE(-6 - 36, 1u << 0, 0u)
    TAKE_CUBE(-36 - 1, 1u << 4, 0u)
#undef TAKE_CUBE
    return taken;
}

// The polygon around an edge of a leaf, if this leaf is the one to emit it: the first of the finest around the edge.
// `low`: the leaf's low corner in the volume; of leaves up to level 3 `halo` is around their brick at `brick_low`.
INLINED Polygon edge_polygon(Grid grid, POLYGON_PARAMS, __local const LeafHalo *halo, int3 brick_low, uint own_region, uint own_slot,
                             uint level, int3 low, uint edge) {
    Polygon polygon;
    polygon.count = 0;
    const uint axis = edge >> 2, own = edge & 3, size = 1u << level;
    const uint b = (axis + 1) % 3, c = (axis + 2) % 3;
    const int3 at = low + edge_offset(edge) * (int)size;
    // Cubes on one side of the edge may lie beyond a face.
    const int at_b = ALONG(at, b), at_c = ALONG(at, c);
    const uint beyond_b = at_b == 0 ? 2u : at_b + 1 >= (int)grid.dims[b] ? 1u : 0u; // k & 1 of these cubes, plus 1
    const uint beyond_c = at_c == 0 ? 2u : at_c + 1 >= (int)grid.dims[c] ? 1u : 0u;
    // A cube may end beyond the volume's last sample; its corner is that one.
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    const int3 end = min(at, last);
    const Around around = around_edge(end - brick_low, axis);
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
        if (level < 4) {
            // The cell beside the edge's low end, from the brick's low corner, -1 to 8.
            const int cell_b = around.b - (int)(k & 1), cell_c = around.c - (int)(k >> 1);
            uint i = cube_around(around, k);
            // Somewhere beside a crossed edge a cell is active, unless samples are missing: then the surface has an open border.
            for (uint along = 2; along < size && halo->what[i] == HALO_EMPTY; along += 2) i += around.step;
            const uint what = halo->what[i], covers = what & 7u;
            if (what == HALO_EMPTY || covers < level || (covers == level && k < own)) return polygon;
            slots[k] = halo->slot[i];
            const uint brick = near_brick(near, brick_low, end - axis_step(b) * (int)(k & 1) - axis_step(c) * (int)(k >> 1));
            in_regions[k] = bricks[brick].region;
            if (covers == 0) {
                const uint bit = ((uint)ALONG(at, axis) & 1u) << axis | ((uint)cell_b & 1u) << b | ((uint)cell_c & 1u) << c, cells = what >> 8;
                if (!(cells >> bit & 1u)) return polygon;
                slots[k] += popcount(cells & ((1u << bit) - 1));
                if (what & HALO_EXTRA_SHEETS)
                    slots[k] = sheet_in_brick(regions + in_regions[k], bricks + brick, nodes, slots[k], 4 * axis + k);
            }
        } else {
            const int3 cube = at - (axis_step(b) * (int)(k & 1) + axis_step(c) * (int)(k >> 1)) * (int)size;
            slots[k] = find_slot_at(grid, region_index, regions, bricks, level, cube, &in_regions[k]);
            if (slots[k] == NONE) return polygon;
            const uint covers = state[slots[k]];
            if (covers == INTERNAL || (covers == level && k < own)) return polygon;
            if (covers > level)
                slots[k] = find_slot(regions + in_regions[k], bricks, covers, morton(convert_uint3(cube) & 31u));
        }
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
    // Once around the edge: 0 1 3 2. A coarser leaf may cover two neighbouring positions around the edge; it is taken once.
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

// Triangles of the polygon that a leaf of level 0 or 1 emits around an edge inside its region, where no samples are missing.
// Marks leaves above the cells around it as used; cells know by themselves. `in_region`, `in_brick`: the leaf's low corner.
inline uint count_inner_polygon(__local const LeafHalo *halo, uint level, int3 in_region, int3 in_brick, uint edge, __global uchar *used) {
    const int3 offset = edge_offset(edge) << (int)level;
    const Around around = around_edge(in_brick + offset, edge >> 2);
    const Around whole = around_edge(in_region + offset, edge >> 2);
    uint triangles = 2;
    for (uint k = 0; k < 4; k++) {
        if (k == (edge & 3)) continue;
        const uint i = cube_around(around, k), covers = halo->what[i] & 7u;
        if (covers == 0) continue;
        used[halo->slot[i]] = 1;
        // It covers two of the four positions, unless the edge lies on its border.
        if (covers > level && (whole.b | whole.c) & (int)((1u << covers) - 1)) triangles = 1;
    }
    return triangles;
}

// The edges of a leaf of levels 0 to 3 that lie on the boundary of its region or the volume's.
inline uint boundary_edges(Grid grid, int3 origin, int3 in_region, uint level) {
    const int3 high = in_region + (1 << level);
    const int3 end = min((int3)(32), (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1 - origin);
    return (in_region.x == 0 ? EDGES_LOW_X : 0) | (in_region.y == 0 ? EDGES_LOW_Y : 0) | (in_region.z == 0 ? EDGES_LOW_Z : 0)
        | (high.x >= end.x ? EDGES_HIGH_X : 0) | (high.y >= end.y ? EDGES_HIGH_Y : 0) | (high.z >= end.z ? EDGES_HIGH_Z : 0);
}

// Bit that names a ghost, or a border vertex at `faces`, of the region at `origin`.
INLINED uint ghost_bit(Grid grid, __global const Region *regions, __global const Node *nodes, int3 origin, uint region, uint slot,
                       uint faces) {
    const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code);
    int3 low = convert_int3(region_origin(grid, regions[region].region) + unmorton(code_cell(code, level))) - origin;
    low = max(low, (int3)(-1));
    if (faces) {
        low.x = faces & 1u ? -1 : faces & 2u ? 32 : low.x;
        low.y = faces & 4u ? -1 : faces & 8u ? 32 : low.y;
        low.z = faces & 16u ? -1 : faces & 32u ? 32 : low.z;
    }
    const bool extra = slot - regions[region].slot_base >= regions[region].level_base[6];
    return 4 * halo_cell(low) + (extra ? meta_extras(meta) : 0);
}

#undef ALONG
#endif
