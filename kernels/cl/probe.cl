// probe: the active cell whose vertex is nearest to a position, of the 5^3 cells around it. One work-item a position: it tests 125
// cells.
// In: positions inside the volume, parameters, control points of the transfer function, regions of interest, the pyramid. Out: a
// ProbedCell for each position.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/grid.h"
#include "lib/importance.h"
#include "lib/interest.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"
#include "lib/vertices.h"

// Cells along an axis, to each side of the one that holds the position: a decimated surface is seldom further off.
#define PROBE_REACH 2

__kernel void probe(const ProbeArgs args, __global const float4 *positions, __constant float2 *points, __constant Interest *interests,
                    __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,
                    __global const Node *nodes, __global const VertexRecord *vertex_records, __global ProbedCell *cells) {
    const uint item = (uint)get_global_id(0);
    if (item >= args.positions) return;
    __global ProbedCell *out = cells + item;
    const Grid grid = args.grid;
    const float3 position = positions[item].xyz;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    const int3 centre = min(convert_int3(position), last);
    int3 nearest = centre;
    float3 vertex = position;
    float distance = INFINITY;
    uint slot = NONE, region = NONE;
    for (int z = -PROBE_REACH; z <= PROBE_REACH; z++)
        for (int y = -PROBE_REACH; y <= PROBE_REACH; y++)
            for (int x = -PROBE_REACH; x <= PROBE_REACH; x++) {
                const int3 cell = centre + (int3)(x, y, z);
                uint index;
                const uint found = find_slot_at(grid, region_index, regions, bricks, 0, cell, &index);
                if (found == NONE) continue;
                const int3 origin = convert_int3(region_origin(grid, regions[index].region));
                const int3 lattice = lattice_position(grid, args.params, vertex_records[found], origin);
                const float3 at = convert_float3(lattice) / VERTEX_LATTICE;
                const float way = length((at - position) * spacing);
                if (!(way < distance)) continue;
                distance = way;
                vertex = at;
                nearest = cell;
                slot = found;
                region = index;
            }
    out->slots[0] = slot;
    if (slot == NONE) return;
    const uint code = morton(convert_uint3(nearest) & 31u);
    for (uint level = 1; level < 6; level++) out->slots[level] = find_slot(regions + region, bricks, level, code);
    const Node node = nodes[slot];
    const float own = importance(args.params, points, node.s, node.f);
    out->region = region;
    out->point = cell_point(regions + region, slot);
    out->distance = distance;
    out->s = node.s;
    out->f = node.f;
    out->blended = blended_feature(args.params, node.s, node.f);
    out->importance = raise_importance(own, args.params.interests, interests, vertex, (float3)(0.0f));
}
