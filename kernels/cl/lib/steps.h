// Derivatives at samples of a block from their neighbours along the axes, LANES at once: of even axes by the spacing; with UNEVEN defined by
// the lengths of the two cells beside each sample (docs/algorithm.md#21-derived-features).
//
// Local memory: STEP_TABLES floats, not read if axes are even.
#ifndef ISOPEEL_STEPS_H
#define ISOPEEL_STEPS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/sample_block.h"

#ifdef UNEVEN

// A part of a list of parameters, and of the call: one over the lengths of the cells along x, then along y, then along z.
#define LENGTHS __global const float *inverse_lengths,
#define LENGTHS_ARGS inverse_lengths,

// One over the lengths of the cells before and after a sample along an axis, and over the sum of both numbers.
typedef struct {
    real before, after, inverse_sum;
} AxisStep;
typedef struct {
    AxisStep x, y, z;
} Steps;
typedef real Resolution;

// Lanes cross rows of a block. So there are tables by the index of a sample in a row and in a plane; of z by the plane. They hold the cell
// before the sample: the one after is the next sample's.
#define STEPS_X 0
#define STEPS_Y (STEPS_X + BLOCK_ROW + 1 + LANES)
#define STEPS_Z (STEPS_Y + BLOCK_PLANE + BLOCK_ROW + LANES)
#define STEPS_END (STEPS_Z + BLOCK_ROW + 1)
#if STEPS_END > STEP_TABLES
#error "STEP_TABLES is too small"
#endif

// Of the cell before sample `i` of a block, whose first sample is one before `origin`; of the nearest cell if there is none. `lengths`:
// of the cells along the axis, one fewer than `samples`.
INLINED float step_before(__global const float *lengths, uint samples, int origin, uint i) {
    return lengths[clamp(origin + (int)i - 2, 0, (int)samples - 2)];
}

// Phase: fills the tables of a block around `origin`.
INLINED void load_step_tables(Grid grid, LENGTHS int3 origin, __local float *tables) {
    const uint nx = grid.dims[0], ny = grid.dims[1], nz = grid.dims[2], lid = get_local_id(0);
    __global const float *along_y = inverse_lengths + (nx - 1), *along_z = along_y + (ny - 1);
    ROLLED for (uint i = lid; i < STEPS_Y - STEPS_X; i += BRICK_GROUP)
        tables[STEPS_X + i] = step_before(inverse_lengths, nx, origin.x, i % BLOCK_ROW);
    ROLLED for (uint i = lid; i < STEPS_Z - STEPS_Y; i += BRICK_GROUP)
        tables[STEPS_Y + i] = step_before(along_y, ny, origin.y, i / BLOCK_ROW);
    ROLLED for (uint i = lid; i < STEPS_END - STEPS_Z; i += BRICK_GROUP) tables[STEPS_Z + i] = step_before(along_z, nz, origin.z, i);
}

INLINED void set_step(AxisStep *step, real before, real after) {
    step->before = before;
    step->after = after;
    step->inverse_sum = 1.0f / (before + after);
}

// Of sample `in_plane` of a plane of a block and those behind it. By address, not as a result: Oclgrind fails on that here
// (llvm.experimental.noalias.scope.decl).
INLINED void load_steps(Steps *steps, Grid grid, __local const float *tables, uint plane, uint in_plane) {
    (void)grid;
    __local const float *x = tables + STEPS_X + in_plane % BLOCK_ROW, *y = tables + STEPS_Y + in_plane, *z = tables + STEPS_Z + plane;
    set_step(&steps->x, LOAD_LANES(x), LOAD_LANES(x + 1));
    set_step(&steps->y, LOAD_LANES(y), LOAD_LANES(y + BLOCK_ROW));
    set_step(&steps->z, (real)z[0], (real)z[1]);
}

// One over the length of the smallest cell beside the samples.
INLINED Resolution resolution(Steps steps) {
    const real x = fmax(steps.x.before, steps.x.after), y = fmax(steps.y.before, steps.y.after);
    return fmax(x, fmax(y, fmax(steps.z.before, steps.z.after)));
}

// That of the parabola through the three samples: exact for squares.
INLINED real first_derivative(real below, real here, real above, AxisStep step) {
    const real of_after = step.after * (step.after * step.inverse_sum), of_before = step.before * (step.before * step.inverse_sum);
    return of_after * (above - here) + of_before * (here - below);
}

INLINED real second_derivative(real below, real here, real above, AxisStep step) {
    const real per = 2.0f * step.before * (step.after * step.inverse_sum);
    return ((above - here) * step.after - (here - below) * step.before) * per;
}

// First along one axis, whose neighbours are `a` samples away, then along another.
INLINED real mixed_derivative(__local const float *at, int a, AxisStep step_a, int b, AxisStep step_b) {
    real rows[3];
    for (int i = 0; i < 3; i++) {
        __local const float *row = at + (i - 1) * b;
        rows[i] = first_derivative(LOAD_LANES(row - a), LOAD_LANES(row), LOAD_LANES(row + a), step_a);
    }
    return first_derivative(rows[0], rows[1], rows[2], step_b);
}

// As gradient_at: one-sided beside a missing sample, 0 if both are missing.
INLINED real usable_derivative(real below, real here, real above, AxisStep step) {
    const integer has_below = below == below, has_above = above == above;
    const real one_sided = PICK(has_above, (above - here) * step.after, PICK(has_below, (here - below) * step.before, 0.0f));
    const real d = PICK(has_below & has_above, first_derivative(below, here, above, step), one_sided);
    return PICK(d == d, d, 0.0f);
}

#else

#define LENGTHS
#define LENGTHS_ARGS

// One over the spacing.
typedef float AxisStep;
typedef float3 Steps;
typedef float Resolution;

INLINED void load_step_tables(Grid grid, int3 origin, __local float *tables) { (void)grid, (void)origin, (void)tables; }

INLINED void load_steps(Steps *steps, Grid grid, __local const float *tables, uint plane, uint in_plane) {
    (void)tables, (void)plane, (void)in_plane;
    *steps = 1.0f / (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
}

INLINED Resolution resolution(Steps steps) { return fmax(steps.x, fmax(steps.y, steps.z)); }

INLINED real first_derivative(real below, real here, real above, AxisStep per) {
    (void)here;
    return (above - below) * (0.5f * per);
}

INLINED real second_derivative(real below, real here, real above, AxisStep per) {
    return ((above - here) - (here - below)) * (per * per);
}

// Along two axes, whose neighbours are `a` and `b` samples away.
INLINED real mixed_derivative(__local const float *at, int a, AxisStep per_a, int b, AxisStep per_b) {
    const real across = (LOAD_LANES(at + b + a) - LOAD_LANES(at + b - a)) - (LOAD_LANES(at - b + a) - LOAD_LANES(at - b - a));
    return across * (0.25f * per_a * per_b);
}

// As gradient_at, one-sided beside a missing sample, but multiplied by one over the spacing.
INLINED real usable_derivative(real below, real here, real above, AxisStep per) {
    const integer has_below = below == below, has_above = above == above;
    const real d = (PICK(has_above, above, here) - PICK(has_below, below, here)) * PICK(has_below & has_above, 0.5f * per, per);
    return PICK(d == d, d, 0.0f);
}

#endif

#endif
