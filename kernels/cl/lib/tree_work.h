// Working memory of the blocks of a launch of tree_begin and tree_build (docs/algorithm.md#7-vertex-tree).
#ifndef ISOPEEL_TREE_WORK_H
#define ISOPEEL_TREE_WORK_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"

// Of all blocks. `rings`: two a block, `costs` beside them. `lists`: three numbers a cluster.
typedef struct {
    __global uint *rings;
    __global float *costs;
    __global TreeCluster *clusters;
    __global TreeMembers *members;
    __global float4 *positions, *merged_positions;
    __global uint *lists;
} TreeWork;

// The working memory of a block that begins with `count` clusters. `points`: as in TreeBlock.
INLINED TreeBlock find_block(const TreeBuildArgs args, const TreeWork *work, __global const Region *region,
                             __global const TreeRegion *tree, __global const int4 *points, uint count) {
    const uint entries = 3 * tree->triangle_count + count, entry_base = 2 * (3 * tree->triangle_base + tree->cluster_base);
    // Each round has swapped both halves.
    const uint own = tree->rounds & 1 ? entries : 0, next = entries - own;
    TreeBlock block;
    block.clusters = work->clusters + tree->cluster_base;
    block.members = work->members + tree->cluster_base;
    block.positions = work->positions + tree->cluster_base;
    block.merged_positions = work->merged_positions + tree->cluster_base;
    block.rings = work->rings + entry_base + own;
    block.next_rings = work->rings + entry_base + next;
    block.costs = work->costs + entry_base + own;
    block.next_costs = work->costs + entry_base + next;
    block.alive = work->lists + 3 * tree->cluster_base;
    block.best = block.alive + count;
    block.partners = block.best + count;
    block.points = points;
    block.origin = convert_int3(region_origin(args.grid, region->region)) << (int)args.level;
    block.scale = (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]) / VERTEX_LATTICE;
    block.alive_count = tree->clusters - tree->idle;
    block.new_count = tree->fresh;
    block.is_soft = args.is_soft;
#if WIDE_GROUP > 1
    block.new_first = tree->rounds ? block.alive_count : 0;
#endif
    return block;
}

#endif
