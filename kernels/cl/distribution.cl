// distribution: histogram of the blended feature of a cut's leaves over the surface. One work-group a region.
//
//   kernel              counts
//   distribution_cut    active cells, by the leaf of the octree that represents them
//   distribution_tree   points, by the leaf of the vertex tree that represents them
//
// In: parameters, the cut. Out: counts[bin], of all; counts[args.bins + bin], of those whose leaf represents others too.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/slots.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

#define MAX_BINS 256

inline void clear_bins(__local uint *bins) {
    for (uint i = get_local_id(0); i < 2 * MAX_BINS; i += GROUP) bins[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
}

inline void count_value(const DistributionArgs args, __local uint *bins, float s, float f, bool is_coarse) {
    const float blended = blended_feature(args.params, s, f);
    const uint bin = min((uint)(fmax(blended, 0.0f) * (float)args.bins), args.bins - 1);
    add_local(&bins[bin], 1);
    if (is_coarse) add_local(&bins[args.bins + bin], 1);
}

inline void add_bins(const DistributionArgs args, __local const uint *bins, __global uint *counts) {
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < 2 * args.bins; i += GROUP)
        if (bins[i]) atomic_add(&counts[i], bins[i]);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void distribution_cut(const DistributionArgs args, __global const Region *regions, __global const Brick *bricks,
                      __global const Node *nodes, __global const uchar *state, __global uint *counts) {
    __local uint bins[2 * MAX_BINS];
    clear_bins(bins);
    __global const Region *region = regions + get_group_id(0);
    for (uint i = region->level_base[0] + get_local_id(0); i < region->level_base[1]; i += GROUP) {
        uint slot = region->slot_base + i;
        const uint level = state[slot];
        if (level > 0) slot = find_slot(region, bricks, level, code_cell(meta_code(nodes[slot].meta), 0));
        count_value(args, bins, nodes[slot].s, nodes[slot].f, level > 0);
    }
    add_bins(args, bins, counts);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void distribution_tree(const DistributionArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                       __global const TreeNode *tree_nodes, __global const int4 *points, __global const Node *nodes,
                       __global const uint *leaves, __global uint *counts) {
    __local uint bins[2 * MAX_BINS];
    clear_bins(bins);
    TreePoints own;
    find_points(&own, regions + get_group_id(0), tree_regions + get_group_id(0));
    for (uint i = get_local_id(0); i < count_points(own); i += GROUP) {
        const uint leaf = leaf_number(leaves[nth_point(own, i)]);
        if (leaf == LEAF_REMOVED) continue;
        if (leaf < args.points) {
            const Node node = nodes[(uint)points[leaf].w];
            count_value(args, bins, node.s, node.f, false);
        } else {
            const TreeNode node = tree_nodes[leaf - args.points];
            count_value(args, bins, (float)(node.normal_s >> 16) / 65535.0f, node.f, true);
        }
    }
    add_bins(args, bins, counts);
}
