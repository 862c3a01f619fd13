// construct: nodes of levels 0 to 5 with the sums of the paper's pyramid (docs/algorithm.md#3-pyramid), each with the vertex,
// normal and error that the dual mesher takes from it (docs/algorithm.md#63-vertex-placement). Per isovalue: edits of the cut read no sample.
// construct: one work-group a brick, levels 0 to 3: its active cells some at a time, then its cubes. Unless the `whole` pyramid
// is wanted, cells alone, which is all that a surface in full needs. `cubes` is room for CUBE_ROWS rows, or for the 6 rows that
// cells need and POSITIONS_CAPACITY in relax.
// construct_top: one work-item a region, levels 4 and 5.
// link: the bricks around each brick, 9 work-items a brick.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/cell_solver.h"
#include "lib/cube.h"
#include "lib/cube_solver.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/merge.h"
#include "lib/moments.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/quadric.h"
#include "lib/relax.h"
#include "lib/samples.h"
#include "lib/sheet_vertices.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// The 27 samples of a cube inside the brick; rows of the tile go on beyond the volume with its last sample.
inline uint tile_samples27(__local const ushort *signs_of_row, int3 low, int half_size) {
    uint samples27 = 0;
    for (int i = 0; i < 9; i++) {
        const uint row = signs_of_row[(low.z + i / 3 * half_size) * 9 + low.y + i % 3 * half_size] >> low.x;
        samples27 |= ((row & 1u) | (row >> half_size & 1u) << 1 | (row >> (2 * half_size) & 1u) << 2) << (3 * i);
    }
    return samples27;
}

// Where and how the vertex of a cube lies. `low`, `high`: the cube in cells from the region's low corner;
// `origin`: the quadric's origin there. The field is read through FIELD(position, result).
#define PLACE_CUBE(q, level_value, low, high, origin, spacing, towards, result, FIELD)                                              \
    {                                                                                                                  \
        float3 x = clamp((origin) + quadric_minimum(q) / (spacing), (low) + MARGIN, (high) - MARGIN);                  \
        const float3 start = x;                                                                                        \
        float4 field;                                                                                                  \
        FIELD(x, field);                                                                                               \
        const float off = fabs(field.w - (level_value));                                                                         \
        for (uint newton = 0; newton < NEWTON_STEPS; newton++) {                                                       \
            x = clamp(x + newton_step(field, level_value, spacing), (low) + MARGIN, (high) - MARGIN);                          \
            FIELD(x, field);                                                                                           \
        }                                                                                                              \
        if (!(fabs(field.w - (level_value)) <= off)) x = start;                                                                  \
        result = make_vertex_record(x, towards, quadric_error(q, (x - (origin)) * (spacing)));                             \
    }

// One row of a brick's samples: minus the isovalue into `tile`, NaN where missing; answers which are inside. Beyond the last
// sample of the volume the row goes on with that one.
inline ushort load_row(__global const SAMPLE *row, int last, float iso, float missing, __local float *tile) {
    uint inside = 0;
    if (last == 8) {
        const float8 v = convert_float8(vload8(0, row));
        const float end = (float)row[8];
        vstore8(select(v - iso, (float8)(NAN), v == missing), 0, tile);
        tile[8] = end == missing ? NAN : end - iso;
        inside = mask8(v >= iso && v != missing) | (uint)(end >= iso && end != missing) << 8;
    } else for (int x = 0; x < 9; x++) {
        const float v = (float)row[min(x, last)];
        tile[x] = v == missing ? NAN : v - iso;
        inside |= (uint)(v >= iso && v != missing) << x;
    }
    return (ushort)inside;
}

// A cube's sums as they lie in its column.
inline Moments column_moments(__local const float *column) {
    Moments m;
    for (uint i = 0; i < 3; i++) m.g[i] = column[(CUBE_SLOPE + i) * CUBES];
    m.q = column[CUBE_SLOPED * CUBES];
    m.f = column[CUBE_FEATURE * CUBES];
    m.n = (uint)column[CUBE_COUNT * CUBES];
    return m;
}
inline Quadric column_quadric(__local const float *column) {
    Quadric q;
    column += CUBE_QUADRIC * CUBES;
    for (uint i = 0; i < 6; i++) q.a[i] = column[i * CUBES];
    for (uint i = 0; i < 3; i++) {
        q.b[i] = column[(6 + i) * CUBES];
        q.m[i] = column[(10 + i) * CUBES];
    }
    q.c = column[9 * CUBES];
    q.k = column[13 * CUBES];
    return q;
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void construct(const ConstructArgs args, __global const SAMPLE *samples, __global const void *feature,
               __global const Region *regions, __global const Brick *bricks, __global const uint *case_facts,
               __global Node *nodes, __global VertexRecord *vertex_records, __global Moments *brick_moments,
               __global Quadric *brick_quadrics, __global uchar *brick_safe, __local float *cubes) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const uint feature_kind = args.feature_kind, feature_type = args.feature_type;
    const float feature_missing = args.feature_missing;
    const uint first_brick = args.first_brick, whole = args.whole;
    __local float tile[729]; // samples minus isovalue
    __local ushort signs_of_row[81];
    __local ushort list[512];  // active cells in Morton order, as in_brick and in_order understand them
    __local ushort place[512]; // theirs in the list, by x + 8 y + 64 z; NO_PLACE of others
    __local float cells_in[INPUTS * CELLS], cells_out[OUTPUTS * CELLS > OFFSET_SUMS_CAPACITY ? OUTPUTS * CELLS : OFFSET_SUMS_CAPACITY];
    // The brick's cubes: those of level 1 in Morton order, those of level 2, itself. Of each: level << 6 | its Morton number.
    __local uchar cube_of[CUBES];
    __local uchar safe[73]; // may be merged: level-1 cubes by Morton number, from 64 on level-2 cubes, from 72 on the brick
    __local uchar signs_of_cube[CUBES];
    // Cells of several sheets, of two or four, of three or four; bits in the order of `list`.
    __local uint several[16], even[16], many[16];
    __local uint listed; // work of the last two steps
    __local uint facts[64]; // of 256 cases a byte: triangles, sheets << 3, has a joined face << 6
    const uint lid = get_local_id(0), index = first_brick + (uint)get_group_id(0);
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const uint brick_cell = brick->morton << 9;
    const int3 in_region = convert_int3(unmorton(brick_cell));
    const int3 origin = convert_int3(region_origin(grid, region->region)) + in_region;
    const int3 last = clamp_sample(grid, origin + 8) - origin; // of the brick
    ROLLED for (uint row = lid; row < 81; row += BRICK_GROUP) {
        const int3 p = origin + (int3)(0, min((int)(row % 9), last.y), min((int)(row / 9), last.z));
        signs_of_row[row] = load_row(samples + sample_index(grid, z0, p), last.x, iso, grid.missing, tile + 9 * row);
    }
    ROLLED for (uint i = lid; i < 512; i += BRICK_GROUP) place[i] = NO_PLACE;
    barrier(CLK_LOCAL_MEM_FENCE);
    const uint ones_low = brick->level1_mask[0], ones_high = brick->level1_mask[1], ones = popcount(ones_low) + popcount(ones_high);
    const uint twos = popcount(brick->level2_mask), cube_count = ones + twos + 1;
    ROLLED for (uint i = lid; i < 64; i += BRICK_GROUP) {
        facts[i] = case_facts[i];
        const uint cells = level1_cells(brick, i);
        safe[i] = 1;
        if (!cells) continue;
        uint at = cells_before_level1(brick, i);
        const uint3 low = unmorton(i << 3);
        ROLLED for (uint rest = cells; rest; rest &= rest - 1, at++) {
            const uint bit = lowest_bit(rest), in_cube = (bit & 1u) | (bit << 2 & 8u) | (bit << 4 & 64u);
            const uint cell = low.x + 8 * low.y + 64 * low.z + in_cube;
            list[at] = (ushort)(i << 9 | cell);
            place[cell] = (ushort)at;
        }
        cube_of[rank64(ones_low, ones_high, i)] = (uchar)(1 << 6 | i);
    }
    if (lid == 0) listed = 0;
    ROLLED for (uint i = lid; i < 16; i += BRICK_GROUP) several[i] = even[i] = many[i] = 0;
    ROLLED for (uint i = lid; i < 9; i += BRICK_GROUP) {
        safe[64 + i] = 1;
        if (i == 8) cube_of[ones + twos] = 3 << 6;
        else if (brick->level2_mask >> i & 1u) cube_of[ones + popcount(brick->level2_mask & ((1u << i) - 1))] = (uchar)(2 << 6 | i);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float least = fmin(spacing.x, fmin(spacing.y, spacing.z));
    const float3 per_spacing = least / spacing; // gradients need their direction alone
    const uint count = count_cells(brick), cell_slots = region->slot_base + brick->level_base[0];
    // Where one work-item does all, the cells of a cube sum up as they come, unless more than their smoothness is wanted.
    const bool at_once = SUM_WHILE_SOLVING && !whole;
    const uint rows = whole ? CUBE_SUMS : at_once ? 0 : CUBE_QUADRIC;
    Moments of_cube = no_moments();
    uint summed = 0, triangles = 0; // cells of the cubes before; of the brick
    ROLLED for (uint first = 0; first < count; first += CELLS) {
        const uint run = min(count - first, (uint)CELLS);
        const uint columns = (run + LANES - 1) / LANES * LANES;
        ROLLED for (uint i = lid; i < columns; i += BRICK_GROUP) {
            const int3 at = listed_cell(list[first + min(i, run - 1)]);
            __local const float *corner = tile + (at.z * 9 + at.y) * 9 + at.x;
            __local float *in = cells_in + i;
            GATHER_CORNERS(corner, in, CELLS)
            in[IN_LOW * CELLS] = (float)at.x - 4.0f; // quadrics of the brick count from its centre
            in[(IN_LOW + 1) * CELLS] = (float)at.y - 4.0f;
            in[(IN_LOW + 2) * CELLS] = (float)at.z - 4.0f;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        ROLLED for (uint i = lid * LANES; i < run; i += BRICK_GROUP * LANES) solve_cells(cells_in, cells_out, i, spacing, per_spacing);
        barrier(CLK_LOCAL_MEM_FENCE);

        ROLLED for (uint i = lid; i < run; i += BRICK_GROUP) {
            __local float *of = cells_out + i;
            const uint slot = cell_slots + first + i, cell = listed_morton(list[first + i]), signs = (uint)of[OUT_SIGNS * CELLS];
            const int3 at = listed_cell(list[first + i]);
            const uint fact = facts[signs >> 2] >> (8 * (signs & 3)) & 0xffu, n = fact & 7u;
            const float f = feature_of_cell(grid, SLAB_ARGS, feature_kind, feature, feature_type, feature_missing, origin + at);
            uint sheets = fact >> 3 & 7u;
            if (fact & 64u) sheets = sheet_count(cell_sheets(grid, SLAB_ARGS, iso, origin + at, signs));
            if (sheets > 1 || fact & 64u) safe[cell >> 3] = 0;
            if (sheets > 1) {
                const uint bit = first + i;
                atomic_or(&several[bit >> 5], 1u << (bit & 31));
                if (sheets != 3) atomic_or(&even[bit >> 5], 1u << (bit & 31));
                if (sheets > 2) atomic_or(&many[bit >> 5], 1u << (bit & 31));
            }
            nodes[slot].count = n;
            nodes[slot].f = f;
            nodes[slot].meta = node_code(0, brick_cell | cell) | signs << 16 | (sheets - 1) << 26;
            const float3 x = (float3)(of[OUT_VERTEX * CELLS], of[(OUT_VERTEX + 1) * CELLS], of[(OUT_VERTEX + 2) * CELLS]);
            vertex_records[slot] = quantise_vertex(convert_float3(in_region + at) + x, (uint)of[OUT_NORMAL * CELLS], of[OUT_ERROR * CELLS]);
            if (at_once) {
                const float weight = (float)n;
                for (uint j = 0; j < 3; j++) of_cube.g[j] += of[(OUT_SLOPE + j) * CELLS] * weight;
                of_cube.q += of[OUT_SLOPED * CELLS] > 0.0f ? weight : 0.0f;
                of_cube.n += n;
                if (first + i + 1 < count && listed_morton(list[first + i + 1]) >> 3 == cell >> 3) continue;
                const float s = smoothness(of_cube);
                for (; summed <= first + i; summed++) nodes[cell_slots + summed].s = s;
                triangles += of_cube.n;
                of_cube = no_moments();
                continue;
            }
            // What the cubes above sum up: the triangles weigh the moments.
            for (uint j = 0; j < 3; j++) of[(OUT_SLOPE + j) * CELLS] *= (float)n;
            of[OUT_SLOPED * CELLS] = of[OUT_SLOPED * CELLS] > 0.0f ? (float)n : 0.0f;
            of[OUT_FEATURE * CELLS] = (float)n * f;
            of[OUT_COUNT * CELLS] = (float)n;
        }
        barrier(CLK_LOCAL_MEM_FENCE);

        // The cells of one cube follow one another; a work-item adds up some rows of one cube.
        ROLLED for (uint i = lid; !at_once && i < ones * WORK_ITEMS_A_SUM; i += BRICK_GROUP) {
            const uint column = i / WORK_ITEMS_A_SUM, one = cube_of[column] & 63u, begin = cells_before_level1(brick, one);
            const uint end = begin + popcount(level1_cells(brick, one));
            if (begin >= first + run || end <= first) continue;
            const uint from = max(begin, first) - first, to = min(end, first + run) - first;
            ROLLED for (uint row = i % WORK_ITEMS_A_SUM; row < rows; row += WORK_ITEMS_A_SUM) {
                float sum = begin >= first ? 0.0f : cubes[row * CUBES + column];
                ROLLED for (uint j = from; j < to; j++) sum += cells_out[row * CELLS + j];
                cubes[row * CUBES + column] = sum;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    ROLLED for (uint i = lid; i < 8 * rows; i += BRICK_GROUP) {
        const uint two = i & 7, row = i >> 3;
        if (!(brick->level2_mask >> two & 1u)) continue;
        const uint from = rank64(ones_low, ones_high, 8 * two);
        const uint to = from + popcount((two < 4 ? ones_low : ones_high) >> (8 * (two & 3)) & 0xffu);
        float sum = 0.0f;
        ROLLED for (uint j = from; j < to; j++) sum += cubes[row * CUBES + j];
        cubes[row * CUBES + ones + popcount(brick->level2_mask & ((1u << two) - 1))] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint row = lid; row < rows; row += BRICK_GROUP) {
        float sum = 0.0f;
        ROLLED for (uint j = ones; j < ones + twos; j++) sum += cubes[row * CUBES + j];
        cubes[row * CUBES + ones + twos] = sum;
    }

    // Whether a cube may be merged depends on those below: what each says itself first.
    ROLLED for (uint column = lid; column < cube_count; column += BRICK_GROUP) {
        if (!whole) break;
        const uint level = cube_of[column] >> 6, number = cube_of[column] & 63u, size = 1u << level;
        const int3 low = convert_int3(unmorton(number << (3 * level))), high = min(low + (int)size, last);
        const uint samples27 = tile_samples27(signs_of_row, low, (int)size / 2);
        signs_of_cube[column] = (uchar)corner_signs(samples27);
        if (!safe_signs(samples27)) safe[level == 1 ? number : level == 2 ? 64 + number : 72] = 0;
        __local float *box = cubes + CUBE_LOW * CUBES + column;
        box[0] = (float)low.x;
        box[CUBES] = (float)low.y;
        box[2 * CUBES] = (float)low.z;
        box[3 * CUBES] = (float)high.x;
        box[4 * CUBES] = (float)high.y;
        box[5 * CUBES] = (float)high.z;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint two = lid; two < 8; two += BRICK_GROUP) {
        bool all_below = true;
        ROLLED for (uint i = 8 * two; i < 8 * two + 8; i++) all_below = all_below && safe[i];
        if (!all_below) safe[64 + two] = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    bool merge_brick = safe[72];
    for (uint two = 0; two < 8; two++) merge_brick = merge_brick && safe[64 + two];
    ROLLED for (uint column = lid; !at_once && column < cube_count; column += BRICK_GROUP) {
        const uint level = cube_of[column] >> 6, number = cube_of[column] & 63u;
        bool missing = (brick->level1_missing[0] | brick->level1_missing[1]) != 0, merge = merge_brick;
        uint slot = region->slot_base + column;
        if (level == 1) {
            missing = missing && test_bit64(brick->level1_missing[0], brick->level1_missing[1], number);
            merge = safe[number];
            slot += brick->level_base[1];
        } else if (level == 2) {
            missing = (brick->level1_missing[number >> 2] >> (8 * (number & 3)) & 0xffu) != 0;
            merge = safe[64 + number];
            slot += brick->level_base[2] - ones;
        } else slot += region->level_base[3] + index - region->brick_base - ones - twos;
        if (!whole && level > 1) continue;
        const Node node = make_node(column_moments(cubes + column), level, brick_cell | number << (3 * level),
                                    signs_of_cube[column], missing, merge);
        if (whole) nodes[slot] = node;
        if (level > 1) continue;
        const uint at = cell_slots + cells_before_level1(brick, number), after = at + popcount(level1_cells(brick, number));
        ROLLED for (uint i = at; i < after; i++) nodes[i].s = node.s;
    }
    if (at_once) brick_moments[index].n = triangles;
    else if (lid == 0) {
        brick_moments[index] = column_moments(cubes + ones + twos);
        if (whole) {
            brick_quadrics[index] = column_quadric(cubes + ones + twos);
            brick_safe[index] = merge_brick;
        }
    }
    // Global too: below nodes of cells are read, and vertices of those with several sheets written again.
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    ROLLED for (uint column = lid * LANES; whole && column < cube_count; column += BRICK_GROUP * LANES)
        solve_cubes(tile, cubes, column, last, spacing);
    barrier(CLK_LOCAL_MEM_FENCE);
    ROLLED for (uint column = lid; whole && column < cube_count; column += BRICK_GROUP) {
        const uint slot = region->slot_base
            + (column < ones ? brick->level_base[1] + column : column < ones + twos ? brick->level_base[2] + column - ones
                                                      : region->level_base[3] + index - region->brick_base);
        __local const float *of = cubes + column;
        const float3 x = (float3)(of[CUBE_VERTEX * CUBES], of[(CUBE_VERTEX + 1) * CUBES], of[(CUBE_VERTEX + 2) * CUBES]);
        vertex_records[slot] = quantise_vertex(convert_float3(in_region) + x, (uint)of[CUBE_NORMAL * CUBES], of[CUBE_ERROR * CUBES]);
    }

    // Sheets of cells with several, one after another so that every work-item gets one: cell << 2 | sheet. The cells' own results
    // are all written: their room holds the list, and then what relax_cells needs.
    __local ushort *of_several = (__local ushort *)cells_out;
    ROLLED for (uint i = lid; brick->extra_sheets && i < count; i += BRICK_GROUP) {
        if (!test_bit(several, i)) continue;
        const uint more = test_bit(many, i), sheets = 2 + more + (more & test_bit(even, i));
        const uint to = ADD_LOCAL(&listed, sheets);
        ROLLED for (uint sheet = 0; sheet < sheets; sheet++) of_several[to + sheet] = (ushort)(i << 2 | sheet);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    SheetVertices vertices;
    for (uint i = 0; i < 8 * LANES; i++) vertices.corner[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) vertices.edges[i] = 0;
    ROLLED for (uint begin = lid * LANES; begin < listed; begin += BRICK_GROUP * LANES) {
        const uint run = min(listed - begin, (uint)LANES);
        uint packed[LANES];
        for (uint lane = 0; lane < LANES; lane++) {
            if (lane >= run) break;
            const uint of = of_several[begin + lane], i = of >> 2, sheet = of & 3u;
            const int3 p = listed_cell(list[i]);
            const uint signs = meta_signs(nodes[cell_slots + i].meta);
            const uint sheets = cell_sheets(grid, SLAB_ARGS, iso, origin + p, signs);
            __local const float *corner = tile + (p.z * 9 + p.y) * 9 + p.x;
            packed[lane] = sheets;
            vertices.edges[lane] = crossed_edges(signs) & edges_of_sheet(sheets, sheet);
            GATHER_CORNERS(corner, vertices.corner + lane, LANES)
        }
        solve_sheets(&vertices, spacing);
        for (uint lane = 0; lane < LANES; lane++) {
            if (lane >= run) break;
            const uint i = of_several[begin + lane] >> 2, sheet = of_several[begin + lane] & 3u;
            // Before the cell's extra sheets stand as many as the cells before have: one for an even number of sheets, two more
            // for three and four.
            const uint below = (1u << (i & 31)) - 1;
            uint before = popcount(even[i >> 5] & below) + 2 * popcount(many[i >> 5] & below), at = cell_slots + i;
            ROLLED for (uint word = 0; word < i >> 5; word++) before += popcount(even[word]) + 2 * popcount(many[word]);
            __global Node *cell = nodes + at;
            if (sheet == 0) cell->count |= before << 8;
            else {
                at = region->slot_base + brick->level_base[3] + before + sheet - 1;
                nodes[at].count = packed[lane];
                nodes[at].s = cell->s;
                nodes[at].f = cell->f;
                nodes[at].meta = (cell->meta & ~(3u << 26)) | sheet << 26;
            }
            const float3 low = convert_float3(in_region + listed_cell(list[i]));
            const float3 x = (float3)(vertices.x[lane], vertices.y[lane], vertices.z[lane]);
            vertex_records[at] = quantise_vertex(low + x, (uint)vertices.normal[lane], 0.0f);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    relax_cells(tile, signs_of_row, list, place, several, count, region, brick, nodes, vertex_records, in_region, spacing,
                (__local ushort *)cubes, (__local int *)cells_out, (__local ushort *)cells_in, &listed);
}

// The 27 samples of a cube from the volume, cut at its last sample.
inline uint cube_samples27(Grid grid, SLAB, float iso, int3 low, int half_size) {
    uint samples27 = 0;
    for (uint i = 0; i < 27; i++) {
        const int3 p = low + (int3)((int)(i % 3), (int)(i / 3 % 3), (int)(i / 9)) * half_size;
        samples27 |= (uint)(sample_at(grid, SLAB_ARGS, clamp_sample(grid, p)) >= iso) << i;
    }
    return samples27;
}

__kernel void construct_top(const ConstructTopArgs args, __global const SAMPLE *samples, __global const Region *regions,
                            __global const Brick *bricks,
                            __global const Moments *brick_moments, __global const Quadric *brick_quadrics,
                            __global const uchar *brick_safe, __global Node *nodes, __global VertexRecord *vertex_records,
                            __global uint *totals) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const float iso = args.iso;
    const uint whole_pyramid = args.whole_pyramid, first_region = args.first_region, region_count = args.region_count;
    if (get_global_id(0) >= region_count) return;
    __global const Region *region = regions + first_region + get_global_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const int3 last = clamp_sample(grid, origin + 32) - origin;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]), centre = (float3)(16.0f);
#define VOLUME_FIELD(x, field)                                                                                         \
    {                                                                                                                  \
        const int3 from = min(convert_int3(x), last - 1);                                                              \
        float v[8];                                                                                                    \
        for (uint corner = 0; corner < 8; corner++)                                                                    \
            v[corner] = sample_at(grid, SLAB_ARGS, origin + from + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));  \
        field = trilinear(v, (x) - convert_float3(from));                                                              \
    }
    if (!whole_pyramid) {
        uint n = 0, end = region->brick_base + count_bricks(region);
        for (uint i = region->brick_base; i < end; i++) n += brick_moments[i].n;
        totals[first_region + get_global_id(0)] = n;
        return;
    }
    Moments whole = no_moments();
    Quadric whole_quadric = no_quadric();
    bool whole_safe = true;
    uint index = region->brick_base, slot = region->slot_base + region->level_base[4];
    for (uint eight = 0; eight < 8; eight++) {
        const uint bits = region->brick_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu;
        if (!bits) continue;
        Moments sum = no_moments();
        Quadric q = no_quadric();
        bool safe = true;
        for (uint i = 0; i < popcount(bits); i++, index++) {
            add_moments(&sum, brick_moments[index]);
            const float3 brick_centre = convert_float3(unmorton(bricks[index].morton << 9)) + 4.0f;
            add_quadric(&q, shift_quadric(brick_quadrics[index], (centre - brick_centre) * spacing));
            // A brick without active cells, beside missing samples, forbids nothing.
            safe = safe && (brick_safe[index] || brick_moments[index].n == 0);
        }
        const uint cell = eight << 12;
        const int3 p = convert_int3(unmorton(cell));
        const bool missing = (region->missing_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu) != 0;
        const uint samples27 = cube_samples27(grid, SLAB_ARGS, iso, origin + p, 8);
        safe = safe && safe_signs(samples27);
        nodes[slot] = make_node(sum, 4, cell, corner_signs(samples27), missing, safe);
        const float3 low = convert_float3(p), high = convert_float3(min(p + 16, last));
        VertexRecord place;
        PLACE_CUBE(q, iso, low, high, centre, spacing, (float3)(sum.g[0], sum.g[1], sum.g[2]), place, VOLUME_FIELD)
        vertex_records[slot++] = place;
        add_moments(&whole, sum);
        add_quadric(&whole_quadric, q);
        whole_safe = whole_safe && safe;
    }
    totals[first_region + get_global_id(0)] = whole.n;
    const bool missing = (region->missing_mask[0] | region->missing_mask[1]) != 0;
    const uint samples27 = cube_samples27(grid, SLAB_ARGS, iso, origin, 16);
    nodes[slot] = make_node(whole, 5, 0, corner_signs(samples27), missing, whole_safe && safe_signs(samples27));
    VertexRecord place;
    PLACE_CUBE(whole_quadric, iso, (float3)(0.0f), convert_float3(last), centre, spacing,
               (float3)(whole.g[0], whole.g[1], whole.g[2]), place, VOLUME_FIELD)
    vertex_records[slot] = place;
}

// The active brick at a place, in bricks, of the volume; NONE where there is none.
inline uint find_brick(Grid grid, __global const uint *region_index, __global const Region *regions, int3 at) {
    if (any(at < 0) || any(at * 8 + 1 >= (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]))) return NONE;
    const int3 r = at >> 2;
    const uint index = region_index[((uint)r.z * grid.regions[1] + (uint)r.y) * grid.regions[0] + (uint)r.x];
    if (index == NONE) return NONE;
    __global const Region *region = regions + index;
    const uint b = morton(convert_uint3(at & 3)), low = region->brick_mask[0], high = region->brick_mask[1];
    return test_bit64(low, high, b) ? region->brick_base + rank64(low, high, b) : NONE;
}

__kernel void link(const LinkArgs args, __global const uint *region_index, __global const Region *regions,
                   __global const Brick *bricks, __global uint *near) {
    const Grid grid = args.grid;
    const uint brick_count = args.brick_count;
    const uint index = (uint)(get_global_id(0) / 9), row = (uint)(get_global_id(0) % 9);
    if (index >= brick_count) return;
    const uint3 first = region_origin(grid, regions[bricks[index].region].region) + unmorton(bricks[index].morton << 9);
    const int3 from = convert_int3(first >> 3) + (int3)(-1, (int)(row % 3) - 1, (int)(row / 3) - 1);
    for (int x = 0; x < 3; x++)
        near[3 * get_global_id(0) + x] = find_brick(grid, region_index, regions, from + (int3)(x, 0, 0));
}
