// evaluate: a field that an expression over others gives, sample by sample. One work-item a sample. Built for each expression: EXPRESSION are
// its statements (src/expression.rs), which make the float `value` of the floats f0, f1, …, and FIELD_0, … the types of the fields' samples.
// Fields that it has not stand for the first one, and are not read.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/layout.h"

#ifndef EXPRESSION
#define EXPRESSION const float value = f0;
#define FIELD_0 float
#define FIELD_1 float
#define FIELD_2 float
#define FIELD_3 float
#define FIELD_4 float
#define FIELD_5 float
#define FIELD_6 float
#define FIELD_7 float
#define FIELDS 1
#endif

// A sample, NaN where it is missing.
inline float known_sample(float v, float missing) { return v == missing ? NAN : v; }

#define LOAD_FIELD(i) (i < FIELDS ? known_sample((float)field_##i[at], args.missing_##i) : 0.0f)

// `planes` planes from `first` on, of a slab whose first plane is `z0`.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void evaluate(const EvaluateArgs args, __global const FIELD_0 *field_0, __global const FIELD_1 *field_1, __global const FIELD_2 *field_2,
              __global const FIELD_3 *field_3, __global const FIELD_4 *field_4, __global const FIELD_5 *field_5,
              __global const FIELD_6 *field_6, __global const FIELD_7 *field_7, __global float *out) {
    const ulong item = get_global_id(0), plane = (ulong)args.grid.dims[0] * args.grid.dims[1];
    if (item >= plane * args.planes) return;
    const ulong at = plane * (args.first - args.z0) + item;
    const float f0 = LOAD_FIELD(0), f1 = LOAD_FIELD(1), f2 = LOAD_FIELD(2), f3 = LOAD_FIELD(3);
    const float f4 = LOAD_FIELD(4), f5 = LOAD_FIELD(5), f6 = LOAD_FIELD(6), f7 = LOAD_FIELD(7);
    const bool is_known = !isnan(f0) && !isnan(f1) && !isnan(f2) && !isnan(f3) && !isnan(f4) && !isnan(f5) && !isnan(f6) && !isnan(f7);
    EXPRESSION
    out[at] = is_known && isfinite(value) ? value : NAN;
}
