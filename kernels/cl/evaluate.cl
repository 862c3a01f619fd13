// evaluate: a field computed by an expression over other fields. The expression is a list of operations, which each work-item interprets for
// LANES samples at a time: one program serves all expressions, so that no expression is compiled. In: the operations as pairs of words
// (src/expression.rs), the samples of up to eight fields of any types. Out: floats, NaN if a field is missing or the value is not finite.
// For fields that the expression does not use, the host passes the first one; they are not read.

#include "lib/precision.h"
#include "lib/any_samples.h"
#include "lib/args.h"
#include "lib/constants.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/operations.h"

#define LOAD_FIELD(i)                                                                                                  \
    if (i < args.fields) {                                                                                             \
        const real v = load_any(field_##i, args.type_##i, at, end);                                                   \
        field[i] = PICK(v == args.missing_##i, NAN, v);                                                                \
        known = known & (field[i] == field[i]);                                                                        \
    }

// `count` samples from the one of number LAUNCH_BLOCK * `first` on.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void evaluate(const EvaluateArgs args, __global const uint2 *operations, __global const void *field_0, __global const void *field_1,
              __global const void *field_2, __global const void *field_3, __global const void *field_4, __global const void *field_5,
              __global const void *field_6, __global const void *field_7, __global float *out) {
    const ulong begin = (ulong)args.first * LAUNCH_BLOCK, end = begin + args.count, at = begin + (ulong)get_global_id(0) * LANES;
    if (at >= end) return;
    real field[EXPRESSION_FIELDS], results[EXPRESSION_OPERATIONS], value = 0.0f;
    integer known = value == value;
    LOAD_FIELD(0)
    LOAD_FIELD(1)
    LOAD_FIELD(2)
    LOAD_FIELD(3)
    LOAD_FIELD(4)
    LOAD_FIELD(5)
    LOAD_FIELD(6)
    LOAD_FIELD(7)
    results[0] = value;
    for (uint i = 0; i < args.operations; i++) {
        const uint2 operation = operations[i];
        const uint a = operation.x >> 8 & 255u, b = operation.x >> 16 & 255u, c = operation.x >> 24;
        const real x = results[a], y = results[b];
        switch (operation.x & 255u) {
            case OPERATION_NUMBER: value = (real)(as_float(operation.y)); break;
            case OPERATION_FIELD: value = field[operation.y]; break;
            case OPERATION_AND: value = x * y; break;
            case OPERATION_OR: value = fmax(x, y); break;
            case OPERATION_NOT: value = 1.0f - x; break;
            case OPERATION_SELECT: value = PICK(results[c] != 0.0f, x, y); break;
            OPERATION_CASES
        }
        results[i] = value;
    }
    value = PICK(known & isfinite(value), value, NAN);
    if (at + LANES <= end) {
        STORE_LANES(value, out + at);
        return;
    }
    float last[LANES];
    STORE_LANES(value, last);
    for (uint i = 0; at + i < end; i++) out[at + i] = last[i];
}
