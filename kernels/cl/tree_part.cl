// tree_part: the connected parts of the full dual mesh, and the removal of some of them (docs/algorithm.md#82-removed-parts).
//
//   kernel              work-item   writes
//   tree_part_begin     a point     labels: each point is a part of its own
//   tree_part_join      a triangle  labels: the corners of each triangle are of one part
//   tree_part_flatten   a point     the first point of each point's part
//   tree_part_add       a triangle  area of each part, beside its first point
//   tree_part_spread    a point     area of each point's part
//   tree_part_remove    a point     whether its part is removed: small ones, and those that were chosen
//   tree_part_sum       a point     of each region, sums over the removed parts, and the remaining area
//   tree_part_mark      a point     marks the nodes of removed parts
//
// A *label* is the number of a point of the same part, the point's own or a smaller one. So labels lead to the first point of a part,
// whichever work-item comes first, and work-items join parts without waiting for each other: a label is only replaced by a smaller one of the
// same part, and a label that equals its own point only by compare-and-exchange, if it still does. While parts are joined, labels are read
// and written by atomic operations.
//
// Areas are summed as whole numbers of `quantum`, two words each, because such sums do not depend on the order. A triangle counts
// for at least one, so that only points without triangles have an area of 0.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/tree_leaf.h"
#include "lib/vertices.h"

__kernel void tree_part_begin(const uint count, __global uint *labels, __global uint2 *sums) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    labels[i] = i;
    sums[i] = (uint2)(0);
}

inline uint read_label(__global uint *labels, uint point) { return atomic_or(&labels[point], 0u); }

// The first point that a point's label leads to. Shortens the chain of labels for later look-ups.
inline uint first_of_part(__global uint *labels, uint point) {
    uint label = read_label(labels, point);
    while (label != point) {
        const uint next = read_label(labels, label);
        if (next != label) atomic_min(&labels[point], next);
        point = label;
        label = next;
    }
    return point;
}

inline void join_parts(__global uint *labels, uint a, uint b) {
    a = first_of_part(labels, a);
    b = first_of_part(labels, b);
    while (a != b) {
        const uint high = max(a, b), low = min(a, b);
        const uint found = atomic_cmpxchg(&labels[high], high, low);
        if (found == high) return;
        a = first_of_part(labels, found);
        b = first_of_part(labels, low);
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_part_join(__global const RegionMesh *meshes, __global const uint *corners, __global uint *labels) {
    const uint group = (uint)get_group_id(0), first = meshes[group].triangle_base, count = meshes[group].triangles[0];
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        __global const uint *at = corners + 3 * (first + i);
        join_parts(labels, at[0], at[1]);
        join_parts(labels, at[0], at[2]);
    }
}

__kernel void tree_part_flatten(const uint count, __global const uint *labels, __global uint *firsts) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    uint first = i;
    while (labels[first] != first) first = labels[first];
    firsts[i] = first;
}

// Area of a triangle in `quantum`.
inline uint triangle_quanta(const TreePartAddArgs args, __global const int4 *points, __global const uint *corners) {
    const float3 scale = (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]) / VERTEX_LATTICE;
    const int3 own = points[corners[0]].xyz;
    const float3 a = convert_float3(points[corners[1]].xyz - own) * scale, b = convert_float3(points[corners[2]].xyz - own) * scale;
    return max(convert_uint_sat_rte(0.5f * length(cross(a, b)) / args.quantum), 1u);
}

// Adds to a number of two words, the low one first.
inline void add_long(__global uint *to, ulong value) {
    const uint low = (uint)value, before = atomic_add(to, low);
    const uint high = (uint)(value >> 32) + (before + low < before ? 1u : 0u);
    if (high) atomic_add(to + 1, high);
}

// `firsts`: first point of each point's part. `sums`: two words a point. A work-item adds up triangles of one part before it adds
// them to the part: most of a region are of one.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_part_add(const TreePartAddArgs args, __global const RegionMesh *meshes, __global const uint *corners,
                   __global const int4 *points, __global const uint *firsts, __global uint *sums) {
    const uint group = (uint)get_group_id(0), first = meshes[group].triangle_base, count = meshes[group].triangles[0];
    uint part = NONE;
    ulong sum = 0;
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        __global const uint *at = corners + 3 * (first + i);
        const uint own = firsts[at[0]];
        if (own != part) {
            if (part != NONE) add_long(sums + 2 * part, sum);
            part = own;
            sum = 0;
        }
        sum += triangle_quanta(args, points, at);
    }
    if (part != NONE) add_long(sums + 2 * part, sum);
}

// `areas`: of each point's part, negative for the first point of a part; 0 of points without triangles.
__kernel void tree_part_spread(const uint count, const float quantum, __global const uint *firsts, __global const uint2 *sums,
                               __global float *areas) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const uint2 sum = sums[firsts[i]];
    const float area = quantum * (float)((ulong)sum.y << 32 | sum.x);
    areas[i] = firsts[i] == i && area > 0.0f ? -area : area;
}

// `chosen`: first points of the parts that were chosen. Points without triangles are of no part, and go with any that are removed.
__kernel void tree_part_remove(const TreePartRemoveArgs args, __global const uint *chosen, __global const uint *firsts,
                               __global const float *areas, __global uchar *removed) {
    const uint i = (uint)get_global_id(0);
    if (i >= args.points) return;
    uint is_chosen = 0;
    for (uint k = 0; k < args.chosen; k++)
        if (chosen[k] == firsts[i]) is_chosen = 1;
    const float area = fabs(areas[i]);
    removed[i] = area == 0.0f || area < args.min_area || is_chosen != args.keep;
}

// Of the triangles of marching cubes, those of a cell count for the part of its first sheet.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_part_sum(__global const Region *regions, __global const TreeRegion *tree_regions,
                   __global const RegionMesh *meshes, __global const uint *corners, __global const int4 *points,
                   __global const Node *nodes, __global const float *areas, __global const uchar *removed, __global TreePartSum *sums) {
    __local uint parts, triangles, full_triangles;
    __local float group_areas[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = meshes[group].triangle_base, count = meshes[group].triangles[0];
    TreePoints own;
    find_points(&own, regions + group, tree_regions + group);
    if (lid == 0) parts = triangles = full_triangles = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint own_parts = 0, own_triangles = 0, own_full = 0;
    float area = 0.0f;
    for (uint i = lid; i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i);
        const float own_area = fmin(areas[point], 0.0f);
        if (!removed[point]) {
            area -= own_area;
            continue;
        }
        if (own_area < 0.0f) own_parts++;
        if (i < regions[group].level_base[1]) own_full += nodes[(uint)points[point].w].count & 0xffu;
    }
    for (uint i = lid; i < count; i += GROUP)
        if (removed[corners[3 * (first + i)]]) own_triangles++;
    add_local(&parts, own_parts);
    add_local(&triangles, own_triangles);
    add_local(&full_triangles, own_full);
    group_areas[lid] = area;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid > 0) return;
    for (uint i = 1; i < GROUP; i++) area += group_areas[i];
    TreePartSum sum;
    sum.parts = parts;
    sum.triangles = triangles;
    sum.full_triangles = full_triangles;
    sum.area_left = area;
    sums[group] = sum;
}

// No tolerance merges nodes of removed parts, so they do not count for a budget.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_part_mark(__global const Region *regions, __global const TreeRegion *tree_regions,
                    __global const uint *node_parents, __global const uint *point_parents, __global const uchar *removed,
                    __global uchar *marks) {
    const uint group = (uint)get_group_id(0);
    TreePoints own;
    find_points(&own, regions + group, tree_regions + group);
    for (uint i = get_local_id(0); i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i);
        if (!removed[point]) continue;
        for (uint node = point_parents[point]; node != NONE; node = node_parents[node]) marks[node] = 1;
    }
}
