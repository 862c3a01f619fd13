// How far nodes of the vertex tree move in a cut (docs/algorithm.md#83-relaxation): sums of offsets, and what becomes of them.
//
// The offsets around a node are one number, so that they take one atomic operation: how many from bit COUNT_SHIFT on, and below, with a sign,
// their sum in smallest spacings / OFFSET_STEPS. Sums of integers do not depend on the order. That is enough for 255 triangles. Nodes of levels
// above may have more, where the surface beside them is fine: of these the first number is how many, the second one the sum.
#ifndef ISOPEEL_TREE_OFFSET_H
#define ISOPEEL_TREE_OFFSET_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/octahedral.h"
#include "lib/tree_node.h"

#define COUNT_SHIFT 24
#define OFFSET_STEPS 8192.0f
#define OFFSET_SHARE 0.7f // of the mean offset that a node moves: its neighbours move too
#define OFFSET_MAX 4.0f   // smallest spacings: those beyond count as this one

inline float smallest_spacing(Grid grid) { return fmin(fmin(grid.spacing[0], grid.spacing[1]), grid.spacing[2]); }

// A sum of one offset.
inline uint pack_offset(int offset) { return (uint)offset + (1u << COUNT_SHIFT); }

// The mean of the offsets of a sum, smallest spacings; 0 if there are none.
INLINED float mean_offset(uint sum) {
    const uint count = (sum + (1u << (COUNT_SHIFT - 1))) >> COUNT_SHIFT;
    const int offsets = (int)(sum - (count << COUNT_SHIFT));
    return count ? exact_quotient((float)offsets, OFFSET_STEPS * (float)count) : 0.0f;
}

// The mean of the offsets around a node.
INLINED float mean_of_sums(TreeNode node, uint2 sums) {
    if (tree_block_level(node) == 0) return mean_offset(sums.x + sums.y);
    return sums.x ? exact_quotient((float)(int)sums.y, OFFSET_STEPS * (float)sums.x) : 0.0f;
}

// Position of a node in a cut, from the low corner of its block, `home` in cells, 1/VERTEX_LATTICE cell. `sums`: of its offsets. Nodes on
// the volume's faces do not move.
INLINED int3 moved_position(Grid grid, uint cap, TreeNode node, int3 home, uint2 sums) {
    const int lattice = (int)VERTEX_LATTICE;
    const int3 at = tree_position(node), margin = (int3)(cap ? lattice : 0);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    const int3 first_face = margin - home * lattice, last_face = (last - home) * lattice - margin;
    const int3 on_face = (at <= first_face) | (at >= last_face);
    if (on_face.x | on_face.y | on_face.z) return at;
    const float max_move = tree_max_move(node);
    const float moved = clamp(OFFSET_SHARE * mean_of_sums(node, sums), -max_move, max_move) * smallest_spacing(grid);
    const float3 way = decode_octahedral8(node.normal_s & 0xffffu) * moved
                       / (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const int3 to = at + convert_int3_rte(way * VERTEX_LATTICE);
    return clamp(to, max(first_face, 0), min(last_face, 32 * lattice << (int)tree_block_level(node)));
}

#endif
