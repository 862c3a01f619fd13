// Polygons become triangles: LANES of them at once.
#ifndef ISOPEEL_BATCH_H
#define ISOPEEL_BATCH_H

#include "lib/precision.h"
#include "lib/lanes.h"

// Polygons wait here until there are LANES of them: their diagonals are chosen together. Row `corner`, column polygon. What lies
// together is copied at once.
typedef struct {
    int4 position_normal[4 * LANES];  // position from some origin, 1/VERTEX_LATTICE cell, and normal as in VertexRecord
    uint2 index_slot[4 * LANES]; // index in the mesh, slot
    uint first[LANES];      // corner of its first triangle
    uint count_flags[LANES];      // number of corners, bit 3: flip the winding
    uint count;
} Batch;

// Positions in world units and normals of one corner of all waiting polygons.
#define LOAD_CORNER(k)                                                                                                 \
    real x##k, y##k, z##k, nx##k, ny##k, nz##k;                                                                        \
    {                                                                                                                  \
        integer x, y, z, packed;                                                                                       \
        load_vec4s(batch->position_normal + (k) * LANES, &x, &y, &z, &packed);                                                   \
        x##k = TO_REAL(x) * scale.x;                                                                                   \
        y##k = TO_REAL(y) * scale.y;                                                                                   \
        z##k = TO_REAL(z) * scale.z;                                                                                   \
        nx##k = TO_REAL(packed << 24 >> 24) * (1.0f / 127.0f);                                                         \
        ny##k = TO_REAL(packed << 16 >> 24) * (1.0f / 127.0f);                                                         \
        nz##k = 1.0f - fabs(nx##k) - fabs(ny##k);                                                                      \
        const real fold = fmax(-nz##k, 0.0f);                                                                          \
        nx##k += PICK(nx##k >= 0.0f, -fold, fold);                                                                     \
        ny##k += PICK(ny##k >= 0.0f, -fold, fold);                                                                     \
        const real per_length = rsqrt(nx##k * nx##k + ny##k * ny##k + nz##k * nz##k);                                  \
        nx##k *= per_length;                                                                                           \
        ny##k *= per_length;                                                                                           \
        nz##k *= per_length;                                                                                           \
    }
// How far the ends of a diagonal are from each other's tangent plane, both together, and the diagonal's squared length.
#define DIAGONAL(a, b, off, length2)                                                                                   \
    real off, length2;                                                                                                 \
    {                                                                                                                  \
        const real dx = x##b - x##a, dy = y##b - y##a, dz = z##b - z##a;                                               \
        off = fabs(nx##a * dx + ny##a * dy + nz##a * dz) + fabs(nx##b * dx + ny##b * dy + nz##b * dz);                 \
        length2 = dx * dx + dy * dy + dz * dz;                                                                         \
    }

// Corners of a polygon's triangles: 0 1 2 and 0 2 3, or, with the other diagonal, 1 2 3 and 1 3 0; with the winding flipped if asked.
inline void write_corners(__global uint *to, uint4 of, uint corners, uint flip_winding, bool use_other_diagonal) {
    const uint a = use_other_diagonal ? of.y : of.x, b = use_other_diagonal ? of.z : of.y, c = use_other_diagonal ? of.w : of.z, d = use_other_diagonal ? of.x : of.w;
    to[0] = a;
    to[1] = flip_winding ? c : b;
    to[2] = flip_winding ? b : c;
    if (corners < 4) return;
    to[3] = a;
    to[4] = flip_winding ? d : c;
    to[5] = flip_winding ? c : d;
}

// Writes the triangles of the waiting polygons; a quad is split along the diagonal that leaves the tangent planes at its ends
// less. `scale`: world units of 1/VERTEX_LATTICE cell.
inline void emit_batch(Batch *batch, float3 scale, __global uint *indices, uint keep_corners, __global uint *corner_slots) {
#pragma OPENCL FP_CONTRACT ON
    LOAD_CORNER(0)
    LOAD_CORNER(2)
    DIAGONAL(0, 2, off02, length02)
    LOAD_CORNER(1)
    LOAD_CORNER(3)
    DIAGONAL(1, 3, off13, length13)
    float other[LANES];
    STORE_LANES(PICK((off13 < off02) | ((off13 == off02) & (length13 < length02)), 1.0f, 0.0f), other);
    for (uint i = 0; i < LANES; i++) {
        if (i >= batch->count) break;
        const uint corners = batch->count_flags[i] & 7u, flip_winding = batch->count_flags[i] >> 3, at = batch->first[i];
        const bool use_other_diagonal = corners == 4 && other[i] > 0.0f;
        const uint2 *index_slot = batch->index_slot + i;
        const uint2 a = index_slot[0], b = index_slot[LANES], c = index_slot[2 * LANES], d = index_slot[3 * LANES];
        write_corners(indices + at, (uint4)(a.x, b.x, c.x, d.x), corners, flip_winding, use_other_diagonal);
        if (keep_corners) write_corners(corner_slots + at, (uint4)(a.y, b.y, c.y, d.y), corners, flip_winding, use_other_diagonal);
    }
    batch->count = 0;
}

#undef LOAD_CORNER
#undef DIAGONAL
#endif
