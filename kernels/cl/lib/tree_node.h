// The packed fields of TreeNode; `meta` is its last one.
#ifndef ISOPEEL_TREE_NODE_H
#define ISOPEEL_TREE_NODE_H

#include "lib/layout.h"

// A position from the region's low corner, 1/VERTEX_LATTICE cell: 0 to 2^16, 17 bits each.
inline void pack_tree_position(TreeNode *node, int3 at) {
    node->position[0] = (uint)at.x | (uint)at.y << 17;
    node->position[1] = (uint)at.y >> 15 | (uint)at.z << 2;
}
inline int3 tree_position(TreeNode node) {
    const uint low = node.position[0], high = node.position[1];
    return (int3)((int)(low & 0x1ffffu), (int)(low >> 17 | (high & 3u) << 15), (int)(high >> 2));
}

inline uint tree_level(uint meta) { return meta & 7u; }
inline uint tree_is_on_border(uint meta) { return meta >> 3 & 1u; }
inline uint tree_node_region(uint meta) { return meta >> 6; }

#endif
