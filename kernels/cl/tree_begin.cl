// tree_begin: the clusters that blocks of the vertex tree begin with (docs/algorithm.md#7-vertex-tree). One work-group a block.
//
//   kernel      writes
//   tree_begin  clusters with their rings, quadrics and flags, and which of them may merge
//
// A kernel of its own: PoCL takes minutes to compile one that has the rounds of merges, too.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/octahedral.h"
#include "lib/scan.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"
#include "lib/tree_fans.h"
#include "lib/tree_leaf.h"
#include "lib/tree_work.h"

inline void add_plane(Quadric *q, float3 normal, float weight) {
    q->a[0] += weight * normal.x * normal.x;
    q->a[1] += weight * normal.x * normal.y;
    q->a[2] += weight * normal.x * normal.z;
    q->a[3] += weight * normal.y * normal.y;
    q->a[4] += weight * normal.y * normal.z;
    q->a[5] += weight * normal.z * normal.z;
}

// Adds the plane through the edge from a point on the border to `other`, at right angles to the triangle with this normal.
inline void add_border_plane(const TreeBlock *block, Quadric *quadric, uint at, uint other, float3 normal) {
    const float3 edge = end_position(block, other).xyz - cluster_position(block, at);
    const float3 across = cross(edge, normal);
    const float length2 = dot(across, across);
    if (length2 > 0.0f)
        add_plane(quadric, across, BORDER_WEIGHT * exact_quotient(dot(edge, edge), length2));
}

inline bool is_on_border(const TreeBuildArgs args, uint cell_points, uint at) {
    return at & FOREIGN ? (at & ~FOREIGN) >= args.cell_points : at >= cell_points;
}

// Flags of a point whose triangles lie like this. `beside`, `end`: its first and its last neighbour.
inline uint point_flags(const TreeBuildArgs args, uint kind, uint at, uint cell_points, uint beside, uint end, int3 position, int3 last) {
    if (at < cell_points) return kind == FAN_CLOSED ? 0 : CLUSTER_LOCKED;
    if (kind != FAN_OPEN || !is_on_border(args, cell_points, beside) || !is_on_border(args, cell_points, end)) return CLUSTER_LOCKED;
    const int3 is_low = position == (int3)(0), is_high = position == last * (int)VERTEX_LATTICE;
    const uint low = (is_low.x ? 1u : 0) | (is_low.y ? 2u : 0) | (is_low.z ? 4u : 0);
    const uint high = (is_high.x ? 1u : 0) | (is_high.y ? 2u : 0) | (is_high.z ? 4u : 0);
    return CLUSTER_BORDER | low | high << CLUSTER_HIGH;
}

// Clusters that have risen from the blocks below: positions in the volume, and flags.
typedef struct {
    __global const int4 *points;
    uint first; // of the block's
} TreeRisen;

inline bool is_risen_border(const TreeRisen *risen, uint at) {
    return (uint)risen->points[at & FOREIGN ? at & ~FOREIGN : risen->first + at].w & CLUSTER_BORDER;
}

// Begins a cluster's ring, of `count` triangles.
inline void begin_ring(const TreeBlock *block, uint at, uint ring, uint count, uint flags) {
    // Not yet into the position's w: other work-items still read the position.
    block->best[at] = flags;
    for (uint i = 0; i <= count; i++) block->costs[ring + i] = INFINITY;
    block->clusters[at].ring_first = ring;
    block->clusters[at].ring_count = flags & CLUSTER_LOCKED ? 0 : count + (flags & CLUSTER_BORDER ? 1 : 0);
}

// Derives a point's ring, its quadric and its flags (on a border, may not merge) from the triangles around it. `last`: of the volume's
// samples.
INLINED void classify_point(const TreeBuildArgs args, const TreeBlock *block, const TreeFans *fans, uint at, uint cell_points,
                            int3 position, int3 last) {
    __global TreeCluster *cluster = block->clusters + at;
    __global TreeMembers *members = block->members + at;
    __global const uint *corners = fans->corners + cluster->ring_first;
    const uint count = cluster->ring_count, ring = cluster->ring_first + at;
    const float3 own = cluster_position(block, at);
    Quadric quadric = no_quadric();
    float3 begin_normal = (float3)(0.0f), end_normal = (float3)(0.0f);
    uint begin, end = NONE;
    const uint kind = make_ring(fans, corners, count, block->rings + ring, &begin, &end);
    for (uint i = 0; i < count; i++) {
        const uint before = fans->triangles[previous_corner(corners[i])];
        const float3 normal = cross(end_position(block, fans->triangles[next_corner(corners[i])]).xyz - own,
                                    end_position(block, before).xyz - own);
        const float length = sqrt(dot(normal, normal));
        if (length > 0.0f) add_plane(&quadric, normal, exact_quotient(1.0f, 6.0f * length));
        quadric.k += length / 6.0f;
        if (i == begin) begin_normal = normal;
        if (before == end) end_normal = normal;
    }
    const float area = quadric.k;
    members->s *= area;
    members->f *= area;
    for (uint i = 0; i < 3; i++) members->normal[i] *= area;
    const uint beside = kind == FAN_OPEN ? block->rings[ring] : NONE;
    const uint flags = point_flags(args, kind, at, cell_points, beside, end, position, last);
    if (flags & CLUSTER_BORDER) {
        add_border_plane(block, &quadric, at, beside, begin_normal);
        add_border_plane(block, &quadric, at, end, end_normal);
    }
    begin_ring(block, at, ring, count, flags);
    cluster->quadric = quadric;
}

// Whether a ring has a neighbour twice.
inline bool repeats(__global const uint *ring, uint count) {
    for (uint i = 1; i < count; i++)
        for (uint k = 0; k < i; k++)
            if (ring[i] == ring[k]) return true;
    return false;
}

// Flags of a cluster of which blocks below have made parts: it merges no further if two of them, merging at the same time, have joined the
// surface there along more than one line.
inline uint risen_flags(const TreeRisen *risen, uint flags, uint kind, __global const uint *ring, uint count, uint end) {
    const bool on_border = flags & CLUSTER_BORDER;
    const bool fits = on_border ? kind == FAN_OPEN && is_risen_border(risen, ring[0]) && is_risen_border(risen, end)
                                : kind == FAN_CLOSED && count >= 3;
    return fits && !repeats(ring, count + on_border) ? flags : flags | CLUSTER_LOCKED;
}

// Derives the ring of a cluster that has risen from a block below. Its quadric is complete.
INLINED void classify_cluster(const TreeBlock *block, const TreeFans *fans, const TreeRisen *risen, uint at) {
    __global TreeCluster *cluster = block->clusters + at;
    const uint count = cluster->ring_count, ring = cluster->ring_first + at;
    uint begin, end = NONE, flags = (uint)risen->points[risen->first + at].w;
    const uint kind = make_ring(fans, fans->corners + cluster->ring_first, count, block->rings + ring, &begin, &end);
    if (!(flags & CLUSTER_LOCKED)) flags = risen_flags(risen, flags, kind, block->rings + ring, count, end);
    begin_ring(block, at, ring, count, flags);
}

// Begins the cluster of a point. The data that depends on its triangles is added later.
INLINED void begin_point(const TreeBlock *block, __global const Node *nodes, __global const VertexRecord *vertex_records, uint at,
                         int4 point) {
    __global TreeMembers *members = block->members + at;
    const Node node = nodes[(uint)point.w];
    const float3 normal = decode_octahedral8(vertex_records[(uint)point.w].normal);
    members->normal[0] = normal.x;
    members->normal[1] = normal.y;
    members->normal[2] = normal.z;
    members->s = node.s;
    members->f = node.f;
    // Of an extra sheet, the code is that of its cell.
    members->extent = extent_of_cell(unmorton(code_cell(meta_code(node.meta), 0)));
}

INLINED void begin_cluster(const TreeBlock *block, uint at, int3 position) {
    const float3 from_corner = convert_float3(position - block->origin * (int)VERTEX_LATTICE) * block->scale;
    block->positions[at] = block->merged_positions[at] = (float4)(from_corner, 0.0f);
    block->members[at].node = NONE;
    block->members[at].changes = 0;
}

// Whether a cluster has no merge to expect in its block: it is locked, or it is one of four that are all that is left of a part.
inline bool is_idle(const TreeBlock *block, uint at) {
    const uint count = block->clusters[at].ring_count;
    if (count == 0) return true;
    if (count != 3 || cluster_flags(block, at) & CLUSTER_BORDER) return false;
    __global const uint *ring = block->rings + block->clusters[at].ring_first;
    for (uint i = 0; i < 3; i++)
        if (ring[i] & FOREIGN || block->clusters[ring[i]].ring_count != 3 || cluster_flags(block, ring[i]) & CLUSTER_BORDER) return false;
    return true;
}

// Lists the clusters of a block: those that may merge, and from the end on the idle ones.
INLINED void list_clusters(TreeBlock *block, __local uint *scratch) {
    const uint lid = get_local_id(0), count = block->alive_count;
    uint active = 0, total;
    for (uint begin = 0; begin < count; begin += WIDE_GROUP) {
        const uint i = begin + lid;
        const bool is_active = i < count && !is_idle(block, i);
        const uint before = active + scan_group(scratch, is_active, &total);
        active += total;
        if (i >= count) continue;
        block->alive[is_active ? before : count - 1 - (i - before)] = i;
        block->partners[i] = is_active ? i : NONE;
        if (WIDE_GROUP == 1 && is_active) block->best[before] = i; // new_list: all are new
    }
    block->alive_count = block->new_count = active;
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Of the surface, as in tree_begin; `cluster_parents`: of the block.
typedef struct {
    __global const Node *nodes;
    __global const VertexRecord *vertex_records;
    __global const int4 *points;
    __global const TreeCluster *risen_clusters;
    __global const TreeMembers *risen_members;
    __global uint *cluster_parents;
} BeginBuffers;

// Makes a cluster of each point of a region, or of each cluster that has risen into a block, with its ring and quadric.
INLINED void begin_clusters(const TreeBuildArgs args, const BeginBuffers *all, TreeBlock *block, const TreeFans *fans, TreePoints own,
                            __local uint *scratch) {
    const uint lid = get_local_id(0), count = block->alive_count;
    const int3 last = (int3)((int)args.grid.dims[0], (int)args.grid.dims[1], (int)args.grid.dims[2]) - 1;
    const TreeRisen risen = {all->points, own.first};
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        const uint point = nth_point(own, i);
        if (args.level) {
            block->clusters[i].quadric = all->risen_clusters[point].quadric;
            block->members[i] = all->risen_members[point];
        } else {
            begin_point(block, all->nodes, all->vertex_records, i, all->points[point]);
        }
        begin_cluster(block, i, all->points[point].xyz);
        all->cluster_parents[i] = NONE;
    }
    make_fans(block, fans, scratch);
    for (uint i = lid; i < count; i += WIDE_GROUP)
        if (args.level) classify_cluster(block, fans, &risen, i);
        else classify_point(args, block, fans, i, own.count, all->points[nth_point(own, i)].xyz, last);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += WIDE_GROUP) block->positions[i].w = as_float(block->best[i]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    list_clusters(block, scratch);
}

// Working memory (lib/tree_work.h): of the launch's blocks; the second half of a block's `rings` holds the corners around each cluster.
// `points`: at level 0 of the surface, above the risen clusters: position, flags. `triangles`: those around each block, block by block.
// `cluster_parents`: receives NONE.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_begin(const TreeBuildArgs args, __global const Region *regions, __global const Node *nodes,
                __global const VertexRecord *vertex_records, __global const int4 *points, __global const TreeCluster *risen_clusters,
                __global const TreeMembers *risen_members, __global TreeRegion *tree_regions, __global const uint *triangles,
                __global uint *rings, __global float *costs, __global TreeCluster *clusters, __global TreeMembers *members,
                __global float4 *positions, __global float4 *merged_positions, __global uint *lists, __global uint *cluster_parents) {
    __local uint scratch[WIDE_GROUP];
    const uint group = args.first_region + (uint)get_group_id(0);
    __global TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_points(&own, regions + group, tree);
    const uint count = count_points(own);
    const TreeWork work = {rings, costs, clusters, members, positions, merged_positions, lists};
    const BeginBuffers all = {nodes, vertex_records, points, risen_clusters, risen_members, cluster_parents + tree->cluster_base};
    TreeBlock block = find_block(args, &work, regions + group, tree, points, count);
    block.alive_count = count;
    const TreeFans fans = {triangles + 3 * tree->triangle_base, block.next_rings, tree->triangle_count};
    begin_clusters(args, &all, &block, &fans, own, scratch);
    if (get_local_id(0) > 0) return;
    float area = 0.0f;
    for (uint i = 0; i < count && args.level == 0; i++) area += block.clusters[i].quadric.k;
    if (args.level == 0) tree->area = area;
    tree->clusters = count;
    tree->idle = count - block.alive_count;
    tree->fresh = block.new_count;
}
