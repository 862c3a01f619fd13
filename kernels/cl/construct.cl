// construct: nodes of all levels, each with the sums of the pyramid and the vertex, normal and error of the dual mesher
// (docs/algorithm.md#3-pyramid, docs/algorithm.md#63-vertex-placement). Once per isovalue: edits of the cut read no sample.
//
// construct: levels 0 to 3 and extra sheets. One work-group a brick.
//   In: samples, feature, regions, bricks. Out: nodes, vertex records, and of every brick its moments, quadric and whether it may
//   be merged. If the whole pyramid is not requested, only cells are made, which is all that a surface in full detail needs.
// construct_top: levels 4 and 5, and the triangles of each region. One work-item a region.
// link: the 27 bricks around each brick. 9 work-items a brick.
//
// Local memory of construct, and the phases in which each array is live (S samples, L lists, F feature, C cells, in runs of 64,
// K cubes, P sheets, R relaxation). Rows in one box share their bytes.
//
//   array                                     type     bytes                 S L F C K P R
//   tile                                      float    2916                  x x x x x x x
//   inside_rows                               ushort   162                   x x x x x x x
//   cell_list                                 ushort   1024                    x x x x x x
//   compact_index                             ushort   1024                  x x x x x x x
//   facts                                     uint     256                     x x x
//   cube_ids, cube_signs, mergeable           uchar    233                     x x x x
//   multi_sheet, even_sheet, sheets_ge3 masks uint     192                     x x x x x x
//   work_count                                uint     4                       x x x x x x
//   +- feature at corners of cells            float    2048                      x
//   |  solver_in: cells to solve              float    2816                        x
//   +- quad_list                              ushort   2352                              x
//   +- samples with a halo                    float    5324                      x   x
//   |  solver_out: solved cells               float    2560                        x
//   |  sheet_list                             ushort   4096                            x
//   +- offset_sums                            int      6144 (CPU: 8208)                  x
//   +- feature at samples                     float    5324                      x
//   |  cubes: sums, then vertices of cubes    float    8320 (cells alone: 1920)    x x
//   +- positions                              ushort   3072 (CPU: 4096)                  x
//
// `cubes` is an argument, so that groups that construct cells alone, without a feature, take less local memory.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/brick_cells.h"
#include "lib/brick_cubes.h"
#include "lib/brick_feature.h"
#include "lib/brick_sheets.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/construct_device.h"
#include "lib/cube_crossings.h"
#include "lib/cube_solver.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/merge.h"
#include "lib/moments.h"
#include "lib/morton.h"
#include "lib/quadric.h"
#include "lib/relax.h"
#include "lib/sample_block.h"
#include "lib/samples.h"
#include "lib/slots.h"
#include "lib/vertex_record.h"

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void construct(const ConstructArgs args, __global const SAMPLE *samples, __global const void *feature,
               __global const Region *regions, __global const Brick *bricks, __global const uint *case_facts,
               __global Node *nodes, __global VertexRecord *vertex_records, __global Moments *brick_moments,
               __global Quadric *brick_quadrics, __global uchar *brick_mergeable, __local float *cubes) {
    __local float tile[729];
    __local ushort inside_rows[81], cell_list[512], compact_index[512];
    __local uchar cube_ids[CUBES], cube_signs[CUBES], mergeable[MERGEABLE_ROWS];
    __local uint multi_sheet_mask[16], even_sheet_mask[16], sheets_ge3_mask[16], facts[64], work_count;
    __local union {
        float solver_in[INPUTS * CELLS];
        ushort quad_list[MAX_INNER_QUADS];
    } first;
    __local union {
        float samples[BLOCK_PLANE * BLOCK_ROW];
        float solver_out[OUTPUTS * CELLS];
        ushort sheet_list[4 * 512];
        int offset_sums[OFFSET_SUMS_CAPACITY];
    } second;
    const BrickMemory memory = {
        tile, inside_rows, cell_list, compact_index, first.solver_in, second.solver_out, cubes, cube_ids, cube_signs, mergeable,
        multi_sheet_mask, even_sheet_mask, sheets_ge3_mask, facts, &work_count, second.sheet_list, (__local ushort *)cubes,
        second.offset_sums, first.quad_list,
    };
    const BrickTask task = make_brick_task(args, samples, feature, regions, bricks, nodes, vertex_records);

    load_samples(&task, &memory);
    prefetch_next_brick(&task, regions, bricks);
    list_cells_and_cubes(&task, &memory, case_facts);
    load_blocks(&task, second.samples, cubes);
    derive_feature(&task, second.samples, cubes);
    store_features(&task, &memory, cubes, first.solver_in);
    // Rows of sums over cells, unless they are summed while solving; quadrics are wanted of whole pyramids alone.
    const uint cell_rows = task.running_sums ? 0 : OUT_SUMS;
    RunningSums sums = no_running_sums();
    ROLLED for (uint first_cell = 0; first_cell < task.cell_count; first_cell += CELLS) {
        const uint run = min(task.cell_count - first_cell, (uint)CELLS);
        solve_listed_cells(&task, &memory, first_cell, run);
        store_cells(&task, &memory, first_cell, run, &sums);
        sum_cells(&task, &memory, first_cell, run, cell_rows);
    }
    load_halo(&task, second.samples);
    sum_crossings(&task, &memory, second.samples);
    sum_cubes(&task, &memory, args.whole ? CUBE_SUMS : cell_rows);
    const bool mergeable_brick = find_mergeable(&task, &memory);
    store_cube_nodes(&task, &memory, mergeable_brick);
    if (task.running_sums) brick_moments[task.index].n = sums.triangles;
    else if (get_local_id(0) == 0) {
        __local const float *column = cubes + task.cube_count - 1;
        brick_moments[task.index] = column_moments(column);
        if (args.whole) {
            brick_quadrics[task.index] = column_quadric(column);
            brick_mergeable[task.index] = mergeable_brick;
        }
    }
    // Global too: the next phases read nodes of cells, and write vertices of those with several sheets again.
    brick_barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    store_cube_vertices(&task, &memory);
    split_sheets(&task, &memory);
    relax_cells(&task, &memory);
}

// What the two levels above the bricks are made of: the sums over the bricks below a cube.
typedef struct {
    Moments moments;
    Quadric quadric; // from the region's centre
    bool mergeable;
} CubeSums;

INLINED CubeSums no_cube_sums() {
    CubeSums sums;
    sums.moments = no_moments();
    sums.quadric = no_quadric();
    sums.mergeable = true;
    return sums;
}

// The region at hand.
typedef struct {
    ConstructTopArgs args;
    __global const SAMPLE *samples;
    __global const Region *region;
    int3 origin; // low corner in the volume
    int3 last;   // its last sample, from its first
    float3 spacing;
} RegionTask;

// The 27 samples of a cube at half its size, cut at the volume's last sample. `low`: from the region's low corner.
inline uint region_samples27(const RegionTask *task, int3 low, int half_size) {
    const Grid grid = task->args.grid;
    uint samples27 = 0;
    for (uint i = 0; i < 27; i++) {
        const int3 p = task->origin + low + (int3)((int)(i % 3), (int)(i / 3 % 3), (int)(i / 9)) * half_size;
        samples27 |= (uint)(sample_at(grid, task->samples, task->args.z0, clamp_sample(grid, p)) >= task->args.iso) << i;
    }
    return samples27;
}

// The vertex of a cube between `low` and `high`, in cells from the region's low corner: the quadric's minimum inside it.
inline VertexRecord cube_vertex(float3 spacing, const CubeSums *sums, float3 low, float3 high) {
    const float3 centre = (float3)(16.0f);
    const float3 x = clamp(centre + quadric_minimum(sums->quadric) / spacing, low + MARGIN, high - MARGIN);
    const float3 gradient = (float3)(sums->moments.g[0], sums->moments.g[1], sums->moments.g[2]);
    return make_vertex_record(x, gradient, quadric_error(sums->quadric, (x - centre) * spacing));
}

// Sums over the active bricks of a level-4 cube, `count` of them from `first` on.
inline CubeSums sum_bricks(const RegionTask *task, __global const Brick *bricks, __global const Moments *brick_moments,
                           __global const Quadric *brick_quadrics, __global const uchar *brick_mergeable, uint first, uint count) {
    CubeSums sums = no_cube_sums();
    for (uint i = first; i < first + count; i++) {
        add_moments(&sums.moments, brick_moments[i]);
        const float3 brick_centre = convert_float3(unmorton(bricks[i].morton << 9)) + 4.0f;
        add_quadric(&sums.quadric, shift_quadric(brick_quadrics[i], ((float3)(16.0f) - brick_centre) * task->spacing));
        // A brick without active cells, beside missing samples, does not forbid merging.
        sums.mergeable = sums.mergeable && (brick_mergeable[i] || brick_moments[i].n == 0);
    }
    return sums;
}

__kernel void construct_top(const ConstructTopArgs args, __global const SAMPLE *samples, __global const Region *regions,
                            __global const Brick *bricks, __global const Moments *brick_moments,
                            __global const Quadric *brick_quadrics, __global const uchar *brick_mergeable, __global Node *nodes,
                            __global VertexRecord *vertex_records, __global uint *totals) {
    if (get_global_id(0) >= args.region_count) return;
    __global const Region *region = regions + args.first_region + get_global_id(0);
    __global uint *total = totals + args.first_region + get_global_id(0);
    uint index = region->brick_base, slot = region->slot_base + region->level_base[4];
    if (!args.whole_pyramid) {
        uint n = 0, end = index + count_bricks(region);
        for (uint i = index; i < end; i++) n += brick_moments[i].n;
        *total = n;
        return;
    }
    RegionTask task;
    task.args = args;
    task.samples = samples;
    task.region = region;
    task.origin = convert_int3(region_origin(args.grid, region->region));
    task.last = clamp_sample(args.grid, task.origin + 32) - task.origin;
    task.spacing = (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]);
    CubeSums whole = no_cube_sums();
    for (uint cube = 0; cube < 8; cube++) {
        const uint count = popcount(region->brick_mask[cube >> 2] >> (8 * (cube & 3)) & 0xffu), cell = cube << 12;
        if (!count) continue;
        CubeSums sums = sum_bricks(&task, bricks, brick_moments, brick_quadrics, brick_mergeable, index, count);
        index += count;
        const int3 low = convert_int3(unmorton(cell));
        const bool missing = (region->missing_mask[cube >> 2] >> (8 * (cube & 3)) & 0xffu) != 0;
        const uint samples27 = region_samples27(&task, low, 8);
        sums.mergeable = sums.mergeable && safe_signs(samples27);
        nodes[slot] = make_node(sums.moments, 4, cell, corner_signs(samples27), missing, sums.mergeable);
        vertex_records[slot++] = cube_vertex(task.spacing, &sums, convert_float3(low), convert_float3(min(low + 16, task.last)));
        add_moments(&whole.moments, sums.moments);
        add_quadric(&whole.quadric, sums.quadric);
        whole.mergeable = whole.mergeable && sums.mergeable;
    }
    *total = whole.moments.n;
    const bool missing = (region->missing_mask[0] | region->missing_mask[1]) != 0;
    const uint samples27 = region_samples27(&task, (int3)(0), 16);
    nodes[slot] = make_node(whole.moments, 5, 0, corner_signs(samples27), missing, whole.mergeable && safe_signs(samples27));
    vertex_records[slot] = cube_vertex(task.spacing, &whole, (float3)(0.0f), convert_float3(task.last));
}

// The active brick at a place, in bricks, of the volume; NONE if there is none.
inline uint find_brick(Grid grid, __global const uint *region_index, __global const Region *regions, int3 at) {
    if (any(at < 0) || any(at * 8 + 1 >= (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]))) return NONE;
    const int3 r = at >> 2;
    const uint index = region_index[((uint)r.z * grid.regions[1] + (uint)r.y) * grid.regions[0] + (uint)r.x];
    if (index == NONE) return NONE;
    __global const Region *region = regions + index;
    const uint b = morton(convert_uint3(at & 3)), low = region->brick_mask[0], high = region->brick_mask[1];
    return test_bit64(low, high, b) ? region->brick_base + rank64(low, high, b) : NONE;
}

__kernel void link(const LinkArgs args, __global const uint *region_index, __global const Region *regions,
                   __global const Brick *bricks, __global uint *near) {
    const Grid grid = args.grid;
    const uint brick_count = args.brick_count;
    const uint index = (uint)(get_global_id(0) / 9), row = (uint)(get_global_id(0) % 9);
    if (index >= brick_count) return;
    const uint3 first = brick_origin(grid, regions[bricks[index].region].region, bricks[index].morton);
    const int3 from = convert_int3(first >> 3) + (int3)(-1, (int)(row % 3) - 1, (int)(row / 3) - 1);
    for (int x = 0; x < 3; x++)
        near[3 * get_global_id(0) + x] = find_brick(grid, region_index, regions, from + (int3)(x, 0, 0));
}
