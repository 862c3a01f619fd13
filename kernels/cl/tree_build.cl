// tree_build: the nodes of the vertex tree (docs/algorithm.md#7-vertex-tree). One work-group a block.
//
//   kernel      writes
//   tree_build  the nodes, the parents of nodes and of what the blocks begin with
//
// The blocks of level 0 are regions, those of level l have 2^l regions along each axis. Clusters merge only with clusters of the same
// block, so that blocks do not wait for each other. What a block leaves rises to the next level (tree_rise.cl).

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_leaf.h"
#include "lib/tree_rounds.h"
#include "lib/tree_work.h"

#define MIN_PROGRESS 64 // the last round is the first that merges less than 1 / MIN_PROGRESS of the clusters

// Buffers of tree_build, as there.
typedef struct {
    __global const Region *regions;
    __global const int4 *points;
    __global TreeRegion *tree_regions;
    TreeWork work;
    __global TreeNode *tree_nodes;
    __global uint *node_errors;
    __global uchar *node_levels;
    __global uint *node_parents, *cluster_parents, *round_ends;
} BuildBuffers;

// Output buffers for the nodes of a block.
INLINED TreeOutput find_output(const TreeBuildArgs args, const BuildBuffers *all, __global const TreeRegion *tree, const TreeBlock *block) {
    const int3 last = (int3)((int)args.grid.dims[0], (int)args.grid.dims[1], (int)args.grid.dims[2]) - 1;
    const int3 margin = (int3)(args.params.cap ? 1 : 0);
    const int lattice = (int)VERTEX_LATTICE, level = (int)args.level;
    TreeOutput out;
    out.nodes = all->tree_nodes;
    out.node_errors = all->node_errors;
    out.node_levels = all->node_levels;
    out.node_parents = all->node_parents;
    out.cluster_parents = all->cluster_parents + tree->cluster_base;
    out.region = tree->region;
    out.level = args.level;
    out.node_base = tree->cluster_base;
    out.low = max((int3)(0), (margin - block->origin) * lattice) >> level;
    out.high = min((int3)(32 << level), last - margin - block->origin) * lattice >> level;
    out.step = block->scale * (float)(1u << args.level);
    out.per_length = exact_quotient(1.0f, fmin(fmin(args.grid.spacing[0], args.grid.spacing[1]), args.grid.spacing[2]));
    return out;
}

// Whether a block rests: enough is merged, and the blocks of the next level merge the rest better.
inline bool rests(const TreeBuildArgs args, uint clusters, uint points) {
    return !args.is_last && (ulong)clusters << 2 * (args.level + 1) <= points;
}

// Makes some rounds of merges in a block.
INLINED void build_block(const TreeBuildArgs args, const BuildBuffers *all, uint group, __local uint *scratch, __local uint *counts) {
    const uint lid = get_local_id(0);
    __global TreeRegion *tree = all->tree_regions + group;
    TreePoints own;
    find_points(&own, all->regions + group, tree);
    const uint points = tree->points, idle = tree->idle;
    TreeBlock block = find_block(args, &all->work, all->regions + group, tree, all->points, count_points(own));
    const TreeOutput out = find_output(args, all, tree, &block);
    uint node_count = tree->nodes, rounds = tree->rounds;
    bool is_done = tree->is_done || rests(args, block.alive_count + idle, points);
    for (uint i = 0; i < args.rounds && !is_done; i++) {
        find_pairs(&block, scratch, counts);
        const uint merged = block.pair_count, before = block.alive_count;
        commit_pairs(&block, &out, node_count);
        node_count += merged;
        if (lid == 0) all->round_ends[TREE_ROUNDS * group + rounds] = node_count;
        rounds++;
        compact_block(&block, scratch);
        is_done = merged == 0 || rounds == TREE_ROUNDS || rests(args, block.alive_count + idle, points)
            || (!args.is_last && merged * MIN_PROGRESS < before);
    }
    // Work-items that made no round may still read the record.
    barrier(CLK_GLOBAL_MEM_FENCE);
    if (lid > 0) return;
    tree->nodes = node_count;
    tree->rounds = rounds;
    tree->clusters = block.alive_count + idle;
    tree->fresh = block.new_count;
    tree->is_done = is_done;
}

// `points` and working memory: from tree_begin. Nodes: from TreeRegion::cluster_base on, numbered in the launch; `cluster_parents`: of what
// each block begins with; `round_ends`: how many nodes there are after each round. `order`: of each launch its blocks; `claimed`: how many of
// them have been begun.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_build(const TreeBuildArgs args, __global const Region *regions, __global const int4 *points,
                __global TreeRegion *tree_regions, __global const uint *order, __global uint *claimed, __global uint *rings,
                __global float *costs, __global TreeCluster *clusters, __global TreeMembers *members, __global float4 *positions,
                __global float4 *merged_positions, __global uint *lists, __global TreeNode *tree_nodes, __global uint *node_errors,
                __global uchar *node_levels, __global uint *node_parents, __global uint *cluster_parents, __global uint *round_ends) {
    __local uint scratch[WIDE_GROUP], counts[2];
    const BuildBuffers all = {
        regions, points, tree_regions, {rings, costs, clusters, members, positions, merged_positions, lists},
        tree_nodes, node_errors, node_levels, node_parents, cluster_parents, round_ends,
    };
#if WIDE_GROUP == 1
    // Takes one block of the launch after another, the longest first. Work-groups are not bound to blocks, because a driver may assign half
    // of the work-groups to one core of two in advance, however long they take.
    for (;;) {
        const uint n = atomic_inc(claimed);
        if (n >= get_num_groups(0)) return;
        build_block(args, &all, order[args.first_region + n], scratch, counts);
    }
#else
    (void)order, (void)claimed;
    build_block(args, &all, args.first_region + (uint)get_group_id(0), scratch, counts);
#endif
}
