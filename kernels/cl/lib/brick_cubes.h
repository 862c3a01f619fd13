// Phases of construct for the cubes of levels 1 to 3 of a brick: sums, whether they may be merged, nodes and vertices.
#ifndef ISOPEEL_BRICK_CUBES_H
#define ISOPEEL_BRICK_CUBES_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/cube_solver.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/merge.h"
#include "lib/moments.h"
#include "lib/morton.h"
#include "lib/slots.h"
#include "lib/vertex_record.h"

// A cube's sums from its column.
INLINED Moments column_moments(__local const float *column) {
    Moments m;
    for (uint i = 0; i < 3; i++) m.g[i] = column[(CUBE_SLOPE + i) * CUBES];
    m.q = column[CUBE_SLOPED * CUBES];
    m.f = column[CUBE_FEATURE * CUBES];
    m.n = (uint)column[CUBE_COUNT * CUBES];
    return m;
}
INLINED Quadric column_quadric(__local const float *column) {
    Quadric q;
    column += CUBE_QUADRIC * CUBES;
    for (uint i = 0; i < 6; i++) q.a[i] = column[i * CUBES];
    for (uint i = 0; i < 3; i++) {
        q.b[i] = column[(6 + i) * CUBES];
        q.m[i] = column[(10 + i) * CUBES];
    }
    q.c = column[9 * CUBES];
    q.k = column[13 * CUBES];
    return q;
}

// Phase: sums of the level-2 cubes from those of level 1, then of the brick. Needs no barrier at its end: the next phase reads
// other rows.
INLINED void sum_cubes(const BrickTask *task, const BrickMemory *memory, uint rows) {
    const uint lid = get_local_id(0), level1_count = task->level1_count, level2_end = level1_count + task->level2_count;
    __local float *cubes = memory->cubes;
    ROLLED for (uint i = lid; i < 8 * rows; i += BRICK_GROUP) {
        const uint cube = i & 7, row = i >> 3;
        if (!(task->brick->level2_mask >> cube & 1u)) continue;
        const uint from = level1_column(task->brick, 8 * cube), to = from + popcount(level1_below(task->brick, cube));
        float sum = 0.0f;
        ROLLED for (uint j = from; j < to; j++) sum += cubes[row * CUBES + j];
        cubes[row * CUBES + level2_column(task, cube)] = sum;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint row = lid; row < rows; row += BRICK_GROUP) {
        float sum = 0.0f;
        ROLLED for (uint j = level1_count; j < level2_end; j++) sum += cubes[row * CUBES + j];
        cubes[row * CUBES + level2_end] = sum;
    }
}

// The 27 samples of a cube of the brick at half its size; rows of samples repeat the volume's last one beyond it.
INLINED uint tile_samples27(__local const ushort *inside_rows, int3 low, int half_size) {
    uint samples27 = 0;
    for (int i = 0; i < 9; i++) {
        const uint row = inside_rows[(low.z + i / 3 * half_size) * 9 + low.y + i % 3 * half_size] >> low.x;
        samples27 |= ((row & 1u) | (row >> half_size & 1u) << 1 | (row >> (2 * half_size) & 1u) << 2) << (3 * i);
    }
    return samples27;
}

// Phase: corner signs and extent of every cube, and which may be merged: those whose samples allow it and all cubes below too.
// Returns whether the brick may.
INLINED bool find_mergeable(const BrickTask *task, const BrickMemory *memory) {
    const uint lid = get_local_id(0);
    ROLLED for (uint column = lid; column < task->cube_count; column += BRICK_GROUP) {
        if (!task->args.whole) break;
        const uint level = cube_level(memory->cube_ids[column]), number = cube_morton(memory->cube_ids[column]), size = 1u << level;
        const int3 low = convert_int3(unmorton(number << (3 * level))), high = min(low + (int)size, task->last);
        const uint samples27 = tile_samples27(memory->inside_rows, low, (int)size / 2);
        memory->cube_signs[column] = (uchar)corner_signs(samples27);
        if (!safe_signs(samples27))
            memory->mergeable[level == 1 ? number : level == 2 ? MERGEABLE_LEVEL2 + number : MERGEABLE_BRICK] = 0;
        __local float *box = memory->cubes + CUBE_LOW * CUBES + column;
        box[0] = (float)low.x;
        box[CUBES] = (float)low.y;
        box[2 * CUBES] = (float)low.z;
        box[3 * CUBES] = (float)high.x;
        box[4 * CUBES] = (float)high.y;
        box[5 * CUBES] = (float)high.z;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint cube = lid; cube < 8; cube += BRICK_GROUP) {
        bool all_below = true;
        ROLLED for (uint i = 8 * cube; i < 8 * cube + 8; i++) all_below = all_below && memory->mergeable[i];
        if (!all_below) memory->mergeable[MERGEABLE_LEVEL2 + cube] = 0;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    bool brick = memory->mergeable[MERGEABLE_BRICK];
    for (uint cube = 0; cube < 8; cube++) brick = brick && memory->mergeable[MERGEABLE_LEVEL2 + cube];
    return brick;
}

// Does a cube touch a missing sample?
INLINED bool cube_missing(__global const Brick *brick, uint level, uint number) {
    if (level == 1) return test_bit64(brick->level1_missing[0], brick->level1_missing[1], number);
    if (level == 2) return (brick->level1_missing[number >> 2] >> (8 * (number & 3)) & 0xffu) != 0;
    return (brick->level1_missing[0] | brick->level1_missing[1]) != 0;
}

// Phase: nodes of the cubes; cells get the smoothness of their level-1 cube.
INLINED void store_cube_nodes(const BrickTask *task, const BrickMemory *memory, bool mergeable_brick) {
    const uint work = task->running_sums ? 0 : task->cube_count;
    ROLLED for (uint column = get_local_id(0); column < work; column += BRICK_GROUP) {
        const uint level = cube_level(memory->cube_ids[column]), number = cube_morton(memory->cube_ids[column]);
        if (!task->args.whole && level > 1) continue;
        const bool mergeable = level == 1 ? memory->mergeable[number]
            : level == 2 ? memory->mergeable[MERGEABLE_LEVEL2 + number] : mergeable_brick;
        const Node node = make_node(column_moments(memory->cubes + column), level, task->morton | number << (3 * level),
                                    memory->cube_signs[column], cube_missing(task->brick, level, number), mergeable);
        if (task->args.whole) task->nodes[cube_slot(task, column)] = node;
        if (level > 1) continue;
        const uint begin = task->cell_slots + cells_before_level1(task->brick, number);
        const uint end = begin + popcount(level1_cells(task->brick, number));
        ROLLED for (uint i = begin; i < end; i++) task->nodes[i].s = node.s;
    }
}

// Phase: vertex records of the cubes.
INLINED void store_cube_vertices(const BrickTask *task, const BrickMemory *memory) {
    const uint lid = get_local_id(0), work = task->args.whole ? task->cube_count : 0;
    ROLLED for (uint column = lid * LANES; column < work; column += BRICK_GROUP * LANES)
        solve_cubes(memory->cubes, column, task->spacing);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint column = lid; column < work; column += BRICK_GROUP) {
        __local const float *solved = memory->cubes + column;
        const float3 x = (float3)(solved[CUBE_VERTEX * CUBES], solved[(CUBE_VERTEX + 1) * CUBES], solved[(CUBE_VERTEX + 2) * CUBES]);
        task->vertex_records[cube_slot(task, column)] = quantise_vertex(
            convert_float3(task->in_region) + x, (uint)solved[CUBE_NORMAL * CUBES], solved[CUBE_ERROR * CUBES]);
    }
}

#endif
