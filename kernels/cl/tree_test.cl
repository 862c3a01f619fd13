// tree_test: whether a cut of the vertex tree has the surface's topology (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group a
// region.
//
//   kernel     writes
//   tree_test  the triangles that are left; marks nodes beside an edge of more than two of them, or with too few of them around
//
// A cut is made again until none of its merges changes the topology. What may be wrong with a cut after the first one is beside leaves
// that the one before did not have, so only triangles with such a corner are looked at.
//
// Each region tests what is around its own leaves, in its own triangles and those beside it: it waits for no other region, and all that
// it reads and counts is near in memory.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_key.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

#define NEAR 1u   // in the region or in one before it, as a region's triangles have corners in these
#define AROUND 2u // in any of the 27 regions

// Where numbers are not 0. Called by all work-items.
INLINED uint find_near(const Grid grid, __local uint *found, __global const uint *region_index, __global const uint *numbers, uint region) {
    const int3 coords = convert_int3(region_coords(grid, region));
    if (get_local_id(0) == 0) *found = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < 27; i += WIDE_GROUP) {
        const int3 by = (int3)((int)(i % 3), (int)(i / 3 % 3), (int)(i / 9)) - 1;
        // Below 0 is above the number of regions.
        const uint3 at = convert_uint3(coords + by);
        if (at.x >= grid.regions[0] || at.y >= grid.regions[1] || at.z >= grid.regions[2]) continue;
        const uint other = region_index[(at.z * grid.regions[1] + at.y) * grid.regions[0] + at.x];
        if (other != NONE && numbers[other]) or_local(found, by.x <= 0 && by.y <= 0 && by.z <= 0 ? NEAR | AROUND : AROUND);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    return *found;
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

// A region's triangles in a cut: of its mesh, then of those of others that have a corner in the region.
typedef struct {
    __global const uint *left;
    uint count, beside, beside_count; // `beside`: the first of those of others
} LeftTriangles;

inline uint count_left(const LeftTriangles *of) { return of->count + of->beside_count; }
inline uint nth_left(const LeftTriangles *of, uint i) { return of->left[i < of->count ? i : of->beside + i - of->count]; }

// Whether what a cut says is wrong was found by a region.
typedef struct {
    __global const TreeNode *tree_nodes;
    __global uchar *marks;
    __global uint *marked;
    bool any;
} Faults;

// Counts a triangle around a corner, a leaf of the region with that index.
inline void count_corner(const OwnLeaves *own, const Faults *faults, uint index, uint a, uint b, uint c) {
    const uint by = around_corner(is_border_leaf(own, faults->tree_nodes, a), b, c);
    if (own->is_local) add_local(own->local_around + index, by);
    else add_global(own->global_around + index, by);
}

// Counts a triangle around its first corner, and marks that and the next one if they meet along more than one line: a directed edge of a
// surface is there once. `corner`: of the full mesh.
INLINED void add_corner(const OwnLeaves *own, const EdgeTable *table, Faults *faults, uint corner, uint a, uint b, uint c) {
    const uint index = own_index(own, a);
    if (index == NONE) return;
    count_corner(own, faults, index, a, b, c);
    // Edges between points differ: they are those of the full mesh. Inside the surface there is a triangle on the other side of the edge,
    // which looks at it.
    if (max(a, b) < own->first_node) return;
    if (a > b && !(is_border_leaf(own, faults->tree_nodes, a) && is_border_leaf(own, faults->tree_nodes, b))) return;
    if (!put_edge(table, corner, a, b)) return;
    mark_pair(faults->tree_nodes, own->first_node, a, b, faults->marks, faults->marked);
    faults->any = true;
}

// Marks nodes with too few triangles around them, or where the border has closed. Whether the same may be true of a point.
INLINED bool mark_broken_nodes(const CutView *cut, const OwnLeaves *own, Faults *faults, uint nodes, __global const uint *tops) {
    const uint own_points = count_points(own->points);
    for (uint i = get_local_id(0); i < nodes; i += WIDE_GROUP) {
        const uint at = own->node_base + i, leaf = own->first_node + at, count = count_around(own, own_points + i);
        // One branch for all, as each by itself could go either way.
        if (!((uint)(count < 3) & (uint)(leaf_number(tops[at]) == leaf) & (cut->first | tops[at] >> 31))) continue;
        if (!is_broken(tree_is_on_border(faults->tree_nodes[at].meta), count)) continue;
        mark_leaf(faults->tree_nodes, own->first_node, leaf, faults->marks, faults->marked);
        faults->any = true;
    }
    uint broken_points = 0;
    for (uint i = get_local_id(0); i < own_points; i += WIDE_GROUP) {
        const uint point = nth_point(own->points, i), leaf = cut->leaves[point];
        broken_points |= (uint)(count_around(own, i) < 3) & (uint)(leaf_number(leaf) == point) & (cut->first | leaf >> 31);
    }
    return broken_points;
}

// Counts around all leaves of the region, in all triangles.
INLINED void count_all(const CutView *cut, const OwnLeaves *own, const Faults *faults, const LeftTriangles *triangles) {
    for (uint i = get_local_id(0); i < count_left(triangles); i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, cut, nth_left(triangles, i));
        for (uint k = 0; k < 3; k++, triangle = rotated(triangle)) {
            const uint index = own_index(own, triangle.a);
            if (index != NONE) count_corner(own, faults, index, triangle.a, triangle.b, triangle.c);
        }
    }
}

// Marks the leaves beside such points, once all triangles have been counted. Whether there is such a point.
INLINED bool mark_beside_points(const CutView *cut, const OwnLeaves *own, Faults *faults, const LeftTriangles *triangles) {
    bool is_any_broken = false;
    for (uint i = get_local_id(0); i < count_left(triangles); i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, cut, nth_left(triangles, i));
        for (uint k = 0; k < 3; k++, triangle = rotated(triangle)) {
            const uint point = triangle.a, index = own_index(own, point);
            if (index == NONE || point >= own->first_node) continue;
            if (!is_broken(point >= own->cell_points, count_around(own, index))) continue;
            is_any_broken = true;
            faults->any |= mark_pair(faults->tree_nodes, own->first_node, point, triangle.b, faults->marks, faults->marked);
            faults->any |= mark_pair(faults->tree_nodes, own->first_node, point, triangle.c, faults->marks, faults->marked);
        }
    }
    return is_any_broken;
}

// Looks for such points, and marks what is beside them, where `recounts` is set: rare, and for a few points. All triangles are counted, as
// a repair may have given these points none that is new. Whether there are any. Called by all work-items.
INLINED bool recount_points(const CutView *cut, OwnLeaves *own, Faults *faults, const LeftTriangles *triangles, bool recounts) {
    if (recounts) clear_around(own);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (recounts) count_all(cut, own, faults, triangles);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    return recounts && mark_beside_points(cut, own, faults, triangles);
}

INLINED CutView view_cut(const TreeTestArgs args, __global const uint *corners, __global const uint *leaves,
                         __global const uint *collapsed_by, __global const uint *keys) {
    CutView cut;
    cut.corners = corners;
    cut.leaves = leaves;
    cut.collapsed_by = collapsed_by;
    cut.keys = keys;
    cut.end_key = end_key(args.tolerance);
    cut.first = args.first;
    cut.removes = args.removes;
    return cut;
}

INLINED OwnLeaves own_leaves(const TreeTestArgs args, __global const Region *region, __global const TreeRegion *tree) {
    OwnLeaves own;
    find_points(&own.points, region, tree);
    own.node_base = tree->node_base;
    own.first_node = args.points;
    own.cell_points = args.cell_points;
    return own;
}

// Lists the triangles of a region that a cut has, counts them by level, and marks nodes whose merging changes the topology: what is
// around the region's own leaves is looked at, in all triangles that have one as a corner. After a repair these are only the leaves that
// the cut before did not have, as a repair takes no triangle from any other. `meshes`: of the full mesh. `left`: numbers of triangles, in
// order; `broken`: regions with points that have too few triangles around them, of themselves; `around`, `edges`: working memory.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_test(const TreeTestArgs args, __global const uint *region_index, __global const uint *renewed,
               __global const Region *regions, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
               __global const RegionMesh *meshes, __global const uint *corners, __global const uint *collapsed_by,
               __global const uint *beside, __global const uint *keys, __global const uint *tops, __global const uint *leaves,
               __global RegionMesh *cut_meshes, __global uint *left, __global uint *around, __global uint *edges,
               __global uchar *marks, __global uint *marked, __global uint *broken, __global uint *failed) {
    __local uint scratch[WIDE_GROUP], counts[6], near, broken_points, local_around[LOCAL_LEAVES], local_edges[LOCAL_EDGES];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    const uint region = regions[group].region, mesh_first = meshes[group].triangle_base, mesh_count = meshes[group].triangles[0];
    const bool is_made = args.first || renewed[group];
    const uint found = find_near(args.grid, &near, region_index, renewed, region);
    const bool is_near = args.first || (found & NEAR), is_around = args.first || (found & AROUND);
    const CutView cut = view_cut(args, corners, leaves, collapsed_by, keys);
    OwnLeaves own = own_leaves(args, regions + group, tree);
    own.local_around = local_around;
    own.global_around = around + 2 * tree->node_base;
    if (is_around) clear_around(&own);
    for (uint i = lid; i < 6; i += WIDE_GROUP) counts[i] = 0;
    if (lid == 0) broken_points = is_around && !args.first ? broken[group] : 0;
    LeftTriangles triangles;
    __global uint *own_left = left + mesh_first + tree->beside_base;
    triangles.left = own_left;
    triangles.beside = mesh_count;
    triangles.count = list_left(&cut, scratch, 0, mesh_first, is_near ? mesh_count : 0, own_left);
    triangles.beside_count =
        list_left(&cut, scratch, beside, tree->beside_base, is_around ? tree->beside_count : 0, own_left + mesh_count);
    EdgeTable table;
    table.corners = corners;
    table.leaves = leaves;
    table.edges = edges + EDGE_WORDS * (3 * (mesh_first + tree->beside_base) + group);
    table.local_edges = local_edges;
    clear_edges(&table, 3 * count_left(&triangles) + 1);
    Faults faults = {tree_nodes, marks, marked, false};
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count_left(&triangles); i += WIDE_GROUP) {
        const uint number = nth_left(&triangles, i);
        CutTriangle triangle;
        nth_triangle(&triangle, &cut, number);
        if (i < triangles.count) add_local(&counts[triangle.level], 1);
        if (!cut.first && !triangle.changed) continue;
        add_corner(&own, &table, &faults, 3 * number, triangle.a, triangle.b, triangle.c);
        add_corner(&own, &table, &faults, 3 * number + 1, triangle.b, triangle.c, triangle.a);
        add_corner(&own, &table, &faults, 3 * number + 2, triangle.c, triangle.a, triangle.b);
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (is_near)
        for (uint i = lid; i < 6; i += WIDE_GROUP) cut_meshes[group].triangles[i] = counts[i];
    if (is_made && mark_broken_nodes(&cut, &own, &faults, tree->nodes, tops)) broken_points = 1;
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    const bool recounts = broken_points;
    if (recounts && !is_near)
        for (uint level = 0; level < 6; level++) triangles.count += cut_meshes[group].triangles[level];
    if (lid == 0 && is_around) broken[group] = 0;
    if (recount_points(&cut, &own, &faults, &triangles, recounts)) broken[group] = 1;
    if (faults.any) *failed = 1;
}
