// The pair test of the vertex tree: finds the merges of a round that would break the surface, given all other merges of the round.
#ifndef ISOPEEL_TREE_PAIR_TEST_H
#define ISOPEEL_TREE_PAIR_TEST_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_folds.h"
#include "lib/tree_lists.h"
#include "lib/tree_rings.h"

// Verdicts on a pair: flags in TreeBlock::best of its first cluster, beside a number.
#define GIVE_UP 0x80000000u   // in this round
#define SET_ASIDE 0x40000000u // until one of the two merges: it would be chosen in every round; in a soft block penalised instead
#define EXCLUDED 0x20000000u  // until one of the two merges, in a soft block, too

// Cost of merging a cluster with its partner.
inline float partner_cost(const TreeBlock *block, uint a) { return pair_cost(block, a, block->partners[a]); }

// Of two pairs that may not both merge, the one that gives way, both named by their first clusters. Without this choice they would retry
// for ever.
inline uint dearer_pair(const TreeBlock *block, uint a, uint b) {
    const float a_cost = partner_cost(block, a), b_cost = partner_cost(block, b);
    return a_cost > b_cost || (a_cost == b_cost && a > b) ? a : b;
}

// If two pairs would meet along more than one line, marks the one of higher cost.
INLINED void test_lines(const TreeBlock *block, uint a, const MergedRing *ring, uint count, bool open) {
    for (uint i = 0; i < count; i++) {
        const uint other = merged_entry(ring, i);
        if (!merges_here(block, other)) continue;
        for (uint k = i + 1; k < count; k++) {
            if (merged_entry(ring, k) != other) continue;
            // If the border has closed, only this cluster is at fault.
            if (!(open && i == 0 && k == count - 1)) or_global(block->best + dearer_pair(block, a, other), GIVE_UP);
        }
    }
}

// Whether other blocks are beside a ring along more than one line. A cluster of such a block that meets the ring's cluster along both lines
// would join the surface there twice.
INLINED bool meets_others_twice(const MergedRing *ring, uint count, bool open) {
    uint lines = 0, own = 0;
    uint before = open || !count ? 0 : merged_entry(ring, count - 1) & FOREIGN;
    for (uint i = 0; i < count; i++) {
        const uint foreign = merged_entry(ring, i) & FOREIGN;
        lines += foreign > before;
        own += !foreign;
        before = foreign;
    }
    return lines > 1 || (!open && own + lines < 3);
}

// Marks a pair that meets another one along more than one line and costs more, one with too few triangles left, one that would close
// the border, one that meets other blocks along more than one line, and one that folds the surface.
// Undoing a merge makes no other one fail: its neighbours keep more triangles, and meet along no more lines.
INLINED void test_pair(const TreeBlock *block, uint a) {
    const JoinedRing joined = join_rings(block, a);
    MergedRing ring;
    const uint count = find_merged_ring(block, a, &joined, &ring);
    // On the border, the first and the last neighbour are the same if the border has closed.
    const bool fails = joined.open ? count == 0 || merged_entry(&ring, 0) == merged_entry(&ring, count - 1) : count < 3;
    if (fails) or_global(block->best + a, GIVE_UP);
    if (!all_differ(&ring, count)) test_lines(block, a, &ring, count, joined.open);
    if (meets_others_twice(&ring, count, joined.open)) or_global(block->best + a, EXCLUDED);
    const bool may_fold = block->is_soft && is_penalised(partner_cost(block, a));
    if (!may_fold && folds(block, a, &ring, count, joined.open)) or_global(block->best + a, SET_ASIDE);
}

// Excludes the edge between a cluster and its partner from the cluster's choice until one of them merges; or penalises it.
inline void set_edge_aside(const TreeBlock *block, uint at, bool penalises) {
    const uint partner = block->partners[at], entry = ring_entry(block, at, partner);
    float cost = INFINITY;
    if (penalises)
        cost = penalised_cost(block->costs[entry], merge_penalty(block, at, partner, block->merged_positions[at].xyz));
    block->costs[entry] = cost;
}

// Applies a verdict to one cluster of a pair. Returns whether the pair is given up.
INLINED bool settle_cluster(const TreeBlock *block, uint at, uint verdict) {
    if (verdict & (SET_ASIDE | EXCLUDED)) set_edge_aside(block, at, block->is_soft && !(verdict & EXCLUDED));
    if (!(verdict & (GIVE_UP | SET_ASIDE | EXCLUDED))) return false;
    block->partners[at] = CHANGES; // partners could not be marked
    block->merged_positions[at] = block->positions[at];
    return true;
}

// Gives up the pairs that failed, records the changes by the others, and lists the others. Each work-item writes only the data of its own clusters.
#if WIDE_GROUP == 1
INLINED void settle_pairs(TreeBlock *block, __local uint *scratch) {
    (void)scratch;
    uint count = 0;
    for (uint i = 0; i < block->pair_count; i++) {
        const uint at = pair_list(block)[i], partner = block->partners[at], verdict = block->best[at];
        pair_list(block)[count] = at;
        count += !settle_cluster(block, at, verdict);
        settle_cluster(block, partner, verdict);
    }
    block->pair_count = count;
}
#else
INLINED void settle_pairs(TreeBlock *block, __local uint *scratch) {
    for (uint i = get_local_id(0); i < block->alive_count; i += WIDE_GROUP) {
        const uint at = block->alive[i], partner = block->partners[at];
        if (partner & FOREIGN && block->members[at].changes) block->partners[at] = CHANGES;
        block->members[at].changes = 0;
        if (!(partner & FOREIGN)) settle_cluster(block, at, block->best[min(at, partner)]);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    list_pairs(block, scratch);
}
#endif

#endif
