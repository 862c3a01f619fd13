// Keys of the vertex tree's nodes: the tolerance from which on a node is merged (tree_cut.cl). And their errors, which are the keys if
// all weights are 1: root of the summed squared distances to the planes, each by its area, over the smallest spacing.
#ifndef ISOPEEL_TREE_KEY_H
#define ISOPEEL_TREE_KEY_H

#include "lib/constants.h"
#include "lib/precision.h"
#include "lib/device.h"

// A packed key has KEY_SINGLE beside it; keys are 0 or more. As a number that is ordered as the keys are.
inline uint key_bits(uint packed) { return packed & ~KEY_SINGLE; }
// Triangles that the merge removes.
inline uint merged_triangles(uint packed) { return packed & KEY_SINGLE ? 1 : 2; }
// The lowest number of a key that the tolerance does not allow.
inline uint end_key(float tolerance) { return tolerance >= 0.0f ? as_uint(fabs(tolerance)) + 1 : 0; }
// The smallest power of four that is not below a number of 0 or more; of those below the smallest normal number that one. Exponents of
// powers of four are odd as a float has them.
inline float power_above(float x) { return as_float(((as_uint(x) - 0x00800000u + 0x00ffffffu) & 0xff000000u) + 0x00800000u); }
// Divides an error over weight by a further weight, that of regions. In steps it counts as the power of four above it, so that a slightly
// different weight rarely changes the cut. Above the guard no tolerance allows it.
inline float over_region_weight(float error, float weight, uint in_steps, float guard) {
    if (error > guard) return INFINITY;
    return exact_quotient(in_steps ? power_above(error) : error, weight);
}
inline float key_of(uint packed) { return as_float(key_bits(packed)); }

#endif
