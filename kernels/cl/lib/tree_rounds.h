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
    for (uint i = get_local_id(0); i < new_end(block); i += WIDE_GROUP) {
        const uint at = nth_new(block, i);
        if (at != NONE) collect_edges(block, &batch, at);
    }
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

// Tests the collected pairs and writes the positions of their merges. Returns the columns of the pairs that may not merge, one bit each.
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
            failed |= 1u << i;
            continue;
        }
        const float4 to = (float4)(x[i], y[i], z[i], 0.0f);
        block->merged_positions[a] = block->merged_positions[b] = to;
        failed |= collect_turns(block, &turns, a, b, to, i);
        failed |= collect_turns(block, &turns, b, a, to, i);
    }
    return failed | failed_turns(&turns);
}

// Makes partners of the collected pairs that may merge, and lists the clusters of the others. Empties the batch.
INLINED void test_batch(const TreeBlock *block, PairBatch *batch, __global uint *failed, __local uint *failed_count) {
    if (batch->count == 0) return;
    const uint fails = failed_pairs(block, batch);
    for (uint i = 0; i < batch->count; i++) {
        const uint a = batch->first[i], b = batch->second[i];
        if (fails >> i & 1u) {
            const uint at = add_local(failed_count, 2);
            failed[at] = a;
            failed[at + 1] = b;
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

// Makes partners of clusters that are each other's best neighbour and may merge. A pair is tested once both have chosen each other. If it
// fails, both choose again, until no pair fails.
INLINED void choose_partners(const TreeBlock *block, __local uint *failed_count) {
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
        if (lid == 0) *failed_count = 0;
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        __global uint *failed = pass & 1 ? (__global uint *)block->next_costs : block->next_rings;
        PairBatch batch;
        batch.count = 0;
        for (uint i = lid; i < count; i += WIDE_GROUP) {
            const uint at = list[i];
            const bool tests = tests_best(block, at, pass);
            if (WIDE_GROUP > 1 && !tests) continue;
            collect_pair(&batch, at, best[at], 0);
            // Branch-free: the outcome is unpredictable.
            if (WIDE_GROUP == 1) batch.count -= !tests;
            if (batch.count == LANES) test_batch(block, &batch, failed, failed_count);
        }
        test_batch(block, &batch, failed, failed_count);
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        count = *failed_count;
        for (uint i = lid; i < count; i += WIDE_GROUP) {
            const uint at = failed[i], first = block->clusters[at].ring_first;
            ((__global uint *)block->costs)[first + index_of(block->rings + first, best[at])] |= FAILED;
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
INLINED void find_pairs(TreeBlock *block, __local uint *failed_count) {
    find_costs(block);
    barrier(CLK_GLOBAL_MEM_FENCE);
    choose_partners(block, failed_count);
    barrier(CLK_GLOBAL_MEM_FENCE);
    list_pairs(block);
    for (uint i = get_local_id(0); i < pairs_end(block); i += WIDE_GROUP) {
        const uint at = nth_pair(block, i);
        if (at != NONE) test_pair(block, at);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    settle_pairs(block);
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Output buffers of a block's nodes.
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

// Replaces a cluster by itself and its partner merged at `at`, node number `index`; its ring is made later.
INLINED void commit_merge(const TreeBlock *block, const TreeOutput *out, uint a, Quadric quadric, int3 at, uint index) {
    __global TreeCluster *first = block->clusters + a;
    const uint b = block->partners[a];
    __global TreeMembers *own = block->members + a, *other = block->members + b;
    const uint first_flags = cluster_flags(block, a), second_flags = cluster_flags(block, b);
    first->quadric = quadric;
    for (uint side = 0; side < 2; side++) {
        const uint point = side ? b : a, node = side ? other->node : own->node;
        __global uint *of_point = point < out->cell_points ? out->point_parents + point : out->border_parents + (point - out->cell_points);
        *(node != NONE ? out->node_parents + node : of_point) = index;
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
    const float3 to = convert_float3(at) * block->scale;
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
    const float3 scale = block->scale;
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
    STORE_LANES(fmax(q.c, 0.0f), rows + 9 * LANES);
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
        const int3 to = convert_int3((float3)(rows[14 * LANES + i], rows[15 * LANES + i], rows[16 * LANES + i]));
        commit_merge(block, out, batch->first[i], quadric, to, batch->entry[i]);
    }
    batch->count = 0;
}

// Makes the nodes of this round's pairs, in order of their clusters. Returns how many.
INLINED uint commit_pairs(const TreeBlock *block, const TreeOutput *out, uint node_count, __local uint *scratch) {
    PairBatch batch;
    batch.count = 0;
    uint merged = 0, total;
    for (uint begin = 0; begin < pairs_end(block); begin += WIDE_GROUP) {
        const uint i = begin + get_local_id(0), at = i < pairs_end(block) ? nth_pair(block, i) : NONE;
        const uint rank = merged + scan_group(scratch, at != NONE, &total);
        if (at != NONE) collect_pair(&batch, at, block->partners[at], out->node_base + node_count + rank);
        if (batch.count == LANES) commit_batch(block, out, &batch);
        merged += total;
    }
    commit_batch(block, out, &batch);
    barrier(CLK_GLOBAL_MEM_FENCE);
    return merged;
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
    uint entries = 0;
#if WIDE_GROUP == 1
    (void)scratch;
    const uint end = block->alive_count, begin = list_kept(block);
    for (uint i = end; i-- > begin;) entries += next_ring(block, block->best[i], entries, false);
    for (uint i = 0; i < block->new_count; i++) entries += next_ring(block, block->best[i], entries, true);
#else
    const uint lid = get_local_id(0);
    uint kept = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += WIDE_GROUP) {
        const bool is_there = begin + lid < block->alive_count;
        const uint at = is_there ? block->alive[begin + lid] : 0, partner = is_there ? block->partners[at] : 0;
        const bool is_kept = is_there && partner > at; // without a partner, it is above all
        uint capacity = 0;
        if (is_kept) capacity = block->clusters[at].ring_count + (!(partner & FOREIGN) ? block->clusters[partner].ring_count - 2 : 0);
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
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < kept; i += WIDE_GROUP) {
        const uint at = block->alive[i];
        next_ring(block, at, block->best[at], has_partner(block, at));
    }
    block->alive_count = kept;
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
