// patch: moves vertices of finer leaves onto the segments that coarser leaves make on their faces
// (docs/algorithm.md#52-crack-patching). patch_level finds which level decides about a vertex; patch is run for levels 5 to 1,
// so that the segments of a level are final before finer ones follow them. One work-group a region.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/samples.h"
#include "lib/sheets.h"
#include "lib/slots.h"

#define DECIDED_SHIFT 20 // of WorkVertex.key: level of the leaf that decides, 0: the vertex stays

typedef struct {
    int3 low, last;  // low corner of the leaf in the region; the region's last sample
    uint region;     // compact index of the leaf's region
    uint slot, signs;
    uint2 refined;
} Leaf;

// The leaf of `level` around a cell of the volume, if that is what stands for the cell.
inline bool load_leaf(Grid grid, __global const uint *region_index, __global const Region *regions,
                      __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
                      __global const uint2 *refined, uint level, int3 cell, Leaf *leaf) {
    const uint cell_slot = find_slot_at(grid, region_index, regions, bricks, 0, cell, &leaf->region);
    if (cell_slot == NONE || state[cell_slot] != level) return false;
    __global const Region *region = regions + leaf->region;
    const uint in_region = morton(convert_uint3(cell) & 31u);
    leaf->slot = find_slot(region, bricks, level, in_region);
    leaf->signs = meta_signs(nodes[leaf->slot].meta);
    leaf->refined = refined[leaf->slot];
    leaf->low = convert_int3(unmorton(in_region >> (3 * level) << (3 * level)));
    const int3 origin = convert_int3(region_origin(grid, region->region));
    leaf->last = clamp_sample(grid, origin + 32) - origin;
    return true;
}

inline int3 leaf_vertex_low(Leaf leaf, uint level, uint edge) {
    return cube_edge_low(leaf.low, level, edge, leaf.last) + axis_step(edge >> 2) * refined_offset(leaf.refined, edge);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void patch_level(const Grid grid, __global const uint *region_index, __global const Region *regions,
                 __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
                 __global const uint2 *refined, __global const RegionMesh *meshes, __global WorkVertex *vertices) {
    const uint group = (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        __global WorkVertex *vertex = vertices + meshes[group].vertex_base + i;
        const uint key = vertex->key, axis = key_axis(key);
        const int3 low = origin + key_low(key), b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
        uint decides = 0;
        for (uint k = 0; k < 4; k++) {
            uint region;
            const uint slot = find_slot_at(grid, region_index, regions, bricks, 0,
                                           low - b * (int)(k & 1) - c * (int)(k >> 1), &region);
            if (slot != NONE && state[slot] != INTERNAL) decides = max(decides, (uint)state[slot]);
        }
        if (decides == 0) continue;
        // A vertex of the deciding leaf itself is an end of its segments.
        for (uint k = 0; k < 4; k++) {
            Leaf leaf;
            if (!load_leaf(grid, region_index, regions, bricks, nodes, state, refined, decides,
                           low - b * (int)(k & 1) - c * (int)(k >> 1), &leaf))
                continue;
            const int3 leaf_origin = convert_int3(region_origin(grid, regions[leaf.region].region));
            for (uint edge = 4 * axis; edge < 4 * axis + 4; edge++)
                if (edge_crosses(leaf.signs, edge) && all(leaf_vertex_low(leaf, decides, edge) + leaf_origin == low))
                    decides = 0;
            if (decides == 0) break;
        }
        vertex->key = key | decides << DECIDED_SHIFT;
    }
}

// Final position of a leaf's vertex in cells from the leaf's low corner.
inline float3 leaf_vertex(Leaf leaf, uint level, uint edge, __global const Region *regions, __global const Brick *bricks,
                          __global const uint *owners, __global const RegionMesh *meshes,
                          __global const WorkVertex *vertices) {
    const uint index = find_vertex(regions + leaf.region, bricks, owners, leaf_vertex_low(leaf, level, edge), edge >> 2);
    __global const WorkVertex *vertex = vertices + meshes[leaf.region].vertex_base + index;
    const int3 position = (int3)(vertex->position[0], vertex->position[1], vertex->position[2]);
    return convert_float3(position - leaf.low * 65536) / 65536.0f;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void patch(const PatchArgs args, __global const uint *region_index, __global const Region *regions,
           __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
           __global const uint2 *refined, __global const uint *owners, __global const RegionMesh *meshes,
           __global WorkVertex *vertices, __global Counters *counters) {
    const Grid grid = args.grid;
    const uint level = args.level;
    const uint group = (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        __global WorkVertex *vertex = vertices + meshes[group].vertex_base + i;
        const uint key = vertex->key, axis = key_axis(key);
        if (key >> DECIDED_SHIFT != level) continue;
        const int3 at = origin + key_low(key), axis_b = axis_step((axis + 1) % 3), axis_c = axis_step((axis + 2) % 3);
        const int3 position = (int3)(vertex->position[0], vertex->position[1], vertex->position[2]);
        float best = INFINITY;
        int3 moved = position;
        for (uint k = 0; k < 4; k++) {
            const int3 cell = at - axis_b * (int)(k & 1) - axis_c * (int)(k >> 1);
            Leaf leaf;
            if (!load_leaf(grid, region_index, regions, bricks, nodes, state, refined, level, cell, &leaf)) continue;
            const int3 leaf_origin = convert_int3(region_origin(grid, regions[leaf.region].region)) + leaf.low;
            const int3 shift = (origin - leaf_origin) * 65536;
            const float3 p = convert_float3(position + shift) / 65536.0f;
            const int3 high = min(leaf.low + (1 << level), leaf.last) - leaf.low, on = at - leaf_origin;
            for (uint face = 0; face < 6; face++) {
                const uint d = face >> 1, side = face & 1;
                const int plane = side ? (d == 0 ? high.x : d == 1 ? high.y : high.z) : 0;
                if (d == axis || (d == 0 ? on.x : d == 1 ? on.y : on.z) != plane) continue;
                uint ends[4];
                const uint crossings = face_segments(leaf.signs, face, false, ends);
                for (uint j = 0; j + 1 < crossings; j += 2) {
                    const float3 q = nearest_on_segment(
                        p, leaf_vertex(leaf, level, ends[j], regions, bricks, owners, meshes, vertices),
                        leaf_vertex(leaf, level, ends[j + 1], regions, bricks, owners, meshes, vertices));
                    const float3 away = q - p;
                    if (dot(away, away) < best) {
                        best = dot(away, away);
                        moved = convert_int3_rte(q * 65536.0f) - shift;
                    }
                }
            }
        }
        if (best < INFINITY) {
            vertex->position[0] = moved.x;
            vertex->position[1] = moved.y;
            vertex->position[2] = moved.z;
        } else if (counts_vertex(grid, region_index, regions, bricks, owners, group, at, axis))
            atomic_inc(&counters->unpatched_vertices);
    }
}
