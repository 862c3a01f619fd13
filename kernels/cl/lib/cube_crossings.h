// Quadrics of the level-1 cubes of a brick (docs/algorithm.md#61-crossings-and-quadrics). Normals of the crossings are central
// differences across their edges, so that a cube knows what the cells beside it are like.
#ifndef ISOPEEL_CUBE_CROSSINGS_H
#define ISOPEEL_CUBE_CROSSINGS_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/brick_cubes.h"
#include "lib/brick_task.h"
#include "lib/cube_solver.h"
#include "lib/device.h"
#include "lib/morton.h"
#include "lib/quadric.h"
#include "lib/sample_block.h"
#include "lib/slots.h"

#define SLOPE_LIMIT 0x1p120f // slopes beside infinite samples count as this

// Low ends of the edges along x, y and z among the 3x3x3 samples of a level-1 cube, bits x + 3 y + 9 z.
#define EDGES_X 0x36db6dbu
#define EDGES_Y 0x0fc7e3fu
#define EDGES_Z 0x003ffffu

// Phase: samples of the brick with a halo.
INLINED void load_halo(const BrickTask *task, __local float *block) {
    const uint rows = task->args.whole ? BLOCK_PLANE : 0;
    ROLLED for (uint row = get_local_id(0); row < rows; row += BRICK_GROUP) {
        const BlockRow from = find_block_row(task->args.grid, task->args.z0, task->origin, row);
        __local float *to = block + BLOCK_ROW * row;
        COPY_BLOCK_ROW(from, task->samples, task->args.grid.missing, to)
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Of the cells `low` and `high` along an axis those that touch a point: at 0 the low ones, at 2 the high ones, at 1 both.
inline uint cells_touching(uint at, uint low, uint high) { return (at < 2 ? low : 0u) | (at > 0 ? high : 0u); }
// The cells of a level-1 cube around an edge, one bit each. 0 to 2: its place across its axis; along its axis twice that of its
// low end, as only cells beside its middle count.
inline uint cells_around(uint x, uint y, uint z) {
    return cells_touching(x, 0x55u, 0xaau) & cells_touching(y, 0x33u, 0xccu) & cells_touching(z, 0x0fu, 0xf0u);
}

// A quadric as vectors, which a CPU adds up in registers: of a crossing, (n, n p) times each of these four numbers, and (p, 1).
typedef struct {
    float4 x, y, z; // rows of A, b in w
    float4 d;       // c in w
    float4 m;       // k in w
} QuadricRows;

// Slopes per two cells: central differences, one-sided beside missing samples; limited, and 0 if they are not defined.
INLINED float4 slopes_between(float4 below, float4 here, float4 above) {
    const float4 down = here - below, up = above - here;
    const float4 slope = select(up, down, down == down) + select(down, up, up == up);
    return select((float4)(0.0f), clamp(slope, -SLOPE_LIMIT, SLOPE_LIMIT), slope == slope);
}

// Adds a crossing `weight` times. `g`: along its normal, of any length, 0 in w; `p`: its position, 1 in w.
INLINED void add_to_rows(QuadricRows *rows, float weight, float4 p, float4 g) {
#pragma OPENCL FP_CONTRACT ON
    // Scaled by a power of two: squares stay in range.
    const float largest = fmax(fmax(fabs(g.x), fabs(g.y)), fabs(g.z));
    g *= as_float(0x7f000000 - min(as_int(largest) & 0x7f800000, 0x7e800000));
    const float length2 = dot(g, g), d = dot(g, p), w = length2 > 0.0f ? native_divide(weight, length2) : 0.0f;
    g.w = d;
    const float4 wg = g * w;
    rows->x += g * wg.x;
    rows->y += g * wg.y;
    rows->z += g * wg.z;
    rows->d += g * wg.w;
    rows->m += p * weight;
}

// Adds the crossings of `edges` along an axis, one bit each as in EDGES_X. `cells`: the cube's active ones; `low`: its corner from
// the brick's; `block`: samples of the brick with a halo.
INLINED void add_crossings_along(QuadricRows *rows, const BrickTask *task, __local const float *block, uint edges, uint axis,
                                 uint cells, uint3 low) {
    const int step = axis == 0 ? 1 : axis == 1 ? BLOCK_ROW : BLOCK_PLANE;
    const int b = axis == 0 ? BLOCK_ROW : axis == 1 ? BLOCK_PLANE : 1, c = axis == 0 ? BLOCK_PLANE : axis == 1 ? 1 : BLOCK_ROW;
    const float iso = task->args.iso;
    const float3 smallest = (float3)(fmin(task->spacing.x, fmin(task->spacing.y, task->spacing.z)));
    const float4 spacing = (float4)(task->spacing, 1.0f), scale = (float4)(smallest / task->spacing, 0.0f);
    // From the brick's centre.
    const float4 first = (float4)(convert_float3(low) - 4.0f, 1.0f);
    const float4 along = (float4)(axis == 0, axis == 1, axis == 2, 0.0f);
    __local const float *corner = block + BLOCK_FIRST + (low.z * BLOCK_PLANE + low.y * BLOCK_ROW + low.x);
    for (uint rest = edges; rest; rest &= rest - 1) {
        const uint i = lowest_bit(rest), x = i % 3, y = i / 3 % 3, z = i / 9;
        const uint count = popcount(cells & cells_around(x << (axis == 0), y << (axis == 1), z << (axis == 2)));
        if (!count) continue; // beside missing samples
        __local const float *from = corner + (z * BLOCK_PLANE + y * BLOCK_ROW + x), *to = from + step;
        const float start = *from, end = *to, part = native_divide(start - iso, start - end);
        const float t = part == part ? clamp(part, 0.0f, 1.0f) : 0.5f;
        const float4 slopes = slopes_between((float4)(from[-b], from[-c], to[-b], to[-c]), (float4)(start, start, end, end),
                                             (float4)(from[b], from[c], to[b], to[c]));
        const float2 across = mix(slopes.lo, slopes.hi, t);
        const float own = clamp(2.0f * (end - start), -SLOPE_LIMIT, SLOPE_LIMIT);
        const float4 g = axis == 0 ? (float4)(own, across, 0.0f) : axis == 1 ? (float4)(across.y, own, across.x, 0.0f)
                                                                             : (float4)(across, own, 0.0f);
        const float4 p = (first + (float4)((float)x, (float)y, (float)z, 0.0f) + along * t) * spacing;
        add_to_rows(rows, (float)count, p, g * scale);
    }
}

INLINED void store_rows(QuadricRows rows, __local float *column) {
    column[0] = rows.x.x;
    column[CUBES] = rows.x.y;
    column[2 * CUBES] = rows.x.z;
    column[3 * CUBES] = rows.y.y;
    column[4 * CUBES] = rows.y.z;
    column[5 * CUBES] = rows.z.z;
    column[6 * CUBES] = rows.x.w;
    column[7 * CUBES] = rows.y.w;
    column[8 * CUBES] = rows.z.w;
    column[9 * CUBES] = rows.d.w;
    column[10 * CUBES] = rows.m.x;
    column[11 * CUBES] = rows.m.y;
    column[12 * CUBES] = rows.m.z;
    column[13 * CUBES] = rows.m.w;
}

// Phase: quadrics of the level-1 cubes. A crossing counts once for each active cell around it.
INLINED void sum_crossings(const BrickTask *task, const BrickMemory *memory, __local const float *block) {
    const uint work = task->args.whole ? task->level1_count : 0;
    ROLLED for (uint column = get_local_id(0); column < work; column += BRICK_GROUP) {
        const uint cube = cube_morton(memory->cube_ids[column]), cells = level1_cells(task->brick, cube);
        const uint3 low = unmorton(cube << 3);
        const uint inside = tile_samples27(memory->inside_rows, convert_int3(low), 1);
        QuadricRows rows = {(float4)(0.0f), (float4)(0.0f), (float4)(0.0f), (float4)(0.0f), (float4)(0.0f)};
        ROLLED for (uint axis = 0; axis < 3; axis++) {
            const uint step = axis == 0 ? 1 : axis == 1 ? 3 : 9, edges = axis == 0 ? EDGES_X : axis == 1 ? EDGES_Y : EDGES_Z;
            add_crossings_along(&rows, task, block, (inside ^ inside >> step) & edges, axis, cells, low);
        }
        store_rows(rows, memory->cubes + CUBE_QUADRIC * CUBES + column);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

#endif
