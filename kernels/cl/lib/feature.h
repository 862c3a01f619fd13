// The user's feature.
#ifndef ISOPEEL_FEATURE_H
#define ISOPEEL_FEATURE_H

#include "lib/grid.h"
#include "lib/layout.h"

inline float normalised_feature(CutParams params, float f) {
    return clamp(exact_quotient(fabs(f) - params.feature_lo, params.feature_span), 0.0f, 1.0f);
}

#endif
