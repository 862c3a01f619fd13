// Regions of interest, in which importance is raised (docs/algorithm.md#44-regions-of-interest).
#ifndef ISOPEEL_INTEREST_H
#define ISOPEEL_INTEREST_H

#include "lib/precision.h"
#include "lib/layout.h"

// Along one axis of a region of interest's own frame: the distance from its centre to a box, whose `middle` is seen from there.
inline float distance_along(__constant const float *row, float3 middle, float3 half_size) {
    const float at = row[0] * middle.x + row[1] * middle.y + row[2] * middle.z;
    const float reach = fabs(row[0]) * half_size.x + fabs(row[1]) * half_size.y + fabs(row[2]) * half_size.z;
    return fmax(fabs(at) - reach, 0.0f);
}

// Whether a box of cells meets a region of interest; if axes are turned, also true if it nearly does. A point is a box without size.
inline bool meets_interest(__constant Interest *interest, float3 middle, float3 half_size) {
    const float3 from_centre = middle - (float3)(interest->centre[0], interest->centre[1], interest->centre[2]);
    const float x = distance_along(interest->rows, from_centre, half_size);
    const float y = distance_along(interest->rows + 3, from_centre, half_size);
    const float z = distance_along(interest->rows + 6, from_centre, half_size);
    return interest->is_cube ? x <= 1.0f && y <= 1.0f && z <= 1.0f : x * x + y * y + z * z <= 1.0f;
}

// The maximum of an importance and those of the regions of interest that a box of cells meets.
inline float raise_importance(float importance, uint count, __constant Interest *interests, float3 middle, float3 half_size) {
    for (uint i = 0; i < count; i++) {
        const float raised = interests[i].importance;
        if (raised > importance && meets_interest(interests + i, middle, half_size)) importance = raised;
    }
    return importance;
}

#endif
