// Distances of samples of triangles to the surface, LANES samples at a time: by Newton steps (surface_distance.h), and if these do
// not converge, by the nearest known points of the surface.
#ifndef ISOPEEL_SAMPLE_DISTANCE_H
#define ISOPEEL_SAMPLE_DISTANCE_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/cell_lines.h"
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

// How many bricks away from a sample the surface is looked for: as many as a region has.
#define BRICKS_AROUND 4

// What error_samples reads beside the mesh.
typedef struct {
    Grid grid;
    __global const uint *region_index;
    __global const Brick *bricks;
    __global const SAMPLE *samples;
    uint z0;
    uint cap;
    FieldBox box;
} SampledField;

// Upper estimate of the distance of a point on a triangle to the surface: the minimum over the corners of the distance to the
// corner and the corner's own residual; a border vertex counts as the vertex that it was moved from. World units.
INLINED float bound_by_corners(const SampledField *field, const MeshFans *mesh, float3 p, uint first) {
    float bound = INFINITY;
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

// The active brick at a place, in bricks of the volume, or NONE.
INLINED uint active_brick(const SampledField *field, __global const Region *regions, int3 at) {
    const uint3 count = (uint3)(field->grid.regions[0], field->grid.regions[1], field->grid.regions[2]);
    if (any(at < 0) || any(at >= convert_int3(4u * count))) return NONE;
    const int3 region = at >> 2;
    const uint index = field->region_index[((uint)region.z * count.y + (uint)region.y) * count.x + (uint)region.x];
    if (index == NONE) return NONE;
    const uint brick = morton(convert_uint3(at & 3)), low = regions[index].brick_mask[0], high = regions[index].brick_mask[1];
    return test_bit64(low, high, brick) ? regions[index].brick_base + rank64(low, high, brick) : NONE;
}

// The nearest to `p` of the vertices of active cells of a brick, if it is nearer than `nearest` (w: squared distance). `low`: the brick's low
// corner, world units.
INLINED float4 nearest_cell_vertex(const SampledField *field, const MeshFans *mesh, float3 p, uint index, float3 low, float4 nearest) {
    __global const Brick *brick = field->bricks + index;
    const uint first_slot = mesh->regions[brick->region].slot_base + brick->level_base[0];
    const float3 cube_size = 4.0f * field->box.spacing;
    for (uint cube = 0; cube < 8; cube++) {
        const uint count = popcount(brick->cells[2 * cube]) + popcount(brick->cells[2 * cube + 1]);
        const float3 begin = low + (float3)((float)(cube & 1), (float)(cube >> 1 & 1), (float)(cube >> 2)) * cube_size;
        if (!count || distance2_to_box(p, begin, cube_size) >= nearest.w) continue;
        const uint first = first_slot + brick->cells_before[2 * cube];
        for (uint slot = first; slot < first + count; slot++) {
            const float3 vertex = mesh->positions[slot].xyz;
            const float distance2 = distance2_of(p, vertex);
            if (distance2 < nearest.w) nearest = (float4)(vertex, distance2);
        }
    }
    return nearest;
}

// The vertex of an active cell, which lies on the surface, that is nearest to `x`; w: squared distance, infinite if no brick is active within
// BRICKS_AROUND. Bricks are tried from the middle outwards, as long as one of the next may have a nearer one. World units.
INLINED float4 nearest_of_cells(const SampledField *field, const MeshFans *mesh, float3 x) {
    const float3 spacing = field->box.spacing, p = x * spacing;
    const float brick_size = 8.0f * field->box.straight / STRAIGHT;
    const int3 centre = convert_int3(x) >> 3;
    float4 nearest = (float4)(0.0f, 0.0f, 0.0f, INFINITY);
    for (int radius = 0; radius <= BRICKS_AROUND; radius++) {
        const float before = brick_size * (float)(radius - 1);
        if (radius > 1 && nearest.w <= before * before) break;
        const int side = 2 * radius + 1;
        for (int k = 0; k < side * side * side; k++) {
            const int3 to = (int3)(k % side, k / side % side, k / (side * side)) - radius;
            if (max(max(abs(to.x), abs(to.y)), abs(to.z)) != (uint)radius) continue;
            const float3 begin = convert_float3((centre + to) << 3) * spacing;
            if (distance2_to_box(p, begin, 8.0f * spacing) >= nearest.w) continue;
            const uint brick = active_brick(field, mesh->regions, centre + to);
            if (brick != NONE) nearest = nearest_cell_vertex(field, mesh, p, brick, begin, nearest);
        }
    }
    return nearest;
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

// Distance of `p` to the nearest crossing of a line and the surface in the 27 cells around `x`, at most `nearest`.
INLINED float distance_to_lines(const SampledField *field, float3 p, float3 x, float nearest) {
    for (int k = 0; k < 27; k++) {
        const int3 low = convert_int3(x) + (int3)(k % 3, k / 3 % 3, k / 9) - 1;
        if (any(low < field->box.first) || any(low > field->box.last)) continue;
        const CellOfLines lines = load_cell_of_lines(field->grid, field->samples, field->z0, field->box.iso, field->cap, low);
        for (uint line = 0; line < 3 * LINES_OF_AXIS; line++) {
            const float4 at = cross_line(&lines, line / LINES_OF_AXIS, line % LINES_OF_AXIS);
            if (at.w >= 0.0f) nearest = fmin(nearest, sqrt(distance2_of(p, at.xyz)));
        }
    }
    return nearest;
}

// Searches that did not arrive, or only after half a cell, begin once more at the nearest vertex of a cell, except for samples that
// count for the maximum alone and cannot change it. Fills in the distances.
INLINED void search_again(const SampledField *field, const MeshFans *mesh, TriangleSamples *batch, float maximum, float *distances) {
    SurfaceSearch *search = &batch->search;
    const float half_cell = 0.5f * field->box.straight / STRAIGHT;
    bool any_again = false;
    for (uint i = 0; i < batch->count; i++) {
        distances[i] = arrived(&field->box, search, i) ? search->distance[i] : INFINITY;
        search->active[i] = 0.0f;
        if (distances[i] <= half_cell || (batch->weight[i] == 0.0f && distances[i] <= maximum)) continue;
        const float4 vertex = nearest_of_cells(field, mesh, sample_position(batch, i));
        if (vertex.w == INFINITY) continue;
        const float3 x = vertex.xyz / field->box.spacing;
        distances[i] = fmin(distances[i], sqrt(vertex.w));
        if (!is_in_box(&field->box, x)) continue;
        search->at[i] = x.x;
        search->at[LANES + i] = x.y;
        search->at[2 * LANES + i] = x.z;
        search->active[i] = 1.0f;
        any_again = true;
    }
    if (!any_again) return;
    float again[LANES];
    for (uint i = 0; i < LANES; i++) again[i] = search->active[i];
    search_surface(field->grid, field->samples, field->z0, &field->box, search, batch->count);
    for (uint i = 0; i < batch->count; i++) {
        if (!(again[i] > 0.0f)) continue;
        const float3 x = (float3)(search->at[i], search->at[LANES + i], search->at[2 * LANES + i]);
        if (arrived(&field->box, search, i)) distances[i] = fmin(distances[i], search->distance[i]);
        else distances[i] = distance_to_lines(field, sample_position(batch, i) * field->box.spacing, x, distances[i]);
    }
}

// Adds the distances of the samples that were collected.
INLINED void measure_samples(const SampledField *field, const MeshFans *mesh, TriangleSamples *batch, Distances *sums) {
    SurfaceSearch *search = &batch->search;
    begin_search(search, batch->count);
    search_surface(field->grid, field->samples, field->z0, &field->box, search, batch->count);
    float distances[LANES];
    search_again(field, mesh, batch, sums->maximum, distances);
    for (uint i = 0; i < batch->count; i++) {
        const float3 x = sample_position(batch, i);
        float d = distances[i];
        if (d == INFINITY && batch->first[i] != NONE) d = bound_by_corners(field, mesh, x * field->box.spacing, batch->first[i]);
        if (field->cap) d = distance_to_cap(field, x, d);
        // A vertex so far away is a corner of triangles that are measured.
        if (d < INFINITY) add_distance(sums, d, batch->weight[i]);
    }
    batch->count = 0;
}

#endif
