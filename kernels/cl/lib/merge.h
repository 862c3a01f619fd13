// Whether a cube may replace the cells below it without a change of topology (docs/algorithm.md#41-guards).
#ifndef ISOPEEL_MERGE_H
#define ISOPEEL_MERGE_H

#include "lib/sheets.h"
#include "lib/tables.h"

// The 3x3x3 samples of a cube at half its size, 27 bits x + 3 y + 9 z. Eight of them are its corners.
inline uint corner_signs(uint samples27) {
    uint signs = 0;
    for (uint corner = 0; corner < 8; corner++)
        signs |= (samples27 >> (2 * (corner & 1) + 6 * (corner >> 1 & 1) + 18 * (corner >> 2)) & 1u) << corner;
    return signs;
}

// Whether no sample between a cube's corners has a sign that none of the corners next to it has
// (docs/algorithm.md#41-guards). All edges along an axis, and all faces across it, at once: a bit at the low corner of each.
inline bool safe_signs(uint samples27) {
    const uint steps[3] = {1, 3, 9};
    uint unlike = 0;
    for (uint axis = 0; axis < 3; axis++) {
        const uint a = steps[axis], b = steps[(axis + 1) % 3], c = steps[(axis + 2) % 3], s = samples27;
        const uint middle = s >> a, edges = 1u | 1u << (2 * b) | 1u << (2 * c) | 1u << (2 * b + 2 * c);
        unlike |= (middle ^ s) & (middle ^ s >> (2 * a)) & edges;
        const uint centre = s >> (b + c), faces = 1u | 1u << (2 * a);
        unlike |= (centre ^ s) & (centre ^ s >> (2 * b)) & (centre ^ s >> (2 * c)) & (centre ^ s >> (2 * b + 2 * c)) & faces;
    }
    const uint signs = corner_signs(samples27);
    return !unlike && signs != (samples27 >> 13 & 1u ? 0u : 255u) && sheet_count(SHEETS[signs]) == 1 && !JOINED[signs];
}

#endif
