// The leaves in and around a brick, looked up once for all its polygons: a table in local memory of 6^3 level-1 cubes, the
// brick's own 4^3 and one more on every side. Cube x + 6 y + 36 z is counted from the one diagonally before the brick's first.
//
// What covers a cube (`cover`), and the slot beside it:
//
//   cover                                                      slot
//   HALO_EMPTY                 no active cell                  undefined
//   1 to 5                     a leaf of that level            of that leaf
//   0, and bits 8 to 15        its active cells are leaves;    of the first of these cells
//      (bit 4: HALO_EXTRA_     one bit each in Morton order
//      SHEETS)
#ifndef ISOPEEL_LEAF_HALO_H
#define ISOPEEL_LEAF_HALO_H

#include "lib/bits.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

#define HALO_CUBES 216
#define HALO_EMPTY 7u
#define HALO_EXTRA_SHEETS 16u // some cells of the brick that the cube is in have several sheets

typedef struct {
    uint slot[HALO_CUBES];
    ushort cover[HALO_CUBES];
} LeafHalo;

inline uint cover_level(uint cover) { return cover & 7u; }
inline uint cover_cells(uint cover) { return cover >> 8; }

// Enters an active level-1 cube of brick `index`. `to`: its number in the halo; `cube`: in the brick, in Morton order; `own`: slot.
INLINED void set_halo_cube(__local LeafHalo *halo, uint to, __global const Region *regions, __global const Brick *bricks,
                           __global const uchar *state, uint index, uint cube, uint own) {
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const uint level = state[own];
    if (level == INTERNAL) {
        halo->cover[to] = (ushort)((brick->extra_sheets ? HALO_EXTRA_SHEETS : 0) | level1_cells(brick, cube) << 8);
        halo->slot[to] = region->slot_base + brick->level_base[0] + cells_before_level1(brick, cube);
        return;
    }
    halo->cover[to] = (ushort)level;
    halo->slot[to] = level == 1 ? own
        : level < 4 ? find_in_brick(region, bricks, index, level, cube << 3)
                    : find_slot(region, bricks, level, brick->morton << 9);
}

// The four cubes of a halo that touch the low end of an edge.
typedef struct {
    int b, c;            // the end from the brick's low corner in cells, along the two axes across the edge
    uint first, step;    // the cube along the edge: number of the first, and how far the next one is
    uint step_b, step_c; // how far the next cubes across the edge are
} EdgeCubes;

// `at`: the edge's low end from the brick's low corner, in cells.
inline EdgeCubes edge_cubes(int3 at, uint axis) {
    EdgeCubes cubes;
    cubes.b = axis == 0 ? at.y : axis == 1 ? at.z : at.x;
    cubes.c = axis == 0 ? at.z : axis == 1 ? at.x : at.y;
    cubes.step = axis == 0 ? 1 : axis == 1 ? 6 : 36;
    cubes.step_b = axis == 0 ? 6 : axis == 1 ? 36 : 1;
    cubes.step_c = axis == 0 ? 36 : axis == 1 ? 1 : 6;
    cubes.first = (uint)(component(at, axis) + 2) / 2 * cubes.step;
    return cubes;
}

// Number of the cube at position `k` around the edge (see polygon.h).
inline uint cube_at(EdgeCubes cubes, uint k) {
    return cubes.first + (uint)(cubes.b + 2 - (int)(k & 1)) / 2 * cubes.step_b
        + (uint)(cubes.c + 2 - (int)(k >> 1)) / 2 * cubes.step_c;
}

// The edges of a cube on each of its faces, one bit each.
#define EDGES_HIGH_X (1u << 6 | 1u << 7 | 1u << 9 | 1u << 11)
#define EDGES_HIGH_Y (1u << 1 | 1u << 3 | 1u << 10 | 1u << 11)
#define EDGES_HIGH_Z (1u << 2 | 1u << 3 | 1u << 5 | 1u << 7)
#define EDGES_LOW_X (1u << 4 | 1u << 5 | 1u << 8 | 1u << 10)
#define EDGES_LOW_Y (1u << 0 | 1u << 2 | 1u << 8 | 1u << 9)
#define EDGES_LOW_Z (1u << 0 | 1u << 1 | 1u << 4 | 1u << 6)

// The edges of a leaf of levels 0 to 3 that lie on the boundary of its region or of the volume. `origin`: of the region.
inline uint boundary_edges(Grid grid, int3 origin, int3 in_region, uint level) {
    const int3 high = in_region + (1 << level);
    const int3 end = min((int3)(32), (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1 - origin);
    return (in_region.x == 0 ? EDGES_LOW_X : 0) | (in_region.y == 0 ? EDGES_LOW_Y : 0) | (in_region.z == 0 ? EDGES_LOW_Z : 0)
        | (high.x >= end.x ? EDGES_HIGH_X : 0) | (high.y >= end.y ? EDGES_HIGH_Y : 0) | (high.z >= end.z ? EDGES_HIGH_Z : 0);
}

// `edges` if a cell of cube `i` is a leaf; `cell`: its number in the cube.
inline uint edges_beside_cell(__local const LeafHalo *halo, uint i, uint cell, uint edges) {
    return cover_cells(halo->cover[i]) >> cell & 1u ? edges : 0u;
}

// Of a leaf of level 0, the edges around which other leaves emit the polygon: those earlier in the order around the edge.
// `cell`: the leaf from the brick's low corner; `i`: its cube. A step along an axis leads to the next cube, or stays in this one.
inline uint edges_of_neighbour_cells(__local const LeafHalo *halo, uint3 cell, uint i) {
    const uint x = cell.x & 1, y = cell.y & 1, z = cell.z & 1, here = x | y << 1 | z << 2;
    return edges_beside_cell(halo, i + x, here ^ 1, EDGES_HIGH_X) | edges_beside_cell(halo, i + 6 * y, here ^ 2, EDGES_HIGH_Y)
        | edges_beside_cell(halo, i + 36 * z, here ^ 4, EDGES_HIGH_Z) | edges_beside_cell(halo, i + x + 6 * y, here ^ 3, 1u << 11)
        | edges_beside_cell(halo, i + 6 * y + 36 * z, here ^ 6, 1u << 3)
        | edges_beside_cell(halo, i + x + 36 * z, here ^ 5, 1u << 7)
        | edges_beside_cell(halo, i + 6 * y - 6 + 36 * z, here ^ 6, 1u << 2)
        | edges_beside_cell(halo, i + 36 * z - 36 + x, here ^ 5, 1u << 6)
        | edges_beside_cell(halo, i + x - 1 + 6 * y, here ^ 3, 1u << 10);
}

// `finer` if cells of cube `i` are leaves, `same` if the cube is a leaf itself.
inline uint edges_beside_cube(__local const LeafHalo *halo, uint i, uint finer, uint same) {
    const uint level = cover_level(halo->cover[i]);
    return level == 0 ? finer : level == 1 ? same : 0u;
}

// The same of a leaf of level 1, whose cube is `i`: finer leaves always emit, those of its level if they come earlier.
inline uint edges_of_neighbour_cubes(__local const LeafHalo *halo, uint i) {
    uint edges = 0;
    // Across a face.
    edges |= edges_beside_cube(halo, i + 1, EDGES_HIGH_X, EDGES_HIGH_X);
    edges |= edges_beside_cube(halo, i + 6, EDGES_HIGH_Y, EDGES_HIGH_Y);
    edges |= edges_beside_cube(halo, i + 36, EDGES_HIGH_Z, EDGES_HIGH_Z);
    edges |= edges_beside_cube(halo, i - 1, EDGES_LOW_X, 0u);
    edges |= edges_beside_cube(halo, i - 6, EDGES_LOW_Y, 0u);
    edges |= edges_beside_cube(halo, i - 36, EDGES_LOW_Z, 0u);
    // Across an edge.
    edges |= edges_beside_cube(halo, i + 1 + 6, 1u << 11, 1u << 11);
    edges |= edges_beside_cube(halo, i + 6 + 36, 1u << 3, 1u << 3);
    edges |= edges_beside_cube(halo, i + 36 + 1, 1u << 7, 1u << 7);
    edges |= edges_beside_cube(halo, i - 1 + 6, 1u << 10, 1u << 10);
    edges |= edges_beside_cube(halo, i - 6 + 36, 1u << 2, 1u << 2);
    edges |= edges_beside_cube(halo, i - 36 + 1, 1u << 6, 1u << 6);
    edges |= edges_beside_cube(halo, i + 1 - 6, 1u << 9, 0u);
    edges |= edges_beside_cube(halo, i + 6 - 36, 1u << 1, 0u);
    edges |= edges_beside_cube(halo, i + 36 - 1, 1u << 5, 0u);
    edges |= edges_beside_cube(halo, i - 1 - 6, 1u << 8, 0u);
    edges |= edges_beside_cube(halo, i - 6 - 36, 1u << 0, 0u);
    edges |= edges_beside_cube(halo, i - 36 - 1, 1u << 4, 0u);
    return edges;
}

// Edges of a leaf of level 0 or 1 around which other leaves emit the polygon. `cell`: its low corner from the brick's.
inline uint edges_of_neighbours(__local const LeafHalo *halo, uint level, uint3 cell) {
    const uint i = cell.x / 2 + 1 + 6 * (cell.y / 2 + 1) + 36 * (cell.z / 2 + 1);
    return level == 0 ? edges_of_neighbour_cells(halo, cell, i) : edges_of_neighbour_cubes(halo, i);
}

#endif
