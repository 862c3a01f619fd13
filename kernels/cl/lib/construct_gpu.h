// construct on a GPU, which works on a brick with BRICK_GROUP work-items: see construct_device.h.
#ifndef ISOPEEL_CONSTRUCT_GPU_H
#define ISOPEEL_CONSTRUCT_GPU_H

#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

// Phase: lists of active cells and of cubes; every cube counts as mergeable until a phase finds that it is not.
INLINED void list_cells_and_cubes(const BrickTask *task, const BrickMemory *memory, __global const uint *case_facts) {
    const uint lid = get_local_id(0);
    __global const Brick *brick = task->brick;
    ROLLED for (uint i = lid; i < 64; i += BRICK_GROUP) {
        memory->facts[i] = case_facts[i];
        memory->mergeable[MERGEABLE_LEVEL1 + i] = 1;
        const uint cells = level1_cells(brick, i);
        if (!cells) continue;
        uint at = cells_before_level1(brick, i);
        const uint3 low = unmorton(i << 3);
        ROLLED for (uint rest = cells; rest; rest &= rest - 1, at++) {
            const uint bit = lowest_bit(rest), in_cube = (bit & 1u) | (bit << 2 & 8u) | (bit << 4 & 64u);
            const uint cell = low.x + 8 * low.y + 64 * low.z + in_cube;
            memory->cell_list[at] = (ushort)(i << 9 | cell);
            memory->compact_index[cell] = (ushort)at;
        }
        memory->cube_ids[level1_column(brick, i)] = (uchar)(1 << 6 | i);
    }
    if (lid == 0) *memory->work_count = 0;
    ROLLED for (uint i = lid; i < 16; i += BRICK_GROUP)
        memory->multi_sheet_mask[i] = memory->even_sheet_mask[i] = memory->sheets_ge3_mask[i] = 0;
    ROLLED for (uint i = lid; i < 9; i += BRICK_GROUP) {
        memory->mergeable[MERGEABLE_LEVEL2 + i] = 1;
        if (i == 8) memory->cube_ids[task->cube_count - 1] = 3 << 6;
        else if (brick->level2_mask >> i & 1u) memory->cube_ids[level2_column(task, i)] = (uchar)(2 << 6 | i);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Lists the crossed edges with four cells of the brick around them, from rows of samples: y + 8 z, one bit a sample.
INLINED void list_inner_quads(const BrickMemory *memory) {
    __local const ushort *rows = memory->inside_rows;
    __local ushort *quads = memory->quad_list;
    for (uint i = get_local_id(0); i < 64; i += BRICK_GROUP) {
        const uint y = i & 7, z = i >> 3, row = 9 * z + y, here = rows[row];
        uint along_x = (here ^ here >> 1) & 0xffu, along_y = (here ^ rows[row + 1]) & 0xfeu;
        uint along_z = (here ^ rows[row + 9]) & 0xfeu;
        if (y == 0) along_x = along_z = 0;
        if (z == 0) along_x = along_y = 0;
        if (!(along_x | along_y | along_z)) continue;
        uint n = add_local(memory->work_count, popcount(along_x | along_y << 8 | along_z << 16));
        for (uint rest = along_x; rest; rest &= rest - 1) quads[n++] = (ushort)(i << 3 | lowest_bit(rest));
        for (uint rest = along_y; rest; rest &= rest - 1) quads[n++] = (ushort)(512 | i << 3 | lowest_bit(rest));
        for (uint rest = along_z; rest; rest &= rest - 1) quads[n++] = (ushort)(1024 | i << 3 | lowest_bit(rest));
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

#endif
