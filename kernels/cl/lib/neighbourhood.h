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

// Rounds of rotations, which converge quadratically: a fourth changes no float any more.
#define LAMBDA_2_SWEEPS 4

// The neighbour so many samples further along x, y, z.
#define NEIGHBOUR(at, x, y, z) LOAD_LANES((at) + ((z) * BLOCK_PLANE + (y) * BLOCK_ROW + (x)))

// First and second derivatives of a field at samples, over the sum of the absolute first ones, which curvature does not depend on.
typedef struct {
    Real3 first;
    Real3 second; // xx, yy, zz
    Real3 mixed;  // yz, xz, xy
    integer flat; // the gradient is zero
} Derivatives;

// `per`: one over the spacing.
INLINED Derivatives make_derivatives(__local const float *at, float3 per) {
    const real here = LOAD_LANES(at);
    const real left = NEIGHBOUR(at, -1, 0, 0), right = NEIGHBOUR(at, 1, 0, 0);
    const real front = NEIGHBOUR(at, 0, -1, 0), back = NEIGHBOUR(at, 0, 1, 0);
    const real below = NEIGHBOUR(at, 0, 0, -1), above = NEIGHBOUR(at, 0, 0, 1);
    const real x = (right - left) * (0.5f * per.x), y = (back - front) * (0.5f * per.y), z = (above - below) * (0.5f * per.z);
    const real size = fabs(x) + fabs(y) + fabs(z);
    Derivatives d;
    d.flat = size == 0.0f;
    const real scale = PICK(d.flat, 0.0f, 1.0f / size);
    d.first = make_real3(x * scale, y * scale, z * scale);
    d.second = make_real3(((right - here) - (here - left)) * (per.x * per.x) * scale,
                          ((back - here) - (here - front)) * (per.y * per.y) * scale,
                          ((above - here) - (here - below)) * (per.z * per.z) * scale);
    const real yz = (NEIGHBOUR(at, 0, 1, 1) - NEIGHBOUR(at, 0, -1, 1)) - (NEIGHBOUR(at, 0, 1, -1) - NEIGHBOUR(at, 0, -1, -1));
    const real xz = (NEIGHBOUR(at, 1, 0, 1) - NEIGHBOUR(at, -1, 0, 1)) - (NEIGHBOUR(at, 1, 0, -1) - NEIGHBOUR(at, -1, 0, -1));
    const real xy = (NEIGHBOUR(at, 1, 1, 0) - NEIGHBOUR(at, -1, 1, 0)) - (NEIGHBOUR(at, 1, -1, 0) - NEIGHBOUR(at, -1, -1, 0));
    d.mixed = make_real3(yz * (0.25f * per.y * per.z) * scale, xz * (0.25f * per.x * per.z) * scale,
                         xy * (0.25f * per.x * per.y) * scale);
    return d;
}

// A curvature from its numerator and denominator: zero where the gradient is, and no larger than the grid resolves. NaN stays.
INLINED real make_curvature(const Derivatives *d, real numerator, real denominator, float bound) {
    const real v = numerator / PICK(d->flat, 1.0f, denominator);
    return PICK(v > bound, bound, PICK(v < -bound, -bound, v));
}

// Half the divergence of the unit normal to lower values.
INLINED real mean_curvature(const Derivatives *d, float bound) {
    const Real3 g = d->first, h = d->second, m = d->mixed;
    const real xx = g.x * g.x, yy = g.y * g.y, zz = g.z * g.z, square = xx + yy + zz;
    const real across = 2.0f * (g.y * g.z * m.x + g.x * g.z * m.y + g.x * g.y * m.z);
    const real along = xx * (h.y + h.z) + yy * (h.x + h.z) + zz * (h.x + h.y);
    return make_curvature(d, across - along, 2.0f * square * sqrt(square), bound);
}

// Product of the principal curvatures: the gradient between the adjugate of the Hessian matrix.
INLINED real gaussian_curvature(const Derivatives *d, float bound) {
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

// Derivatives of a vector's component along x, y, z, as gradient_at: one-sided beside a missing sample.
INLINED Real3 component_gradient(__local const float *at, float3 spacing) {
    const real here = LOAD_LANES(at);
    return make_real3(gradient_in_lanes(NEIGHBOUR(at, -1, 0, 0), here, NEIGHBOUR(at, 1, 0, 0), spacing.x),
                      gradient_in_lanes(NEIGHBOUR(at, 0, -1, 0), here, NEIGHBOUR(at, 0, 1, 0), spacing.y),
                      gradient_in_lanes(NEIGHBOUR(at, 0, 0, -1), here, NEIGHBOUR(at, 0, 0, 1), spacing.z));
}

// Matrix entries of one rotation of Jacobi's: [p][p], [q][q], [p][q], and the other two of rows p and q.
#define ROTATE(pp, qq, pq, rp, rq)                                                                                                    \
    {                                                                                                                                 \
        const real gap = (qq) - (pp), twice = 2.0f * (pq), size = fabs(gap) + sqrt(gap * gap + twice * twice);                        \
        const real t = PICK(size > 0.0f, PICK(gap < 0.0f, -twice, twice) / PICK(size > 0.0f, size, 1.0f), 0.0f);                      \
        const real c = 1.0f / sqrt(t * t + 1.0f), s = t * c, before = (rp);                                                           \
        (pp) -= t * (pq);                                                                                                             \
        (qq) += t * (pq);                                                                                                             \
        (pq) = 0.0f;                                                                                                                  \
        (rp) = c * before - s * (rq);                                                                                                 \
        (rq) = s * before + c * (rq);                                                                                                 \
    }

// The middle eigenvalue of the symmetric part of the square of a matrix of derivatives, by rotations: closed forms lose half of the digits
// where two eigenvalues are near each other.
INLINED real lambda_2(Real3 du, Real3 dv, Real3 dw) {
    const real size = fabs(du.x) + fabs(du.y) + fabs(du.z) + fabs(dv.x) + fabs(dv.y) + fabs(dv.z) + fabs(dw.x) + fabs(dw.y) + fabs(dw.z);
    const real scale = PICK(size > 0.0f, 1.0f / PICK(size > 0.0f, size, 1.0f), 0.0f);
    const Real3 u = make_real3(du.x * scale, du.y * scale, du.z * scale), v = make_real3(dv.x * scale, dv.y * scale, dv.z * scale);
    const Real3 w = make_real3(dw.x * scale, dw.y * scale, dw.z * scale);
    real xx = u.x * u.x + u.y * v.x + u.z * w.x, yy = u.y * v.x + v.y * v.y + v.z * w.y, zz = u.z * w.x + v.z * w.y + w.z * w.z;
    real xy = 0.5f * ((u.x + v.y) * (u.y + v.x) + u.z * w.y + v.z * w.x);
    real xz = 0.5f * ((u.x + w.z) * (u.z + w.x) + u.y * v.z + w.y * v.x);
    real yz = 0.5f * ((v.y + w.z) * (v.z + w.y) + v.x * u.z + w.x * u.y);
    ROLLED for (uint sweep = 0; sweep < LAMBDA_2_SWEEPS; sweep++) {
        ROTATE(xx, yy, xy, xz, yz)
        ROTATE(xx, zz, xz, xy, yz)
        ROTATE(yy, zz, yz, xy, xz)
    }
    const real low = PICK(xx < yy, xx, yy), high = PICK(xx < yy, yy, xx);
    const real middle = PICK(zz < low, low, PICK(zz > high, high, zz));
    return size * (size * middle);
}

// A feature of a vector field from the blocks of its components, DERIVE_BLOCK apart.
INLINED real vector_feature(uint kind, __local const float *at, float3 spacing) {
    const real u = LOAD_LANES(at), v = LOAD_LANES(at + DERIVE_BLOCK), w = LOAD_LANES(at + 2 * DERIVE_BLOCK);
    const real square = u * u + v * v + w * w;
    if (kind == FEATURE_VECTOR_MAGNITUDE) return sqrt(square);
    const Real3 du = component_gradient(at, spacing), dv = component_gradient(at + DERIVE_BLOCK, spacing);
    const Real3 dw = component_gradient(at + 2 * DERIVE_BLOCK, spacing);
    real value;
    if (kind == FEATURE_DIVERGENCE) value = du.x + dv.y + dw.z;
    else if (kind == FEATURE_VORTICITY) {
        const real x = dw.y - dv.z, y = du.z - dw.x, z = dv.x - du.y;
        value = sqrt(x * x + y * y + z * z);
    } else if (kind == FEATURE_HELICITY) value = u * (dw.y - dv.z) + v * (du.z - dw.x) + w * (dv.x - du.y);
    else if (kind == FEATURE_LAMBDA_2) value = lambda_2(du, dv, dw);
    else value = -0.5f * (du.x * du.x + dv.y * dv.y + dw.z * dw.z) - (du.y * dv.x + du.z * dw.x + dv.z * dw.y);
    return PICK((u == u) & (v == v) & (w == w), value, NAN);
}

// A feature at samples. `at`: in the block of the field, or of the first component. Missing, NaN, where it is not finite.
INLINED real neighbourhood_feature(uint kind, __local const float *at, float3 spacing) {
    const float3 per = 1.0f / spacing;
    const float bound = fmax(per.x, fmax(per.y, per.z));
    real value;
    if (kind >= FEATURE_VECTOR_MAGNITUDE) value = vector_feature(kind, at, spacing);
    else if (kind == FEATURE_LOCAL_VARIANCE) value = local_variance(at);
    else {
        const Derivatives d = make_derivatives(at, per);
        value = kind == FEATURE_MEAN_CURVATURE ? mean_curvature(&d, bound) : gaussian_curvature(&d, bound * bound);
    }
    return PICK(fabs(value) <= FLT_MAX, value, NAN);
}

#endif
