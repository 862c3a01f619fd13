// Polygons become triangles: LANES of them at once.
#ifndef ISOPEEL_BATCH_H
#define ISOPEEL_BATCH_H

// Polygons wait here until there are LANES of them: their diagonals are chosen together. Row `corner`, column polygon.
typedef struct {
    float x[4 * LANES], y[4 * LANES], z[4 * LANES]; // world units from some origin
    float u[4 * LANES], v[4 * LANES];               // octahedral normals
    uint index[4 * LANES], slot[4 * LANES];
    uint first[LANES]; // corner of its first triangle
    uint shape[LANES]; // number of corners, and bit 3: turns the other way
    uint count;
} Batch;

#define UNIT_NORMAL(k, nx, ny, nz)                                                                                     \
    real nx = LOAD_LANES(batch->u + (k) * LANES), ny = LOAD_LANES(batch->v + (k) * LANES);                             \
    real nz = 1.0f - fabs(nx) - fabs(ny);                                                                              \
    {                                                                                                                  \
        const real fold = fmax(-nz, 0.0f);                                                                             \
        nx += PICK(nx >= 0.0f, -fold, fold);                                                                           \
        ny += PICK(ny >= 0.0f, -fold, fold);                                                                           \
        const real per_length = rsqrt(nx * nx + ny * ny + nz * nz);                                                    \
        nx *= per_length;                                                                                              \
        ny *= per_length;                                                                                              \
        nz *= per_length;                                                                                              \
    }
// How far the ends of a diagonal are from each other's tangent plane, both together, and the diagonal's squared length.
#define DIAGONAL(from, to, off, length2)                                                                               \
    real off, length2;                                                                                                 \
    {                                                                                                                  \
        const real dx = LOAD_LANES(batch->x + (to) * LANES) - LOAD_LANES(batch->x + (from) * LANES);                   \
        const real dy = LOAD_LANES(batch->y + (to) * LANES) - LOAD_LANES(batch->y + (from) * LANES);                   \
        const real dz = LOAD_LANES(batch->z + (to) * LANES) - LOAD_LANES(batch->z + (from) * LANES);                   \
        UNIT_NORMAL(from, ax, ay, az)                                                                                  \
        UNIT_NORMAL(to, bx, by, bz)                                                                                    \
        off = fabs(ax * dx + ay * dy + az * dz) + fabs(bx * dx + by * dy + bz * dz);                                   \
        length2 = dx * dx + dy * dy + dz * dz;                                                                         \
    }

// Corners of a polygon's triangles: 0 1 2 and 0 2 3, or, where the diagonal swings, 1 2 3 and 1 3 0; turned round if it says so.
inline void write_corners(__global uint *to, const uint *of, uint corners, uint turn, bool swing) {
    const uint a = swing ? of[LANES] : of[0], b = swing ? of[2 * LANES] : of[LANES];
    const uint c = swing ? of[3 * LANES] : of[2 * LANES], d = swing ? of[0] : of[3 * LANES];
    to[0] = a;
    to[1] = turn ? c : b;
    to[2] = turn ? b : c;
    if (corners < 4) return;
    to[3] = a;
    to[4] = turn ? d : c;
    to[5] = turn ? c : d;
}

// Writes the triangles of the waiting polygons; a quad is split along the diagonal that leaves the tangent planes at its ends
// less.
inline void emit_batch(Batch *batch, __global uint *indices, uint keep_corners, __global uint *corner_slots) {
#pragma OPENCL FP_CONTRACT ON
    DIAGONAL(0, 2, off02, length02)
    DIAGONAL(1, 3, off13, length13)
    float other[LANES];
    STORE_LANES(PICK((off13 < off02) | ((off13 == off02) & (length13 < length02)), 1.0f, 0.0f), other);
    for (uint i = 0; i < LANES; i++) {
        if (i >= batch->count) break;
        const uint corners = batch->shape[i] & 7u, turn = batch->shape[i] >> 3, at = batch->first[i];
        const bool swing = corners == 4 && other[i] > 0.0f;
        write_corners(indices + at, batch->index + i, corners, turn, swing);
        if (keep_corners) write_corners(corner_slots + at, batch->slot + i, corners, turn, swing);
    }
    batch->count = 0;
}

#undef UNIT_NORMAL
#undef DIAGONAL
#endif
