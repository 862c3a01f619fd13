// The clusters of a block that a step of a round processes. On a GPU each work-item tests its clusters one by one. On a CPU they are listed
// before, branch-free: whether a cluster merges is unpredictable, and a branch misprediction costs as much as a few neighbours.
#ifndef ISOPEEL_TREE_LISTS_H
#define ISOPEEL_TREE_LISTS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_rings.h"

#if WIDE_GROUP == 1
inline __global uint *pair_list(const TreeBlock *block) { return (__global uint *)block->next_costs; }

// Lists the first clusters of this round's pairs.
INLINED void list_pairs(TreeBlock *block) {
    uint count = 0;
    for (uint i = 0; i < block->alive_count; i++) {
        const uint at = block->alive[i], partner = block->partners[at];
        pair_list(block)[count] = at;
        count += (partner > at) & !(partner & FOREIGN);
    }
    block->pair_count = count;
}

// Number of entries of nth_pair and nth_new. Entries that are not such clusters are NONE.
inline uint pairs_end(const TreeBlock *block) { return block->pair_count; }
inline uint new_end(const TreeBlock *block) { return block->new_count; }

// First clusters of this round's pairs, in order.
inline uint nth_pair(const TreeBlock *block, uint i) { return pair_list(block)[i]; }

// Clusters that merged in the last round, or points before the first one, in order.
inline uint nth_new(const TreeBlock *block, uint i) { return block->best[i]; }

// Drops the clusters that are merged into others. Lists the clusters that merged, and from the end of `best` on, those that did not. Returns
// the start of the latter list.
INLINED uint list_kept(TreeBlock *block) {
    const uint count = block->alive_count;
    uint kept = 0, merged = 0, others = count;
    for (uint i = 0; i < count; i++) {
        const uint at = block->alive[i], partner = block->partners[at];
        const bool stays = partner > at, is_alone = partner & FOREIGN;
        block->alive[kept] = at;
        kept += stays;
        block->best[merged] = at;
        merged += stays & !is_alone;
        block->best[others - 1] = at;
        others -= is_alone;
    }
    block->alive_count = kept;
    block->new_count = merged;
    return others;
}
#else
inline void list_pairs(const TreeBlock *block) { (void)block; }
inline uint pairs_end(const TreeBlock *block) { return block->alive_count; }
inline uint new_end(const TreeBlock *block) { return block->alive_count; }
inline uint nth_pair(const TreeBlock *block, uint i) {
    const uint at = block->alive[i], partner = block->partners[at];
    return !(partner & FOREIGN) && partner > at ? at : NONE;
}
inline uint nth_new(const TreeBlock *block, uint i) { return has_partner(block, block->alive[i]) ? block->alive[i] : NONE; }
#endif

#endif
