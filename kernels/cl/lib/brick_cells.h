// Phases of construct for the active cells of a brick: samples, the list of cells, their nodes and vertices, sums by level-1 cube.
#ifndef ISOPEEL_BRICK_CELLS_H
#define ISOPEEL_BRICK_CELLS_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/layout.h"
#include "lib/moments.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/samples.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// Loads one row of a brick's samples minus the isovalue into `tile`; missing samples become NaN. Returns which samples are inside, one bit
// each. Beyond the volume's last sample the row repeats that one.
INLINED ushort load_row(__global const SAMPLE *row, int last, float iso, float missing, __local float *tile) {
    uint inside = 0;
    if (last == 8) {
        const float8 v = convert_float8(vload8(0, row));
        const float end = (float)row[8];
        vstore8(select(v - iso, (float8)(NAN), v == missing), 0, tile);
        tile[8] = end == missing ? NAN : end - iso;
        inside = mask8(v >= iso && v != missing) | (uint)(end >= iso && end != missing) << 8;
    } else for (int x = 0; x < 9; x++) {
        const float v = (float)row[min(x, last)];
        tile[x] = v == missing ? NAN : v - iso;
        inside |= (uint)(v >= iso && v != missing) << x;
    }
    return (ushort)inside;
}

// Phase: the brick's samples, and no cell listed yet.
INLINED void load_samples(const BrickTask *task, const BrickMemory *memory) {
    const uint lid = get_local_id(0);
    const Grid grid = task->args.grid;
    __global const SAMPLE *first = task->samples + sample_index(grid, task->args.z0, task->origin);
    const ulong width = grid.dims[0], plane = width * grid.dims[1];
    ROLLED for (uint row = lid; row < 81; row += BRICK_GROUP) {
        __global const SAMPLE *from = first + min(row / 9, (uint)task->last.z) * plane + min(row % 9, (uint)task->last.y) * width;
        memory->inside_rows[row] = load_row(from, task->last.x, task->args.iso, grid.missing, memory->tile + 9 * row);
    }
    ROLLED for (uint i = lid; i < 512; i += BRICK_GROUP) memory->compact_index[i] = NO_CELL;
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase on a CPU: loads the samples of the next work-group's brick into the caches.
INLINED void prefetch_next_brick(const BrickTask *task, __global const Region *regions, __global const Brick *bricks) {
    if (!PREFETCHES || get_group_id(0) + 1 >= get_num_groups(0)) return;
    __global const Brick *brick = bricks + task->index + 1;
    const int3 origin = convert_int3(brick_origin(task->args.grid, regions[brick->region].region, brick->morton));
    prefetch_samples(task->args.grid, task->samples, task->args.z0, origin);
}

// Phase: crossings, vertex and normal of the `run` listed cells from `first` on, a column each.
INLINED void solve_listed_cells(const BrickTask *task, const BrickMemory *memory, uint first, uint run) {
    const uint lid = get_local_id(0), columns = (run + LANES - 1) / LANES * LANES;
    ROLLED for (uint i = lid; i < columns; i += BRICK_GROUP) {
        const int3 at = listed_cell(memory->cell_list[first + min(i, run - 1)]);
        __local const float *corner = memory->tile + (at.z * 9 + at.y) * 9 + at.x;
        __local float *in = memory->solver_in + i;
        GATHER_CORNERS(corner, in, CELLS)
        in[IN_LOW * CELLS] = (float)at.x - 4.0f; // quadrics of the brick count from its centre
        in[(IN_LOW + 1) * CELLS] = (float)at.y - 4.0f;
        in[(IN_LOW + 2) * CELLS] = (float)at.z - 4.0f;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    const float3 spacing = task->spacing, centre = convert_float3(task->in_region + 4);
    const float smallest = fmin(spacing.x, fmin(spacing.y, spacing.z));
    ROLLED for (uint i = lid * LANES; i < run; i += BRICK_GROUP * LANES)
        solve_cells(memory->solver_in, memory->solver_out, i, centre, spacing, smallest / spacing);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// The sums over the cells of the level-1 cube at hand, if cells are summed while they are solved.
typedef struct {
    float4 slopes;  // of Moments: g and q
    uint n;         // likewise
    uint stored;    // listed cells that have their smoothness
    uint triangles; // of the brick's cubes before
} RunningSums;

INLINED RunningSums no_running_sums() {
    RunningSums sums;
    sums.slopes = (float4)(0.0f);
    sums.n = sums.stored = sums.triangles = 0;
    return sums;
}

// Adds the listed cell `i`; after the last one of its level-1 cube all cells of the cube get its smoothness.
INLINED void add_to_running_sums(RunningSums *sums, const BrickTask *task, const BrickMemory *memory, __local const float *solved,
                                 uint i, uint triangles) {
    sums->slopes += (float4)(solved[OUT_SLOPE * CELLS], solved[(OUT_SLOPE + 1) * CELLS], solved[(OUT_SLOPE + 2) * CELLS],
                             solved[OUT_SLOPED * CELLS] > 0.0f ? 1.0f : 0.0f) * (float)triangles;
    sums->n += triangles;
    const uint cube = listed_morton(memory->cell_list[i]) >> 3;
    if (i + 1 < task->cell_count && listed_morton(memory->cell_list[i + 1]) >> 3 == cube) return;
    const float s = smoothness(sums->slopes, (float)sums->n);
    for (; sums->stored <= i; sums->stored++) task->nodes[task->cell_slots + sums->stored].s = s;
    sums->triangles += sums->n;
    sums->slopes = (float4)(0.0f);
    sums->n = 0;
}

// Marks a cell with several sheets in the masks.
INLINED void mark_multi_sheet_cell(const BrickMemory *memory, uint i, uint sheets) {
    const uint word = i >> 5, bit = 1u << (i & 31);
    or_local(&memory->multi_sheet_mask[word], bit);
    if (sheets != 3) or_local(&memory->even_sheet_mask[word], bit);
    if (sheets > 2) or_local(&memory->sheets_ge3_mask[word], bit);
}

// Phase: nodes and vertex records of the solved cells. Leaves in `solver_out` what the cubes above sum up: moments weighted by
// triangles.
INLINED void store_cells(const BrickTask *task, const BrickMemory *memory, uint first, uint run, RunningSums *sums) {
    const ConstructArgs args = task->args;
    ROLLED for (uint i = get_local_id(0); i < run; i += BRICK_GROUP) {
        __local float *solved = memory->solver_out + i;
        const uint slot = task->cell_slots + first + i, entry = memory->cell_list[first + i], cell = listed_morton(entry);
        const uint signs = (uint)solved[OUT_SIGNS * CELLS], fact = case_fact(memory->facts, signs), n = fact_triangles(fact);
        const float f = args.feature_kind == FEATURE_NONE ? 0.0f : task->nodes[slot].f; // from store_features
        uint sheets = fact_sheets(fact);
        if (fact_joined(fact))
            sheets = sheet_count(cell_sheets(args.grid, task->samples, args.z0, args.iso, task->origin + listed_cell(entry), signs));
        if (sheets > 1 || fact_joined(fact)) memory->mergeable[MERGEABLE_LEVEL1 + (cell >> 3)] = 0;
        if (sheets > 1) mark_multi_sheet_cell(memory, first + i, sheets);
        task->nodes[slot].count = n;
        if (args.feature_kind == FEATURE_NONE) task->nodes[slot].f = 0.0f;
        task->nodes[slot].meta = node_code(0, task->morton | cell) | signs << 16 | (sheets - 1) << 26;
        __global float *record = (__global float *)(task->vertex_records + slot);
        vstore3((float3)(solved[OUT_RECORD * CELLS], solved[(OUT_RECORD + 1) * CELLS], solved[(OUT_RECORD + 2) * CELLS]), 0, record);
        if (task->running_sums) {
            add_to_running_sums(sums, task, memory, solved, first + i, n);
            continue;
        }
        for (uint j = 0; j < 3; j++) solved[(OUT_SLOPE + j) * CELLS] *= (float)n;
        solved[OUT_SLOPED * CELLS] = solved[OUT_SLOPED * CELLS] > 0.0f ? (float)n : 0.0f;
        solved[OUT_FEATURE * CELLS] = (float)n * f;
        solved[OUT_COUNT * CELLS] = (float)n;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: adds the solved cells to their level-1 cubes' sums. The cells of a cube are neighbours in the list; a work-item adds up
// some rows of one cube.
INLINED void sum_cells(const BrickTask *task, const BrickMemory *memory, uint first, uint run, uint rows) {
    const uint work = task->running_sums ? 0 : task->level1_count * WORK_ITEMS_A_SUM;
    ROLLED for (uint i = get_local_id(0); i < work; i += BRICK_GROUP) {
        const uint column = i / WORK_ITEMS_A_SUM, cube = cube_morton(memory->cube_ids[column]);
        const uint begin = cells_before_level1(task->brick, cube), end = begin + popcount(level1_cells(task->brick, cube));
        if (begin >= first + run || end <= first) continue;
        const uint from = max(begin, first) - first, to = min(end, first + run) - first;
        ROLLED for (uint row = i % WORK_ITEMS_A_SUM; row < rows; row += WORK_ITEMS_A_SUM) {
            float sum = begin >= first ? 0.0f : memory->cubes[row * CUBES + column];
            ROLLED for (uint j = from; j < to; j++) sum += memory->solver_out[row * CELLS + j];
            memory->cubes[row * CUBES + column] = sum;
        }
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

#endif
