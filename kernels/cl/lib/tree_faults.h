// Faults of a cut of the vertex tree, and the marks that undo the merges behind them: two leaves that meet along more than one line, a leaf
// with too few triangles around it, a border that has closed.
#ifndef ISOPEEL_TREE_FAULTS_H
#define ISOPEEL_TREE_FAULTS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"

// The faults that a region finds, and the buffers for marking them.
typedef struct {
    __global const TreeRegion *tree_regions;
    __global const TreeNode *tree_nodes;
    __global const uchar2 *lives; // of leaves
    __global uchar *marks;
    __global uint *marked;
    bool any;
} Faults;

// Marks the node of a leaf.
INLINED void mark_leaf(const Faults *faults, uint points, uint leaf) {
    const TreeNode node = faults->tree_nodes[leaf - points];
    uint block = tree_node_region(node.meta);
    for (uint level = tree_block_level(node); level > 0; level--) block = faults->tree_regions[block].above;
    faults->marks[leaf - points] = 1;
    faults->marked[block] = 1;
}

// Marks two leaves that meet along more than one line: of two nodes only the later one. `points`: the leaves before those that are nodes.
// Returns whether one of them is a node.
INLINED bool mark_pair(const Faults *faults, uint points, uint a, uint b) {
    if (max(a, b) < points) return false;
    mark_leaf(faults, points, max(a, b));
    return true;
}

// A corner of a triangle: its leaf, the leaf's index in the region or NONE, and the rounds during which it existed.
typedef struct {
    uint leaf, index;
    uchar2 life;
} TestedCorner;

INLINED void find_corner(TestedCorner *out, const OwnLeaves *own, const Faults *faults, uint leaf) {
    out->leaf = leaf;
    out->index = own_index(own, leaf);
    out->life = faults->lives[leaf];
}

// Counts a triangle around its first corner, a leaf of the region.
inline void count_corner(const OwnLeaves *own, const Faults *faults, const TestedCorner *a, uint b, uint c) {
    const uint by = around_corner(is_border_leaf(own, faults->tree_nodes, a->leaf), b, c);
    if (own->is_local) add_local(own->local_around + a->index, by);
    else add_global(own->global_around + a->index, by);
}

// Whether two leaves can meet along more than one line. They cannot if both existed in the same round of building the tree: no round's merges
// made such an edge, and the edges between two leaves depend on these leaves alone. Points of other regions existed in all rounds. Edges of
// leaves of levels above are not tested here.
inline bool may_meet_twice(const OwnLeaves *own, const TestedCorner *a, const TestedCorner *b) {
    if (max(a->leaf, b->leaf) >= own->first_above) return false;
    if (a->index == NONE || b->index == NONE) return min(a->leaf, b->leaf) >= own->first_node;
    return !lived_together(a->life, b->life);
}

// Marks the later of two leaves, one of them the region's, that meet along more than one line: a surface has each directed edge once. `corner`: number,
// in the full mesh, of the corner at which the edge begins.
INLINED void test_edge(const OwnLeaves *own, const EdgeTable *table, Faults *faults, uint corner, const TestedCorner *from,
                       const TestedCorner *to) {
    if (!may_meet_twice(own, from, to)) return;
    const uint a = from->leaf, b = to->leaf;
    // Inside the surface the triangle on the other side of the edge has the opposite edge, which is tested instead.
    if (a > b && !(is_border_leaf(own, faults->tree_nodes, a) && is_border_leaf(own, faults->tree_nodes, b))) return;
    if (!put_edge(table, corner, a, b)) return;
    mark_pair(faults, own->first_node, a, b);
    faults->any = true;
}

// Marks nodes that have too few triangles around them or at which the border has closed. Returns whether a point may have the same fault.
INLINED bool mark_broken_nodes(const CutView *cut, const OwnLeaves *own, Faults *faults, uint nodes, __global const uint *tops) {
    const uint own_points = count_points(own->points);
    for (uint i = get_local_id(0); i < nodes; i += WIDE_GROUP) {
        const uint at = own->node_base + i, leaf = own->first_node + at, count = count_around(own, own_points + i);
        // One branch for both conditions, because each by itself is unpredictable.
        if (!((uint)(count < 3) & (uint)(leaf_number(tops[at]) == leaf))) continue;
        if (!is_broken(tree_is_on_border(faults->tree_nodes[at].meta), count)) continue;
        mark_leaf(faults, own->first_node, leaf);
        faults->any = true;
    }
    uint broken_points = 0;
    for (uint i = get_local_id(0); i < own_points; i += WIDE_GROUP) {
        const uint point = nth_point(own->points, i);
        broken_points |= (uint)(count_around(own, i) < 3) & (uint)(leaf_number(cut->leaves[point]) == point);
    }
    return broken_points;
}

// The corners of the full mesh at each point of a region.
typedef struct {
    __global const uint *numbers, *ends; // numbers of corners; of each point, the end of its range
    uint base;                           // start of the region's range
} PointCorners;

inline uint corners_begin(const PointCorners *at, const OwnLeaves *own, uint i) {
    return i ? at->ends[nth_point(own->points, i - 1)] : at->base;
}

// Marks the leaves beside those points of the region that have too few triangles around them or at which the border has closed. Such points
// are rare. Returns whether there is one.
INLINED bool mark_beside_points(const CutView *cut, const OwnLeaves *own, Faults *faults, const PointCorners *at) {
    bool is_any_broken = false;
    for (uint i = get_local_id(0); i < count_points(own->points); i += WIDE_GROUP) {
        const uint point = nth_point(own->points, i), begin = corners_begin(at, own, i), end = at->ends[point];
        if (leaf_number(cut->leaves[point]) != point) continue;
        const bool on_border = point >= own->cell_points;
        uint around = 0, left = 0;
        for (uint k = begin; k < end; k++) {
            CutTriangle triangle;
            if (!triangle_at(&triangle, cut, at->numbers[k])) continue;
            around += around_corner(on_border, triangle.b, triangle.c);
            left++;
        }
        if (!left || !is_broken(on_border, around)) continue;
        is_any_broken = true;
        for (uint k = begin; k < end; k++) {
            CutTriangle triangle;
            if (!triangle_at(&triangle, cut, at->numbers[k])) continue;
            faults->any |= mark_pair(faults, own->first_node, point, triangle.b);
            faults->any |= mark_pair(faults, own->first_node, point, triangle.c);
        }
    }
    return is_any_broken;
}

#endif
