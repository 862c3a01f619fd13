// Distances of samples of triangles to the surface, LANES samples at a time: by Newton steps (surface_distance.h), and where these
// do not lead to it, by what is known near the sample.
#ifndef ISOPEEL_SAMPLE_DISTANCE_H
#define ISOPEEL_SAMPLE_DISTANCE_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/distances.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/mesh_distance.h"
#include "lib/morton.h"
#include "lib/polygon.h"
#include "lib/samples.h"
#include "lib/surface_distance.h"
#include "lib/triangle_samples.h"

// What error_samples reads beside the mesh.
typedef struct {
    Grid grid;
    __global const uint *region_index;
    __global const Brick *bricks;
    __global const uint *near;
    __global const SAMPLE *samples;
    uint z0;
    uint cap;
    FieldBox box;
} SampledField;

// Bound of the distance of a point on a triangle to the surface, at most `bound`: it is no further than a corner and that corner's
// own distance, of a border vertex that of the vertex it was moved from. World units.
INLINED float bound_by_corners(const SampledField *field, const MeshFans *mesh, float3 p, uint first, float bound) {
    for (uint i = 0; i < 3; i++) {
        const float4 corner = mesh->positions[mesh->corner_slots[first + i] & ~ON_BORDER];
        const float3 x = corner.xyz / field->box.spacing;
        const float way = sqrt(distance2_of(p, corner.xyz));
        if (way >= bound) continue;
        float own = corner.w;
        if (is_in_box(&field->box, x)) {
            const float4 at = field_at(field->grid, field->samples, field->z0, &field->box, x);
            own = fmin(fabs(at.w) / length(at.xyz), own);
        }
        bound = fmin(bound, way + own);
    }
    return bound;
}

// The active brick at `x`, in cells, or NONE.
INLINED uint brick_at(const SampledField *field, __global const Region *regions, float3 x) {
    const Grid grid = field->grid;
    const uint3 last = (uint3)(grid.dims[0], grid.dims[1], grid.dims[2]) - 2, cell = min(convert_uint3(x), last);
    const uint index = field->region_index[((cell.z >> 5) * grid.regions[1] + (cell.y >> 5)) * grid.regions[0] + (cell.x >> 5)];
    if (index == NONE) return NONE;
    const uint brick = morton(cell & 31u) >> 9, low = regions[index].brick_mask[0], high = regions[index].brick_mask[1];
    return test_bit64(low, high, brick) ? regions[index].brick_base + rank64(low, high, brick) : NONE;
}

// Slot of the first active cell of a level-2 cube of a brick, and how many it has.
INLINED uint first_cell_of_cube(__global const Region *regions, __global const Brick *brick, uint cube, uint *count) {
    *count = popcount(brick->cells[2 * cube]) + popcount(brick->cells[2 * cube + 1]);
    return regions[brick->region].slot_base + brick->level_base[0] + brick->cells_before[2 * cube];
}

// Distance to the surface by the vertices of active cells, which lie on it, in the 27 bricks around the sample or a corner of its
// triangle: of the level-2 cube whose first cell is nearest. Infinite where no brick is active there. World units.
INLINED float distance_to_cells(const SampledField *field, const MeshFans *mesh, float3 x, uint first) {
    const float3 spacing = field->box.spacing, p = x * spacing;
    uint brick = brick_at(field, mesh->regions, x);
    for (uint i = 0; i < 3 && brick == NONE; i++)
        brick = brick_at(field, mesh->regions, mesh->positions[mesh->corner_slots[first + i] & ~ON_BORDER].xyz / spacing);
    if (brick == NONE) return INFINITY;
    __global const Brick *centre = field->bricks + brick;
    const float3 low = convert_float3(region_origin(field->grid, mesh->regions[centre->region].region)
                                      + unmorton(centre->morton << 9));
    uint nearest = 0, nearest_count = 0, count;
    float nearest2 = INFINITY;
    for (uint i = 0; i < 27; i++) {
        const uint k = (i + 13) % 27, index = field->near[27 * brick + k];
        if (index == NONE) continue;
        const float3 begin = (low + 8.0f * ((float3)((float)(k % 3), (float)(k / 3 % 3), (float)(k / 9)) - 1.0f)) * spacing;
        if (distance2_of(p, clamp(p, begin, begin + 8.0f * spacing)) >= nearest2) continue;
        for (uint cube = 0; cube < 8; cube++) {
            const uint slot = first_cell_of_cube(mesh->regions, field->bricks + index, cube, &count);
            if (!count) continue;
            const float distance2 = distance2_of(p, mesh->positions[slot].xyz);
            if (distance2 >= nearest2) continue;
            nearest2 = distance2;
            nearest = slot;
            nearest_count = count;
        }
    }
    for (uint i = 1; i < nearest_count; i++) nearest2 = fmin(nearest2, distance2_of(p, mesh->positions[nearest + i].xyz));
    return sqrt(nearest2);
}

// In a capped volume the parts of its faces that lie inside are surface. Distance of a point to those next to it, at most `nearest`.
INLINED float distance_to_cap(const SampledField *field, float3 x, float nearest) {
    const Grid grid = field->grid;
    const float3 end = (float3)((float)grid.dims[0], (float)grid.dims[1], (float)grid.dims[2]) - 2.0f;
    for (uint face = 0; face < 6; face++) {
        float3 foot = x;
        const bool high = face & 1;
        if (face >> 1 == 0) foot.x = high ? end.x : 1.0f;
        else if (face >> 1 == 1) foot.y = high ? end.y : 1.0f;
        else foot.z = high ? end.z : 1.0f;
        const float d = length((foot - x) * field->box.spacing);
        if (d < nearest && is_in_box(&field->box, foot)
            && field_at(grid, field->samples, field->z0, &field->box, foot).w >= 0.0f)
            nearest = d;
    }
    return nearest;
}

// Adds the distances of the samples that were collected.
INLINED void measure_samples(const SampledField *field, const MeshFans *mesh, TriangleSamples *batch, Distances *sums) {
    search_surface(field->grid, field->samples, field->z0, &field->box, &batch->search, batch->count);
    const float cell = field->box.straight / STRAIGHT;
    for (uint i = 0; i < batch->count; i++) {
        float d = batch->search.distance[i];
        const bool found = batch->search.residual[i] <= fmax(field->box.straight, 0.125f * d);
        if (!found || d > cell) {
            const float3 x = sample_position(batch, i);
            const float by_cells = distance_to_cells(field, mesh, x, batch->first[i]), bound = found ? fmin(d, by_cells) : by_cells;
            d = bound_by_corners(field, mesh, x * field->box.spacing, batch->first[i], bound);
        }
        if (field->cap && d > field->box.straight) d = distance_to_cap(field, sample_position(batch, i), d);
        add_distance(sums, d, batch->weight[i]);
    }
    batch->count = 0;
}

#endif
