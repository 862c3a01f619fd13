// Importance of a node, and the conditions under which it may be decimated (docs/algorithm.md#4-importance-and-cut).
#ifndef ISOPEEL_IMPORTANCE_H
#define ISOPEEL_IMPORTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/grid.h"
#include "lib/interest.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"

inline float transfer(__constant float2 *points, uint count, float x) {
    uint right = 0;
    while (right < count && points[right].x <= x) right++;
    if (right == 0) return points[0].y;
    if (right == count) return points[count - 1].y;
    const float2 a = points[right - 1], b = points[right];
    return a.y + (b.y - a.y) * exact_quotient(x - a.x, b.x - a.x);
}

// The blended feature, which is the input of the transfer function, in [0, 1].
inline float blended_feature(CutParams params, float s, float f) {
    return (1.0f - params.alpha) * s + params.alpha * normalised_feature(params, f);
}

inline float importance(CutParams params, __constant float2 *points, float s, float f) {
    return transfer(points, params.points, blended_feature(params, s, f));
}

// Divides an error by the weight of an importance (docs/algorithm.md#43-the-cut-by-error).
#define MIN_WEIGHT (1.0f / 64.0f)
inline float error_over_weight(float error, float importance) {
    return exact_quotient(error, fmax(1.0f - importance, MIN_WEIGHT));
}

// Criterion of the cut for the nodes of a region.
typedef struct {
    CutParams params;
    __constant float2 *points; // of the transfer function
    __constant Interest *interests;
    float3 origin;  // of the region
    float3 last;    // sample of the volume
    float diagonal; // of a cell
} CutCriterion;

inline void find_criterion(CutCriterion *of, Grid grid, CutParams params, __constant float2 *points,
                            __constant Interest *interests, uint region) {
    of->params = params;
    of->points = points;
    of->interests = interests;
    of->origin = convert_float3(region_origin(grid, region));
    of->last = convert_float3((uint3)(grid.dims[0], grid.dims[1], grid.dims[2]) - 1);
    of->diagonal = sqrt(grid.spacing[0] * grid.spacing[0] + grid.spacing[1] * grid.spacing[1] + grid.spacing[2] * grid.spacing[2]);
}

// Importance of a node of level 1 or above. A region of interest counts if it meets the cube anywhere, so that no detail in it is lost.
inline float node_importance(const CutCriterion *of, Node node, uint level) {
    const float own = importance(of->params, of->points, node.s, node.f);
    if (of->params.interests == 0) return own;
    const float3 low = of->origin + convert_float3(unmorton(code_cell(meta_code(node.meta), level)));
    const float3 high = fmin(low + (float)(1u << level), of->last);
    return raise_importance(own, of->params.interests, of->interests, 0.5f * (low + high), 0.5f * (high - low));
}

// Error of a node of level 1 or above as the cut by error counts it. If all corners have one sign, the merge removes the surface between
// them, and so the cube's diagonal counts as well. `error`: of the node's vertex record.
inline float counted_error(const CutCriterion *of, Node node, uint level, float error) {
    const bool vanishes = of->params.by_error && meta_one_sign(node.meta);
    return vanishes ? error + of->diagonal * (float)(1u << level) : error;
}

// The error of a node is summed over the surface below it, as in the vertex tree: multiplied by the root of its area in squares of the
// spacing. A square has about three triangles of the full surface. A large cube moves more of the surface than a small one for one vertex less.
#define TRIANGLES_A_SQUARE 3.0f
inline float summed_error(Node node, float error) { return error * sqrt(fmax((float)node.count / TRIANGLES_A_SQUARE, 1.0f)); }

// The number that is compared with the threshold: importance, or error over weight. Not below 0. `error`: the counted one.
inline float decimation_key(const CutCriterion *of, Node node, uint level, float error) {
    const float own = node_importance(of, node, level);
    return fmax(of->params.by_error ? error_over_weight(summed_error(node, error), own) : own, 0.0f);
}

// Whether the maximum level and the guards allow a node of level 1 or above to be a leaf, if its importance does. `error`: the
// counted one.
inline bool may_decimate(CutParams params, Node node, uint level, float error) {
    return level <= params.max_level && (!params.preserve || meta_safe(node.meta)) && !(error > params.max_error);
}

#endif
