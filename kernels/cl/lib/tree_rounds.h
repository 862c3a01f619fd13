// A round of merges in a block of the vertex tree: each cluster's best edge, pairs that are each other's best, the pair test.
#ifndef ISOPEEL_TREE_ROUNDS_H
#define ISOPEEL_TREE_ROUNDS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/octahedral.h"
#include "lib/scan.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"
#include "lib/tree_folds.h"
#include "lib/tree_key.h"
#include "lib/tree_node.h"

// Computes the edges of the collected pairs, and writes each into the rings of both ends. Empties the batch.
INLINED void cost_batch(const TreeBlock *block, PairBatch *batch) {
    if (batch->count == 0) return;
    const Merges merges = merge_pairs(batch, block->clusters, block->positions);
    float x[LANES], y[LANES], z[LANES], cost[LANES];
    STORE_LANES(merges.from.x + merges.to.x, x);
    STORE_LANES(merges.from.y + merges.to.y, y);
    STORE_LANES(merges.from.z + merges.to.z, z);
    STORE_LANES(merges.cost, cost);
    for (uint i = 0; i < batch->count; i++)
        block->edges[batch->entry[i]] = block->edges[batch->mirror[i]] = (float4)(x[i], y[i], z[i], cost[i]);
    batch->count = 0;
}

// Whether a cluster is a point before the first round, or one that merged in the last round. No other edges than those of such
// clusters have changed.
inline bool is_new(const TreeBlock *block, uint at) { return block->partners[at] != NONE; }

// Computes the edges of new clusters.
INLINED void find_costs(const TreeBlock *block) {
    PairBatch batch;
    batch.count = 0;
    for (uint i = get_local_id(0); i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        if (!is_new(block, at)) continue;
        const uint first = block->clusters[at].ring_first, end = first + block->clusters[at].ring_count;
        for (uint entry = first; entry < end; entry++) {
            const uint other = block->rings[entry];
            if (other & FOREIGN || cluster_flags(block, other) & CLUSTER_LOCKED) {
                block->edges[entry].w = INFINITY;
                continue;
            }
            if (other < at && is_new(block, other)) continue;
            const uint column = collect_pair(&batch, at, other, entry), other_first = block->clusters[other].ring_first;
            batch.mirror[column] = other_first + ring_index(block->rings + other_first, at);
            if (batch.count == LANES) cost_batch(block, &batch);
        }
    }
    cost_batch(block, &batch);
}

// Best of the edges of a cluster that may merge; NONE where none may.
INLINED uint best_neighbour(const TreeBlock *block, uint at) {
    if ((cluster_flags(block, at) & CLUSTER_LOCKED) || fan_count(block, at) > MAX_FAN) return NONE;
    const uint first = block->clusters[at].ring_first, count = block->clusters[at].ring_count;
    ulong rejected = 0;
    for (;;) {
        uint best = NONE, best_edge = 0, best_hash = 0;
        float best_cost = INFINITY;
        for (uint k = 0; k < count; k++) {
            const float cost = block->edges[first + k].w;
            if (!(cost <= best_cost) || cost == INFINITY || (rejected >> k & 1ul)) continue;
            const uint other = block->rings[first + k], hash = edge_hash(min(at, other), max(at, other));
            if (cost == best_cost && best != NONE && (hash > best_hash || (hash == best_hash && other > best))) continue;
            best = other;
            best_edge = k;
            best_cost = cost;
            best_hash = hash;
        }
        if (best == NONE || may_merge(block, min(at, best), max(at, best), block->edges[first + best_edge].xyz)) return best;
        rejected |= 1ul << best_edge;
    }
}

// The cluster that stands for another one after this round's merges.
inline uint merged_corner(const TreeBlock *block, uint at) {
    if (at & FOREIGN) return at;
    const uint partner = block->partners[at];
    return partner < at ? partner : at; // NONE is above all
}

// The ring of two neighbours as one: that of `outer` with the ring of `inner` in its place, before this round's other merges.
typedef struct {
    uint outer_first, inner_first; // of the rings
    uint at;                       // index of `inner` in outer's ring
    uint inner_begin, inner_count; // index in inner's ring of what comes after `outer`
    uint count;
    bool open;
} JoinedRing;

INLINED JoinedRing join_rings(const TreeBlock *block, uint a) {
    const uint b = block->partners[a];
    const bool a_open = cluster_flags(block, a) & CLUSTER_BORDER, b_open = cluster_flags(block, b) & CLUSTER_BORDER;
    // Of a cluster inside and one on the border, the latter is the outer one.
    const uint outer = b_open && !a_open ? b : a, inner = outer == a ? b : a;
    JoinedRing ring;
    ring.outer_first = block->clusters[outer].ring_first;
    ring.inner_first = block->clusters[inner].ring_first;
    ring.inner_count = block->clusters[inner].ring_count;
    ring.at = ring_index(block->rings + ring.outer_first, inner);
    ring.inner_begin = ring_index(block->rings + ring.inner_first, outer) + 1;
    ring.count = block->clusters[outer].ring_count + ring.inner_count - 2;
    ring.open = a_open || b_open;
    return ring;
}

inline uint joined_entry(const TreeBlock *block, const JoinedRing *ring, uint i) {
    if (i < ring->at) return block->rings[ring->outer_first + i];
    const uint along = i - ring->at;
    if (along + 1 >= ring->inner_count) return block->rings[ring->outer_first + i + 2 - ring->inner_count];
    const uint at = ring->inner_begin + along;
    return block->rings[ring->inner_first + (at < ring->inner_count ? at : at - ring->inner_count)];
}

// What the pair test says of a pair.
#define GIVE_UP 1u   // in this round
#define SET_ASIDE 2u // until one of the two merges: it would choose itself in every round

// The pair test: merged neighbours that would meet along more than one line, clusters with too few triangles left, those that would
// close the border, and those that fold the surface are marked.
// Undoing a merge makes no other one fail: its neighbours keep more triangles, and meet along no more lines.
INLINED void test_pair(const TreeBlock *block, uint a) {
    const JoinedRing ring = join_rings(block, a);
    // The merged ring, in the two ranges that the two rings have in the next ones.
    const uint split = block->clusters[a].ring_count;
    __global uint *low = block->next_rings + block->clusters[a].ring_first;
    __global uint *high = block->next_rings + block->clusters[block->partners[a]].ring_first - split;
    const uint last = ring.count ? merged_corner(block, joined_entry(block, &ring, ring.count - 1)) : NONE;
    uint before = ring.open ? NONE : last, count = 0, begin = NONE;
    for (uint i = 0; i < ring.count; i++) {
        const uint other = merged_corner(block, joined_entry(block, &ring, i));
        if (other == before) continue;
        *(count < split ? low + count : high + count) = before = other;
        if (count++ == 0) begin = other;
    }
    // On the border, the first and the last neighbour are the same where it has closed.
    if (ring.open ? before == begin : count < 3) or_global(block->best + a, GIVE_UP);
    for (uint i = 0; i < count; i++) {
        const uint other = *(i < split ? low + i : high + i);
        if (!merges_here(block, other)) continue;
        for (uint k = i + 1; k < count; k++) {
            if (*(k < split ? low + k : high + k) != other) continue;
            // Where the border has closed, only this cluster is at fault.
            if (ring.open && i == 0 && k == count - 1) continue;
            or_global(block->best + a, GIVE_UP);
            or_global(block->best + other, GIVE_UP);
        }
    }
    if (folds(block, a, low, high, split, count, ring.open)) or_global(block->best + a, SET_ASIDE);
}

// Pairs the clusters that are each other's best, but for those that fail the pair test.
INLINED void find_pairs(const TreeBlock *block) {
    const uint lid = get_local_id(0);
    __global uint *best = block->best, *partners = block->partners;
    find_costs(block);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) best[block->alive[i]] = best_neighbour(block, block->alive[i]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i], other = best[at];
        partners[at] = other != NONE && best[other] == at ? other : NONE;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) best[block->alive[i]] = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        if (partners[at] != NONE && partners[at] > at) test_pair(block, at);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        if (!best[at]) continue;
        if (best[at] & SET_ASIDE) set_edge_aside(block, at, partners[at]);
        partners[partners[at]] = NONE;
        partners[at] = NONE;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Where the nodes of a block go.
typedef struct {
    __global TreeNode *nodes;
    __global uint *node_errors;   // as keys (tree_key.h)
    __global uchar *node_levels;  // as in TreeNode
    __global uint *node_parents;
    __global uint *point_parents; // of the points of cells and sheets, then of those on the volume's faces
    __global uint *border_parents;
    uint cell_points;             // how many points of cells and sheets
    uint region;
    uint node_base;
    int3 low, high;               // range of positions, 1/VERTEX_LATTICE cell from the region's low corner
    float per_length;             // 1 / smallest spacing
} TreeOutput;

// Replaces a cluster by itself and its partner merged, node number `index`; its ring is made later.
INLINED void commit_merge(const TreeBlock *block, const TreeOutput *out, uint a, Quadric quadric, float3 merged, uint index) {
    __global TreeCluster *first = block->clusters + a;
    const uint b = block->partners[a];
    __global TreeMembers *own = block->members + a, *other = block->members + b;
    const uint first_flags = cluster_flags(block, a), second_flags = cluster_flags(block, b);
    const float3 from = cluster_position(block, a);
    const int3 at = clamp(convert_int3_rte(merged / block->scale), out->low, out->high);
    const float3 to = convert_float3(at) * block->scale;
    quadric = shift_quadric(quadric, to - from);
    quadric.c = fmax(quadric.c, 0.0f);
    first->quadric = quadric;
    for (uint side = 0; side < 2; side++) {
        const uint point = side ? b : a, node = side ? other->node : own->node;
        if (node != NONE) out->node_parents[node] = index;
        else if (point < out->cell_points) out->point_parents[point] = index;
        else out->border_parents[point - out->cell_points] = index;
    }
    for (uint i = 0; i < 3; i++) own->normal[i] += other->normal[i];
    own->s += other->s;
    own->f += other->f;
    own->extent = join_extents(own->extent, other->extent);
    own->node = index;
    const float per_area = exact_quotient(1.0f, fmax(quadric.k, 1e-30f));
    TreeNode node;
    pack_tree_position(&node, at);
    node.normal_s = encode_octahedral8((float3)(own->normal[0], own->normal[1], own->normal[2]))
        | (uint)(clamp(own->s * per_area, 0.0f, 1.0f) * 65535.0f + 0.5f) << 16;
    node.f = own->f * per_area;
    const uint border = (first_flags | second_flags) & CLUSTER_BORDER ? 1 : 0;
    node.meta = extent_level(own->extent) | border << 3 | out->region << 6;
    out->nodes[index] = node;
    out->node_errors[index] = as_uint(sqrt(quadric.c) * out->per_length) | (first_flags & second_flags & CLUSTER_BORDER ? KEY_SINGLE : 0);
    out->node_levels[index] = (uchar)tree_level(node.meta);
    out->node_parents[index] = NONE;
    // The flags become those of both with the ring.
    block->positions[a].xyz = to;
}

// Commits the collected pairs. Empties the batch.
INLINED void commit_batch(const TreeBlock *block, const TreeOutput *out, PairBatch *batch) {
    if (batch->count == 0) return;
    const Merges merges = merge_pairs(batch, block->clusters, block->positions);
    const Quadrics q = merges.quadrics;
    float rows[17 * LANES];
    STORE_LANES(q.axx, rows);
    STORE_LANES(q.axy, rows + LANES);
    STORE_LANES(q.axz, rows + 2 * LANES);
    STORE_LANES(q.ayy, rows + 3 * LANES);
    STORE_LANES(q.ayz, rows + 4 * LANES);
    STORE_LANES(q.azz, rows + 5 * LANES);
    STORE_REAL3(q.b, rows + 6 * LANES, LANES)
    STORE_LANES(q.c, rows + 9 * LANES);
    STORE_REAL3(q.m, rows + 10 * LANES, LANES)
    STORE_LANES(q.k, rows + 13 * LANES);
    const Real3 to = make_real3(merges.from.x + merges.to.x, merges.from.y + merges.to.y, merges.from.z + merges.to.z);
    STORE_REAL3(to, rows + 14 * LANES, LANES)
    for (uint i = 0; i < batch->count; i++) {
        Quadric quadric;
        for (uint k = 0; k < 6; k++) quadric.a[k] = rows[k * LANES + i];
        for (uint k = 0; k < 3; k++) {
            quadric.b[k] = rows[(6 + k) * LANES + i];
            quadric.m[k] = rows[(10 + k) * LANES + i];
        }
        quadric.c = rows[9 * LANES + i];
        quadric.k = rows[13 * LANES + i];
        const float3 merged = (float3)(rows[14 * LANES + i], rows[15 * LANES + i], rows[16 * LANES + i]);
        commit_merge(block, out, batch->first[i], quadric, merged, batch->entry[i]);
    }
    batch->count = 0;
}

// Makes the nodes of this round's pairs, in order of their clusters. Returns how many.
INLINED uint commit_pairs(const TreeBlock *block, const TreeOutput *out, uint node_count, __local uint *scratch) {
    PairBatch batch;
    batch.count = 0;
    uint merged = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += WIDE_GROUP) {
        const uint i = begin + get_local_id(0);
        const uint at = i < block->alive_count ? block->alive[i] : 0;
        const bool is_first = i < block->alive_count && block->partners[at] != NONE && block->partners[at] > at;
        const uint rank = merged + scan_group(scratch, is_first, &total);
        if (is_first) collect_pair(&batch, at, block->partners[at], out->node_base + node_count + rank);
        if (batch.count == LANES) commit_batch(block, out, &batch);
        merged += total;
    }
    commit_batch(block, out, &batch);
    barrier(CLK_GLOBAL_MEM_FENCE);
    return merged;
}

// Writes the ring of a cluster that did not merge, its neighbours merged, from `to` on. Returns how many entries it has.
INLINED uint renew_ring(const TreeBlock *block, uint at, uint to) {
    const uint first = block->clusters[at].ring_first, ring_count = block->clusters[at].ring_count;
    const bool open = cluster_flags(block, at) & CLUSTER_BORDER;
    uint count = 0, before = open || !ring_count ? NONE : merged_corner(block, block->rings[first + ring_count - 1]);
    for (uint i = 0; i < ring_count; i++) {
        const uint neighbour = block->rings[first + i], other = merged_corner(block, neighbour);
        if (other == before) continue;
        block->next_rings[to + count] = before = other;
        block->next_edges[to + count++] = block->edges[first + i];
    }
    return count;
}

// The same of a cluster that did.
INLINED uint merge_rings(const TreeBlock *block, const JoinedRing *ring, uint to) {
    uint count = 0, before = ring->open ? NONE : merged_corner(block, joined_entry(block, ring, ring->count - 1));
    for (uint i = 0; i < ring->count; i++) {
        const uint other = merged_corner(block, joined_entry(block, ring, i));
        if (other == before) continue;
        block->next_rings[to + count++] = before = other;
    }
    return count;
}

// Makes the next round's rings, and drops the clusters that are merged into others.
INLINED void compact_block(TreeBlock *block, __local uint *scratch) {
    const uint lid = get_local_id(0);
    uint kept = 0, entries = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += WIDE_GROUP) {
        const bool is_there = begin + lid < block->alive_count;
        const uint at = is_there ? block->alive[begin + lid] : 0, partner = is_there ? block->partners[at] : 0;
        const bool is_kept = is_there && partner > at; // NONE is above all
        uint capacity = 0;
        if (is_kept) capacity = block->clusters[at].ring_count + (partner != NONE ? block->clusters[partner].ring_count - 2 : 0);
        const uint to = entries + scan_group(scratch, capacity, &total);
        entries += total;
        // Also the barrier between reading and writing.
        const uint rank = kept + scan_group(scratch, is_kept, &total);
        barrier(CLK_GLOBAL_MEM_FENCE);
        kept += total;
        if (is_kept) {
            block->best[at] = to;
            block->alive[rank] = at;
        }
    }
    block->alive_count = kept;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < kept; i += WIDE_GROUP) {
        const uint at = block->alive[i], to = block->best[at];
        uint count;
        if (block->partners[at] == NONE) count = renew_ring(block, at, to);
        else {
            const JoinedRing ring = join_rings(block, at);
            count = merge_rings(block, &ring, to);
            block->positions[at].w = as_float(cluster_flags(block, at) | cluster_flags(block, block->partners[at]));
        }
        block->clusters[at].ring_first = to;
        block->clusters[at].ring_count = count;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    __global uint *rings = block->rings;
    __global float4 *edges = block->edges;
    block->rings = block->next_rings;
    block->edges = block->next_edges;
    block->next_rings = rings;
    block->next_edges = edges;
}

#endif
