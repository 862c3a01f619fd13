// derive: features that take more than a sample's six neighbours, or three fields, before construct, which finds them in the nodes
// (docs/algorithm.md#21-derived-features). In kernels of their own, they cost nothing if they are not used.
//
// derive: the feature of the active cells of a brick. One work-group a brick.
// derive_samples: the feature at samples, of which histogram is made. One work-group a block of 8^3 samples.
//
// Local memory: `blocks` has a block for each component, then one for the feature, DERIVE_BLOCK floats each; behind them, with UNEVEN defined,
// the tables of lib/steps.h.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/neighbourhood.h"
#include "lib/sample_block.h"
#include "lib/slots.h"
#include "lib/steps.h"

// Which neighbours of a sample its feature reads: none, those along the axes, or all of 3^3.
#define NEIGHBOURS_NONE 0
#define NEIGHBOURS_AXES 1
#define NEIGHBOURS_ALL 2
INLINED uint feature_neighbours(uint kind) {
    switch (kind) {
        case FEATURE_VECTOR_MAGNITUDE: return NEIGHBOURS_NONE;
        case FEATURE_MEAN_CURVATURE: case FEATURE_GAUSSIAN_CURVATURE: case FEATURE_LOCAL_VARIANCE: return NEIGHBOURS_ALL;
        default: return NEIGHBOURS_AXES;
    }
}

// Which cells along y have an active one in a brick's layer `z` of cells, one bit each. A word of 32 cells has 4 x 4 x 2 of them, in
// Morton order.
INLINED uint active_cell_rows(__global const Brick *brick, uint z) {
    uint rows = 0;
    for (uint i = 0; i < 4; i++) {
        const uint word = (z >> 1 & 1u) | i << 1 | (z >> 2) << 3;
        const uint cells = brick->cells[word] >> 4 * (z & 1u) & 0x0f0f0f0fu, pairs = cells | cells >> 8;
        const uint found = (pairs & 3u ? 1u : 0u) | (pairs & 12u ? 2u : 0u) | (pairs >> 16 & 3u ? 4u : 0u) | (pairs >> 16 & 12u ? 8u : 0u);
        rows |= found << 4 * (i >> 1);
    }
    return rows;
}

// Phases: the rows of a block that corners of active cells are in, and those that features there are computed from: of each plane along z one
// bit a row.
INLINED void want_rows(__global const Brick *brick, uint kind, __local uint *cell_rows, __local uint *corners, __local uint *loaded) {
    ROLLED for (uint z = get_local_id(0); z < 8; z += BRICK_GROUP) cell_rows[z] = active_cell_rows(brick, z);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    // The corners of cell i are samples i + 1 and i + 2 of a block.
    ROLLED for (uint plane = get_local_id(0); plane < BLOCK_ROW; plane += BRICK_GROUP) {
        const uint cells = (plane >= 2 && plane < 10 ? cell_rows[plane - 2] : 0) | (plane >= 1 && plane < 9 ? cell_rows[plane - 1] : 0);
        corners[plane] = cells << 1 | cells << 2;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    const uint neighbours = feature_neighbours(kind);
    ROLLED for (uint plane = get_local_id(0); plane < BLOCK_ROW; plane += BRICK_GROUP) {
        const uint own = corners[plane], beside = (plane > 0 ? corners[plane - 1] : 0) | (plane < BLOCK_ROW - 1 ? corners[plane + 1] : 0);
        const uint all = own | beside;
        loaded[plane] = neighbours == NEIGHBOURS_NONE ? own
            : neighbours == NEIGHBOURS_AXES ? all | own << 1 | own >> 1 : all | all << 1 | all >> 1;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: the samples of the components around the brick at `origin`, in the rows that are wanted.
INLINED void load_components(DeriveArgs args, int3 origin, __global const void *samples_x, __global const void *samples_y,
                             __global const void *samples_z, __local const uint *rows, __local float *blocks) {
    ROLLED for (uint row = get_local_id(0); row < BLOCK_PLANE; row += BRICK_GROUP) {
        if (!(rows[row / BLOCK_ROW] >> row % BLOCK_ROW & 1u)) continue;
        const BlockRow from = find_block_row(args.grid, args.z0, origin, row);
        __local float *to = blocks + BLOCK_ROW * row;
        COPY_TYPED_BLOCK_ROW(from, samples_x, args.type_x, args.missing_x, to)
        if (args.components == 1) continue;
        COPY_TYPED_BLOCK_ROW(from, samples_y, args.type_y, args.missing_y, to + DERIVE_BLOCK)
        COPY_TYPED_BLOCK_ROW(from, samples_z, args.type_z, args.missing_z, to + 2 * DERIVE_BLOCK)
    }
}

// Bytes of a sample of this type.
INLINED uint sample_bytes(uint type) { return type == TYPE_U8 || type == TYPE_I8 ? 1 : type == TYPE_F32 ? 4 : 2; }

// Phase on a CPU: loads the rows that load_components will read into the caches, both ends of each.
INLINED void prefetch_components(DeriveArgs args, int3 origin, __global const void *samples_x, __global const void *samples_y,
                                 __global const void *samples_z, __local const uint *rows) {
    __global const void *samples[3] = {samples_x, samples_y, samples_z};
    const uint bytes[3] = {sample_bytes(args.type_x), sample_bytes(args.type_y), sample_bytes(args.type_z)};
    for (uint plane = 0; plane < BLOCK_ROW; plane++)
        for (uint rest = rows[plane]; rest; rest &= rest - 1) {
            const long along_z = (long)(origin.z - (int)args.z0 + (int)plane - 1) * args.grid.dims[1];
            const long first = (along_z + origin.y + (int)lowest_bit(rest) - 1) * args.grid.dims[0] + origin.x - 1;
            for (uint i = 0; i < args.components; i++) {
                __global const uchar *row = (__global const uchar *)samples[i] + first * bytes[i];
                prefetch_line(row);
                prefetch_line(row + (BLOCK_ROW - 1) * bytes[i]);
            }
        }
}

// A corner of a cell from its low one, in samples of a block.
INLINED uint corner_step(uint corner) { return (corner & 1) + (corner >> 1 & 1) * BLOCK_ROW + (corner >> 2) * BLOCK_PLANE; }

// The first sample of a level-1 cube in a block, from the brick's first. Its cells lie as the corners of a cell: see corner_step.
INLINED uint cube_sample(uint cube) {
    const uint3 p = unmorton(cube << 3);
    return p.z * BLOCK_PLANE + p.y * BLOCK_ROW + p.x;
}

// Parts of LANES samples of a brick's plane, those of its block between its first and last sample.
#define PLANE_PARTS ((9 * BLOCK_ROW - 2 + LANES - 1) / LANES)

// Phases: computes the feature at samples of the brick and writes it to the last block, which it returns. Computes whole parts of LANES
// samples: those that contain samples of the rows `wanted`, for which the components have been loaded.
INLINED __local float *derive_block(DeriveArgs args, LENGTHS int3 origin, __local const uint *wanted, __local float *blocks) {
    const uint lid = get_local_id(0);
    __local float *values = blocks + args.components * DERIVE_BLOCK, *tables = values + DERIVE_BLOCK;
    load_step_tables(args.grid, LENGTHS_ARGS origin, tables);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint i = lid; i < 9 * PLANE_PARTS; i += BRICK_GROUP) {
        // The first part of a plane begins with its first row that is wanted.
        const uint plane = i / PLANE_PARTS + 1, rows = wanted[plane], in_plane = BLOCK_ROW * lowest_bit(rows) + 1 + i % PLANE_PARTS * LANES;
        const uint first_row = in_plane / BLOCK_ROW, last_row = (in_plane + LANES - 1) / BLOCK_ROW;
        if (!(rows & ((2u << last_row) - (1u << first_row)))) continue;
        const uint at = BLOCK_PLANE * plane + in_plane;
        Steps steps;
        load_steps(&steps, args.grid, tables, plane, in_plane);
        STORE_LANES(neighbourhood_feature(args.kind, blocks + at, steps), values + at);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    return values;
}

// Mean over the corners of a cell that are not missing; 0 if all are. `at`: its low corner.
INLINED float corner_mean(__local const float *at) {
    // Two corners along x lie side by side.
    const float2 low = vload2(0, at) + vload2(0, at + BLOCK_ROW);
    const float2 pairs = low + (vload2(0, at + BLOCK_PLANE) + vload2(0, at + BLOCK_PLANE + BLOCK_ROW));
    const float whole = pairs.x + pairs.y;
    if (whole == whole) return whole * 0.125f;
    float sum = 0.0f, count = 0.0f;
    for (uint corner = 0; corner < 8; corner++) {
        const float v = at[corner_step(corner)];
        sum += v == v ? v : 0.0f;
        count += v == v ? 1.0f : 0.0f;
    }
    return count > 0.0f ? sum / count : 0.0f;
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void derive(const DeriveArgs args, LENGTHS __global const void *x, __global const void *y, __global const void *z,
            __global const Region *regions, __global const Brick *bricks, __global Node *nodes, __local float *blocks) {
    __global const Brick *brick = bricks + args.first + get_group_id(0);
    __global const Region *region = regions + brick->region;
    const int3 origin = convert_int3(brick_origin(args.grid, region->region, brick->morton));
    __local uint cell_rows[8], wanted[BLOCK_ROW], next_wanted[BLOCK_ROW], loaded[BLOCK_ROW];
    want_rows(brick, args.kind, cell_rows, wanted, loaded);
    load_components(args, origin, x, y, z, loaded, blocks);
    if (PREFETCHES) { // for the next work-group
        __global const Brick *next = brick + (get_group_id(0) + 1 < get_num_groups(0));
        want_rows(next, args.kind, cell_rows, next_wanted, loaded);
        prefetch_components(args, convert_int3(brick_origin(args.grid, regions[next->region].region, next->morton)), x, y, z, loaded);
    }
    __local const float *values = derive_block(args, LENGTHS_ARGS origin, wanted, blocks);
    __global Node *cells = nodes + region->slot_base + brick->level_base[0];
    ROLLED for (uint cube = get_local_id(0); cube < 64; cube += BRICK_GROUP) {
        if (!level1_cells(brick, cube)) continue;
        uint at = cells_before_level1(brick, cube);
        __local const float *first = values + BLOCK_FIRST + cube_sample(cube);
        ROLLED for (uint rest = level1_cells(brick, cube); rest; rest &= rest - 1, at++)
            cells[at].f = corner_mean(first + corner_step(lowest_bit(rest)));
    }
}

// `planes` planes from `first` on, a multiple of 8, into `out`.
__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void derive_samples(const DeriveArgs args, LENGTHS __global const void *x, __global const void *y, __global const void *z,
                    __global float *out, __local float *blocks) {
    const uint nx = args.grid.dims[0], ny = args.grid.dims[1], across = (nx + 7) / 8, along = (ny + 7) / 8;
    const uint group = (uint)get_group_id(0), column = group % across, row = group / across % along, layer = group / across / along;
    const uint3 low = (uint3)(8 * column, 8 * row, 8 * layer);
    const int3 origin = convert_int3(low) + (int3)(0, 0, (int)args.first);
    __local uint loaded[BLOCK_ROW], wanted[BLOCK_ROW];
    ROLLED for (uint i = get_local_id(0); i < BLOCK_ROW; i += BRICK_GROUP) {
        loaded[i] = (1u << BLOCK_ROW) - 1;
        wanted[i] = ((1u << 9) - 1) << 1;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    load_components(args, origin, x, y, z, loaded, blocks);
    __local const float *values = derive_block(args, LENGTHS_ARGS origin, wanted, blocks);
    ROLLED for (uint i = get_local_id(0); i < 512; i += BRICK_GROUP) {
        const uint3 p = low + (uint3)(i & 7u, i >> 3 & 7u, i >> 6);
        if (p.x >= nx || p.y >= ny || p.z >= args.planes) continue;
        out[((ulong)p.z * ny + p.y) * nx + p.x] = values[BLOCK_FIRST + (i >> 6) * BLOCK_PLANE + (i >> 3 & 7u) * BLOCK_ROW + (i & 7u)];
    }
}
