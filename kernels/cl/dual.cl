// dual: the mesher that is watertight by construction (algorithm, section 6). One vertex a leaf and sheet, one polygon for
// every minimal edge of the cut whose ends differ in sign, joining the leaves around it.
// dual_fine: which cells are leaves themselves. One work-item a brick.
// dual_count: triangles, and which vertices each region needs: its own and *ghosts*, leaves of other regions around it.
// dual_place: where the vertices and triangles of each brick go. One work-group a region.
// dual_emit: vertices and indices.
// dual_count and dual_emit have one work-group a brick, for leaves of levels 0 to 3, and behind these one a region, for
// those of levels 4 and 5.
//
// Where the surface leaves the volume it goes on to the face: around an edge on a face the cubes beyond are stood in for by
// *border vertices* of their mirror images inside, each a leaf's vertex moved along its tangent plane onto the face, so that
// the surface ends in a clean border there.
//
// A ghost, or a border vertex, is named by a cell of the region's shell, the layer of cells around it: the leaf's first
// cell there, or beyond the face the one next to it, and its sheet. The names are bits of a mask; a ghost's place is the
// number of bits below.

#define SHELL_CELLS 6536 // 34^3 - 32^3
#define SHELL_WORDS 817  // four sheets a cell, 32 bits a word
#define ON_BORDER 0x80000000u // beside a corner's slot: it is a border vertex

// A cut; for polygons also the 27 bricks around each brick, and which of its cells are leaves themselves.
#define CUT_PARAMS                                                                                                     \
    __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,                  \
        __global const Node *nodes, __global const uchar *state
#define POLYGON_PARAMS CUT_PARAMS, __global const uint *near, __global const Fine *fine
#define POLYGON_ARGS region_index, regions, bricks, nodes, state, near, fine

// Which cells of a brick are leaves: its level-1 cubes, 64 bits, and whether that is all.
typedef struct {
    uint ones[2], all;
} Fine;

typedef struct {
    uint slot[4];   // the leaves' slots in the order around the edge, each once
    uint region[4]; // their compact regions
    uint faces[4];  // of a border vertex the volume's faces, bit 2 axis + side
    uint count;     // 0: no polygon; 3 or 4
} Polygon;

inline uint shell_cell(int3 p) {
    if (p.z < 0) return (uint)((p.y + 1) * 34 + p.x + 1);
    if (p.z > 31) return (uint)(34 * 34 + (p.y + 1) * 34 + p.x + 1);
    const uint ring = 2 * 34 * 34 + 132 * (uint)p.z;
    if (p.y < 0) return ring + (uint)(p.x + 1);
    if (p.y > 31) return ring + 34 + (uint)(p.x + 1);
    return ring + 68 + 2 * (uint)p.y + (p.x > 31);
}

// Slot of the sheet of an active cell to which one of its edges belongs.
inline uint sheet_slot(__global const Region *region, __global const Brick *bricks, __global const Node *nodes, uint slot,
                       uint edge) {
    const uint b = code_cell(meta_code(nodes[slot].meta), 0) >> 9;
    return sheet_in_brick(region, bricks + region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], b), nodes,
                          slot, edge);
}

// The bricks around a brick: x + 3 y + 9 z, itself at 13. `low`: its first cell in the volume.
inline uint near_brick(__global const uint *near, int3 low, int3 cell) {
    const int3 d = (cell - low + 8) >> 3;
    return near[d.x + 3 * d.y + 9 * d.z];
}

inline bool is_cell_active(__global const Brick *brick, uint cell) { return brick->cells[cell >> 5] >> (cell & 31) & 1u; }

// As find_slot, in a brick at hand.
inline uint find_in_brick(__global const Region *region, __global const Brick *bricks, uint index, uint level, uint cell) {
    __global const Brick *brick = bricks + index;
    const uint i = (cell & 511) >> (3 * level);
    if (level == 0) {
        const uint word = brick->cells[i >> 5], bit = 1u << (i & 31);
        return word & bit ? region->slot_base + brick->base[0] + brick->prefix[i >> 5] + popcount(word & (bit - 1)) : NONE;
    }
    if (level == 1)
        return bit64(brick->twos[0], brick->twos[1], i)
            ? region->slot_base + brick->base[1] + rank64(brick->twos[0], brick->twos[1], i) : NONE;
    if (level == 2)
        return brick->fours >> i & 1u ? region->slot_base + brick->base[2] + popcount(brick->fours & ((1u << i) - 1)) : NONE;
    return region->slot_base + region->level_base[3] + index - region->brick_base;
}

// The polygon around an edge of a leaf, if this leaf is the one to emit it: the first of the finest around the edge.
// `low`: the leaf's low corner in the volume; of leaves up to level 3 `near` are the bricks around that at `brick_low`.
inline Polygon edge_polygon(Grid grid, POLYGON_PARAMS, int3 brick_low, uint own_region, uint own_slot, uint level,
                            int3 low, uint edge) {
    Polygon polygon;
    polygon.count = 0;
    const uint axis = edge >> 2, own = edge & 3, size = 1u << level;
    const uint b = (axis + 1) % 3, c = (axis + 2) % 3;
    const int3 at = low + edge_offset(edge) * (int)size;
    // Cubes on one side of the edge may lie beyond a face.
    const int at_b = b == 0 ? at.x : b == 1 ? at.y : at.z, at_c = c == 0 ? at.x : c == 1 ? at.y : at.z;
    const uint beyond_b = at_b == 0 ? 2u : at_b + 1 >= (int)grid.dims[b] ? 1u : 0u; // k & 1 of these cubes, plus 1
    const uint beyond_c = at_c == 0 ? 2u : at_c + 1 >= (int)grid.dims[c] ? 1u : 0u;
    uint slots[4], in_regions[4], faces[4];
    for (uint k = 0; k < 4; k++) {
        const uint out_b = beyond_b == (k & 1) + 1, out_c = beyond_c == (k >> 1) + 1;
        faces[k] = (out_b ? 1u << (2 * b + (beyond_b == 1)) : 0) | (out_c ? 1u << (2 * c + (beyond_c == 1)) : 0);
        if (faces[k]) continue;
        if (k == own) {
            in_regions[k] = own_region;
            slots[k] = level == 0 ? sheet_in_brick(regions + own_region, bricks + near[13], nodes, own_slot, edge) : own_slot;
            continue;
        }
        const int3 cube = at - (axis_step(b) * (int)(k & 1) + axis_step(c) * (int)(k >> 1)) * (int)size;
        const uint cell = morton(convert_uint3(cube) & 31u);
        uint brick = NONE;
        if (level < 4) {
            brick = near_brick(near, brick_low, cube);
            if (brick == NONE) return polygon; // samples are missing: an open border
            if (level == 0) {
                if (!is_cell_active(bricks + brick, cell & 511)) return polygon;
                if (k < own && bit64(fine[brick].ones[0], fine[brick].ones[1], cell >> 3 & 63)) return polygon;
            }
            in_regions[k] = bricks[brick].region;
            slots[k] = find_in_brick(regions + in_regions[k], bricks, brick, level, cell);
        } else slots[k] = find_slot_at(grid, region_index, regions, bricks, level, cube, &in_regions[k]);
        if (slots[k] == NONE) return polygon;
        const uint covers = state[slots[k]];
        if (covers == INTERNAL || (covers == level && k < own)) return polygon;
        if (covers > level) slots[k] = find_slot(regions + in_regions[k], bricks, covers, cell);
        else if (level == 0)
            slots[k] = sheet_in_brick(regions + in_regions[k], bricks + brick, nodes, slots[k], 4 * axis + k);
    }
    // Beyond a face stands the mirror image, across b, then across c.
    if (beyond_b | beyond_c) {
        for (uint k = 0; k < 4; k += 2) {
            if (beyond_b == 1) { slots[k] = slots[k + 1]; in_regions[k] = in_regions[k + 1]; }
            if (beyond_b == 2) { slots[k + 1] = slots[k]; in_regions[k + 1] = in_regions[k]; }
        }
        for (uint k = 0; k < 2; k++) {
            if (beyond_c == 1) { slots[k] = slots[k + 2]; in_regions[k] = in_regions[k + 2]; }
            if (beyond_c == 2) { slots[k + 2] = slots[k]; in_regions[k + 2] = in_regions[k]; }
        }
    }
    // Once around the edge: 0 1 3 2. A coarser leaf may stand at two neighbouring places, of which one is left out.
#define SAME(i, j) (slots[i] == slots[j] && faces[i] == faces[j])
    const bool without_first = SAME(0, 1), without_second = without_first || SAME(1, 3);
    const bool without_last = SAME(3, 2) || SAME(2, 0);
#undef SAME
#define TAKE(place, k)                                                                                                 \
    polygon.slot[place] = slots[k];                                                                                    \
    polygon.region[place] = in_regions[k];                                                                             \
    polygon.faces[place] = faces[k];
    TAKE(0, 0)
    if (without_first) { TAKE(1, 3) } else { TAKE(1, 1) }
    if (without_second) { TAKE(2, 2) } else { TAKE(2, 3) }
    TAKE(3, 2)
#undef TAKE
    polygon.count = without_second || without_last ? 3 : 4;
    return polygon;
}

// The same between cells that all are leaves, around the edge along `axis` from a cell's low corner.
__attribute__((always_inline)) inline Polygon plain_polygon(__global const Region *regions, __global const Brick *bricks, __global const Node *nodes,
                             __global const uint *near, int3 brick_low, uint own_slot, int3 low, uint axis) {
    Polygon polygon;
    polygon.count = 4;
    const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
    for (uint i = 0; i < 4; i++) {
        const uint k = i ^ i >> 1;
        const int3 at = low - b * (int)(k & 1) - c * (int)(k >> 1);
        const uint brick = k == 0 ? near[13] : near_brick(near, brick_low, at);
        const uint in = bricks[brick].region;
        const uint slot = k == 0 ? own_slot
            : find_in_brick(regions + in, bricks, brick, 0, morton(convert_uint3(at) & 7u));
        polygon.region[i] = in;
        polygon.faces[i] = 0;
        polygon.slot[i] = sheet_in_brick(regions + in, bricks + brick, nodes, slot, 4 * axis + k);
    }
    return polygon;
}

// Bit that names a ghost, or a border vertex at `faces`, of the region at `origin`.
inline uint ghost_bit(Grid grid, __global const Region *regions, __global const Node *nodes, int3 origin, uint region,
                      uint slot, uint faces) {
    const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code);
    int3 low = convert_int3(region_origin(grid, regions[region].region) + unmorton(code_cell(code, level))) - origin;
    low = max(low, (int3)(-1));
    if (faces) {
        low.x = faces & 1u ? -1 : faces & 2u ? 32 : low.x;
        low.y = faces & 4u ? -1 : faces & 8u ? 32 : low.y;
        low.z = faces & 16u ? -1 : faces & 32u ? 32 : low.z;
    }
    const bool extra = slot - regions[region].slot_base >= regions[region].level_base[6];
    return 4 * shell_cell(low) + (extra ? meta_extras(meta) : 0);
}

__kernel void dual_fine(const uint brick_count, __global const Region *regions, __global const Brick *bricks,
                        __global const uchar *state, __global Fine *fine) {
    const uint index = (uint)get_global_id(0);
    if (index >= brick_count) return;
    __global const Brick *brick = bricks + index;
    uint slot = regions[brick->region].slot_base + brick->base[1], leaves[2];
    for (uint side = 0; side < 2; side++) {
        leaves[side] = 0;
        for (uint rest = brick->twos[side]; rest; rest &= rest - 1)
            if (state[slot++] == INTERNAL) leaves[side] |= rest & -rest;
    }
    fine[index].ones[0] = leaves[0];
    fine[index].ones[1] = leaves[1];
    fine[index].all = leaves[0] == brick->twos[0] && leaves[1] == brick->twos[1];
}

// What a work-group of dual_count or dual_emit works on.
typedef struct {
    uint brick;  // NONE: the region's levels 4 and 5
    uint region; // compact
    int3 origin; // of the region, in cells
    int3 low;    // of the brick
} Part;

inline Part find_part(Grid grid, uint brick_count, __global const Region *regions, __global const Brick *bricks) {
    Part part;
    const uint group = (uint)get_group_id(0);
    const bool top = group >= brick_count;
    part.brick = top ? NONE : group;
    part.region = top ? group - brick_count : bricks[group].region;
    part.origin = convert_int3(region_origin(grid, regions[part.region].region));
    part.low = part.origin + (top ? (int3)(0) : convert_int3(unmorton(bricks[group].morton << 9)));
    return part;
}

// First slot of a part's nodes of a level, relative to the region's, and how many: of level 6 its extra sheets.
inline uint part_first(Part part, __global const Region *region, __global const Brick *bricks, uint level) {
    if (part.brick == NONE) return region->level_base[level];
    if (level == 3) return region->level_base[3] + part.brick - region->brick_base;
    return bricks[part.brick].base[level == 6 ? 3 : level];
}
inline uint part_count(Part part, __global const Region *region, __global const Brick *bricks, uint level) {
    if (part.brick == NONE) return level == 4 || level == 5 ? region->level_base[level + 1] - region->level_base[level] : 0;
    __global const Brick *brick = bricks + part.brick;
    switch (level) {
        case 0: return brick->prefix[15] + popcount(brick->cells[15]);
        case 1: return popcount(brick->twos[0]) + popcount(brick->twos[1]);
        case 2: return popcount(brick->fours);
        case 3: return 1;
        case 6: return brick->extras;
        default: return 0;
    }
}

// Edges of a cell that the next cell along an axis emits, where that one is a leaf too.
#define EDGES_NEXT_X (1u << 6 | 1u << 7 | 1u << 9 | 1u << 11)
#define EDGES_NEXT_Y (1u << 1 | 1u << 3 | 1u << 10 | 1u << 11)
#define EDGES_NEXT_Z (1u << 2 | 1u << 3 | 1u << 5 | 1u << 7)

// Edges that each of a work-group's leaves may emit, one after another, so that every work-item gets one: leaf << 4 | edge.
// Answers how many there are.
inline uint list_edges(__local ushort *list, __local uint *scratch, uint edges) {
    uint total, at = scan_group(scratch, popcount(edges), &total);
    for (uint rest = edges; rest; rest &= rest - 1) list[at++] = (ushort)((uint)get_local_id(0) << 4 | lowest_bit(rest));
    barrier(CLK_LOCAL_MEM_FENCE);
    return total;
}

// Away from the volume's end?
inline bool is_inside(Grid grid, int3 cell) {
    return all(cell > 0) && all(cell + 2 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]));
}

// Is the cell an active one of a brick around, and a leaf itself?
inline bool is_leaf_cell(__global const Brick *bricks, __global const uint *near, __global const Fine *fine, int3 brick_low,
                         int3 cell) {
    const uint brick = near_brick(near, brick_low, cell);
    if (brick == NONE) return false;
    const uint m = morton(convert_uint3(cell) & 7u);
    return is_cell_active(bricks + brick, m) && bit64(fine[brick].ones[0], fine[brick].ones[1], m >> 3);
}

// Of the crossed edges of a leaf cell at `low` those that the cell at the edge's high side does not emit.
inline uint without_next(__global const Brick *bricks, __global const uint *near, __global const Fine *fine, int3 brick_low,
                         int3 low, uint crossed) {
#define DROP(edges, x, y, z)                                                                                           \
    if (crossed & (edges) && is_leaf_cell(bricks, near, fine, brick_low, low + (int3)(x, y, z))) crossed &= ~(edges);
    DROP(1u << 6 | 1u << 9, 1, 0, 0)
    DROP(1u << 1 | 1u << 10, 0, 1, 0)
    DROP(1u << 2 | 1u << 5, 0, 0, 1)
    DROP(1u << 11, 1, 1, 0)
    DROP(1u << 3, 0, 1, 1)
    DROP(1u << 7, 1, 0, 1)
#undef DROP
    return crossed;
}

// Are all cells in and around a brick leaves, and no samples missing? Then every crossed edge of a cell inside has a polygon
// of four cells, and the one at whose low corner the edge begins emits it.
inline bool is_plain(__global const Fine *fine, uint gaps, __global const uint *near) {
    if (gaps) return false;
    for (uint i = 0; i < 27; i++)
        if (near[i] != NONE && !fine[near[i]].all) return false; // none: no crossed edge there
    return true;
}

// Of the crossed edges of a leaf at `low` those that it may have to emit.
inline uint own_edges(Grid grid, __global const Brick *bricks, __global const uint *near, __global const Fine *fine,
                      int3 brick_low, int3 low, uint level, bool plain_brick, uint crossed) {
    if (level > 0) return crossed;
    return plain_brick && is_inside(grid, low) ? crossed & EDGES_OWN
                                               : without_next(bricks, near, fine, brick_low, low, crossed);
}

// The polygon at hand: of a cell inside a plain brick, or of any leaf.
#define FIND_POLYGON                                                                                                   \
    (plain_brick && is_inside(grid, low))                                                                              \
        ? plain_polygon(regions, bricks, nodes, near, part.low, slot, low, edge >> 2)                                  \
        : edge_polygon(grid, POLYGON_ARGS, part.low, part.region, slot, level, low, edge)

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_count(const Grid grid, POLYGON_PARAMS, const uint brick_count, const uint gaps, __global uchar *used,
                __global uchar *used_elsewhere, __global uint *brick_triangles, __global uint *ghosts,
                __global uint *borders) {
    __local uint triangles[6], scratch[BRICK_GROUP];
    __local ushort list[12 * BRICK_GROUP];
    const uint lid = get_local_id(0);
    const Part part = find_part(grid, brick_count, regions, bricks);
    __global const Region *region = regions + part.region;
    near += 27 * (part.brick == NONE ? 0 : part.brick);
    for (uint i = lid; i < 6; i += BRICK_GROUP) triangles[i] = 0;
    const bool plain_brick = part.brick != NONE && is_plain(fine, gaps, near);
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint level = 0; level < (plain_brick ? 1 : 6); level++) {
        const uint first = region->slot_base + part_first(part, region, bricks, level);
        const uint count = part_count(part, region, bricks, level);
        uint sum = 0;
        for (uint begin = 0; begin < count; begin += BRICK_GROUP) {
            const uint own = first + begin + lid;
            uint edges = 0;
            if (begin + lid < count && (plain_brick || state[own] == level)) {
                const uint meta = nodes[own].meta, crossed = crossed_edges(meta_signs(meta));
                const int3 in_region = convert_int3(unmorton(code_cell(meta_code(meta), level))), low = part.origin + in_region;
                // Where no samples are missing every crossed edge has a polygon, so that a cell need not be told by those that
                // emit them. Where the next cell is no leaf this one may emit, and says so below.
                if (level == 0 && !gaps) {
                    const uint next = (in_region.x == 31 && low.x + 2 < end.x ? EDGES_NEXT_X : 0)
                        | (in_region.y == 31 && low.y + 2 < end.y ? EDGES_NEXT_Y : 0)
                        | (in_region.z == 31 && low.z + 2 < end.z ? EDGES_NEXT_Z : 0);
                    if (!next && !meta_extras(meta)) used[own] = 1;
                    else for (uint rest = crossed; rest; rest &= rest - 1) {
                        const uint edge = lowest_bit(rest);
                        const uint at = sheet_in_brick(region, bricks + part.brick, nodes, own, edge);
                        if (next >> edge & 1u) used_elsewhere[at] = 1;
                        else used[at] = 1;
                    }
                }
                edges = own_edges(grid, bricks, near, fine, part.low, low, level, plain_brick, crossed);
                if (plain_brick && is_inside(grid, low) && all(in_region > 0)) {
                    sum += 2 * popcount(edges);
                    edges = 0;
                }
            }
            const uint listed = list_edges(list, scratch, edges);
            for (uint i = lid; i < listed; i += BRICK_GROUP) {
                const uint slot = first + begin + (list[i] >> 4), edge = list[i] & 15u;
                const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(nodes[slot].meta), level)));
                const Polygon polygon = FIND_POLYGON;
                sum += polygon.count ? polygon.count - 2 : 0;
                for (uint k = 0; k < 4; k++) {
                    if (k >= polygon.count) break;
                    const uint of = polygon.region[k], at = polygon.slot[k], faces = polygon.faces[k];
                    if (of == part.region && !faces) {
                        used[at] = 1;
                        continue;
                    }
                    const uint bit = ghost_bit(grid, regions, nodes, part.origin, of, at, faces);
                    atomic_or(&ghosts[part.region * SHELL_WORDS + (bit >> 5)], 1u << (bit & 31));
                    if (!faces) used_elsewhere[at] = 1;
                    else {
                        // Its leaf's region alone counts it.
                        const int3 origin = convert_int3(region_origin(grid, regions[of].region));
                        const uint there = ghost_bit(grid, regions, nodes, origin, of, at, faces);
                        atomic_or(&borders[of * SHELL_WORDS + (there >> 5)], 1u << (there & 31));
                    }
                }
            }
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        if (sum) atomic_add(&triangles[level], sum);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    // Behind the bricks' four levels each stand the regions' upper two.
    const uint out = part.brick == NONE ? 4 * brick_count + 2 * part.region : 4 * part.brick;
    const uint first = part.brick == NONE ? 4 : 0, count = part.brick == NONE ? 2 : 4;
    for (uint i = lid; i < count; i += BRICK_GROUP) brick_triangles[out + i] = triangles[first + i];
}

// `brick_triangles`: counts become first triangles, from the region's. `ghost_places`: of the first ghost of every word.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_place(const uint brick_count, __global const Region *regions, __global const uchar *used,
                __global const uchar *used_elsewhere, __global const uint *ghosts, __global const uint *borders,
                __global uint *brick_triangles, __global uint *places, __global uint *ghost_places, __global RegionMesh *meshes,
                __global Counters *counters) {
    __local uint scratch[GROUP], triangles[6];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const uint slots = region->level_base[7], count = popcount(region->brick_mask[0]) + popcount(region->brick_mask[1]);
    for (uint level = lid; level < 6; level += GROUP) {
        uint sum = 0;
        if (level < 4)
            for (uint b = region->brick_base; b < region->brick_base + count; b++) sum += brick_triangles[4 * b + level];
        else sum = brick_triangles[4 * brick_count + 2 * group + level - 4];
        triangles[level] = sum;
        meshes[group].triangles[level] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint level = lid; level < 6; level += GROUP) {
        uint before = 0;
        for (uint finer = 0; finer < level; finer++) before += triangles[finer];
        if (level > 3) brick_triangles[4 * brick_count + 2 * group + level - 4] = before;
        else for (uint b = region->brick_base; b < region->brick_base + count; b++) {
            const uint own = brick_triangles[4 * b + level];
            brick_triangles[4 * b + level] = before;
            before += own;
        }
    }

    uint vertices = 0, total, different = 0;
    for (uint first = 0; first < slots; first += GROUP) {
        const uint slot = region->slot_base + first + lid;
        const bool inside = first + lid < slots;
        const uint own = inside ? used[slot] : 0, before = scan_group(scratch, own, &total);
        if (inside) {
            places[slot] = vertices + before;
            different += own | used_elsewhere[slot];
        }
        vertices += total;
    }
    for (uint word = lid; word < SHELL_WORDS; word += GROUP) different += popcount(borders[group * SHELL_WORDS + word]);
    if (different) atomic_add(&counters->vertices, different);
    for (uint first = 0; first < SHELL_WORDS; first += GROUP) {
        const bool inside = first + lid < SHELL_WORDS;
        const uint word = group * SHELL_WORDS + first + lid;
        const uint before = scan_group(scratch, inside ? popcount(ghosts[word]) : 0, &total);
        if (inside) ghost_places[word] = vertices + before;
        vertices += total;
    }
    if (lid == 0) meshes[group].vertices = vertices;
}

// Position of a vertex in the volume, 1/PLACEMENT_LATTICE cell; what lies in the padding of a capped volume moves onto the
// faces. `origin`: of its region.
inline int3 lattice_position(Grid grid, CutParams params, Placement place, int3 origin) {
    const int lattice = (int)PLACEMENT_LATTICE;
    const int3 p = (int3)(place.position[0], place.position[1], place.position[2]) + origin * lattice;
    if (!params.cap) return p;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    return clamp(p, (int3)(lattice), last * lattice);
}

inline float3 decode_normal(uint packed) {
    const float2 p = (float2)((float)(char)(packed & 0xffu), (float)(char)(packed >> 8 & 0xffu)) / 127.0f;
    float3 n = (float3)(p, 1.0f - fabs(p.x) - fabs(p.y));
    if (n.z < 0.0f) n.xy = (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
    return n * rsqrt(dot(n, n));
}

// Position of a border vertex: the leaf's vertex moved along its tangent plane, as little as that takes, onto the faces, but
// not out of the leaf. `origin`: of the leaf's region.
inline int3 border_position(Grid grid, Node node, Placement place, uint faces, int3 origin) {
    const uint code = meta_code(node.meta), level = code_level(code);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1 - origin;
    const int3 low = convert_int3(unmorton(code_cell(code, level))), high = min(low + (1 << level), last);
    const float3 p = (float3)(place.position[0], place.position[1], place.position[2]) / PLACEMENT_LATTICE;
    // The plane's normal in cells; along the faces' axes the way is given, along the others the plane gives it.
    const float3 n = decode_normal(place.normal) * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const int3 is_low = -(int3)((int)(faces & 1u), (int)(faces >> 2 & 1u), (int)(faces >> 4 & 1u));
    const int3 is_high = -(int3)((int)(faces >> 1 & 1u), (int)(faces >> 3 & 1u), (int)(faces >> 5 & 1u));
    const float3 face = select(convert_float3(last), convert_float3(-origin), is_low);
    const float3 along = select((float3)(1.0f), (float3)(0.0f), is_low | is_high), way = (1.0f - along) * (face - p);
    const float3 free_n = along * n;
    // Where the surface hardly leans towards the face, not beyond ten times the way.
    const float3 moved = p - free_n * (dot(n, way) / fmax(dot(free_n, free_n), 0.01f * dot(n, n)));
    // Each sheet of a cell stops at another place, lest two of them meet.
    const float margin = MARGIN * (1.0f + (node.count >> 24 ? (float)meta_extras(node.meta) : 0.0f));
    const float3 in_leaf = clamp(moved, convert_float3(low) + margin, convert_float3(high) - margin);
    return convert_int3_rte(select(in_leaf, face, is_low | is_high) * PLACEMENT_LATTICE) + origin * (int)PLACEMENT_LATTICE;
}

// `origin`: of the region that gets the vertex, in cells.
inline Vertex make_vertex(CutParams params, Node node, uint normal, int3 position, int3 origin) {
    Vertex vertex;
    const int3 p = (position - origin * (int)PLACEMENT_LATTICE) * (65536 / (int)PLACEMENT_LATTICE);
    vertex.position[0] = p.x;
    vertex.position[1] = p.y;
    vertex.position[2] = p.z;
    // Both are octahedral; only the steps are finer.
    const int nx = (char)(normal & 0xffu), ny = (char)(normal >> 8 & 0xffu);
    vertex.normal = ((uint)(nx * 32767 / 127) & 0xffffu) | (uint)(ny * 32767 / 127) << 16;
    vertex.attributes = unorm16(node.s) | unorm16(normalised_feature(params, node.f)) << 16;
    return vertex;
}

// Polygons wait here until there are LANES of them: their diagonals are chosen together. Row `corner`, column polygon.
typedef struct {
    float x[4 * LANES], y[4 * LANES], z[4 * LANES]; // world units from some origin
    float u[4 * LANES], v[4 * LANES];               // octahedral normals
    uint index[4 * LANES], slot[4 * LANES];
    uint first[LANES]; // corner of its first triangle
    uint shape[LANES]; // number of corners, and bit 3: turns the other way
    uint count;
} Batch;

#define UNIT_NORMAL(k, nx, ny, nz)                                                                                     \
    real nx = LOAD_LANES(batch->u + (k) * LANES), ny = LOAD_LANES(batch->v + (k) * LANES);                             \
    real nz = 1.0f - fabs(nx) - fabs(ny);                                                                              \
    {                                                                                                                  \
        const real fold = fmax(-nz, 0.0f);                                                                             \
        nx += PICK(nx >= 0.0f, -fold, fold);                                                                           \
        ny += PICK(ny >= 0.0f, -fold, fold);                                                                           \
        const real per_length = rsqrt(nx * nx + ny * ny + nz * nz);                                                    \
        nx *= per_length;                                                                                              \
        ny *= per_length;                                                                                              \
        nz *= per_length;                                                                                              \
    }
// How far the ends of a diagonal are from each other's tangent plane, both together, and the diagonal's squared length.
#define DIAGONAL(from, to, off, length2)                                                                               \
    real off, length2;                                                                                                 \
    {                                                                                                                  \
        const real dx = LOAD_LANES(batch->x + (to) * LANES) - LOAD_LANES(batch->x + (from) * LANES);                   \
        const real dy = LOAD_LANES(batch->y + (to) * LANES) - LOAD_LANES(batch->y + (from) * LANES);                   \
        const real dz = LOAD_LANES(batch->z + (to) * LANES) - LOAD_LANES(batch->z + (from) * LANES);                   \
        UNIT_NORMAL(from, ax, ay, az)                                                                                  \
        UNIT_NORMAL(to, bx, by, bz)                                                                                    \
        off = fabs(ax * dx + ay * dy + az * dz) + fabs(bx * dx + by * dy + bz * dz);                                   \
        length2 = dx * dx + dy * dy + dz * dz;                                                                         \
    }

// Corners of a polygon's triangles: 0 1 2 and 0 2 3, or, where the diagonal swings, 1 2 3 and 1 3 0; turned round if it says so.
inline void write_corners(__global uint *to, const uint *of, uint corners, uint turn, bool swing) {
    const uint a = swing ? of[LANES] : of[0], b = swing ? of[2 * LANES] : of[LANES];
    const uint c = swing ? of[3 * LANES] : of[2 * LANES], d = swing ? of[0] : of[3 * LANES];
    to[0] = a;
    to[1] = turn ? c : b;
    to[2] = turn ? b : c;
    if (corners < 4) return;
    to[3] = a;
    to[4] = turn ? d : c;
    to[5] = turn ? c : d;
}

// Writes the triangles of the waiting polygons; a quad is split along the diagonal that leaves the tangent planes at its ends
// less.
inline void emit_batch(Batch *batch, __global uint *indices, uint keep_corners, __global uint *corner_slots) {
#pragma OPENCL FP_CONTRACT ON
    DIAGONAL(0, 2, off02, length02)
    DIAGONAL(1, 3, off13, length13)
    float other[LANES];
    STORE_LANES(PICK((off13 < off02) | ((off13 == off02) & (length13 < length02)), 1.0f, 0.0f), other);
    for (uint i = 0; i < LANES; i++) {
        if (i >= batch->count) break;
        const uint corners = batch->shape[i] & 7u, turn = batch->shape[i] >> 3, at = batch->first[i];
        const bool swing = corners == 4 && other[i] > 0.0f;
        write_corners(indices + at, batch->index + i, corners, turn, swing);
        if (keep_corners) write_corners(corner_slots + at, batch->slot + i, corners, turn, swing);
    }
    batch->count = 0;
}

// What dual_emit takes polygons' corners from and to.
#define CORNER_PARAMS                                                                                                  \
    __global const Region *regions, __global const Node *nodes, const CutParams params,                                \
        __global const Placement *placements, __global const uint *places, __global const uint *ghosts,                \
        __global const uint *ghost_places
#define CORNER_ARGS regions, nodes, params, placements, places, ghosts, ghost_places

// Puts a polygon into a batch, and the vertices of its ghosts and of the border into `out`.
inline void add_polygon(Batch *batch, Grid grid, CORNER_PARAMS, Part part, const Polygon *polygon, uint turn,
                        uint first_corner, float3 scale, __global Vertex *out) {
    const uint column = NEXT_COLUMN(batch);
    for (uint k = 0; k < 4; k++) {
        if (k >= polygon->count) break;
        const uint at = polygon->slot[k], in = polygon->region[k], faces = polygon->faces[k], row = k * LANES + column;
        const Placement place = placements[at];
        const bool here = in == part.region;
        const int3 from = here ? part.origin : convert_int3(region_origin(grid, regions[in].region));
        const int3 lattice = faces ? border_position(grid, nodes[at], place, faces, from)
                                   : lattice_position(grid, params, place, from);
        uint index;
        if (here && !faces) index = places[at];
        else {
            const uint bit = ghost_bit(grid, regions, nodes, part.origin, in, at, faces);
            const uint word = part.region * SHELL_WORDS + (bit >> 5);
            index = ghost_places[word] + popcount(ghosts[word] & ((1u << (bit & 31)) - 1));
            out[index] = make_vertex(params, nodes[at], place.normal, lattice, part.origin);
        }
        const float3 position = convert_float3(lattice - part.origin * (int)PLACEMENT_LATTICE) * scale;
        batch->index[row] = index;
        batch->slot[row] = at | (faces ? ON_BORDER : 0);
        batch->x[row] = position.x;
        batch->y[row] = position.y;
        batch->z[row] = position.z;
        batch->u[row] = (float)(char)(place.normal & 0xffu) / 127.0f;
        batch->v[row] = (float)(char)(place.normal >> 8 & 0xffu) / 127.0f;
    }
    batch->first[column] = first_corner;
    batch->shape[column] = polygon->count | turn << 3;
}

// The same for the quad around the edge along `axis` from the low corner of a cell at `low`, where that is plain and all four
// cells are the region's own, which most are: without the way over slots of leaves.
__attribute__((always_inline)) inline void add_plain_quad(Batch *batch, __global const Region *region,
                                                         __global const Brick *bricks, __global const Node *nodes,
                                                         __global const Placement *placements,
                                                         __global const uint *places, __global const uint *near,
                                                         int3 brick_low, int3 low, uint axis, uint turn,
                                                         uint first_corner, float3 scale) {
    const uint column = NEXT_COLUMN(batch);
    const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3), d = low - brick_low + 8;
    for (uint i = 0; i < 4; i++) {
        const uint k = i ^ i >> 1, row = i * LANES + column;
        const int3 p = d - b * (int)(k & 1) - c * (int)(k >> 1);
        __global const Brick *brick = bricks + near[(p.x >> 3) + 3 * (p.y >> 3) + 9 * (p.z >> 3)];
        const uint cell = morton(convert_uint3(p) & 7u), word = cell >> 5;
        uint slot = region->slot_base + brick->base[0] + brick->prefix[word]
            + popcount(brick->cells[word] & ((1u << (cell & 31)) - 1));
        if (brick->extras) slot = sheet_in_brick(region, brick, nodes, slot, 4 * axis + k);
        const Placement place = placements[slot];
        batch->index[row] = places[slot];
        batch->slot[row] = slot;
        batch->x[row] = (float)place.position[0] * scale.x;
        batch->y[row] = (float)place.position[1] * scale.y;
        batch->z[row] = (float)place.position[2] * scale.z;
        batch->u[row] = (float)(char)(place.normal & 0xffu) / 127.0f;
        batch->v[row] = (float)(char)(place.normal >> 8 & 0xffu) / 127.0f;
    }
    batch->first[column] = first_corner;
    batch->shape[column] = 4 | turn << 3;
}

// Once around an edge is counter-clockwise seen from its high end: right when that is the outside.
#define TURN(signs, edge) (uint)(!((signs) >> edge_low_corner(edge) & 1u))

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_emit(const Grid grid, POLYGON_PARAMS, const CutParams params, __global const Placement *placements,
               const uint brick_count, const uint gaps, __global const uchar *used,
               __global const uint *brick_triangles, __global const uint *places,
               __global const uint *ghosts, __global const uint *ghost_places, __global const RegionMesh *meshes,
               __global Vertex *vertices, __global uint *indices, const uint keep_corners, __global uint *corner_slots) {
    __local uint scratch[BRICK_GROUP];
    __local ushort list[12 * BRICK_GROUP];
    const uint lid = get_local_id(0);
    const Part part = find_part(grid, brick_count, regions, bricks);
    __global const Region *region = regions + part.region;
    const float3 scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / PLACEMENT_LATTICE;
    __global Vertex *out = vertices + meshes[part.region].vertex_base;
    near += 27 * (part.brick == NONE ? 0 : part.brick);
    const bool plain_brick = part.brick != NONE && is_plain(fine, gaps, near);
    Batch batch;
    batch.count = 0;
    for (uint i = 0; i < 4 * LANES; i++) {
        batch.x[i] = 0.0f;
        batch.y[i] = 0.0f;
        batch.z[i] = 0.0f;
        batch.u[i] = 0.0f;
        batch.v[i] = 0.0f;
    }

    for (uint level = 0; level < 7; level++) {
        const uint first_slot = region->slot_base + part_first(part, region, bricks, level);
        const uint count = part_count(part, region, bricks, level);
        for (uint i = lid; i < count; i += BRICK_GROUP) {
            const uint slot = first_slot + i;
            if (!used[slot]) continue;
            const Placement place = placements[slot];
            out[places[slot]] = make_vertex(params, nodes[slot], place.normal,
                                            lattice_position(grid, params, place, part.origin), part.origin);
        }
        if (level == 6 || count == 0 || (plain_brick && level > 0)) continue;
        uint done = meshes[part.region].triangle_base
            + brick_triangles[part.brick == NONE ? 4 * brick_count + 2 * part.region + level - 4 : 4 * part.brick + level];
        for (uint begin = 0; begin < count; begin += BRICK_GROUP) {
            const uint own = first_slot + begin + lid;
            uint edges = 0;
            if (begin + lid < count && (plain_brick || state[own] == level)) {
                const uint meta = nodes[own].meta, signs = meta_signs(meta);
                const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(meta), level)));
                edges = own_edges(grid, bricks, near, fine, part.low, low, level, plain_brick, crossed_edges(signs));
#if BRICK_GROUP == 1
                if (plain_brick && is_inside(grid, low) && all(low > part.origin)) {
                    for (; edges; edges &= edges - 1) {
                        const uint edge = lowest_bit(edges);
                        add_plain_quad(&batch, region, bricks, nodes, placements, places, near, part.low, low, edge >> 2,
                                       TURN(signs, edge), 3 * done, scale);
                        done += 2;
                        if (batch.count == LANES) emit_batch(&batch, indices, keep_corners, corner_slots);
                    }
                    continue;
                }
#endif
            }
            const uint listed = list_edges(list, scratch, edges);
            for (uint at = 0; at < listed; at += BRICK_GROUP) {
                Polygon polygon;
                polygon.count = 0;
                uint turn = 0, total;
                if (at + lid < listed) {
                    const uint slot = first_slot + begin + (list[at + lid] >> 4), edge = list[at + lid] & 15u;
                    const uint meta = nodes[slot].meta;
                    const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(meta), level)));
                    polygon = FIND_POLYGON;
                    turn = TURN(meta_signs(meta), edge);
                }
                const uint before = scan_group(scratch, polygon.count ? polygon.count - 2 : 0, &total);
                if (polygon.count)
                    add_polygon(&batch, grid, CORNER_ARGS, part, &polygon, turn, 3 * (done + before), scale, out);
                if (batch.count == LANES) emit_batch(&batch, indices, keep_corners, corner_slots);
                done += total;
            }
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }
    if (batch.count) emit_batch(&batch, indices, keep_corners, corner_slots);
}
