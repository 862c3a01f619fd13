// fit: number of leaves of a cut as a function of its threshold, for budgets of triangles (docs/algorithm.md#42-budgets). One work-group a
// region, from level 5 down.
// In: parameters, control points of the transfer function, regions of interest, nodes, vertex records. Out: changes[bin], the change of
// the number of leaves when the threshold passes the bin; keys[slot], working memory.
//
// A *key* is the bit pattern of the number that is compared with the threshold (decimation_key): keys are ordered as these numbers are. A
// node is a leaf from its own key on, up to the minimum of the keys of the cubes above it.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/fit_bins.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/slots.h"

#define NO_KEY 0xffffffffu // of a node that is never a leaf

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void fit(const FitArgs args, __constant float2 *points, __constant Interest *interests, __global const Region *regions,
         __global const Brick *bricks, __global const Node *nodes, __global const VertexRecord *vertex_records,
         __global uint *keys, __global int *changes) {
    __local int bins[FIT_BINS];
    const uint lid = get_local_id(0);
    __global const Region *region = regions + get_group_id(0);
    CutCriterion criterion;
    find_criterion(&criterion, args.grid, args.params, points, interests, region->region);
    const uint slots = region->slot_base;
    for (uint i = lid; i < FIT_BINS; i += GROUP) bins[i] = 0;
    for (uint level = 5; level > 0; level--) {
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        for (uint i = region->level_base[level] + lid; i < region->level_base[level + 1]; i += GROUP) {
            const Node node = nodes[slots + i];
            const uint cell = code_cell(meta_code(node.meta), level);
            const uint above = level == 5 ? NO_KEY : keys[find_slot(region, bricks, level + 1, cell)];
            uint own = NO_KEY;
            const float error = counted_error(&criterion, node, level, vertex_records[slots + i].error);
            if (node.count > 0 && !meta_missing(node.meta) && may_decimate(criterion.params, node, level, error))
                own = as_uint(decimation_key(&criterion, node, level, error));
            if (own < above) {
                atomic_inc(&bins[bin_of_key(own, args.first_key, args.shift)]);
                if (above != NO_KEY) atomic_dec(&bins[bin_of_key(above, args.first_key, args.shift)]);
            }
            keys[slots + i] = min(own, above);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    const uint brick_count = count_bricks(region);
    for (uint b = lid; b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        uint cube = slots + brick->level_base[1];
        for (uint side = 0; side < 2; side++) {
            for (uint rest = brick->level1_mask[side]; rest; rest &= rest - 1) {
                const uint above = keys[cube++], cells = popcount(level1_cells(brick, side << 5 | lowest_bit(rest)));
                if (above != NO_KEY) atomic_sub(&bins[bin_of_key(above, args.first_key, args.shift)], (int)cells);
            }
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < FIT_BINS; i += GROUP)
        if (bins[i]) atomic_add(&changes[i], bins[i]);
}
