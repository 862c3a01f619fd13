// Surface sheets of a cell: each crossed edge belongs to one. The host makes the tables from the contours of the cube's faces, with inside
// corners separated on ambiguous faces: SHEETS; JOINED, the faces whose two segments lie in one sheet. From FLIPPED_ROW of the case on,
// the tables hold a row for each set of joined faces that are paired the other way: FLIPPED, the sheets; STILL_JOINED, the faces that
// remain joined.
//
// Two cells that share an ambiguous face and both join its two segments in one sheet would make an edge of four triangles
// (R. Wenger, "Isosurfaces", 2013). Then the face's crossings are paired the other way, in both cells: the one whose coordinates sum to an even
// number decides, so that its sheet is split, and of two neighbours only one ever does. On the volume's faces the surface goes on as if
// mirrored, so that every cell there meets its like.
#ifndef ISOPEEL_SHEETS_H
#define ISOPEEL_SHEETS_H

#include "lib/precision.h"
#include "lib/cube.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/samples.h"
#include "lib/tables.h"

// Contour of a face (2 axis + side): crossed edges, pairwise the ends of a segment. On an ambiguous face inside corners are
// separated, or outside corners if `flipped`. Returns 0, 2 or 4.
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

// The entry of a case's tables for a set of its joined faces: their bits pushed together.
inline uint flips_entry(uint signs, uint faces) {
    uint set = 0, bit = 0;
    for (uint face = 0; face < 6; face++) {
        if (!(JOINED[signs] >> face & 1u)) continue;
        set |= (faces >> face & 1u) << bit++;
    }
    return FLIPPED_ROW[signs] + set;
}

// Which of the faces `candidates` a cell flips beside those of `forced`: of all ways that which leaves the fewest of them joined, of equals the
// one with the largest bits; none if that gains nothing.
inline uint choose_flips(uint signs, uint forced, uint candidates) {
    uint best = 0, fewest = popcount(candidates & STILL_JOINED[flips_entry(signs, forced)]);
    for (uint flips = candidates; flips; flips = (flips - 1) & candidates) {
        const uint left = popcount(candidates & STILL_JOINED[flips_entry(signs, forced | flips)]);
        if (left >= fewest) continue;
        fewest = left;
        best = flips;
    }
    return best;
}

inline int3 cell_beyond(int3 cell, uint face) { return cell + axis_step(face >> 1) * (face & 1 ? 1 : -1); }

// Whether a cell is one of the volume's.
inline bool is_cell(Grid grid, int3 cell) {
    return all(cell >= 0) && all(cell + 1 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]));
}

// Signs of the cell beyond a face, NONE if it has a missing sample. The corners of the face are known; the others are read together.
inline uint signs_beyond(Grid grid, SLAB, float iso, int3 cell, uint signs, uint face) {
    const uint axis = face >> 1, side = face & 1;
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
    return known ? there : NONE;
}

// Faces of a cell that cells on both sides join: x those of neighbours, y those of the volume, which meet their mirror image.
inline uint2 joined_on_both_sides(Grid grid, SLAB, float iso, int3 cell, uint signs) {
    uint inner = 0, outer = 0;
    for (uint face = 0; face < 6; face++) {
        if (!(JOINED[signs] >> face & 1u)) continue;
        if (!is_cell(grid, cell_beyond(cell, face))) {
            outer |= 1u << face;
            continue;
        }
        const uint there = signs_beyond(grid, SLAB_ARGS, iso, cell, signs, face);
        if (there != NONE && JOINED[there] >> (face ^ 1) & 1u) inner |= 1u << face;
    }
    return (uint2)(inner, outer);
}

// Of the faces `shared` of a cell whose coordinates sum to an odd number those that its neighbours flip.
inline uint flips_of_neighbours(Grid grid, SLAB, float iso, int3 cell, uint signs, uint shared) {
    uint flips = 0;
    for (uint face = 0; face < 6; face++) {
        if (!(shared >> face & 1u)) continue;
        const uint there = signs_beyond(grid, SLAB_ARGS, iso, cell, signs, face);
        const uint2 candidates = joined_on_both_sides(grid, SLAB_ARGS, iso, cell_beyond(cell, face), there);
        flips |= (choose_flips(there, 0, candidates.x | candidates.y) >> (face ^ 1) & 1u) << face;
    }
    return flips;
}

// Sheets of an active cell, with faces flipped if that keeps the surface a manifold. Reads samples up to two beyond the cell's.
inline uint cell_sheets(Grid grid, SLAB, float iso, int3 cell, uint signs) {
    if (!JOINED[signs]) return SHEETS[signs];
    const uint2 candidates = joined_on_both_sides(grid, SLAB_ARGS, iso, cell, signs);
    const bool is_odd = cell.x + cell.y + cell.z & 1;
    const uint forced = is_odd ? flips_of_neighbours(grid, SLAB_ARGS, iso, cell, signs, candidates.x) : 0;
    const uint flips = choose_flips(signs, forced, is_odd ? candidates.y : candidates.x | candidates.y);
    return FLIPPED[flips_entry(signs, forced | flips)];
}

// Slot of the first extra sheet of a cell that has several sheets. `brick`: the cell's.
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
