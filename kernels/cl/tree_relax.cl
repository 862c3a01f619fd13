// tree_relax: how far the nodes of a cut of the vertex tree move (docs/algorithm.md#83-relaxation). One work-group a region.
//
//   kernel        writes
//   tree_offsets  of each node the sums of the offsets around it

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/tree_around.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"
#include "lib/tree_offset.h"

// What a work-group reads of the tree, the full mesh and the cut, and the sums that it adds to.
typedef struct {
    Grid grid;
    uint point_count, first_above;
    int3 origin; // of the region
    CutView cut;
    __global const Region *regions;
    __global const TreeRegion *tree;
    __global const TreeNode *nodes;
    __global const int4 *points;
    __global uint *sums;
} RelaxedCut;

// At most LANES triangles of a cut. Positions: from the region's low corner, 1/VERTEX_LATTICE cell.
typedef struct {
    uint count;
    uint numbers[LANES]; // in the full mesh
    CutTriangle triangles[LANES];
    float leaves[9 * LANES]; // x, y, z of three leaves
    float points[3 * LANES]; // of the full mesh, summed up
    float offsets[LANES];
} LaneTriangles;

INLINED int3 point_position(const RelaxedCut *in, uint point) { return in->points[point].xyz - in->origin * (int)VERTEX_LATTICE; }

INLINED int3 leaf_position(const RelaxedCut *in, uint leaf) {
    if (leaf < in->point_count) return point_position(in, leaf);
    const TreeNode node = in->nodes[leaf - in->point_count];
    return tree_position(node) + (tree_node_origin(in->grid, in->regions, node) - in->origin) * (int)VERTEX_LATTICE;
}

// Adds an offset to the sums of a triangle's nodes. Only this work-group adds to the first sum of the region's own nodes.
INLINED void add_offset_around(const RelaxedCut *in, const CutTriangle *triangle, int offset) {
    const uint leaves[3] = {triangle->a, triangle->b, triangle->c};
    for (uint k = 0; k < 3; k++) {
        if (leaves[k] < in->point_count) continue;
        const uint node = leaves[k] - in->point_count;
        if (leaves[k] >= in->first_above) {
            atomic_inc(&in->sums[2 * node]);
            atomic_add(&in->sums[2 * node + 1], (uint)offset);
        } else if (node - in->tree->node_base < in->tree->nodes) {
            add_global(&in->sums[2 * node], pack_offset(offset));
        } else {
            atomic_add(&in->sums[2 * node + 1], pack_offset(offset));
        }
    }
}

// Finds the triangles to measure among `count` of a region. `left`: their numbers. Those of level 0 are as fine as the full mesh: their offset
// is 0.
INLINED void find_triangles(LaneTriangles *lanes, const RelaxedCut *in, __global const uint *left, uint count) {
    lanes->count = 0;
    for (uint i = 0; i < count; i++) {
        CutTriangle *triangle = lanes->triangles + lanes->count;
        nth_triangle(triangle, &in->cut, left[i]);
        if (triangle->level == 0) {
            add_offset_around(in, triangle, 0);
            continue;
        }
        lanes->numbers[lanes->count++] = left[i];
        const uint leaves[3] = {triangle->a, triangle->b, triangle->c};
        for (uint k = 0; k < 3; k++)
            if (leaves[k] >= in->point_count) prefetch_line(in->nodes + leaves[k] - in->point_count);
    }
}

// Loads the positions of triangles. Those of lanes past the end are the last one's.
INLINED void load_positions(LaneTriangles *lanes, const RelaxedCut *in) {
    for (uint i = 0; i < LANES; i++) {
        const uint from = min(i, lanes->count - 1);
        const CutTriangle triangle = lanes->triangles[from];
        const int3 at[3] = {leaf_position(in, triangle.a), leaf_position(in, triangle.b), leaf_position(in, triangle.c)};
        __global const uint *corners = in->cut.corners + 3 * lanes->numbers[from];
        const int3 sum = point_position(in, corners[0]) + point_position(in, corners[1]) + point_position(in, corners[2]);
        for (uint k = 0; k < 3; k++) {
            lanes->leaves[3 * k * LANES + i] = (float)at[k].x;
            lanes->leaves[(3 * k + 1) * LANES + i] = (float)at[k].y;
            lanes->leaves[(3 * k + 2) * LANES + i] = (float)at[k].z;
        }
        lanes->points[i] = (float)sum.x;
        lanes->points[LANES + i] = (float)sum.y;
        lanes->points[2 * LANES + i] = (float)sum.z;
    }
}

INLINED Real3 scaled_difference(Real3 a, Real3 b, float3 scale) {
    const Real3 d = minus_real3(a, b);
    return make_real3(d.x * scale.x, d.y * scale.y, d.z * scale.z);
}

// Measures the offsets of triangles: how high above their plane the centroid of the full mesh's triangle is, smallest spacings /
// OFFSET_STEPS. 0 if they have no plane.
INLINED void measure_offsets(LaneTriangles *lanes, Grid grid) {
    const float3 scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / (smallest_spacing(grid) * VERTEX_LATTICE);
    const Real3 a = LOAD_REAL3(lanes->leaves, LANES), b = LOAD_REAL3(lanes->leaves + 3 * LANES, LANES);
    const Real3 c = LOAD_REAL3(lanes->leaves + 6 * LANES, LANES), centroid = scale_real3(LOAD_REAL3(lanes->points, LANES), 1.0f / 3.0f);
    const Real3 p = scaled_difference(centroid, a, scale);
    const Real3 n = cross_real3(scaled_difference(b, a, scale), scaled_difference(c, a, scale));
    const real height = dot_real3(p, n) * rsqrt(dot_real3(n, n));
    const real offset = rint(clamp(height, -OFFSET_MAX, OFFSET_MAX) * OFFSET_STEPS);
    STORE_LANES(PICK(height == height, offset, 0.0f), lanes->offsets);
}

// `sums`: two of each node, cleared: of triangles in its own region, and of those in others.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_offsets(const TreeOffsetsArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                  __global const RegionMesh *meshes, __global const uint *corners, __global const uint *leaves,
                  __global const uint *left, __global const RegionMesh *cut_meshes, __global const TreeNode *tree_nodes,
                  __global const int4 *points, __global uint *sums) {
    const uint group = (uint)get_group_id(0);
    RelaxedCut in;
    in.grid = args.grid;
    in.point_count = args.points;
    in.first_above = args.first_above;
    in.origin = convert_int3(region_origin(args.grid, regions[group].region));
    in.cut.corners = corners;
    in.cut.leaves = leaves;
    in.regions = regions;
    in.tree = tree_regions + group;
    in.nodes = tree_nodes;
    in.points = points;
    in.sums = sums;
    __global const uint *own_left = left + list_base(meshes + group, in.tree);
    const uint count = count_triangles(cut_meshes + group);
    for (uint first = LANES * (uint)get_local_id(0); first < count; first += LANES * WIDE_GROUP) {
        LaneTriangles lanes;
        find_triangles(&lanes, &in, own_left + first, min((uint)LANES, count - first));
        if (lanes.count == 0) continue;
        load_positions(&lanes, &in);
        measure_offsets(&lanes, args.grid);
        for (uint i = 0; i < lanes.count; i++) add_offset_around(&in, lanes.triangles + i, (int)lanes.offsets[i]);
    }
}
