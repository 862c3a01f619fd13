// dual: the mesher that is watertight by construction (algorithm, section 6). One vertex a leaf and sheet, one polygon for
// every minimal edge of the cut whose ends differ in sign, joining the leaves around it.
// dual_begin: in which bricks all active cells are leaves themselves; what is marked later is cleared. One work-group a region.
// dual_count: triangles, the edges around which each leaf emits a polygon (not stored for plain bricks), and
// which vertices each region needs: its own and *ghosts*, leaves of other regions around it.
// dual_scan: where the vertices and triangles of each brick go. One work-group a region.
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

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/batch.h"
#include "lib/bits.h"
#include "lib/cells.h"
#include "lib/corners.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/scan.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/vertices.h"

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_begin(__global const Region *regions, __global const Brick *bricks, __global const uchar *state, __global uchar *fine,
                __global uchar *used, __global uchar *used_elsewhere, __global uint *ghosts, __global uint *borders) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const uint slots = region->slot_base, count = region->level_base[7];
    for (uint i = lid; i < count; i += GROUP) used[slots + i] = used_elsewhere[slots + i] = 0;
    for (uint i = lid; i < HALO_WORDS; i += GROUP) ghosts[group * HALO_WORDS + i] = borders[group * HALO_WORDS + i] = 0;
    const uint brick_count = count_bricks(region);
    for (uint b = lid; b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        const uint first = slots + brick->level_base[1], ones = count_level1(brick);
        bool all = true;
        for (uint i = 0; i < ones; i++) all = all && state[first + i] == INTERNAL;
        fine[region->brick_base + b] = all;
    }
}

// The polygon at hand: of a cell inside a plain brick, or of any leaf.
#define FIND_POLYGON                                                                                                   \
    (plain_brick && is_inside(grid, low))                                                                              \
        ? plain_polygon(regions, bricks, nodes, near, part.low, slot, low, edge >> 2)                                  \
        : edge_polygon(grid, POLYGON_ARGS, &halo, part.low, part.region, slot, of_level, low, edge)

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_count(const DualCountArgs args, POLYGON_PARAMS, __global const uchar *fine, __global uchar *used,
                __global uchar *used_elsewhere, __global uint *emitted_edges, __global uint *brick_triangles,
                __global uint *ghosts, __global uint *borders) {
    const Grid grid = args.grid;
    const uint brick_count = args.brick_count, gaps = args.gaps;
    __local uint triangles[6], coarse, border_count, listed;
    __local ushort list[EDGE_LIST_CAPACITY], border[512];
    __local LeafHalo halo;
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
    find_halo(&halo, regions, bricks, state, near, part.brick != NONE && !all_quads);
    mark_all(part, region, bricks, all_quads, used, triangles, border, &border_count);

    const uint beyond = part.finest + (plain_brick ? 1 : part.levels);
    Slots slots = part_slots(part, region, bricks, part.finest);
    ROLLED for (uint level = part.finest, begin = 0; level < beyond;) {
        if (lid == 0) listed = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        // Some leaves' edges are listed, as many as the list holds. In which order makes no difference.
        for (uint capacity = EDGE_LIST_CAPACITY; level < beyond && capacity >= 12 * BRICK_GROUP;) {
            const uint first = region->slot_base + slots.first, count = all_quads ? border_count : slots.count;
            if (begin >= count) {
                begin = 0;
                slots = part_slots(part, region, bricks, ++level);
                continue;
            }
            const uint i = all_quads ? border[min(begin + lid, count - 1)] : begin + lid, own = first + i;
            const bool is_leaf = begin + lid < count && (plain_brick || state[own] == level);
            begin += BRICK_GROUP;
            capacity -= 12 * BRICK_GROUP;
            if (!is_leaf) continue;
            uint edges = 0, inner = 0, sum = 0; // edges to be looked at one by one; known; triangles of these
            const uint meta = nodes[own].meta, crossed = crossed_edges(meta_signs(meta));
            const int3 in_region = convert_int3(unmorton(code_cell(meta_code(meta), level))), low = part.origin + in_region;
            // Where no samples are missing every crossed edge has a polygon, so that a cell marks its own vertices as used, without the leaves that
            // emit the polygons.
            if (level == 0 && !gaps) {
                const uint next = !is_last ? 0 : (in_region.x == 31 && low.x + 2 < end.x ? EDGES_HIGH_X : 0)
                    | (in_region.y == 31 && low.y + 2 < end.y ? EDGES_HIGH_Y : 0)
                    | (in_region.z == 31 && low.z + 2 < end.z ? EDGES_HIGH_Z : 0);
                const uint extra = first_extra(region, bricks + part.brick, nodes[own]);
                const uint sheets = meta_extras(meta) ? nodes[extra].count : 0;
                ROLLED for (uint sheet = 0; sheet <= meta_extras(meta); sheet++) {
                    const uint at = sheet == 0 ? own : extra + sheet - 1, of_sheet = crossed & edges_of_sheet(sheets, sheet);
                    if (of_sheet & ~next) used[at] = 1;
                    else if (all_quads) used[at] = 0; // was marked with all others
                    if (of_sheet & next) used_elsewhere[at] = 1;
                }
            }
            if (all_quads) edges = crossed & EDGES_OWN & boundary_edges(grid, part.origin, in_region, 0);
            else if (plain_brick && is_inside(grid, low) && all(in_region > 0)) sum = 2 * popcount(crossed & EDGES_OWN);
            else if (plain_brick && is_inside(grid, low)) edges = crossed & EDGES_OWN;
            else if (part.brick == NONE || level > 1) edges = crossed;
            else {
                const int3 in_brick = low - part.low;
                edges = crossed & ~edges_of_neighbours(&halo, level, convert_uint3(in_brick));
                if (!gaps) {
                    const uint outer = boundary_edges(grid, part.origin, in_region, level);
                    inner = edges & ~outer;
                    edges &= outer;
                    if (inner && level > 0) used[own] = 1;
                    ROLLED for (uint rest = inner; rest; rest &= rest - 1)
                        sum += count_inner_polygon(&halo, level, in_region, in_brick, lowest_bit(rest), used);
                }
            }
            if (sum) ADD_LOCAL(&triangles[level], sum);
            if (!plain_brick) emitted_edges[own] = inner;
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
            if (!plain_brick) atomic_or(&emitted_edges[slot], 1u << edge);
            for (uint k = 0; k < 4; k++) {
                if (k >= polygon.count) break;
                const uint of = polygon.region[k], at = polygon.slot[k], faces = polygon.faces[k];
                if (of == part.region && !faces) {
                    used[at] = 1;
                    continue;
                }
                const uint bit = ghost_bit(grid, regions, nodes, part.origin, of, at, faces);
                atomic_or(&ghosts[part.region * HALO_WORDS + (bit >> 5)], 1u << (bit & 31));
                if (!faces) used_elsewhere[at] = 1;
                else {
                    // Its leaf's region alone counts it.
                    const int3 origin = convert_int3(region_origin(grid, regions[of].region));
                    const uint there = ghost_bit(grid, regions, nodes, origin, of, at, faces);
                    atomic_or(&borders[of * HALO_WORDS + (there >> 5)], 1u << (there & 31));
                }
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    ROLLED for (uint i = lid; i < part.levels; i += BRICK_GROUP) brick_triangles[part.counts + i] = triangles[part.finest + i];
}

#if GROUP == 1
#define SLOTS_EACH 1
#else
#define SLOTS_EACH 8 // that a work-item of dual_scan numbers, so that there are few scans
#endif

// `first_triangles`: of every brick and level, from the region's first. `ghost_base`: of the first ghost of every word.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_scan(const uint brick_count, __global const Region *regions, __global const uchar *used,
                __global const uchar *used_elsewhere, __global const uint *ghosts, __global const uint *borders,
                __global const uint *brick_triangles, __global uint *first_triangles, __global uint *compact_index,
                __global uint *ghost_base, __global RegionMesh *meshes, __global Counters *counters) {
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

    uint vertices = 0, total, distinct = 0;
    for (uint begin = 0; begin < slots; begin += SLOTS_EACH * GROUP) {
        const uint first = begin + SLOTS_EACH * lid;
        uint own = 0; // one bit each
        for (uint i = 0; i < SLOTS_EACH; i++) {
            if (first + i >= slots) break;
            const uint slot = region->slot_base + first + i, here = used[slot];
            own |= here << i;
            distinct += here | used_elsewhere[slot];
        }
        const uint before = vertices + scan_group(scratch, popcount(own), &total);
        for (uint i = 0; i < SLOTS_EACH; i++) {
            if (first + i >= slots) break;
            compact_index[region->slot_base + first + i] = before + popcount(own & ((1u << i) - 1));
        }
        vertices += total;
    }
    for (uint word = lid; word < HALO_WORDS; word += GROUP) distinct += popcount(borders[group * HALO_WORDS + word]);
    if (distinct) atomic_add(&counters->vertices, distinct);
    for (uint first = 0; first < HALO_WORDS; first += GROUP) {
        const bool inside = first + lid < HALO_WORDS;
        const uint word = group * HALO_WORDS + first + lid;
        const uint before = scan_group(scratch, inside ? popcount(ghosts[word]) : 0, &total);
        if (inside) ghost_base[word] = vertices + before;
        vertices += total;
    }
    if (lid == 0) meshes[group].vertices = vertices;
}

// Puts a polygon into a batch, and the vertices of its ghosts and of the border into `out`.
INLINED void add_polygon(Batch *batch, Grid grid, CORNER_PARAMS, Part part, const Polygon *polygon, uint flip_winding, uint first_corner) {
    const uint column = NEXT_COLUMN(batch);
    for (uint k = 0; k < 4; k++) {
        if (k >= polygon->count) break;
        const uint at = polygon->slot[k], in = polygon->region[k], faces = polygon->faces[k], row = k * LANES + column;
        const VertexRecord record = vertex_records[at];
        const bool here = in == part.region;
        const int3 from = here ? part.origin : convert_int3(region_origin(grid, regions[in].region));
        const int3 in_region = (faces ? border_position(grid, nodes[at], record, faces, from)
                                      : lattice_position(grid, params, record, from)) - part.origin * (int)VERTEX_LATTICE;
        const uint index = here && !faces ? compact_index[at]
            : ghost_vertex(CORNER_ARGS, part, at, ghost_bit(grid, regions, nodes, part.origin, in, at, faces), in_region);
        batch->position_normal[row] = (int4)(in_region, (int)record.normal);
        batch->index_slot[row] = (uint2)(index, at | (faces ? ON_BORDER : 0));
    }
    batch->first[column] = first_corner;
    batch->count_flags[column] = polygon->count | flip_winding << 3;
}

// Once around an edge is counter-clockwise seen from its high end: right when that is the outside.
#define FLIP_WINDING(signs, edge) (uint)(!((signs) >> edge_low_corner(edge) & 1u))

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_emit(const DualEmitArgs args, POLYGON_PARAMS, __global const uchar *fine, __global const VertexRecord *vertex_records,
               __global const uchar *used,
               __global const uint *emitted_edges, __global const uint *brick_triangles, __global const uint *first_triangles,
               __global const uint *compact_index, __global const uint *ghosts, __global const uint *ghost_base,
               __global const RegionMesh *meshes, __global Vertex *vertices, __global uint *indices,
               __global uint *corner_slots) {
    const Grid grid = args.grid;
    const CutParams params = args.params;
    const uint brick_count = args.brick_count, gaps = args.gaps, keep_corners = args.keep_corners;
    __local uint to[6], scratch[BRICK_GROUP], coarse;
    __local ushort list[EDGE_LIST_CAPACITY];
    __local LeafHalo halo;
    const uint lid = get_local_id(0);
    const Part part = find_part(grid, brick_count, regions, bricks);
    __global const Region *region = regions + part.region;
    const float3 scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / VERTEX_LATTICE;
    __global Vertex *out = vertices + meshes[part.region].vertex_base;
    // Where each level's first triangle goes, less the triangles of the levels before.
    for (uint i = lid; i < part.levels; i += BRICK_GROUP) {
        uint before = 0;
        for (uint finer = 0; finer < i; finer++) before += brick_triangles[part.counts + finer];
        to[part.finest + i] = meshes[part.region].triangle_base + first_triangles[part.counts + i] - before;
    }
    near += 27 * (part.brick == NONE ? 0 : part.brick);
    const bool plain_brick = is_plain(fine, part.brick != NONE && !gaps, near, &coarse);
    const bool all_quads = plain_brick && is_inside(grid, part.low) && is_inside(grid, part.low + 7);
    find_halo(&halo, regions, bricks, state, near, part.brick != NONE && !all_quads);
#if BRICK_GROUP == 1
    Corners corners;
    if (plain_brick) find_corners(&corners, grid, CORNER_ARGS, part, bricks, near);
#endif
    Batch batch;
    batch.count = 0;
    for (uint i = 0; i < 4 * LANES; i++) batch.position_normal[i] = (int4)(0);

    // The part's nodes of all levels, of a region's top two alone, and its extra sheets, numbered through, so that many work-items
    // take few steps.
    const Slots a = part_slots(part, region, bricks, part.finest), b = part_slots(part, region, bricks, part.finest + 1);
    const Slots c = part_slots(part, region, bricks, 2), d = part_slots(part, region, bricks, 3), e = part_slots(part, region, bricks, 6);
    const uint end_a = a.count, end_b = end_a + b.count, end_c = end_b + c.count, end_d = end_c + d.count, end_e = end_d + e.count;
    for (uint i = lid; i < end_e; i += BRICK_GROUP) {
        const uint slot = region->slot_base
            + (i < end_a ? a.first + i : i < end_b ? b.first + i - end_a : i < end_c ? c.first + i - end_b
               : i < end_d ? d.first + i - end_c : e.first + i - end_d);
        if (!used[slot]) continue;
        const VertexRecord record = vertex_records[slot];
        int3 at = (int3)(record.position[0], record.position[1], record.position[2]);
        if (params.cap) at = lattice_position(grid, params, record, part.origin) - part.origin * (int)VERTEX_LATTICE;
        out[compact_index[slot]] = make_vertex(params, nodes[slot], record.normal, at);
    }

    uint done = 0;
    Slots slots = part_slots(part, region, bricks, part.finest);
    for (uint level = part.finest, begin = 0, beyond = level + (plain_brick ? 1 : part.levels); level < beyond;) {
        uint listed = 0;
#if BRICK_GROUP == 1
        if (plain_brick) {
            listed = emit_plain(&batch, &corners, grid, part, regions, bricks, nodes, all_quads, scale, to[0], &done, list,
                                indices, keep_corners, corner_slots);
            level = beyond;
        }
#endif
        while (level < beyond && listed + 12 * BRICK_GROUP <= EDGE_LIST_CAPACITY) {
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
                edges = !plain_brick ? emitted_edges[own] : is_inside(grid, low) ? crossed & EDGES_OWN : crossed;
            }
            uint at = listed + scan_group(scratch, popcount(edges), &total);
            for (uint rest = edges; rest; rest &= rest - 1) list[at++] = LIST_ENTRY(level, i, lowest_bit(rest));
            listed += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint at = 0; at < listed; at += BRICK_GROUP) {
            Polygon polygon;
            polygon.count = 0;
            uint flip_winding = 0, first = 0, total;
            if (at + lid < listed) {
                const uint entry = list[at + lid], of_level = entry_level(entry), edge = entry_edge(entry);
                const uint slot = entry_slot(entry, part, region, bricks);
                const uint meta = nodes[slot].meta;
                const int3 low = part.origin + convert_int3(unmorton(code_cell(meta_code(meta), of_level)));
                polygon = FIND_POLYGON;
                flip_winding = FLIP_WINDING(meta_signs(meta), edge);
                first = to[of_level] + done;
            }
            uint before = 2 * lid;
            if (all_quads) total = 2 * min(listed - at, (uint)BRICK_GROUP);
            else before = scan_group(scratch, polygon.count ? polygon.count - 2 : 0, &total);
            if (polygon.count)
                add_polygon(&batch, grid, CORNER_ARGS, part, &polygon, flip_winding, 3 * (first + before));
            if (batch.count == LANES) emit_batch(&batch, scale, indices, keep_corners, corner_slots);
            done += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (batch.count) emit_batch(&batch, scale, indices, keep_corners, corner_slots);
}
