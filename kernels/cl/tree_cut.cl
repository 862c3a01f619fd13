// tree_cut: cuts of the vertex tree, and their meshes (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group a region.
//
//   kernel          writes
//   tree_weigh      of each node the maximum importance of its points
//   tree_keys       of each node its key
//   tree_histogram  triangles that are taken away as the tolerance grows
//   tree_leaves     the leaf of each point
//   tree_count      triangles that are left, by level, and around each leaf; lists those with another leaf than before
//   tree_link       edges of the listed triangles, in a table; marks nodes beside an edge of more than two triangles, and beside
//                   points with too few
//   tree_check      marks nodes with too few triangles around them
//   tree_sum        what the leaves add up to
//   tree_emit       the triangles, between leaves
//   tree_index      indices of vertices in the region's mesh
//   tree_vertices   vertices
//
// A node's *key* is the tolerance from which on it is merged: the minimum of error over weight, of its own and of the nodes above
// it. So the topmost node that the tolerance allows is the leaf. Nodes that are marked are merged by no tolerance.
//
// A cut is made again until none of its merges changes the topology. What may be wrong with a cut after the first one is beside leaves
// that the one before did not have, so only triangles with such a corner are looked at.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/fit_bins.h"
#include "lib/grid.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/scan.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"
#include "lib/vertices.h"

// `importances`: bits of floats of 0 or more, which are ordered as the floats are.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_weigh(const TreeWeighArgs args, __constant float2 *transfer_points, __constant Interest *interests,
                __global const Region *regions, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
                __global const uint *round_ends, __global const uint *point_parents, __global const int4 *points,
                __global const Node *nodes, __global uint *importances) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_points(&own, regions + group, tree);
    for (uint i = lid; i < tree->nodes; i += GROUP) importances[tree->node_base + i] = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i), parent = point_parents[point];
        if (parent == NONE) continue;
        const Node node = nodes[(uint)points[point].w];
        const float own_importance = clamp(importance(args.params, transfer_points, node.s, node.f), 0.0f, 1.0f);
        const float3 at = convert_float3(points[point].xyz) / VERTEX_LATTICE;
        const float raised = raise_importance(own_importance, args.params.interests, interests, at, (float3)(0.0f));
        max_global(&importances[parent], as_uint(raised));
    }
    for (uint round = 0; round < tree->rounds; round++) {
        barrier(CLK_GLOBAL_MEM_FENCE);
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = tree_nodes[at].parent;
            if (parent != NONE) max_global(&importances[parent], importances[at]);
        }
    }
}

// Beside a key: the merge takes away one triangle instead of two. Keys are 0 or more.
#define KEY_SINGLE 0x80000000u

inline float key_of(uint packed) { return as_float(packed & ~KEY_SINGLE); }

// `weighted`: whether importances are read, or all weights are 1. `marked`: regions with new marks; the others keep their keys. `renewed`:
// receives which regions do not.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_keys(const uint weighted, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
               __global const uint *round_ends, __global const uint *importances, __global const uchar *marks,
               __global uint *marked, __global uint *renewed, __global uint *keys) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    const uint is_marked = marked[group];
    barrier(CLK_GLOBAL_MEM_FENCE);
    if (lid == 0) {
        marked[group] = 0;
        renewed[group] = is_marked;
    }
    // No return before a barrier: PoCL 3.1 compiles that wrongly.
    for (uint round = is_marked ? tree->rounds : 0; round-- > 0;) {
        const uint end = round_end(round_ends, group, round);
        for (uint i = round_begin(round_ends, group, round) + lid; i < end; i += GROUP) {
            const uint at = tree->node_base + i, parent = tree_nodes[at].parent;
            float key = tree_nodes[at].error;
            if (weighted) key = error_over_weight(key, as_float(importances[at]));
            if (marks[at]) key = INFINITY;
            if (parent != NONE) key = fmin(key, key_of(keys[parent]));
            keys[at] = as_uint(key) | (tree_removed(tree_nodes[at].meta) == 1 ? KEY_SINGLE : 0);
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}

// removed[bin]: triangles that go where the tolerance passes the bin. `keys`: above infinity where there is no node. Any number of
// work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_histogram(const TreeHistogramArgs args, __global const uint *keys, __global uint *removed) {
    __local uint bins[FIT_BINS];
    const uint lid = get_local_id(0), groups = (uint)get_num_groups(0), share = (args.nodes + groups - 1) / groups;
    const uint first = share * (uint)get_group_id(0), end = min(first + share, args.nodes);
    for (uint i = lid; i < FIT_BINS; i += GROUP) bins[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = first + lid; i < end; i += GROUP) {
        const uint packed = keys[i], key = packed & ~KEY_SINGLE;
        if (key < as_uint(INFINITY)) add_local(&bins[bin_of_key(key, args.first_key, args.shift)], packed & KEY_SINGLE ? 1 : 2);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < FIT_BINS; i += GROUP)
        if (bins[i]) atomic_add(&removed[i], bins[i]);
}

// Whether a node is a leaf: of keys that the tolerance allows, the topmost.
inline bool is_leaf_node(__global const uint *keys, uint at, uint parent, float tolerance) {
    return key_of(keys[at]) <= tolerance && (parent == NONE || key_of(keys[parent]) > tolerance);
}

// `areas`: see is_of_small_part. `renewed`: regions whose keys are not those of the cut before, if its tolerance was the same. `previous`:
// leaves of the cut before; neither is read for the first one.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_leaves(const TreeLeavesArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                 __global const TreeNode *tree_nodes, __global const uint *point_parents, __global const float *areas,
                 __global const uint *keys, __global const uint *renewed, __global const uint *previous, __global uint *leaves) {
    const uint group = (uint)get_group_id(0);
    const bool is_same = !args.whole && !renewed[group];
    TreePoints own;
    find_points(&own, regions + group, tree_regions + group);
    for (uint i = get_local_id(0); i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i);
        const uint before = args.first ? NONE : previous[point] & ~LEAF_CHANGED;
        if (!args.whole) {
            // A repair forbids nodes: all others stay leaves.
            const uint number = leaf_number(before);
            if (is_same || before == LEAF_REMOVED || number < args.points || key_of(keys[number - args.points]) <= args.tolerance) {
                leaves[point] = before;
                continue;
            }
        }
        uint parent = point_parents[point], top = NONE;
        while (parent != NONE && key_of(keys[parent]) <= args.tolerance) {
            top = parent;
            parent = tree_nodes[parent].parent;
        }
        uint leaf = top == NONE ? pack_leaf(point, 0) : pack_leaf(args.points + top, tree_level(tree_nodes[top].meta));
        if (is_of_small_part(args.min_part, areas, point)) leaf = LEAF_REMOVED;
        leaves[point] = leaf | (leaf != before ? LEAF_CHANGED : 0);
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_sum(const TreeLeavesArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
              __global const TreeNode *tree_nodes, __global const uint *keys, __global const uint *leaves,
              __global TreeCutRegion *sums) {
    __local uint counts[6];
    __local float errors2[GROUP], worsts[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_points(&own, regions + group, tree);
    for (uint i = lid; i < 6; i += GROUP) counts[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    float error2 = 0.0f, worst = 0.0f;
    for (uint i = lid; i < tree->nodes; i += GROUP) {
        const uint at = tree->node_base + i;
        if (!is_leaf_node(keys, at, tree_nodes[at].parent, args.tolerance)) continue;
        const float error = tree_nodes[at].error;
        add_local(&counts[tree_level(tree_nodes[at].meta)], 1);
        error2 += error * error;
        worst = fmax(worst, error);
    }
    uint single = 0;
    for (uint i = lid; i < count_points(own); i += GROUP)
        if (leaf_number(leaves[nth_point(own, i)]) < args.points) single++;
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

// A triangle of the full mesh between leaves.
typedef struct {
    uint corners[3];
    uint level; // NONE where the triangle has become a line or a point
} CutTriangle;

inline void cut_triangle(CutTriangle *out, uint a, uint b, uint c) {
    out->corners[0] = leaf_number(a);
    out->corners[1] = leaf_number(b);
    out->corners[2] = leaf_number(c);
    const bool is_line = out->corners[0] == out->corners[1] || out->corners[1] == out->corners[2] || out->corners[2] == out->corners[0];
    out->level = is_line ? NONE : min(leaf_level(a), min(leaf_level(b), leaf_level(c)));
}
inline void nth_triangle(CutTriangle *out, __global const uint *corners, uint triangle, __global const uint *leaves) {
    cut_triangle(out, leaves[corners[3 * triangle]], leaves[corners[3 * triangle + 1]], leaves[corners[3 * triangle + 2]]);
}

// What is around a leaf (tree_leaf.h), in two parts: by triangles of the leaf's own region, and by all others.
inline uint count_around(__global const uint *around, uint leaf) { return around[2 * leaf] + around[2 * leaf + 1]; }

// Leaves of a region, and where to count around them in local memory, where adding takes less time.
typedef struct {
    TreePoints points;
    uint node_base;
    __local uint *around; // by own_leaf_index; not used where the region has more than LOCAL_LEAVES
    bool is_local;
} OwnLeaves;

#if GROUP > 1
#define LOCAL_LEAVES 4096
#else
#define LOCAL_LEAVES 1 // all memory of a CPU is the same
#endif

// Begins to count around the leaves of a region.
inline void begin_around(OwnLeaves *own, __local uint *around) {
    own->around = around;
    own->is_local = 2 * count_points(own->points) <= LOCAL_LEAVES;
    for (uint i = get_local_id(0); i < LOCAL_LEAVES; i += GROUP) around[i] = 0;
}
// Adds what was counted; after a barrier.
inline void end_around(const OwnLeaves *own, uint points, __global uint *around) {
    if (!own->is_local) return;
    const uint own_points = count_points(own->points);
    for (uint i = get_local_id(0); i < 2 * own_points; i += GROUP) {
        const uint leaf = i < own_points ? nth_point(own->points, i) : points + own->node_base + i - own_points;
        if (own->around[i]) around[2 * leaf] += own->around[i];
    }
}

// `sign`: 1, or -1 to take the triangle away again.
INLINED void add_around(const TreeCountArgs args, __global uint *around, __global const TreeNode *tree_nodes, const OwnLeaves *own,
                        const CutTriangle *triangle, uint sign) {
    for (uint i = 0; i < 3; i++) {
        const uint leaf = triangle->corners[i];
        // Most surfaces have no border.
        const bool on_border = args.points > args.cell_points && is_border_leaf(tree_nodes, args.cell_points, args.points, leaf);
        const uint by = sign * around_corner(on_border, triangle->corners[(i + 1) % 3], triangle->corners[(i + 2) % 3]);
        const uint index = own_leaf_index(&own->points, own->node_base, args.points, leaf);
        if (index == NONE) atomic_add(&around[2 * leaf + 1], by);
        else if (own->is_local) add_local(&own->around[index], by);
        else add_global(&around[2 * leaf], by);
    }
}

// Whether a number of the region or of a neighbour is not 0. `step`: -1 for neighbours towards lower coordinates, 1 for the others. A
// region's triangles have corners in itself and in those before it.
inline bool is_any_near(const Grid grid, __global const uint *region_index, __global const uint *numbers, uint region, int step) {
    const uint3 coords = region_coords(grid, region);
    for (int n = 0; n < 8; n++) {
        // Below 0 is above the number of regions.
        const uint x = coords.x + (uint)(step * (n & 1)), y = coords.y + (uint)(step * (n >> 1 & 1)), z = coords.z + (uint)(step * (n >> 2));
        if (x >= grid.regions[0] || y >= grid.regions[1] || z >= grid.regions[2]) continue;
        const uint other = region_index[(z * grid.regions[1] + y) * grid.regions[0] + x];
        if (other != NONE && numbers[other]) return true;
    }
    return false;
}

// `meshes`: of the full mesh. `changed`: from the region's first triangle on those whose leaves differ from the cut before, in any
// order, without those that have become lines; `changed_counts`: how many. `around` and the counts of `cut_meshes`: as after the cut
// before.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_count(const TreeCountArgs args, __global const uint *region_index, __global const uint *renewed,
                __global const Region *regions, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
                __global const RegionMesh *meshes, __global const uint *corners, __global const uint *leaves,
                __global const uint *previous, __global RegionMesh *cut_meshes, __global uint *around, __global uint *changed,
                __global uint *changed_counts) {
    __local uint counts[6], listed, around_own[LOCAL_LEAVES];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = meshes[group].triangle_base;
    OwnLeaves own;
    own.node_base = tree_regions[group].node_base;
    find_points(&own.points, regions + group, tree_regions + group);
    const bool is_near = args.whole || is_any_near(args.grid, region_index, renewed, regions[group].region, -1);
    const uint count = is_near ? meshes[group].triangles[0] : 0;
    begin_around(&own, around_own);
    for (uint i = lid; i < 6; i += GROUP) counts[i] = args.first ? 0 : cut_meshes[group].triangles[i];
    if (lid == 0) listed = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) {
        __global const uint *at = corners + 3 * (first + i);
        const uint a = leaves[at[0]], b = leaves[at[1]], c = leaves[at[2]];
        if (!((a | b | c) & LEAF_CHANGED)) continue;
        CutTriangle triangle, before;
        cut_triangle(&triangle, a, b, c);
        if (triangle.level != NONE) {
            add_local(&counts[triangle.level], 1);
            add_around(args, around, tree_nodes, &own, &triangle, 1);
            changed[first + add_local(&listed, 1)] = first + i;
        }
        if (args.first) continue;
        cut_triangle(&before, previous[at[0]], previous[at[1]], previous[at[2]]);
        if (before.level == NONE) continue;
        add_local(&counts[before.level], (uint)-1);
        add_around(args, around, tree_nodes, &own, &before, (uint)-1);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    end_around(&own, args.points, around);
    for (uint i = lid; i < 6; i += GROUP) cut_meshes[group].triangles[i] = counts[i];
    if (lid == 0) changed_counts[group] = listed;
}

// Writes a region's triangles by level, finest first, inside a level in the order of the full mesh.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_emit(__global const RegionMesh *meshes, __global const uint *corners, __global const uint *leaves,
               __global const RegionMesh *cut_meshes, __global uint *cut_corners) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = meshes[group].triangle_base, count = meshes[group].triangles[0];
    uint next[6];
    next[0] = cut_meshes[group].triangle_base;
    for (uint level = 1; level < 6; level++) next[level] = next[level - 1] + cut_meshes[group].triangles[level - 1];
    for (uint begin = 0; begin < count; begin += GROUP) {
        CutTriangle triangle;
        triangle.level = NONE;
        if (begin + lid < count) nth_triangle(&triangle, corners, first + begin + lid, leaves);
        if (GROUP == 1 && triangle.level == NONE) continue;
        // Three levels a scan, 10 bits each.
        for (uint triple = 0; triple < 2; triple++) {
            uint total;
            const uint shift = triangle.level / 3 == triple ? 10 * (triangle.level % 3) : 32;
            const uint before = scan_group(scratch, shift < 32 ? 1u << shift : 0, &total);
            if (shift < 32) {
                const uint to = next[triangle.level] + (before >> shift & 1023u);
                for (uint i = 0; i < 3; i++) cut_corners[3 * to + i] = triangle.corners[i];
            }
            for (uint i = 0; i < 3; i++) next[3 * triple + i] += total >> (10 * i) & 1023u;
        }
    }
}

inline uint leaf_hash(uint leaf) {
    const uint h = leaf * 0x9e3779b1u;
    return h ^ h >> 15;
}

// Marks the node of a leaf.
inline void mark_leaf(__global const TreeNode *tree_nodes, uint points, uint leaf, __global uchar *marks, __global uint *marked) {
    marks[leaf - points] = 1;
    marked[tree_node_region(tree_nodes[leaf - points].meta)] = 1;
}

// Marks one of two leaves that meet along more than one line: of one region the later one, else both. Whether one of them is a node.
inline bool mark_pair(__global const TreeNode *tree_nodes, uint points, uint a, uint b, __global uchar *marks, __global uint *marked) {
    const bool a_is_node = a >= points, b_is_node = b >= points;
    const bool same = a_is_node && b_is_node
        && tree_node_region(tree_nodes[a - points].meta) == tree_node_region(tree_nodes[b - points].meta);
    if (a_is_node && !(same && a < b)) mark_leaf(tree_nodes, points, a, marks, marked);
    if (b_is_node && !(same && b < a)) mark_leaf(tree_nodes, points, b, marks, marked);
    return a_is_node || b_is_node;
}

// Region of a leaf that is a node; `group` where that region has it.
inline uint leaf_region(__global const TreeNode *tree_nodes, uint points, uint leaf, const TreePoints *own, uint node_base,
                        uint group) {
    return own_leaf_index(own, node_base, points, leaf) != NONE ? group : tree_node_region(tree_nodes[leaf - points].meta);
}

// Tables of directed edges, each by its corner at its begin.
typedef struct {
    __global const uint *corners, *leaves; // of the full mesh
    __global uint *edges;
    uint capacity;
    __local uint *local_edges; // of edges that no other region has
    bool is_local;
} EdgeTables;

#if GROUP > 1
#define LOCAL_EDGES 4096
#else
#define LOCAL_EDGES 1 // all memory of a CPU is the same
#endif

inline bool is_edge(const EdgeTables *tables, uint corner, uint a, uint b) {
    const uint end = corner % 3 == 2 ? corner - 2 : corner + 1;
    return leaf_number(tables->leaves[tables->corners[corner]]) == a && leaf_number(tables->leaves[tables->corners[end]]) == b;
}

// Puts an edge into a table, from `first` on. Whether it was there.
inline bool put_edge(const EdgeTables *tables, uint first, uint corner, uint a, uint b) {
    for (uint at = first;; at = at + 1 < tables->capacity ? at + 1 : 0) {
        const uint found = atomic_cmpxchg(&tables->edges[at], NONE, corner);
        if (found == NONE) return false;
        if (is_edge(tables, found, a, b)) return true;
    }
}
inline bool put_local_edge(const EdgeTables *tables, uint first, uint corner, uint a, uint b) {
    for (uint at = first;; at = (at + 1) % LOCAL_EDGES) {
        const uint found = atomic_cmpxchg(&tables->local_edges[at], NONE, corner);
        if (found == NONE) return false;
        if (is_edge(tables, found, a, b)) return true;
    }
}

// `edges`: a hash table of directed edges. `table_bases`: of the entries of each region, and the end of the last. Directed edges of a
// surface differ, so one that is found twice joins leaves that meet along two lines.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_link(const TreeLinkArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
               __global const RegionMesh *meshes, __global const uint *corners, __global const uint *leaves,
               __global const uint *changed, __global const uint *changed_counts, __global const TreeNode *tree_nodes,
               __global const uint *around, __global const uint *table_bases, __global uint *edges, __global uchar *marks,
               __global uint *marked, __global uint *failed) {
    __local uint local_edges[LOCAL_EDGES];
    const uint group = (uint)get_group_id(0), first = meshes[group].triangle_base, count = changed_counts[group];
    const uint node_base = tree_regions[group].node_base;
    const bool has_border = args.points > args.cell_points;
    TreePoints own;
    find_points(&own, regions + group, tree_regions + group);
    EdgeTables tables;
    tables.corners = corners;
    tables.leaves = leaves;
    tables.edges = edges;
    tables.capacity = args.capacity;
    tables.local_edges = local_edges;
    tables.is_local = 3 * count <= LOCAL_EDGES;
    for (uint i = get_local_id(0); i < LOCAL_EDGES; i += GROUP) local_edges[i] = NONE;
    barrier(CLK_LOCAL_MEM_FENCE);
    warm_cache(edges + table_bases[group], table_bases[group + 1] - table_bases[group]);
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, corners, changed[first + i], leaves);
        bool on_border[3], is_inside[3]; // inside: all triangles around the leaf are of this region
        uint counts[3];
        for (uint k = 0; k < 3; k++) {
            const uint leaf = triangle.corners[k], others = around[2 * leaf + 1];
            counts[k] = around[2 * leaf] + others;
            on_border[k] = has_border && is_border_leaf(tree_nodes, args.cell_points, args.points, leaf);
            is_inside[k] = !on_border[k] && others == 0;
        }
        for (uint k = 0; k < 3; k++) {
            const uint next = k == 2 ? 0 : k + 1;
            const uint a = triangle.corners[k], b = triangle.corners[next], c = triangle.corners[3 - k - next];
            if (a < args.points) {
                if (is_broken(a >= args.cell_points, counts[k])) {
                    const bool marks_b = mark_pair(tree_nodes, args.points, a, b, marks, marked);
                    const bool marks_c = mark_pair(tree_nodes, args.points, a, c, marks, marked);
                    if (marks_b || marks_c) *failed = 1;
                }
                // The edges between points differ: they are those of the full mesh.
                if (b < args.points) continue;
            }
            // Inside the surface there is a triangle on the other side of the edge, which looks at it.
            if (a > b && !(on_border[k] && on_border[next])) continue;
            const uint corner = 3 * changed[first + i] + k, hash = (leaf_hash(a) + 31 * leaf_hash(b)) * 0x85ebca6bu;
            bool is_there;
            if (tables.is_local && (is_inside[k] || is_inside[next]))
                is_there = put_local_edge(&tables, mul_hi(hash, (uint)LOCAL_EDGES), corner, a, b);
            else {
                // Entries of a region are near each other in memory.
                const uint region = leaf_region(tree_nodes, args.points, a < args.points ? b : a, &own, node_base, group);
                const uint base = table_bases[region];
                is_there = put_edge(&tables, base + mul_hi(hash, table_bases[region + 1] - base), corner, a, b);
            }
            if (!is_there) continue;
            mark_pair(tree_nodes, args.points, a, b, marks, marked);
            *failed = 1;
        }
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_check(const TreeLinkArgs args, __global const uint *region_index, __global const uint *changed_counts,
                __global const Region *regions, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
                __global const uint *keys, __global const uint *around, __global uchar *marks, __global uint *marked,
                __global uint *failed) {
    __global const TreeRegion *tree = tree_regions + get_group_id(0);
    if (!is_any_near(args.grid, region_index, changed_counts, regions[get_group_id(0)].region, 1)) return;
    for (uint i = get_local_id(0); i < tree->nodes; i += GROUP) {
        const uint at = tree->node_base + i, leaf = args.points + at;
        if (!is_leaf_node(keys, at, tree_nodes[at].parent, args.tolerance)) continue;
        const uint count = count_around(around, leaf);
        if (count >= 3 || !is_broken(tree_is_on_border(tree_nodes[at].meta), count)) continue;
        mark_leaf(tree_nodes, args.points, leaf, marks, marked);
        *failed = 1;
    }
}

// A hash table of the leaves in a region's mesh: each with its first corner, then with its vertex. In local memory where it is small enough.
typedef struct {
    __global uint *leaves, *firsts;
    __local uint *local_leaves, *local_firsts;
    bool is_local;
    uint mask;
} LeafTable;

#define CORNERS_AN_ITEM 4 // in a row: fewer scans

#if GROUP > 1
#define LOCAL_TABLE 2048
#else
#define LOCAL_TABLE 1 // all memory of a CPU is the same
#endif

// The entry of a leaf, which is there from now on.
inline uint put_leaf(const LeafTable *table, uint leaf) {
    for (uint at = leaf_hash(leaf) & table->mask;; at = (at + 1) & table->mask) {
        const uint found = table->is_local ? atomic_cmpxchg(&table->local_leaves[at], NONE, leaf)
                                           : claim_global(&table->leaves[at], NONE, leaf);
        if (found == NONE || found == leaf) return at;
    }
}
inline void put_corner(const LeafTable *table, uint at, uint corner) {
    if (table->is_local) atomic_min(&table->local_firsts[at], corner);
    else min_global(&table->firsts[at], corner);
}
inline uint first_corner(const LeafTable *table, uint at) { return table->is_local ? table->local_firsts[at] : table->firsts[at]; }
inline void put_vertex(const LeafTable *table, uint at, uint vertex) {
    if (table->is_local) table->local_leaves[at] = vertex;
    else table->leaves[at] = vertex;
}
inline uint vertex_at(const LeafTable *table, uint at) { return table->is_local ? table->local_leaves[at] : table->leaves[at]; }

// `table_leaves`, `table_firsts`: a hash table a region, from `table_bases` on, up to that of the next region; a power of two each.
// `vertex_leaves`: leaf of each vertex, from the region's first corner on. Vertices are numbered in the order of the corners.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_index(__global const uint *table_bases, __global const uint *cut_corners, __global uint *table_leaves,
                __global uint *table_firsts, __global uint *indices, __global uint *vertex_leaves, __global RegionMesh *cut_meshes) {
    __local uint scratch[GROUP], local_leaves[LOCAL_TABLE], local_firsts[LOCAL_TABLE];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0), first = 3 * cut_meshes[group].triangle_base;
    const uint entries = table_bases[group + 1] - table_bases[group];
    LeafTable table;
    table.leaves = table_leaves + table_bases[group];
    table.firsts = table_firsts + table_bases[group];
    table.local_leaves = local_leaves;
    table.local_firsts = local_firsts;
    table.is_local = entries <= LOCAL_TABLE;
    table.mask = entries - 1;
    for (uint i = lid; i < LOCAL_TABLE; i += GROUP) local_leaves[i] = local_firsts[i] = NONE;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint count = 0;
    for (uint level = 0; level < 6; level++) count += 3 * cut_meshes[group].triangles[level];
    for (uint i = lid; i < count; i += GROUP) {
        const uint at = put_leaf(&table, cut_corners[first + i]);
        put_corner(&table, at, i);
        indices[first + i] = at;
    }
    barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
    uint vertices = 0, total;
    for (uint begin = 0; begin < count; begin += CORNERS_AN_ITEM * GROUP) {
        const uint i = begin + CORNERS_AN_ITEM * lid;
        uint firsts = 0; // one bit a corner
        for (uint k = 0; k < CORNERS_AN_ITEM; k++)
            if (i + k < count && first_corner(&table, indices[first + i + k]) == i + k) firsts |= 1u << k;
        uint vertex = vertices + scan_group(scratch, popcount(firsts), &total);
        for (uint k = 0; k < CORNERS_AN_ITEM; k++) {
            if (!(firsts >> k & 1u)) continue;
            vertex_leaves[first + vertex] = cut_corners[first + i + k];
            put_vertex(&table, indices[first + i + k], vertex++);
        }
        vertices += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) indices[first + i] = vertex_at(&table, indices[first + i]);
    if (lid == 0) cut_meshes[group].vertices = vertices;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_vertices(const TreeVerticesArgs args, __global const Region *regions, __global const Node *nodes,
                   __global const VertexRecord *vertex_records, __global const TreeNode *tree_nodes, __global const int4 *points,
                   __global const RegionMesh *cut_meshes, __global const uint *vertex_leaves, __global Vertex *vertices) {
    const Grid grid = args.grid;
    const uint group = (uint)get_group_id(0);
    const RegionMesh mesh = cut_meshes[group];
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    for (uint i = get_local_id(0); i < mesh.vertices; i += GROUP) {
        const uint leaf = vertex_leaves[3 * mesh.triangle_base + i];
        Node node;
        uint normal;
        int3 at;
        if (leaf < args.points) {
            const int4 point = points[leaf];
            node = nodes[(uint)point.w];
            normal = vertex_records[(uint)point.w].normal;
            at = point.xyz - origin * (int)VERTEX_LATTICE;
        } else {
            const TreeNode merged = tree_nodes[leaf - args.points];
            const int3 home = convert_int3(region_origin(grid, regions[tree_node_region(merged.meta)].region));
            node.s = (float)(merged.normal_s >> 16) / 65535.0f;
            node.f = merged.f;
            normal = merged.normal_s & 0xffffu;
            at = tree_position(merged) + (home - origin) * (int)VERTEX_LATTICE;
        }
        vertices[mesh.vertex_base + i] = make_vertex(args.params, node, normal, at);
    }
}
