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
#include "lib/tree_key.h"
#include "lib/tree_lists.h"
#include "lib/tree_node.h"
#include "lib/tree_pair_test.h"
#include "lib/tree_rings.h"

// Computes the costs of the collected pairs, and writes each beside both ends' rings. Empties the batch.
INLINED void cost_batch(const TreeBlock *block, PairBatch *batch) {
    if (batch->count == 0) return;
    float cost[LANES];
    // The sign bit holds a flag.
    STORE_LANES(fabs(merge_pairs(batch, block->clusters, block->positions).cost), cost);
    for (uint i = 0; i < batch->count; i++) {
        const uint other = batch->other[i], at = batch->first[i] ^ batch->second[i] ^ other;
        if (block->is_soft) cost[i] = as_float(as_uint(cost[i]) & ~PENALISED);
        block->costs[batch->entry[i]] = cost[i];
        if (block->clusters[other].ring_count == 0) continue; // a locked one
        const uint first = block->clusters[other].ring_first;
        block->costs[first + index_of(block->rings + first, at)] = cost[i];
    }
    batch->count = 0;
}

#if WIDE_GROUP == 1
// Collects the edges of a new cluster, MORE_COLUMNS entries of its ring at a time, so that the number of steps varies little.
INLINED void collect_edges(const TreeBlock *block, PairBatch *batch, uint at) {
    const uint first = block->clusters[at].ring_first, end = first + block->clusters[at].ring_count;
    for (uint begin = first; begin < end; begin += MORE_COLUMNS) {
        for (uint k = 0; k < MORE_COLUMNS; k++) {
            const uint entry = begin + k, neighbour = entry < end ? block->rings[entry] : FOREIGN;
            const uint other = neighbour & FOREIGN ? at : neighbour, column = collect_pair(batch, at, other, entry);
            batch->other[column] = other;
            // Branch-free: the outcome is unpredictable.
            batch->count -= (other == at) | ((other < at) & has_partner(block, other));
        }
        if (batch->count < LANES) continue;
        const uint rest = batch->count - LANES;
        batch->count = LANES;
        cost_batch(block, batch);
        vstore8(vload8(0, batch->first + LANES), 0, batch->first);
        vstore8(vload8(0, batch->second + LANES), 0, batch->second);
        vstore8(vload8(0, batch->entry + LANES), 0, batch->entry);
        vstore8(vload8(0, batch->other + LANES), 0, batch->other);
        batch->count = rest;
    }
}
#else
INLINED void collect_edges(const TreeBlock *block, PairBatch *batch, uint at) {
    const uint first = block->clusters[at].ring_first, end = first + block->clusters[at].ring_count;
    for (uint entry = first; entry < end; entry++) {
        const uint other = block->rings[entry];
        if (other & FOREIGN || (other < at && has_partner(block, other))) continue;
        const uint column = collect_pair(batch, at, other, entry);
        batch->other[column] = other;
        cost_batch(block, batch);
    }
}
#endif

// Computes the costs of new clusters: points before the first round, or clusters that merged in the last round. No other costs have
// changed.
INLINED void find_costs(const TreeBlock *block) {
    PairBatch batch;
    batch.count = 0;
    for (uint i = get_local_id(0); i < block->new_count; i += WIDE_GROUP) collect_edges(block, &batch, new_list(block)[i]);
    cost_batch(block, &batch);
}

// Bits of a cost that a pair has failed with: it may not merge in this round.
#define FAILED 0x80000000u
#define NO_COST 0x7f800000u // bits of INFINITY

// The neighbour at the minimum cost of those that may merge, as far as is known; NONE if there is none.
INLINED uint best_neighbour(const TreeBlock *block, uint at) {
    const uint first = block->clusters[at].ring_first, count = block->clusters[at].ring_count;
    __global const uint *costs = (__global const uint *)block->costs + first;
    const uint minimum = index_of_minimum(costs, count, NO_COST);
    if (minimum != AMBIGUOUS) return minimum == NONE ? NONE : block->rings[first + minimum];
    uint best = NONE, best_hash = 0, best_cost = NO_COST;
    for (uint k = 0; k < count; k++) {
        const uint cost = costs[k];
        if (cost > best_cost || cost == NO_COST) continue;
        const uint other = block->rings[first + k], hash = edge_hash(min(at, other), max(at, other));
        if (cost == best_cost && (hash > best_hash || (hash == best_hash && other > best))) continue;
        best = other;
        best_cost = cost;
        best_hash = hash;
    }
    return best;
}

// Tests the collected pairs and writes the positions of their merges. Returns the columns of the pairs that may not merge, a bit each, and
// from SOFT_SHIFT on, those that only turn a triangle past MIN_TURN.
INLINED uint failed_pairs(const TreeBlock *block, PairBatch *batch) {
    const Merges merges = merge_pairs(batch, block->clusters, block->positions);
    float x[LANES], y[LANES], z[LANES];
    STORE_LANES(merges.from.x + merges.to.x, x);
    STORE_LANES(merges.from.y + merges.to.y, y);
    STORE_LANES(merges.from.z + merges.to.z, z);
    TurnBatch turns;
    turns.count = 0;
    uint failed = 0;
    for (uint i = 0; i < batch->count; i++) {
        const uint a = batch->first[i], b = batch->second[i];
        if (!keeps_topology(block, a, b)) {
            failed |= (1u << SOFT_SHIFT | 1u) << i;
            continue;
        }
        const float4 to = (float4)(x[i], y[i], z[i], 0.0f);
        block->merged_positions[a] = block->merged_positions[b] = to;
        failed |= collect_turns(block, &turns, a, b, to, i);
        failed |= collect_turns(block, &turns, b, a, to, i);
    }
    return failed | failed_turns(&turns);
}

// Adds the penalty to the cost of an edge, beside both ends' rings.
INLINED void penalise_edge(const TreeBlock *block, uint a, uint b) {
    const float cost = penalised_cost(pair_cost(block, a, b), merge_penalty(block, a, b, block->merged_positions[a].xyz));
    block->costs[ring_entry(block, a, b)] = cost;
    block->costs[ring_entry(block, b, a)] = cost;
}

// Whether a tested pair is not to merge now; `turns_far`, `fails`: from failed_pairs.
#define CHOOSES_AGAIN FOREIGN // beside a listed cluster: its edge has not failed, but has another cost
INLINED bool is_refused(const TreeBlock *block, uint a, uint b, bool fails, bool turns_far, uint *flag) {
    *flag = 0;
    if (fails || !turns_far) return fails;
    if (!block->is_soft) return true;
    if (is_penalised(pair_cost(block, a, b))) return false;
    penalise_edge(block, a, b);
    *flag = CHOOSES_AGAIN;
    return true;
}

// Makes partners of the collected pairs that may merge, and lists the clusters of the others. Empties the batch.
INLINED void test_batch(const TreeBlock *block, PairBatch *batch, __global uint *failed, __local uint *failed_count) {
    if (batch->count == 0) return;
    const uint fails = failed_pairs(block, batch);
    for (uint i = 0; i < batch->count; i++) {
        const uint a = batch->first[i], b = batch->second[i];
        uint flag;
        if (is_refused(block, a, b, fails >> i & 1u, fails >> (i + SOFT_SHIFT) & 1u, &flag)) {
            const uint at = add_local(failed_count, 2);
            failed[at] = a | flag;
            failed[at + 1] = b | flag;
            block->merged_positions[a] = block->positions[a];
            block->merged_positions[b] = block->positions[b];
        } else {
            write_shared(block->partners + a, b);
            write_shared(block->partners + b, a);
        }
    }
    batch->count = 0;
}

// Whether a cluster on the list of a pass must test the pair with its best neighbour: if both have chosen each other. If both are on the
// list, only the first one tests; it may just have become the other's partner.
INLINED bool tests_best(const TreeBlock *block, uint at, uint pass) {
    const uint other = block->best[at];
#if WIDE_GROUP == 1
    // Branch-free. No cluster is its own best neighbour.
    if (pass == 0) return (other > at) & (block->best[other == NONE ? at : other] == at);
#endif
    if (other == NONE || block->best[other] != at) return false;
    if (other > at) return true;
    if (pass == 0) return false;
    const uint of_other = read_shared(block->partners + other);
    return of_other != (FOREIGN | pass) && of_other != at;
}

// A pass of choose_partners: tests the pairs of clusters on a list that have chosen each other. `counts`: of the clusters in `failed`, and on a
// GPU of the pairs.
INLINED void test_pass(const TreeBlock *block, __global const uint *list, uint count, uint pass, __global uint *failed,
                       __local uint *counts) {
    PairBatch batch;
    batch.count = 0;
#if WIDE_GROUP == 1
    for (uint i = 0; i < count; i++) {
        const uint at = list[i];
        collect_pair(&batch, at, block->best[at], 0);
        // Branch-free: the outcome is unpredictable.
        batch.count -= !tests_best(block, at, pass);
        if (batch.count == LANES) test_batch(block, &batch, failed, counts);
    }
    test_batch(block, &batch, failed, counts);
#else
    // Behind the clusters that have failed.
    __global uint *pairs = (__global uint *)block->next_costs + block->alive_count;
    for (uint i = get_local_id(0); i < count; i += WIDE_GROUP)
        if (tests_best(block, list[i], pass)) pairs[add_local(counts + 1, 1)] = list[i];
    barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < counts[1]; i += WIDE_GROUP) {
        collect_pair(&batch, pairs[i], block->best[pairs[i]], 0);
        test_batch(block, &batch, failed, counts);
    }
#endif
}

// Makes partners of clusters that are each other's best neighbour and may merge. A pair is tested once both have chosen each other. If it
// fails, both choose again, until no pair fails.
INLINED void choose_partners(const TreeBlock *block, __local uint *counts) {
    const uint lid = get_local_id(0);
    __global uint *best = block->best, *partners = block->partners;
    for (uint i = lid; i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        best[at] = best_neighbour(block, at);
        partners[at] = NONE;
    }
    __global const uint *list = block->alive;
    uint count = block->alive_count;
    // Of the clusters on the list, `partners` is the pass with FOREIGN beside it.
    for (uint pass = 0; count > 0; pass++) {
        if (lid == 0) counts[0] = counts[1] = 0;
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        __global uint *failed = pass & 1 ? (__global uint *)block->next_costs : block->next_rings;
        test_pass(block, list, count, pass, failed, counts);
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        count = counts[0];
        for (uint i = lid; i < count; i += WIDE_GROUP) {
            const uint at = failed[i] & ~CHOOSES_AGAIN;
            if (failed[i] == at) ((__global uint *)block->costs)[ring_entry(block, at, best[at])] |= FAILED;
            failed[i] = at;
        }
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        for (uint i = lid; i < count; i += WIDE_GROUP) {
            best[failed[i]] = best_neighbour(block, failed[i]);
            partners[failed[i]] = FOREIGN | (pass + 1);
        }
        list = failed;
    }
}

// Pairs the clusters that are each other's best, except those that fail the pair test.
INLINED void find_pairs(TreeBlock *block, __local uint *scratch, __local uint *counts) {
    find_costs(block);
    barrier(CLK_GLOBAL_MEM_FENCE);
    choose_partners(block, counts);
    barrier(CLK_GLOBAL_MEM_FENCE);
    list_pairs(block, scratch);
    for (uint i = get_local_id(0); i < block->pair_count; i += WIDE_GROUP) test_pair(block, pair_list(block)[i]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    settle_pairs(block, scratch);
}

// Output buffers of a block's nodes.
typedef struct {
    __global TreeNode *nodes;
    __global uint *node_errors;   // as keys (tree_key.h)
    __global uchar *node_levels;  // as in TreeNode
    __global uint *node_parents;
    __global uint *cluster_parents; // of what the block began with
    uint region, level;
    uint node_base;
    int3 low, high;                 // range of positions, 2^level/VERTEX_LATTICE cell from the block's low corner
    float3 step;                    // world units of that
    float per_length;               // 1 / smallest spacing
} TreeOutput;

// Replaces a cluster by itself and its partner merged at `at`, node number `index`; its ring is made later.
INLINED void commit_merge(const TreeBlock *block, const TreeOutput *out, uint a, Quadric quadric, int3 at, uint index) {
    __global TreeCluster *first = block->clusters + a;
    const uint b = block->partners[a];
    __global TreeMembers *own = block->members + a, *other = block->members + b;
    const uint first_flags = cluster_flags(block, a), second_flags = cluster_flags(block, b);
    first->quadric = quadric;
    for (uint side = 0; side < 2; side++) {
        const uint node = side ? other->node : own->node;
        *(node != NONE ? out->node_parents + node : out->cluster_parents + (side ? b : a)) = index;
    }
    for (uint i = 0; i < 3; i++) own->normal[i] += other->normal[i];
    own->s += other->s;
    own->f += other->f;
    own->extent = join_extents(own->extent, other->extent);
    own->node = index;
    const float per_area = exact_quotient(1.0f, fmax(quadric.k, 1e-30f));
    TreeNode node;
    const float rms = sqrt(exact_quotient(quadric.c, fmax(quadric.k, 1e-30f))) * out->per_length;
    pack_tree_position(&node, at, 0.5f * rms, out->level);
    node.normal_s = encode_octahedral8((float3)(own->normal[0], own->normal[1], own->normal[2]))
        | (uint)(clamp(own->s * per_area, 0.0f, 1.0f) * 65535.0f + 0.5f) << 16;
    node.f = own->f * per_area;
    const uint border = (first_flags | second_flags) & CLUSTER_BORDER ? NODE_BORDER : 0;
    node.meta = min(extent_level(own->extent) + out->level, MAX_CUBE_LEVEL) | border | out->region << 6;
    out->nodes[index] = node;
    out->node_errors[index] = as_uint(sqrt(quadric.c) * out->per_length) | (first_flags & second_flags & CLUSTER_BORDER ? KEY_SINGLE : 0);
    out->node_levels[index] = (uchar)tree_level(node.meta);
    out->node_parents[index] = NONE;
    // The flags become those of both with the ring.
    const float3 to = convert_float3(at) * out->step;
    block->positions[a].xyz = to;
    block->merged_positions[a].xyz = to;
}

// The whole number of the vertex lattice that is nearest to a coordinate.
INLINED real lattice_coordinate(real merged, float scale, int low, int high) {
    return fmin(fmax(rint(merged / scale), (real)(float)low), (real)(float)high);
}

// Commits the collected pairs. Empties the batch.
INLINED void commit_batch(const TreeBlock *block, const TreeOutput *out, PairBatch *batch) {
    if (batch->count == 0) return;
    const Merges merges = merge_pairs(batch, block->clusters, block->positions);
    const float3 scale = out->step;
    const Real3 at = make_real3(lattice_coordinate(merges.from.x + merges.to.x, scale.x, out->low.x, out->high.x),
                                lattice_coordinate(merges.from.y + merges.to.y, scale.y, out->low.y, out->high.y),
                                lattice_coordinate(merges.from.z + merges.to.z, scale.z, out->low.z, out->high.z));
    Quadrics q = merges.quadrics;
    shift_quadrics(&q, make_real3(at.x * scale.x - merges.from.x, at.y * scale.y - merges.from.y, at.z * scale.z - merges.from.z));
    float rows[17 * LANES];
    STORE_LANES(q.axx, rows);
    STORE_LANES(q.axy, rows + LANES);
    STORE_LANES(q.axz, rows + 2 * LANES);
    STORE_LANES(q.ayy, rows + 3 * LANES);
    STORE_LANES(q.ayz, rows + 4 * LANES);
    STORE_LANES(q.azz, rows + 5 * LANES);
    STORE_REAL3(q.b, rows + 6 * LANES, LANES)
    // No merge makes the error smaller. Rounding would, if clusters are large and nearly flat.
    STORE_LANES(fmax(q.c, merges.children), rows + 9 * LANES);
    STORE_REAL3(q.m, rows + 10 * LANES, LANES)
    STORE_LANES(q.k, rows + 13 * LANES);
    STORE_REAL3(at, rows + 14 * LANES, LANES)
    for (uint i = 0; i < batch->count; i++) {
        Quadric quadric;
        for (uint k = 0; k < 6; k++) quadric.a[k] = rows[k * LANES + i];
        for (uint k = 0; k < 3; k++) {
            quadric.b[k] = rows[(6 + k) * LANES + i];
            quadric.m[k] = rows[(10 + k) * LANES + i];
        }
        quadric.c = rows[9 * LANES + i];
        quadric.k = rows[13 * LANES + i];
        const uint a = batch->first[i], b = batch->second[i];
        if (block->is_soft && is_penalised(pair_cost(block, a, b)))
            quadric.c += merge_penalty(block, a, b, block->merged_positions[a].xyz);
        const int3 to = convert_int3((float3)(rows[14 * LANES + i], rows[15 * LANES + i], rows[16 * LANES + i]));
        commit_merge(block, out, a, quadric, to, batch->entry[i]);
    }
    batch->count = 0;
}

// Makes the nodes of this round's pairs, in order of their clusters.
INLINED void commit_pairs(const TreeBlock *block, const TreeOutput *out, uint node_count) {
    PairBatch batch;
    batch.count = 0;
    for (uint i = get_local_id(0); i < block->pair_count; i += WIDE_GROUP) {
        const uint at = pair_list(block)[i];
        collect_pair(&batch, at, block->partners[at], out->node_base + node_count + i);
        if (batch.count == LANES) commit_batch(block, out, &batch);
    }
    commit_batch(block, out, &batch);
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Makes the next round's ring of a cluster, from `to` on. Returns how many entries it has.
INLINED uint next_ring(const TreeBlock *block, uint at, uint to, bool merges) {
    uint count;
    if (!merges) count = renew_ring(block, at, to);
    else {
        const JoinedRing ring = join_rings(block, at);
        count = merge_rings(block, &ring, to);
        block->positions[at].w = as_float(cluster_flags(block, at) | cluster_flags(block, block->partners[at]));
    }
    block->clusters[at].ring_first = to;
    block->clusters[at].ring_count = count;
    return count;
}

// Makes the next round's rings, and drops the clusters that are merged into others.
INLINED void compact_block(TreeBlock *block, __local uint *scratch) {
#if WIDE_GROUP == 1
    (void)scratch;
    uint entries = 0;
    const uint end = block->alive_count, begin = list_kept(block);
    for (uint i = end; i-- > begin;) entries += next_ring(block, block->best[i], entries, false);
    for (uint i = 0; i < block->new_count; i++) entries += next_ring(block, new_list(block)[i], entries, true);
#else
    list_kept(block, scratch);
    for (uint i = get_local_id(0); i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        if (!has_partner(block, at)) next_ring(block, at, block->best[at], false);
    }
    for (uint i = get_local_id(0); i < block->new_count; i += WIDE_GROUP) {
        const uint at = new_list(block)[i];
        next_ring(block, at, block->best[at], true);
    }
#endif
    barrier(CLK_GLOBAL_MEM_FENCE);
    __global uint *rings = block->rings;
    __global float *costs = block->costs;
    block->rings = block->next_rings;
    block->costs = block->next_costs;
    block->next_rings = rings;
    block->next_costs = costs;
}

#endif
