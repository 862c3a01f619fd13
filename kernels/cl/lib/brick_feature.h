// Phases of construct for the user feature (docs/algorithm.md#2-per-cell-quantities): the feature at the samples of a brick, then the
// mean over each active cell's corners. To be called before the cells are solved: its arrays share their bytes with theirs.
// Every phase is passed by every brick, with nothing to do if there is no feature: PoCL corrupts memory if barriers stand in
// branches.
// Features of `derive` are in the nodes already.
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
#include "lib/sample_block.h"

// Phase: a field as feature into `block`, without the halo; or into `samples` the field that the feature is derived from.
INLINED void load_blocks(const BrickTask *task, __local float *samples, __local float *block) {
    const uint kind = task->args.feature_kind, rows = kind == FEATURE_FIELD ? 81 : kind == FEATURE_GRADIENT ? 121 : 0;
    ROLLED for (uint i = get_local_id(0); i < rows; i += BRICK_GROUP) {
        const uint row = kind == FEATURE_FIELD ? (i / 9 + 1) * 11 + i % 9 + 1 : i;
        const BlockRow from = find_block_row(task->args.grid, task->args.z0, task->origin, row);
        __local float *to = (kind == FEATURE_FIELD ? block : samples) + BLOCK_ROW * row;
        if (kind == FEATURE_FIELD) {
            COPY_TYPED_BLOCK_ROW(from, task->feature, task->args.feature_type, task->args.feature_missing, to)
        } else COPY_BLOCK_ROW(from, task->samples, task->args.grid.missing, to)
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: a derived feature at the brick's samples, from those around them. Between two rows it is computed, too, for nothing.
INLINED void derive_feature(const BrickTask *task, __local const float *samples, __local float *block) {
    const uint kind = task->args.feature_kind, end = kind == FEATURE_GRADIENT ? BLOCK_END : 0;
    ROLLED for (uint i = BLOCK_FIRST + get_local_id(0) * LANES; i < end; i += BRICK_GROUP * LANES) {
        __local const float *at = samples + i;
        const real here = LOAD_LANES(at);
        const Real3 below = make_real3(LOAD_LANES(at - 1), LOAD_LANES(at - BLOCK_ROW), LOAD_LANES(at - BLOCK_PLANE));
        const Real3 above = make_real3(LOAD_LANES(at + 1), LOAD_LANES(at + BLOCK_ROW), LOAD_LANES(at + BLOCK_PLANE));
        STORE_LANES(derived_in_lanes(kind, here, below, above, task->spacing), block + i);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Phase: the feature of each listed cell goes to its node. `corners`: 8 rows of CELLS columns.
INLINED void store_features(const BrickTask *task, const BrickMemory *memory, __local const float *block, __local float *corners) {
    const uint kind = task->args.feature_kind, end = kind == FEATURE_NONE || kind == FEATURE_STORED ? 0 : task->cell_count;
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
