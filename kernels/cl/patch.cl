// patch: moves vertices of finer leaves onto the segments that coarser leaves make on their faces
// (docs/algorithm.md#52-crack-patching). One work-group a region.
//
//   kernel        computes
//   patch_level   the level that decides about each vertex, in its key
//   patch         new positions of the vertices for which `level` decides. Run for levels 5 to 1, so that the segments of a level
//                 are final before finer ones follow them

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/cut.h"
#include "lib/device.h"
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
    int3 low, last; // low corner of the leaf in the region; the region's last sample
    uint region;    // compact index of the leaf's region
    uint slot, signs;
    uint2 refined;
} Leaf;

// The leaf around a cell of the volume, if it is one of `level`.
INLINED bool load_leaf(Grid grid, const Cut *cut, __global const uint2 *refined, uint level, int3 cell, Leaf *leaf) {
    const uint cell_slot = find_slot_at(grid, cut->region_index, cut->regions, cut->bricks, 0, cell, &leaf->region);
    if (cell_slot == NONE || cut->state[cell_slot] != level) return false;
    __global const Region *region = cut->regions + leaf->region;
    const uint in_region = morton(convert_uint3(cell) & 31u);
    leaf->slot = find_slot(region, cut->bricks, level, in_region);
    leaf->signs = meta_signs(cut->nodes[leaf->slot].meta);
    leaf->refined = refined[leaf->slot];
    leaf->low = convert_int3(unmorton(in_region >> (3 * level) << (3 * level)));
    const int3 origin = convert_int3(region_origin(grid, region->region));
    leaf->last = clamp_sample(grid, origin + 32) - origin;
    return true;
}

// Low sample of the fine edge that the leaf's vertex on an edge lies on, in the leaf's region.
inline int3 leaf_vertex_low(Leaf leaf, uint level, uint edge) {
    return cube_edge_low(leaf.low, level, edge, leaf.last) + axis_step(edge >> 2) * refined_offset(leaf.refined, edge);
}

// Is the vertex on a fine edge one of the leaf's own? `low`: of the fine edge, in the volume.
INLINED bool has_vertex(Grid grid, const Cut *cut, Leaf leaf, uint level, int3 low, uint axis) {
    const int3 origin = convert_int3(region_origin(grid, cut->regions[leaf.region].region));
    for (uint edge = 4 * axis; edge < 4 * axis + 4; edge++)
        if (edge_crosses(leaf.signs, edge) && all(leaf_vertex_low(leaf, level, edge) + origin == low)) return true;
    return false;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void patch_level(const Grid grid, __global const uint *region_index, __global const Region *regions,
                 __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
                 __global const uint2 *refined, __global const RegionMesh *meshes, __global WorkVertex *vertices) {
    const Cut cut = {region_index, regions, bricks, nodes, state};
    const uint group = (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        __global WorkVertex *vertex = vertices + meshes[group].vertex_base + i;
        const uint key = vertex->key, axis = key_axis(key);
        const int3 low = origin + key_low(key);
        uint decides = 0;
        for (uint k = 0; k < 4; k++) {
            uint region;
            const uint slot = find_slot_at(grid, region_index, regions, bricks, 0, cell_around(low, axis, k), &region);
            if (slot != NONE && state[slot] != INTERNAL) decides = max(decides, (uint)state[slot]);
        }
        if (decides == 0) continue;
        // A vertex of a leaf of that level is an end of its segments.
        for (uint k = 0; k < 4 && decides > 0; k++) {
            Leaf leaf;
            if (load_leaf(grid, &cut, refined, decides, cell_around(low, axis, k), &leaf)
                && has_vertex(grid, &cut, leaf, decides, low, axis))
                decides = 0;
        }
        vertex->key = key | decides << DECIDED_SHIFT;
    }
}

// Buffers in which the vertices of leaves are looked up.
typedef struct {
    __global const uint *owners;
    __global const RegionMesh *meshes;
    __global const WorkVertex *vertices;
} LeafVertices;

// Final position of a leaf's vertex in cells from the leaf's low corner.
INLINED float3 leaf_vertex(const Cut *cut, const LeafVertices *mesh, Leaf leaf, uint level, uint edge) {
    const int3 low = leaf_vertex_low(leaf, level, edge);
    const uint index = find_vertex(cut->regions + leaf.region, cut->bricks, mesh->owners, low, edge >> 2);
    __global const WorkVertex *vertex = mesh->vertices + mesh->meshes[leaf.region].vertex_base + index;
    const int3 position = (int3)(vertex->position[0], vertex->position[1], vertex->position[2]);
    return convert_float3(position - leaf.low * 65536) / 65536.0f;
}

// The nearest point to `p` on the segments of the faces of a leaf that the vertex lies on, if nearer than the squared distance
// `best`, which it then replaces. `p`: the vertex, `on`: low sample of its fine edge, both from the leaf's low corner, in cells.
INLINED bool nearest_on_leaf(const Cut *cut, const LeafVertices *mesh, Leaf leaf, uint level, uint axis, int3 on, float3 p,
                             float *best, float3 *nearest) {
    const int3 high = min(leaf.low + (1 << level), leaf.last) - leaf.low;
    bool found = false;
    for (uint face = 0; face < 6; face++) {
        const uint d = face >> 1, side = face & 1;
        if (d == axis || component(on, d) != (side ? component(high, d) : 0)) continue;
        uint ends[4];
        const uint crossings = face_segments(leaf.signs, face, false, ends);
        for (uint j = 0; j + 1 < crossings; j += 2) {
            const float3 q = nearest_on_segment(p, leaf_vertex(cut, mesh, leaf, level, ends[j]),
                                                leaf_vertex(cut, mesh, leaf, level, ends[j + 1]));
            const float3 away = q - p;
            if (dot(away, away) < *best) {
                *best = dot(away, away);
                *nearest = q;
                found = true;
            }
        }
    }
    return found;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void patch(const PatchArgs args, __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,
           __global const Node *nodes, __global const uchar *state, __global const uint2 *refined, __global const uint *owners,
           __global const RegionMesh *meshes, __global WorkVertex *vertices, __global Counters *counters) {
    const Grid grid = args.grid;
    const Cut cut = {region_index, regions, bricks, nodes, state};
    const LeafVertices mesh = {owners, meshes, vertices};
    const uint group = (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        __global WorkVertex *vertex = vertices + meshes[group].vertex_base + i;
        const uint key = vertex->key, axis = key_axis(key);
        if (key >> DECIDED_SHIFT != args.level) continue;
        const int3 low = origin + key_low(key);
        const int3 position = (int3)(vertex->position[0], vertex->position[1], vertex->position[2]);
        float best = INFINITY;
        int3 moved = position;
        for (uint k = 0; k < 4; k++) {
            Leaf leaf;
            if (!load_leaf(grid, &cut, refined, args.level, cell_around(low, axis, k), &leaf)) continue;
            const int3 leaf_origin = convert_int3(region_origin(grid, regions[leaf.region].region)) + leaf.low;
            const int3 shift = (origin - leaf_origin) * 65536;
            const float3 p = convert_float3(position + shift) / 65536.0f;
            float3 nearest;
            if (nearest_on_leaf(&cut, &mesh, leaf, args.level, axis, low - leaf_origin, p, &best, &nearest))
                moved = convert_int3_rte(nearest * 65536.0f) - shift;
        }
        if (best < INFINITY) {
            vertex->position[0] = moved.x;
            vertex->position[1] = moved.y;
            vertex->position[2] = moved.z;
        } else if (counts_vertex(grid, &cut, owners, group, low, axis))
            atomic_inc(&counters->unpatched_vertices);
    }
}
