// CPU: one work-item processes a whole brick (BRICK_GROUP == 1), 16 cells at a time in vector registers (LANES == 16). Chosen
// in lib/device.h; lib/device_gpu.h defines the same names.
#ifndef ISOPEEL_DEVICE_CPU_H
#define ISOPEEL_DEVICE_CPU_H

// A function that must be inlined: a call would copy its large arguments, `grid` first of all.
#define INLINED inline __attribute__((always_inline))

// Before a loop: no hint about unrolling.
#define ROLLED

// Waits until all work-items of a brick's group have come here. On a CPU the group is one work-item, which sees its own writes in program
// order. Not left to the compiler: PoCL cuts a kernel at each barrier and keeps what is alive across it in memory, and PoCL 6.0 compiles
// `construct` wrongly if it is cut. Kernels that work on a region keep their barriers: without them PoCL 7.1 compiles cuts of the tree
// wrongly.
#define brick_barrier(fences)

// Adds to a counter that the work-items of a group share; its value is the one before.
inline uint add_local(__local uint *counter, uint value) {
    const uint before = *counter;
    *counter += value;
    return before;
}
inline void add_local_float(__local float *sum, float value) { *sum += value; }
inline void max_global(__global uint *to, uint value) { *to = max(*to, value); }
inline uint add_global(__global uint *counter, uint value) {
    const uint before = *counter;
    *counter += value;
    return before;
}

inline uint or_local(__local uint *bits, uint more) {
    const uint before = *bits;
    *bits |= more;
    return before;
}
inline uint or_global(__global uint *bits, uint more) {
    const uint before = *bits;
    *bits |= more;
    return before;
}
inline void min_global(__global uint *to, uint value) { *to = min(*to, value); }
// Replaces `expected` by `value`; returns what was there. Of memory that no other work-group uses at the time.
inline uint claim_global(__global uint *at, uint expected, uint value) {
    const uint found = *at;
    if (found == expected) *at = value;
    return found;
}

// Loads the memory at an address into the caches, for later. PREFETCHES is set if the compiler is known to take the intrinsic
// (kernels/src/tuning.rs): Mesa's refuses it, and PoCL 7.1 (LLVM 21) compiles loops around it wrongly. OpenCL's own `prefetch` is
// nothing in PoCL.
#if PREFETCHES
INLINED void prefetch_line(__global const void *at) { __builtin_prefetch((const void *)(ulong)at, 0, 2); }
#else
INLINED void prefetch_line(__global const void *at) { (void)at; }
#endif

// Cells of a level-1 cube are summed as they are solved if only the smoothness of the cells is needed.
#define SUM_WHILE_SOLVING 1
// Work-items that share the sums of one level-1 cube.
#define WORK_ITEMS_A_SUM 1

// a / b rounded as IEEE 754 demands: a CPU's division is.
inline float exact_quotient(float a, float b) { return a / b; }

// LANES floats, integers and bit masks. Loads and stores are macros because OpenCL C 1.2 has no pointer to any address space.
typedef float16 real;
typedef int16 integer;
typedef uint16 mask_lanes;
#define LOAD_LANES(from) vload16(0, from)
#define LOAD_MASK(from) vload16(0, from)
#define STORE_LANES(value, to) vstore16(value, 0, to)
#define LOAD_SAMPLES(from) convert_float16(vload16(0, from))
#define FIRST_LANE(value) (value).s0
#define LANE_INDEX ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#define AS_INT(value) as_int16(value)
#define AS_REAL(value) as_float16(value)
#define TO_REAL(value) convert_float16(value)
#define TO_INTEGER(value) convert_int16(value)
// `yes` if the condition holds, else `no`. A macro because the condition is an integer vector here and a bool on a GPU.
#define PICK(condition, yes, no) select((real)(no), (real)(yes), condition)

// Transposes LANES vectors of four, which follow one another in `a` to `d`, to one vector a component.
inline void transpose_vec4s(int16 a, int16 b, int16 c, int16 d, integer *x, integer *y, integer *z, integer *w) {
    *x = (int16)(a.even.even, b.even.even, c.even.even, d.even.even);
    *y = (int16)(a.odd.even, b.odd.even, c.odd.even, d.odd.even);
    *z = (int16)(a.even.odd, b.even.odd, c.even.odd, d.even.odd);
    *w = (int16)(a.odd.odd, b.odd.odd, c.odd.odd, d.odd.odd);
}

// Loads LANES int4, and LANES short4, to one vector a component.
inline void load_vec4s(const int4 *from, integer *x, integer *y, integer *z, integer *w) {
    const int *numbers = (const int *)from;
    transpose_vec4s(vload16(0, numbers), vload16(1, numbers), vload16(2, numbers), vload16(3, numbers), x, y, z, w);
}
inline void load_short4s(const short4 *from, integer *x, integer *y, integer *z, integer *w) {
    const short *numbers = (const short *)from;
    transpose_vec4s(convert_int16(vload16(0, numbers)), convert_int16(vload16(1, numbers)), convert_int16(vload16(2, numbers)),
                    convert_int16(vload16(3, numbers)), x, y, z, w);
}

// Transposes one vector a component to LANES float4.
inline void store_vec4s(real x, real y, real z, real w, float4 *to) {
    float16 xz, yw, low, high;
    float *numbers = (float *)to;
    xz.even = x.lo, xz.odd = z.lo, yw.even = y.lo, yw.odd = w.lo;
    low.even = xz.lo, low.odd = yw.lo, high.even = xz.hi, high.odd = yw.hi;
    vstore16(low, 0, numbers);
    vstore16(high, 1, numbers);
    xz.even = x.hi, xz.odd = z.hi, yw.even = y.hi, yw.odd = w.hi;
    low.even = xz.lo, low.odd = yw.lo, high.even = xz.hi, high.odd = yw.hi;
    vstore16(low, 2, numbers);
    vstore16(high, 3, numbers);
}

// Whether the condition holds in any lane.
inline bool any_lane(int16 condition) {
    const int8 eight = condition.lo | condition.hi;
    const int4 four = eight.lo | eight.hi;
    const int2 two = four.lo | four.hi;
    return (two.x | two.y) != 0;
}
// a / b, as exact_quotient.
#define EXACT_QUOTIENT(a, b) ((a) / (b))

// In each quarter of two vectors: their low or high numbers, one of each in turn; the same of pairs.
inline float16 interleave_low(float16 a, float16 b) {
    return (float16)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5, a.s8, b.s8, a.s9, b.s9, a.sc, b.sc, a.sd, b.sd);
}
inline float16 interleave_high(float16 a, float16 b) {
    return (float16)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7, a.sa, b.sa, a.sb, b.sb, a.se, b.se, a.sf, b.sf);
}
inline float16 interleave_low_pairs(float16 a, float16 b) {
    return (float16)(a.s01, b.s01, a.s45, b.s45, a.s89, b.s89, a.scd, b.scd);
}
inline float16 interleave_high_pairs(float16 a, float16 b) {
    return (float16)(a.s23, b.s23, a.s67, b.s67, a.sab, b.sab, a.sef, b.sef);
}

// Loads a structure of 16 numbers for each lane, from the LANES indices `at` on: one vector a number. A 16 x 16 transpose: within
// quarters of vectors, then of the quarters.
inline void load_rows16(__global const float *from, const uint *at, real *rows) {
    real x[16], y[16];
    for (uint i = 0; i < 16; i++) x[i] = vload16(at[i], from);
    for (uint i = 0; i < 16; i += 4) {
        const real low = interleave_low(x[i], x[i + 1]), high = interleave_high(x[i], x[i + 1]);
        const real next_low = interleave_low(x[i + 2], x[i + 3]), next_high = interleave_high(x[i + 2], x[i + 3]);
        y[i] = interleave_low_pairs(low, next_low);
        y[i + 1] = interleave_high_pairs(low, next_low);
        y[i + 2] = interleave_low_pairs(high, next_high);
        y[i + 3] = interleave_high_pairs(high, next_high);
    }
    for (uint i = 0; i < 4; i++) {
        const real a = (float16)(y[i].lo, y[i + 4].lo), b = (float16)(y[i].hi, y[i + 4].hi);
        const real c = (float16)(y[i + 8].lo, y[i + 12].lo), d = (float16)(y[i + 8].hi, y[i + 12].hi);
        rows[i] = (float16)(a.s0123, a.s89ab, c.s0123, c.s89ab);
        rows[i + 4] = (float16)(a.s4567, a.scdef, c.s4567, c.scdef);
        rows[i + 8] = (float16)(b.s0123, b.s89ab, d.s0123, d.s89ab);
        rows[i + 12] = (float16)(b.s4567, b.scdef, d.s4567, d.scdef);
    }
}

// How many of `a_count` values are among `b_count` others, which differ from each other. None is NONE; up to 15 numbers behind `b` are read.
inline uint count_common(__global const uint *a, uint a_count, __global const uint *b, uint b_count) {
    const int16 lane = LANE_INDEX;
    int16 found = 0;
    for (uint first = 0; first < b_count; first += 16) {
        const int16 others = select(as_int16(vload16(0, b + first)), (int16)(-1), lane >= (int)(b_count - first));
        for (uint i = 0; i < a_count; i++) found -= others == (int)a[i];
    }
    const int8 eight = found.lo + found.hi;
    const int4 four = eight.lo + eight.hi;
    return (uint)(four.x + four.y + four.z + four.w);
}

// A number that other work-items of the group write or read meanwhile.
inline uint read_shared(__global const uint *at) { return *at; }
inline void write_shared(__global uint *at, uint value) { *at = value; }

// The minimum of 16 numbers.
inline uint minimum_lane(uint16 lanes) {
    const uint8 eight = min(lanes.lo, lanes.hi);
    const uint4 four = min(eight.lo, eight.hi);
    const uint2 two = min(four.lo, four.hi);
    return min(two.x, two.y);
}

// Index of the first byte of 16 that is not 0; one of them is not.
inline uint first_byte(ulong2 bytes) {
    const ulong eight = bytes.x ? bytes.x : bytes.y;
    return (bytes.x ? 0u : 8u) + ((63u - (uint)clz(eight & -eight)) >> 3);
}

// Index of the first of these numbers that is `value`, which one of them is; up to 15 numbers behind that are read.
inline uint index_of(__global const uint *numbers, uint value) {
    for (uint first = 0;; first += 16) {
        const ulong2 found = as_ulong2(convert_char16(vload16(0, numbers + first) == value));
        if (found.x | found.y) return first + first_byte(found);
    }
}

// Index of the minimum of `count` numbers; NONE if none is below `end`, AMBIGUOUS if it may not be the only one. Up to 15 numbers behind
// them are read.
#define AMBIGUOUS (UINT_MAX - 1)
inline uint index_of_minimum(__global const uint *numbers, uint count, uint end) {
    if (count > 16) return AMBIGUOUS;
    const uint16 lane = (uint16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const uint16 all = select(vload16(0, numbers), (uint16)(UINT_MAX), lane >= count);
    const uint minimum = minimum_lane(all);
    if (minimum >= end) return UINT_MAX;
    const ulong2 found = as_ulong2(convert_char16(all == minimum));
    return popcount(found.x) + popcount(found.y) == 8 ? first_byte(found) : AMBIGUOUS;
}

// Next free column of a batch of LANES columns.
#define NEXT_COLUMN(batch) ((batch)->count++)
// Columns beyond LANES, for what is collected before a batch is emptied.
#define MORE_COLUMNS 8

// Cells of ROWS_AT_ONCE rows of eight that one work-item looks at side by side, a bit each, a byte a row.
#define ROWS_AT_ONCE 8
typedef ulong cell_bits;
// Eight bits from `shift` on of each row.
inline cell_bits load_cell_rows(__local const ushort *rows, uint shift) { return as_ulong(convert_uchar8(vload8(0, rows) >> (ushort)shift)); }
inline void store_cell_rows(__local uchar *rows, cell_bits bits) { vstore8(as_uchar8(bits), 0, rows); }

// Storage of relaxation for the cells of a brick, as arrays of structures: what one work-item reads together lies together.
// Positions are ushort4: x, y, z and the index of the cell's sum, NO_SUM for cells of several sheets. Offsets are int4; those of
// index NO_SUM are written but never read.
#define NO_SUM 512 // index of the sum that belongs to no cell: a brick has 512 cells
#define POSITIONS_CAPACITY 2048
#define OFFSET_SUMS_CAPACITY (4 * (NO_SUM + 1))
inline int4 load_position(__local const ushort *positions, __local const uint *multi_sheet_mask, uint cell) {
    (void)multi_sheet_mask;
    return convert_int4(vload4(cell, positions));
}
inline void store_position(__local ushort *positions, uint cell, ushort4 position) {
    ((__local ushort4 *)positions)[cell] = position;
}
inline int4 load_offset_sum(__local const int *sums, uint cell) { return vload4(cell, sums); }
inline void clear_offset_sum(__local int *sums, uint cell) { vstore4((int4)(0), cell, sums); }
inline void add_offset(__local int *sums, uint cell, int4 offset) { vstore4(vload4(cell, sums) + offset, cell, sums); }

#endif
