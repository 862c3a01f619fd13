// Where a node's vertex goes: the point that fits the planes of all crossings below best, moved onto the isosurface.
#ifndef ISOPEEL_QUADRIC_H
#define ISOPEEL_QUADRIC_H

#include "lib/precision.h"
#include "lib/lanes.h"
#include "lib/layout.h"

#define MEAN_WEIGHT 0.05f          // pull towards the mean of the crossings, each of them

inline Quadric no_quadric() {
    Quadric q = {{0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.0f, {0.0f, 0.0f, 0.0f}, 0.0f};
    return q;
}

inline void add_quadric(Quadric *into, Quadric q) {
    for (uint i = 0; i < 6; i++) into->a[i] += q.a[i];
    for (uint i = 0; i < 3; i++) { into->b[i] += q.b[i]; into->m[i] += q.m[i]; }
    into->c += q.c;
    into->k += q.k;
}

inline float3 times_a(Quadric q, float3 x) {
    return (float3)(q.a[0] * x.x + q.a[1] * x.y + q.a[2] * x.z, q.a[1] * x.x + q.a[3] * x.y + q.a[4] * x.z,
                    q.a[2] * x.x + q.a[4] * x.y + q.a[5] * x.z);
}

// The same sums from another origin, `by` away.
inline Quadric shift_quadric(Quadric q, float3 by) {
    const float3 ad = times_a(q, by), b = (float3)(q.b[0], q.b[1], q.b[2]);
    q.c += dot(by, ad) - 2.0f * dot(by, b);
    q.b[0] -= ad.x;
    q.b[1] -= ad.y;
    q.b[2] -= ad.z;
    q.m[0] -= q.k * by.x;
    q.m[1] -= q.k * by.y;
    q.m[2] -= q.k * by.z;
    return q;
}

// Root mean square distance of `x` to the planes.
inline float quadric_error(Quadric q, float3 x) {
    const float3 b = (float3)(q.b[0], q.b[1], q.b[2]);
    return sqrt(fmax((dot(x, times_a(q, x)) - 2.0f * dot(b, x) + q.c) / fmax(q.k, 1.0f), 0.0f));
}

// The best point: minimises the quadric with a pull towards the mean. Symmetric 3x3 system by Cholesky factors.
inline float3 quadric_minimum(Quadric q) {
    const float3 mean = (float3)(q.m[0], q.m[1], q.m[2]) / fmax(q.k, 1.0f);
    const float w = fmax(MEAN_WEIGHT * q.k, 1e-6f);
    const float3 r = (float3)(q.b[0], q.b[1], q.b[2]) - times_a(q, mean);
    const float l00 = sqrt(q.a[0] + w), l10 = q.a[1] / l00, l20 = q.a[2] / l00;
    const float l11 = sqrt(fmax(q.a[3] + w - l10 * l10, 1e-12f)), l21 = (q.a[4] - l20 * l10) / l11;
    const float l22 = sqrt(fmax(q.a[5] + w - l20 * l20 - l21 * l21, 1e-12f));
    const float y0 = r.x / l00, y1 = (r.y - l10 * y0) / l11, y2 = (r.z - l20 * y0 - l21 * y1) / l22;
    const float x2 = y2 / l22, x1 = (y1 - l21 * x2) / l11, x0 = (y0 - l10 * x1 - l20 * x2) / l00;
    return mean + (float3)(x0, x1, x2);
}

// The quadric's minimum with a pull towards the mean, and from there (up_x, up_y, up_z): quadric_minimum, in lanes.
#define SOLVE_QUADRIC                                                                                                  \
    const real pull = fmax(MEAN_WEIGHT * k, 1e-6f);                                                                    \
    const real rx = bx - (axx * mean_x + axy * mean_y + axz * mean_z);                                                 \
    const real ry = by - (axy * mean_x + ayy * mean_y + ayz * mean_z);                                                 \
    const real rz = bz - (axz * mean_x + ayz * mean_y + azz * mean_z);                                                 \
    const real l00 = rsqrt(axx + pull), l10 = axy * l00, l20 = axz * l00;                                              \
    const real l11 = rsqrt(fmax(ayy + pull - l10 * l10, 1e-12f)), l21 = (ayz - l20 * l10) * l11;                       \
    const real l22 = rsqrt(fmax(azz + pull - l20 * l20 - l21 * l21, 1e-12f));                                          \
    const real s0 = rx * l00, s1 = (ry - l10 * s0) * l11, s2 = (rz - l20 * s0 - l21 * s1) * l22;                       \
    const real up_z = s2 * l22, up_y = (s1 - l21 * up_z) * l11, up_x = (s0 - l10 * up_y - l20 * up_z) * l00;

#endif
