// Vertices of the cells of a plain brick and of those just before it, which its quads inside the volume join: a device that
// works on a brick with one work-item looks each up once, not once for every quad, and writes each ghost once.
#ifndef ISOPEEL_CORNERS_H
#define ISOPEEL_CORNERS_H

#include "lib/precision.h"
#include "lib/batch.h"
#include "lib/bits.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/vertices.h"
#if BRICK_GROUP == 1

#define MULTI_SHEET 0x8000u // beside a row: the cell has several sheets, whose rows follow one another

typedef struct {
    // By x + 9 y + 81 z from the cell before the brick's first: row of its vertex; of a cell of several sheets these (sheets.h).
    ushort row[729];
    uint sheets[729];
    ushort own[512]; // of the brick's cells, one after another: their index in the arrays above
    // Rows: position from the brick's low corner and normal, as in VertexRecord; index and slot, as in Batch.
    short4 position_normal[4 * 729];
    uint2 index_slot[4 * 729];
} Corners;

// `origin`: of the vertex' region; `name`: the ghost's where that is another one.
inline void set_corner(Corners *corners, uint row, Grid grid, CORNER_PARAMS, Part part, uint in, int3 origin, uint slot, uint name) {
    // In 16 bits, which hold what is left of the way; the normal follows the position.
    const int3 moved = (origin - part.low) * (int)VERTEX_LATTICE;
    corners->position_normal[row] = as_short4(vload4(0, vertex_records[slot].position) + convert_ushort4((int4)(moved, 0)));
    uint index = compact_index[slot];
    if (in != part.region) {
        // Not every cell there is part of a polygon of this region.
        if (!(ghosts[part.region * HALO_WORDS + (name >> 5)] >> (name & 31) & 1u)) return;
        const int3 at = lattice_position(grid, params, vertex_records[slot], origin) - part.origin * (int)VERTEX_LATTICE;
        index = ghost_vertex(CORNER_ARGS, part, slot, name, at);
    }
    corners->index_slot[row] = (uint2)(index, slot);
}

// By how much each of a word's 32 cells lies behind its first, in x + 9 y + 81 z.
__constant uchar CELL_IN_WORD[32] = {
    0,  1,  9,  10, 81, 82, 90, 91, 2,  3,  11, 12, 83,  84,  92,  93,
    18, 19, 27, 28, 99, 100, 108, 109, 20, 21, 29, 30, 101, 102, 110, 111,
};

inline void find_corners(Corners *corners, Grid grid, CORNER_PARAMS, Part part, __global const Brick *bricks,
                         __global const uint *near) {
    const int3 in_region = part.low - part.origin;
    uint row = 0, own = 0;
    for (uint before = 0; before < 8; before++) {
        const uint x = before & 1, y = before >> 1 & 1, z = before >> 2, index = near[13 - x - 3 * y - 9 * z];
        if (index == NONE) continue;
        __global const Brick *brick = bricks + index;
        const uint in = brick->region;
        const int3 origin = convert_int3(region_origin(grid, regions[in].region));
        // Of the bricks before this one the last cells: the highest bits of x, y and z are their word's.
        const uint wanted = (x ? LAST_X : ~0u) & (y ? LAST_Y : ~0u) & (z ? LAST_Z : ~0u);
        const uint words = x << 1 | y << 2 | z * 9;
        for (uint word = 0; word < 16; word++) {
            if ((word & words) != words) continue;
            const uint first = regions[in].slot_base + brick->level_base[0] + brick->cells_before[word], cells = brick->cells[word];
            const uint word_at = 4 * (word >> 1 & 1) + 36 * (word >> 2 & 1) + 162 * (word & 1) + 324 * (word >> 3);
            // From the cell before the brick's first; of the bricks before this one the cells are that one layer.
            const uint first_at = 91 + word_at - 8 * x - 72 * y - 648 * z;
            for (uint rest = cells & wanted; rest; rest &= rest - 1) {
                const uint bit = lowest_bit(rest), slot = first + popcount(cells & ((1u << bit) - 1));
                const uint at = first_at + CELL_IN_WORD[bit];
                uint name = 0;
                if (in != part.region) {
                    const int3 cell = convert_int3(unmorton(word << 5 | bit)) - 8 * (int3)((int)x, (int)y, (int)z);
                    name = 4 * halo_cell(in_region + cell);
                }
                if (before == 0) corners->own[own++] = (ushort)at;
                corners->row[at] = (ushort)row;
                set_corner(corners, row++, grid, CORNER_ARGS, part, in, origin, slot, name);
                if (!brick->extra_sheets || !meta_extras(nodes[slot].meta)) continue;
                const uint extra = first_extra(regions + in, brick, nodes[slot]);
                corners->row[at] |= MULTI_SHEET;
                corners->sheets[at] = nodes[extra].count;
                for (uint sheet = 1; sheet <= meta_extras(nodes[slot].meta); sheet++)
                    set_corner(corners, row++, grid, CORNER_ARGS, part, in, origin, extra + sheet - 1, name + sheet);
            }
        }
    }
}

// Puts the quad around the edge along `axis` from the low corner of a cell of the brick into a batch. `at`: the cell's place.
INLINED void add_plain_quad(Batch *batch, const Corners *corners, uint at, uint axis, uint flip_winding, uint first_corner) {
    const uint column = NEXT_COLUMN(batch);
    const uint b = axis == 0 ? 9 : axis == 1 ? 81 : 1, c = axis == 0 ? 81 : axis == 1 ? 1 : 9;
    const uint around[4] = {at, at - b, at - b - c, at - c};
    for (uint i = 0; i < 4; i++) {
        uint row = corners->row[around[i]];
        if (row & MULTI_SHEET) row = (row & ~MULTI_SHEET) + edge_sheet(corners->sheets[around[i]], 4 * axis + (i ^ i >> 1));
        batch->position_normal[i * LANES + column] = convert_int4(corners->position_normal[row]);
        batch->index_slot[i * LANES + column] = corners->index_slot[row];
    }
    batch->first[column] = first_corner;
    batch->count_flags[column] = 4 | flip_winding << 3;
}

// Emits the quads of a plain brick's cells inside the volume, and lists the edges of the others, at most 12 of each of 8^3 - 6^3
// cells; answers how many these are. `done`: triangles emitted so far.
inline uint emit_plain(Batch *batch, const Corners *corners, Grid grid, Part part, __global const Region *regions,
                       __global const Brick *bricks, __global const Node *nodes, bool inside, float3 scale,
                       uint first_triangle, uint *done, __local ushort *list, __global uint *indices, uint keep_corners,
                       __global uint *corner_slots) {
    __global const Brick *brick = bricks + part.brick;
    const uint first = regions[part.region].slot_base + brick->level_base[0], count = count_cells(brick);
    uint listed = 0;
    for (uint i = 0; i < count; i++) {
        const uint meta = nodes[first + i].meta, signs = meta_signs(meta);
        if (!inside && !is_inside(grid, part.origin + convert_int3(unmorton(code_cell(meta_code(meta), 0))))) {
            for (uint edges = crossed_edges(signs); edges; edges &= edges - 1) list[listed++] = LIST_ENTRY(0, i, lowest_bit(edges));
            continue;
        }
        for (uint axis = 0; axis < 3; axis++) {
            if (!((signs ^ signs >> (1u << axis)) & 1u)) continue;
            add_plain_quad(batch, corners, corners->own[i], axis, !(signs & 1u), 3 * (first_triangle + *done));
            *done += 2;
            if (batch->count == LANES) emit_batch(batch, scale, indices, keep_corners, corner_slots);
        }
    }
    return listed;
}

#endif
#endif
