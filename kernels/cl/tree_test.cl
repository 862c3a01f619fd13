// tree_test: tests whether a cut of the vertex tree has the surface's topology (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group
// a region.
//
//   kernel       writes
//   tree_test    the remaining triangles; marks nodes beside an edge of more than two of them, or with too few of them around
//   tree_retest  the same marks, after a repair
//   tree_list    the remaining triangles, after all repairs
//
// The cut is repeated until none of its merges changes the topology. After the first cut, faults are only possible beside leaves that the
// previous cut did not have, so only triangles with such a corner are tested.
//
// Each region tests the surroundings of its own leaves, in its own triangles and those beside it. So it does not wait for other regions,
// and all that it reads and counts is near in memory.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_faults.h"
#include "lib/tree_key.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

#define NEAR 1u   // in the region or in one before it, as a region's triangles have corners in these
#define AROUND 2u // in any of the 27 regions

// Returns NEAR and AROUND, whichever hold: whether `numbers` is not 0 for a region near or around this one. Called by all work-items.
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

// Structs by address, not as results: Oclgrind fails on these here (llvm.experimental.noalias.scope.decl).
INLINED void set_cut(CutView *cut, const TreeTestArgs args, __global const uint *corners, __global const uint *leaves,
                     __global const uint *collapsed_by, __global const uint *keys) {
    cut->corners = corners;
    cut->leaves = leaves;
    cut->collapsed_by = collapsed_by;
    cut->keys = keys;
    cut->end_key = end_key(args.tolerance);
    cut->removes = args.removes;
}

INLINED void set_own(OwnLeaves *own, const TreeTestArgs args, __global const Region *region, __global const TreeRegion *tree,
                     __local uint *local_around, __global uint *around) {
    find_points(&own->points, region, tree);
    own->node_base = tree->node_base;
    own->nodes = tree->nodes;
    own->first_node = args.points;
    own->first_above = args.first_above;
    own->cell_points = args.cell_points;
    own->is_local = false;
    own->local_around = local_around;
    own->global_around = around + 2 * tree->cluster_base;
}

INLINED void set_point_corners(PointCorners *at, __global const uint *numbers, __global const uint *ends, uint list_base) {
    at->numbers = numbers;
    at->ends = ends;
    at->base = 3 * list_base;
}

// A region's table of edges. `edges`: of all regions; each has one for each corner in its lists, and one that stays free.
INLINED void set_table(EdgeTable *table, const CutView *cut, uint group, uint list_base, __global uint *edges, __local uint *local_edges) {
    table->corners = cut->corners;
    table->leaves = cut->leaves;
    table->edges = edges + EDGE_WORDS * (3 * list_base + group);
    table->local_edges = local_edges;
}

// If the first corner of a triangle is the region's, counts the triangle around it and tests the edge that begins there.
INLINED void test_corner(const OwnLeaves *own, const EdgeTable *table, Faults *faults, uint corner, const TestedCorner *a,
                         const TestedCorner *b, uint c) {
    if (a->index == NONE) return;
    count_corner(own, faults, a, b->leaf, c);
    test_edge(own, table, faults, corner, a, b);
}

INLINED void test_triangle(const OwnLeaves *own, const EdgeTable *table, Faults *faults, uint number, const CutTriangle *triangle) {
    TestedCorner a, b, c;
    find_corner(&a, own, faults, triangle->a);
    find_corner(&b, own, faults, triangle->b);
    find_corner(&c, own, faults, triangle->c);
    test_corner(own, table, faults, 3 * number, &a, &b, c.leaf);
    test_corner(own, table, faults, 3 * number + 1, &b, &c, a.leaf);
    test_corner(own, table, faults, 3 * number + 2, &c, &a, b.leaf);
}

// Lists the triangles of a region that remain in a cut, counts them by level, and marks nodes whose merging changes the topology. Tests the
// surroundings of the region's own leaves, in all triangles that have one as a corner. `meshes`: of the full mesh. `left`: numbers of
// triangles, in order; `broken`: regions with points that have too few triangles around them, of themselves; `stale`: cleared; `around`,
// `edges`: working memory.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_test(const TreeTestArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
               __global const TreeNode *tree_nodes, __global const uchar2 *lives, __global const RegionMesh *meshes,
               __global const uint *corners, __global const uint *collapsed_by, __global const uint *beside,
               __global const uint *point_corners, __global const uint *corner_ends, __global const uint *keys,
               __global const uint *tops, __global const uint *leaves, __global RegionMesh *cut_meshes, __global uint *left,
               __global uint *around, __global uint *edges, __global uchar *marks, __global uint *marked, __global uint *broken,
               __global uint *stale, __global uint *failed) {
    __local uint scratch[WIDE_GROUP], counts[6], broken_points, local_around[LOCAL_LEAVES], local_edges[LOCAL_EDGES];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    __global const RegionMesh *mesh = meshes + group;
    const uint base = list_base(mesh, tree);
    CutView cut;
    set_cut(&cut, args, corners, leaves, collapsed_by, keys);
    OwnLeaves own;
    set_own(&own, args, regions + group, tree, local_around, around);
    clear_around(&own);
    for (uint i = lid; i < 6; i += WIDE_GROUP) counts[i] = 0;
    if (lid == 0) broken_points = stale[group] = 0;
    __global uint *own_left = left + base;
    const uint own_count = list_left(&cut, scratch, 0, mesh->triangle_base, mesh->triangles[0], own_left);
    const uint count = own_count + list_left(&cut, scratch, beside, tree->beside_base, tree->beside_count, own_left + own_count);
    EdgeTable table;
    set_table(&table, &cut, group, base, edges, local_edges);
    clear_edges(&table, 3 * count + 1);
    Faults faults = {tree_regions, tree_nodes, lives, marks, marked, false};
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, &cut, own_left[i]);
        if (i < own_count) add_local(&counts[triangle.level], 1);
        test_triangle(&own, &table, &faults, own_left[i], &triangle);
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < 6; i += WIDE_GROUP) cut_meshes[group].triangles[i] = counts[i];
    if (mark_broken_nodes(&cut, &own, &faults, tree->nodes, tops)) broken_points = 1;
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (lid == 0) broken[group] = 0;
    const bool recounts = broken_points;
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    PointCorners at;
    set_point_corners(&at, point_corners, corner_ends, base);
    if (recounts && mark_beside_points(&cut, &own, &faults, &at)) broken[group] = 1;
    if (faults.any) *failed = 1;
}

// The region's points whose leaves are new: the previous cut did not have them.
typedef struct {
    __global const uint *points; // which of the region's
    uint count;
} ChangedPoints;

// Clears the counts around these leaves. Returns the number of corners of the full mesh at the points of this work-item.
INLINED uint clear_changed(const CutView *cut, const OwnLeaves *own, const PointCorners *at, const ChangedPoints *changed) {
    uint corners = 0;
    for (uint n = get_local_id(0); n < changed->count; n += WIDE_GROUP) {
        const uint i = changed->points[n], point = nth_point(own->points, i);
        const uint index = own_index(own, leaf_number(cut->leaves[point]));
        if (index != NONE) own->global_around[index] = 0; // not that of a removed part
        corners += at->ends[point] - corners_begin(at, own, i);
    }
    return corners;
}

// Counts the triangles around these leaves, and tests the edges that begin or end there. An edge between two of them is tested once, at the
// leaf at which it begins.
INLINED void test_changed(const CutView *cut, const OwnLeaves *own, const EdgeTable *table, Faults *faults, const PointCorners *at,
                          const ChangedPoints *changed) {
    for (uint n = get_local_id(0); n < changed->count; n += WIDE_GROUP) {
        const uint i = changed->points[n], end = at->ends[nth_point(own->points, i)];
        for (uint k = corners_begin(at, own, i); k < end; k++) {
            const uint corner = at->numbers[k], before = previous_corner(corner);
            CutTriangle triangle;
            if (!triangle_at(&triangle, cut, corner)) continue;
            TestedCorner a, b, c;
            find_corner(&a, own, faults, triangle.a);
            if (a.index == NONE) continue; // of a level above
            find_corner(&b, own, faults, triangle.b);
            count_corner(own, faults, &a, triangle.b, triangle.c);
            test_edge(own, table, faults, corner, &a, &b);
            if (cut->leaves[cut->corners[before]] & LEAF_CHANGED) continue;
            find_corner(&c, own, faults, triangle.c);
            test_edge(own, table, faults, before, &c, &a);
        }
    }
}

// Marks those of these leaves that are nodes and have too few triangles around them, or at which the border has closed. Returns whether a
// point has the same fault.
INLINED bool mark_broken_changed(const CutView *cut, const OwnLeaves *own, Faults *faults, const ChangedPoints *changed) {
    bool is_any_point = false;
    for (uint n = get_local_id(0); n < changed->count; n += WIDE_GROUP) {
        const uint leaf = leaf_number(cut->leaves[nth_point(own->points, changed->points[n])]), index = own_index(own, leaf);
        if (index == NONE || !is_broken(is_border_leaf(own, faults->tree_nodes, leaf), count_around(own, index))) continue;
        if (leaf < own->first_node) {
            is_any_point = true;
            continue;
        }
        mark_leaf(faults, own->first_node, leaf);
        faults->any = true;
    }
    return is_any_point;
}

// Marks nodes whose merging changes the topology, after a repair. Only the surroundings of new leaves are tested, because a repair removes no
// triangle from any other leaf. `renewed`: regions that may have new leaves; `changed`, `changed_counts`: from tree_leaves. `stale`: set if
// the list of the region's remaining triangles may be outdated.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_retest(const TreeTestArgs args, __global const uint *region_index, __global const uint *renewed,
                 __global const Region *regions, __global const TreeRegion *tree_regions, __global const TreeNode *tree_nodes,
                 __global const uchar2 *lives, __global const RegionMesh *meshes, __global const uint *corners,
                 __global const uint *collapsed_by, __global const uint *point_corners, __global const uint *corner_ends,
                 __global const uint *keys, __global const uint *leaves, __global const uint *changed,
                 __global const uint *changed_counts, __global uint *around, __global uint *edges, __global uchar *marks,
                 __global uint *marked, __global uint *broken, __global uint *stale, __global uint *failed) {
    __local uint near, changed_corners, recounts, local_edges[LOCAL_EDGES], no_around[1];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    __global const RegionMesh *mesh = meshes + group;
    const uint base = list_base(mesh, tree), found = find_near(args.grid, &near, region_index, renewed, regions[group].region);
    CutView cut;
    set_cut(&cut, args, corners, leaves, collapsed_by, keys);
    OwnLeaves own;
    set_own(&own, args, regions + group, tree, no_around, around);
    PointCorners at;
    set_point_corners(&at, point_corners, corner_ends, base);
    const ChangedPoints of = {changed + tree->cluster_base, found ? changed_counts[group] : 0};
    if (lid == 0) {
        changed_corners = 0;
        recounts = found ? broken[group] : 0;
        if (found & NEAR) stale[group] = 1;
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    add_local(&changed_corners, clear_changed(&cut, &own, &at, &of));
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    EdgeTable table;
    set_table(&table, &cut, group, base, edges, local_edges);
    // Two edges per corner of changed points, but at most all edges of the region's lists.
    clear_edges(&table, min(2 * changed_corners, 3 * (mesh->triangles[0] + tree->beside_count)) + 1);
    Faults faults = {tree_regions, tree_nodes, lives, marks, marked, false};
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    test_changed(&cut, &own, &table, &faults, &at, &of);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (mark_broken_changed(&cut, &own, &faults, &of)) recounts = 1;
    if (lid == 0 && found) broken[group] = 0;
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (recounts && mark_beside_points(&cut, &own, &faults, &at)) broken[group] = 1;
    if (faults.any) *failed = 1;
}

// For regions that repairs have changed (`stale`), lists the triangles that remain in a cut, and counts them by level.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_list(const TreeTestArgs args, __global const TreeRegion *tree_regions, __global const RegionMesh *meshes,
               __global const uint *corners, __global const uint *collapsed_by, __global const uint *keys,
               __global const uint *leaves, __global const uint *stale, __global RegionMesh *cut_meshes, __global uint *left) {
    __local uint scratch[WIDE_GROUP], counts[6];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0), is_stale = stale[group];
    __global const RegionMesh *mesh = meshes + group;
    CutView cut;
    set_cut(&cut, args, corners, leaves, collapsed_by, keys);
    __global uint *own_left = left + list_base(mesh, tree_regions + group);
    for (uint i = lid; i < 6; i += WIDE_GROUP) counts[i] = 0;
    const uint count = list_left(&cut, scratch, 0, mesh->triangle_base, is_stale ? mesh->triangles[0] : 0, own_left);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, &cut, own_left[i]);
        add_local(&counts[triangle.level], 1);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (is_stale)
        for (uint i = lid; i < 6; i += WIDE_GROUP) cut_meshes[group].triangles[i] = counts[i];
}
