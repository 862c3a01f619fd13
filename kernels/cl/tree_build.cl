// tree_build: the nodes of the vertex tree (docs/algorithm.md#7-vertex-tree). One work-group a region.
//
//   kernel      writes
//   tree_build  the nodes, the parents of nodes and points
//
// A region is a *block*: points merge only with points of the same block, so that blocks do not wait for each other.

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
#include "lib/tree_rounds.h"

#define MIN_PROGRESS 64 // the last round is the first that merges less than 1 / MIN_PROGRESS of the clusters

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
    // Not yet into the position's w: other work-items still read the position.
    block->best[at] = flags;
    for (uint i = 0; i <= count; i++) block->costs[ring + i] = INFINITY;
    cluster->quadric = quadric;
    cluster->ring_first = ring;
    cluster->ring_count = flags & CLUSTER_LOCKED ? 0 : count + (flags & CLUSTER_BORDER ? 1 : 0);
}

// Begins the cluster of a point. The data that depends on its triangles is added later.
INLINED void begin_cluster(const TreeBlock *block, __global const Node *nodes, __global const VertexRecord *vertex_records, uint at,
                           int4 point) {
    __global TreeMembers *members = block->members + at;
    const Node node = nodes[(uint)point.w];
    const float3 position = convert_float3(point.xyz - block->origin * (int)VERTEX_LATTICE) * block->scale;
    const float3 normal = decode_octahedral8(vertex_records[(uint)point.w].normal);
    block->positions[at] = block->merged_positions[at] = (float4)(position, 0.0f);
    members->normal[0] = normal.x;
    members->normal[1] = normal.y;
    members->normal[2] = normal.z;
    members->s = node.s;
    members->f = node.f;
    members->node = NONE;
    // Of an extra sheet, the code is that of its cell.
    members->extent = extent_of_cell(unmorton(code_cell(meta_code(node.meta), 0)));
    block->alive[at] = at;
    block->partners[at] = at;
    members->changes = 0;
}

// Buffers of tree_build, as there.
typedef struct {
    __global const Region *regions;
    __global const Node *nodes;
    __global const VertexRecord *vertex_records;
    __global const int4 *points;
    __global TreeRegion *tree_regions;
    __global const uint *triangles;
    __global uint *rings;
    __global float *costs;
    __global TreeCluster *clusters;
    __global TreeMembers *members;
    __global float4 *positions, *merged_positions;
    __global uint *lists;
    __global TreeNode *tree_nodes;
    __global uint *node_errors;
    __global uchar *node_levels;
    __global uint *node_parents, *point_parents, *round_ends;
} TreeBuffers;

// The working memory of a region with `count` points.
INLINED TreeBlock find_block(const Grid grid, const TreeBuffers *all, uint group, uint count) {
    __global const TreeRegion *tree = all->tree_regions + group;
    const uint entries = 3 * tree->triangle_count + count, entry_base = 2 * (3 * tree->triangle_base + tree->cluster_base);
    TreeBlock block;
    block.clusters = all->clusters + tree->cluster_base;
    block.members = all->members + tree->cluster_base;
    block.positions = all->positions + tree->cluster_base;
    block.merged_positions = all->merged_positions + tree->cluster_base;
    block.rings = all->rings + entry_base;
    block.next_rings = block.rings + entries;
    block.costs = all->costs + entry_base;
    block.next_costs = block.costs + entries;
    block.alive = all->lists + 3 * tree->cluster_base;
    block.best = block.alive + count;
    block.partners = block.best + count;
    block.points = all->points;
    block.origin = convert_int3(region_origin(grid, all->regions[group].region));
    block.scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / VERTEX_LATTICE;
    block.alive_count = count;
#if WIDE_GROUP == 1
    block.new_count = count;
#endif
    return block;
}

// Output buffers for the nodes of a region. `last`: the volume's last sample.
INLINED TreeOutput find_output(const TreeBuildArgs args, const TreeBuffers *all, uint group, uint cell_points, int3 origin, int3 last) {
    __global const TreeRegion *tree = all->tree_regions + group;
    const int3 margin = (int3)(args.params.cap ? 1 : 0);
    TreeOutput out;
    out.nodes = all->tree_nodes;
    out.node_errors = all->node_errors;
    out.node_levels = all->node_levels;
    out.node_parents = all->node_parents;
    out.point_parents = all->point_parents + all->regions[group].point_base;
    out.border_parents = all->point_parents + tree->border_base;
    out.cell_points = cell_points;
    out.region = group;
    out.node_base = tree->node_base;
    out.low = max((int3)(0), (margin - origin) * (int)VERTEX_LATTICE);
    out.high = min((int3)(32), last - margin - origin) * (int)VERTEX_LATTICE;
    out.per_length = exact_quotient(1.0f, fmin(fmin(args.grid.spacing[0], args.grid.spacing[1]), args.grid.spacing[2]));
    return out;
}

// Makes a cluster of each point of a region, with its ring and quadric.
INLINED void begin_clusters(const TreeBuildArgs args, const TreeBuffers *all, const TreeBlock *block, uint group, TreePoints own, int3 last,
                            __local uint *scratch) {
    const uint lid = get_local_id(0), count = block->alive_count;
    __global const TreeRegion *tree = all->tree_regions + group;
    TreeFans fans;
    fans.triangles = all->triangles + 3 * tree->triangle_base;
    fans.triangle_count = tree->triangle_count;
    fans.corners = block->next_rings;
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        const uint point = nth_point(own, i);
        begin_cluster(block, all->nodes, all->vertex_records, i, all->points[point]);
        all->point_parents[point] = NONE;
    }
    make_fans(block, &fans, scratch);
    for (uint i = lid; i < count; i += WIDE_GROUP)
        classify_point(args, block, &fans, i, own.count, all->points[nth_point(own, i)].xyz, last);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        block->positions[i].w = as_float(block->best[i]);
        if (WIDE_GROUP == 1) block->best[i] = i; // all are new
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
}

// Builds the tree of a region.
INLINED void build_region(const TreeBuildArgs args, const TreeBuffers *all, uint group, __local uint *scratch, __local uint *failed_count) {
    const uint lid = get_local_id(0);
    __global TreeRegion *tree = all->tree_regions + group;
    TreePoints own;
    find_points(&own, all->regions + group, tree);
    const uint count = count_points(own);
    const int3 last = (int3)((int)args.grid.dims[0], (int)args.grid.dims[1], (int)args.grid.dims[2]) - 1;
    TreeBlock block = find_block(args.grid, all, group, count);
    begin_clusters(args, all, &block, group, own, last, scratch);
    float area = 0.0f;
    if (lid == 0)
        for (uint i = 0; i < count; i++) area += block.clusters[i].quadric.k;

    const TreeOutput out = find_output(args, all, group, own.count, block.origin, last);
    uint node_count = 0, rounds = 0;
    while (rounds < TREE_ROUNDS) {
        find_pairs(&block, failed_count);
        const uint merged = commit_pairs(&block, &out, node_count, scratch), before = block.alive_count;
        node_count += merged;
        if (lid == 0) all->round_ends[TREE_ROUNDS * group + rounds] = node_count;
        rounds++;
        compact_block(&block, scratch);
        if (merged * MIN_PROGRESS < before || merged == 0) break;
    }
    if (lid > 0) return;
    tree->nodes = node_count;
    tree->rounds = rounds;
    tree->area = area;
}

// Working memory: of the launch's regions. `rings`: two a region, `costs` beside them; the second one holds the corners around each
// point at first. `lists`: three numbers a cluster. `tree_nodes`: from TreeRegion::node_base on; `round_ends`: how many of them there
// are after each round. `order`, `claimed`: of each launch its regions, and at its first one how many of them have been begun.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_build(const TreeBuildArgs args, __global const Region *regions, __global const Node *nodes,
                __global const VertexRecord *vertex_records, __global const int4 *points, __global TreeRegion *tree_regions,
                __global const uint *order, __global uint *claimed, __global const uint *triangles, __global uint *rings,
                __global float *costs, __global TreeCluster *clusters, __global TreeMembers *members, __global float4 *positions,
                __global float4 *merged_positions, __global uint *lists, __global TreeNode *tree_nodes, __global uint *node_errors,
                __global uchar *node_levels, __global uint *node_parents, __global uint *point_parents, __global uint *round_ends) {
    __local uint scratch[WIDE_GROUP], failed_count;
    const TreeBuffers all = {
        regions, nodes, vertex_records, points, tree_regions, triangles, rings, costs, clusters, members, positions, merged_positions,
        lists, tree_nodes, node_errors, node_levels, node_parents, point_parents, round_ends,
    };
#if WIDE_GROUP == 1
    // Takes one region of the launch after another, the longest first. Work-groups are not bound to regions, because a driver may assign half
    // of the work-groups to one core of two in advance, however long they take.
    for (;;) {
        const uint n = atomic_inc(claimed + args.first_region);
        if (n >= get_num_groups(0)) return;
        build_region(args, &all, order[args.first_region + n], scratch, &failed_count);
    }
#else
    (void)order, (void)claimed;
    build_region(args, &all, args.first_region + (uint)get_group_id(0), scratch, &failed_count);
#endif
}
