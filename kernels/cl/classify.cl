// classify: the active cells of every active brick, and the slots of all nodes (docs/algorithm.md#10-memory-layout-on-the-device).
//
// classify: one work-group a brick. In: samples, list of active bricks, regions. Out: the bricks' masks and counts. Rows of samples
//   become rows of bits; bit operations on these give the active cells.
// arrange: one work-item a region. In: bricks. Out: first slots of the regions' levels and of the bricks' nodes.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/samples.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/tables.h"

// Which samples of a row are inside, and which are not missing, one bit each.
inline void row_bits(__global const SAMPLE *row, int columns, float iso, float missing, uint *inside, uint *valid) {
    *inside = 0;
    *valid = 0;
    int x = 0;
    if (columns == 9) {
        const float8 v = convert_float8(vload8(0, row));
        *inside = mask8(v >= iso && v != missing);
        *valid = mask8(v == v && v != missing);
        x = 8;
    }
    for (; x < columns; x++) {
        const float v = (float)row[x];
        *inside |= (uint)(v >= iso && v != missing) << x;
        *valid |= (uint)(!isnan(v) && v != missing) << x;
    }
}

// The 32 cells of word `word` of a brick in Morton order, from rows of eight bits y + 8 z.
inline uint gather_word(__local const uchar *rows, uint word) {
    const uint x = 4 * (word >> 1 & 1), y = 4 * (word >> 2 & 1), z = 4 * (word >> 3) + 2 * (word & 1);
    uint bits = 0;
    for (uint i = 0; i < 8; i++) {
        const uint cells = rows[y + (i & 3) + 8 * (z + (i >> 2))] >> x & 15u; // four along x
        // Bit 0 of x is bit 0 of the Morton number, bit 1 is bit 3.
        bits |= ((cells & 3u) | (cells & 12u) << 6) << (spread_bits(i & 3) << 1 | (i >> 2) << 2);
    }
    return bits;
}

// The brick at hand and what its phases share in local memory.
typedef struct {
    ClassifyArgs args;
    __global const SAMPLE *samples;
    int3 origin;           // low corner in the volume
    int3 end;              // samples of the volume along each axis
    bool all_known;        // all samples lie inside the volume and none is missing
    __local ushort *inside, *valid;           // rows of nine samples y + 9 z: above the isovalue; known, unless all are
    __local uchar *active_rows, *hole_rows;   // rows of eight cells y + 8 z: active; touching a missing sample
    __local uint *cells, *holes;              // the same in Morton order
    __local uint *extras, *quads;             // sheets beyond a cell's first; crossed edges from the cells' low corners
    __local uint *holed_rows;                 // whether any cell touches a missing sample
} ClassifyTask;

// Phase: rows of bits from the samples.
INLINED void read_rows(const ClassifyTask *task) {
    const Grid grid = task->args.grid;
    const float iso = task->args.iso;
    __global const SAMPLE *first = task->samples + sample_index(grid, task->args.z0, task->origin);
    const ulong width = grid.dims[0], plane = width * grid.dims[1];
    for (uint row = get_local_id(0); row < 81; row += BRICK_GROUP) {
        if (task->all_known) {
            __global const SAMPLE *from = first + row / 9 * plane + row % 9 * width;
            task->inside[row] = (ushort)(mask8(convert_float8(vload8(0, from)) >= iso) | (uint)((float)from[8] >= iso) << 8);
            continue;
        }
        const int3 p = task->origin + (int3)(0, (int)(row % 9), (int)(row / 9));
        uint above = 0, known = 0;
        if (p.y < task->end.y && p.z < task->end.z)
            row_bits(task->samples + sample_index(grid, task->args.z0, p), min(9, task->end.x - p.x), iso, grid.missing, &above,
                     &known);
        task->inside[row] = (ushort)above;
        task->valid[row] = (ushort)known;
    }
}

// The low corner of a brick of the list of active ones.
INLINED int3 listed_brick_origin(Grid grid, __global const Region *regions, uint packed) {
    return convert_int3(brick_origin(grid, regions[packed >> 6].region, packed & 63));
}

// ROWS_AT_ONCE rows of cells: which have this corner inside, one bit each.
typedef struct {
    cell_bits c0, c1, c2, c3, c4, c5, c6, c7;
} CornerBits;

INLINED CornerBits load_corner_bits(__local const ushort *inside) {
    const CornerBits bits = {
        load_cell_rows(inside, 0), load_cell_rows(inside, 1), load_cell_rows(inside + 1, 0), load_cell_rows(inside + 1, 1),
        load_cell_rows(inside + 9, 0), load_cell_rows(inside + 9, 1), load_cell_rows(inside + 10, 0), load_cell_rows(inside + 10, 1),
    };
    return bits;
}

// Faces whose corners are inside across, `a` and `d`, and outside, `b` and `c`, or the other way round.
INLINED cell_bits ambiguous_face(cell_bits a, cell_bits b, cell_bits c, cell_bits d) { return (a ^ b) & ~(a ^ d) & ~(b ^ c); }

// Cells that may have several sheets: those with an ambiguous face, and those in which only two opposite corners differ from the others.
INLINED cell_bits intricate_cells(const CornerBits *b) {
    const cell_bits faces = ambiguous_face(b->c0, b->c1, b->c2, b->c3) | ambiguous_face(b->c4, b->c5, b->c6, b->c7)
        | ambiguous_face(b->c0, b->c1, b->c4, b->c5) | ambiguous_face(b->c2, b->c3, b->c6, b->c7)
        | ambiguous_face(b->c0, b->c2, b->c4, b->c6) | ambiguous_face(b->c1, b->c3, b->c5, b->c7);
    const cell_bits unlike_opposite = (b->c0 ^ b->c7) | (b->c1 ^ b->c6) | (b->c2 ^ b->c5) | (b->c3 ^ b->c4);
    return faces | (~unlike_opposite & (b->c0 ^ b->c1 ^ b->c2 ^ b->c3));
}

// The sheets of these cells beyond their first ones. `p`: the first cell of the rows.
INLINED uint count_extra_sheets(const ClassifyTask *task, const CornerBits *b, cell_bits cells, int3 p) {
    uint extras = 0;
    for (cell_bits rest = cells; rest; rest &= rest - 1) {
        const uint i = lowest_cell_bit(rest);
        const uint signs = (uint)(b->c0 >> i & 1) | (uint)(b->c1 >> i & 1) << 1 | (uint)(b->c2 >> i & 1) << 2
            | (uint)(b->c3 >> i & 1) << 3 | (uint)(b->c4 >> i & 1) << 4 | (uint)(b->c5 >> i & 1) << 5 | (uint)(b->c6 >> i & 1) << 6
            | (uint)(b->c7 >> i & 1) << 7;
        const int3 cell = p + (int3)((int)(i & 7), (int)(i >> 3), 0);
        extras += sheet_count(cell_sheets(task->args.grid, task->samples, task->args.z0, task->args.iso, cell, signs)) - 1;
    }
    return extras;
}

// Which cells of the rows from `p` on lie in the volume.
INLINED cell_bits cells_in_volume(const ClassifyTask *task, int3 p) {
    if (p.z + 1 >= task->end.z) return 0;
    const cell_bits columns = (1u << min(8, task->end.x - 1 - p.x)) - 1;
    cell_bits cells = 0;
    for (int row = 0; row < ROWS_AT_ONCE; row++)
        if (p.y + row + 1 < task->end.y) cells |= columns << 8 * row;
    return cells;
}

// Which cells of rows have a missing sample at no corner.
INLINED cell_bits whole_cells(__local const ushort *valid) {
    const CornerBits b = load_corner_bits(valid);
    return b.c0 & b.c1 & b.c2 & b.c3 & b.c4 & b.c5 & b.c6 & b.c7;
}

// Phase: active cells and those that touch a missing sample, by rows of eight; crossed edges and extra sheets.
INLINED void classify_rows(const ClassifyTask *task) {
    for (uint i = get_local_id(0) * ROWS_AT_ONCE; i < 64; i += BRICK_GROUP * ROWS_AT_ONCE) {
        const uint y = i & 7, z = i >> 3, row = z * 9 + y;
        const int3 p = task->origin + (int3)(0, (int)y, (int)z);
        const CornerBits b = load_corner_bits(task->inside + row);
        const cell_bits some = b.c0 | b.c1 | b.c2 | b.c3 | b.c4 | b.c5 | b.c6 | b.c7;
        cell_bits active = some & ~(b.c0 & b.c1 & b.c2 & b.c3 & b.c4 & b.c5 & b.c6 & b.c7);
        if (!task->all_known) {
            const cell_bits whole = whole_cells(task->valid + row), holes = cells_in_volume(task, p) & ~whole;
            active &= whole;
            store_cell_rows(task->hole_rows + i, holes);
            if (holes) atomic_or(task->holed_rows, 1u);
        }
        store_cell_rows(task->active_rows + i, active);
        if (!active) continue;
        const uint along_x = popcount((b.c0 ^ b.c1) & active), along_y = popcount((b.c0 ^ b.c2) & active);
        add_local(task->quads, along_x + along_y + (uint)popcount((b.c0 ^ b.c4) & active));
        const uint extras = count_extra_sheets(task, &b, intricate_cells(&b) & active, p);
        if (extras) add_local(task->extras, extras);
    }
}

// Phase: the brick's masks and counts, from the words in Morton order.
INLINED void store_brick(const ClassifyTask *task, uint packed, __global Brick *brick) {
    const uint lid = get_local_id(0);
    __local const uint *cells = task->cells;
    for (uint word = lid; word < 16; word += BRICK_GROUP) {
        uint before = 0;
        for (uint i = 0; i < word; i++) before += popcount(cells[i]);
        brick->cells[word] = cells[word];
        brick->cells_before[word] = (ushort)before;
    }
    for (uint side = lid; side < 2; side += BRICK_GROUP) {
        uint level1_mask = 0, holed = 0;
        for (uint i = 0; i < 8; i++) {
            level1_mask |= nonzero_bytes(cells[8 * side + i]) << (4 * i);
            holed |= nonzero_bytes(task->holes[8 * side + i]) << (4 * i);
        }
        brick->level1_mask[side] = level1_mask;
        brick->level1_missing[side] = holed;
    }
    if (lid == 0) {
        brick->region = packed >> 6;
        brick->morton = packed & 63;
        brick->extra_sheets = *task->extras;
        brick->quad_count = *task->quads;
        uint level2_mask = 0;
        for (uint i = 0; i < 8; i++) level2_mask |= (uint)((cells[2 * i] | cells[2 * i + 1]) != 0) << i;
        brick->level2_mask = level2_mask;
    }
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void classify(const ClassifyArgs args, __global const SAMPLE *samples, __global const uint *list,
              __global const Region *regions, __global Brick *bricks) {
    __local ushort inside[81], valid[81];
    __local uchar active_rows[64], hole_rows[64];
    __local uint cells[16], holes[16], extras, quads, holed_rows;
    const Grid grid = args.grid;
    const uint index = args.first_brick + (uint)get_group_id(0);
    const uint packed = list[index]; // compact index of the region << 6 | Morton number of the brick
    __global const Region *region = regions + (packed >> 6);
    const int3 origin = listed_brick_origin(grid, regions, packed);
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    const bool missing = test_bit64(region->missing_mask[0], region->missing_mask[1], packed & 63);
    const ClassifyTask task = {
        args, samples, origin, end, all(origin + 9 <= end) && !missing, inside, valid, active_rows, hole_rows, cells, holes,
        &extras, &quads, &holed_rows,
    };
    if (get_local_id(0) == 0) extras = quads = holed_rows = 0;
    read_rows(&task);
    if (PREFETCHES && get_group_id(0) + 1 < get_num_groups(0))
        prefetch_samples(grid, samples, args.z0, listed_brick_origin(grid, regions, list[index + 1]));
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    classify_rows(&task);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    for (uint word = get_local_id(0); word < 16; word += BRICK_GROUP) {
        cells[word] = gather_word(active_rows, word);
        holes[word] = holed_rows ? gather_word(hole_rows, word) : 0;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    store_brick(&task, packed, bricks + index);
}

__kernel void arrange(const uint region_count, __global Region *regions, __global Brick *bricks) {
    const uint i = (uint)get_global_id(0);
    if (i >= region_count) return;
    __global Region *region = regions + i;
    const uint2 mask = (uint2)(region->brick_mask[0], region->brick_mask[1]);
    const uint count = count_bricks(region);
    uint base[4] = {0, 0, 0, 0};
    for (uint b = 0; b < count; b++) {
        __global Brick *brick = bricks + region->brick_base + b;
        brick->level_base[0] = base[0];
        brick->level_base[1] = base[1];
        brick->level_base[2] = base[2];
        brick->level_base[3] = base[3];
        base[0] += count_cells(brick);
        base[1] += count_level1(brick);
        base[2] += popcount(brick->level2_mask);
        base[3] += brick->extra_sheets;
    }
    const uint level4_count = popcount(nonzero_bytes(mask.x)) + popcount(nonzero_bytes(mask.y));
    const uint level1 = base[0], level2 = level1 + base[1], level3 = level2 + base[2], level4 = level3 + count;
    const uint sheets = level4 + level4_count + 1;
    for (uint b = 0; b < count; b++) {
        bricks[region->brick_base + b].level_base[1] += level1;
        bricks[region->brick_base + b].level_base[2] += level2;
        bricks[region->brick_base + b].level_base[3] += sheets;
    }
    region->level_base[0] = 0;
    region->level_base[1] = level1;
    region->level_base[2] = level2;
    region->level_base[3] = level3;
    region->level_base[4] = level4;
    region->level_base[5] = level4 + level4_count;
    region->level_base[6] = sheets;
    region->level_base[7] = sheets + base[3];
}
