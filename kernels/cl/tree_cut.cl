// tree_cut: cuts of the vertex tree (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group a block. A launch has the blocks of one
// level: nodes are weighed from the lowest level on, keys and leaves found from the highest one on. tree_test.cl tests a cut, tree_mesh.cl
// makes its mesh.
//
//   kernel          writes
//   tree_weigh      of each node the maximum importance of its points
//   tree_lower      of each node above the regions the minimum weight of its points' regions
//   tree_keys       of each node its key
//   tree_histogram  triangles that are removed as the tolerance grows
//   tree_leaves     the leaf of each point
//   tree_sum        sums over the leaves
//
// A node's *key* is the tolerance from which on it is merged: the minimum of error over weight, of its own and of the nodes above
// it. So the topmost node that the tolerance allows is the leaf. No tolerance merges marked nodes.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/fit_bins.h"
#include "lib/grid.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/scan.h"
#include "lib/tree_key.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

// Raises the number of a node above one of `tree`. Other blocks raise those of levels above as well.
inline void raise_node(__global const TreeRegion *tree, __global uint *numbers, uint node, uint value) {
    if (node - tree->node_base < tree->nodes) max_global(&numbers[node], value);
    else atomic_max(&numbers[node], value);
}

// `importances`: bits of floats of 0 or more, which are ordered as the floats are; cleared before the first level.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_weigh(const TreeWeighArgs args, __constant float2 *transfer_points, __constant Interest *interests,
                __global const Region *regions, __global const TreeRegion *tree_regions, __global const uint *node_parents,
                __global const uint *round_ends, __global const uint *point_parents, __global const int4 *points,
                __global const Node *nodes, __global uint *importances) {
    const uint lid = get_local_id(0), group = args.first_block + (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_block_points(&own, regions, args.regions, tree_regions, group);
    for (uint i = lid; i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i), parent = point_parents[point];
        if (parent == NONE) continue;
        const Node node = nodes[(uint)points[point].w];
        const float own_importance = clamp(importance(args.params, transfer_points, node.s, node.f), 0.0f, 1.0f);
        const float3 at = convert_float3(points[point].xyz) / VERTEX_LATTICE;
        const float raised = raise_importance(own_importance, args.params.interests, interests, at, (float3)(0.0f));
        raise_node(tree, importances, parent, as_uint(raised));
    }
    for (uint round = 0; round < tree->rounds; round++) {
        barrier(CLK_GLOBAL_MEM_FENCE);
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = node_parents[at];
            if (parent != NONE) raise_node(tree, importances, parent, importances[at]);
        }
    }
    // A part vanishes as a whole: all its nodes here are as important as the topmost one.
    for (uint round = group == args.vanishing ? tree->rounds : 0; round-- > 0;) {
        barrier(CLK_GLOBAL_MEM_FENCE);
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = node_parents[at];
            if (parent != NONE) importances[at] = importances[parent];
        }
    }
}

// Lowers the number of a node above the regions. `node`: of all nodes, or NONE.
inline void lower_node(__global uint *numbers, uint first_above, uint node, uint value) {
    if (node != NONE && node >= first_above) atomic_min(&numbers[node - first_above], value);
}

// `region_weights`: above 0. `node_weights`: of the nodes above the regions, bits of floats; infinity before the first level.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_lower(const TreeLowerArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                __global const uint *node_parents, __global const uint *round_ends, __global const uint *point_parents,
                __global const float *region_weights, __global uint *node_weights) {
    const uint lid = get_local_id(0), group = args.first_block + (uint)get_group_id(0);
    const bool is_region = group < args.regions;
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_block_points(&own, regions, args.regions, tree_regions, group);
    if (is_region) {
        const uint weight = as_uint(region_weights[group]);
        for (uint i = lid; i < count_points(own); i += GROUP)
            lower_node(node_weights, args.first_above, point_parents[nth_point(own, i)], weight);
        for (uint i = lid; i < tree->nodes; i += GROUP)
            lower_node(node_weights, args.first_above, node_parents[tree->node_base + i], weight);
    }
    for (uint round = 0; round < (is_region ? 0 : tree->rounds); round++) {
        barrier(CLK_GLOBAL_MEM_FENCE);
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i;
            lower_node(node_weights, args.first_above, node_parents[at], node_weights[at - args.first_above]);
        }
    }
    // A part vanishes as a whole.
    for (uint round = group == args.vanishing ? tree->rounds : 0; round-- > 0;) {
        barrier(CLK_GLOBAL_MEM_FENCE);
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = node_parents[at];
            if (parent != NONE) node_weights[at - args.first_above] = node_weights[parent - args.first_above];
        }
    }
}

// `importances`, `region_weights` and `node_weights` are not read if all weights are 1 without them. `marked`: blocks with new marks; the
// others keep their keys, unless one above has new ones. `renewed`: receives which blocks do not.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_keys(const TreeKeysArgs args, __global const TreeRegion *tree_regions, __global const uint *node_errors,
               __global const uint *node_parents, __global const uint *round_ends, __global const uint *importances,
               __global const float *region_weights, __global const uint *node_weights, __global const uchar *marks,
               __global uint *marked, __global uint *renewed, __global uint *keys) {
    const uint lid = get_local_id(0), group = args.first_block + (uint)get_group_id(0);
    const bool is_region = group < args.regions;
    const float region_weight = args.has_weights && is_region ? region_weights[group] : 1.0f;
    __global const TreeRegion *tree = tree_regions + group;
    const uint is_marked = marked[group] || (tree->above != NONE && renewed[tree->above]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    if (lid == 0) {
        marked[group] = 0;
        renewed[group] = is_marked;
    }
    // No return before a barrier: PoCL 3.1 compiles that wrongly.
    for (uint round = is_marked ? tree->rounds : 0; round-- > 0;) {
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = node_parents[at], packed = node_errors[at];
            uint key = key_bits(packed);
            if (args.has_importances) key = as_uint(error_over_weight(as_float(key), as_float(importances[at])));
            if (args.has_weights) {
                const float weight = is_region ? region_weight : as_float(node_weights[at - args.first_above]);
                key = as_uint(over_region_weight(as_float(key), weight, args.in_steps, args.guard));
            }
            if (marks[at]) key = as_uint(INFINITY);
            // In the order of numbers, which is that of keys.
            keys[at] = min(key, parent == NONE ? as_uint(INFINITY) : key_bits(keys[parent])) | (packed & KEY_SINGLE);
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}

// removed[bin]: triangles that are removed when the tolerance passes the bin. `keys`: above infinity if there is no node. Any number of
// work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_histogram(const TreeHistogramArgs args, __global const uint *keys, __global uint *removed) {
    __local uint bins[FIT_BINS];
    const uint lid = get_local_id(0), groups = (uint)get_num_groups(0), share = (args.nodes + groups - 1) / groups;
    const uint first = share * (uint)get_group_id(0), end = min(first + share, args.nodes);
    for (uint i = lid; i < FIT_BINS; i += GROUP) bins[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = first + lid; i < end; i += GROUP) {
        const uint packed = keys[i], key = key_bits(packed);
        if (key < as_uint(INFINITY)) add_local(&bins[bin_of_key(key, args.first_key, args.shift)], merged_triangles(packed));
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < FIT_BINS; i += GROUP)
        if (bins[i]) atomic_add(&removed[i], bins[i]);
}

// Finds the leaf of each merged node, from the top down, then of each point. `removed`: whether the part of a point is removed
// (tree_part_remove); not read if `removes` is 0. `renewed`: blocks whose keys differ from those of the previous cut; not read for the
// first cut of a tolerance, which covers all blocks. `tops`: for each node its leaf, or NONE if it is not merged. `changed`: region by
// region, from TreeRegion::cluster_base on, the points whose leaf differs from that in the previous cut; `changed_counts`: how many.
// `merged`: triangles that the merged nodes remove.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_leaves(const TreeLeavesArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                 __global const uchar *node_levels, __global const uint *node_parents, __global const uint *round_ends,
                 __global const uint *point_parents, __global const uchar *removed, __global const uint *keys,
                 __global const uint *renewed, __global uint *tops, __global uint *leaves, __global uint *changed,
                 __global uint *changed_counts, __global uint *merged) {
    __local uint all_merged, changed_count;
    const uint lid = get_local_id(0), group = args.first_block + (uint)get_group_id(0), end_merged = end_key(args.tolerance);
    const bool is_made = args.first || renewed[group];
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_block_points(&own, regions, args.regions, tree_regions, group);
    if (lid == 0) all_merged = changed_count = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint own_merged = 0;
    // No return before a barrier: PoCL 3.1 compiles that wrongly.
    for (uint round = is_made ? tree->rounds : 0; round-- > 0;) {
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            // Branch-free: the outcome is unpredictable.
            const uint at = tree->node_base + i, parent = node_parents[at], packed = keys[at];
            const uint above = parent == NONE ? NONE : tops[parent];
            const bool is_merged = key_bits(packed) < end_merged;
            const uint leaf = above == NONE ? pack_leaf(args.points + at, node_levels[at]) : above & ~LEAF_CHANGED;
            const uint top = changed_leaf(leaf, args.first ? leaf : tops[at]);
            own_merged += is_merged ? merged_triangles(packed) : 0;
            tops[at] = is_merged ? top : NONE;
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
    for (uint i = lid; i < (is_made ? count_points(own) : 0); i += GROUP) {
        const uint point = nth_point(own, i), parent = point_parents[point];
        const uint top = parent == NONE ? NONE : tops[parent];
        uint leaf = top == NONE ? pack_leaf(point, 0) : top & ~LEAF_CHANGED;
        if (args.removes && removed[point]) leaf = LEAF_REMOVED;
        leaf = changed_leaf(leaf, args.first ? leaf : leaves[point]);
        leaves[point] = leaf;
        if (leaf & LEAF_CHANGED) changed[tree->cluster_base + add_local(&changed_count, 1)] = i;
    }
    add_local(&all_merged, own_merged);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid > 0 || !is_made) return;
    merged[group] = all_merged;
    changed_counts[group] = changed_count;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_sum(const uint points, const uint region_count, __global const Region *regions, __global const TreeRegion *tree_regions,
              __global const uint *node_errors, __global const uchar *node_levels, __global const uint *tops,
              __global const uint *leaves, __global TreeCutRegion *sums) {
    __local uint counts[6];
    __local float errors2[GROUP], worsts[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_block_points(&own, regions, region_count, tree_regions, group);
    for (uint i = lid; i < 6; i += GROUP) counts[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    float error2 = 0.0f, worst = 0.0f;
    for (uint i = lid; i < tree->nodes; i += GROUP) {
        const uint at = tree->node_base + i;
        if (leaf_number(tops[at]) != points + at) continue;
        const float error = key_of(node_errors[at]);
        add_local(&counts[node_levels[at]], 1);
        error2 += error * error;
        worst = fmax(worst, error);
    }
    uint single = 0;
    for (uint i = lid; i < count_points(own); i += GROUP) single += leaf_number(leaves[nth_point(own, i)]) < points;
    add_local(&counts[0], single);
    errors2[lid] = error2;
    worsts[lid] = worst;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid > 0) return;
    TreeCutRegion sum;
    for (uint level = 0; level < 6; level++) sum.leaves[level] = counts[level];
    for (uint i = 1; i < GROUP; i++) {
        error2 += errors2[i];
        worst = fmax(worst, worsts[i]);
    }
    sum.error2 = error2;
    sum.worst = worst;
    sums[group] = sum;
}
