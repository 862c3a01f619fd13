// dual: the mesher that is watertight by construction (algorithm, section 6). One vertex a leaf and sheet, one polygon for
// every minimal edge of the cut whose ends differ in sign, joining the leaves around it.
// dual_begin: in which bricks all active cells are leaves themselves; what is marked later is cleared. One work-group a region.
// dual_count: triangles, which of its edges each leaf emits a polygon around (but in plain bricks, where that is known), and
// which vertices each region needs: its own and *ghosts*, leaves of other regions around it.
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

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_begin(__global const Region *regions, __global const Brick *bricks, __global const uchar *state, __global uchar *fine,
                __global uchar *used, __global uchar *used_elsewhere, __global uint *ghosts, __global uint *borders) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const uint slots = region->slot_base, count = region->level_base[7];
    for (uint i = lid; i < count; i += GROUP) used[slots + i] = used_elsewhere[slots + i] = 0;
    for (uint i = lid; i < SHELL_WORDS; i += GROUP) ghosts[group * SHELL_WORDS + i] = borders[group * SHELL_WORDS + i] = 0;
    const uint brick_count = count_bricks(region);
    for (uint b = lid; b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        const uint first = slots + brick->base[1], ones = count_ones(brick);
        bool all = true;
        for (uint i = 0; i < ones; i++) all = all && state[first + i] == INTERNAL;
        fine[region->brick_base + b] = all;
    }
}

// The polygon at hand: of a cell inside a plain brick, or of any leaf.
#define FIND_POLYGON                                                                                                   \
    (plain_brick && is_inside(grid, low))                                                                              \
        ? plain_polygon(regions, bricks, nodes, near, part.low, slot, low, edge >> 2)                                  \
        : edge_polygon(grid, POLYGON_ARGS, &hood, part.low, part.region, slot, of_level, low, edge)

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_count(const Grid grid, POLYGON_PARAMS, __global const uchar *fine, const uint brick_count, const uint gaps,
                __global uchar *used, __global uchar *used_elsewhere, __global uint *emits, __global uint *brick_triangles,
                __global uint *ghosts, __global uint *borders) {
    __local uint triangles[6], coarse, border_count, listed;
    __local ushort list[LISTED], border[512];
    __local Hood hood;
    const uint lid = get_local_id(0);
    const Part part = find_part(grid, brick_count, regions, bricks);
    __global const Region *region = regions + part.region;
    near += 27 * (part.brick == NONE ? 0 : part.brick);
    ROLLED for (uint i = lid; i < 6; i += BRICK_GROUP) triangles[i] = 0;
    const bool plain_brick = is_plain(fine, part.brick != NONE && !gaps, near, &coarse);
    const int3 in_part = part.low - part.origin;
    const bool all_quads = plain_brick && is_inside(grid, part.low) && is_inside(grid, part.low + 7);
    const bool is_last = any(in_part == 24);
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    find_hood(&hood, regions, bricks, state, near, part.brick != NONE && !all_quads);
    mark_all(part, region, bricks, all_quads, used, triangles, border, &border_count);

    const uint beyond = part.finest + (plain_brick ? 1 : part.levels);
    Slots slots = part_slots(part, region, bricks, part.finest);
    ROLLED for (uint level = part.finest, begin = 0; level < beyond;) {
        if (lid == 0) listed = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        // Some leaves' edges are listed, as many as there is room for. In which order makes no difference.
        for (uint room = LISTED; level < beyond && room >= 12 * BRICK_GROUP;) {
            const uint first = region->slot_base + slots.first, count = all_quads ? border_count : slots.count;
            if (begin >= count) {
                begin = 0;
                slots = part_slots(part, region, bricks, ++level);
                continue;
            }
            const uint i = all_quads ? border[min(begin + lid, count - 1)] : begin + lid, own = first + i;
            const bool is_leaf = begin + lid < count && (plain_brick || state[own] == level);
            begin += BRICK_GROUP;
            room -= 12 * BRICK_GROUP;
            if (!is_leaf) continue;
            uint edges = 0, inner = 0, sum = 0; // edges to be looked at one by one; known; triangles of these
            const uint meta = nodes[own].meta, crossed = crossed_edges(meta_signs(meta));
            const int3 in_region = convert_int3(unmorton(code_cell(meta_code(meta), level))), low = part.origin + in_region;
            // Where no samples are missing every crossed edge has a polygon, so that a cell need not be told by those that
            // emit them. Where the next cell is no leaf this one may emit, and says so below.
            if (level == 0 && !gaps) {
                const uint next = !is_last ? 0 : (in_region.x == 31 && low.x + 2 < end.x ? EDGES_NEXT_X : 0)
                    | (in_region.y == 31 && low.y + 2 < end.y ? EDGES_NEXT_Y : 0)
                    | (in_region.z == 31 && low.z + 2 < end.z ? EDGES_NEXT_Z : 0);
                const uint extra = first_extra(region, bricks + part.brick, nodes[own]);
                const uint sheets = meta_extras(meta) ? nodes[extra].count : 0;
                ROLLED for (uint sheet = 0; sheet <= meta_extras(meta); sheet++) {
                    const uint at = sheet == 0 ? own : extra + sheet - 1, of_sheet = crossed & edges_of_sheet(sheets, sheet);
                    if (of_sheet & ~next) used[at] = 1;
                    else if (all_quads) used[at] = 0; // was marked with all others
                    if (of_sheet & next) used_elsewhere[at] = 1;
                }
            }
            if (all_quads) edges = crossed & EDGES_OWN & outer_edges(grid, part.origin, in_region, 0);
            else if (plain_brick && is_inside(grid, low) && all(in_region > 0)) sum = 2 * popcount(crossed & EDGES_OWN);
            else if (plain_brick && is_inside(grid, low)) edges = crossed & EDGES_OWN;
            else if (part.brick == NONE || level > 1) edges = crossed;
            else {
                const int3 in_brick = low - part.low;
                edges = crossed & ~taken_edges(&hood, level, convert_uint3(in_brick));
                if (!gaps) {
                    const uint outer = outer_edges(grid, part.origin, in_region, level);
                    inner = edges & ~outer;
                    edges &= outer;
                    if (inner && level > 0) used[own] = 1;
                    ROLLED for (uint rest = inner; rest; rest &= rest - 1)
                        sum += count_inner(&hood, level, in_region, in_brick, lowest_bit(rest), used);
                }
            }
            if (sum) ADD_LOCAL(&triangles[level], sum);
            if (!plain_brick) emits[own] = inner;
            if (!edges) continue;
            uint at = ADD_LOCAL(&listed, popcount(edges));
            ROLLED for (uint rest = edges; rest; rest &= rest - 1) list[at++] = LIST_ENTRY(level, i, lowest_bit(rest));
        }
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        ROLLED for (uint i = lid; i < listed; i += BRICK_GROUP) {
            const uint of_level = entry_level(list[i]), edge = entry_edge(list[i]), slot = entry_slot(list[i], part, region, bricks);
            const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(nodes[slot].meta), of_level)));
            const Polygon polygon = FIND_POLYGON;
            if (!polygon.count) continue;
            if (!all_quads) ADD_LOCAL(&triangles[of_level], polygon.count - 2);
            if (!plain_brick) atomic_or(&emits[slot], 1u << edge);
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
    ROLLED for (uint i = lid; i < part.levels; i += BRICK_GROUP) brick_triangles[part.counts + i] = triangles[part.finest + i];
}

// `first_triangles`: of every brick and level, from the region's first. `ghost_places`: of the first ghost of every word.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_place(const uint brick_count, __global const Region *regions, __global const uchar *used,
                __global const uchar *used_elsewhere, __global const uint *ghosts, __global const uint *borders,
                __global const uint *brick_triangles, __global uint *first_triangles, __global uint *places,
                __global uint *ghost_places, __global RegionMesh *meshes, __global Counters *counters) {
    __local uint scratch[GROUP], triangles[6];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const uint slots = region->level_base[7], count = count_bricks(region);
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
        if (level > 3) first_triangles[4 * brick_count + 2 * group + level - 4] = before;
        else for (uint b = region->brick_base; b < region->brick_base + count; b++) {
            first_triangles[4 * b + level] = before;
            before += brick_triangles[4 * b + level];
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

// `x`, `y`, `z`: from the low corner of the region that gets the vertex, 1/PLACEMENT_LATTICE cell.
inline Vertex make_vertex(CutParams params, Node node, uint normal, int x, int y, int z) {
    Vertex vertex;
    vertex.position[0] = x * (65536 / (int)PLACEMENT_LATTICE);
    vertex.position[1] = y * (65536 / (int)PLACEMENT_LATTICE);
    vertex.position[2] = z * (65536 / (int)PLACEMENT_LATTICE);
    // Both are octahedral; only the steps are finer.
    const int nx = (char)(normal & 0xffu), ny = (char)(normal >> 8 & 0xffu);
    vertex.normal = ((uint)(nx * 32767 / 127) & 0xffffu) | (uint)(ny * 32767 / 127) << 16;
    vertex.attributes = unorm16(node.s) | unorm16((fabs(node.f) - params.feature_lo) / params.feature_span) << 16;
    return vertex;
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
        const int3 in_region = (faces ? border_position(grid, nodes[at], place, faces, from)
                                      : lattice_position(grid, params, place, from)) - part.origin * (int)PLACEMENT_LATTICE;
        uint index;
        if (here && !faces) index = places[at];
        else {
            const uint bit = ghost_bit(grid, regions, nodes, part.origin, in, at, faces);
            const uint word = part.region * SHELL_WORDS + (bit >> 5);
            index = ghost_places[word] + popcount(ghosts[word] & ((1u << (bit & 31)) - 1));
            out[index] = make_vertex(params, nodes[at], place.normal, in_region.x, in_region.y, in_region.z);
        }
        const float3 position = convert_float3(in_region) * scale;
        batch->index[row] = index;
        batch->slot[row] = at | (faces ? ON_BORDER : 0);
        batch->x[row] = position.x;
        batch->y[row] = position.y;
        batch->z[row] = position.z;
        batch->u[row] = (float)(char)(place.normal & 0xffu) * (1.0f / 127.0f);
        batch->v[row] = (float)(char)(place.normal >> 8 & 0xffu) * (1.0f / 127.0f);
    }
    batch->first[column] = first_corner;
    batch->shape[column] = polygon->count | turn << 3;
}

// Once around an edge is counter-clockwise seen from its high end: right when that is the outside.
#define TURN(signs, edge) (uint)(!((signs) >> edge_low_corner(edge) & 1u))

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_emit(const Grid grid, POLYGON_PARAMS, __global const uchar *fine, const CutParams params,
               __global const Placement *placements, const uint brick_count, const uint gaps, __global const uchar *used,
               __global const uint *emits, __global const uint *brick_triangles, __global const uint *first_triangles,
               __global const uint *places, __global const uint *ghosts, __global const uint *ghost_places,
               __global const RegionMesh *meshes, __global Vertex *vertices, __global uint *indices, const uint keep_corners, __global uint *corner_slots) {
    __local uint to[6], scratch[BRICK_GROUP], coarse;
    __local ushort list[LISTED];
    __local Hood hood;
    const uint lid = get_local_id(0);
    const Part part = find_part(grid, brick_count, regions, bricks);
    __global const Region *region = regions + part.region;
    const float3 scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / PLACEMENT_LATTICE;
    __global Vertex *out = vertices + meshes[part.region].vertex_base;
    near += 27 * (part.brick == NONE ? 0 : part.brick);
    const bool plain_brick = is_plain(fine, part.brick != NONE && !gaps, near, &coarse);
    const bool all_quads = plain_brick && is_inside(grid, part.low) && is_inside(grid, part.low + 7);
    find_hood(&hood, regions, bricks, state, near, part.brick != NONE && !all_quads);
#if BRICK_GROUP == 1
    const bool inner_brick = all_quads && all(part.low > part.origin);
    Corners corners;
    if (plain_brick) find_corners(&corners, region, bricks, nodes, placements, places, near, part.low - part.origin, scale);
#endif
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
        const Slots slots = part_slots(part, region, bricks, level);
        for (uint i = lid; i < slots.count; i += BRICK_GROUP) {
            const uint slot = region->slot_base + slots.first + i;
            if (!used[slot]) continue;
            const Placement place = placements[slot];
            int x = place.position[0], y = place.position[1], z = place.position[2];
            if (params.cap) {
                const int3 p = lattice_position(grid, params, place, part.origin) - part.origin * (int)PLACEMENT_LATTICE;
                x = p.x;
                y = p.y;
                z = p.z;
            }
            out[places[slot]] = make_vertex(params, nodes[slot], place.normal, x, y, z);
        }
    }

    // Where each level's first triangle goes, less the triangles of the levels before.
    for (uint i = lid; i < part.levels; i += BRICK_GROUP) {
        uint before = 0;
        for (uint finer = 0; finer < i; finer++) before += brick_triangles[part.counts + finer];
        to[part.finest + i] = meshes[part.region].triangle_base + first_triangles[part.counts + i] - before;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    uint done = 0;
    Slots slots = part_slots(part, region, bricks, part.finest);
    for (uint level = part.finest, begin = 0, beyond = level + (plain_brick ? 1 : part.levels); level < beyond;) {
        uint listed = 0;
        while (level < beyond && listed + 12 * BRICK_GROUP <= LISTED) {
            if (begin >= slots.count || brick_triangles[part.counts + level - part.finest] == 0) {
                begin = 0;
                slots = part_slots(part, region, bricks, ++level);
                continue;
            }
            const uint i = begin + lid, own = region->slot_base + slots.first + i;
            const bool is_leaf = i < slots.count && (plain_brick || state[own] == level);
            begin += BRICK_GROUP;
            uint edges = 0, total;
            if (is_leaf) {
                const uint meta = nodes[own].meta, signs = meta_signs(meta), crossed = crossed_edges(signs);
                const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(meta), level)));
#if BRICK_GROUP == 1
                if (inner_brick || (plain_brick && is_inside(grid, low) && all(low > part.origin))) {
                    const uint3 cell = convert_uint3(low - part.low);
                    for (edges = crossed & EDGES_OWN; edges; edges &= edges - 1) {
                        const uint edge = lowest_bit(edges);
                        add_plain_quad(&batch, &corners, region, bricks, nodes, placements, places, cell, edge >> 2,
                                       !(signs & 1u), 3 * (to[0] + done), scale);
                        done += 2;
                        if (batch.count == LANES) emit_batch(&batch, indices, keep_corners, corner_slots);
                    }
                    continue;
                }
#endif
                edges = !plain_brick ? emits[own] : is_inside(grid, low) ? crossed & EDGES_OWN : crossed;
            }
            uint at = listed + scan_group(scratch, popcount(edges), &total);
            for (uint rest = edges; rest; rest &= rest - 1) list[at++] = LIST_ENTRY(level, i, lowest_bit(rest));
            listed += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint at = 0; at < listed; at += BRICK_GROUP) {
            Polygon polygon;
            polygon.count = 0;
            uint turn = 0, first = 0, total;
            if (at + lid < listed) {
                const uint entry = list[at + lid], of_level = entry_level(entry), edge = entry_edge(entry);
                const uint slot = entry_slot(entry, part, region, bricks);
                const uint meta = nodes[slot].meta;
                const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(meta), of_level)));
                polygon = FIND_POLYGON;
                turn = TURN(meta_signs(meta), edge);
                first = to[of_level] + done;
            }
            uint before = 2 * lid;
            if (all_quads) total = 2 * min(listed - at, (uint)BRICK_GROUP);
            else before = scan_group(scratch, polygon.count ? polygon.count - 2 : 0, &total);
            if (polygon.count)
                add_polygon(&batch, grid, CORNER_ARGS, part, &polygon, turn, 3 * (first + before), scale, out);
            if (batch.count == LANES) emit_batch(&batch, indices, keep_corners, corner_slots);
            done += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (batch.count) emit_batch(&batch, indices, keep_corners, corner_slots);
}
