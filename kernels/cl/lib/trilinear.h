// The trilinear interpolant of a cell's eight corner values: value, gradient and crossings. Functions of one cell and of LANES
// cells, because OpenCL C has none over several types; those of LANES divide approximately.
// Corner = dx + 2 dy + 4 dz.
#ifndef ISOPEEL_TRILINEAR_H
#define ISOPEEL_TRILINEAR_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"

// Value (w) and gradient per cell (xyz) of a cell's trilinear interpolant at `t` in [0, 1]^3.
inline float4 trilinear(const float *v, float3 t) {
    const float x00 = mix(v[0], v[1], t.x), x10 = mix(v[2], v[3], t.x), x01 = mix(v[4], v[5], t.x), x11 = mix(v[6], v[7], t.x);
    const float y0 = mix(x00, x10, t.y), y1 = mix(x01, x11, t.y);
    const float d0 = mix(v[1] - v[0], v[3] - v[2], t.y), d1 = mix(v[5] - v[4], v[7] - v[6], t.y);
    return (float4)(mix(d0, d1, t.z), mix(x10 - x00, x11 - x01, t.z), y1 - y0, mix(y0, y1, t.z));
}

// Copies the samples at a cell's corners from a brick's tile of 9^3 samples, from the low corner's on, into a column of eight
// rows of `stride` numbers. A macro because it stores to any address space.
#define GATHER_CORNERS(from, to, stride)                                                                               \
    {                                                                                                                  \
        (to)[0] = (from)[0];                                                                                           \
        (to)[(stride)] = (from)[1];                                                                                    \
        (to)[2 * (stride)] = (from)[9];                                                                                \
        (to)[3 * (stride)] = (from)[10];                                                                               \
        (to)[4 * (stride)] = (from)[81];                                                                               \
        (to)[5 * (stride)] = (from)[82];                                                                               \
        (to)[6 * (stride)] = (from)[90];                                                                               \
        (to)[7 * (stride)] = (from)[91];                                                                               \
    }

// Parameter in [0, 1] of the zero between two values of different sign; 1/2 if both are infinite.
inline real crossing_parameter(real from, real to) {
    const real t = native_divide(from, from - to);
    return PICK(t == t, clamp(t, 0.0f, 1.0f), 0.5f);
}

// LANES cells: corner values, and their differences along the four edges of each axis.
typedef struct {
    real v0, v1, v2, v3, v4, v5, v6, v7;
    real x00, x10, x01, x11; // along x, by y and z
    real y00, y10, y01, y11; // along y, by x and z
    real z00, z10, z01, z11; // along z, by x and y
} Cells;

INLINED Cells make_cells(real v0, real v1, real v2, real v3, real v4, real v5, real v6, real v7) {
    Cells c;
    c.v0 = v0;
    c.v1 = v1;
    c.v2 = v2;
    c.v3 = v3;
    c.v4 = v4;
    c.v5 = v5;
    c.v6 = v6;
    c.v7 = v7;
    c.x00 = v1 - v0;
    c.x10 = v3 - v2;
    c.x01 = v5 - v4;
    c.x11 = v7 - v6;
    c.y00 = v2 - v0;
    c.y10 = v3 - v1;
    c.y01 = v6 - v4;
    c.y11 = v7 - v5;
    c.z00 = v4 - v0;
    c.z10 = v5 - v1;
    c.z01 = v6 - v2;
    c.z11 = v7 - v3;
    return c;
}

// Cells from eight rows of corner values, `stride` numbers apart. A macro because it loads from any address space.
#define LOAD_CELLS(from, stride)                                                                                       \
    make_cells(LOAD_LANES(from), LOAD_LANES((from) + (stride)), LOAD_LANES((from) + 2 * (stride)),                     \
               LOAD_LANES((from) + 3 * (stride)), LOAD_LANES((from) + 4 * (stride)), LOAD_LANES((from) + 5 * (stride)), \
               LOAD_LANES((from) + 6 * (stride)), LOAD_LANES((from) + 7 * (stride)))

// Value and scaled gradient of the interpolant at LANES points.
typedef struct {
    real value;
    Real3 gradient;
} Field;

// The field at `p` in [0, 1]^3; its gradient, per cell, is multiplied by `scale`.
INLINED Field field_in_cells(const Cells *c, Real3 p, float3 scale) {
#pragma OPENCL FP_CONTRACT ON
    Field field;
    const real dx0 = mix(c->x00, c->x10, p.y), dx1 = mix(c->x01, c->x11, p.y);
    field.value = mix(mix(c->v0, c->v2, p.y) + dx0 * p.x, mix(c->v4, c->v6, p.y) + dx1 * p.x, p.z);
    field.gradient.x = mix(dx0, dx1, p.z) * scale.x;
    field.gradient.y = mix(mix(c->y00, c->y10, p.x), mix(c->y01, c->y11, p.x), p.z) * scale.y;
    field.gradient.z = mix(mix(c->z00, c->z10, p.x), mix(c->z01, c->z11, p.x), p.y) * scale.z;
    return field;
}

#endif
