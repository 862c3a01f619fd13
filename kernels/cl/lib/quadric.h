// Error quadrics: sums over the tangent planes of the crossings below a node, and the point that fits them best
// (docs/algorithm.md#61-crossings-and-quadrics).
#ifndef ISOPEEL_QUADRIC_H
#define ISOPEEL_QUADRIC_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"

// Weight of each crossing's pull towards the mean of the crossings: of a cell, of a cube.
#define CELL_PULL 0.05f
#define CUBE_PULL 0.01f

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

// A x.
inline float3 times_a(Quadric q, float3 x) {
    return (float3)(q.a[0] * x.x + q.a[1] * x.y + q.a[2] * x.z, q.a[1] * x.x + q.a[3] * x.y + q.a[4] * x.z,
                    q.a[2] * x.x + q.a[4] * x.y + q.a[5] * x.z);
}

// The same sums from an origin moved by `by`.
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

// The point that minimises the quadric of a cube with a pull towards the mean of the crossings: a symmetric 3x3 system, by
// Cholesky factors.
inline float3 quadric_minimum(Quadric q) {
    const float3 mean = (float3)(q.m[0], q.m[1], q.m[2]) / fmax(q.k, 1.0f);
    const float w = fmax(CUBE_PULL * q.k, 1e-6f);
    const float3 r = (float3)(q.b[0], q.b[1], q.b[2]) - times_a(q, mean);
    const float l00 = sqrt(q.a[0] + w), l10 = q.a[1] / l00, l20 = q.a[2] / l00;
    const float l11 = sqrt(fmax(q.a[3] + w - l10 * l10, 1e-12f)), l21 = (q.a[4] - l20 * l10) / l11;
    const float l22 = sqrt(fmax(q.a[5] + w - l20 * l20 - l21 * l21, 1e-12f));
    const float y0 = r.x / l00, y1 = (r.y - l10 * y0) / l11, y2 = (r.z - l20 * y0 - l21 * y1) / l22;
    const float x2 = y2 / l22, x1 = (y1 - l21 * x2) / l11, x0 = (y0 - l10 * x1 - l20 * x2) / l00;
    return mean + (float3)(x0, x1, x2);
}

// Sums over the crossings of LANES cells or cubes: the fields of Quadric. p: position, n: unit normal, world units.
typedef struct {
    real axx, axy, axz, ayy, ayz, azz; // sum of n n^T
    Real3 b;                           // sum of n (n p)
    real c;                            // sum of (n p)^2
    Real3 m;                           // sum of p
    real k;                            // how many
} Quadrics;

INLINED Quadrics no_quadrics() {
    Quadrics q;
    q.axx = q.axy = q.axz = q.ayy = q.ayz = q.azz = 0.0f;
    q.b = q.m = make_real3(0.0f, 0.0f, 0.0f);
    q.c = q.k = 0.0f;
    return q;
}

// Rows a quadric takes in an array with one column a cell or cube.
#define QUADRIC_ROWS 14

// From QUADRIC_ROWS rows of local memory, `stride` numbers apart.
INLINED Quadrics load_quadrics(__local const float *from, uint stride) {
    Quadrics q;
    q.axx = LOAD_LANES(from);
    q.axy = LOAD_LANES(from + stride);
    q.axz = LOAD_LANES(from + 2 * stride);
    q.ayy = LOAD_LANES(from + 3 * stride);
    q.ayz = LOAD_LANES(from + 4 * stride);
    q.azz = LOAD_LANES(from + 5 * stride);
    q.b = LOAD_REAL3(from + 6 * stride, stride);
    q.c = LOAD_LANES(from + 9 * stride);
    q.m = LOAD_REAL3(from + 10 * stride, stride);
    q.k = LOAD_LANES(from + 13 * stride);
    return q;
}

// Adds a crossing at `p` if `weight` is 1, none if it is 0. `gradient`: of any length, 0 if it is not defined.
INLINED void add_crossing(Quadrics *q, real weight, Real3 p, Real3 gradient) {
#pragma OPENCL FP_CONTRACT ON
    const real length2 = dot_real3(gradient, gradient);
    const Real3 n = scale_real3(gradient, PICK(length2 > 0.0f, weight * rsqrt(length2), 0.0f));
    const real d = dot_real3(n, p);
    q->axx += n.x * n.x;
    q->axy += n.x * n.y;
    q->axz += n.x * n.z;
    q->ayy += n.y * n.y;
    q->ayz += n.y * n.z;
    q->azz += n.z * n.z;
    q->b.x += n.x * d;
    q->b.y += n.y * d;
    q->b.z += n.z * d;
    q->c += d * d;
    q->m.x += weight * p.x;
    q->m.y += weight * p.y;
    q->m.z += weight * p.z;
    q->k += weight;
}

// The minimum of the quadric with a pull towards the crossings' mean, as quadric_minimum, relative to the mean.
INLINED Real3 quadrics_minimum(const Quadrics *q, Real3 mean, float weight) {
#pragma OPENCL FP_CONTRACT ON
    const real pull = fmax(weight * q->k, 1e-6f);
    const real rx = q->b.x - (q->axx * mean.x + q->axy * mean.y + q->axz * mean.z);
    const real ry = q->b.y - (q->axy * mean.x + q->ayy * mean.y + q->ayz * mean.z);
    const real rz = q->b.z - (q->axz * mean.x + q->ayz * mean.y + q->azz * mean.z);
    const real l00 = rsqrt(q->axx + pull), l10 = q->axy * l00, l20 = q->axz * l00;
    const real l11 = rsqrt(fmax(q->ayy + pull - l10 * l10, 1e-12f)), l21 = (q->ayz - l20 * l10) * l11;
    const real l22 = rsqrt(fmax(q->azz + pull - l20 * l20 - l21 * l21, 1e-12f));
    const real s0 = rx * l00, s1 = (ry - l10 * s0) * l11, s2 = (rz - l20 * s0 - l21 * s1) * l22;
    const real z = s2 * l22, y = (s1 - l21 * z) * l11, x = (s0 - l10 * y - l20 * z) * l00;
    return make_real3(x, y, z);
}

// Root mean square distance of `p` to the planes. `per_k`: 1 / k.
INLINED real quadrics_error(const Quadrics *q, Real3 p, real per_k) {
#pragma OPENCL FP_CONTRACT ON
    const real error2 = p.x * (q->axx * p.x + q->axy * p.y + q->axz * p.z)
        + p.y * (q->axy * p.x + q->ayy * p.y + q->ayz * p.z) + p.z * (q->axz * p.x + q->ayz * p.y + q->azz * p.z)
        - 2.0f * (q->b.x * p.x + q->b.y * p.y + q->b.z * p.z) + q->c;
    return native_sqrt(fmax(error2 * per_k, 0.0f));
}

#endif
