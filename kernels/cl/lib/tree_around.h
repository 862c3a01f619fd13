// Triangles of a cut of the vertex tree, and the counts of triangles around its leaves.
#ifndef ISOPEEL_TREE_AROUND_H
#define ISOPEEL_TREE_AROUND_H

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/corners.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_key.h"
#include "lib/tree_leaf.h"

// The full mesh in a cut.
typedef struct {
    __global const uint *corners, *leaves; // points of the triangles, and their leaves
    __global const uint *collapsed_by;     // of each triangle (tree_collapse)
    __global const uint *keys;
    uint end_key; // the lowest one that is not merged
    bool removes; // parts are left out
} CutView;

// A triangle of the full mesh between leaves.
typedef struct {
    uint a, b, c;
    uint level;
} CutTriangle;

INLINED void nth_triangle(CutTriangle *out, const CutView *cut, uint triangle) {
    __global const uint *at = cut->corners + 3 * triangle;
    const uint a = cut->leaves[at[0]], b = cut->leaves[at[1]], c = cut->leaves[at[2]];
    out->a = leaf_number(a);
    out->b = leaf_number(b);
    out->c = leaf_number(c);
    out->level = min(leaf_level(a), min(leaf_level(b), leaf_level(c)));
}

// Whether the triangle remains in a cut: it has not degenerated to a line or a point.
INLINED bool is_left(const CutView *cut, uint triangle) {
    const uint node = cut->collapsed_by[triangle];
    // Branch-free: the outcome is unpredictable.
    const uint key = cut->keys[node == NONE ? 0 : node];
    const uint is_kept = (uint)(node == NONE) | (uint)(key_bits(key) >= cut->end_key);
    if (!cut->removes) return is_kept;
    return is_kept && leaf_number(cut->leaves[cut->corners[3 * triangle]]) != LEAF_REMOVED;
}

// The triangle of a corner of the full mesh, from that corner on. Returns whether it remains in the cut; only then `out` is filled in.
INLINED bool triangle_at(CutTriangle *out, const CutView *cut, uint corner) {
    if (!is_left(cut, corner / 3)) return false;
    out->a = leaf_number(cut->leaves[cut->corners[corner]]);
    out->b = leaf_number(cut->leaves[cut->corners[next_corner(corner)]]);
    out->c = leaf_number(cut->leaves[cut->corners[previous_corner(corner)]]);
    return true;
}

// Index of a region's first entry in lists that hold all triangles and those beside regions.
inline uint list_base(__global const RegionMesh *mesh, __global const TreeRegion *tree) { return mesh->triangle_base + tree->beside_base; }

inline uint count_triangles(__global const RegionMesh *mesh) {
    uint count = 0;
    for (uint level = 0; level < 6; level++) count += mesh->triangles[level];
    return count;
}

#if WIDE_GROUP > 1
#define LISTED_RUN 4 // triangles in a row of one work-item: one prefix sum for all of them
#else
#define LISTED_RUN 1
#endif

// Lists those of `count` triangles that remain in a cut. The triangles are those from `first` on, or the ones that `numbers` lists. Returns
// how many remain.
INLINED uint list_left(const CutView *cut, __local uint *scratch, __global const uint *numbers, uint first, uint count,
                       __global uint *left) {
    uint kept = 0, total;
    for (uint begin = 0; begin < count; begin += LISTED_RUN * WIDE_GROUP) {
        const uint own = begin + LISTED_RUN * get_local_id(0);
        uint triangles[LISTED_RUN], own_kept = 0;
        bool is_kept[LISTED_RUN];
        for (uint i = 0; i < LISTED_RUN; i++) {
            const bool is_there = own + i < count;
            triangles[i] = is_there && numbers ? numbers[first + own + i] : first + own + i;
            is_kept[i] = is_there && is_left(cut, triangles[i]);
            own_kept += is_kept[i];
        }
        uint to = kept + scan_group(scratch, own_kept, &total);
        // Branch-free: if a triangle does not remain, the next one overwrites it.
        for (uint i = 0; i < LISTED_RUN; i++)
            if (WIDE_GROUP == 1 || is_kept[i]) left[to++] = triangles[i];
        kept += total;
    }
    return kept;
}

// Leaves of a region, and the counts of triangles around them.
typedef struct {
    TreePoints points;
    uint node_base, nodes;      // of the region
    uint first_node;            // of leaves that are nodes
    uint first_above;           // of leaves that are nodes of levels above
    uint cell_points;           // of the surface
    __local uint *local_around; // by own_leaf_index; on a GPU, memory in which adding is faster
    __global uint *global_around;
    bool is_local;
} OwnLeaves;

#if WIDE_GROUP > 1
#define LOCAL_LEAVES 2048 // with LOCAL_EDGES below 32 KiB, which is all that OpenCL promises a full profile
#else
#define LOCAL_LEAVES 1 // all memory of a CPU is the same
#endif

inline uint own_index(const OwnLeaves *own, uint leaf) {
    return own_leaf_index(&own->points, own->node_base, own->nodes, own->first_node, leaf);
}
inline uint count_around(const OwnLeaves *own, uint index) {
    return own->is_local ? own->local_around[index] : own->global_around[index];
}

inline void clear_around(OwnLeaves *own) {
    const uint leaves = 2 * count_points(own->points);
    own->is_local = WIDE_GROUP > 1 && leaves <= LOCAL_LEAVES;
    for (uint i = get_local_id(0); i < leaves; i += WIDE_GROUP)
        if (own->is_local) own->local_around[i] = 0;
        else own->global_around[i] = 0;
}

inline bool is_border_leaf(const OwnLeaves *own, __global const TreeNode *tree_nodes, uint leaf) {
    // Most surfaces have no border.
    if (own->first_node == own->cell_points) return false;
    return leaf_is_on_border(own->first_node, own->cell_points, tree_nodes, leaf);
}

#endif
