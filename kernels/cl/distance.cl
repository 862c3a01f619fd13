// distance: how far points are from the isosurface (docs/algorithm.md#67-measured-error), each for itself. A work-item takes LANES of them.
// In: the samples of a slab, points in cells, the pyramid. Out: distances in world units of the points in the slab's layers of regions.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/samples.h"
#include "lib/surface_distance.h"
#include "lib/vertex_record.h"

// Squared distance of a point to the nearest vertex of a brick's active cells, which lie on the surface; at most `nearest2`.
inline float nearest_in_brick(Grid grid, __global const Region *region, __global const Brick *brick,
                              __global const VertexRecord *vertex_records, float3 x, float nearest2) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float3 origin = convert_float3(region_origin(grid, region->region));
    const uint first = region->slot_base + brick->level_base[0], cells = brick->cells_before[15] + popcount(brick->cells[15]);
    for (uint slot = first; slot < first + cells; slot++) {
        __global const ushort *at = vertex_records[slot].position;
        const float3 way = (origin + (float3)(at[0], at[1], at[2]) / VERTEX_LATTICE - x) * spacing;
        nearest2 = fmin(nearest2, dot(way, way));
    }
    return nearest2;
}

// Distance of a point to the nearest vertex of the active cells in the 27 bricks around it; infinite if there is none.
inline float distance_to_bricks(Grid grid, __global const uint *region_index, __global const Region *regions,
                                __global const Brick *bricks, __global const VertexRecord *vertex_records, float3 x) {
    const int3 last = ((int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2) >> 3;
    const int3 centre = clamp(convert_int3(x) >> 3, (int3)(0), last);
    float nearest2 = INFINITY;
    for (int i = 0; i < 27; i++) {
        const int3 at = centre + (int3)(i % 3, i / 3 % 3, i / 9) - 1;
        if (any(at < 0) || any(at > last)) continue;
        const uint3 b = convert_uint3(at), r = b >> 2;
        const uint index = region_index[(r.z * grid.regions[1] + r.y) * grid.regions[0] + r.x];
        if (index == NONE) continue;
        __global const Region *region = regions + index;
        const uint code = morton((b & 3u) << 3) >> 9;
        if (!test_bit64(region->brick_mask[0], region->brick_mask[1], code)) continue;
        const uint brick = region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], code);
        nearest2 = nearest_in_brick(grid, region, bricks + brick, vertex_records, x, nearest2);
    }
    return sqrt(nearest2);
}

// Residuals of found points, in smallest spacings, below which no crossing is looked for.
#define ON_SURFACE 1e-3f

// Whether the field crosses the isovalue near `x`, the end of the steps. Next to an extreme value or an end of the volume, the slope can
// predict a surface that does not exist.
inline bool crosses_surface(Grid grid, SLAB, const FieldBox *box, float3 x) {
    const float4 here = field_at(grid, SLAB_ARGS, box, x);
    const float3 way = -here.w / dot(here.xyz, here.xyz) * here.xyz / box->spacing;
    const float3 beyond = clamp(x + 2.0f * way, convert_float3(box->first), convert_float3(box->last) + 1.0f);
    return field_at(grid, SLAB_ARGS, box, beyond).w * here.w <= 0.0f;
}

__kernel void distance_points(const DistanceArgs args, __global const SAMPLE *samples, __global const uint *region_index,
                              __global const Region *regions, __global const Brick *bricks,
                              __global const VertexRecord *vertex_records, __global const float4 *points,
                              __global float *distances) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const FieldBox box = make_field_box(grid, args.iso, 0, args.first_layer, args.end_layer);
    const uint first = args.first + LANES * (uint)get_global_id(0);
    SurfaceSearch search;
    uint numbers[LANES], count = 0;
    for (uint i = 0; i < 3 * LANES; i++) search.from[i] = 0.0f;
    for (uint i = first; i < min(first + LANES, args.end); i++) {
        const uint layer = min((uint)fmax(points[i].z, 0.0f) / 32, grid.regions[2] - 1);
        if (layer < args.first_layer || layer >= args.end_layer) continue;
        search.from[count] = points[i].x;
        search.from[LANES + count] = points[i].y;
        search.from[2 * LANES + count] = points[i].z;
        numbers[count++] = i;
    }
    if (count == 0) return;
    begin_search(&search, count);
    search_surface(grid, samples, z0, &box, &search, count);
    for (uint i = 0; i < count; i++) {
        float d = search.distance[i];
        const float residual = search.residual[i];
        const float3 at = (float3)(search.at[i], search.at[LANES + i], search.at[2 * LANES + i]);
        const bool found = arrived(&box, &search, i)
                           && (residual <= box.straight / STRAIGHT * ON_SURFACE
                               || crosses_surface(grid, samples, z0, &box, at));
        if (!found || d > box.straight / STRAIGHT) {
            const float by_cells =
                distance_to_bricks(grid, region_index, regions, bricks, vertex_records, points[numbers[i]].xyz);
            d = found ? fmin(d, by_cells) : by_cells;
        }
        distances[numbers[i]] = d;
    }
}
