// Hash tables of the leaves and the directed edges of a cut of the vertex tree.
#ifndef ISOPEEL_TREE_EDGES_H
#define ISOPEEL_TREE_EDGES_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_leaf.h"

inline uint leaf_hash(uint leaf) {
    const uint h = leaf * 0x9e3779b1u;
    return h ^ h >> 15;
}

// Tables of directed edges, each by its corner at its begin.
typedef struct {
    __global const uint *corners, *leaves; // of the full mesh
    __global uint *edges;
    uint capacity;
    __local uint *local_edges; // of edges that no other region has
    bool is_local;
} EdgeTables;

#if GROUP > 1
#define LOCAL_EDGES 4096
#else
#define LOCAL_EDGES 1 // all memory of a CPU is the same
#endif

inline bool is_edge(const EdgeTables *tables, uint corner, uint a, uint b) {
    const uint end = corner % 3 == 2 ? corner - 2 : corner + 1;
    return leaf_number(tables->leaves[tables->corners[corner]]) == a && leaf_number(tables->leaves[tables->corners[end]]) == b;
}

// Puts an edge into a table, from `first` on. Whether it was there.
inline bool put_edge(const EdgeTables *tables, uint first, uint corner, uint a, uint b) {
    for (uint at = first;; at = at + 1 < tables->capacity ? at + 1 : 0) {
        const uint found = atomic_cmpxchg(&tables->edges[at], NONE, corner);
        if (found == NONE) return false;
        if (is_edge(tables, found, a, b)) return true;
    }
}
inline bool put_local_edge(const EdgeTables *tables, uint first, uint corner, uint a, uint b) {
    for (uint at = first;; at = (at + 1) % LOCAL_EDGES) {
        const uint found = atomic_cmpxchg(&tables->local_edges[at], NONE, corner);
        if (found == NONE) return false;
        if (is_edge(tables, found, a, b)) return true;
    }
}

// The first corner of each leaf in a region's mesh: of the region's own leaves by their number, of the others in a hash table.
typedef struct {
    TreePoints own;
    uint node_base, points;
    __global uint *own_firsts;                  // of the leaves of all regions
    __global uint *other_leaves, *other_firsts; // the table
    uint mask;
} FirstCorners;

inline bool is_own_leaf(const FirstCorners *of, uint leaf) {
    return own_leaf_index(&of->own, of->node_base, of->points, leaf) != NONE;
}

inline void put_corner(const FirstCorners *of, uint leaf, uint corner) {
    __global uint *first = of->own_firsts + leaf;
    if (!is_own_leaf(of, leaf)) {
        uint at = leaf_hash(leaf) & of->mask;
        for (;; at = (at + 1) & of->mask) {
            const uint found = claim_global(&of->other_leaves[at], NONE, leaf);
            if (found == NONE || found == leaf) break;
        }
        first = of->other_firsts + at;
    }
    min_global(first, corner);
}

inline uint first_corner(const FirstCorners *of, uint leaf) {
    if (is_own_leaf(of, leaf)) return of->own_firsts[leaf];
    uint at = leaf_hash(leaf) & of->mask;
    while (of->other_leaves[at] != leaf) at = (at + 1) & of->mask;
    return of->other_firsts[at];
}

#endif
