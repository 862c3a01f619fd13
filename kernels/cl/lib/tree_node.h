// The packed fields of TreeNode; `meta` is its last one.
//
// Nodes of level 0 are made in regions, those of level l in blocks of 2^l regions along each axis.
#ifndef ISOPEEL_TREE_NODE_H
#define ISOPEEL_TREE_NODE_H

#include "lib/grid.h"
#include "lib/layout.h"

// How far relaxation moves a node at most, smallest spacings: further than this only if its own error is large
// (docs/algorithm.md#83-relaxation).
#define MIN_MOVE 0.04f
// That limit in 9 bits: its sign, exponent and five bits of its mantissa, less those of MIN_MOVE.
#define MOVE_SHIFT 18
#define MOVE_CODES 512u
inline uint move_code(float limit) {
    return min((as_uint(fmax(limit, MIN_MOVE)) - as_uint(MIN_MOVE)) >> MOVE_SHIFT, MOVE_CODES - 1);
}

// Packs a position from the block's low corner, 2^level/VERTEX_LATTICE cell: 0 to 2^16, 17 bits each. Then the limit of its movement, and the
// block's level, 4 bits.
inline void pack_tree_position(TreeNode *node, int3 at, float max_move, uint level) {
    node->position[0] = (uint)at.x | (uint)at.y << 17;
    node->position[1] = (uint)at.y >> 15 | (uint)at.z << 2 | move_code(max_move) << 19 | level << 28;
}
inline uint tree_block_level(TreeNode node) { return node.position[1] >> 28; }
inline float tree_max_move(TreeNode node) {
    return as_float(as_uint(MIN_MOVE) + ((node.position[1] >> 19 & (MOVE_CODES - 1)) << MOVE_SHIFT));
}
// The position from the block's low corner, 1/VERTEX_LATTICE cell.
inline int3 tree_position(TreeNode node) {
    const uint low = node.position[0], high = node.position[1];
    return (int3)((int)(low & 0x1ffffu), (int)(low >> 17 | (high & 3u) << 15), (int)(high >> 2 & 0x1ffffu)) << (int)tree_block_level(node);
}

inline uint tree_level(uint meta) { return meta & 7u; }
inline uint tree_is_on_border(uint meta) { return meta & NODE_BORDER ? 1 : 0; }
// Of a point or a node. `points`: of the surface, of which those from `cell_points` on are on the border.
inline bool leaf_is_on_border(uint points, uint cell_points, __global const TreeNode *nodes, uint leaf) {
    return leaf < points ? leaf >= cell_points : tree_is_on_border(nodes[leaf - points].meta);
}
inline uint tree_node_region(uint meta) { return meta >> 6; }

// The low corner of a block, of which `region` is one of the regions.
inline int3 tree_block_origin(Grid grid, uint region, uint level) {
    return convert_int3(region_coords(grid, region) >> level << level) * 32;
}
inline int3 tree_node_origin(Grid grid, __global const Region *regions, TreeNode node) {
    return tree_block_origin(grid, regions[tree_node_region(node.meta)].region, tree_block_level(node));
}

#endif
