// curve: how the estimated error of a cut grows with its threshold. Some work-groups share the regions.
// In: keys of nodes, as `fit` and `tree_keys` make them. Out, of each work-group: changes[bin], weighted squared errors of the leaves that
// come less those of the leaves that go once the threshold passes the bin; bins are those of lib/fit_bins.h.
//
//   kernel       leaves of              squared errors are weighted by
//   curve_cut    cuts of cubes          triangles of the undecimated surface, as `cut` does; the first bin has those of all cells
//   curve_tree   cuts of the tree       area, as `tree_sum` does

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/fit_bins.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/slots.h"
#include "lib/tree_key.h"

#define NO_KEY 0xffffffffu // of a node that is never a leaf

inline void clear_changes(__local float *bins) {
    for (uint i = get_local_id(0); i < FIT_BINS; i += GROUP) bins[i] = 0.0f;
    barrier(CLK_LOCAL_MEM_FENCE);
}

inline void write_changes(__local const float *bins, __global float *changes) {
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < FIT_BINS; i += GROUP) changes[get_group_id(0) * FIT_BINS + i] = bins[i];
}

// A leaf from key `own` on, up to `above`.
inline void add_change(const CurveArgs args, __local float *bins, uint own, uint above, float value) {
    const uint from = bin_of_key(own, args.first_key, args.shift), to = bin_of_key(above, args.first_key, args.shift);
    if (above != NO_KEY && from == to) return;
    add_local_float(&bins[from], value);
    if (above != NO_KEY) add_local_float(&bins[to], -value);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void curve_cut(const CurveArgs args, __constant float2 *points, __constant Interest *interests, __global const Region *regions,
               __global const Brick *bricks, __global const Node *nodes, __global const VertexRecord *vertex_records,
               __global const uint *keys, __global float *changes) {
    __local float bins[FIT_BINS];
    clear_changes(bins);
    for (uint index = (uint)get_group_id(0); index < args.regions; index += (uint)get_num_groups(0)) {
        __global const Region *region = regions + index;
        CutCriterion criterion;
        find_criterion(&criterion, args.grid, args.params, points, interests, region->region);
        uint level = 0;
        for (uint i = get_local_id(0); i < region->level_base[6]; i += GROUP) {
            while (i >= region->level_base[level + 1]) level++;
            const uint slot = region->slot_base + i;
            const Node node = nodes[slot];
            const uint cell = code_cell(meta_code(node.meta), level);
            const uint above = level == 5 ? NO_KEY : keys[find_slot(region, bricks, level + 1, cell)];
            const uint own = level == 0 ? 0 : keys[slot];
            if (level > 0 && own >= above) continue;
            const float error = level == 0 ? vertex_records[slot].error
                                           : counted_error(&criterion, node, level, vertex_records[slot].error);
            const uint triangles = level == 0 ? node.count & 0xffu : node.count;
            add_change(args, bins, own, above, (float)triangles * error * error);
        }
    }
    write_changes(bins, changes);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void curve_tree(const CurveArgs args, __global const TreeRegion *tree_regions, __global const uint *node_errors,
                __global const uint *node_parents, __global const uint *keys, __global float *changes) {
    __local float bins[FIT_BINS];
    clear_changes(bins);
    const uint never = as_uint(INFINITY);
    for (uint index = (uint)get_group_id(0); index < args.regions; index += (uint)get_num_groups(0)) {
        __global const TreeRegion *tree = tree_regions + index;
        for (uint i = get_local_id(0); i < tree->nodes; i += GROUP) {
            const uint at = tree->node_base + i, own = key_bits(keys[at]), parent = node_parents[at];
            if (own >= never) continue;
            const uint above = parent == NONE ? never : key_bits(keys[parent]);
            const float error = key_of(node_errors[at]);
            add_change(args, bins, own, above < never ? above : NO_KEY, error * error);
        }
    }
    write_changes(bins, changes);
}
