// dual on a CPU, which works on a brick with one work-item: see dual_device.h. The quads of a plain brick are made from a table
// of the vertices of its cells and of the cells just before it, so that each vertex is looked up and scaled once, not once for every
// quad, and each ghost is written once.
#ifndef ISOPEEL_DUAL_CPU_H
#define ISOPEEL_DUAL_CPU_H

#include "lib/active_cells.h"
#include "lib/batch.h"
#include "lib/bits.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/emit_polygons.h"
#include "lib/ghosts.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/vertices.h"

#if LANES == 16 // vectors of 16 numbers are taken apart below

// Slots that one work-item of dual_scan numbers in a step.
#define SLOTS_PER_ITEM 1

// Whether plain bricks are emitted from a table of vertices.
#define VERTEX_TABLE 1

// The 32 level-1 cubes in half a brick, in Morton order: number in the halo, less that of the first.
__constant uchar CUBE_IN_HALO[32] = {
    0,  1,  6,  7,  36, 37, 42, 43, 2,  3,  8,  9,  38, 39, 44, 45,
    12, 13, 18, 19, 48, 49, 54, 55, 14, 15, 20, 21, 50, 51, 56, 57,
};

// Enters those active cubes of one of the 27 bricks that lie in the halo. `x, y, z`: the brick, 0 to 2.
INLINED void find_halo_of_brick(__local LeafHalo *halo, const Cut *cut, uint index, uint x, uint y, uint z) {
    __global const Brick *brick = cut->bricks + index;
    // Of the bricks before this one the last cubes, of those behind it the first.
    const uint within = (x == 0 ? LAST_X : x == 2 ? FIRST_X : ~0u) & (y == 0 ? LAST_Y : y == 2 ? FIRST_Y : ~0u)
        & (z == 0 ? LAST_Z : z == 2 ? FIRST_Z : ~0u);
    uint first = cut->regions[brick->region].slot_base + brick->level_base[1];
    const uint corner = 4 * (x + 6 * y + 36 * z) - 3 * (1 + 6 + 36);
    for (uint side = 0; side < 2; side++) {
        const uint cubes = brick->level1_mask[side];
        for (uint rest = z == 2 * side ? 0 : cubes & within; rest; rest &= rest - 1) {
            const uint bit = lowest_bit(rest), own = first + popcount(cubes & ((1u << bit) - 1));
            set_halo_cube(halo, corner + CUBE_IN_HALO[bit] + 72 * side, cut->regions, cut->bricks, cut->state, index,
                          side << 5 | bit, own);
        }
        first += popcount(cubes);
    }
}

// Fills the halo of a brick if `wanted`, from active cube to active cube.
INLINED void find_halo(__local LeafHalo *halo, const Cut *cut, const Part *part, bool wanted) {
    if (!wanted) return;
    for (uint i = 0; i < HALO_CUBES; i++) halo->cover[i] = HALO_EMPTY;
    for (uint i = 0; i < 27; i++)
        if (part->near[i] != NONE) find_halo_of_brick(halo, cut, part->near[i], i % 3, i / 3 % 3, i / 9);
}

// LANES vertex records: positions, and normals in the low half.
INLINED void load_records(__global const VertexRecord *records, integer *x, integer *y, integer *z, integer *normal) {
    __global const uint *record = (__global const uint *)records;
    const uint16 r0 = vload16(0, record), r1 = vload16(1, record), r2 = vload16(2, record);
    const uint16 xy = (uint16)(r0.s0369, r0.sCF, r1.s258B, r1.sE, r2.s147A, r2.sD);
    const uint16 z_normal = (uint16)(r0.s147A, r0.sD, r1.s0369, r1.sCF, r2.s258B, r2.sE);
    *x = as_int16(xy & 0xffffu), *y = as_int16(xy >> 16), *z = as_int16(z_normal & 0xffffu), *normal = as_int16(z_normal >> 16);
}

// make_vertex of LANES nodes: the first four numbers of each vertex, and `attributes`. `origin`: low corner of the region, in cells.
INLINED void make_vertices(Grid grid, CutParams params, __global const Node *nodes, __global const VertexRecord *records, int3 origin,
                           float4 *vertices, uint *attributes) {
    const int lattice = (int)VERTEX_LATTICE, unit = 65536 / lattice;
    integer x, y, z, normal;
    load_records(records, &x, &y, &z, &normal);
    if (params.cap) { // as lattice_position
        const int3 low = (1 - origin) * lattice;
        const int3 high = ((int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2 - origin) * lattice;
        x = clamp(x, low.x, high.x), y = clamp(y, low.y, high.y), z = clamp(z, low.z, high.z);
    }
    const int16 nx = normal << 24 >> 24, ny = normal << 16 >> 24;
    const int16 wide_x = 258 * nx - (nx > 126) + (nx < -126), wide_y = 258 * ny - (ny > 126) + (ny < -126); // true is -1
    store_vec4s(as_float16(x * unit), as_float16(y * unit), as_float16(z * unit), as_float16(wide_x & 0xffff | wide_y << 16), vertices);
    __global const float *node = (__global const float *)nodes;
    const float16 n0 = vload16(0, node), n1 = vload16(1, node), n2 = vload16(2, node), n3 = vload16(3, node);
    const float16 s = (float16)(n0.s159D, n1.s159D, n2.s159D, n3.s159D), f = (float16)(n0.s26AE, n1.s26AE, n2.s26AE, n3.s26AE);
    const float16 feature = EXACT_QUOTIENT(fabs(f) - params.feature_lo, params.feature_span);
    const int16 low_half = convert_int16(clamp(s, 0.0f, 1.0f) * 65535.0f + 0.5f);
    const int16 high_half = convert_int16(clamp(feature, 0.0f, 1.0f) * 65535.0f + 0.5f);
    vstore16(as_uint16(low_half | high_half << 16), 0, attributes);
}

// Writes the vertices of `count` slots, those that are used.
INLINED void write_vertices(Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh, __global const uchar *used, uint first,
                            uint count) {
    uint begin = 0;
    for (; begin + LANES <= count; begin += LANES) {
        const uint slot = first + begin;
        float4 vertices[LANES];
        uint attributes[LANES];
        make_vertices(grid, mesh->params, cut->nodes + slot, mesh->records + slot, part->origin, vertices, attributes);
        for (uint i = 0; i < LANES; i++) {
            if (!used[slot + i]) continue;
            __global Vertex *to = mesh->out + mesh->compact_index[slot + i];
            vstore4(as_uint4(vertices[i]), 0, (__global uint *)to);
            to->attributes = attributes[i];
        }
    }
    for (; begin < count; begin++) write_vertex(grid, cut, part, mesh, used, first + begin);
}

#define TABLE_CELLS 729 // 9^3
#define TABLE_FIRST 91  // the brick's first cell
#define TABLE_ROWS (4 * TABLE_CELLS + 512 + LANES) // of several sheets, own cells have five rows
#define MULTI_SHEET 0x8000u // beside a row: the cell has several sheets, whose rows follow one another

typedef struct {
    // By x + 9 y + 81 z from the cell diagonally before the brick's first: row of the cell's vertex; if there are several, its
    // sheets (sheets.h).
    ushort row[TABLE_CELLS];
    uint sheets[TABLE_CELLS];
    ushort own[512]; // of the brick's active cells in order: index into the two above
    // Rows, each a vertex: position from the brick's low corner in 1/VERTEX_LATTICE cell, normal as in VertexRecord; the two in world
    // units; index in the region's mesh, and slot.
    short4 position_normal[TABLE_ROWS];
    float4 position[TABLE_ROWS], normal[TABLE_ROWS];
    uint index[TABLE_ROWS], slot[TABLE_ROWS];
} VertexTable;

// A brick whose cells go into a table.
typedef struct {
    __global const Brick *brick;
    uint region; // compact index
    __global const Region *home; // that region
    int3 origin; // of the region
} TableBrick;

// `name`: as a ghost, of a vertex of another region.
INLINED void set_row(VertexTable *table, uint row, Grid grid, const Part *part, const MeshVertices *mesh, const TableBrick *from,
                     uint slot, uint name) {
    // 16 bits hold the difference, for a cell in or beside the brick. The normal follows the position.
    const int3 shift = (from->origin - part->low) * (int)VERTEX_LATTICE;
    table->position_normal[row] = as_short4(vload4(0, mesh->records[slot].position) + convert_ushort4((int4)(shift, 0)));
    uint index = mesh->points.wanted ? cell_point(from->home, slot) : mesh->compact_index[slot];
    if (from->region != part->region && !mesh->points.wanted) {
        // Not every cell there is a corner of a polygon of this region.
        if (!(mesh->ghosts[part->region * HALO_WORDS + (name >> 5)] >> (name & 31) & 1u)) return;
        const int3 at = lattice_position(grid, mesh->params, mesh->records[slot], from->origin)
            - part->origin * (int)VERTEX_LATTICE;
        index = write_ghost(mesh, part->region, slot, mesh->nodes[slot], name, at);
    }
    table->index[row] = index;
    table->slot[row] = slot;
}

// Enters a cell at `at` and its extra sheets from row `row` on; returns the next free row.
INLINED uint set_cell(VertexTable *table, uint row, uint at, Grid grid, const Cut *cut, const Part *part,
                      const MeshVertices *mesh, const TableBrick *from, uint slot, uint name) {
    table->row[at] = (ushort)row;
    set_row(table, row++, grid, part, mesh, from, slot, name);
    if (!from->brick->extra_sheets || !meta_extras(cut->nodes[slot].meta)) return row;
    const uint extra = first_extra(cut->regions + from->region, from->brick, cut->nodes[slot]);
    table->row[at] |= MULTI_SHEET;
    table->sheets[at] = cut->nodes[extra].count;
    for (uint sheet = 1; sheet <= meta_extras(cut->nodes[slot].meta); sheet++)
        set_row(table, row++, grid, part, mesh, from, extra + sheet - 1, name + sheet);
    return row;
}

// The 32 cells of a word of a brick's mask, in Morton order: x + 9 y + 81 z, less that of the first.
__constant uchar CELL_IN_WORD[32] = {
    0,  1,  9,  10, 81, 82, 90, 91, 2,  3,  11, 12, 83,  84,  92,  93,
    18, 19, 27, 28, 99, 100, 108, 109, 20, 21, 29, 30, 101, 102, 110, 111,
};

// Index of a cell of a brick in the table, from its Morton number.
INLINED uint table_cell(uint cell) {
    const uint word = cell >> 5;
    return TABLE_FIRST + 4 * (word >> 1 & 1) + 36 * (word >> 2 & 1) + 162 * (word & 1) + 324 * (word >> 3) + CELL_IN_WORD[cell & 31u];
}

// Rows from `row` on in world units, LANES at a time; reads and writes up to LANES - 1 more than there are.
INLINED void scale_rows(VertexTable *table, uint row, uint rows, float3 scale) {
    for (; row < rows; row += LANES) {
        integer x, y, z, packed;
        load_short4s(table->position_normal + row, &x, &y, &z, &packed);
        const Real3 normal = decode_normal_lanes(packed);
        store_vec4s(TO_REAL(x) * scale.x, TO_REAL(y) * scale.y, TO_REAL(z) * scale.z, 0.0f, table->position + row);
        store_vec4s(normal.x, normal.y, normal.z, 0.0f, table->normal + row);
    }
}

// Writes the rows of LANES own cells from `row` on, in world units at once. `first`: slot of row 0.
INLINED void set_own_rows(VertexTable *table, uint row, const Part *part, const MeshVertices *mesh, const TableBrick *from, float3 scale,
                          uint first) {
    const int3 shift = (part->origin - part->low) * (int)VERTEX_LATTICE;
    integer x, y, z, packed;
    load_records(mesh->records + first + row, &x, &y, &z, &packed);
    const Real3 normal = decode_normal_lanes(packed);
    store_vec4s(TO_REAL(x + shift.x) * scale.x, TO_REAL(y + shift.y) * scale.y, TO_REAL(z + shift.z) * scale.z, 0.0f, table->position + row);
    store_vec4s(normal.x, normal.y, normal.z, 0.0f, table->normal + row);
    const uint16 slots = first + row + as_uint16(LANE_INDEX);
    // Points of cells are numbered as their slots are.
    const uint16 points = slots + (cell_point(from->home, first) - first);
    vstore16(mesh->points.wanted ? points : vload16(0, mesh->compact_index + first + row), 0, table->index + row);
    vstore16(slots, 0, table->slot + row);
}

// Enters the cells of the brick itself, a row each in their order from row 0 on; behind them, for every cell of several sheets, a row for
// each sheet. Returns the next free row. `scaled`: receives how many rows are in world units already.
INLINED uint enter_own_cells(VertexTable *table, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh,
                             const TableBrick *from, float3 scale, uint *scaled) {
    __global const Brick *brick = from->brick;
    const uint slots = from->home->slot_base, first = slots + brick->level_base[0], count = count_cells(brick);
    ushort cells[512];
    list_active_cells(brick, cells);
    for (uint i = 0; i < count; i += LANES) {
        const ushort16 m = vload16(0, cells + i), y = every_third_bit(m >> (ushort)1), z = every_third_bit(m >> (ushort)2);
        vstore16(every_third_bit(m) + y * (ushort)9 + z * (ushort)81 + (ushort)TABLE_FIRST, 0, table->own + i);
    }
    for (uint i = 0; i < count; i++) table->row[table->own[i]] = (ushort)i;
    uint row = count;
    *scaled = count < LANES ? 0 : count;
    for (uint i = *scaled; i < count; i++) set_row(table, i, grid, part, mesh, from, first + i, 0);
    // The last LANES cells: some of them for the second time.
    for (uint i = 0; i < *scaled; i += LANES) set_own_rows(table, min(i, count - LANES), part, mesh, from, scale, first);
    for (uint extra = slots + brick->level_base[3]; extra < slots + brick->level_base[3] + brick->extra_sheets; extra++) {
        const uint meta = cut->nodes[extra].meta, at = table_cell(code_cell(meta_code(meta), 0) & 511u);
        if (meta_extras(meta) == 1) { // of the first one's sheets
            const uint slot = first + table->row[at];
            table->row[at] = (ushort)(MULTI_SHEET | row);
            table->sheets[at] = cut->nodes[extra].count;
            set_row(table, row++, grid, part, mesh, from, slot, 0);
        }
        set_row(table, row++, grid, part, mesh, from, extra, 0);
    }
    return row;
}

// Enters the cells just before a brick of one of the seven bricks before it, which is `x`, `y` and `z` bricks away.
INLINED uint enter_cells_before(VertexTable *table, uint row, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh,
                                const TableBrick *from, uint x, uint y, uint z) {
    const int3 in_region = part->low - part->origin;
    // The last cells: the highest bits of x, y and z are their word's.
    const uint wanted = (x ? LAST_X : ~0u) & (y ? LAST_Y : ~0u) & (z ? LAST_Z : ~0u);
    const uint words = x << 1 | y << 2 | z * 9;
    for (uint word = words; word < 16; word = (word + 1) | words) {
        const uint cells = from->brick->cells[word];
        const uint first = from->home->slot_base + from->brick->level_base[0] + from->brick->cells_before[word];
        for (uint rest = cells & wanted; rest; rest &= rest - 1) {
            const uint bit = lowest_bit(rest), slot = first + popcount(cells & ((1u << bit) - 1));
            const uint cell = word << 5 | bit, at = table_cell(cell) - 8 * x - 72 * y - 648 * z;
            uint name = 0;
            if (from->region != part->region)
                name = 4 * halo_cell(in_region + convert_int3(unmorton(cell)) - 8 * (int3)((int)x, (int)y, (int)z));
            row = set_cell(table, row, at, grid, cut, part, mesh, from, slot, name);
        }
    }
    return row;
}

// Fills the table of a plain brick, whose vertices in world units are `scale` times those on the lattice.
INLINED void fill_table(VertexTable *table, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh, float3 scale) {
    uint row = 0, scaled = 0;
    for (uint before = 0; before < 8; before++) {
        const uint x = before & 1, y = before >> 1 & 1, z = before >> 2, index = part->near[13 - x - 3 * y - 9 * z];
        if (index == NONE) continue;
        const uint of = cut->bricks[index].region;
        const TableBrick from = {cut->bricks + index, of, cut->regions + of,
                                 convert_int3(region_origin(grid, cut->regions[of].region))};
        row = before == 0 ? enter_own_cells(table, grid, cut, part, mesh, &from, scale, &scaled)
                          : enter_cells_before(table, row, grid, cut, part, mesh, &from, x, y, z);
    }
    scale_rows(table, scaled, row, scale);
}

// Row of the vertex of a cell to which an edge of it belongs, from the cell's row. `at`: in the table.
INLINED uint row_of_edge(const VertexTable *table, uint row, uint at, uint edge) {
    return row & MULTI_SHEET ? (row & ~MULTI_SHEET) + edge_sheet(table->sheets[at], edge) : row;
}

// Whether the diagonal between corners 1 and 3 of a quad is better than the other one, as emit_batch decides it. `r`: rows of the
// corners. Both diagonals are measured side by side.
INLINED bool other_is_better(const VertexTable *table, uint4 r) {
    const float4 *p = table->position, *n = table->normal;
    const float8 d = (float8)(p[r.z], p[r.w]) - (float8)(p[r.x], p[r.y]);
    const float8 a = (float8)(n[r.x], n[r.y]) * d, b = (float8)(n[r.z], n[r.w]) * d, length = d * d;
    // Sums of four, for each half: of a, of b, of lengths.
    const float8 ab = (float8)(a.s02, b.s02, a.s46, b.s46) + (float8)(a.s13, b.s13, a.s57, b.s57);
    const float8 ll = (float8)(length.s02, length.s02, length.s46, length.s46) + (float8)(length.s13, length.s13, length.s57, length.s57);
    const float8 sums = (float8)(ab.s02, ll.s02, ab.s46, ll.s46) + (float8)(ab.s13, ll.s13, ab.s57, ll.s57);
    const float offset02 = fabs(sums.s0) + fabs(sums.s1), offset13 = fabs(sums.s4) + fabs(sums.s5);
    return (offset13 < offset02) | ((offset13 == offset02) & (sums.s6 < sums.s2));
}

// Quads of a plain brick, by the edge from the low corner of a cell that each is around: the cell in the table, then the axis, then
// whether the winding is flipped.
#define QUAD_AXIS 10
#define QUAD_FLIP 12
#define MAX_PLAIN_QUADS (3 * 512)

// Appends the quads of a cell at `at` to a list of `count`; returns how many there are. Branch-free: the outcome is unpredictable.
INLINED uint list_plain_quads(ushort *quads, uint count, uint at, uint signs) {
    // Along each axis, whether the cell's first corner and the next one lie on different sides.
    const uint inside = signs & 1u, crossed = inside ? ~signs : signs, entry = at | (inside ^ 1u) << QUAD_FLIP;
    quads[count] = (ushort)entry;
    count += crossed >> 1 & 1u;
    quads[count] = (ushort)(entry | 1 << QUAD_AXIS);
    count += crossed >> 2 & 1u;
    quads[count] = (ushort)(entry | 2 << QUAD_AXIS);
    return count + (crossed >> 4 & 1u);
}

// Writes the triangles of a listed quad. `first`: position of their first corner among all indices.
INLINED void write_plain_quad(const VertexTable *table, const TriangleOutput *out, uint quad, uint first) {
    const uint at = quad & ((1u << QUAD_AXIS) - 1), axis = quad >> QUAD_AXIS & 3u, flip_winding = quad >> QUAD_FLIP;
    // How far before it the cells are that lie a step back along the next two axes.
    const uint b = axis == 0 ? 9 : axis == 1 ? 81 : 1, c = axis == 0 ? 81 : axis == 1 ? 1 : 9;
    uint4 r = (uint4)(table->row[at], table->row[at - b], table->row[at - b - c], table->row[at - c]);
    if ((r.x | r.y | r.z | r.w) & MULTI_SHEET)
        r = (uint4)(row_of_edge(table, r.x, at, 4 * axis), row_of_edge(table, r.y, at - b, 4 * axis + 1),
                    row_of_edge(table, r.z, at - b - c, 4 * axis + 3), row_of_edge(table, r.w, at - c, 4 * axis + 2));
    const bool other = other_is_better(table, r);
    const uint *index = table->index, *slot = table->slot;
    write_corners(out->indices + first, (uint4)(index[r.x], index[r.y], index[r.z], index[r.w]), 4, flip_winding, other);
    if (out->keep_corners)
        write_corners(out->corner_slots + first, (uint4)(slot[r.x], slot[r.y], slot[r.z], slot[r.w]), 4, flip_winding, other);
}

// Writes the vertices of a plain brick and the quads of its cells away from the volume's faces, and lists the edges of the others,
// at most 12 of each of 8^3 - 6^3 cells; returns how many these are. `first_triangle`: index of its first triangle; `done`:
// triangles written so far.
INLINED uint emit_plain_brick(Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh, const TriangleOutput *out,
                              __global const uchar *used, uint first_triangle, uint *done, __local ushort *list) {
    __global const Brick *brick = cut->bricks + part->brick;
    const uint slots = cut->regions[part->region].slot_base, first = slots + brick->level_base[0], count = count_cells(brick);
    if (!mesh->points.wanted) {
        write_vertices(grid, cut, part, mesh, used, first, count);
        write_vertices(grid, cut, part, mesh, used, slots + brick->level_base[3], brick->extra_sheets);
    }
    VertexTable table;
    fill_table(&table, grid, cut, part, mesh, out->scale);
    ushort quads[MAX_PLAIN_QUADS + 1];
    uint listed = 0, quad_count = 0;
    for (uint i = 0; i < count; i++) {
        const uint meta = cut->nodes[first + i].meta, signs = meta_signs(meta);
        if (!part->all_quads && !is_inside(grid, part->origin + convert_int3(unmorton(code_cell(meta_code(meta), 0))))) {
            for (uint edges = crossed_edges(signs); edges; edges &= edges - 1) list[listed++] = edge_entry(0, i, lowest_bit(edges));
            continue;
        }
        quad_count = list_plain_quads(quads, quad_count, table.own[i], signs);
    }
    for (uint i = 0; i < quad_count; i++) write_plain_quad(&table, out, quads[i], 3 * (first_triangle + *done) + 6 * i);
    *done += 2 * quad_count;
    return listed;
}

#endif

#endif
