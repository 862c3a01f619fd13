// tree_test_above: tests the surroundings of those leaves of a cut of the vertex tree that are nodes of levels above the regions
// (docs/algorithm.md#8-cuts-of-the-vertex-tree). They have triangles in many regions, and there are few of them, so that the whole surface
// has one table of their edges.
//
//   kernel           work-group  writes
//   tree_begin_above any         clears the counts around these leaves, and the table of edges
//   tree_test_above  a region    how many triangles each of these leaves has; marks nodes that meet along more than one line
//   tree_mark_above  any         marks nodes with too few triangles around them

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_faults.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

// What the test reads, and what it counts and inserts into.
typedef struct {
    TreeTestArgs args;
    uint capacity;
    __global const uint *corners, *leaves;
    __global const TreeNode *nodes;
    __global uint *around, *edges;
} TestAbove;

inline bool is_above(const TestAbove *in, uint leaf) { return leaf >= in->args.first_above; }
inline bool is_border(const TestAbove *in, uint leaf) {
    return leaf_is_on_border(in->args.points, in->args.cell_points, in->nodes, leaf);
}

// Counts a triangle around its first corner, and inserts the edge that begins there, if one of its ends is of a level above.
INLINED void test_corner_above(const TestAbove *in, Faults *faults, uint corner, uint a, uint b, uint c) {
    if (is_above(in, a)) atomic_add(in->around + (a - in->args.first_above), around_corner(is_border(in, a), b, c));
    if (!is_above(in, max(a, b))) return;
    // Inside the surface the triangle on the other side of the edge has the opposite edge, which is tested instead.
    if (a > b && !(is_border(in, a) && is_border(in, b))) return;
    if (put_shared_edge(in->edges, in->capacity, in->corners, in->leaves, corner, a, b)) faults->any |= mark_pair(faults, in->args.points, a, b);
}

__kernel void tree_begin_above(const uint count, const uint capacity, __global uint *around, __global uint *edges) {
    const uint i = (uint)get_global_id(0);
    if (i < count) around[i] = 0;
    if (i < capacity) edges[i] = NONE;
}

// `left`: numbers of the triangles that remain, of tree_test or tree_list; `around`, `edges`: cleared, of `capacity` edges.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_test_above(const TreeTestArgs args, const uint capacity, __global const TreeRegion *tree_regions,
                     __global const TreeNode *tree_nodes, __global const RegionMesh *meshes, __global const uint *corners,
                     __global const uint *leaves, __global const RegionMesh *cut_meshes, __global const uint *left,
                     __global uint *around, __global uint *edges, __global uchar *marks, __global uint *marked, __global uint *failed) {
    const uint group = (uint)get_group_id(0), count = count_triangles(cut_meshes + group);
    __global const uint *own_left = left + list_base(meshes + group, tree_regions + group);
    const TestAbove in = {args, capacity, corners, leaves, tree_nodes, around, edges};
    Faults faults = {tree_regions, tree_nodes, 0, marks, marked, false};
    CutView cut;
    cut.corners = corners;
    cut.leaves = leaves;
    for (uint i = get_local_id(0); i < count; i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, &cut, own_left[i]);
        if (!is_above(&in, max(triangle.a, max(triangle.b, triangle.c)))) continue;
        const uint corner = 3 * own_left[i];
        test_corner_above(&in, &faults, corner, triangle.a, triangle.b, triangle.c);
        test_corner_above(&in, &faults, corner + 1, triangle.b, triangle.c, triangle.a);
        test_corner_above(&in, &faults, corner + 2, triangle.c, triangle.a, triangle.b);
    }
    if (faults.any) *failed = 1;
}

// `count`: nodes of levels above; `tops`: of tree_leaves; `around`: of tree_test_above.
__kernel void tree_mark_above(const TreeTestArgs args, const uint count, __global const TreeRegion *tree_regions,
                              __global const TreeNode *tree_nodes, __global const uint *tops, __global const uint *around,
                              __global uchar *marks, __global uint *marked, __global uint *failed) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const uint leaf = args.first_above + i, node = leaf - args.points;
    if (leaf_number(tops[node]) != leaf || !is_broken(tree_is_on_border(tree_nodes[node].meta), around[i])) return;
    const Faults faults = {tree_regions, tree_nodes, 0, marks, marked, false};
    mark_leaf(&faults, args.points, leaf);
    *failed = 1;
}
