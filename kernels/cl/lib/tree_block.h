// The mesh of one block while its vertex tree is built: clusters, and around each of them a ring of neighbours.
//
// Clusters are numbered by what they begin with: in a region by its points (cells, extra sheets, then points on the volume's faces), in a
// block of a level above by the clusters that its blocks below have left. Points or clusters of other blocks do not merge here; in a ring
// they have FOREIGN beside their number in the whole surface.
//
// A *ring* has the neighbours counter-clockwise: around a cluster inside the surface each of them once, beginning anywhere, around one
// on the border from the first to the last. Locked clusters have none.
#ifndef ISOPEEL_TREE_BLOCK_H
#define ISOPEEL_TREE_BLOCK_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_cluster.h"

#define FOREIGN 0x80000000u
#define MAX_FAN 60       // triangles around a cluster that merges
#define MIN_TURN 0.5f    // cosine of the angle by which a triangle may turn
#define PENALTY 0.125f   // share of its second moment that a penalised merge costs

// Of a cost, beside the flags of tree_rounds.h: the bit of an edge whose merge turns or folds the surface, in a block where that only costs.
#define PENALISED 1u

typedef struct {
    __global TreeCluster *clusters;
    __global TreeMembers *members;
    __global float4 *positions;            // position in world units from the block's low corner; w: the flags' bits
    __global float4 *merged_positions;     // positions of clusters after this round's merges, as far as known
    __global uint *rings, *next_rings;     // of this round and the next one
    __global float *costs, *next_costs;    // beside a ring's entries: the cost of merging the two (tree_rounds.h)
    __global uint *alive;                  // remaining clusters, in order
    __global uint *best;                   // of each cluster its neighbour at the minimum cost; then the verdict of the pair test
    __global uint *partners;               // the one that it merges with, or NONE
    __global const int4 *points;           // positions of all points, or clusters, of the surface at the start
    int3 origin;                           // of the block
    float3 scale;                          // world units of 1/VERTEX_LATTICE cell
    uint alive_count;
    uint pair_count, new_count;            // of lists (tree_lists.h)
    bool is_soft;                          // merges that turn or fold the surface are not forbidden but cost more
#if WIDE_GROUP > 1
    uint new_first;                        // in `alive`
#endif
} TreeBlock;

inline float3 cluster_position(const TreeBlock *block, uint at) { return block->positions[at].xyz; }
inline uint cluster_flags(const TreeBlock *block, uint at) { return as_uint(block->positions[at].w); }

// Position of a cluster, or of another block's point or cluster.
inline float4 end_position(const TreeBlock *block, uint at) {
    if (!(at & FOREIGN)) return block->positions[at];
    return (float4)(convert_float3(block->points[at & ~FOREIGN].xyz - block->origin * (int)VERTEX_LATTICE) * block->scale, 0.0f);
}

// Where in the rings, and in their costs, a cluster has a neighbour.
inline uint ring_entry(const TreeBlock *block, uint at, uint neighbour) {
    const uint first = block->clusters[at].ring_first;
    return first + index_of(block->rings + first, neighbour);
}
// Cost of merging two neighbours; a failed one has its sign bit (tree_rounds.h).
inline float pair_cost(const TreeBlock *block, uint a, uint b) { return block->costs[ring_entry(block, a, b)]; }

// Triangles around a cluster.
inline uint fan_count(const TreeBlock *block, uint at) {
    return block->clusters[at].ring_count - (cluster_flags(block, at) & CLUSTER_BORDER ? 1 : 0);
}

inline float dot_plain(float3 a) { return a.x * a.x + a.y * a.y + a.z * a.z; }

// Triangles that may turn over, LANES at a time: two corners, the third one before and after the merge, and the column of its pair.
typedef struct {
    float4 p[LANES], q[LANES], from[LANES], to[LANES];
    uint pair[LANES];
    uint count;
} TurnBatch;

INLINED Real3 load_turn(const float4 *rows) {
    integer x, y, z, unused;
    load_vec4s((const int4 *)rows, &x, &y, &z, &unused);
    return make_real3(AS_REAL(x), AS_REAL(y), AS_REAL(z));
}

INLINED Real3 cross_from(Real3 p, Real3 q, Real3 from) { return cross_real3(minus_real3(p, from), minus_real3(q, from)); }

// Adds a share of the second moment of two clusters to the cost of their merge: of what the planes do not see.
INLINED float merge_penalty(const TreeBlock *block, uint a, uint b, float3 merged) {
    const uint first = min(a, b), second = max(a, b);
    const float3 to_first = merged - cluster_position(block, first), to_second = merged - cluster_position(block, second);
    return PENALTY * (block->clusters[first].quadric.k * dot_plain(to_first) + block->clusters[second].quadric.k * dot_plain(to_second));
}
inline bool is_penalised(float cost) { return as_uint(cost) & PENALISED; }
inline float penalised_cost(float cost, float penalty) { return as_float(as_uint(cost + penalty) | PENALISED); }

// Shift of the bits of pairs that turn a triangle past MIN_TURN, but by at most 90 degrees.
#define SOFT_SHIFT 16

// The columns of pairs one of whose triangles turns too far, a bit each: past 90 degrees, and from SOFT_SHIFT on, past MIN_TURN. Empties
// the batch.
INLINED uint failed_turns(TurnBatch *batch) {
    const uint count = batch->count;
    batch->count = 0;
    if (count == 0) return 0;
    for (uint i = count; i < LANES; i++) batch->p[i] = batch->q[i] = batch->from[i] = batch->to[i];
    const Real3 p = load_turn(batch->p), q = load_turn(batch->q);
    const Real3 before = cross_from(p, q, load_turn(batch->from)), after = cross_from(p, q, load_turn(batch->to));
    const real product = plain_dot(before, after);
    const integer turns = (product < 0.0f)
        | (product * product < MIN_TURN * MIN_TURN * plain_dot(before, before) * plain_dot(after, after));
    if (!any_lane(turns)) return 0;
    int lanes[LANES];
    float products[LANES];
    STORE_LANES(turns, lanes);
    STORE_LANES(product, products);
    uint pairs = 0;
    for (uint i = 0; i < count; i++) {
        const uint bits = lanes[i] ? 1u << SOFT_SHIFT | (products[i] < 0.0f ? 1u : 0) : 0;
        pairs |= bits << batch->pair[i];
    }
    return pairs;
}

// Adds the triangles around one of two clusters that merge at `to`, except the triangles of both. Returns pairs as failed_turns does.
INLINED uint collect_turns(const TreeBlock *block, TurnBatch *batch, uint own, uint other, float4 to, uint pair) {
    const float4 from = block->positions[own];
    const uint count = block->clusters[own].ring_count;
    __global const uint *ring = block->rings + block->clusters[own].ring_first;
    uint p = as_uint(from.w) & CLUSTER_BORDER ? other : ring[count - 1], failed = 0;
    float4 at_p = end_position(block, p);
    for (uint i = 0; i < count; i++) {
        const uint q = ring[i];
        const float4 at_q = end_position(block, q);
        const bool is_shared = (p == other) | (q == other);
        if (WIDE_GROUP == 1 || !is_shared) {
            const uint column = NEXT_COLUMN(batch);
            batch->p[column] = at_p;
            batch->q[column] = at_q;
            batch->from[column] = from;
            batch->to[column] = to;
            batch->pair[column] = pair;
            // Branch-free: the outcome is unpredictable.
            if (WIDE_GROUP == 1) batch->count -= is_shared;
            if (batch->count == LANES) failed |= failed_turns(batch);
        }
        p = q;
        at_p = at_q;
    }
    return failed;
}

// Whether merging keeps the surface's topology (the link condition: two common neighbours, on the border one). `a` before `b`.
INLINED bool keeps_topology(const TreeBlock *block, uint a, uint b) {
    const uint a_fan = fan_count(block, a), b_fan = fan_count(block, b);
    if (a_fan > MAX_FAN || b_fan > MAX_FAN) return false;
    const uint a_count = block->clusters[a].ring_count, b_count = block->clusters[b].ring_count;
    __global const uint *a_ring = block->rings + block->clusters[a].ring_first, *b_ring = block->rings + block->clusters[b].ring_first;
    const bool both_on_border = cluster_flags(block, a) & cluster_flags(block, b) & CLUSTER_BORDER;
    if (both_on_border && a_ring[0] != b && a_ring[a_count - 1] != b) return false;
    if (count_common(a_ring, a_count, b_ring, b_count) != (both_on_border ? 1u : 2u)) return false;
    const uint smallest = both_on_border ? 1 : 3; // the fans of a tetrahedron, and of a single triangle
    return a_fan != smallest || b_fan != smallest;
}

#endif
