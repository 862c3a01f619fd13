// Vectors of LANES numbers: a CPU device works on LANES cells in one work-item's vector registers, without a branch, a GPU on one.
#ifndef ISOPEEL_LANES_H
#define ISOPEEL_LANES_H

#include "lib/precision.h"

#if LANES == 1
typedef float real;
typedef int integer;
#define LOAD_LANES(from) (*(from))
#define STORE_LANES(value, to) (*(to) = (value))
#define PICK(condition, yes, no) ((condition) ? (yes) : (no))
#define LOAD_SAMPLES(from) ((float)*(from))
#define FIRST_LANE(value) (value)
#define AS_INT(value) as_int(value)
#define AS_REAL(value) as_float(value)
#define TO_REAL(value) (float)(value)
#else
typedef float16 real;
typedef int16 integer;
#define LOAD_LANES(from) vload16(0, from)
#define STORE_LANES(value, to) vstore16(value, 0, to)
#define PICK(condition, yes, no) select((real)(no), (real)(yes), condition)
#define LOAD_SAMPLES(from) convert_float16(vload16(0, from))
#define FIRST_LANE(value) (value).s0
#define AS_INT(value) as_int16(value)
#define AS_REAL(value) as_float16(value)
#define TO_REAL(value) convert_float16(value)
#endif

// The numbers of LANES fours that follow one another, by their place in the four.
inline void load_vec4s(const int4 *of, integer *x, integer *y, integer *z, integer *w) {
#if LANES == 1
    *x = of->x;
    *y = of->y;
    *z = of->z;
    *w = of->w;
#else
    const int16 a = vload16(0, (const int *)of), b = vload16(1, (const int *)of);
    const int16 c = vload16(2, (const int *)of), d = vload16(3, (const int *)of);
    *x = (int16)(a.even.even, b.even.even, c.even.even, d.even.even);
    *y = (int16)(a.odd.even, b.odd.even, c.odd.even, d.odd.even);
    *z = (int16)(a.even.odd, b.even.odd, c.even.odd, d.even.odd);
    *w = (int16)(a.odd.odd, b.odd.odd, c.odd.odd, d.odd.odd);
#endif
}

// Batches of LANES columns: a column of a lone lane is known when the program is built, which keeps the batch in registers.
#if LANES == 1
#define NEXT_COLUMN(batch) ((batch)->count = 1, 0)
#else
#define NEXT_COLUMN(batch) ((batch)->count++)
#endif

#if LANES == 1
typedef uint mask_lanes;
#define LOAD_MASK(from) (*(from))
#else
typedef uint16 mask_lanes;
#define LOAD_MASK(from) vload16(0, from)
#endif

#endif
