// Leaves of a cut as marching-cubes cubes (docs/algorithm.md#5-marching-cubes-mesher). A vertex lies on a grid edge of the finest
// level, its fine edge, which is its identity: a key of the edge's low sample in the region and its axis.
#ifndef ISOPEEL_LEAF_H
#define ISOPEEL_LEAF_H

#include "lib/precision.h"
#include "lib/cube.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

inline uint edge_key(int3 low, uint axis) { return (uint)(low.x | low.y << 6 | low.z << 12) | axis << 18; }
inline int3 key_low(uint key) { return (int3)((int)(key & 63), (int)(key >> 6 & 63), (int)(key >> 12 & 63)); }
inline uint key_axis(uint key) { return key >> 18 & 3; }

// Offset of the vertex on an edge of a leaf of level 1 or above, in cells from the edge's low end. Stored in 5 bits for each of 12 edges.
inline int refined_offset(uint2 refined, uint edge) {
    return (int)(edge < 6 ? refined.x >> (5 * edge) & 31u : refined.y >> (5 * edge - 30) & 31u);
}

// Low sample of an edge of the cube of `level` at `low`, which is cut off at `last`.
inline int3 cube_edge_low(int3 low, uint level, uint edge, int3 last) {
    return min(low + edge_offset(edge) * (1 << level), last);
}

// One of the four cells around a fine edge, k = u + 2 v as in polygon.h.
inline int3 cell_around(int3 low, uint axis, uint k) {
    return low - axis_step((axis + 1) % 3) * (int)(k & 1) - axis_step((axis + 2) % 3) * (int)(k >> 1);
}

// The vertices that a region makes are numbered cell by cell: each is owned by the first active cell of the region around its
// fine edge. Returns that cell's slot; `edge`: the edge's number in the cell.
inline uint find_owner(__global const Region *region, __global const Brick *bricks, int3 low, uint axis, uint *edge) {
    for (uint i = 0; i < 4; i++) {
        const int3 cell = cell_around(low, axis, i);
        if (any(cell < 0) || any(cell > 31)) continue;
        const uint slot = find_slot(region, bricks, 0, morton(convert_uint3(cell)));
        if (slot != NONE) {
            *edge = 4 * axis + i;
            return slot;
        }
    }
    return NONE;
}

// Index of a vertex among those of its region. `owners`: of each cell 12 bits, the edges whose vertices it owns, then the number
// of vertices that the cells before it own.
inline uint find_vertex(__global const Region *region, __global const Brick *bricks, __global const uint *owners,
                        int3 low, uint axis) {
    uint edge;
    const uint slot = find_owner(region, bricks, low, axis, &edge);
    const uint owner = owners[slot];
    return (owner >> 12) + popcount(owner & ((1u << edge) - 1));
}

// A vertex on a face between regions exists in each of them that uses it. Is `group` the first of these, which counts it?
// `low`: low sample of the fine edge, in the volume.
INLINED bool counts_vertex(Grid grid, const Cut *cut, __global const uint *owners, uint group, int3 low, uint axis) {
    for (uint i = 0; i < 4; i++) {
        uint region, edge;
        const int3 cell = cell_around(low, axis, i);
        if (find_slot_at(grid, cut->region_index, cut->regions, cut->bricks, 0, cell, &region) == NONE) continue;
        if (region == group) return true;
        const int3 origin = convert_int3(region_origin(grid, cut->regions[region].region));
        const uint owner = find_owner(cut->regions + region, cut->bricks, low - origin, axis, &edge);
        if (owners[owner] >> edge & 1u) return false;
    }
    return true;
}

// Crossing of the isosurface on a fine grid edge, in 1/65536 of its length from the low sample.
inline int crossing(float iso, float a, float b) {
    const float t = (iso - a) / (b - a);
    return isnan(t) ? 32768 : convert_int_rte(clamp(t, 0.0f, 1.0f) * 65536.0f);
}

inline float3 nearest_on_segment(float3 p, float3 a, float3 b) {
    const float3 d = b - a;
    const float length2 = dot(d, d);
    return length2 > 0.0f ? a + d * clamp(dot(p - a, d) / length2, 0.0f, 1.0f) : a;
}

#endif
