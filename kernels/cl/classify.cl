// classify: the active cells of every active brick as bit masks, and the place of every node.
// classify: one work-group a brick; rows of samples become rows of bits, cells come from them by bit operations.
// arrange: one work-item a region; first slots of its bricks and levels.

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void classify(const Grid grid, SLAB, const float iso, const uint first_brick, __global const uint *list,
              __global const Region *regions, __global Brick *bricks) {
    __local ushort inside[81], valid[81];
    __local uint cells[16], holes[16], extras;
    const uint lid = get_local_id(0);
    __global Brick *brick = bricks + first_brick + get_group_id(0);
    const uint named = list[first_brick + get_group_id(0)]; // compact region, then 6 bits of Morton number
    const int3 origin = convert_int3(region_origin(grid, regions[named >> 6].region) + unmorton((named & 63) << 9));
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    if (lid < 16) { cells[lid] = 0; holes[lid] = 0; }
    if (lid == 16) extras = 0;
    for (uint row = lid; row < 81; row += 64) {
        const int3 p = origin + (int3)(0, (int)(row % 9), (int)(row / 9));
        uint above = 0, known = 0;
        if (p.y < end.y && p.z < end.z) {
            const ulong base = sample_index(grid, z0, p);
            const int columns = min(9, end.x - origin.x);
            for (int x = 0; x < columns; x++) {
                const float v = (float)samples[base + x];
                above |= (uint)(v >= iso && v != grid.missing) << x;
                known |= (uint)(!isnan(v) && v != grid.missing) << x;
            }
        }
        inside[row] = (ushort)above;
        valid[row] = (ushort)known;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // Work-item (y, z) makes the 8 cells of one row.
    const uint y = lid & 7, z = lid >> 3, row = z * 9 + y;
    const uint some = inside[row] | inside[row + 1] | inside[row + 9] | inside[row + 10];
    const uint every = inside[row] & inside[row + 1] & inside[row + 9] & inside[row + 10];
    const uint known = valid[row] & valid[row + 1] & valid[row + 9] & valid[row + 10];
    const uint whole = known & known >> 1 & 0xffu;
    const uint active = (some | some >> 1) & ~(every & every >> 1) & whole;
    // Cells inside the volume that are not whole touch a missing sample.
    const int3 p = origin + (int3)(0, (int)y, (int)z);
    const uint columns = p.y + 1 < end.y && p.z + 1 < end.z ? (uint)min(8, end.x - 1 - origin.x) : 0u;
    const uint hole = ((1u << columns) - 1) & ~whole;
    // Bits 0, 1 of x go to places 0, 3 of the Morton number, bit 2 to place 6: two words further.
    const uint base = spread(y) << 1 | spread(z) << 2, word = base >> 5, shift = base & 31;
    for (uint part = 0; part < 2; part++) {
        const uint a = active >> (4 * part) & 15u, h = hole >> (4 * part) & 15u;
        if (a) atomic_or(&cells[word + 2 * part], ((a & 3u) | (a & 12u) << 6) << shift);
        if (h) atomic_or(&holes[word + 2 * part], ((h & 3u) | (h & 12u) << 6) << shift);
    }
    // Cells that the surface crosses in several sheets need a vertex for each.
    uint more = 0;
    for (uint rest = active; rest; rest &= rest - 1) {
        const uint x = 31 - clz(rest & -rest);
        const uint signs = (inside[row] >> x & 3u) | (inside[row + 1] >> x & 3u) << 2 | (inside[row + 9] >> x & 3u) << 4
            | (inside[row + 10] >> x & 3u) << 6;
        more += sheet_count(cell_sheets(grid, SLAB_ARGS, iso, p + (int3)((int)x, 0, 0), signs)) - 1;
    }
    if (more) atomic_add(&extras, more);
    barrier(CLK_LOCAL_MEM_FENCE);

    if (lid < 16) {
        uint before = 0;
        for (uint i = 0; i < lid; i++) before += popcount(cells[i]);
        brick->cells[lid] = cells[lid];
        brick->prefix[lid] = (ushort)before;
    }
    if (lid < 2) {
        uint twos = 0, holed = 0;
        for (uint i = 0; i < 8; i++) {
            twos |= nonzero_bytes(cells[8 * lid + i]) << (4 * i);
            holed |= nonzero_bytes(holes[8 * lid + i]) << (4 * i);
        }
        brick->twos[lid] = twos;
        brick->holes[lid] = holed;
    }
    if (lid == 0) {
        brick->region = named >> 6;
        brick->morton = named & 63;
        brick->extras = extras;
        uint fours = 0;
        for (uint i = 0; i < 8; i++) fours |= (uint)((cells[2 * i] | cells[2 * i + 1]) != 0) << i;
        brick->fours = fours;
    }
}

__kernel void arrange(const uint region_count, __global Region *regions, __global Brick *bricks) {
    const uint i = (uint)get_global_id(0);
    if (i >= region_count) return;
    __global Region *region = regions + i;
    const uint2 mask = (uint2)(region->brick_mask[0], region->brick_mask[1]);
    const uint count = popcount(mask.x) + popcount(mask.y);
    uint base[4] = {0, 0, 0, 0};
    for (uint b = 0; b < count; b++) {
        __global Brick *brick = bricks + region->brick_base + b;
        brick->base[0] = base[0];
        brick->base[1] = base[1];
        brick->base[2] = base[2];
        brick->base[3] = base[3];
        base[0] += brick->prefix[15] + popcount(brick->cells[15]);
        base[1] += popcount(brick->twos[0]) + popcount(brick->twos[1]);
        base[2] += popcount(brick->fours);
        base[3] += brick->extras;
    }
    const uint eights = popcount(nonzero_bytes(mask.x)) + popcount(nonzero_bytes(mask.y));
    const uint level1 = base[0], level2 = level1 + base[1], level3 = level2 + base[2], level4 = level3 + count;
    const uint sheets = level4 + eights + 1;
    for (uint b = 0; b < count; b++) {
        bricks[region->brick_base + b].base[1] += level1;
        bricks[region->brick_base + b].base[2] += level2;
        bricks[region->brick_base + b].base[3] += sheets;
    }
    region->level_base[0] = 0;
    region->level_base[1] = level1;
    region->level_base[2] = level2;
    region->level_base[3] = level3;
    region->level_base[4] = level4;
    region->level_base[5] = level4 + eights;
    region->level_base[6] = sheets;
    region->level_base[7] = sheets + base[3];
}
