// Vertices of the dual mesh: those of leaves, of leaves beyond a region's border, and on the volume's faces.
#ifndef ISOPEEL_VERTICES_H
#define ISOPEEL_VERTICES_H

#include "lib/precision.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/octahedral.h"
#include "lib/part.h"
#include "lib/vertex_record.h"

// Position of a vertex in the volume, 1/VERTEX_LATTICE cell; what lies in the padding of a capped volume moves onto the
// faces. `origin`: of its region.
inline int3 lattice_position(Grid grid, CutParams params, VertexRecord record, int3 origin) {
    const int lattice = (int)VERTEX_LATTICE;
    const int3 p = (int3)(record.position[0], record.position[1], record.position[2]) + origin * lattice;
    if (!params.cap) return p;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    return clamp(p, (int3)(lattice), last * lattice);
}

// Position of a border vertex: the leaf's vertex moved along its tangent plane, as little as that takes, onto the faces, but
// not out of the leaf. `origin`: of the leaf's region.
inline int3 border_position(Grid grid, Node node, VertexRecord record, uint faces, int3 origin) {
    const uint code = meta_code(node.meta), level = code_level(code);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1 - origin;
    const int3 low = convert_int3(unmorton(code_cell(code, level))), high = min(low + (1 << level), last);
    const float3 p = (float3)(record.position[0], record.position[1], record.position[2]) / VERTEX_LATTICE;
    // The plane's normal in cells; along the faces' axes the way is given, along the others the plane gives it.
    const float3 n = decode_octahedral8(record.normal) * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const int3 is_low = -(int3)((int)(faces & 1u), (int)(faces >> 2 & 1u), (int)(faces >> 4 & 1u));
    const int3 is_high = -(int3)((int)(faces >> 1 & 1u), (int)(faces >> 3 & 1u), (int)(faces >> 5 & 1u));
    const float3 face = select(convert_float3(last), convert_float3(-origin), is_low);
    const float3 along = select((float3)(1.0f), (float3)(0.0f), is_low | is_high), way = (1.0f - along) * (face - p);
    const float3 free_n = along * n;
    // Where the surface hardly leans towards the face, not beyond ten times the way.
    const float3 moved = p - free_n * (dot(n, way) / fmax(dot(free_n, free_n), 0.01f * dot(n, n)));
    // Each sheet of a cell stops at another place, lest two of them meet.
    const uint sheet = node.count >> 24 ? meta_extras(node.meta) : 0;
    const float margin = MARGIN * (1.0f + (float)sheet);
    const float3 in_leaf = clamp(moved, convert_float3(low) + margin, convert_float3(high) - margin);
    const int3 at = convert_int3_rte(select(in_leaf, face, is_low | is_high) * VERTEX_LATTICE);
    // Where two sheets of a cell touch on the face, their last bits still keep them apart.
    const int3 own = meta_extras(node.meta) ? (at & ~3) | (int)sheet : at;
    return select(own, at, is_low | is_high) + origin * (int)VERTEX_LATTICE;
}

inline uint unorm16(float v) { return (uint)(clamp(v, 0.0f, 1.0f) * 65535.0f + 0.5f); }

// `at`: from the low corner of the region that gets the vertex, 1/VERTEX_LATTICE cell.
inline Vertex make_vertex(CutParams params, Node node, uint normal, int3 at) {
    Vertex vertex;
    vertex.position[0] = at.x * (65536 / (int)VERTEX_LATTICE);
    vertex.position[1] = at.y * (65536 / (int)VERTEX_LATTICE);
    vertex.position[2] = at.z * (65536 / (int)VERTEX_LATTICE);
    // Both are octahedral; only the steps are finer: 32767 are 127 times 258 and one more.
    const int nx = (char)(normal & 0xffu), ny = (char)(normal >> 8 & 0xffu);
    const int x = 258 * nx + (nx > 126) - (nx < -126), y = 258 * ny + (ny > 126) - (ny < -126);
    vertex.normal = ((uint)x & 0xffffu) | (uint)y << 16;
    vertex.attributes = unorm16(node.s) | unorm16((fabs(node.f) - params.feature_lo) / params.feature_span) << 16;
    return vertex;
}

// What dual_emit takes polygons' corners from, and where the region's vertices go.
#define CORNER_PARAMS                                                                                                  \
    __global const Region *regions, __global const Node *nodes, const CutParams params,                                \
        __global const VertexRecord *vertex_records, __global const uint *compact_index, __global const uint *ghosts,                \
        __global const uint *ghost_base, __global Vertex *out
#define CORNER_ARGS regions, nodes, params, vertex_records, compact_index, ghosts, ghost_base, out

// Writes the vertex of a ghost, or of the border, and answers its index. `bit`: its name; `at`: as in make_vertex.
inline uint ghost_vertex(CORNER_PARAMS, Part part, uint slot, uint bit, int3 at) {
    (void)regions, (void)compact_index;
    const uint word = part.region * HALO_WORDS + (bit >> 5);
    const uint index = ghost_base[word] + popcount(ghosts[word] & ((1u << (bit & 31)) - 1));
    out[index] = make_vertex(params, nodes[slot], vertex_records[slot].normal, at);
    return index;
}

#endif
