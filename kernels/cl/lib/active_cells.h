// Lists the active cells of a brick if one work-item makes the list. Branch-free: the outcome is unpredictable.
#ifndef ISOPEEL_ACTIVE_CELLS_H
#define ISOPEEL_ACTIVE_CELLS_H

#include "lib/device.h"
#include "lib/layout.h"
#include "lib/set_bits.h"
#include "lib/slots.h"

// Lists the Morton numbers of the active cells in a brick, in their order; returns how many there are. What is behind them in `list`, which
// holds 512, is undefined.
INLINED uint list_active_cells(__global const Brick *brick, ushort *list) {
    uint count = 0;
    for (uint cube = 0; cube < 64; cube++) {
        const uint cells = level1_cells(brick, cube);
        vstore8(convert_ushort8(as_uchar8(SET_BITS[cells])) + (ushort)(8 * cube), 0, list + count);
        count += popcount(cells);
    }
    return count;
}

// Every third bit of LANES numbers of nine bits, put together: coordinates from Morton numbers.
INLINED ushort16 every_third_bit(ushort16 m) { return (m & (ushort)1) | (m >> (ushort)2 & (ushort)2) | (m >> (ushort)4 & (ushort)4); }

#endif
