// The triangles around each point of a block, before anything is merged.
#ifndef ISOPEEL_TREE_FANS_H
#define ISOPEEL_TREE_FANS_H

#include "lib/precision.h"
#include "lib/corners.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/scan.h"
#include "lib/tree_block.h"

typedef struct {
    __global const uint *triangles; // three corners each
    __global uint *corners;         // point by point, from TreeCluster::ring_first on: numbers of corners in `triangles`
    uint triangle_count;
} TreeFans;

// Lists the corners of each point, in order, so that sums do not depend on timing.
INLINED void make_fans(const TreeBlock *block, const TreeFans *fans, __local uint *scratch) {
    const uint lid = get_local_id(0), count = block->alive_count;
    __global TreeCluster *clusters = block->clusters;
    for (uint i = lid; i < count; i += WIDE_GROUP) clusters[i].ring_count = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < 3 * fans->triangle_count; i += WIDE_GROUP) {
        const uint at = fans->triangles[i];
        if (!(at & FOREIGN)) add_global(&clusters[at].ring_count, 1);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    uint before = 0, total;
    for (uint begin = 0; begin < count; begin += WIDE_GROUP) {
        const uint i = begin + lid;
        const uint first = before + scan_group(scratch, i < count ? clusters[i].ring_count : 0, &total);
        if (i < count) {
            clusters[i].ring_first = first;
            clusters[i].ring_count = 0;
        }
        before += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < 3 * fans->triangle_count; i += WIDE_GROUP) {
        const uint at = fans->triangles[i];
        if (at & FOREIGN) continue;
        const uint rank = add_global(&clusters[at].ring_count, 1);
        fans->corners[clusters[at].ring_first + rank] = i;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
#if WIDE_GROUP > 1
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        __global uint *fan = fans->corners + clusters[i].ring_first;
        for (uint k = 1; k < clusters[i].ring_count; k++) {
            const uint corner = fan[k];
            uint to = k;
            for (; to > 0 && fan[to - 1] > corner; to--) fan[to] = fan[to - 1];
            fan[to] = corner;
        }
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
#endif
}

// How the triangles around a point lie.
#define FAN_OTHER 0u  // none, or more than one fan
#define FAN_CLOSED 1u
#define FAN_OPEN 2u

#if WIDE_GROUP == 1
// The ring of a point with up to 16 corners whose fan is closed. Returns whether that is so.
inline bool make_closed_ring(const TreeFans *fans, __global const uint *corners, uint count, __global uint *ring) {
    if (count > 16) return false;
    uint next[16], previous[16], following[16];
    for (uint i = 0; i < count; i++) {
        next[i] = fans->triangles[next_corner(corners[i])];
        previous[i] = fans->triangles[previous_corner(corners[i])];
    }
    // For each triangle, the one that begins at its end.
    const uint16 ends = vload16(0, previous);
    uint16 found = NONE;
    for (uint i = count; i-- > 0;) found = select(found, (uint16)(i), ends == next[i]);
    vstore16(found, 0, following);
    uint at = 0;
    for (uint i = 0; i < count; i++) {
        ring[i] = next[at];
        at = following[at];
        if (at >= count || at == 0) return at == 0 && i + 1 == count;
    }
    return false;
}
#endif

// Writes the ring of a point with these corners, up to one entry more than there are corners. `begin`, `end`: receive the index of the
// first triangle and the last neighbour.
inline uint make_ring(const TreeFans *fans, __global const uint *corners, uint count, __global uint *ring, uint *begin, uint *end) {
    bool open = false;
    *begin = 0;
#if WIDE_GROUP == 1
    if (make_closed_ring(fans, corners, count, ring)) return FAN_CLOSED;
#endif
    for (uint i = 0; i < count; i++) {
        const uint at = fans->triangles[next_corner(corners[i])];
        bool found = false;
        for (uint k = 0; k < count && !found; k++) found = fans->triangles[previous_corner(corners[k])] == at;
        if (found) continue;
        open = true;
        *begin = i;
    }
    uint steps = 0, at = *begin;
    while (at < count && steps < count) {
        ring[steps++] = fans->triangles[next_corner(corners[at])];
        *end = fans->triangles[previous_corner(corners[at])];
        for (at = 0; at < count; at++)
            if (fans->triangles[next_corner(corners[at])] == *end) break;
        if (at == *begin) break;
    }
    if (count == 0 || steps < count || (at == count) != open) return FAN_OTHER;
    if (open) ring[count] = *end;
    return open ? FAN_OPEN : FAN_CLOSED;
}

#endif
