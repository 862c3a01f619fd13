// The mesh of one block, a region, while its vertex tree is built: clusters, triangles, and the fans of triangles around clusters.
//
// Clusters are numbered by one of their points: cells, extra sheets, then points on the volume's faces. Points of other regions do
// not merge here; a corner at one has FOREIGN beside the point's number in the whole surface.
#ifndef ISOPEEL_TREE_BLOCK_H
#define ISOPEEL_TREE_BLOCK_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_cluster.h"

#define FOREIGN 0x80000000u
#define MAX_FAN 60       // triangles around a cluster that merges
#define MIN_TURN 0.2f    // cosine of the angle by which a triangle may turn

typedef struct {
    __global TreeCluster *clusters;
    __global uint *triangles;        // three corners each
    __global uint *fans;             // corner by corner: of cluster c from clusters[c].fan_first on, numbers of corners in `triangles`
    __global float *costs;           // of the edge from the cluster to the next corner, beside `fans`
    __global uint *alive;            // clusters that are left, in order
    __global const int4 *points;     // positions of all points of the surface
    int3 origin;                     // of the region
    float3 scale;                    // world units of 1/VERTEX_LATTICE cell
    uint alive_count, triangle_count;
} TreeBlock;

// Corners of a triangle after and before one of them.
inline uint next_corner(uint corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
inline uint previous_corner(uint corner) { return corner % 3 == 0 ? corner + 2 : corner - 1; }

// Position of a cluster or of another region's point, world units from the region's low corner.
inline float3 end_position(const TreeBlock *block, uint at) {
    if (!(at & FOREIGN)) return cluster_position(block->clusters + at);
    return convert_float3(block->points[at & ~FOREIGN].xyz - block->origin * (int)VERTEX_LATTICE) * block->scale;
}

// The i-th neighbour of a cluster: the corner after it in the i-th triangle of its fan.
inline uint neighbour(const TreeBlock *block, uint cluster, uint i) {
    return block->triangles[next_corner(block->fans[block->clusters[cluster].fan_first + i])];
}

// Of a cluster on the border the neighbour that is after it in no triangle; NONE where there is none.
inline uint last_neighbour(const TreeBlock *block, uint cluster) {
    const uint count = block->clusters[cluster].fan_count, first = block->clusters[cluster].fan_first;
    for (uint i = 0; i < count; i++) {
        const uint before = block->triangles[previous_corner(block->fans[first + i])];
        bool found = false;
        for (uint k = 0; k < count && !found; k++) found = neighbour(block, cluster, k) == before;
        if (!found) return before;
    }
    return NONE;
}

inline bool is_neighbour(const TreeBlock *block, uint cluster, uint of) {
    const uint count = block->clusters[cluster].fan_count;
    for (uint i = 0; i < count; i++)
        if (neighbour(block, cluster, i) == of) return true;
    return (block->clusters[cluster].flags & CLUSTER_BORDER) && last_neighbour(block, cluster) == of;
}

// Triangles around `cluster` that have `other` as a corner.
inline uint shared_triangles(const TreeBlock *block, uint cluster, uint other) {
    const uint count = block->clusters[cluster].fan_count, first = block->clusters[cluster].fan_first;
    uint shared = 0;
    for (uint i = 0; i < count; i++) {
        const uint corner = block->fans[first + i];
        shared += block->triangles[next_corner(corner)] == other || block->triangles[previous_corner(corner)] == other;
    }
    return shared;
}

inline uint common_neighbours(const TreeBlock *block, uint a, uint b) {
    const uint count = block->clusters[a].fan_count;
    uint common = 0;
    for (uint i = 0; i < count; i++) {
        const uint other = neighbour(block, a, i);
        common += other != b && is_neighbour(block, b, other);
    }
    if (block->clusters[a].flags & CLUSTER_BORDER) {
        const uint other = last_neighbour(block, a);
        common += other != NONE && other != b && is_neighbour(block, b, other);
    }
    return common;
}

// Whether a triangle around `cluster`, but for those with `other`, turns too far where the cluster moves to `to`.
inline bool turns_triangle(const TreeBlock *block, uint cluster, uint other, float3 to) {
    const uint count = block->clusters[cluster].fan_count, first = block->clusters[cluster].fan_first;
    const float3 from = cluster_position(block->clusters + cluster);
    for (uint i = 0; i < count; i++) {
        const uint corner = block->fans[first + i];
        const uint p = block->triangles[next_corner(corner)], q = block->triangles[previous_corner(corner)];
        if (p == other || q == other) continue;
        const float3 at_p = end_position(block, p), at_q = end_position(block, q);
        const float3 before = cross(at_p - from, at_q - from), after = cross(at_p - to, at_q - to);
        const float turn = dot(before, after);
        if (turn < 0.0f || turn * turn < MIN_TURN * MIN_TURN * dot(before, before) * dot(after, after)) return true;
    }
    return false;
}

// Whether merging keeps the surface's topology (the link condition: two common neighbours, on the border one) and turns no triangle.
// `a` before `b`.
INLINED bool may_merge(const TreeBlock *block, uint a, uint b) {
    __global const TreeCluster *first = block->clusters + a, *second = block->clusters + b;
    if (first->fan_count > MAX_FAN || second->fan_count > MAX_FAN) return false;
    const bool both_on_border = first->flags & second->flags & CLUSTER_BORDER;
    if (both_on_border && shared_triangles(block, a, b) != 1) return false;
    if (common_neighbours(block, a, b) != (both_on_border ? 1u : 2u)) return false;
    const uint smallest = both_on_border ? 1 : 3; // the fans of a tetrahedron, and of a single triangle
    if (first->fan_count == smallest && second->fan_count == smallest) return false;
    const float3 to = cluster_position(first) + merge_clusters(first, second).to;
    return !turns_triangle(block, a, b, to) && !turns_triangle(block, b, a, to);
}

// Makes the fans of the clusters that are left. `sorted`: by number of their corners, so that sums do not depend on timing.
INLINED void make_fans(const TreeBlock *block, bool sorted, __local uint *scratch) {
    const uint lid = get_local_id(0);
    __global TreeCluster *clusters = block->clusters;
    for (uint i = lid; i < block->alive_count; i += GROUP) clusters[block->alive[i]].fan_count = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < 3 * block->triangle_count; i += GROUP) {
        const uint at = block->triangles[i];
        if (!(at & FOREIGN)) add_global(&clusters[at].fan_count, 1);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    uint before = 0, total;
    for (uint begin = 0; begin < block->alive_count; begin += GROUP) {
        const bool is_alive = begin + lid < block->alive_count;
        __global TreeCluster *cluster = clusters + (is_alive ? block->alive[begin + lid] : 0);
        const uint first = before + scan_group(scratch, is_alive ? cluster->fan_count : 0, &total);
        if (is_alive) {
            cluster->fan_first = first;
            cluster->fan_count = 0;
        }
        before += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < 3 * block->triangle_count; i += GROUP) {
        const uint at = block->triangles[i];
        if (at & FOREIGN) continue;
        const uint place = add_global(&clusters[at].fan_count, 1);
        block->fans[clusters[at].fan_first + place] = i;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    if (!sorted) return;
    for (uint i = lid; i < block->alive_count; i += GROUP) {
        __global TreeCluster *cluster = clusters + block->alive[i];
        __global uint *fan = block->fans + cluster->fan_first;
        for (uint k = 1; k < cluster->fan_count; k++) {
            const uint corner = fan[k];
            uint to = k;
            for (; to > 0 && fan[to - 1] > corner; to--) fan[to] = fan[to - 1];
            fan[to] = corner;
        }
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
}

#endif
