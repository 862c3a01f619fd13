// A round of merges in a block of the vertex tree: each cluster's best edge, pairs that are each other's best, the pair test.
#ifndef ISOPEEL_TREE_ROUNDS_H
#define ISOPEEL_TREE_ROUNDS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"
#include "lib/tree_node.h"

// Cost of merging two clusters of the block, from either side.
inline float edge_cost(const TreeBlock *block, uint a, uint b) {
    return merge_clusters(block->clusters + min(a, b), block->clusters + max(a, b)).cost;
}

// Costs of the edges from each cluster to later ones; make_fans has made the fans.
INLINED void find_costs(const TreeBlock *block) {
    for (uint i = get_local_id(0); i < block->alive_count; i += GROUP) {
        const uint at = block->alive[i], first = block->clusters[at].fan_first;
        for (uint k = 0; k < block->clusters[at].fan_count; k++) {
            const uint other = neighbour(block, at, k);
            if (!(other & FOREIGN) && other > at) block->costs[first + k] = edge_cost(block, at, other);
        }
    }
}

// Cost of the edge to the k-th neighbour, `other`: that of an earlier one is found in its fan, unless they are on a border.
inline float known_cost(const TreeBlock *block, uint at, uint k, uint other) {
    if (other & FOREIGN) return INFINITY;
    if (other > at) return block->costs[block->clusters[at].fan_first + k];
    const uint count = block->clusters[other].fan_count;
    for (uint i = 0; i < count; i++)
        if (neighbour(block, other, i) == at) return block->costs[block->clusters[other].fan_first + i];
    return edge_cost(block, at, other);
}

// Best of the edges of a cluster that may merge; NONE where none may.
INLINED uint best_neighbour(const TreeBlock *block, uint at) {
    __global const TreeCluster *cluster = block->clusters + at;
    if ((cluster->flags & CLUSTER_LOCKED) || cluster->fan_count > MAX_FAN) return NONE;
    const uint last = cluster->flags & CLUSTER_BORDER ? last_neighbour(block, at) : NONE;
    const uint edges = cluster->fan_count + (last != NONE);
    ulong rejected = 0;
    for (;;) {
        uint best = NONE, best_edge = 0, best_hash = 0;
        float best_cost = INFINITY;
        for (uint k = 0; k < edges; k++) {
            if (rejected >> k & 1ul) continue;
            const uint other = k < cluster->fan_count ? neighbour(block, at, k) : last;
            const float cost = k < cluster->fan_count ? known_cost(block, at, k, other)
                : other & FOREIGN ? INFINITY : edge_cost(block, at, other);
            if (!(cost <= best_cost) || cost == INFINITY) continue;
            const uint hash = edge_hash(min(at, other), max(at, other));
            if (cost == best_cost && best != NONE && (hash > best_hash || (hash == best_hash && other > best))) continue;
            best = other;
            best_edge = k;
            best_cost = cost;
            best_hash = hash;
        }
        if (best == NONE || may_merge(block, min(at, best), max(at, best))) return best;
        rejected |= 1ul << best_edge;
    }
}

// The cluster that stands for another one after this round's merges.
inline uint merged_corner(const TreeBlock *block, uint at) {
    if (at & FOREIGN) return at;
    const uint partner = block->clusters[at].partner;
    return partner < at ? partner : at; // NONE is above all
}

inline bool merges_here(const TreeBlock *block, uint at) { return !(at & FOREIGN) && block->clusters[at].partner != NONE; }

// Triangles that a merged cluster keeps.
typedef struct {
    uint triangles;
    uint after, before; // with `other` after the cluster, and before it
} MergedFan;

// Of the cluster that `a` and its partner become: what is left around it, and beside `other`.
inline MergedFan merged_fan(const TreeBlock *block, uint a, uint other) {
    MergedFan fan = {0, 0, 0};
    for (uint side = 0; side < 2; side++) {
        __global const TreeCluster *cluster = block->clusters + (side ? block->clusters[a].partner : a);
        for (uint i = 0; i < cluster->fan_count; i++) {
            const uint corner = block->fans[cluster->fan_first + i];
            const uint p = merged_corner(block, block->triangles[next_corner(corner)]);
            const uint q = merged_corner(block, block->triangles[previous_corner(corner)]);
            if (p == a || q == a || p == q) continue;
            fan.triangles++;
            fan.after += p == other;
            fan.before += q == other;
        }
    }
    return fan;
}

// The pair test: merged neighbours that would meet along more than one line, and clusters with too few triangles left, are marked.
INLINED void test_pair(const TreeBlock *block, uint a) {
    const bool on_border = (block->clusters[a].flags | block->clusters[block->clusters[a].partner].flags) & CLUSTER_BORDER;
    if (merged_fan(block, a, NONE).triangles < (on_border ? 1u : 3u)) block->clusters[a].undo = 1;
    for (uint side = 0; side < 2; side++) {
        __global const TreeCluster *cluster = block->clusters + (side ? block->clusters[a].partner : a);
        for (uint i = 0; i < cluster->fan_count; i++) {
            const uint other = merged_corner(block, block->triangles[next_corner(block->fans[cluster->fan_first + i])]);
            if (other == a || !merges_here(block, other)) continue;
            const MergedFan fan = merged_fan(block, a, other);
            if (fan.after > 1 || fan.before > 1) block->clusters[a].undo = block->clusters[other].undo = 1;
        }
    }
}

// Pairs the clusters that are each other's best, and takes back those that fail the pair test.
INLINED void find_pairs(const TreeBlock *block, __local uint *failed) {
    const uint lid = get_local_id(0);
    __global TreeCluster *clusters = block->clusters;
    find_costs(block);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += GROUP) clusters[block->alive[i]].best = best_neighbour(block, block->alive[i]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < block->alive_count; i += GROUP) {
        const uint at = block->alive[i], best = clusters[at].best;
        clusters[at].partner = best != NONE && clusters[best].best == at ? best : NONE;
        clusters[at].undo = 0;
    }
    for (;;) {
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        if (lid == 0) *failed = 0;
        for (uint i = lid; i < block->alive_count; i += GROUP) {
            const uint at = block->alive[i];
            if (clusters[at].partner != NONE && clusters[at].partner > at) test_pair(block, at);
        }
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        for (uint i = lid; i < block->alive_count; i += GROUP) {
            const uint at = block->alive[i];
            if (!clusters[at].undo) continue;
            clusters[at].undo = 0;
            clusters[clusters[at].partner].partner = NONE;
            clusters[at].partner = NONE;
            *failed = 1;
        }
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
        if (!*failed) return;
    }
}

// Where the nodes of a block go.
typedef struct {
    __global TreeNode *nodes;
    __global uint *point_parents; // of the points of cells and sheets, then of those on the volume's faces
    __global uint *border_parents;
    uint cell_points;             // how many points of cells and sheets
    uint region;
    uint node_base;
    int3 low, high;               // range of positions, 1/VERTEX_LATTICE cell from the region's low corner
    float per_length;             // 1 / smallest spacing
} TreeOutput;

// Replaces a cluster by itself and its partner merged, node number `index`.
INLINED void commit_merge(const TreeBlock *block, const TreeOutput *out, uint a, uint index) {
    __global TreeCluster *first = block->clusters + a, *second = block->clusters + first->partner;
    const Merge merge = merge_clusters(first, second);
    const float3 from = cluster_position(first);
    const int3 at = clamp(convert_int3_rte((from + merge.to) / block->scale), out->low, out->high);
    const float3 to = convert_float3(at) * block->scale;
    const uint removed = first->flags & second->flags & CLUSTER_BORDER ? 1 : 2;
    first->quadric = shift_quadric(merge.quadric, to - from);
    first->quadric.c = fmax(first->quadric.c, 0.0f);
    for (uint side = 0; side < 2; side++) {
        const uint own = side ? first->partner : a, node = block->clusters[own].node;
        if (node != NONE) out->nodes[node].parent = index;
        else if (own < out->cell_points) out->point_parents[own] = index;
        else out->border_parents[own - out->cell_points] = index;
    }
    first->position[0] = to.x;
    first->position[1] = to.y;
    first->position[2] = to.z;
    for (uint i = 0; i < 3; i++) first->normal[i] += second->normal[i];
    first->s += second->s;
    first->f += second->f;
    first->extent = join_extents(first->extent, second->extent);
    first->flags |= second->flags;
    first->node = index;
    const float per_area = exact_quotient(1.0f, fmax(first->quadric.k, 1e-30f));
    TreeNode node;
    pack_tree_position(&node, at);
    node.normal_s = encode_octahedral8((float3)(first->normal[0], first->normal[1], first->normal[2]))
        | (uint)(clamp(first->s * per_area, 0.0f, 1.0f) * 65535.0f + 0.5f) << 16;
    node.f = first->f * per_area;
    node.error = sqrt(first->quadric.c) * out->per_length;
    node.parent = NONE;
    const uint border = first->flags & CLUSTER_BORDER ? 1 : 0;
    node.meta = extent_level(first->extent) | border << 3 | removed << 4 | out->region << 6;
    out->nodes[index] = node;
}

// Makes the nodes of this round's pairs, in order of their clusters. Returns how many.
INLINED uint commit_pairs(const TreeBlock *block, const TreeOutput *out, uint node_count, __local uint *scratch) {
    uint merged = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += GROUP) {
        const uint i = begin + get_local_id(0);
        const uint at = i < block->alive_count ? block->alive[i] : 0;
        const bool is_first = i < block->alive_count && block->clusters[at].partner != NONE && block->clusters[at].partner > at;
        const uint rank = merged + scan_group(scratch, is_first, &total);
        if (is_first) commit_merge(block, out, at, out->node_base + node_count + rank);
        merged += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    return merged;
}

// Gives the triangles their new corners and drops those that have become lines; drops the clusters that are merged into others.
INLINED void compact_block(TreeBlock *block, __local uint *scratch) {
    const uint lid = get_local_id(0);
    uint kept = 0, total;
    for (uint begin = 0; begin < block->triangle_count; begin += GROUP) {
        const bool is_there = begin + lid < block->triangle_count;
        uint corners[3] = {0, 0, 0};
        for (uint i = 0; i < 3; i++)
            if (is_there) corners[i] = merged_corner(block, block->triangles[3 * (begin + lid) + i]);
        const bool is_kept = is_there && corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0];
        // Also the barrier between reading and writing.
        const uint to = kept + scan_group(scratch, is_kept, &total);
        barrier(CLK_GLOBAL_MEM_FENCE);
        for (uint i = 0; i < 3; i++)
            if (is_kept) block->triangles[3 * to + i] = corners[i];
        kept += total;
    }
    block->triangle_count = kept;
    uint left = 0;
    for (uint begin = 0; begin < block->alive_count; begin += GROUP) {
        const bool is_there = begin + lid < block->alive_count;
        const uint at = is_there ? block->alive[begin + lid] : 0;
        const bool is_kept = is_there && merged_corner(block, at) == at;
        const uint to = left + scan_group(scratch, is_kept, &total);
        barrier(CLK_GLOBAL_MEM_FENCE);
        if (is_kept) block->alive[to] = at;
        left += total;
    }
    block->alive_count = left;
    barrier(CLK_GLOBAL_MEM_FENCE);
}

#endif
