// tree_rise: from one level of the vertex tree to the next (docs/algorithm.md#7-vertex-tree). What the blocks of a level have left, their
// *roots*, become the clusters of larger blocks, and the triangles between different roots the mesh of these.
//
//   kernel          work-group     writes
//   tree_commit     a block        its nodes behind those of all blocks before it, the parents of what it began with, its roots
//   tree_rise       a block        its roots as clusters of the next level
//   tree_risen      any            of each point or cluster of this level, its cluster of the next one
//   tree_survivors  a block        how many of its triangles remain; then these triangles
//   tree_link       any            of some leaves the node above

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_cluster.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

// The leaf that a block begins with as its cluster `i`.
inline uint first_leaf(uint level, TreePoints own, __global const TreeCluster *risen, uint i) {
    const uint point = nth_point(own, i);
    return level ? risen[point].ring_first : point;
}

inline uint numbered_node(uint node, uint from, uint to) { return node == NONE ? NONE : node - from + to; }

// `points`, `risen`: as in tree_build. `bases`: of each block of the launch, its first node in the tree, and its first root in the launch.
// `nodes` to `lists`: working memory of tree_build.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_commit(const TreeRiseArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                 __global const uint2 *bases, __global const int4 *points, __global const TreeCluster *risen,
                 __global const TreeNode *nodes, __global const uint *errors, __global const uchar *levels, __global const uint *parents,
                 __global const uint *cluster_parents, __global const TreeCluster *clusters, __global const TreeMembers *members,
                 __global const float4 *positions, __global const uint *lists, __global TreeNode *tree_nodes,
                 __global uint *node_errors, __global uchar *node_levels, __global uint *node_parents, __global uint *point_parents,
                 __global TreeCluster *root_clusters, __global TreeMembers *root_members, __global int4 *root_points) {
    const uint lid = get_local_id(0), group = args.first_region + (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    const uint2 base = bases[get_group_id(0)];
    const uint from = tree->cluster_base, to = base.x;
    TreePoints own;
    find_points(&own, regions + group, tree);
    for (uint i = lid; i < tree->nodes; i += GROUP) {
        tree_nodes[to + i] = nodes[from + i];
        node_errors[to + i] = errors[from + i];
        node_levels[to + i] = levels[from + i];
        node_parents[to + i] = numbered_node(parents[from + i], from, to);
    }
    for (uint i = lid; i < count_points(own); i += GROUP) {
        const uint leaf = first_leaf(args.level, own, risen, i);
        *(leaf < args.points ? point_parents + leaf : node_parents + (leaf - args.points)) =
            numbered_node(cluster_parents[from + i], from, to);
    }
    const int3 origin = convert_int3(region_origin(args.grid, regions[group].region)) << (int)args.level;
    // Idle clusters have stayed at the end of the list that the block began with, the last one first.
    const uint active = tree->clusters - tree->idle, last = count_points(own) - 1;
    for (uint i = lid; i < tree->clusters; i += GROUP) {
        const uint at = lists[3 * from + (i < active ? i : last - (i - active))], node = members[from + at].node, root = base.y + i;
        const uint leaf = node == NONE ? first_leaf(args.level, own, risen, at) : args.points + numbered_node(node, from, to);
        const int3 position = node == NONE ? points[nth_point(own, at)].xyz
                                           : tree_position(nodes[node]) + origin * (int)VERTEX_LATTICE;
        root_clusters[root] = clusters[from + at];
        root_clusters[root].ring_first = leaf;
        root_members[root] = members[from + at];
        root_points[root] = (int4)(position, as_int(positions[from + at].w));
    }
}

// Cells of an extent in a block, as those of the next level's block: one of two along each axis.
inline uint risen_extent(uint extent, uint3 coords) {
    const uint3 by = coords & 1u;
    uint risen = 0;
    for (uint i = 0; i < 30; i += 5) {
        const uint axis = i / 5 % 3, beside = axis == 0 ? by.x : axis == 1 ? by.y : by.z;
        risen |= ((extent >> i & 31u) + 32 * beside) >> 1 << i;
    }
    return risen;
}

// `bases`: as in tree_commit. `to`: of each block of the launch, its first cluster in the next level. `risen_of`: receives the next level's
// cluster of each leaf that is a root.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_rise(const TreeRiseArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
               __global const uint2 *bases, __global const uint *to, __global const TreeCluster *root_clusters,
               __global const TreeMembers *root_members, __global const int4 *root_points, __global TreeCluster *clusters,
               __global TreeMembers *members, __global int4 *points, __global uint *risen_of) {
    const uint group = args.first_region + (uint)get_group_id(0), count = tree_regions[group].clusters;
    const uint from = bases[get_group_id(0)].y, first = to[get_group_id(0)];
    const uint3 coords = region_coords(args.grid, regions[group].region);
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        clusters[first + i] = root_clusters[from + i];
        members[first + i] = root_members[from + i];
        members[first + i].extent = risen_extent(root_members[from + i].extent, coords);
        points[first + i] = root_points[from + i];
        risen_of[root_clusters[from + i].ring_first] = first + i;
    }
}

// `risen`: of this level; `risen_of`: from tree_rise. `next`: receives of each of this level's `count` points or clusters its cluster of the
// next level.
__kernel void tree_risen(const TreeRiseArgs args, const uint count, __global const TreeCluster *risen,
                         __global const uint *point_parents, __global const uint *node_parents, __global const uint *risen_of,
                         __global uint *next) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    uint leaf = args.level ? risen[i].ring_first : i;
    for (;;) {
        const uint parent = leaf < args.points ? point_parents[leaf] : node_parents[leaf - args.points];
        if (parent == NONE) break;
        leaf = args.points + parent;
    }
    next[i] = risen_of[leaf];
}

// `meshes`, `corners`: of this level. `next`: from tree_risen. `fill`: 0: `counts` receives how many triangles of each block remain;
// 1: `counts` has the first of them in the next level, and `survivors` receives their corners.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_survivors(const uint fill, __global const RegionMesh *meshes, __global const uint *corners, __global const uint *next,
                    __global uint *counts, __global uint *survivors) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = meshes[group].triangle_base, count = meshes[group].triangles[0], to = fill ? counts[group] : 0;
    uint kept = 0, total;
    for (uint begin = 0; begin < count; begin += GROUP) {
        uint a = 0, b = 0, c = 0;
        if (begin + lid < count) {
            __global const uint *at = corners + 3 * (first + begin + lid);
            a = next[at[0]];
            b = next[at[1]];
            c = next[at[2]];
        }
        const bool is_kept = a != b && b != c && c != a;
        const uint rank = kept + scan_group(scratch, is_kept, &total);
        if (fill && is_kept) vstore3((uint3)(a, b, c), to + rank, survivors);
        kept += total;
    }
    if (!fill && lid == 0) counts[group] = kept;
}

// `leaves`: points or nodes, each with the node that becomes its parent.
__kernel void tree_link(const uint count, const uint points, __global const uint2 *leaves, __global uint *point_parents,
                        __global uint *node_parents) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const uint leaf = leaves[i].x;
    *(leaf < points ? point_parents + leaf : node_parents + (leaf - points)) = leaves[i].y;
}
