// Vertices of the cells of a plain brick, and of those of its region just before it, which most quads of the brick join: a
// device that works on a brick with one work-item looks each up once, not once for every quad.
#ifndef ISOPEEL_CORNERS_H
#define ISOPEEL_CORNERS_H
#if BRICK_GROUP == 1

#define SEVERAL 0x8000u // beside a place: the cell has several sheets

typedef struct {
    ushort at[729]; // place of a cell's vertex in the rows below, by x + 9 y + 81 z from the cell before the brick's first
    float x[730], y[730], z[730], u[730], v[730]; // as in Batch; the last is for sheets that have no place
    uint index[730], slot[730], brick[730];
} Corners;

inline void set_corner(Corners *corners, uint n, __global const Placement *placements, __global const uint *places, uint slot,
                       float3 scale) {
    const Placement place = placements[slot];
    corners->x[n] = (float)place.position[0] * scale.x;
    corners->y[n] = (float)place.position[1] * scale.y;
    corners->z[n] = (float)place.position[2] * scale.z;
    corners->u[n] = (float)(char)(place.normal & 0xffu) * (1.0f / 127.0f);
    corners->v[n] = (float)(char)(place.normal >> 8 & 0xffu) * (1.0f / 127.0f);
    corners->index[n] = places[slot];
    corners->slot[n] = slot;
}

// `in_region`: the brick's low corner from the region's.
inline void find_corners(Corners *corners, __global const Region *region, __global const Brick *bricks,
                         __global const Node *nodes, __global const Placement *placements, __global const uint *places,
                         __global const uint *near, int3 in_region, float3 scale) {
    uint n = 0;
    for (uint before = 0; before < 8; before++) {
        const uint x = before & 1, y = before >> 1 & 1, z = before >> 2, index = near[13 - x - 3 * y - 9 * z];
        if (index == NONE || (x && in_region.x == 0) || (y && in_region.y == 0) || (z && in_region.z == 0)) continue;
        __global const Brick *brick = bricks + index;
        // Of the bricks before this one the last cells: the highest bits of x, y and z are their word's.
        const uint wanted = (x ? LAST_X : ~0u) & (y ? LAST_Y : ~0u) & (z ? LAST_Z : ~0u);
        const uint words = x << 1 | y << 2 | z * 9;
        for (uint word = 0; word < 16; word++) {
            if ((word & words) != words) continue;
            const uint first = region->slot_base + brick->base[0] + brick->prefix[word];
            for (uint rest = brick->cells[word] & wanted; rest; rest &= rest - 1, n++) {
                const uint bit = lowest_bit(rest), cell = word << 5 | bit;
                const uint slot = first + popcount(brick->cells[word] & ((1u << bit) - 1));
                const bool several = brick->extras && meta_extras(nodes[slot].meta);
                corners->at[(x ? 0 : gather(cell) + 1) + 9 * (y ? 0 : gather(cell >> 1) + 1) + 81 * (z ? 0 : gather(cell >> 2) + 1)]
                    = (ushort)(several ? n | SEVERAL : n);
                corners->brick[n] = index;
                set_corner(corners, n, placements, places, slot, scale);
            }
        }
    }
}

// Puts the quad around the edge along `axis` from the low corner of a cell of the brick into a batch.
inline void add_plain_quad(Batch *batch, Corners *corners, __global const Region *region, __global const Brick *bricks,
                           __global const Node *nodes, __global const Placement *placements, __global const uint *places,
                           uint3 cell, uint axis, uint turn, uint first_corner, float3 scale) {
    const uint column = NEXT_COLUMN(batch), at = cell.x + 1 + 9 * (cell.y + 1) + 81 * (cell.z + 1);
    const uint b = axis == 0 ? 9 : axis == 1 ? 81 : 1, c = axis == 0 ? 81 : axis == 1 ? 1 : 9;
    const uint around[4] = {at, at - b, at - b - c, at - c};
    for (uint i = 0; i < 4; i++) {
        const uint row = i * LANES + column;
        uint n = corners->at[around[i]];
        if (n & SEVERAL) {
            const uint first = n & ~SEVERAL;
            const uint edge = 4 * axis + (i ^ i >> 1);
            const uint slot = sheet_in_brick(region, bricks + corners->brick[first], nodes, corners->slot[first], edge);
            n = 729;
            set_corner(corners, n, placements, places, slot, scale);
        }
        batch->index[row] = corners->index[n];
        batch->slot[row] = corners->slot[n];
        batch->x[row] = corners->x[n];
        batch->y[row] = corners->y[n];
        batch->z[row] = corners->z[n];
        batch->u[row] = corners->u[n];
        batch->v[row] = corners->v[n];
    }
    batch->first[column] = first_corner;
    batch->shape[column] = 4 | turn << 3;
}

#endif
#endif
