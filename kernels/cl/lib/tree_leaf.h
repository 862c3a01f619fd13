// Leaves of a cut of the vertex tree: a point by its number, or a node by its number behind those of all points.
#ifndef ISOPEEL_TREE_LEAF_H
#define ISOPEEL_TREE_LEAF_H

#include "lib/layout.h"
#include "lib/tree_node.h"

// Points of a region: those of cells and sheets, and those on the volume's faces.
typedef struct {
    uint first, count, border_first, border_count;
} TreePoints;

inline uint count_cell_points(__global const Region *region) {
    return region->level_base[1] + region->level_base[7] - region->level_base[6];
}
inline void find_points(TreePoints *points, __global const Region *region, __global const TreeRegion *tree) {
    points->first = region->point_base;
    points->count = count_cell_points(region);
    points->border_first = tree->border_base;
    points->border_count = tree->border_points;
}
// The same of a block: one above level 0, behind `regions`, has no points of its own.
inline void find_block_points(TreePoints *points, __global const Region *of_regions, uint regions, __global const TreeRegion *tree_regions,
                              uint block) {
    if (block < regions) find_points(points, of_regions + block, tree_regions + block);
    else points->first = points->count = points->border_first = points->border_count = 0;
}
inline uint count_points(TreePoints points) { return points.count + points.border_count; }
inline uint nth_point(TreePoints points, uint i) {
    return i < points.count ? points.first + i : points.border_first + i - points.count;
}

// Nodes of a block after a round, and before it.
inline uint round_end(__global const uint *round_ends, uint block, uint round) { return round_ends[TREE_ROUNDS * block + round]; }
inline uint round_begin(__global const uint *round_ends, uint block, uint round) {
    return round ? round_ends[TREE_ROUNDS * block + round - 1] : 0;
}

// A leaf as stored for a point: its number, its level, and whether the point had another leaf in the previous cut.
#define LEAF_NUMBER 0x0fffffffu
#define LEAF_LEVEL_SHIFT 28
#define LEAF_CHANGED 0x80000000u
// Stored instead of a leaf if the point's part was removed. All corners of the part's triangles have it, so the triangles degenerate and
// are left out. No node has this number, because there are fewer nodes than points.
#define LEAF_REMOVED LEAF_NUMBER

inline uint pack_leaf(uint leaf, uint level) { return leaf | level << LEAF_LEVEL_SHIFT; }
// A leaf with the flag LEAF_CHANGED if it differs from that of the previous cut.
inline uint changed_leaf(uint leaf, uint before) { return leaf != (before & ~LEAF_CHANGED) ? leaf | LEAF_CHANGED : leaf; }
inline uint leaf_number(uint packed) { return packed & LEAF_NUMBER; }
// Level of the smallest cube that is as large as the cells that the leaf represents.
inline uint leaf_level(uint packed) { return packed >> LEAF_LEVEL_SHIFT & 7u; }

// Life of a leaf while the tree was built, in rounds: from the one that made it, 0 for points, to before the one that merged it. Two bytes.
#define ENDLESS_LIFE 0xffu // above TREE_ROUNDS
inline uint life_begin(uint leaf) { return 2 * leaf; }
inline uint life_end(uint leaf) { return 2 * leaf + 1; }
// Whether two leaves of a region existed in the same round.
inline bool lived_together(uchar2 a, uchar2 b) { return max(a.x, b.x) < min(a.y, b.y); }

// The value that a triangle adds to `around` of a corner. Off the border it counts triangles. On the border the sum is the difference of the
// fan's two ends, which is 0 if the fan has closed.
inline uint around_corner(bool on_border, uint after, uint before) { return on_border ? after - before : 1u; }
// Whether a leaf has too few triangles around it, or the border at it has closed.
inline bool is_broken(bool on_border, uint around) { return on_border ? around == 0 : around < 3; }

// Index of a leaf in the region that has these points, and `nodes` nodes from `node_base` on: points first, then nodes. NONE if the leaf
// belongs to another block.
inline uint own_leaf_index(const TreePoints *own, uint node_base, uint nodes, uint points, uint leaf) {
    const uint own_points = own->count + own->border_count;
    const bool is_node = leaf >= points;
    const uint index = leaf - (is_node ? points + node_base : own->first);
    if (index < (is_node ? nodes : own->count)) return index + (is_node ? own_points : 0);
    return leaf - own->border_first < own->border_count ? own->count + leaf - own->border_first : NONE;
}

#endif
