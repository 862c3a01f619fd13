// tree_cut: cuts of the vertex tree, and their meshes (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group a region.
//
//   kernel          writes
//   tree_weigh      of each node the maximum importance of its points
//   tree_keys       of each node its key, and that of the node above it
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
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_key.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"
#include "lib/vertices.h"

// `importances`: bits of floats of 0 or more, which are ordered as the floats are.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_weigh(const TreeWeighArgs args, __constant float2 *transfer_points, __constant Interest *interests,
                __global const Region *regions, __global const TreeRegion *tree_regions, __global const uint *node_parents,
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
            const uint at = tree->node_base + i, parent = node_parents[at];
            if (parent != NONE) max_global(&importances[parent], importances[at]);
        }
    }
}

// `weighted`: whether importances are read, or all weights are 1. `marked`: regions with new marks; the others keep their keys. `renewed`:
// receives which regions do not.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_keys(const uint weighted, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
               __global const uint *node_parents, __global const uint *round_ends, __global const uint *importances,
               __global const uchar *marks, __global uint *marked, __global uint *renewed, __global uint *keys,
               __global float *keys_above) {
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
            const uint at = tree->node_base + i, parent = node_parents[at];
            const float above = parent == NONE ? INFINITY : key_of(keys[parent]);
            float key = tree_nodes[at].error;
            if (weighted) key = error_over_weight(key, as_float(importances[at]));
            if (marks[at]) key = INFINITY;
            keys[at] = as_uint(fmin(key, above)) | (tree_removed(tree_nodes[at].meta) == 1 ? KEY_SINGLE : 0);
            keys_above[at] = above;
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
        const uint packed = keys[i], key = key_bits(packed);
        if (key < as_uint(INFINITY)) add_local(&bins[bin_of_key(key, args.first_key, args.shift)], packed & KEY_SINGLE ? 1 : 2);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < FIT_BINS; i += GROUP)
        if (bins[i]) atomic_add(&removed[i], bins[i]);
}

// Whether a node is a leaf: of keys that the tolerance allows, the topmost.
inline bool is_leaf_node(__global const uint *keys, __global const float *keys_above, uint at, float tolerance) {
    return keys_above[at] > tolerance && key_of(keys[at]) <= tolerance;
}

// Whether a cut has no such triangle. `collapsed_by`: of the triangle (tree_collapse).
inline bool is_collapsed(__global const uint *keys, uint collapsed_by, float tolerance) {
    return collapsed_by != NONE && key_of(keys[collapsed_by]) <= tolerance;
}

// `removed`: whether the part of a point is (tree_part_remove); not read where `removes` is 0. `renewed`: regions whose keys are not those
// of the cut before. `previous`: leaves of the cut before; neither is read for the first cut of a tolerance.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_leaves(const TreeLeavesArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                 __global const TreeNode *tree_nodes, __global const uint *node_parents, __global const uint *point_parents,
                 __global const uchar *removed, __global const uint *keys, __global const uint *renewed,
                 __global const uint *previous, __global uint *leaves) {
    const uint group = (uint)get_group_id(0);
    const bool is_same = !args.first && !renewed[group];
    TreePoints own;
    find_points(&own, regions + group, tree_regions + group);
    for (uint i = get_local_id(0); i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i);
        const uint before = args.first ? NONE : previous[point] & ~LEAF_CHANGED;
        if (!args.first) {
            // A repair forbids nodes: all others stay leaves.
            const uint number = leaf_number(before);
            if (is_same || before == LEAF_REMOVED || number < args.points || key_of(keys[number - args.points]) <= args.tolerance) {
                leaves[point] = before;
                continue;
            }
        }
        uint above = point_parents[point], top = NONE;
        while (above != NONE && key_of(keys[above]) <= args.tolerance) {
            top = above;
            above = node_parents[above];
        }
        uint leaf = top == NONE ? pack_leaf(point, 0) : pack_leaf(args.points + top, tree_level(tree_nodes[top].meta));
        if (args.removes && removed[point]) leaf = LEAF_REMOVED;
        leaves[point] = leaf | (leaf != before ? LEAF_CHANGED : 0);
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_sum(const TreeSumArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
              __global const TreeNode *tree_nodes, __global const uint *keys, __global const float *keys_above,
              __global const uint *leaves, __global TreeCutRegion *sums) {
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
        if (!is_leaf_node(keys, keys_above, at, args.tolerance)) continue;
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

// Whether a number of the region or of one before it is not 0: a region's triangles have corners in these.
inline bool is_any_near(const Grid grid, __global const uint *region_index, __global const uint *numbers, uint region) {
    const uint3 coords = region_coords(grid, region);
    for (int n = 0; n < 8; n++) {
        // Below 0 is above the number of regions.
        const uint x = coords.x - (uint)(n & 1), y = coords.y - (uint)(n >> 1 & 1), z = coords.z - (uint)(n >> 2);
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
                __global const RegionMesh *meshes, __global const uint *corners, __global const uint *collapsed_by,
                __global const uint *keys, __global const uint *leaves, __global const uint *previous,
                __global RegionMesh *cut_meshes, __global uint *around, __global uint *changed, __global uint *changed_counts) {
    __local uint counts[6], listed, around_own[LOCAL_LEAVES];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = meshes[group].triangle_base;
    OwnLeaves own;
    own.node_base = tree_regions[group].node_base;
    find_points(&own.points, regions + group, tree_regions + group);
    const bool is_near = args.first || is_any_near(args.grid, region_index, renewed, regions[group].region);
    const uint count = is_near ? meshes[group].triangles[0] : 0;
    begin_around(&own, around_own);
    for (uint i = lid; i < 6; i += GROUP) counts[i] = args.first ? 0 : cut_meshes[group].triangles[i];
    if (lid == 0) listed = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) {
        // A repair brings triangles back and takes none away.
        if (is_collapsed(keys, collapsed_by[first + i], args.tolerance)) continue;
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
void tree_emit(const float tolerance, __global const RegionMesh *meshes, __global const uint *corners,
               __global const uint *collapsed_by, __global const uint *keys, __global const uint *leaves,
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
        if (begin + lid < count && !is_collapsed(keys, collapsed_by[first + begin + lid], tolerance))
            nth_triangle(&triangle, corners, first + begin + lid, leaves);
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
        for (uint k = 0; k < 3; k++) {
            const uint leaf = triangle.corners[k];
            on_border[k] = has_border && is_border_leaf(tree_nodes, args.cell_points, args.points, leaf);
            is_inside[k] = tables.is_local && !on_border[k] && around[2 * leaf + 1] == 0;
        }
        for (uint k = 0; k < 3; k++) {
            const uint next = k == 2 ? 0 : k + 1;
            const uint a = triangle.corners[k], b = triangle.corners[next], c = triangle.corners[3 - k - next];
            if (a < args.points) {
                if (is_broken(a >= args.cell_points, count_around(around, a))) {
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
            if (is_inside[k] || is_inside[next])
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
void tree_check(const TreeCheckArgs args, __global const uint *renewed, __global const TreeRegion *tree_regions,
                __global const TreeNode *tree_nodes,
                __global const uint *keys, __global const float *keys_above, __global const uint *around, __global uchar *marks,
                __global uint *marked, __global uint *failed) {
    __global const TreeRegion *tree = tree_regions + get_group_id(0);
    // A repair takes no triangle from a leaf that was one before.
    if (!args.first && !renewed[get_group_id(0)]) return;
    for (uint i = get_local_id(0); i < tree->nodes; i += GROUP) {
        const uint at = tree->node_base + i, leaf = args.points + at;
        if (!is_leaf_node(keys, keys_above, at, args.tolerance)) continue;
        const uint count = count_around(around, leaf);
        if (count >= 3 || !is_broken(tree_is_on_border(tree_nodes[at].meta), count)) continue;
        mark_leaf(tree_nodes, args.points, leaf, marks, marked);
        *failed = 1;
    }
}

#define LATER_CORNER 0x80000000u // instead of a vertex, the leaf's first corner

// `own_firsts`: of all leaves; working memory. `table_leaves`, `table_firsts`: a hash table a region, from `table_bases` on, up to that of
// the next region; a power of two each. `vertex_leaves`: leaf of each vertex, from the region's first corner on. Vertices are numbered
// in the order of the corners.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_index(const uint points, __global const Region *regions, __global const TreeRegion *tree_regions,
                __global const uint *table_bases, __global const uint *cut_corners, __global uint *own_firsts,
                __global uint *table_leaves, __global uint *table_firsts, __global uint *indices, __global uint *vertex_leaves,
                __global RegionMesh *cut_meshes) {
    __local uint scratch[GROUP], others;
    const uint lid = get_local_id(0), group = (uint)get_group_id(0), first = 3 * cut_meshes[group].triangle_base;
    FirstCorners of;
    find_points(&of.own, regions + group, tree_regions + group);
    of.node_base = tree_regions[group].node_base;
    of.points = points;
    of.own_firsts = own_firsts;
    of.other_leaves = table_leaves + table_bases[group];
    of.other_firsts = table_firsts + table_bases[group];
    uint count = 0, own_others = 0;
    for (uint level = 0; level < 6; level++) count += 3 * cut_meshes[group].triangles[level];
    if (lid == 0) others = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    // Only what is used of the memory is cleared, by whoever uses it.
    for (uint i = lid; i < count; i += GROUP) {
        const uint leaf = cut_corners[first + i];
        if (is_own_leaf(&of, leaf)) own_firsts[leaf] = NONE;
        else own_others++;
    }
    add_local(&others, own_others);
    barrier(CLK_LOCAL_MEM_FENCE);
    // At least a quarter of the entries stay free.
    of.mask = others ? 0xffffffffu >> clz(others + others / 3) : 0;
    for (uint i = lid; i <= of.mask; i += GROUP) of.other_leaves[i] = of.other_firsts[i] = NONE;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) put_corner(&of, cut_corners[first + i], i);
    barrier(CLK_GLOBAL_MEM_FENCE);
    uint vertices = 0, total;
    for (uint begin = 0; begin < count; begin += GROUP) {
        const uint i = begin + lid, leaf = i < count ? cut_corners[first + i] : NONE;
        const uint corner = i < count ? first_corner(&of, leaf) : NONE;
        const bool is_first = i < count && corner == i;
        const uint vertex = vertices + scan_group(scratch, is_first, &total);
        if (is_first) vertex_leaves[first + vertex] = leaf;
        if (i < count) indices[first + i] = is_first ? vertex : corner | LATER_CORNER;
        vertices += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) {
        const uint index = indices[first + i];
        if (index & LATER_CORNER) indices[first + i] = indices[first + (index & ~LATER_CORNER)];
    }
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
