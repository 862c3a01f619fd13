// pack: vertices as they leave the device: position, normal, s and normalised f. One work-group a region.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/feature.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/samples.h"
#include "lib/slots.h"
#include "lib/vector.h"
#include "lib/vertices.h"

inline uint octahedral(float3 n) {
    const float sum = fabs(n.x) + fabs(n.y) + fabs(n.z);
    if (!(sum > 0.0f) || isinf(sum)) return 0; // decodes to +z
    float2 p = n.xy / sum;
    if (n.z < 0.0f) p = (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
    const int2 q = convert_int2_rte(p * 32767.0f);
    return ((uint)q.x & 0xffffu) | (uint)q.y << 16;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pack(const PackArgs args, __global const SAMPLE *samples, __global const uint *region_index,
          __global const Region *regions, __global const Brick *bricks,
          __global const Node *nodes, __global const uchar *state, __global const uint *owners,
          __global const RegionMesh *meshes,
          __global const WorkVertex *work, __global Vertex *vertices, __global Counters *counters) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const CutParams params = args.params;
    const uint first_region = args.first_region;
    const uint group = first_region + (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    uint distinct = 0;
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        const uint index = meshes[group].vertex_base + i;
        const WorkVertex from = work[index];
        const uint axis = key_axis(from.key);
        const int3 low = origin + key_low(from.key), high = low + axis_step(axis);
        const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);

        // Attributes are those of the coarsest leaf around, the first of equals.
        uint coarsest = 0, leaf = NONE;
        for (uint k = 0; k < 4; k++) {
            uint region;
            const int3 cell = low - b * (int)(k & 1) - c * (int)(k >> 1);
            const uint slot = find_slot_at(grid, region_index, regions, bricks, 0, cell, &region);
            if (slot == NONE) continue;
            const uint level = state[slot];
            if (leaf == NONE || level > coarsest) {
                coarsest = level;
                leaf = find_slot(regions + region, bricks, level, morton(convert_uint3(cell) & 31u));
            }
        }
        const Node node = nodes[leaf];
        distinct += counts_vertex(grid, region_index, regions, bricks, owners, group, low, axis);

        const float va = sample_at(grid, SLAB_ARGS, low), vb = sample_at(grid, SLAB_ARGS, high);
        const float t = (float)crossing(iso, va, vb) / 65536.0f;
        const float3 ga = gradient_at(grid, SLAB_ARGS, low), gb = gradient_at(grid, SLAB_ARGS, high);
        Vertex to;
        for (uint k = 0; k < 3; k++) to.position[k] = from.position[k];
        to.normal = octahedral(-unit_or_zero(ga + (gb - ga) * t));
        to.attributes = unorm16(node.s) | unorm16(normalised_feature(params, node.f)) << 16;
        vertices[index] = to;
    }
    if (distinct) atomic_add(&counters->vertices, distinct);
}
