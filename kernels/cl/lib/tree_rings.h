// Rings of the vertex tree's clusters after a round of merges, and the clusters that replace merged neighbours.
#ifndef ISOPEEL_TREE_RINGS_H
#define ISOPEEL_TREE_RINGS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_block.h"

// In TreeBlock::partners, for a cluster that does not merge: a cluster around it does.
#define CHANGES FOREIGN

// Whether a cluster merges with another one.
inline bool has_partner(const TreeBlock *block, uint at) { return !(block->partners[at] & FOREIGN); }

// The cluster that replaces another one after this round's merges.
inline uint merged_corner(const TreeBlock *block, uint at) {
    // Without a partner, the number is above all cluster numbers.
    const uint partner = block->partners[at & FOREIGN ? 0 : at];
    return at & FOREIGN ? at : min(at, partner);
}

inline bool merges_here(const TreeBlock *block, uint at) { return !(at & FOREIGN) && has_partner(block, at); }

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
    // If one cluster is inside and the other one on the border, the latter is the outer one.
    const uint outer = b_open && !a_open ? b : a, inner = outer == a ? b : a;
    JoinedRing ring;
    ring.outer_first = block->clusters[outer].ring_first;
    ring.inner_first = block->clusters[inner].ring_first;
    ring.inner_count = block->clusters[inner].ring_count;
    ring.at = index_of(block->rings + ring.outer_first, inner);
    ring.inner_begin = index_of(block->rings + ring.inner_first, outer) + 1;
    ring.count = block->clusters[outer].ring_count + ring.inner_count - 2;
    ring.open = a_open || b_open;
    return ring;
}

// Marks a neighbour of clusters that merge.
inline void mark_change(const TreeBlock *block, uint neighbour) {
    if (neighbour & FOREIGN) return;
#if WIDE_GROUP == 1
    const uint partner = block->partners[neighbour];
    block->partners[neighbour] = min(partner, CHANGES);
#else
    // Others read partners.
    block->members[neighbour].changes = 1;
#endif
}

#if WIDE_GROUP == 1
// A joined ring in private memory, which has space for a vector behind it.
#define RING_CAPACITY (2 * MAX_FAN + 16)

inline void copy_ring(__global const uint *from, uint count, uint *to) {
    for (uint i = 0; i < count; i += 16) vstore16(vload16(0, from + i), 0, to + i);
}

// The ring of a pair after all merges of the round.
typedef struct {
    uint entries[RING_CAPACITY];
} MergedRing;

inline uint merged_entry(const MergedRing *ring, uint i) { return ring->entries[i]; }

// Writes a joined ring.
INLINED void copy_joined(const TreeBlock *block, const JoinedRing *ring, uint *to) {
    __global const uint *outer = block->rings + ring->outer_first, *inner = block->rings + ring->inner_first;
    const uint wrapped = ring->inner_begin - 1, along = ring->inner_count - ring->inner_begin;
    copy_ring(outer, ring->at, to);
    copy_ring(inner + ring->inner_begin, along, to + ring->at);
    copy_ring(inner, wrapped, to + ring->at + along);
    const uint behind = ring->at + along + wrapped;
    copy_ring(outer + ring->at + 1, ring->count - behind, to + behind);
}

// Replaces the neighbours in a ring by their merged clusters and drops repeated ones. `marks`: marks the neighbours as changed, because the
// ring's clusters merge. Returns the new number of neighbours.
INLINED uint merge_neighbours(const TreeBlock *block, uint *ring, uint count, bool open, bool marks) {
    uint before = open || !count ? NONE : merged_corner(block, ring[count - 1]), kept = 0;
    for (uint i = 0; i < count; i++) {
        const uint neighbour = ring[i], other = merged_corner(block, neighbour);
        if (marks) mark_change(block, neighbour);
        ring[kept] = other;
        kept += other != before;
        before = other;
    }
    return kept;
}

// Whether it is known that no neighbour is in a ring twice.
INLINED bool all_differ(MergedRing *ring, uint count) {
    if (count > 16) return false;
    const uint16 lane = (uint16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const uint16 own = vload16(0, ring->entries);
    vstore16(own, 0, ring->entries + count);
    int16 equal = 0;
    for (uint step = 1; 2 * step <= count; step++) equal |= own == vload16(0, ring->entries + step);
    return !any_lane(equal & (lane < count));
}

// Writes the ring of a pair, and marks the clusters around the pair. Returns the number of entries of the ring.
INLINED uint find_merged_ring(const TreeBlock *block, uint a, const JoinedRing *joined, MergedRing *ring) {
    (void)a;
    copy_joined(block, joined, ring->entries);
    return merge_neighbours(block, ring->entries, joined->count, joined->open, true);
}
#else
// The ring of a pair after all merges of the round: in the two ranges of `next_rings` that the two rings have.
typedef struct {
    __global uint *low, *high; // the latter from `split` on
    uint split;
} MergedRing;

inline __global uint *at_merged_entry(const MergedRing *ring, uint i) { return (i < ring->split ? ring->low : ring->high) + i; }
inline uint merged_entry(const MergedRing *ring, uint i) { return *at_merged_entry(ring, i); }
inline bool all_differ(MergedRing *ring, uint count) { return (void)ring, (void)count, false; }

inline uint joined_entry(const TreeBlock *block, const JoinedRing *ring, uint i) {
    if (i < ring->at) return block->rings[ring->outer_first + i];
    const uint along = i - ring->at;
    if (along + 1 >= ring->inner_count) return block->rings[ring->outer_first + i + 2 - ring->inner_count];
    const uint at = ring->inner_begin + along;
    return block->rings[ring->inner_first + (at < ring->inner_count ? at : at - ring->inner_count)];
}

// Writes the ring of the pair whose first cluster is `a`, and marks the clusters around the pair. Returns the number of entries of the ring.
INLINED uint find_merged_ring(const TreeBlock *block, uint a, const JoinedRing *joined, MergedRing *ring) {
    ring->split = block->clusters[a].ring_count;
    ring->low = block->next_rings + block->clusters[a].ring_first;
    ring->high = block->next_rings + block->clusters[block->partners[a]].ring_first - ring->split;
    uint before = joined->open || !joined->count ? NONE : merged_corner(block, joined_entry(block, joined, joined->count - 1)), count = 0;
    for (uint i = 0; i < joined->count; i++) {
        const uint neighbour = joined_entry(block, joined, i), other = merged_corner(block, neighbour);
        mark_change(block, neighbour);
        if (other != before) *at_merged_entry(ring, count++) = before = other;
    }
    return count;
}
#endif

// Whether a cluster or one around it merges: then the reason why its pairs failed may be gone.
inline bool has_changed(const TreeBlock *block, uint at) { return block->partners[at] <= CHANGES; }

// Writes the ring of a cluster that did not merge, its neighbours merged, from `to` on. Returns how many entries it has.
INLINED uint renew_ring(const TreeBlock *block, uint at, uint to) {
    const uint first = block->clusters[at].ring_first, ring_count = block->clusters[at].ring_count;
    const bool open = cluster_flags(block, at) & CLUSTER_BORDER, changed = has_changed(block, at);
    uint count = 0, before = open || !ring_count ? NONE : merged_corner(block, block->rings[first + ring_count - 1]);
    for (uint i = 0; i < ring_count; i++) {
        const uint neighbour = block->rings[first + i], partner = block->partners[neighbour & FOREIGN ? 0 : neighbour];
        const uint other = neighbour & FOREIGN ? neighbour : min(neighbour, partner);
        if (WIDE_GROUP > 1 && other == before) continue;
        block->next_rings[to + count] = other;
        const float cost = block->costs[first + i];
        block->next_costs[to + count] = (changed | (partner <= CHANGES)) ? fabs(cost) : cost;
        // Branch-free, as the outcome is unpredictable: the next entry overwrites this one.
        count += other != before;
        before = other;
    }
    return count;
}

// The same of a cluster that did.
#if WIDE_GROUP == 1
INLINED uint merge_rings(const TreeBlock *block, const JoinedRing *joined, uint to) {
    uint ring[RING_CAPACITY];
    copy_joined(block, joined, ring);
    const uint count = merge_neighbours(block, ring, joined->count, joined->open, false);
    for (uint i = 0; i < count; i++) {
        block->next_rings[to + i] = ring[i];
        block->next_costs[to + i] = INFINITY;
    }
    return count;
}
#else
INLINED uint merge_rings(const TreeBlock *block, const JoinedRing *ring, uint to) {
    uint count = 0, before = ring->open ? NONE : merged_corner(block, joined_entry(block, ring, ring->count - 1));
    for (uint i = 0; i < ring->count; i++) {
        const uint other = merged_corner(block, joined_entry(block, ring, i));
        if (other == before) continue;
        block->next_costs[to + count] = INFINITY;
        block->next_rings[to + count++] = before = other;
    }
    return count;
}
#endif

#endif
