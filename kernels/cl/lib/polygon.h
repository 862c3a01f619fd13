// The polygon around a minimal edge of the cut (docs/algorithm.md#65-minimal-edges-and-polygons).
//
// Positions around an edge, seen from its high end. k = u + 2 v, with u = 1 on the low side along axis b = axis + 1 and v = 1 on
// the low side along c = axis + 2 (modulo 3). A leaf has edge 4 axis + k at position k. The corners' order is 0 1 3 2:
//
//      c           four leaves               three leaves: a coarser one
//      ^        1       |       0            covers two positions
//      |     . .v1------|------v0. .             v1----|----v0
//      |        |       |       |                  \   |   /
//      |     ---+-----edge------+---            -----edge-----
//      |        |       |       |                    \ | /
//      |     . .v3------|------v2. .                  v2 (= v3)
//      |        3       |       2
//      +------------------------------> b
//
// edge_polygon is called for a leaf of level L at position `own`. What it finds at each other position k:
//
//   beyond a face of the volume           mirror image of the leaf inside: the corner is a border vertex on the face
//   no active cell (samples missing)      no polygon: the surface has an open border there
//   leaf of a level below L               no polygon from this leaf: a finer one emits it
//   leaf of level L, k < own              no polygon from this leaf: that one, the first of the finest, emits it
//   leaf of level L, k > own              a corner
//   leaf of a level above L               a corner; at two neighbouring positions it counts once, so the polygon is a triangle
//
// Whose vertex a corner is:
//
//   the leaf's region     inside the volume     beyond a face
//   this one              own vertex            border vertex of this region
//   another               ghost                 border vertex of the other; also a ghost of this one
#ifndef ISOPEEL_POLYGON_H
#define ISOPEEL_POLYGON_H

#include "lib/cube.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/sheets.h"
#include "lib/slots.h"

#define ON_BORDER 0x80000000u // beside the slot of a corner: a border vertex

// Corners: by position k while they are looked up, then in order around the edge.
typedef struct {
    uint slot[4];   // of leaves, or of extra sheets
    uint region[4]; // compact indices
    uint faces[4];  // of a border vertex the volume's faces, bit 2 axis + side; else 0
    uint count;     // 0: no polygon; 3 or 4
} Polygon;

// Sides of an edge beyond a face of the volume, along one axis across it.
#define BEYOND_NONE 0u
#define BEYOND_HIGH 1u
#define BEYOND_LOW 2u

// An edge of a leaf.
typedef struct {
    uint axis, b, c;         // its axis, and those across it
    uint own;                // position of the leaf
    int3 low;                // low end, in cells of the volume
    int3 sample;             // the same, but at most the last sample, which cuts off the leaf
    uint beyond_b, beyond_c; // BEYOND_...
} LeafEdge;

inline uint side_beyond(int at, int last) { return at == 0 ? BEYOND_LOW : at >= last ? BEYOND_HIGH : BEYOND_NONE; }

// `low`: the leaf's low corner.
INLINED LeafEdge leaf_edge(Grid grid, uint level, int3 low, uint edge) {
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    LeafEdge e;
    e.axis = edge >> 2;
    e.own = edge & 3;
    e.b = (e.axis + 1) % 3;
    e.c = (e.axis + 2) % 3;
    e.low = low + edge_offset(edge) * (1 << level);
    e.sample = min(e.low, last);
    e.beyond_b = side_beyond(component(e.low, e.b), component(last, e.b));
    e.beyond_c = side_beyond(component(e.low, e.c), component(last, e.c));
    return e;
}

// Faces of the volume that position `k` is beyond.
INLINED uint faces_at(LeafEdge edge, uint k) {
    const bool out_b = edge.beyond_b == (k & 1 ? BEYOND_LOW : BEYOND_HIGH);
    const bool out_c = edge.beyond_c == (k >> 1 ? BEYOND_LOW : BEYOND_HIGH);
    return (out_b ? 1u << (2 * edge.b + (edge.beyond_b == BEYOND_HIGH)) : 0)
        | (out_c ? 1u << (2 * edge.c + (edge.beyond_c == BEYOND_HIGH)) : 0);
}

// Way from the edge to the cube at position `k`, in cubes.
INLINED int3 step_to(LeafEdge edge, uint k) { return -axis_step(edge.b) * (int)(k & 1) - axis_step(edge.c) * (int)(k >> 1); }

// Compact index of the brick, in or around the part's, that holds `cell`.
INLINED uint near_brick(const Part *part, int3 cell) {
    const int3 d = (cell - part->low + 8) >> 3;
    return part->near[d.x + 3 * d.y + 9 * d.z];
}

// The leaf at position `k`, for a leaf of levels 0 to 3 whose brick's halo is known. False if this leaf emits no polygon.
INLINED bool corner_from_halo(const Cut *cut, __local const LeafHalo *halo, const Part *part, LeafEdge edge, uint level, uint k,
                              Polygon *corners) {
    const EdgeCubes cubes = edge_cubes(edge.sample - part->low, edge.axis);
    uint i = cube_at(cubes, k);
    // Beside a crossed edge some cell is active, unless samples are missing.
    for (uint along = 2; along < 1u << level && halo->cover[i] == HALO_EMPTY; along += 2) i += cubes.step;
    const uint cover = halo->cover[i], found = cover_level(cover);
    if (cover == HALO_EMPTY || found < level || (found == level && k < edge.own)) return false;
    const uint brick = near_brick(part, edge.sample + step_to(edge, k));
    corners->slot[k] = halo->slot[i];
    corners->region[k] = cut->bricks[brick].region;
    if (found > 0) return true;

    // Cells are leaves: the one beside the edge's low end, if it is active.
    const uint b = (uint)(cubes.b - (int)(k & 1)) & 1u, c = (uint)(cubes.c - (int)(k >> 1)) & 1u;
    const uint cell = ((uint)component(edge.low, edge.axis) & 1u) << edge.axis | b << edge.b | c << edge.c;
    if (!(cover_cells(cover) >> cell & 1u)) return false;
    corners->slot[k] += popcount(cover_cells(cover) & ((1u << cell) - 1));
    if (cover & HALO_EXTRA_SHEETS)
        corners->slot[k] = sheet_in_brick(cut->regions + corners->region[k], cut->bricks + brick, cut->nodes, corners->slot[k],
                                          4 * edge.axis + k);
    return true;
}

// The same for a leaf of levels 4 and 5, which is looked up in the pyramid.
INLINED bool corner_from_pyramid(Grid grid, const Cut *cut, LeafEdge edge, uint level, uint k, Polygon *corners) {
    const int3 cube = edge.low + step_to(edge, k) * (1 << level);
    const uint slot = find_slot_at(grid, cut->region_index, cut->regions, cut->bricks, level, cube, &corners->region[k]);
    if (slot == NONE) return false;
    const uint found = cut->state[slot];
    if (found == INTERNAL || (found == level && k < edge.own)) return false;
    corners->slot[k] = found <= level ? slot
        : find_slot(cut->regions + corners->region[k], cut->bricks, found, morton(convert_uint3(cube) & 31u));
    return true;
}

INLINED void copy_corner(Polygon *to, uint i, const Polygon *from, uint k) {
    to->slot[i] = from->slot[k];
    to->region[i] = from->region[k];
}

// Positions beyond a face get the mirror image of the leaf inside, across b, then across c.
INLINED void mirror_corners(Polygon *corners, LeafEdge edge) {
    for (uint k = 0; k < 4; k += 2) {
        if (edge.beyond_b == BEYOND_HIGH) copy_corner(corners, k, corners, k + 1);
        if (edge.beyond_b == BEYOND_LOW) copy_corner(corners, k + 1, corners, k);
    }
    for (uint k = 0; k < 2; k++) {
        if (edge.beyond_c == BEYOND_HIGH) copy_corner(corners, k, corners, k + 2);
        if (edge.beyond_c == BEYOND_LOW) copy_corner(corners, k + 2, corners, k);
    }
}

INLINED bool same_vertex(const Polygon *corners, uint i, uint k) {
    return corners->slot[i] == corners->slot[k] && corners->faces[i] == corners->faces[k];
}

INLINED void set_corner(Polygon *polygon, uint i, const Polygon *corners, uint k) {
    copy_corner(polygon, i, corners, k);
    polygon->faces[i] = corners->faces[k];
}

// Corners in order around the edge, 0 1 3 2, without one of two neighbours that are the same.
INLINED Polygon order_corners(const Polygon *corners) {
    const bool skip_first = same_vertex(corners, 0, 1), skip_second = skip_first || same_vertex(corners, 1, 3);
    const bool skip_last = same_vertex(corners, 3, 2) || same_vertex(corners, 2, 0);
    Polygon polygon;
    set_corner(&polygon, 0, corners, 0);
    if (skip_first) set_corner(&polygon, 1, corners, 3);
    else set_corner(&polygon, 1, corners, 1);
    if (skip_second) set_corner(&polygon, 2, corners, 2);
    else set_corner(&polygon, 2, corners, 3);
    set_corner(&polygon, 3, corners, 2);
    polygon.count = skip_second || skip_last ? 3 : 4;
    return polygon;
}

// The polygon that a leaf emits around one of its edges: see the table above. `low`: the leaf's low corner in the volume.
INLINED Polygon edge_polygon(Grid grid, const Cut *cut, __local const LeafHalo *halo, const Part *part, uint own_slot, uint level,
                             int3 low, uint edge_number) {
    const LeafEdge edge = leaf_edge(grid, level, low, edge_number);
    Polygon corners;
    corners.count = 0;
    for (uint k = 0; k < 4; k++) {
        corners.faces[k] = faces_at(edge, k);
        if (corners.faces[k]) continue;
        if (k == edge.own) {
            corners.region[k] = part->region;
            corners.slot[k] = level > 0 ? own_slot
                : sheet_in_brick(cut->regions + part->region, cut->bricks + part->brick, cut->nodes, own_slot, edge_number);
        } else if (!(level < 4 ? corner_from_halo(cut, halo, part, edge, level, k, &corners)
                               : corner_from_pyramid(grid, cut, edge, level, k, &corners)))
            return corners;
    }
    if (edge.beyond_b | edge.beyond_c) mirror_corners(&corners, edge);
    return order_corners(&corners);
}

// The polygon around the edge along `axis` from the low corner of a cell, between four cells that all are leaves.
INLINED Polygon plain_polygon(const Cut *cut, const Part *part, uint own_slot, int3 low, uint axis) {
    Polygon polygon;
    polygon.count = 4;
    const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
    for (uint i = 0; i < 4; i++) {
        const uint k = i ^ i >> 1;
        const int3 at = low - b * (int)(k & 1) - c * (int)(k >> 1);
        const uint brick = k == 0 ? part->brick : near_brick(part, at);
        const uint region = cut->bricks[brick].region;
        const uint slot = k == 0 ? own_slot
            : find_in_brick(cut->regions + region, cut->bricks, brick, 0, morton(convert_uint3(at) & 7u));
        polygon.region[i] = region;
        polygon.faces[i] = 0;
        polygon.slot[i] = sheet_in_brick(cut->regions + region, cut->bricks + brick, cut->nodes, slot, 4 * axis + k);
    }
    return polygon;
}

// The polygon of a listed edge: plain_polygon in plain bricks away from the volume's faces, else edge_polygon.
INLINED Polygon find_polygon(Grid grid, const Cut *cut, __local const LeafHalo *halo, const Part *part, uint slot, uint level,
                             int3 low, uint edge) {
    return part->plain && is_inside(grid, low) ? plain_polygon(cut, part, slot, low, edge >> 2)
                                               : edge_polygon(grid, cut, halo, part, slot, level, low, edge);
}

#endif
