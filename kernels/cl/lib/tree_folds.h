// Whether a merge of the vertex tree folds the surface, as the round's other merges leave it (docs/algorithm.md#7-vertex-tree).
#ifndef ISOPEEL_TREE_FOLDS_H
#define ISOPEEL_TREE_FOLDS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"
#include "lib/tree_rings.h"

#define MAX_FOLD 0.8f // minus the cosine between the normals of two triangles that share an edge

// Position of a cluster or of another region's point after this round's merges.
inline float3 merged_position(const TreeBlock *block, uint at) {
    return merges_here(block, at) ? block->merged_positions[at].xyz : end_position(block, at).xyz;
}

// Of two triangles with these normals, which share an edge, whether one folds back over the other.
inline bool folds_back(float3 a, float3 b) {
    const float product = dot(a, b);
    return product < 0.0f && product * product > MAX_FOLD * MAX_FOLD * dot(a, a) * dot(b, b);
}

// Whether two triangles around a merged cluster that share an edge fold back.
INLINED bool folds(const TreeBlock *block, uint a, const MergedRing *ring, uint count, bool open) {
    if (count == 0) return false;
    const float3 centre = merged_position(block, a);
    float3 first = (float3)(0.0f), before = (float3)(0.0f);
    float3 p = merged_position(block, merged_entry(ring, 0));
    for (uint i = 1; i < count + (open ? 0 : 1); i++) {
        const uint k = i < count ? i : 0;
        const float3 q = merged_position(block, merged_entry(ring, k));
        const float3 normal = cross(p - centre, q - centre);
        if (i == 1) first = normal;
        else if (folds_back(before, normal)) return true;
        before = normal;
        p = q;
    }
    return !open && folds_back(before, first);
}

#endif
