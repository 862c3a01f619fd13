// The trilinear interpolant of a cell's eight corner values, and where it crosses zero.
#ifndef ISOPEEL_TRILINEAR_H
#define ISOPEEL_TRILINEAR_H

#include "lib/precision.h"
#include "lib/lanes.h"

// Value (w) and gradient per cell (xyz) of a cell's trilinear interpolant at `t` in [0, 1]^3.
inline float4 trilinear(const float *v, float3 t) {
    const float x00 = mix(v[0], v[1], t.x), x10 = mix(v[2], v[3], t.x), x01 = mix(v[4], v[5], t.x), x11 = mix(v[6], v[7], t.x);
    const float y0 = mix(x00, x10, t.y), y1 = mix(x01, x11, t.y);
    const float d0 = mix(v[1] - v[0], v[3] - v[2], t.y), d1 = mix(v[5] - v[4], v[7] - v[6], t.y);
    return (float4)(mix(d0, d1, t.z), mix(x10 - x00, x11 - x01, t.z), y1 - y0, mix(y0, y1, t.z));
}

// One Newton step towards the isosurface, in cells, at most one cell long.
inline float3 newton_step(float4 field, float iso, float3 spacing) {
    const float3 g = field.xyz / spacing;
    const float length2 = dot(g, g);
    const float3 step = (iso - field.w) / length2 * g / spacing;
    const float longest = fmax(fmax(fabs(step.x), fabs(step.y)), fabs(step.z));
    if (!(longest < INFINITY)) return (float3)(0.0f);
    return longest > 1.0f ? step / longest : step;
}

// Samples at the corners of a cell, from the one at its low corner in a brick's tile on, into a column of eight rows.
#define GATHER_CORNERS(from, to, row)                                                                                  \
    {                                                                                                                  \
        (to)[0] = (from)[0];                                                                                           \
        (to)[(row)] = (from)[1];                                                                                       \
        (to)[2 * (row)] = (from)[9];                                                                                   \
        (to)[3 * (row)] = (from)[10];                                                                                  \
        (to)[4 * (row)] = (from)[81];                                                                                  \
        (to)[5 * (row)] = (from)[82];                                                                                  \
        (to)[6 * (row)] = (from)[90];                                                                                  \
        (to)[7 * (row)] = (from)[91];                                                                                  \
    }

// Where between two samples, of the way, the surface passes: in the middle where both are infinite.
inline real crossing_parameter(real from, real to) {
    const real share = native_divide(from, from - to);
    return PICK(share == share, clamp(share, 0.0f, 1.0f), 0.5f);
}

// Differences of a cell's corners along x, y, z at the four edges each.
#define CORNER_DIFFERENCES                                                                                             \
    const real x00 = v1 - v0, x10 = v3 - v2, x01 = v5 - v4, x11 = v7 - v6;                                             \
    const real y00 = v2 - v0, y10 = v3 - v1, y01 = v6 - v4, y11 = v7 - v5;                                             \
    const real z00 = v4 - v0, z10 = v5 - v1, z01 = v6 - v2, z11 = v7 - v3;

// From them, field and gradient at x, y, z in the cell, the gradient by `per`.
#define FIELD_IN_CELL(per)                                                                                             \
    {                                                                                                                  \
        const real dx0 = mix(x00, x10, y), dx1 = mix(x01, x11, y);                                                     \
        now = mix(mix(v0, v2, y) + dx0 * x, mix(v4, v6, y) + dx1 * x, z);                                              \
        gx = mix(dx0, dx1, z) * per.x;                                                                                 \
        gy = mix(mix(y00, y10, x), mix(y01, y11, x), z) * per.y;                                                       \
        gz = mix(mix(z00, z10, x), mix(z01, z11, x), y) * per.z;                                                       \
    }

#endif
