// Phase of construct for the cells with several sheets: a vertex for each sheet, a node for each but the first
// (docs/algorithm.md#62-sheets).
#ifndef ISOPEEL_BRICK_SHEETS_H
#define ISOPEEL_BRICK_SHEETS_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/sheet_vertices.h"
#include "lib/sheets.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// Lists the sheets of cells with several sheets, so that every work-item gets some.
INLINED void list_sheets(const BrickTask *task, const BrickMemory *memory) {
    const uint count = task->brick->extra_sheets ? task->cell_count : 0;
    ROLLED for (uint i = get_local_id(0); i < count; i += BRICK_GROUP) {
        if (!test_bit(memory->multi_sheet_mask, i)) continue;
        const uint ge3 = test_bit(memory->sheets_ge3_mask, i), sheets = 2 + ge3 + (ge3 & test_bit(memory->even_sheet_mask, i));
        const uint to = add_local(memory->work_count, sheets);
        ROLLED for (uint sheet = 0; sheet < sheets; sheet++) memory->sheet_list[to + sheet] = (ushort)(i << 2 | sheet);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Extra sheets of the listed cells before cell `i`: one for an even number of sheets, two more for three and four.
INLINED uint extra_sheets_before(const BrickMemory *memory, uint i) {
    const uint below = (1u << (i & 31)) - 1, last = i >> 5;
    uint before = popcount(memory->even_sheet_mask[last] & below) + 2 * popcount(memory->sheets_ge3_mask[last] & below);
    ROLLED for (uint word = 0; word < last; word++)
        before += popcount(memory->even_sheet_mask[word]) + 2 * popcount(memory->sheets_ge3_mask[word]);
    return before;
}

// Fills column `lane`; returns the sheets of its cell, packed as by cell_sheets.
INLINED uint gather_sheet(const BrickTask *task, const BrickMemory *memory, SheetVertices *vertices, uint lane, uint entry) {
    const uint i = entry >> 2, sheet = entry & 3u, signs = meta_signs(task->nodes[task->cell_slots + i].meta);
    const int3 p = listed_cell(memory->cell_list[i]);
    const uint sheets = cell_sheets(task->args.grid, task->samples, task->args.z0, task->args.iso, task->origin + p, signs);
    __local const float *corner = memory->tile + (p.z * 9 + p.y) * 9 + p.x;
    vertices->edges[lane] = crossed_edges(signs) & edges_of_sheet(sheets, sheet);
    GATHER_CORNERS(corner, vertices->corner + lane, LANES)
    return sheets;
}

// Stores the vertex of column `lane` and its node: the first sheet's is the cell's, which gets the index of the others' first.
INLINED void store_sheet(const BrickTask *task, const BrickMemory *memory, const SheetVertices *vertices, uint lane, uint entry,
                         uint sheets) {
    const uint i = entry >> 2, sheet = entry & 3u, before = extra_sheets_before(memory, i);
    uint slot = task->cell_slots + i;
    __global Node *cell = task->nodes + slot;
    if (sheet == 0) cell->count |= before << 8;
    else {
        slot = task->region->slot_base + task->brick->level_base[3] + before + sheet - 1;
        task->nodes[slot].count = sheets;
        task->nodes[slot].s = cell->s;
        task->nodes[slot].f = cell->f;
        task->nodes[slot].meta = (cell->meta & ~(3u << 26)) | sheet << 26;
    }
    const float3 low = convert_float3(task->in_region + listed_cell(memory->cell_list[i]));
    const float3 x = (float3)(vertices->x[lane], vertices->y[lane], vertices->z[lane]);
    task->vertex_records[slot] = quantise_vertex(low + x, (uint)vertices->normal[lane], 0.0f);
}

// Phase: vertices of the sheets of cells with several sheets, LANES at once.
INLINED void split_sheets(const BrickTask *task, const BrickMemory *memory) {
    list_sheets(task, memory);
    SheetVertices vertices;
    for (uint i = 0; i < 8 * LANES; i++) vertices.corner[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) vertices.edges[i] = 0;
    const uint count = *memory->work_count;
    ROLLED for (uint begin = get_local_id(0) * LANES; begin < count; begin += BRICK_GROUP * LANES) {
        const uint run = min(count - begin, (uint)LANES);
        uint sheets[LANES];
        for (uint lane = 0; lane < LANES; lane++) {
            if (lane >= run) break;
            sheets[lane] = gather_sheet(task, memory, &vertices, lane, memory->sheet_list[begin + lane]);
        }
        solve_sheets(&vertices, task->spacing);
        for (uint lane = 0; lane < LANES; lane++) {
            if (lane >= run) break;
            store_sheet(task, memory, &vertices, lane, memory->sheet_list[begin + lane], sheets[lane]);
        }
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
}

#endif
