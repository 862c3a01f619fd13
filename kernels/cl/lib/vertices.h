// Vertices of the dual mesh as they leave the device: those of leaves, of ghosts, and border vertices on the volume's faces.
// Positions are in 1/VERTEX_LATTICE cell.
#ifndef ISOPEEL_VERTICES_H
#define ISOPEEL_VERTICES_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/octahedral.h"
#include "lib/part.h"
#include "lib/vertex_record.h"

// Position of a vertex in the volume; in a capped volume what lies in the padding moves onto the faces
// (docs/algorithm.md#66-borders-and-caps). `origin`: of its region.
INLINED int3 lattice_position(Grid grid, CutParams params, VertexRecord record, int3 origin) {
    const int lattice = (int)VERTEX_LATTICE;
    const int3 p = (int3)(record.position[0], record.position[1], record.position[2]) + origin * lattice;
    if (!params.cap) return p;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    return clamp(p, (int3)(lattice), last * lattice);
}

// Position of a border vertex in the volume: the leaf's vertex moved along its tangent plane, by the shortest way in it, onto
// the faces, but not out of the leaf. `origin`: of the leaf's region.
inline int3 border_position(Grid grid, Node node, VertexRecord record, uint faces, int3 origin) {
    const uint code = meta_code(node.meta), level = code_level(code);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1 - origin;
    const int3 low = convert_int3(unmorton(code_cell(code, level))), high = min(low + (1 << level), last);
    const float3 p = (float3)(record.position[0], record.position[1], record.position[2]) / VERTEX_LATTICE;
    // The plane's normal in cells. Along the faces' axes the movement is given, along the others the plane decides.
    const float3 n = decode_octahedral8(record.normal) * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const int3 is_low = -(int3)((int)(faces & 1u), (int)(faces >> 2 & 1u), (int)(faces >> 4 & 1u));
    const int3 is_high = -(int3)((int)(faces >> 1 & 1u), (int)(faces >> 3 & 1u), (int)(faces >> 5 & 1u));
    const float3 face = select(convert_float3(last), convert_float3(-origin), is_low);
    const float3 along = select((float3)(1.0f), (float3)(0.0f), is_low | is_high), to_face = (1.0f - along) * (face - p);
    const float3 free_n = along * n;
    // Limited for planes almost parallel to the face: the vertex moves at most ten times its distance to the face.
    const float3 moved = p - free_n * (dot(n, to_face) / fmax(dot(free_n, free_n), 0.01f * dot(n, n)));
    // Each sheet of a cell has a margin of its own, so that two of them do not meet.
    const uint sheet = node.count >> 24 ? meta_extras(node.meta) : 0;
    const float margin = MARGIN * (1.0f + (float)sheet);
    const float3 in_leaf = clamp(moved, convert_float3(low) + margin, convert_float3(high) - margin);
    const int3 at = convert_int3_rte(select(in_leaf, face, is_low | is_high) * VERTEX_LATTICE);
    // If two sheets of a cell touch on the face, the last two bits still keep them apart.
    const int3 own = meta_extras(node.meta) ? (at & ~3) | (int)sheet : at;
    return select(own, at, is_low | is_high) + origin * (int)VERTEX_LATTICE;
}

inline uint unorm16(float v) { return (uint)(clamp(v, 0.0f, 1.0f) * 65535.0f + 0.5f); }

// `at`: from the low corner of the region that the vertex is made for.
INLINED int3 vertex_position(int3 at) { return at * (65536 / (int)VERTEX_LATTICE); }

// `normal`: as in VertexRecord; `at`: as in vertex_position.
INLINED Vertex make_vertex(CutParams params, Node node, uint normal, int3 at) {
    Vertex vertex;
    vstore3(vertex_position(at), 0, vertex.position);
    vertex.normal = widen_octahedral8(normal);
    vertex.attributes = unorm16(node.s) | unorm16(normalised_feature(params, node.f)) << 16;
    return vertex;
}

// Inputs for numbering the points of the vertex tree (tree.cl), and the output buffer for positions of those on the volume's faces.
typedef struct {
    bool wanted;                // instead of vertices
    __global const uint *borders;
    __global const uint *border_base;
    __global const TreeRegion *tree_regions;
    __global int4 *points;
} PointNumbers;

// Number of the point of a cell or extra sheet.
inline uint cell_point(__global const Region *region, uint slot) {
    const uint rank = slot - region->slot_base, sheets = region->level_base[6];
    return region->point_base + (rank < sheets ? rank : rank - sheets + region->level_base[1]);
}

// Inputs and output buffers of the vertices of a region's mesh.
typedef struct {
    CutParams params;
    __global const Node *nodes;
    __global const VertexRecord *records;
    __global const uint *compact_index; // of a slot's vertex in its own region's mesh
    __global const uint *ghosts;        // masks of the names of ghosts and border vertices (ghosts.h), HALO_WORDS a region
    __global const uint *ghost_base;    // index of the first vertex of each word of these
    __global Vertex *out;               // of this region
    PointNumbers points;
} MeshVertices;

// Writes the vertex of a ghost, or a border vertex, and returns its index. `node`: of the slot, with the vertex' values; `bit`: its name;
// `at`: as in vertex_position.
INLINED uint write_ghost(const MeshVertices *mesh, uint region, uint slot, Node node, uint bit, int3 at) {
    const uint word = region * HALO_WORDS + (bit >> 5);
    const uint index = mesh->ghost_base[word] + popcount(mesh->ghosts[word] & ((1u << (bit & 31)) - 1));
    mesh->out[index] = make_vertex(mesh->params, node, mesh->records[slot].normal, at);
    return index;
}

#endif
