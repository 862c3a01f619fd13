// error: how far a dual mesh is from the surface it stands for (the stated error). One work-group a region but for
// error_link. Positions are in world units from the volume's first sample.
// error_positions, error_link: vertices of slots, and for each slot a chain of the triangles around its vertex.
// error_crossings: for every full-resolution crossing the distance to the nearest triangle around its leaf's vertex.
// error_centres: |V - iso| / |grad V| at the centres of triangles.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/polygon.h"
#include "lib/samples.h"
#include "lib/slots.h"
#include "lib/trilinear.h"
#include "lib/vertices.h"

#define TRILINEAR_AT(x, low, v, field)                                                                                 \
    {                                                                                                                  \
        low = clamp(convert_int3(x), (int3)(0), (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2);  \
        for (uint corner = 0; corner < 8; corner++)                                                                    \
            v[corner] = sample_at(grid, SLAB_ARGS, low + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));            \
        field = trilinear(v, x - convert_float3(low));                                                                 \
    }

// In w: how far a vertex is from the surface itself. By the field's slope, but no further than its cube is wide, in which the
// surface is.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_positions(const ErrorPositionsArgs args, __global const SAMPLE *samples, __global const Region *regions,
                     __global const Node *nodes, __global const VertexRecord *vertex_records,
                     __global float4 *positions) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const uint first_region = args.first_region;
    const CutParams params = args.params;
    __global const Region *region = regions + first_region + get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        const float3 x = convert_float3(lattice_position(grid, params, vertex_records[slot], origin)) / VERTEX_LATTICE;
        int3 low;
        float v[8];
        float4 field;
        TRILINEAR_AT(x, low, v, field)
        const float widest = length(spacing) * (float)(1u << code_level(meta_code(nodes[slot].meta)));
        positions[slot] = (float4)(x * spacing, fmin(fabs(field.w - iso) / length(field.xyz / spacing), widest));
    }
}

__kernel void error_link(const uint count, __global const uint *corner_slots, __global uint *heads, __global uint *next) {
    const uint i = (uint)get_global_id(0);
    if (i < count) next[i] = atomic_xchg(&heads[corner_slots[i] & ~ON_BORDER], i);
}

// Where the corners of triangles are: vertices of slots, and border vertices, which only the mesh has.
#define CORNER_BUFFERS                                                                                                 \
    __global const uint *corner_slots, __global const float4 *positions, __global const RegionMesh *meshes,            \
        __global const uint *indices, __global const Vertex *vertices
#define CORNER_POSITIONS const uint region_count, CORNER_BUFFERS
#define CORNER_POSITION_ARGS region_count, corner_slots, positions, meshes, indices, vertices

inline float3 corner_position(Grid grid, __global const Region *regions, CORNER_POSITIONS, uint corner) {
    const uint slot = corner_slots[corner];
    if (!(slot & ON_BORDER)) return positions[slot].xyz;
    // The last region that begins at this triangle or before has it.
    uint region = 0, beyond = region_count;
    while (beyond - region > 1) {
        const uint middle = region + (beyond - region) / 2;
        if (meshes[middle].triangle_base <= corner / 3) region = middle;
        else beyond = middle;
    }
    const Vertex vertex = vertices[meshes[region].vertex_base + indices[corner]];
    const float3 cells = (float3)((float)vertex.position[0], (float)vertex.position[1], (float)vertex.position[2]) / 65536.0f;
    return (cells + convert_float3(region_origin(grid, regions[region].region)))
        * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
}
#define CORNER_POSITION(corner) corner_position(grid, regions, CORNER_POSITION_ARGS, corner)

// Squared distance of a point to a triangle: to its plane where the foot lies inside, else to its nearest side.
inline float side_distance2(float3 p, float3 a, float3 b) {
    const float3 d = nearest_on_segment(p, a, b) - p;
    return dot(d, d);
}
inline float triangle_distance2(float3 p, float3 a, float3 b, float3 c) {
    const float3 n = cross(b - a, c - a);
    const float length2 = dot(n, n);
    const bool inside = length2 > 0.0f && dot(cross(b - a, p - a), n) >= 0.0f && dot(cross(c - b, p - b), n) >= 0.0f
        && dot(cross(a - c, p - c), n) >= 0.0f;
    if (inside) {
        const float d = dot(n, p - a);
        return d * d / length2;
    }
    return fmin(side_distance2(p, a, b), fmin(side_distance2(p, b, c), side_distance2(p, c, a)));
}

// Sums and maximum over a work-group, written by its first work-item.
inline void write_error(__local float *sums, __local float *maxima, __local uint *counts, float sum, float maximum,
                        uint count, __global RegionError *out) {
    const uint lid = get_local_id(0);
    sums[lid] = sum;
    maxima[lid] = maximum;
    counts[lid] = count;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid == 0) {
        for (uint i = 1; i < GROUP; i++) {
            sum += sums[i];
            maximum = fmax(maximum, maxima[i]);
            count += counts[i];
        }
        out->sum2 = sum;
        out->max = maximum;
        out->count = count;
    }
}

// Squared distance from the vertex of a slot to the nearest vertex of the mesh among `count` slots.
inline float nearest_vertex2(uint slot, uint first, uint count, __global const uint *heads,
                             __global const float4 *positions) {
    float best = INFINITY;
    for (uint i = first; i < first + count; i++) {
        if (heads[i] == NONE) continue;
        const float3 d = positions[i].xyz - positions[slot].xyz;
        best = fmin(best, dot(d, d));
    }
    return best;
}

// `unmeshed[slot]`: distance to the mesh of leaves without triangles; the others are not read.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_unmeshed(__global const Region *regions, __global const Node *nodes, __global const uchar *state,
                  const uint slots, __global const uint *heads, __global const float4 *positions,
                  __global float *unmeshed) {
    __global const Region *region = regions + get_group_id(0);
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        if (state[slot] != code_level(meta_code(nodes[slot].meta)) || heads[slot] != NONE) continue;
        // Any vertex bounds the distance from above: the region's own do, unless it has none.
        float near2 = nearest_vertex2(slot, region->slot_base, region->level_base[7], heads, positions);
        if (isinf(near2)) near2 = nearest_vertex2(slot, 0, slots, heads, positions);
        unmeshed[slot] = sqrt(near2);
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_crossings(const ErrorCrossingsArgs args, __global const SAMPLE *samples, CUT_PARAMS,
                     CORNER_BUFFERS, __global const uint *heads, __global const uint *next, __global const float *unmeshed,
                     __global RegionError *errors) {
    (void)region_index;
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const uint first_region = args.first_region, region_count = args.region_count;
    __local float sums[GROUP], maxima[GROUP];
    __local uint counts[GROUP];
    const uint group = first_region + (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const bool gaps = region->missing_mask[0] | region->missing_mask[1];
    float sum = 0.0f, maximum = 0.0f;
    uint count = 0;
    for (uint i = get_local_id(0); i < region->level_base[1]; i += GROUP) {
        const uint slot = region->slot_base + i, meta = nodes[slot].meta, signs = meta_signs(meta);
        const uint cell = code_cell(meta_code(meta), 0), level = state[slot];
        const int3 at = convert_int3(unmorton(cell));
        const uint coarse = level > 0 ? find_slot(region, bricks, level, cell) : slot;
        for (uint edge = 0; edge < 12; edge++) {
            if (!edge_crosses(signs, edge)) continue;
            const uint axis = edge >> 2;
            const int3 low = origin + at + edge_offset(edge), step = axis_step(axis);
            // Each crossing once: by the cell at whose low corner it is, or where that does not exist by others.
            if ((edge & 3) && !gaps && all(low + 1 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2])))
                continue;
            const float a = sample_at(grid, SLAB_ARGS, low), b = sample_at(grid, SLAB_ARGS, low + step);
            const float t = (float)crossing(iso, a, b) / 65536.0f;
            const float3 p = (convert_float3(low) + convert_float3(step) * t) * spacing;
            const uint vertex = level > 0 ? coarse : sheet_slot(region, bricks, nodes, slot, edge);
            float distance2 = INFINITY;
            for (uint corner = heads[vertex]; corner != NONE; corner = next[corner]) {
                const uint first = corner - corner % 3;
                distance2 = fmin(distance2, triangle_distance2(p, CORNER_POSITION(first), CORNER_POSITION(first + 1),
                                                               CORNER_POSITION(first + 2)));
            }
            if (heads[vertex] == NONE) {
                const float d = length(p - positions[vertex].xyz) + unmeshed[vertex];
                distance2 = d * d;
            }
            sum += distance2;
            maximum = fmax(maximum, distance2);
            count++;
        }
    }
    write_error(sums, maxima, counts, sum, sqrt(maximum), count, errors + group);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_centres(const ErrorCentresArgs args, __global const SAMPLE *samples,
                   __global const Region *regions, CORNER_BUFFERS, __global RegionError *errors) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const uint first_layer = args.first_layer, end_layer = args.end_layer, region_count = args.region_count;
    __local float sums[GROUP], maxima[GROUP];
    __local uint counts[GROUP];
    const uint group = (uint)get_group_id(0);
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    uint triangles = 0;
    for (uint i = 0; i < 6; i++) triangles += meshes[group].triangles[i];
    float sum = 0.0f, maximum = 0.0f;
    uint count = 0;
    for (uint i = get_local_id(0); i < triangles; i += GROUP) {
        const uint first = 3 * (meshes[group].triangle_base + i);
        const float3 a = CORNER_POSITION(first), b = CORNER_POSITION(first + 1), c = CORNER_POSITION(first + 2);
        const float3 centre = (a + b + c) / 3.0f, x = centre / spacing;
        // A triangle may reach into another slab; the one that holds its centre counts it.
        const uint layer = (uint)x.z / 32;
        if (layer < first_layer || layer >= end_layer) continue;
        int3 low;
        float v[8];
        float4 field;
        TRILINEAR_AT(x, low, v, field)
        const float slope = length(field.xyz / spacing);
        // However flat the field, the surface is no further than a corner and what that is off; of a border vertex, than the
        // one it was moved from.
        float nearest = INFINITY;
        for (uint j = 0; j < 3; j++) {
            const float4 corner = positions[corner_slots[first + j] & ~ON_BORDER];
            nearest = fmin(nearest, length(corner.xyz - centre) + corner.w);
        }
        float d = fmin(fabs(field.w - iso) / slope, nearest);
        if (isnan(d)) d = nearest;
        sum += d * d;
        maximum = fmax(maximum, d);
        count++;
    }
    write_error(sums, maxima, counts, sum, maximum, count, errors + group);
}
