// What the phases of construct share: the brick at hand and its local memory. The kernel fills both structs; every phase is
// called by all work-items of the group. The table of local memory stands in construct.cl.
//
// Functions that take them are INLINED: with a call the structs stay in memory, and construct takes twice as long on PoCL.
#ifndef ISOPEEL_BRICK_TASK_H
#define ISOPEEL_BRICK_TASK_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/samples.h"
#include "lib/slots.h"

// Grid edges inside a brick: three axes, 7^2 lines each, 8 edges a line.
#define MAX_INNER_QUADS (3 * 7 * 7 * 8)

#define NO_CELL 0xffffu // in `compact_index`: the cell is not active

// The brick, its buffers and what follows from them.
typedef struct {
    ConstructArgs args;
    __global const SAMPLE *samples;
    __global const void *feature;
    __global const Region *region;
    __global const Brick *brick;
    __global Node *nodes;
    __global VertexRecord *vertex_records;
    uint index;      // of the brick in the compact array
    uint morton;     // Morton number in the region of the brick's first cell
    int3 in_region;  // low corner from the region's, in cells
    int3 origin;     // low corner in the volume
    int3 last;       // its last sample, from its first: 8, less at the volume's end
    float3 spacing;
    uint cell_count; // active cells
    uint cell_slots; // slot of the first of them
    uint level1_count, level2_count;
    uint cube_count; // of levels 1 to 3
    bool running_sums; // cells alone, on a device that sums them while solving
} BrickTask;

// Local memory by its use; construct.cl says which arrays share bytes.
typedef struct {
    __local float *tile;                // 9^3 samples minus isovalue, NaN if missing
    __local ushort *inside_rows;        // by y + 9 z: which samples along x are inside, one bit each
    __local ushort *cell_list;          // active cells in Morton order: listed_cell, listed_morton
    __local ushort *compact_index;      // by x + 8 y + 64 z: index in `cell_list`, or NO_CELL
    __local float *solver_in;           // INPUTS rows of CELLS columns
    __local float *solver_out;          // OUTPUTS rows of CELLS columns
    __local float *cubes;               // rows of CUBES columns, see lib/cube_solver.h; cubes as in `cube_ids`
    __local uchar *cube_ids;            // level-1 cubes in Morton order, level-2 cubes, the brick: level << 6 | Morton number
    __local uchar *cube_signs;          // signs of the corners, by column of `cubes`
    __local uchar *mergeable;           // by MERGEABLE_LEVEL1 + Morton number and so on
    __local uint *multi_sheet_mask;     // cells with several sheets, one bit each in the order of `cell_list`
    __local uint *even_sheet_mask;      // of these, the ones with two or four sheets
    __local uint *sheets_ge3_mask;      // of these, the ones with three or four sheets
    __local uint *facts;                // of 256 cases a byte, see fact_triangles
    __local uint *work_count;           // entries of the lists that the last two phases make
    __local ushort *sheet_list;         // cell in `cell_list` << 2 | sheet
    __local ushort *positions;          // POSITIONS_CAPACITY: vertices of the cells before relaxation
    __local int *offset_sums;           // OFFSET_SUMS_CAPACITY
    __local ushort *quad_list;          // up to MAX_INNER_QUADS: edge's low sample x + 8 y + 64 z, axis << 9
} BrickMemory;

// Rows of `mergeable`: level-1 cubes by Morton number, then level-2 cubes, then the brick.
#define MERGEABLE_LEVEL1 0
#define MERGEABLE_LEVEL2 64
#define MERGEABLE_BRICK 72
#define MERGEABLE_ROWS 73

// A byte of `facts`: triangles of the case, number of sheets, whether two segments of a face lie in one sheet.
INLINED uint case_fact(__local const uint *facts, uint signs) { return facts[signs >> 2] >> (8 * (signs & 3)) & 0xffu; }
INLINED uint fact_triangles(uint fact) { return fact & 7u; }
INLINED uint fact_sheets(uint fact) { return fact >> 3 & 7u; }
INLINED bool fact_joined(uint fact) { return fact >> 6 & 1u; }

INLINED uint cube_level(uint id) { return id >> 6; }
INLINED uint cube_morton(uint id) { return id & 63u; }

// Low 8 bits: the level-1 cubes of a level-2 cube, one bit each.
INLINED uint level1_below(__global const Brick *brick, uint level2) {
    return brick->level1_mask[level2 >> 2] >> (8 * (level2 & 3)) & 0xffu;
}

// Column of a level-1 or level-2 cube in `cubes`.
INLINED uint level1_column(__global const Brick *brick, uint cube) {
    return rank64(brick->level1_mask[0], brick->level1_mask[1], cube);
}
INLINED uint level2_column(const BrickTask *task, uint cube) {
    return task->level1_count + popcount(task->brick->level2_mask & ((1u << cube) - 1));
}

// Slot of the node of a column of `cubes`.
INLINED uint cube_slot(const BrickTask *task, uint column) {
    const uint level2_end = task->level1_count + task->level2_count;
    return task->region->slot_base
        + (column < task->level1_count ? task->brick->level_base[1] + column
           : column < level2_end ? task->brick->level_base[2] + column - task->level1_count
                                 : task->region->level_base[3] + task->index - task->region->brick_base);
}

INLINED BrickTask make_brick_task(ConstructArgs args, __global const SAMPLE *samples, __global const void *feature,
                                  __global const Region *regions, __global const Brick *bricks, __global Node *nodes,
                                  __global VertexRecord *vertex_records) {
    BrickTask task;
    task.args = args;
    task.samples = samples;
    task.feature = feature;
    task.index = args.first_brick + (uint)get_group_id(0);
    task.brick = bricks + task.index;
    task.region = regions + task.brick->region;
    task.nodes = nodes;
    task.vertex_records = vertex_records;
    task.morton = task.brick->morton << 9;
    task.in_region = convert_int3(unmorton(task.morton));
    task.origin = convert_int3(region_origin(args.grid, task.region->region)) + task.in_region;
    task.last = clamp_sample(args.grid, task.origin + 8) - task.origin;
    task.spacing = (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]);
    task.cell_count = count_cells(task.brick);
    task.cell_slots = task.region->slot_base + task.brick->level_base[0];
    task.level1_count = count_level1(task.brick);
    task.level2_count = popcount(task.brick->level2_mask);
    task.cube_count = task.level1_count + task.level2_count + 1;
    task.running_sums = SUM_WHILE_SOLVING && !args.whole;
    return task;
}

#endif
