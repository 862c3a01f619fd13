// Lists of the clusters of a block that a step of a round processes: its pairs, and those that merged in the last round. On a CPU they are
// made branch-free: whether a cluster merges is unpredictable, and a branch misprediction costs as much as a few neighbours. On a GPU, the
// work-items of a warp that have no such cluster would wait for those that have.
#ifndef ISOPEEL_TREE_LISTS_H
#define ISOPEEL_TREE_LISTS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_block.h"
#include "lib/tree_rings.h"

// First clusters of this round's pairs, in order.
inline __global uint *pair_list(const TreeBlock *block) { return (__global uint *)block->next_costs; }

#if WIDE_GROUP == 1
// Clusters that merged in the last round, or all before the first one, in order.
inline __global const uint *new_list(const TreeBlock *block) { return block->best; }

INLINED void list_pairs(TreeBlock *block, __local uint *scratch) {
    (void)scratch;
    uint count = 0;
    for (uint i = 0; i < block->alive_count; i++) {
        const uint at = block->alive[i], partner = block->partners[at];
        pair_list(block)[count] = at;
        count += (partner > at) & !(partner & FOREIGN);
    }
    block->pair_count = count;
}

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
inline __global const uint *new_list(const TreeBlock *block) { return block->alive + block->new_first; }

// Clusters that a work-item lists with each prefix sum, which has many barriers.
#define LIST_RUN 8

INLINED void list_pairs(TreeBlock *block, __local uint *scratch) {
    uint count = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += LIST_RUN * WIDE_GROUP) {
        uint own[LIST_RUN], own_count = 0;
        for (uint k = 0; k < LIST_RUN; k++) {
            const uint i = begin + LIST_RUN * (uint)get_local_id(0) + k;
            own[k] = NONE;
            if (i >= block->alive_count) continue;
            const uint at = block->alive[i], partner = block->partners[at];
            if (partner & FOREIGN || partner < at) continue;
            own[k] = at;
            own_count++;
        }
        uint rank = count + scan_group(scratch, own_count, &total);
        for (uint k = 0; k < LIST_RUN; k++)
            if (own[k] != NONE) pair_list(block)[rank++] = own[k];
        count += total;
    }
    block->pair_count = count;
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Upper bound of the entries of a remaining cluster's next ring.
inline uint ring_capacity(const TreeBlock *block, uint at) {
    const uint partner = block->partners[at], own = block->clusters[at].ring_count;
    return partner & FOREIGN ? own : own + block->clusters[partner].ring_count - 2;
}

// Drops the clusters that are merged into others, and lists behind the others those that merged. `best` receives where the next ring of each
// begins.
INLINED void list_kept(TreeBlock *block, __local uint *scratch) {
    const uint lid = get_local_id(0), count = block->alive_count;
    uint kept = 0, entries = 0, total;
    for (uint begin = 0; begin < count; begin += LIST_RUN * WIDE_GROUP) {
        uint own[LIST_RUN], own_count = 0, capacity = 0;
        for (uint k = 0; k < LIST_RUN; k++) {
            const uint i = begin + LIST_RUN * lid + k;
            own[k] = NONE;
            if (i >= count) continue;
            const uint at = block->alive[i];
            if (block->partners[at] < at) continue;
            own[k] = at;
            own_count++;
            capacity += ring_capacity(block, at);
        }
        uint to = entries + scan_group(scratch, capacity, &total);
        entries += total;
        // Also the barrier between reading and writing.
        uint rank = kept + scan_group(scratch, own_count, &total);
        barrier(CLK_GLOBAL_MEM_FENCE);
        kept += total;
        for (uint k = 0; k < LIST_RUN; k++) {
            if (own[k] == NONE) continue;
            block->best[own[k]] = to;
            to += ring_capacity(block, own[k]);
            block->alive[rank++] = own[k];
        }
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->pair_count; i += WIDE_GROUP) block->alive[kept + i] = pair_list(block)[i];
    block->alive_count = block->new_first = kept;
    block->new_count = block->pair_count;
    barrier(CLK_GLOBAL_MEM_FENCE);
}
#endif

#endif
