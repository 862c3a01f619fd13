// dual: the mesher that is watertight by construction (algorithm, section 6). One vertex a leaf and sheet, one polygon for
// every minimal edge of the cut whose ends differ in sign, joining the leaves around it. One work-group a region.
// dual_count: triangles, and which vertices the region needs: its own and *ghosts*, leaves of other regions around it.
// dual_emit: vertices and indices.
//
// A ghost is named by a cell of the region's shell, the layer of cells around it: the leaf's first cell there, and its
// sheet. The names are bits of a mask; a ghost's place is the number of bits below.

#define SHELL_CELLS 6536 // 34^3 - 32^3
#define SHELL_WORDS 817  // four sheets a cell, 32 bits a word

// What the polygons of a region are made from.
#define CUT_PARAMS                                                                                                     \
    __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,                  \
        __global const Node *nodes, __global const uchar *state
#define CUT_ARGS region_index, regions, bricks, nodes, state

typedef struct {
    uint slot[4];   // the leaves' slots in the order around the edge, each once
    uint region[4]; // their compact regions
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

// The brick that holds a cell of a node; of a node above level 3 any.
inline __global const Brick *leaf_brick(__global const Region *region, __global const Brick *bricks, uint cell) {
    return bricks + region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], cell >> 9);
}

// Slot of the sheet of an active cell to which one of its edges belongs.
inline uint sheet_slot(__global const Region *region, __global const Brick *bricks, __global const Node *nodes,
                       uint slot, uint edge) {
    const uint meta = nodes[slot].meta;
    if (!meta_extras(meta)) return slot;
    __global const Brick *brick = leaf_brick(region, bricks, code_cell(meta_code(meta), 0));
    uint extra = region->slot_base + brick->base[3];
    while (meta_code(nodes[extra].meta) != meta_code(meta)) extra++;
    const uint sheet = edge_sheet(nodes[extra].count, edge);
    return sheet == 0 ? slot : extra + sheet - 1;
}

// As find_slot, of a cell in the brick at hand, levels 0 to 2.
inline uint find_in_brick(__global const Region *region, __global const Brick *brick, uint level, uint cell) {
    const uint i = (cell & 511) >> (3 * level);
    if (level == 0) {
        const uint word = brick->cells[i >> 5], bit = 1u << (i & 31);
        return word & bit ? region->slot_base + brick->base[0] + brick->prefix[i >> 5] + popcount(word & (bit - 1)) : NONE;
    }
    if (level == 1)
        return bit64(brick->twos[0], brick->twos[1], i)
            ? region->slot_base + brick->base[1] + rank64(brick->twos[0], brick->twos[1], i) : NONE;
    return brick->fours >> i & 1u ? region->slot_base + brick->base[2] + popcount(brick->fours & ((1u << i) - 1)) : NONE;
}

// The polygon around an edge of a leaf, if this leaf is the one to emit it: the first of the finest around the edge.
// `low`: the leaf's low corner in the volume.
inline Polygon edge_polygon(Grid grid, CUT_PARAMS, uint own_region, __global const Brick *brick, uint own_slot, uint level,
                            int3 low, uint edge) {
    Polygon polygon;
    polygon.count = 0;
    const uint axis = edge >> 2, own = edge & 3, size = 1u << level;
    const int3 b = axis_step((axis + 1) % 3) * (int)size, c = axis_step((axis + 2) % 3) * (int)size;
    const int3 at = low + edge_offset(edge) * (int)size;
    uint slots[4], in_regions[4];
    for (uint k = 0; k < 4; k++) {
        if (k == own) {
            slots[k] = own_slot;
            in_regions[k] = own_region;
        } else {
            const int3 cube = at - b * (int)(k & 1) - c * (int)(k >> 1);
            // Most neighbours share the leaf's brick, which spares the way to theirs.
            if (level < 3 && all(cube >> 3 == low >> 3)) {
                slots[k] = find_in_brick(regions + own_region, brick, level, morton(convert_uint3(cube) & 7u));
                in_regions[k] = own_region;
            } else slots[k] = find_slot_at(grid, region_index, regions, bricks, level, cube, &in_regions[k]);
            if (slots[k] == NONE) return polygon; // the volume ends here, or samples are missing: an open border
            const uint covers = state[slots[k]];
            if (covers == INTERNAL || (covers == level && k < own)) return polygon;
            if (covers > level)
                slots[k] = find_slot(regions + in_regions[k], bricks, covers, morton(convert_uint3(cube) & 31u));
            else if (level == 0)
                slots[k] = sheet_slot(regions + in_regions[k], bricks, nodes, slots[k], 4 * axis + k);
            continue;
        }
        if (level == 0) slots[k] = sheet_slot(regions + own_region, bricks, nodes, own_slot, edge);
    }
    for (uint i = 0; i < 4; i++) {
        const uint k = i ^ i >> 1; // 0 1 3 2: once around the edge
        if (polygon.count && polygon.slot[polygon.count - 1] == slots[k]) continue;
        if (i == 3 && polygon.slot[0] == slots[k]) continue;
        polygon.slot[polygon.count] = slots[k];
        polygon.region[polygon.count++] = in_regions[k];
    }
    return polygon;
}

// Bit that names a leaf of another region among the ghosts of the region at `origin`.
inline uint ghost_bit(Grid grid, __global const Region *regions, __global const Node *nodes, int3 origin, uint region,
                      uint slot) {
    const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code);
    const int3 low = convert_int3(region_origin(grid, regions[region].region) + unmorton(code_cell(code, level))) - origin;
    const bool extra = slot - regions[region].slot_base >= regions[region].level_base[6];
    return 4 * shell_cell(max(low, (int3)(-1))) + (extra ? meta_extras(meta) : 0);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_count(const Grid grid, CUT_PARAMS, __global uchar *used, __global uchar *used_elsewhere,
                __global uchar *triangle_counts, __global uint *places, __global uint *ghosts,
                __global RegionMesh *meshes) {
    __local uint scratch[GROUP], mask[SHELL_WORDS], triangles[6];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    for (uint i = lid; i < SHELL_WORDS; i += GROUP) mask[i] = 0;
    if (lid < 6) triangles[lid] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint i = lid; i < region->level_base[6]; i += GROUP) {
        const uint slot = region->slot_base + i;
        const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code), signs = meta_signs(meta);
        if (state[slot] != level) continue;
        const int3 low = origin + convert_int3(unmorton(code_cell(code, level)));
        uint count = 0;
        __global const Brick *brick = leaf_brick(region, bricks, code_cell(code, level));
        for (uint rest = crossed_edges(signs); rest; rest &= rest - 1) {
            const uint edge = lowest_bit(rest);
            const Polygon polygon = edge_polygon(grid, CUT_ARGS, group, brick, slot, level, low, edge);
            if (!polygon.count) continue;
            count += polygon.count - 2;
            for (uint k = 0; k < polygon.count; k++) {
                if (polygon.region[k] == group) used[polygon.slot[k]] = 1;
                else {
                    const uint bit = ghost_bit(grid, regions, nodes, origin, polygon.region[k], polygon.slot[k]);
                    atomic_or(&mask[bit >> 5], 1u << (bit & 31));
                    used_elsewhere[polygon.slot[k]] = 1;
                }
            }
        }
        triangle_counts[slot] = (uchar)count;
        if (count) atomic_add(&triangles[level], count);
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);

    uint vertices = 0, total;
    for (uint first = 0; first < region->level_base[7]; first += GROUP) {
        const uint slot = region->slot_base + first + lid;
        const bool inside = first + lid < region->level_base[7];
        const uint before = scan_group(scratch, inside ? used[slot] : 0, &total);
        if (inside) places[slot] = vertices + before;
        vertices += total;
    }
    for (uint first = 0; first < SHELL_WORDS; first += GROUP) {
        const uint word = first + lid < SHELL_WORDS ? mask[first + lid] : 0;
        if (first + lid < SHELL_WORDS) ghosts[group * SHELL_WORDS + first + lid] = word;
        scan_group(scratch, popcount(word), &total);
        vertices += total;
    }
    if (lid < 6) meshes[group].triangles[lid] = triangles[lid];
    if (lid == 6) meshes[group].vertices = vertices;
}

inline float3 decode_normal(uint packed) {
    const float2 p = (float2)((float)(char)(packed & 0xffu), (float)(char)(packed >> 8 & 0xffu)) / 127.0f;
    float3 n = (float3)(p, 1.0f - fabs(p.x) - fabs(p.y));
    if (n.z < 0.0f) n.xy = (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
    return n * rsqrt(dot(n, n));
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

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_emit(const Grid grid, CUT_PARAMS, const CutParams params, __global const Placement *placements,
               __global const uchar *used, __global const uchar *used_elsewhere,
               __global const uchar *triangle_counts, __global const uint *places, __global const uint *ghosts,
               __global const RegionMesh *meshes, __global Vertex *vertices, __global uint *indices,
               __global Counters *counters, const uint keep_corners, __global uint *corner_slots) {
    __local uint scratch[GROUP], mask[SHELL_WORDS], before_word[SHELL_WORDS];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    __global Vertex *out = vertices + meshes[group].vertex_base;

    // Own vertices, then the places of ghosts behind them.
    uint own = 0, total, different = 0;
    for (uint i = lid; i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        if (used[slot]) {
            const Placement place = placements[slot];
            out[places[slot]] =
                make_vertex(params, nodes[slot], place.normal, lattice_position(grid, params, place, origin), origin);
        }
        different += used[slot] | used_elsewhere[slot];
    }
    if (different) atomic_add(&counters->vertices, different);
    uint ghost_count = 0;
    for (uint first = 0; first < SHELL_WORDS; first += GROUP) {
        const bool inside = first + lid < SHELL_WORDS;
        const uint word = inside ? ghosts[group * SHELL_WORDS + first + lid] : 0;
        const uint before = scan_group(scratch, popcount(word), &total);
        if (inside) {
            mask[first + lid] = word;
            before_word[first + lid] = ghost_count + before;
        }
        ghost_count += total;
    }
    own = meshes[group].vertices - ghost_count;
    barrier(CLK_LOCAL_MEM_FENCE);

    uint done = 0;
    for (uint first = 0; first < region->level_base[6]; first += GROUP) {
        const uint i = first + lid, slot = region->slot_base + i;
        uint count = 0, level = 0, meta = 0;
        if (i < region->level_base[6]) {
            meta = nodes[slot].meta;
            level = code_level(meta_code(meta));
            if (state[slot] == level) count = triangle_counts[slot];
        }
        const uint before = scan_group(scratch, count, &total);
        const uint first_corner = 3 * (meshes[group].triangle_base + done + before);
        __global uint *to = indices + first_corner, *slots = corner_slots + first_corner;
        done += total;
        if (!count) continue;
        const uint signs = meta_signs(meta), code = meta_code(meta);
        const int3 low = origin + convert_int3(unmorton(code_cell(code, level)));
        __global const Brick *brick = leaf_brick(region, bricks, code_cell(code, level));
        for (uint rest = crossed_edges(signs); rest; rest &= rest - 1) {
            const uint edge = lowest_bit(rest);
            const Polygon polygon = edge_polygon(grid, CUT_ARGS, group, brick, slot, level, low, edge);
            if (!polygon.count) continue;
            uint index[4];
            float3 position[4], normal[4];
            for (uint k = 0; k < polygon.count; k++) {
                const uint at = polygon.slot[k], in = polygon.region[k];
                const Placement place = placements[at];
                const int3 from = in == group ? origin : convert_int3(region_origin(grid, regions[in].region));
                const int3 lattice = lattice_position(grid, params, place, from);
                if (in == group) index[k] = places[at];
                else {
                    const uint bit = ghost_bit(grid, regions, nodes, origin, in, at);
                    index[k] = own + before_word[bit >> 5] + popcount(mask[bit >> 5] & ((1u << (bit & 31)) - 1));
                    out[index[k]] = make_vertex(params, nodes[at], place.normal, lattice, origin);
                }
                position[k] = convert_float3(lattice - origin * (int)PLACEMENT_LATTICE) * spacing;
                normal[k] = decode_normal(place.normal);
            }
            // Once around the edge is counter-clockwise seen from its high end: right when that is the outside.
            const bool turn = !(signs >> edge_low_corner(edge) & 1u);
            // A quad is split along the diagonal that leaves the tangent planes at its ends less.
            uint start = 0;
            if (polygon.count == 4) {
                const float3 d02 = position[2] - position[0], d13 = position[3] - position[1];
                const float off02 = fabs(dot(normal[0], d02)) + fabs(dot(normal[2], d02));
                const float off13 = fabs(dot(normal[1], d13)) + fabs(dot(normal[3], d13));
                start = off13 < off02 || (off13 == off02 && dot(d13, d13) < dot(d02, d02)) ? 1 : 0;
            }
            for (uint k = 1; k + 1 < polygon.count; k++) {
                const uint corners[3] = {start, (start + k + turn) % polygon.count, (start + k + !turn) % polygon.count};
                for (uint j = 0; j < 3; j++) {
                    *to++ = index[corners[j]];
                    if (keep_corners) *slots++ = polygon.slot[corners[j]];
                }
            }
        }
    }
}
