// pack: vertices of the marching-cubes mesher as they leave the device (docs/algorithm.md#5-marching-cubes-mesher): position,
// normal, s and normalised f. Counts the different vertices of the surface. One work-group a region.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cut.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/octahedral.h"
#include "lib/samples.h"
#include "lib/slots.h"
#include "lib/vector.h"
#include "lib/vertices.h"

// Slot of the leaf of the highest level around a fine edge, of equals the first.
INLINED uint coarsest_leaf(Grid grid, const Cut *cut, int3 low, uint axis) {
    uint coarsest = 0, leaf = NONE;
    for (uint k = 0; k < 4; k++) {
        uint region;
        const int3 cell = cell_around(low, axis, k);
        const uint slot = find_slot_at(grid, cut->region_index, cut->regions, cut->bricks, 0, cell, &region);
        if (slot == NONE) continue;
        const uint level = cut->state[slot];
        if (leaf == NONE || level > coarsest) {
            coarsest = level;
            leaf = find_slot(cut->regions + region, cut->bricks, level, morton(convert_uint3(cell) & 31u));
        }
    }
    return leaf;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pack(const PackArgs args, __global const SAMPLE *samples, __global const uint *region_index, __global const Region *regions,
          __global const Brick *bricks, __global const Node *nodes, __global const uchar *state, __global const uint *owners,
          __global const RegionMesh *meshes, __global const WorkVertex *work, __global Vertex *vertices,
          __global Counters *counters) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const Cut cut = {region_index, regions, bricks, nodes, state};
    const uint group = args.first_region + (uint)get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, regions[group].region));
    uint distinct = 0;
    for (uint i = get_local_id(0); i < meshes[group].vertices; i += GROUP) {
        const uint index = meshes[group].vertex_base + i;
        const WorkVertex from = work[index];
        const uint axis = key_axis(from.key);
        const int3 low = origin + key_low(from.key), high = low + axis_step(axis);
        const Node node = nodes[coarsest_leaf(grid, &cut, low, axis)];
        distinct += counts_vertex(grid, &cut, owners, group, low, axis);

        const float va = sample_at(grid, SLAB_ARGS, low), vb = sample_at(grid, SLAB_ARGS, high);
        const float t = (float)crossing(args.iso, va, vb) / 65536.0f;
        const float3 ga = gradient_at(grid, SLAB_ARGS, low), gb = gradient_at(grid, SLAB_ARGS, high);
        Vertex to;
        for (uint k = 0; k < 3; k++) to.position[k] = from.position[k];
        to.normal = encode_octahedral16(-unit_or_zero(ga + (gb - ga) * t));
        to.attributes = unorm16(node.s) | unorm16(normalised_feature(args.params, node.f)) << 16;
        vertices[index] = to;
    }
    if (distinct) atomic_add(&counters->vertices, distinct);
}
