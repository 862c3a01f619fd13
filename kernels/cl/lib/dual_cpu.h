// dual on a CPU, which works on a brick with one work-item: see dual_device.h. The quads of a plain brick are made from a table
// of the vertices of its cells and of the cells just before it, so that each vertex is looked up once, not once for every quad,
// and each ghost is written once.
#ifndef ISOPEEL_DUAL_CPU_H
#define ISOPEEL_DUAL_CPU_H

#include "lib/batch.h"
#include "lib/bits.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/ghosts.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/vertices.h"

// Slots that one work-item of dual_scan numbers in a step.
#define SLOTS_PER_ITEM 1

// Whether plain bricks are emitted from a table of vertices.
#define VERTEX_TABLE 1

// The 32 level-1 cubes in half a brick, in Morton order: number in the halo, less that of the first.
__constant uchar CUBE_IN_HALO[32] = {
    0,  1,  6,  7,  36, 37, 42, 43, 2,  3,  8,  9,  38, 39, 44, 45,
    12, 13, 18, 19, 48, 49, 54, 55, 14, 15, 20, 21, 50, 51, 56, 57,
};

// Enters those active cubes of one of the 27 bricks that lie in the halo. `x, y, z`: the brick, 0 to 2.
INLINED void find_halo_of_brick(__local LeafHalo *halo, const Cut *cut, uint index, uint x, uint y, uint z) {
    __global const Brick *brick = cut->bricks + index;
    // Of the bricks before this one the last cubes, of those behind it the first.
    const uint within = (x == 0 ? LAST_X : x == 2 ? FIRST_X : ~0u) & (y == 0 ? LAST_Y : y == 2 ? FIRST_Y : ~0u)
        & (z == 0 ? LAST_Z : z == 2 ? FIRST_Z : ~0u);
    uint first = cut->regions[brick->region].slot_base + brick->level_base[1];
    const uint corner = 4 * (x + 6 * y + 36 * z) - 3 * (1 + 6 + 36);
    for (uint side = 0; side < 2; side++) {
        const uint cubes = brick->level1_mask[side];
        for (uint rest = z == 2 * side ? 0 : cubes & within; rest; rest &= rest - 1) {
            const uint bit = lowest_bit(rest), own = first + popcount(cubes & ((1u << bit) - 1));
            set_halo_cube(halo, corner + CUBE_IN_HALO[bit] + 72 * side, cut->regions, cut->bricks, cut->state, index,
                          side << 5 | bit, own);
        }
        first += popcount(cubes);
    }
}

// Fills the halo of a brick if `wanted`, from active cube to active cube.
INLINED void find_halo(__local LeafHalo *halo, const Cut *cut, const Part *part, bool wanted) {
    if (!wanted) return;
    for (uint i = 0; i < HALO_CUBES; i++) halo->cover[i] = HALO_EMPTY;
    for (uint i = 0; i < 27; i++)
        if (part->near[i] != NONE) find_halo_of_brick(halo, cut, part->near[i], i % 3, i / 3 % 3, i / 9);
}

#define TABLE_CELLS 729 // 9^3
#define MULTI_SHEET 0x8000u // beside a row: the cell has several sheets, whose rows follow one another

typedef struct {
    // By x + 9 y + 81 z from the cell diagonally before the brick's first: row of the cell's vertex; if there are several, its
    // sheets (sheets.h).
    ushort row[TABLE_CELLS];
    uint sheets[TABLE_CELLS];
    ushort own[512]; // of the brick's active cells in order: index into the two above
    // Rows, each a vertex: position from the brick's low corner in 1/VERTEX_LATTICE cell, normal; index and slot as in Batch.
    short4 position_normal[4 * TABLE_CELLS];
    uint2 index_slot[4 * TABLE_CELLS];
} VertexTable;

// A brick whose cells go into a table.
typedef struct {
    __global const Brick *brick;
    uint region; // compact index
    __global const Region *home; // that region
    int3 origin; // of the region
} TableBrick;

// `name`: as a ghost, of a vertex of another region.
INLINED void set_row(VertexTable *table, uint row, Grid grid, const Part *part, const MeshVertices *mesh, const TableBrick *from,
                     uint slot, uint name) {
    // 16 bits hold the difference, for a cell in or beside the brick. The normal follows the position.
    const int3 shift = (from->origin - part->low) * (int)VERTEX_LATTICE;
    table->position_normal[row] = as_short4(vload4(0, mesh->records[slot].position) + convert_ushort4((int4)(shift, 0)));
    uint index = mesh->points.wanted ? cell_point(from->home, slot) : mesh->compact_index[slot];
    if (from->region != part->region && !mesh->points.wanted) {
        // Not every cell there is a corner of a polygon of this region.
        if (!(mesh->ghosts[part->region * HALO_WORDS + (name >> 5)] >> (name & 31) & 1u)) return;
        const int3 at = lattice_position(grid, mesh->params, mesh->records[slot], from->origin)
            - part->origin * (int)VERTEX_LATTICE;
        index = write_ghost(mesh, part->region, slot, name, at);
    }
    table->index_slot[row] = (uint2)(index, slot);
}

// Enters a cell at `at` and its extra sheets from row `row` on; returns the next free row.
INLINED uint set_cell(VertexTable *table, uint row, uint at, Grid grid, const Cut *cut, const Part *part,
                      const MeshVertices *mesh, const TableBrick *from, uint slot, uint name) {
    table->row[at] = (ushort)row;
    set_row(table, row++, grid, part, mesh, from, slot, name);
    if (!from->brick->extra_sheets || !meta_extras(cut->nodes[slot].meta)) return row;
    const uint extra = first_extra(cut->regions + from->region, from->brick, cut->nodes[slot]);
    table->row[at] |= MULTI_SHEET;
    table->sheets[at] = cut->nodes[extra].count;
    for (uint sheet = 1; sheet <= meta_extras(cut->nodes[slot].meta); sheet++)
        set_row(table, row++, grid, part, mesh, from, extra + sheet - 1, name + sheet);
    return row;
}

// The 32 cells of a word of a brick's mask, in Morton order: x + 9 y + 81 z, less that of the first.
__constant uchar CELL_IN_WORD[32] = {
    0,  1,  9,  10, 81, 82, 90, 91, 2,  3,  11, 12, 83,  84,  92,  93,
    18, 19, 27, 28, 99, 100, 108, 109, 20, 21, 29, 30, 101, 102, 110, 111,
};

INLINED void fill_table(VertexTable *table, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh) {
    const int3 in_region = part->low - part->origin;
    uint row = 0, own = 0;
    for (uint before = 0; before < 8; before++) {
        const uint x = before & 1, y = before >> 1 & 1, z = before >> 2, index = part->near[13 - x - 3 * y - 9 * z];
        if (index == NONE) continue;
        const uint of = cut->bricks[index].region;
        const TableBrick from = {cut->bricks + index, of, cut->regions + of,
                                 convert_int3(region_origin(grid, cut->regions[of].region))};
        // Of the bricks before this one the last cells: the highest bits of x, y and z are their word's.
        const uint wanted = (x ? LAST_X : ~0u) & (y ? LAST_Y : ~0u) & (z ? LAST_Z : ~0u);
        const uint words = x << 1 | y << 2 | z * 9;
        for (uint word = 0; word < 16; word++) {
            if ((word & words) != words) continue;
            const uint cells = from.brick->cells[word];
            const uint first = cut->regions[of].slot_base + from.brick->level_base[0] + from.brick->cells_before[word];
            const uint word_at = 4 * (word >> 1 & 1) + 36 * (word >> 2 & 1) + 162 * (word & 1) + 324 * (word >> 3);
            // The brick's first cell is at 91; the bricks before this one have one layer of cells in the table.
            const uint first_at = 91 + word_at - 8 * x - 72 * y - 648 * z;
            for (uint rest = cells & wanted; rest; rest &= rest - 1) {
                const uint bit = lowest_bit(rest), slot = first + popcount(cells & ((1u << bit) - 1));
                const uint at = first_at + CELL_IN_WORD[bit];
                uint name = 0;
                if (of != part->region) {
                    const int3 cell = convert_int3(unmorton(word << 5 | bit)) - 8 * (int3)((int)x, (int)y, (int)z);
                    name = 4 * halo_cell(in_region + cell);
                }
                if (before == 0) table->own[own++] = (ushort)at;
                row = set_cell(table, row, at, grid, cut, part, mesh, &from, slot, name);
            }
        }
    }
}

// Adds the quad around the edge along `axis` from the low corner of a cell. `at`: the cell in the table.
INLINED void add_plain_quad(Batch *batch, const VertexTable *table, uint at, uint axis, uint flip_winding, uint first) {
    const uint column = NEXT_COLUMN(batch);
    const uint b = axis == 0 ? 9 : axis == 1 ? 81 : 1, c = axis == 0 ? 81 : axis == 1 ? 1 : 9;
    const uint around[4] = {at, at - b, at - b - c, at - c};
    for (uint i = 0; i < 4; i++) {
        uint row = table->row[around[i]];
        if (row & MULTI_SHEET) row = (row & ~MULTI_SHEET) + edge_sheet(table->sheets[around[i]], 4 * axis + (i ^ i >> 1));
        batch->position_normal[i * LANES + column] = convert_int4(table->position_normal[row]);
        batch->index_slot[i * LANES + column] = table->index_slot[row];
    }
    batch->first[column] = first;
    batch->count_flags[column] = 4 | flip_winding << 3;
}

// Emits the quads of a plain brick's cells away from the volume's faces, and lists the edges of the others, at most 12 of each of
// 8^3 - 6^3 cells; returns how many these are. `first_triangle`: where its triangles begin; `done`: triangles emitted so far.
INLINED uint emit_plain_brick(Batch *batch, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh,
                              const TriangleOutput *out, uint first_triangle, uint *done, __local ushort *list) {
    VertexTable table;
    fill_table(&table, grid, cut, part, mesh);
    __global const Brick *brick = cut->bricks + part->brick;
    const uint first = cut->regions[part->region].slot_base + brick->level_base[0], count = count_cells(brick);
    uint listed = 0;
    for (uint i = 0; i < count; i++) {
        const uint meta = cut->nodes[first + i].meta, signs = meta_signs(meta);
        if (!part->all_quads && !is_inside(grid, part->origin + convert_int3(unmorton(code_cell(meta_code(meta), 0))))) {
            for (uint edges = crossed_edges(signs); edges; edges &= edges - 1) list[listed++] = edge_entry(0, i, lowest_bit(edges));
            continue;
        }
        for (uint axis = 0; axis < 3; axis++) {
            if (!((signs ^ signs >> (1u << axis)) & 1u)) continue;
            add_plain_quad(batch, &table, table.own[i], axis, !(signs & 1u), 3 * (first_triangle + *done));
            *done += 2;
            if (batch->count == LANES) emit_batch(batch, out);
        }
    }
    return listed;
}

#endif
