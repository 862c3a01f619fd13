// Triangles of polygons, LANES polygons at a time: a quad is split along the diagonal whose ends are nearer to each other's
// tangent planes (docs/algorithm.md#65-minimal-edges-and-polygons).
#ifndef ISOPEEL_BATCH_H
#define ISOPEEL_BATCH_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/octahedral.h"

// Polygons are collected until there are LANES of them. Row: corner, column: polygon.
typedef struct {
    int4 position_normal[4 * LANES]; // position from a common origin, 1/VERTEX_LATTICE cell; normal as in VertexRecord
    uint2 index_slot[4 * LANES];     // index in the region's mesh; slot, with ON_BORDER
    uint first[LANES];               // position of its first triangle's first corner among all indices
    uint count_flags[LANES];         // number of corners; bit 3: flip the winding
    uint count;                      // polygons
} Batch;

// Output buffers of triangles.
typedef struct {
    float3 scale;                // world units of 1/VERTEX_LATTICE cell
    __global uint *indices;
    bool keep_corners;           // whether corner_slots are wanted
    __global uint *corner_slots; // slot behind every index
} TriangleOutput;

// One corner of LANES polygons, in world units.
typedef struct {
    Real3 position, normal;
} BatchCorner;

INLINED BatchCorner load_corner(const Batch *batch, uint k, float3 scale) {
    integer x, y, z, packed;
    load_vec4s(batch->position_normal + k * LANES, &x, &y, &z, &packed);
    BatchCorner corner;
    corner.position = make_real3(TO_REAL(x) * scale.x, TO_REAL(y) * scale.y, TO_REAL(z) * scale.z);
    corner.normal = decode_normal_lanes(packed);
    return corner;
}

// A diagonal: distances of its ends from each other's tangent plane, summed, and its squared length.
typedef struct {
    real offset, length2;
} Diagonal;

INLINED Diagonal measure_diagonal(BatchCorner a, BatchCorner b) {
    const Real3 d = make_real3(b.position.x - a.position.x, b.position.y - a.position.y, b.position.z - a.position.z);
    Diagonal diagonal;
    diagonal.offset = fabs(dot_real3(a.normal, d)) + fabs(dot_real3(b.normal, d));
    diagonal.length2 = dot_real3(d, d);
    return diagonal;
}

// Writes the corners of a polygon's triangles: 0 1 2 and 0 2 3; with the other diagonal 1 2 3 and 1 3 0.
INLINED void write_corners(__global uint *to, uint4 of, uint corners, uint flip_winding, bool use_other_diagonal) {
    const uint a = use_other_diagonal ? of.y : of.x, b = use_other_diagonal ? of.z : of.y;
    const uint c = use_other_diagonal ? of.w : of.z, d = use_other_diagonal ? of.x : of.w;
    to[0] = a;
    to[1] = flip_winding ? c : b;
    to[2] = flip_winding ? b : c;
    if (corners < 4) return;
    to[3] = a;
    to[4] = flip_winding ? d : c;
    to[5] = flip_winding ? c : d;
}

// Writes the triangles of the collected polygons and empties the batch.
INLINED void emit_batch(Batch *batch, const TriangleOutput *out) {
    const BatchCorner c0 = load_corner(batch, 0, out->scale), c2 = load_corner(batch, 2, out->scale);
    const Diagonal d02 = measure_diagonal(c0, c2);
    const BatchCorner c1 = load_corner(batch, 1, out->scale), c3 = load_corner(batch, 3, out->scale);
    const Diagonal d13 = measure_diagonal(c1, c3);
    float other[LANES];
    STORE_LANES(PICK((d13.offset < d02.offset) | ((d13.offset == d02.offset) & (d13.length2 < d02.length2)), 1.0f, 0.0f), other);
    for (uint i = 0; i < LANES; i++) {
        if (i >= batch->count) break;
        const uint corners = batch->count_flags[i] & 7u, flip_winding = batch->count_flags[i] >> 3, at = batch->first[i];
        const bool use_other_diagonal = corners == 4 && other[i] > 0.0f;
        const uint2 *index_slot = batch->index_slot + i;
        const uint2 a = index_slot[0], b = index_slot[LANES], c = index_slot[2 * LANES], d = index_slot[3 * LANES];
        write_corners(out->indices + at, (uint4)(a.x, b.x, c.x, d.x), corners, flip_winding, use_other_diagonal);
        if (out->keep_corners)
            write_corners(out->corner_slots + at, (uint4)(a.y, b.y, c.y, d.y), corners, flip_winding, use_other_diagonal);
    }
    batch->count = 0;
}

#endif
