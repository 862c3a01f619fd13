// The feature that the user blends into the importance (docs/algorithm.md#2-per-cell-quantities): its value at samples and its normalisation.
#ifndef ISOPEEL_FEATURE_H
#define ISOPEEL_FEATURE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/samples.h"

inline float normalised_feature(CutParams params, float f) {
    return clamp(exact_quotient(fabs(f) - params.feature_lo, params.feature_span), 0.0f, 1.0f);
}

// A derived feature at a sample: a case for each line of the list in `src/feature.rs`.
inline float derived_sample(Grid grid, SLAB, uint kind, int3 p) {
    switch (kind) {
        case FEATURE_GRADIENT: return length(gradient_at(grid, SLAB_ARGS, p));
        default: return NAN;
    }
}

// One component of the gradient at LANES samples, as gradient_component computes it. A missing or non-existent sample is NaN.
INLINED real gradient_in_lanes(real below, real here, real above, float spacing) {
    const integer has_below = below == below, has_above = above == above;
    const real step = PICK(has_below & has_above, 2.0f * spacing, spacing);
    const real d = (PICK(has_above, above, here) - PICK(has_below, below, here)) / step;
    return PICK(d == d, d, 0.0f);
}

// A derived feature at LANES samples, from their neighbours along each axis: as derived_sample.
INLINED real derived_in_lanes(uint kind, real here, Real3 below, Real3 above, float3 spacing) {
    switch (kind) {
        case FEATURE_GRADIENT: {
            const real x = gradient_in_lanes(below.x, here, above.x, spacing.x);
            const real y = gradient_in_lanes(below.y, here, above.y, spacing.y);
            const real z = gradient_in_lanes(below.z, here, above.z, spacing.z);
            return sqrt(x * x + y * y + z * z);
        }
        default: return NAN;
    }
}

#endif
