// tree_relax: the nodes of a cut of the vertex tree move towards where its triangles are nearest to the isosurface
// (docs/algorithm.md#82-relaxation). One work-group a region.
//
//   kernel        writes
//   tree_offsets  of each node the sum of the offsets around it
//   tree_move     positions of vertices

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/samples.h"
#include "lib/surface_distance.h"
#include "lib/tree_node.h"
#include "lib/tree_offset.h"
#include "lib/trilinear.h"
#include "lib/vertices.h"

#define FACE_MARGIN (1.0f / 256.0f) // cells: nearer to a face of a capped volume a triangle lies in the face
#define POSITION_STEPS 65536.0f     // of Vertex::position in a cell
#define OFFSET_MAX 0.25f // smallest spacings: the further beyond, the less the slope leads to the surface
#define UNKNOWN (2.0f * OFFSET_STEPS)

// LANES triangles, in cells from the region's low corner.
typedef struct {
    uint first; // triangle of the region's mesh
    Real3 centroid;
    Real3 normal;         // in world units, of length 1
    float low[3 * LANES]; // rows of the low corners of the cells with the centroids
} LaneTriangles;

// What offsets are measured in.
typedef struct {
    Grid grid;
    __global const SAMPLE *samples;
    uint z0;
    FieldBox box;
    int3 origin; // of the region
} OffsetField;

// The low corner of the cell at a coordinate, along one axis, from the region's.
INLINED real low_corner(real x, int origin, int first, int last) {
    return clamp(floor(x), (real)(float)(first - origin), (real)(float)(last - origin));
}

// Lane by lane: whether a coordinate is near a face of a capped volume, or beyond it.
INLINED integer is_in_face(real x, int origin, uint samples) {
    return (x < (float)(1 - origin) + FACE_MARGIN) | (x > (float)((int)samples - 2 - origin) - FACE_MARGIN);
}

// Loads triangles of a region's mesh. Past the end it is the last one.
INLINED void load_triangles(LaneTriangles *triangles, const OffsetField *field, __global const Vertex *vertices, __global const uint *corners,
                            uint first, uint count) {
    float rows[9 * LANES];
    for (uint i = 0; i < LANES; i++)
        for (uint k = 0; k < 3; k++) {
            __global const Vertex *vertex = vertices + corners[3 * min(first + i, count - 1) + k];
            for (uint axis = 0; axis < 3; axis++) rows[(3 * k + axis) * LANES + i] = (float)vertex->position[axis];
        }
    const Real3 a = LOAD_REAL3(rows, LANES), b = LOAD_REAL3(rows + 3 * LANES, LANES), c = LOAD_REAL3(rows + 6 * LANES, LANES);
    const float3 spacing = field->box.spacing;
    const Real3 u = make_real3((b.x - a.x) * spacing.x, (b.y - a.y) * spacing.y, (b.z - a.z) * spacing.z);
    const Real3 v = make_real3((c.x - a.x) * spacing.x, (c.y - a.y) * spacing.y, (c.z - a.z) * spacing.z);
    const Real3 n = make_real3(u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x);
    const Real3 x = scale_real3(make_real3(a.x + b.x + c.x, a.y + b.y + c.y, a.z + b.z + c.z), 1.0f / (3.0f * POSITION_STEPS));
    triangles->first = first;
    triangles->normal = scale_real3(n, rsqrt(dot_real3(n, n)));
    triangles->centroid = x;
    const int3 origin = field->origin, begin = field->box.first, last = field->box.last;
    STORE_LANES(low_corner(x.x, origin.x, begin.x, last.x), triangles->low);
    STORE_LANES(low_corner(x.y, origin.y, begin.y, last.y), triangles->low + LANES);
    STORE_LANES(low_corner(x.z, origin.z, begin.z, last.z), triangles->low + 2 * LANES);
}

// Loads the cells with the centroids into rows.
INLINED void load_cells(const OffsetField *field, const LaneTriangles *triangles, float *rows) {
    for (uint i = 0; i < LANES; i++) {
        const float *low = triangles->low + i;
        const int3 at = convert_int3((float3)(low[0], low[LANES], low[2 * LANES])) + field->origin;
        load_cell(field->grid, field->samples, field->z0, field->box.iso, at, rows + i);
    }
}

// Offsets of triangles: how far it is from their centroids to the surface, by the slope of the field, along their normals, in smallest
// spacings / OFFSET_STEPS. UNKNOWN where the field has no slope or the slab no samples.
INLINED real measure_offsets(const TreeOffsetsArgs *args, const OffsetField *field, const LaneTriangles *triangles) {
    const Grid grid = field->grid;
    const int3 origin = field->origin;
    const Real3 x = triangles->centroid, low = LOAD_REAL3(triangles->low, LANES);
    float rows[8 * LANES];
    load_cells(field, triangles, rows);
    const Cells cells = LOAD_CELLS(rows, LANES);
    const Field here = field_in_cells(&cells, make_real3(x.x - low.x, x.y - low.y, x.z - low.z), 1.0f / field->box.spacing);
    const real along = dot_real3(here.gradient, triangles->normal), slope2 = dot_real3(here.gradient, here.gradient);
    real offset = here.value * along / slope2 * (-OFFSET_STEPS / smallest_spacing(grid));
    if (args->cap) {
        const integer in_face = is_in_face(x.x, origin.x, grid.dims[0]) | is_in_face(x.y, origin.y, grid.dims[1])
                                | is_in_face(x.z, origin.z, grid.dims[2]);
        offset = PICK(in_face & (here.value == here.value), 0.0f, offset);
    }
    // The slab with the centroid's layer of regions has it.
    const float begin = (float)(32 * (int)args->first_layer - origin.z);
    const float end = args->end_layer < grid.regions[2] ? (float)(32 * (int)args->end_layer - origin.z) : INFINITY;
    const integer in_slab = (x.z >= begin) & (x.z < end);
    const real length = fabs(offset), near = fmax(fmin(length, 2.0f * OFFSET_MAX * OFFSET_STEPS - length), 0.0f);
    return PICK(in_slab & (offset == offset), rint(PICK(offset < 0.0f, -near, near)), UNKNOWN);
}

// Adds the offsets of triangles to the sums of their vertices.
INLINED void add_offsets(const TreeOffsetsArgs *args, const OffsetField *field, const LaneTriangles *triangles,
                         __global const uint *corners, uint count, __global uint *vertex_sums) {
    float offsets[LANES];
    STORE_LANES(measure_offsets(args, field, triangles), offsets);
    for (uint i = 0; i < min((uint)LANES, count - triangles->first); i++) {
        if (offsets[i] == UNKNOWN) continue;
        const uint sum = pack_offset((int)offsets[i]);
        for (uint k = 0; k < 3; k++) add_global(&vertex_sums[corners[3 * (triangles->first + i) + k]], sum);
    }
}

// `vertex_sums`: of each vertex; working memory. `sums`: of each node, which meshes of several regions may have.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_offsets(const TreeOffsetsArgs args, __global const SAMPLE *samples, __global const Region *regions,
                  __global const RegionMesh *cut_meshes, __global const uint *vertex_leaves, __global const uint *indices,
                  __global const Vertex *all_vertices, __global uint *vertex_sums, __global uint *sums) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const RegionMesh mesh = cut_meshes[group];
    OffsetField field;
    field.grid = args.grid;
    field.samples = samples;
    field.z0 = args.z0;
    field.box = make_field_box(args.grid, args.iso, args.cap, args.first_layer, args.end_layer);
    field.origin = convert_int3(region_origin(args.grid, regions[group].region));
    __global const Vertex *vertices = all_vertices + mesh.vertex_base;
    __global const uint *corners = indices + 3 * (mesh.triangle_base + mesh.triangles[0]);
    __global uint *own_sums = vertex_sums + mesh.vertex_base;
    uint count = 0;
    for (uint level = 1; level < 6; level++) count += mesh.triangles[level];
    for (uint i = lid; i < mesh.vertices; i += WIDE_GROUP) own_sums[i] = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    // Those of level 0, which come first, are as fine as the full mesh. The first slab counts them.
    for (uint i = lid; i < (args.first_layer == 0 ? 3 * mesh.triangles[0] : 0); i += WIDE_GROUP)
        add_global(&own_sums[indices[3 * mesh.triangle_base + i]], pack_offset(0));
    for (uint first = LANES * lid; first < count; first += LANES * WIDE_GROUP) {
        LaneTriangles triangles;
        load_triangles(&triangles, &field, vertices, corners, first, count);
        add_offsets(&args, &field, &triangles, corners, count, own_sums);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < mesh.vertices; i += WIDE_GROUP) {
        const uint leaf = vertex_leaves[3 * mesh.triangle_base + i];
        if (leaf >= args.points) atomic_add(&sums[leaf - args.points], own_sums[i]);
    }
}

__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_move(const TreeMoveArgs args, __global const Region *regions, __global const TreeNode *tree_nodes, __global const uint *sums,
               __global const RegionMesh *cut_meshes, __global const uint *vertex_leaves, __global Vertex *vertices) {
    const uint group = (uint)get_group_id(0);
    const RegionMesh mesh = cut_meshes[group];
    const int3 origin = convert_int3(region_origin(args.grid, regions[group].region));
    for (uint i = get_local_id(0); i < mesh.vertices; i += WIDE_GROUP) {
        const uint leaf = vertex_leaves[3 * mesh.triangle_base + i];
        if (leaf < args.points) continue;
        const TreeNode node = tree_nodes[leaf - args.points];
        const int3 home = convert_int3(region_origin(args.grid, regions[tree_node_region(node.meta)].region));
        const int3 at = moved_position(args.grid, args.cap, node, home, sums[leaf - args.points]) + (home - origin) * (int)VERTEX_LATTICE;
        vstore3(vertex_position(at), 0, vertices[mesh.vertex_base + i].position);
    }
}
