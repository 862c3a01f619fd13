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

// Position of a cluster, or of another block's, after this round's merges.
inline float3 merged_position(const TreeBlock *block, uint at) {
    return at & FOREIGN ? end_position(block, at).xyz : block->merged_positions[at].xyz;
}

// Of two triangles with these normals, which share an edge, whether one folds back over the other.
inline bool folds_back(float3 a, float3 b) {
    const float product = dot(a, b);
    return product < 0.0f && product * product > MAX_FOLD * MAX_FOLD * dot(a, a) * dot(b, b);
}

#if WIDE_GROUP == 1
// folds_back in lanes, of the triangles `before` and `after` the edge from `centre` to `at`.
INLINED integer fold_lanes(Real3 centre, Real3 before, Real3 at, Real3 after) {
    const Real3 a = cross_from(before, at, centre), b = cross_from(at, after, centre);
    const real product = plain_dot(a, b);
    return (product < 0.0f) & (product * product > MAX_FOLD * MAX_FOLD * plain_dot(a, a) * plain_dot(b, b));
}

// As `folds`, of a ring of up to LANES entries.
INLINED bool small_ring_folds(const TreeBlock *block, uint a, const MergedRing *ring, uint count, bool open) {
    // The ring's positions, the last one before them and the first one behind them.
    float x[LANES + 2], y[LANES + 2], z[LANES + 2];
    for (uint i = 0; i < count; i++) {
        const float3 p = merged_position(block, merged_entry(ring, i));
        x[i + 1] = p.x;
        y[i + 1] = p.y;
        z[i + 1] = p.z;
    }
    x[0] = x[count], y[0] = y[count], z[0] = z[count];
    x[count + 1] = x[1], y[count + 1] = y[1], z[count + 1] = z[1];
    const float3 p = merged_position(block, a);
    const Real3 centre = make_real3(p.x, p.y, p.z);
    const integer found = fold_lanes(centre, make_real3(LOAD_LANES(x), LOAD_LANES(y), LOAD_LANES(z)),
                                     make_real3(LOAD_LANES(x + 1), LOAD_LANES(y + 1), LOAD_LANES(z + 1)),
                                     make_real3(LOAD_LANES(x + 2), LOAD_LANES(y + 2), LOAD_LANES(z + 2)));
    const integer lane = LANE_INDEX;
    // On the border, no triangle is beyond the first and the last neighbour.
    const int first = open ? 1 : 0, end = (int)count - first;
    return any_lane(found & (lane >= first) & (lane < end));
}
#endif

// Whether two triangles around a merged cluster that share an edge fold back.
INLINED bool folds(const TreeBlock *block, uint a, const MergedRing *ring, uint count, bool open) {
    if (count == 0) return false;
#if WIDE_GROUP == 1
    if (count <= LANES) return small_ring_folds(block, a, ring, count, open);
#endif
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
