// Clusters of the vertex tree while it is built: their quadrics, where two of them merge and at what cost
// (docs/algorithm.md#7-vertex-tree).
#ifndef ISOPEEL_TREE_CLUSTER_H
#define ISOPEEL_TREE_CLUSTER_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/quadric.h"

#define BORDER_WEIGHT 1.0f         // of the planes at right angles to the border, by squared length of its edges
#define MERGE_PULL 0.003f         // weight of the pull towards the mean of a merged cluster's points, in parts of its area
#define MERGE_LENGTH_COST 1e-6f   // cost of an edge's squared length: of merges that cost nothing else, short ones come first

// TreeCluster::flags
#define CLUSTER_FIXED_AXES 7u // axes along which it may not move, one bit each: it lies on a face of the volume there
#define CLUSTER_BORDER 8u     // on the surface's border on the volume's faces
#define CLUSTER_LOCKED 16u    // beside missing samples, or where two fans meet: never merges

inline float3 cluster_position(__global const TreeCluster *cluster) {
    return (float3)(cluster->position[0], cluster->position[1], cluster->position[2]);
}

// Solves (A + w 1) x = r for a quadric's A, by L D L^T factors.
inline float3 solve_pulled(Quadric q, float w, float3 r) {
    const float d0 = exact_quotient(1.0f, q.a[0] + w), l10 = q.a[1] * d0, l20 = q.a[2] * d0;
    const float d1 = exact_quotient(1.0f, fmax(q.a[3] + w - l10 * q.a[1], w)), a21 = q.a[4] - l20 * q.a[1], l21 = a21 * d1;
    const float d2 = exact_quotient(1.0f, fmax(q.a[5] + w - l20 * q.a[2] - l21 * a21, w));
    const float y1 = r.y - l10 * r.x, y2 = r.z - l20 * r.x - l21 * y1;
    const float z = y2 * d2, y = y1 * d1 - l21 * z;
    return (float3)(r.x * d0 - l10 * y - l20 * z, y, z);
}

// Sum of weighted squared distances to the planes.
inline float quadric_sum(Quadric q, float3 x) {
    return fmax(dot(x, times_a(q, x)) - 2.0f * (q.b[0] * x.x + q.b[1] * x.y + q.b[2] * x.z) + q.c, 0.0f);
}

// Two clusters as one.
typedef struct {
    Quadric quadric; // from the first one's position
    float3 to;       // from there to the merged position
    float error;     // of the quadric at that position
    float cost;      // INFINITY where the two may not merge
} Merge;

// `a` before `b` in their block, so that the result has the same bits from both sides.
INLINED Merge merge_clusters(__global const TreeCluster *a, __global const TreeCluster *b) {
    const uint axes_a = a->flags & CLUSTER_FIXED_AXES, axes_b = b->flags & CLUSTER_FIXED_AXES, fixed = axes_a | axes_b;
    const float3 between = cluster_position(b) - cluster_position(a);
    Merge merge;
    merge.quadric = shift_quadric(b->quadric, -between);
    add_quadric(&merge.quadric, a->quadric);
    const Quadric q = merge.quadric;
    if (axes_a == axes_b) {
        const float3 mean = (float3)(q.m[0], q.m[1], q.m[2]) * exact_quotient(1.0f, fmax(q.k, 1e-30f));
        const float3 rest = (float3)(q.b[0], q.b[1], q.b[2]) - times_a(q, mean);
        merge.to = mean + solve_pulled(q, fmax(MERGE_PULL * q.k, 1e-30f), rest);
        if (fixed & 1u) merge.to.x = 0.0f;
        if (fixed & 2u) merge.to.y = 0.0f;
        if (fixed & 4u) merge.to.z = 0.0f;
    } else merge.to = fixed == axes_a ? (float3)(0.0f) : between;
    merge.error = quadric_sum(q, merge.to);
    const float cost = merge.error - a->quadric.c - b->quadric.c + MERGE_LENGTH_COST * dot(between, between) * q.k;
    const bool may_merge = !((a->flags | b->flags) & CLUSTER_LOCKED) && (fixed == axes_a || fixed == axes_b);
    merge.cost = may_merge ? fmax(cost, 0.0f) : INFINITY;
    return merge;
}

// Order of edges of equal cost: without it, whole planes would merge one pair after another.
inline uint edge_hash(uint a, uint b) {
    uint h = a * 0x9e3779b1u ^ b * 0x85ebca6bu;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    return h ^ h >> 12;
}

// Cells that a cluster's points lie in: low and high x, y, z, 5 bits each.
inline uint extent_of_cell(uint3 cell) {
    const uint packed = cell.x | cell.y << 5 | cell.z << 10;
    return packed | packed << 15;
}
inline uint join_extents(uint a, uint b) {
    uint joined = 0;
    for (uint i = 0; i < 30; i += 5) {
        const uint p = a >> i & 31u, q = b >> i & 31u;
        joined |= (i < 15 ? min(p, q) : max(p, q)) << i;
    }
    return joined;
}
// Level of the smallest cube that is as large.
inline uint extent_level(uint extent) {
    uint longest = 0;
    for (uint i = 0; i < 15; i += 5) longest = max(longest, (extent >> (i + 15) & 31u) - (extent >> i & 31u));
    return longest == 0 ? 0 : 32 - (uint)clz(longest);
}

#endif
