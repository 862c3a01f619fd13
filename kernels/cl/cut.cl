// cut: which nodes are the leaves of the cut (docs/algorithm.md#4-importance-and-cut). One work-group a region, from level 5 down.
// In: parameters, control points of the transfer function, nodes, vertex records. Out: state[slot], the level of the leaf that
// covers the node (its own level: it is a leaf) or INTERNAL where leaves are below it; counters.

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/slots.h"

inline float transfer(__constant float2 *points, uint count, float x) {
    uint right = 0;
    while (right < count && points[right].x <= x) right++;
    if (right == 0) return points[0].y;
    if (right == count) return points[count - 1].y;
    const float2 a = points[right - 1], b = points[right];
    return a.y + (b.y - a.y) * exact_quotient(x - a.x, b.x - a.x);
}

inline float importance(CutParams params, __constant float2 *points, float s, float f) {
    const float x = (1.0f - params.alpha) * s + params.alpha * normalised_feature(params, f);
    return transfer(points, params.points, x);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void cut(const CutParams params, __constant float2 *points, __global const Region *regions,
         __global const Brick *bricks, __global const Node *nodes, __global const VertexRecord *vertex_records,
         __global uchar *state, __global Counters *counters) {
    __local uint leaves[6], lost;
    const uint lid = get_local_id(0);
    __global const Region *region = regions + get_group_id(0);
    const uint slots = region->slot_base;
    for (uint i = lid; i < 6; i += GROUP) leaves[i] = 0;
    if (lid == 0) lost = 0;
    // No importance is below 0: then cells are the leaves. Nodes of other levels are not read, and may not have been constructed.
    const bool in_full = params.beta < 0.0f && params.prefix == 0;
    for (int level = 5; level > 0; level--) {
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        uint count = 0, empty = 0;
        for (uint i = region->level_base[level] + lid; i < region->level_base[level + 1]; i += GROUP) {
            if (in_full) {
                state[slots + i] = INTERNAL;
                continue;
            }
            const Node node = nodes[slots + i];
            const uint cell = code_cell(meta_code(node.meta), (uint)level);
            uint result = level == 5 ? INTERNAL : state[find_slot(region, bricks, (uint)level + 1, cell)];
            if (result == INTERNAL && node.count > 0) {
                const bool whole = !meta_missing(node.meta);
                if (whole && (level == (int)params.prefix
                              || (level <= (int)params.max_level
                                  && (!params.preserve || meta_safe(node.meta))
                                  && !(vertex_records[slots + i].error > params.max_error)
                                  && importance(params, points, node.s, node.f) <= params.beta))) {
                    result = (uint)level;
                    count++;
                    const uint signs = meta_signs(node.meta);
                    if (signs == 0 || signs == 255) empty++;
                }
            }
            state[slots + i] = (uchar)result;
        }
        if (count) atomic_add(&leaves[level], count);
        if (empty) atomic_add(&lost, empty);
    }
    // Active cells are leaves where their level-1 cube is INTERNAL. Cells and cubes have the same order.
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    uint cells = 0;
    const uint brick_count = count_bricks(region);
    for (uint b = lid; b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        uint cube = slots + brick->level_base[1], slot = slots + brick->level_base[0];
        for (uint side = 0; side < 2; side++) {
            for (uint rest = brick->level1_mask[side]; rest; rest &= rest - 1) {
                const uint above = state[cube++], end = slot + popcount(level1_cells(brick, side << 5 | lowest_bit(rest)));
                if (above == INTERNAL) cells += end - slot;
                for (; slot < end; slot++) state[slot] = (uchar)(above == INTERNAL ? 0 : above);
            }
        }
    }
    if (cells) atomic_add(&leaves[0], cells);
    // An extra sheet has the state of its cell.
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = region->level_base[6] + lid; i < region->level_base[7]; i += GROUP)
        state[slots + i] = state[find_slot(region, bricks, 0, code_cell(meta_code(nodes[slots + i].meta), 0))];
    for (uint i = lid; i < 6; i += GROUP)
        if (leaves[i]) atomic_add(&counters->leaves[i], leaves[i]);
    if (lid == 0 && lost) atomic_add(&counters->lost_cubes, lost);
}
