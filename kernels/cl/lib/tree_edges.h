// Hash tables of the leaves and the directed edges of a cut of the vertex tree.
#ifndef ISOPEEL_TREE_EDGES_H
#define ISOPEEL_TREE_EDGES_H

#include "lib/precision.h"
#include "lib/corners.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_leaf.h"

inline uint leaf_hash(uint leaf) {
    const uint h = leaf * 0x9e3779b1u;
    return h ^ h >> 15;
}

inline uint edge_hash32(uint a, uint b) { return (a * 0x9e3779b1u ^ b) * 0x85ebca6bu; }

// A table of directed edges: one a region, in local memory if it fits.
typedef struct {
    __global const uint *corners, *leaves; // of the full mesh
    __global uint *edges;
    __local uint *local_edges;
    uint capacity; // one edge more than there may be
    bool is_local;
} EdgeTable;

#if WIDE_GROUP > 1
#define LOCAL_EDGES 4096
#define EDGE_WORDS 1
#else
#define LOCAL_EDGES 1 // all memory of a CPU is the same
#define EDGE_WORDS 2
#endif

inline void clear_edges(EdgeTable *table, uint capacity) {
    table->capacity = capacity;
    table->is_local = WIDE_GROUP > 1 && capacity <= LOCAL_EDGES;
    for (uint i = get_local_id(0); i < EDGE_WORDS * capacity; i += WIDE_GROUP)
        if (table->is_local) table->local_edges[i] = NONE;
        else table->edges[i] = NONE;
}

// Inserts the edge from leaf `a` to leaf `b` into a table. `corner`: the corner of the full mesh at which it begins. Returns whether the
// table had it already. A group of one work-item stores the two leaves; a larger group stores the corner, because an atomic operation
// inserts only a single number.
INLINED bool put_edge(const EdgeTable *table, uint corner, uint a, uint b) {
    for (uint at = mul_hi(edge_hash32(a, b), table->capacity);; at = at + 1 < table->capacity ? at + 1 : 0) {
#if WIDE_GROUP == 1
        (void)corner;
        __global uint *edge = table->edges + 2 * at;
        if (edge[0] == a && edge[1] == b) return true;
        if (edge[0] != NONE) continue;
        edge[0] = a;
        edge[1] = b;
        return false;
#else
        const uint found =
            table->is_local ? atomic_cmpxchg(table->local_edges + at, NONE, corner) : atomic_cmpxchg(table->edges + at, NONE, corner);
        if (found == NONE) return false;
        const uint end = next_corner(found);
        if (leaf_number(table->leaves[table->corners[found]]) == a && leaf_number(table->leaves[table->corners[end]]) == b) return true;
#endif
    }
}

// Inserts the edge that begins at a corner of the full mesh into a table that all work-groups share; each entry is such a corner. Returns
// whether the table had it already.
INLINED bool put_shared_edge(__global uint *edges, uint capacity, __global const uint *corners, __global const uint *leaves, uint corner,
                             uint a, uint b) {
    uint at = mul_hi(edge_hash32(a, b), capacity);
    for (uint tries = 0; tries < capacity; tries++, at = at + 1 < capacity ? at + 1 : 0) {
        const uint found = atomic_cmpxchg(edges + at, NONE, corner);
        if (found == NONE) return false;
        if (leaf_number(leaves[corners[found]]) == a && leaf_number(leaves[corners[next_corner(found)]]) == b) return true;
    }
    return false;
}

// A number of each leaf in a region's mesh: of the region's own leaves by theirs, of the others in a hash table.
typedef struct {
    TreePoints own;
    uint node_base, nodes, points;
    __global uint *own_numbers;                  // of the leaves of all regions
    __global uint *other_leaves, *other_numbers; // the table
    uint mask;
} LeafNumbers;

inline bool is_own_leaf(const LeafNumbers *of, uint leaf) {
    return own_leaf_index(&of->own, of->node_base, of->nodes, of->points, leaf) != NONE;
}

// Address of a leaf's number. Inserts leaves of other regions into the table.
inline __global uint *number_of_leaf(const LeafNumbers *of, uint leaf) {
    if (is_own_leaf(of, leaf)) return of->own_numbers + leaf;
    for (uint at = leaf_hash(leaf) & of->mask;; at = (at + 1) & of->mask) {
        const uint found = claim_global(&of->other_leaves[at], NONE, leaf);
        if (found == NONE || found == leaf) return of->other_numbers + at;
    }
}

#endif
