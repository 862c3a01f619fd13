// Vectors in world space.
#ifndef ISOPEEL_VECTOR_H
#define ISOPEEL_VECTOR_H

#include "lib/precision.h"

inline float3 unit_or_zero(float3 g) {
    // Scaled first, so that neither huge nor tiny values leave the range of a float when squared.
    const float largest = fmax(fmax(fabs(g.x), fabs(g.y)), fabs(g.z));
    // Differences of infinities are NaN, which fmax ignores.
    if (!(largest > 0.0f) || !all(isfinite(g))) return (float3)(0.0f);
    g /= largest;
    return g / sqrt(dot(g, g));
}

#endif
