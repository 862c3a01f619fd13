// Importance of a node and what may be decimated (docs/algorithm.md#4-importance-and-cut).
#ifndef ISOPEEL_IMPORTANCE_H
#define ISOPEEL_IMPORTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/layout.h"
#include "lib/node.h"

inline float transfer(__constant float2 *points, uint count, float x) {
    uint right = 0;
    while (right < count && points[right].x <= x) right++;
    if (right == 0) return points[0].y;
    if (right == count) return points[count - 1].y;
    const float2 a = points[right - 1], b = points[right];
    return a.y + (b.y - a.y) * exact_quotient(x - a.x, b.x - a.x);
}

inline float importance(CutParams params, __constant float2 *points, float s, float f) {
    const float x = (1.0f - params.alpha) * s + params.alpha * normalised_feature(params, f);
    return transfer(points, params.points, x);
}

// How far an error counts where the importance is this much (docs/algorithm.md#43-the-cut-by-error).
#define MIN_WEIGHT (1.0f / 64.0f)
inline float error_over_weight(float error, float importance) {
    return exact_quotient(error, fmax(1.0f - importance, MIN_WEIGHT));
}

// What is compared with the threshold: importance, or error over weight. Not below 0. `error`: of the node's vertex record.
inline float decimation_key(CutParams params, __constant float2 *points, Node node, float error) {
    const float own = importance(params, points, node.s, node.f);
    return fmax(params.by_error ? error_over_weight(error, own) : own, 0.0f);
}

// Whether the coarsest level and the guards let a node of level 1 or above be a leaf, where its importance does. `error`: of its
// vertex record.
inline bool may_decimate(CutParams params, Node node, uint level, float error) {
    return level <= params.max_level && (!params.preserve || meta_safe(node.meta)) && !(error > params.max_error);
}

#endif
