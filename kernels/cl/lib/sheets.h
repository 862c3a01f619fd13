// Which surface sheet of a cell each of its crossed edges belongs to. The tables are made by the host from the contours of the
// cube's faces, where inside corners are separated on ambiguous faces: SHEETS; JOINED, the faces whose two segments lie in
// one sheet; FLIPPED, sheets with some of the joined faces paired the other way, and where each case's begin.
//
// Two cells that share an ambiguous face and both join its two segments in one sheet would make an edge of four triangles
// (R. Wenger, "Isosurfaces", 2013). Then one of them pairs the face's crossings the other way, which splits its sheet: the
// cell whose coordinates sum to an even number, so that of two neighbours only one ever departs from the table. On the
// volume's faces the surface goes on as if mirrored, so that every cell there meets its like.
#ifndef ISOPEEL_SHEETS_H
#define ISOPEEL_SHEETS_H

#include "lib/precision.h"
#include "lib/cube.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/samples.h"
#include "lib/tables.h"

// Contour of a face (2 axis + side): crossed edges, pairwise the ends of a segment. Inside corners are separated where
// the face is ambiguous, outside corners when `flipped`. Returns 0, 2 or 4.
inline uint face_segments(uint signs, uint face, bool flipped, uint *ends) {
    const uint d = face >> 1, side = face & 1, b = (d + 1) % 3, c = (d + 2) % 3;
    // Edges of the face: along b at c = 0 and 1, along c at b = 0 and 1.
    const uint edges[4] = {4 * b + 2 * side, 4 * b + 1 + 2 * side, 4 * c + side, 4 * c + side + 2};
    uint crossings = 0;
    for (uint i = 0; i < 4; i++)
        if (edge_crosses(signs, edges[i])) ends[crossings++] = edges[i];
    if (crossings == 4) {
        // Inside are (0, 0) and (1, 1), or (1, 0) and (0, 1).
        const bool straight = (signs >> (side << d) & 1u) != (uint)flipped;
        ends[0] = edges[0];
        ends[1] = edges[straight ? 2 : 3];
        ends[2] = edges[1];
        ends[3] = edges[straight ? 3 : 2];
    }
    return crossings;
}

// Two bits an edge: its sheet; from bit 24 the number of sheets.
inline uint edge_sheet(uint sheets, uint edge) { return sheets >> (2 * edge) & 3u; }
// Its edges, one bit each; those that are not crossed are in no sheet, and may count to any.
inline uint edges_of_sheet(uint sheets, uint sheet) {
    const uint unlike = sheets ^ sheet * 0x555555u;
    uint edges = ~(unlike | unlike >> 1) & 0x555555u;
    edges = (edges | edges >> 1) & 0x333333u;
    edges = (edges | edges >> 2) & 0x0f0f0fu;
    return (edges & 0xfu) | (edges >> 4 & 0xf0u) | (edges >> 8 & 0xf00u);
}
inline uint sheet_count(uint sheets) { return sheets >> 24; }

// Sheets of an active cell, with faces flipped where that keeps the surface a manifold.
inline uint cell_sheets(Grid grid, SLAB, float iso, int3 cell, uint signs) {
    const uint plain = SHEETS[signs];
    uint candidates = JOINED[signs];
    if (!candidates) return plain;
    for (uint face = 0; face < 6; face++) {
        if (!(candidates >> face & 1u)) continue;
        const uint axis = face >> 1, side = face & 1;
        const int3 other = cell + axis_step(axis) * (side ? 1 : -1);
        if (any(other < 0) || any(other + 1 >= (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]))) continue;
        if (cell.x + cell.y + cell.z & 1) {
            candidates &= ~(1u << face);
            continue;
        }
        // The corners of the face are known; those beyond are read together.
        float beyond[4];
        for (uint i = 0; i < 4; i++)
            beyond[i] = sample_at(grid, SLAB_ARGS, cell + edge_offset(4 * axis + i) + axis_step(axis) * (side ? 2 : -1));
        uint there = 0;
        bool known = true;
        for (uint i = 0; i < 4; i++) {
            const uint corner = (i & 1) << (axis + 1) % 3 | (i >> 1) << (axis + 2) % 3;
            there |= (signs >> (corner | side << axis) & 1u) << (corner | (1 - side) << axis);
            there |= (uint)(beyond[i] >= iso) << (corner | side << axis);
            known = known && !isnan(beyond[i]);
        }
        if (!known || !(JOINED[there] >> (face ^ 1) & 1u)) candidates &= ~(1u << face);
    }
    // The set of faces that are flipped, among the joined ones.
    uint set = 0, bit = 0;
    for (uint face = 0; face < 6; face++) {
        if (!(JOINED[signs] >> face & 1u)) continue;
        set |= (candidates >> face & 1u) << bit++;
    }
    return FLIPPED[FLIPPED_ROW[signs] + set];
}

// Where the extra sheets of a cell of several begin; `brick`: the cell's.
inline uint first_extra(__global const Region *region, __global const Brick *brick, Node cell) {
    return region->slot_base + brick->level_base[3] + (cell.count >> 8);
}

// Slot of the sheet of an active cell to which one of its edges belongs.
inline uint sheet_in_brick(__global const Region *region, __global const Brick *brick, __global const Node *nodes,
                           uint slot, uint edge) {
    if (!meta_extras(nodes[slot].meta)) return slot;
    const uint extra = first_extra(region, brick, nodes[slot]), sheet = edge_sheet(nodes[extra].count, edge);
    return sheet == 0 ? slot : extra + sheet - 1;
}

#endif
