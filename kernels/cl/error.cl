// error: how far a dual mesh is from the surface it stands for, in both directions (docs/algorithm.md#67-stated-error).
// Positions are in world units from the volume's first sample.
//
//   kernel            work-group    computes
//   error_positions   a region      position of each slot's vertex, and its own distance to the surface
//   error_link        any           for each slot a chain of the corners of triangles at its vertex
//   error_unmeshed    a region      for leaves without triangles the distance to the nearest vertex that has some
//   error_crossings   a region      distance of each full-resolution crossing to the nearest triangle at its leaf's vertex
//   error_centres     a region      |V - iso| / |grad V| at the centroids of triangles
//
// The last two write sums and maxima of each region. A chain: heads[slot], then next[corner], to NONE; a corner is its position
// among all indices.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/polygon.h"
#include "lib/samples.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/trilinear.h"
#include "lib/vertices.h"

// Value (w) and gradient per cell (xyz) of the volume's trilinear interpolant. `x`: in cells from the first sample.
inline float4 field_at(Grid grid, SLAB, float3 x) {
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    const int3 low = clamp(convert_int3(x), (int3)(0), end - 2);
    float v[8];
    for (uint corner = 0; corner < 8; corner++)
        v[corner] = sample_at(grid, SLAB_ARGS, low + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));
    return trilinear(v, x - convert_float3(low));
}

// `positions`: in w the distance of a vertex to the surface, |V - iso| / |grad V|, at most the diagonal of its cube, in which the
// surface is.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_positions(const ErrorPositionsArgs args, __global const SAMPLE *samples, __global const Region *regions,
                     __global const Node *nodes, __global const VertexRecord *vertex_records, __global float4 *positions) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    __global const Region *region = regions + args.first_region + get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        const float3 x = convert_float3(lattice_position(grid, args.params, vertex_records[slot], origin)) / VERTEX_LATTICE;
        const float4 field = field_at(grid, SLAB_ARGS, x);
        const float diagonal = length(spacing) * (float)(1u << code_level(meta_code(nodes[slot].meta)));
        positions[slot] = (float4)(x * spacing, fmin(fabs(field.w - args.iso) / length(field.xyz / spacing), diagonal));
    }
}

__kernel void error_link(const uint count, __global const uint *corner_slots, __global uint *heads, __global uint *next) {
    const uint i = (uint)get_global_id(0);
    if (i < count) next[i] = atomic_xchg(&heads[corner_slots[i] & ~ON_BORDER], i);
}

// Where the corners of triangles are: vertices of slots, and border vertices, which the mesh alone has.
typedef struct {
    __global const Region *regions;
    __global const uint *corner_slots;
    __global const float4 *positions;
    __global const RegionMesh *meshes;
    uint region_count;
    __global const uint *indices;
    __global const Vertex *vertices;
} TriangleCorners;

INLINED float3 triangle_corner(Grid grid, const TriangleCorners *mesh, uint corner) {
    const uint slot = mesh->corner_slots[corner];
    if (!(slot & ON_BORDER)) return mesh->positions[slot].xyz;
    // The triangle is in the last region whose triangles begin at it or before, found by bisection.
    uint region = 0, end = mesh->region_count;
    while (end - region > 1) {
        const uint middle = region + (end - region) / 2;
        if (mesh->meshes[middle].triangle_base <= corner / 3) region = middle;
        else end = middle;
    }
    const Vertex vertex = mesh->vertices[mesh->meshes[region].vertex_base + mesh->indices[corner]];
    const float3 cells = (float3)((float)vertex.position[0], (float)vertex.position[1], (float)vertex.position[2]) / 65536.0f;
    return (cells + convert_float3(region_origin(grid, mesh->regions[region].region)))
        * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
}

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

// Adds up the work-items' sums, maxima and counts; the first one writes the result.
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

// Squared distance from the vertex of a slot to the nearest vertex with triangles among `count` slots.
inline float nearest_vertex2(uint slot, uint first, uint count, __global const uint *heads,
                             __global const float4 *positions) {
    float nearest2 = INFINITY;
    for (uint i = first; i < first + count; i++) {
        if (heads[i] == NONE) continue;
        const float3 d = positions[i].xyz - positions[slot].xyz;
        nearest2 = fmin(nearest2, dot(d, d));
    }
    return nearest2;
}

// `unmeshed`: of leaves without triangles; other slots are left as they are. Any vertex bounds the distance from above: those of
// the region are searched, and all others only where none of these has triangles.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_unmeshed(__global const Region *regions, __global const Node *nodes, __global const uchar *state,
                    const uint slots, __global const uint *heads, __global const float4 *positions,
                    __global float *unmeshed) {
    __global const Region *region = regions + get_group_id(0);
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        if (state[slot] != code_level(meta_code(nodes[slot].meta)) || heads[slot] != NONE) continue;
        float nearest2 = nearest_vertex2(slot, region->slot_base, region->level_base[7], heads, positions);
        if (isinf(nearest2)) nearest2 = nearest_vertex2(slot, 0, slots, heads, positions);
        unmeshed[slot] = sqrt(nearest2);
    }
}

// Slot of the sheet of an active cell to which one of its edges belongs.
inline uint sheet_slot(__global const Region *region, __global const Brick *bricks, __global const Node *nodes, uint slot,
                       uint edge) {
    const uint b = code_cell(meta_code(nodes[slot].meta), 0) >> 9;
    return sheet_in_brick(region, bricks + region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], b), nodes,
                          slot, edge);
}

// Squared distance from a crossing to the mesh at the vertex of a slot.
INLINED float crossing_distance2(Grid grid, const TriangleCorners *mesh, float3 p, uint slot, __global const uint *heads,
                                 __global const uint *next, __global const float *unmeshed) {
    float distance2 = INFINITY;
    for (uint corner = heads[slot]; corner != NONE; corner = next[corner]) {
        const uint first = corner - corner % 3;
        const float3 a = triangle_corner(grid, mesh, first), b = triangle_corner(grid, mesh, first + 1);
        distance2 = fmin(distance2, triangle_distance2(p, a, b, triangle_corner(grid, mesh, first + 2)));
    }
    if (heads[slot] == NONE) {
        const float d = length(p - mesh->positions[slot].xyz) + unmeshed[slot];
        distance2 = d * d;
    }
    return distance2;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_crossings(const ErrorCrossingsArgs args, __global const SAMPLE *samples, __global const Region *regions,
                     __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
                     __global const uint *corner_slots, __global const float4 *positions, __global const RegionMesh *meshes,
                     __global const uint *indices, __global const Vertex *vertices, __global const uint *heads,
                     __global const uint *next, __global const float *unmeshed, __global RegionError *errors) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    __local float sums[GROUP], maxima[GROUP];
    __local uint counts[GROUP];
    const TriangleCorners mesh = {regions, corner_slots, positions, meshes, args.region_count, indices, vertices};
    const uint group = args.first_region + (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const bool has_missing = region->missing_mask[0] | region->missing_mask[1];
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
            // Once for each crossing: by the cell that has it on an edge from its low corner, if that cell exists.
            if ((edge & 3) && !has_missing && all(low + 1 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2])))
                continue;
            const float a = sample_at(grid, SLAB_ARGS, low), b = sample_at(grid, SLAB_ARGS, low + step);
            const float t = (float)crossing(args.iso, a, b) / 65536.0f;
            const float3 p = (convert_float3(low) + convert_float3(step) * t) * spacing;
            const uint vertex = level > 0 ? coarse : sheet_slot(region, bricks, nodes, slot, edge);
            const float distance2 = crossing_distance2(grid, &mesh, p, vertex, heads, next, unmeshed);
            sum += distance2;
            maximum = fmax(maximum, distance2);
            count++;
        }
    }
    write_error(sums, maxima, counts, sum, sqrt(maximum), count, errors + group);
}

// Distance of a triangle's centroid to the surface. However flat the field, the surface is no further than a corner and that
// corner's own distance; of a border vertex, that of the vertex it was moved from.
INLINED float centroid_distance(const TriangleCorners *mesh, float4 field, float iso, float3 spacing, float3 centroid, uint first) {
    float bound = INFINITY;
    for (uint j = 0; j < 3; j++) {
        const float4 corner = mesh->positions[mesh->corner_slots[first + j] & ~ON_BORDER];
        bound = fmin(bound, length(corner.xyz - centroid) + corner.w);
    }
    const float d = fmin(fabs(field.w - iso) / length(field.xyz / spacing), bound);
    return isnan(d) ? bound : d;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_centres(const ErrorCentresArgs args, __global const SAMPLE *samples, __global const Region *regions,
                   __global const uint *corner_slots, __global const float4 *positions, __global const RegionMesh *meshes,
                   __global const uint *indices, __global const Vertex *vertices, __global RegionError *errors) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    __local float sums[GROUP], maxima[GROUP];
    __local uint counts[GROUP];
    const TriangleCorners mesh = {regions, corner_slots, positions, meshes, args.region_count, indices, vertices};
    const uint group = (uint)get_group_id(0);
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    uint triangles = 0;
    for (uint i = 0; i < 6; i++) triangles += meshes[group].triangles[i];
    float sum = 0.0f, maximum = 0.0f;
    uint count = 0;
    for (uint i = get_local_id(0); i < triangles; i += GROUP) {
        const uint first = 3 * (meshes[group].triangle_base + i);
        const float3 a = triangle_corner(grid, &mesh, first), b = triangle_corner(grid, &mesh, first + 1);
        const float3 c = triangle_corner(grid, &mesh, first + 2), centroid = (a + b + c) / 3.0f, x = centroid / spacing;
        // A triangle may reach into another slab; the one that holds its centroid counts it.
        const uint layer = (uint)x.z / 32;
        if (layer < args.first_layer || layer >= args.end_layer) continue;
        const float d = centroid_distance(&mesh, field_at(grid, SLAB_ARGS, x), args.iso, spacing, centroid, first);
        sum += d * d;
        maximum = fmax(maximum, d);
        count++;
    }
    write_error(sums, maxima, counts, sum, maximum, count, errors + group);
}
