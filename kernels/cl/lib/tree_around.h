// Triangles of a cut of the vertex tree, and how many are around its leaves.
#ifndef ISOPEEL_TREE_AROUND_H
#define ISOPEEL_TREE_AROUND_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_leaf.h"

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

#endif
