// Phases of construct for the user feature (docs/algorithm.md#2-per-cell-quantities): the feature at the samples of a brick, then the
// mean over each active cell's corners. To be called before the cells are solved: its arrays share their bytes with theirs.
// Every phase is passed by every brick, with nothing to do where there is no feature: PoCL corrupts memory where barriers stand in
// branches.
//
// Arrays are blocks of 11^3 samples, a brick's 9^3 and a halo of one, x fastest.
#ifndef ISOPEEL_BRICK_FEATURE_H
#define ISOPEEL_BRICK_FEATURE_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/samples.h"

#define BLOCK_ROW 11
#define BLOCK_PLANE (11 * 11)
#define BLOCK_FIRST (BLOCK_PLANE + BLOCK_ROW + 1) // the brick's first sample
#define BLOCK_END (9 * BLOCK_PLANE + 9 * BLOCK_ROW + 10) // behind its last one

// Where the row of a block comes from: samples `first` to `last` of a row that exists, counted from the brick's first sample.
typedef struct {
    ulong index; // of the sample above the brick's first along x
    int first, last;
} BlockRow;

// Row `row` of a block, y fastest; false where it lies outside the volume.
INLINED bool find_block_row(const BrickTask *task, uint row, BlockRow *from) {
    const Grid grid = task->args.grid;
    const int3 p = task->origin + (int3)(0, (int)(row % 11) - 1, (int)(row / 11) - 1);
    if (p.y < 0 || p.z < 0 || p.y >= (int)grid.dims[1] || p.z >= (int)grid.dims[2]) return false;
    from->index = sample_index(grid, task->args.z0, p);
    from->first = p.x > 0 ? -1 : 0;
    from->last = min((int)grid.dims[0] - 1 - p.x, 9);
    return true;
}

// Copies a row of samples of any type into a block: NaN where a sample is missing or outside the volume.
#define COPY_BLOCK_ROW(from, samples, missing, to)                                                                     \
    if ((from).first == -1 && (from).last == 9) {                                                                      \
        const float8 v = convert_float8(vload8(0, (samples) + (from).index - 1));                                      \
        const float3 end = convert_float3(vload3(0, (samples) + (from).index + 7));                                    \
        vstore8(select(v, (float8)(NAN), v == (missing)), 0, to);                                                      \
        vstore3(select(end, (float3)(NAN), end == (missing)), 0, (to) + 8);                                            \
    } else for (int x = -1; x < 10; x++) {                                                                             \
        float v = NAN;                                                                                                 \
        if (x >= (from).first && x <= (from).last) v = (float)(samples)[(from).index + (ulong)(long)x];                \
        (to)[x + 1] = v == (missing) ? NAN : v;                                                                        \
    }

// Copies a row of the field that is the feature.
INLINED void copy_field_row(const BrickTask *task, BlockRow from, __local float *to) {
    const float missing = task->args.feature_missing;
    switch (task->args.feature_type) {
        case TYPE_U8: COPY_BLOCK_ROW(from, (__global const uchar *)task->feature, missing, to) break;
        case TYPE_I8: COPY_BLOCK_ROW(from, (__global const char *)task->feature, missing, to) break;
        case TYPE_U16: COPY_BLOCK_ROW(from, (__global const ushort *)task->feature, missing, to) break;
        case TYPE_I16: COPY_BLOCK_ROW(from, (__global const short *)task->feature, missing, to) break;
        default: COPY_BLOCK_ROW(from, (__global const float *)task->feature, missing, to)
    }
}

// Phase: a field as feature into `block`, without the halo; or into `samples` the field that the feature is derived from.
INLINED void load_blocks(const BrickTask *task, __local float *samples, __local float *block) {
    const uint kind = task->args.feature_kind, rows = kind == FEATURE_NONE ? 0 : kind == FEATURE_FIELD ? 81 : 121;
    ROLLED for (uint i = get_local_id(0); i < rows; i += BRICK_GROUP) {
        const uint row = kind == FEATURE_FIELD ? (i / 9 + 1) * 11 + i % 9 + 1 : i;
        BlockRow from;
        __local float *to = (kind == FEATURE_FIELD ? block : samples) + BLOCK_ROW * row;
        if (!find_block_row(task, row, &from)) {
            for (uint x = 0; x < BLOCK_ROW; x++) to[x] = NAN;
        } else if (kind == FEATURE_FIELD) copy_field_row(task, from, to);
        else COPY_BLOCK_ROW(from, task->samples, task->args.grid.missing, to)
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: a derived feature at the brick's samples, from those around them. Between two rows it is computed, too, for nothing.
INLINED void derive_feature(const BrickTask *task, __local const float *samples, __local float *block) {
    const uint kind = task->args.feature_kind, end = kind == FEATURE_NONE || kind == FEATURE_FIELD ? 0 : BLOCK_END;
    ROLLED for (uint i = BLOCK_FIRST + get_local_id(0) * LANES; i < end; i += BRICK_GROUP * LANES) {
        __local const float *at = samples + i;
        const real here = LOAD_LANES(at);
        const Real3 below = make_real3(LOAD_LANES(at - 1), LOAD_LANES(at - BLOCK_ROW), LOAD_LANES(at - BLOCK_PLANE));
        const Real3 above = make_real3(LOAD_LANES(at + 1), LOAD_LANES(at + BLOCK_ROW), LOAD_LANES(at + BLOCK_PLANE));
        STORE_LANES(derived_in_lanes(kind, here, below, above, task->spacing), block + i);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: the feature of each listed cell goes to its node. `corners`: 8 rows of CELLS columns.
INLINED void store_features(const BrickTask *task, const BrickMemory *memory, __local const float *block, __local float *corners) {
    const uint end = task->args.feature_kind == FEATURE_NONE ? 0 : task->cell_count;
    ROLLED for (uint first = get_local_id(0) * LANES; first < end; first += BRICK_GROUP * LANES) {
        __local float *column = corners + first % CELLS;
        for (uint i = 0; i < LANES; i++) {
            const int3 at = listed_cell(memory->cell_list[min(first + i, end - 1)]);
            __local const float *from = block + BLOCK_FIRST + (at.z * BLOCK_PLANE + at.y * BLOCK_ROW + at.x);
            for (uint corner = 0; corner < 8; corner++)
                column[corner * CELLS + i] = from[(corner & 1) + (corner >> 1 & 1) * BLOCK_ROW + (corner >> 2) * BLOCK_PLANE];
        }
        float means[LANES];
        real sum = 0.0f, count = 0.0f;
        for (uint corner = 0; corner < 8; corner++) {
            const real v = LOAD_LANES(column + corner * CELLS);
            sum += PICK(v == v, v, 0.0f);
            count += PICK(v == v, 1.0f, 0.0f);
        }
        STORE_LANES(PICK(count > 0.0f, sum / count, 0.0f), means);
        for (uint i = 0; i < LANES && first + i < end; i++) task->nodes[task->cell_slots + first + i].f = means[i];
    }
}

#endif
