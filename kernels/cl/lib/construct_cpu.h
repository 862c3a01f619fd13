// construct on a CPU, which works on a brick with one work-item: see construct_device.h.
#ifndef ISOPEEL_CONSTRUCT_CPU_H
#define ISOPEEL_CONSTRUCT_CPU_H

#include "lib/active_cells.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/slots.h"

#if LANES == 16 // vectors of 16 numbers are taken apart below

// Phase: lists of active cells and of cubes; every cube counts as mergeable until a phase finds that it is not. Loops begin at `lid`, which
// is 0: if the compiler knows that, it finds several ways to the next barrier, and PoCL makes a copy of all later phases for each.
INLINED void list_cells_and_cubes(const BrickTask *task, const BrickMemory *memory, __global const uint *case_facts) {
    const uint lid = get_local_id(0);
    ushort cells[512];
    const uint count = list_active_cells(task->brick, cells);
    for (uint i = lid; i < count; i += LANES) {
        const ushort16 m = vload16(0, cells + i), x = every_third_bit(m), y = every_third_bit(m >> (ushort)1);
        vstore16(m >> (ushort)3 << (ushort)9 | every_third_bit(m >> (ushort)2) << (ushort)6 | y << (ushort)3 | x, 0, memory->cell_list + i);
    }
    for (uint i = lid; i < count; i++) memory->compact_index[memory->cell_list[i] & 511u] = (ushort)i;
    for (uint i = lid; i < 64; i++) memory->facts[i] = case_facts[i];
    for (uint i = lid; i < 16; i++) memory->multi_sheet_mask[i] = memory->even_sheet_mask[i] = memory->sheets_ge3_mask[i] = 0;
    *memory->work_count = 0;
    for (uint i = lid; i < MERGEABLE_ROWS; i++) memory->mergeable[i] = 1;
    uint column = 0;
    for (uint cube = lid; cube < 64; cube++) {
        memory->cube_ids[column] = (uchar)(1 << 6 | cube);
        column += level1_cells(task->brick, cube) != 0;
    }
    for (uint cube = lid; cube < 8; cube++) {
        memory->cube_ids[column] = (uchar)(2 << 6 | cube);
        column += task->brick->level2_mask >> cube & 1u;
    }
    memory->cube_ids[column] = 3 << 6;
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Lists the crossed edges with four cells of the brick around them, from rows of samples: a layer of 64 edges along an axis at once.
INLINED void list_inner_quads(const BrickMemory *memory) {
    uint n = 0;
    for (uint z = 0; z < 8; z++) {
        __local const ushort *rows = memory->inside_rows + 9 * z;
        const cell_bits here = load_cell_rows(rows, 0), inner_y = ~0xfful, inner_x = 0xfefefefefefefefeul;
        const cell_bits along_z = (here ^ load_cell_rows(rows + 9, 0)) & inner_x & inner_y;
        for (cell_bits rest = along_z; rest; rest &= rest - 1) memory->quad_list[n++] = (ushort)(1024 | z << 6 | lowest_cell_bit(rest));
        if (z == 0) continue;
        const cell_bits along_x = (here ^ load_cell_rows(rows, 1)) & inner_y, along_y = (here ^ load_cell_rows(rows + 1, 0)) & inner_x;
        for (cell_bits rest = along_x; rest; rest &= rest - 1) memory->quad_list[n++] = (ushort)(z << 6 | lowest_cell_bit(rest));
        for (cell_bits rest = along_y; rest; rest &= rest - 1) memory->quad_list[n++] = (ushort)(512 | z << 6 | lowest_cell_bit(rest));
    }
    *memory->work_count = n;
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

#endif

#endif
