// Features at samples of a block from those around them (docs/algorithm.md#21-derived-features), LANES at once. A neighbour that is
// missing, or outside the volume, is NaN.
#ifndef ISOPEEL_NEIGHBOURHOOD_H
#define ISOPEEL_NEIGHBOURHOOD_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/sample_block.h"
#include "lib/steps.h"

// The neighbour at the offset (x, y, z), in samples.
#define NEIGHBOUR(at, x, y, z) LOAD_LANES((at) + ((z) * BLOCK_PLANE + (y) * BLOCK_ROW + (x)))

// First and second derivatives of a field at samples, over the sum of the absolute first ones, which curvature does not depend on.
typedef struct {
    Real3 first;
    Real3 second; // xx, yy, zz
    Real3 mixed;  // yz, xz, xy
    integer flat; // the gradient is zero
} Derivatives;

INLINED Derivatives make_derivatives(__local const float *at, Steps steps) {
    const real here = LOAD_LANES(at);
    const real left = NEIGHBOUR(at, -1, 0, 0), right = NEIGHBOUR(at, 1, 0, 0);
    const real front = NEIGHBOUR(at, 0, -1, 0), back = NEIGHBOUR(at, 0, 1, 0);
    const real below = NEIGHBOUR(at, 0, 0, -1), above = NEIGHBOUR(at, 0, 0, 1);
    const real x = first_derivative(left, here, right, steps.x), y = first_derivative(front, here, back, steps.y);
    const real z = first_derivative(below, here, above, steps.z), size = fabs(x) + fabs(y) + fabs(z);
    Derivatives d;
    d.flat = size == 0.0f;
    const real scale = PICK(d.flat, 0.0f, 1.0f / size);
    d.first = make_real3(x * scale, y * scale, z * scale);
    d.second = make_real3(second_derivative(left, here, right, steps.x) * scale, second_derivative(front, here, back, steps.y) * scale,
                          second_derivative(below, here, above, steps.z) * scale);
    d.mixed = make_real3(mixed_derivative(at, BLOCK_ROW, steps.y, BLOCK_PLANE, steps.z) * scale,
                         mixed_derivative(at, 1, steps.x, BLOCK_PLANE, steps.z) * scale,
                         mixed_derivative(at, 1, steps.x, BLOCK_ROW, steps.y) * scale);
    return d;
}

// A curvature from its numerator and denominator: zero if the gradient is, and no larger than the grid resolves. NaN stays.
INLINED real make_curvature(const Derivatives *d, real numerator, real denominator, Resolution bound) {
    const real v = numerator / PICK(d->flat, 1.0f, denominator);
    return PICK(v > bound, bound, PICK(v < -bound, -bound, v));
}

// Half the divergence of the unit normal to lower values.
INLINED real mean_curvature(const Derivatives *d, Resolution bound) {
    const Real3 g = d->first, h = d->second, m = d->mixed;
    const real xx = g.x * g.x, yy = g.y * g.y, zz = g.z * g.z, square = xx + yy + zz;
    const real across = 2.0f * (g.y * g.z * m.x + g.x * g.z * m.y + g.x * g.y * m.z);
    const real along = xx * (h.y + h.z) + yy * (h.x + h.z) + zz * (h.x + h.y);
    return make_curvature(d, across - along, 2.0f * square * sqrt(square), bound);
}

// Product of the principal curvatures: the gradient between the adjugate of the Hessian matrix.
INLINED real gaussian_curvature(const Derivatives *d, Resolution bound) {
    const Real3 g = d->first, h = d->second, m = d->mixed;
    const real xx = g.x * g.x, yy = g.y * g.y, zz = g.z * g.z, square = xx + yy + zz;
    const real along = xx * (h.y * h.z - m.x * m.x) + yy * (h.x * h.z - m.y * m.y) + zz * (h.x * h.y - m.z * m.z);
    const real across = g.y * g.z * (m.y * m.z - h.x * m.x) + g.x * g.z * (m.x * m.z - h.y * m.y)
        + g.x * g.y * (m.x * m.y - h.z * m.z);
    return make_curvature(d, along + 2.0f * across, square * square, bound);
}

// Variance of the 3^3 samples, from differences to the one in the middle.
INLINED real local_variance(__local const float *at) {
    const real here = LOAD_LANES(at);
    real sum = 0.0f, squares = 0.0f;
    for (int z = -1; z <= 1; z++)
        for (int y = -1; y <= 1; y++)
            for (int x = -1; x <= 1; x++) {
                const real d = NEIGHBOUR(at, x, y, z) - here;
                sum += d;
                squares += d * d;
            }
    const real variance = (squares - sum * sum * (1.0f / 27.0f)) * (1.0f / 27.0f);
    return PICK(variance < 0.0f, 0.0f, variance);
}

// One derivative of a vector's component from the neighbours along an axis, `step` samples away.
INLINED real derivative(__local const float *at, int step, AxisStep along) {
    return usable_derivative(LOAD_LANES(at - step), LOAD_LANES(at), LOAD_LANES(at + step), along);
}

#ifdef UNEVEN
// Magnitude of a field's gradient; of even axes it is construct's.
INLINED real gradient_magnitude(__local const float *at, Steps steps) {
    const real here = LOAD_LANES(at);
    const real x = derivative(at, 1, steps.x), y = derivative(at, BLOCK_ROW, steps.y), z = derivative(at, BLOCK_PLANE, steps.z);
    return PICK(here == here, sqrt(x * x + y * y + z * z), NAN);
}
#endif

// Of t^3 - 3t - 2r the root that is apart from the others, between the root of 3 and 2, for r from 0 to 1: 2 cos(acos(r) / 3), which is smooth
// there. A polynomial by interpolation, off by 1e-7 at most, takes less than a few steps of Newton's method, which divide.
INLINED real root_apart(real r) {
#pragma OPENCL FP_CONTRACT ON
    real t = 0.00110735965f * r - 0.00592397386f;
    t = t * r + 0.0154376272f;
    t = t * r - 0.0286545940f;
    t = t * r + 0.0488116816f;
    t = t * r - 0.0961592942f;
    t = t * r + 0.333330393f;
    return t * r + 1.73205078f;
}

// The middle eigenvalue of a symmetric matrix with the rows (xx, xy, xz), (xy, yy, yz), (xz, yz, zz). The closed form alone loses half of the
// digits if two eigenvalues are near each other: here it finds the third one, and the matrix without that has the distance of the two.
INLINED real middle_eigenvalue(real xx, real yy, real zz, real xy, real xz, real yz) {
#pragma OPENCL FP_CONTRACT ON
    const real mean = (xx + yy + zz) * (1.0f / 3.0f);
    real x = xx - mean, y = yy - mean, z = zz - mean;
    // Scaled by a power of two, `unit`: products stay in range.
    const real size = (fabs(x) + fabs(y) + fabs(z)) + (fabs(xy) + fabs(xz) + fabs(yz));
    const integer exponent = min(AS_INT(size) & 0x7f800000, (integer)0x7e800000);
    const real unit = AS_REAL(exponent), scale = AS_REAL(0x7f000000 - exponent);
    x *= scale, y *= scale, z *= scale, xy *= scale, xz *= scale, yz *= scale;
    // Divided by the spread, the eigenvalues are roots t of t^3 - 3t - 2r.
    const real square = (x * x + y * y + z * z + 2.0f * (xy * xy + xz * xz + yz * yz)) * (1.0f / 6.0f);
    // The spread is 0.19 at least, or the matrix is 0.
    const real spread = sqrt(square), per = 1.0f / fmax(spread, 0.125f), per_square = per * per;
    const real r = 0.5f * per * per_square * (x * (y * z - yz * yz) + xy * (xz * yz - xy * z) + xz * (xy * yz - xz * y));
    const real t = root_apart(fmin(fabs(r), 1.0f)), apart = spread * PICK(r < 0.0f, -t, t);
    const real half_apart = 0.5f * apart;
    // The matrix p less `apart` has the adjugate (3 apart^2 - 3 spread^2) v v', v the eigenvector. Less 3/2 apart v v', and with half of `apart` on
    // the diagonal, p has the eigenvalues 0 and plus and minus half the distance of the other two: its squares sum up to twice that, squared.
    const real px = x - apart, py = y - apart, pz = z - apart, less = half_apart * per_square / (t * t - 1.0f);
    const real qx = (x + half_apart) - less * (py * pz - yz * yz), qy = (y + half_apart) - less * (px * pz - xz * xz);
    const real qz = (z + half_apart) - less * (px * py - xy * xy), q_xy = xy - less * (xz * yz - xy * pz);
    const real q_xz = xz - less * (xy * yz - xz * py), q_yz = yz - less * (xy * xz - yz * px);
    const real half_distance = sqrt(0.5f * (qx * qx + qy * qy + qz * qz) + (q_xy * q_xy + q_xz * q_xz + q_yz * q_yz));
    return mean + unit * (PICK(r < 0.0f, -half_distance, half_distance) - half_apart);
}

// The middle eigenvalue of the symmetric part of the square of a matrix of derivatives.
INLINED real lambda_2(Real3 u, Real3 v, Real3 w) {
#pragma OPENCL FP_CONTRACT ON
    const real xx = u.x * u.x + u.y * v.x + u.z * w.x, yy = u.y * v.x + v.y * v.y + v.z * w.y, zz = u.z * w.x + v.z * w.y + w.z * w.z;
    const real xy = 0.5f * ((u.x + v.y) * (u.y + v.x) + u.z * w.y + v.z * w.x);
    const real xz = 0.5f * ((u.x + w.z) * (u.z + w.x) + u.y * v.z + w.y * v.x);
    const real yz = 0.5f * ((v.y + w.z) * (v.z + w.y) + v.x * u.z + w.x * u.y);
    return middle_eigenvalue(xx, yy, zz, xy, xz, yz);
}

// A feature of a vector field from the blocks of its components, DERIVE_BLOCK apart. Each takes the derivatives that it needs alone.
INLINED real vector_feature(uint kind, __local const float *at, Steps steps) {
    __local const float *in_u = at, *in_v = at + DERIVE_BLOCK, *in_w = at + 2 * DERIVE_BLOCK;
    const real u = LOAD_LANES(in_u), v = LOAD_LANES(in_v), w = LOAD_LANES(in_w);
    if (kind == FEATURE_VECTOR_MAGNITUDE) return sqrt(u * u + v * v + w * w);
    real value, ux = 0.0f, vy = 0.0f, wz = 0.0f, uy = 0.0f, uz = 0.0f, vx = 0.0f, vz = 0.0f, wx = 0.0f, wy = 0.0f;
    if (kind != FEATURE_VORTICITY && kind != FEATURE_HELICITY) {
        ux = derivative(in_u, 1, steps.x);
        vy = derivative(in_v, BLOCK_ROW, steps.y);
        wz = derivative(in_w, BLOCK_PLANE, steps.z);
    }
    if (kind != FEATURE_DIVERGENCE) {
        uy = derivative(in_u, BLOCK_ROW, steps.y);
        uz = derivative(in_u, BLOCK_PLANE, steps.z);
        vx = derivative(in_v, 1, steps.x);
        vz = derivative(in_v, BLOCK_PLANE, steps.z);
        wx = derivative(in_w, 1, steps.x);
        wy = derivative(in_w, BLOCK_ROW, steps.y);
    }
    const real x = wy - vz, y = uz - wx, z = vx - uy; // the curl
    if (kind == FEATURE_DIVERGENCE) value = ux + vy + wz;
    else if (kind == FEATURE_VORTICITY) value = sqrt(x * x + y * y + z * z);
    else if (kind == FEATURE_HELICITY) value = u * x + v * y + w * z;
    else if (kind == FEATURE_LAMBDA_2) value = lambda_2(make_real3(ux, uy, uz), make_real3(vx, vy, vz), make_real3(wx, wy, wz));
    else value = -0.5f * (ux * ux + vy * vy + wz * wz) - (uy * vx + uz * wx + vz * wy);
    return PICK((u == u) & (v == v) & (w == w), value, NAN);
}

// A feature at samples. `at`: in the block of the field, or of the first component. Missing (NaN) if it is not finite.
INLINED real neighbourhood_feature(uint kind, __local const float *at, Steps steps) {
    const Resolution bound = resolution(steps);
    real value;
    if (kind >= FEATURE_VECTOR_MAGNITUDE) value = vector_feature(kind, at, steps);
    else if (kind == FEATURE_LOCAL_VARIANCE) value = local_variance(at);
#ifdef UNEVEN
    else if (kind == FEATURE_GRADIENT) value = gradient_magnitude(at, steps);
#endif
    else {
        const Derivatives d = make_derivatives(at, steps);
        value = kind == FEATURE_MEAN_CURVATURE ? mean_curvature(&d, bound) : gaussian_curvature(&d, bound * bound);
    }
    return PICK(fabs(value) <= FLT_MAX, value, NAN);
}

#endif
