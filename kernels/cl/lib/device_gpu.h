// GPU: BRICK_GROUP work-items share a brick, each processes one cell at a time (LANES == 1). Chosen in lib/device.h;
// lib/device_cpu.h defines the same names.
#ifndef ISOPEEL_DEVICE_GPU_H
#define ISOPEEL_DEVICE_GPU_H

// Intel's compiler for processors makes vectors of work-items, and compiles some of these kernels wrongly then. A length of 1 forbids it.
#ifdef cl_intel_vec_len_hint
#define __kernel __kernel __attribute__((intel_vec_len_hint(1)))
#endif

// A function that must be inlined: a GPU's compiler does so anyway.
#define INLINED inline

// Before a loop that a work-item passes once or twice: unrolled, it would push a large kernel out of the instruction cache.
#define ROLLED _Pragma("unroll 1")

// Waits until all work-items of a brick's group have come here.
#define brick_barrier(fences) barrier(fences)

// Adds to a counter that the work-items of a group share; its value is the one before.
inline uint add_local(__local uint *counter, uint value) { return atomic_add(counter, value); }
// OpenCL C 1.2 has no atomic addition of floats.
inline void add_local_float(__local float *sum, float value) {
    volatile __local uint *bits = (volatile __local uint *)sum;
    uint before = *bits, found;
    while ((found = atomic_cmpxchg(bits, before, as_uint(as_float(before) + value))) != before) before = found;
}
inline void max_global(__global uint *to, uint value) { atomic_max(to, value); }
inline uint add_global(__global uint *counter, uint value) { return atomic_add(counter, value); }

inline uint or_local(__local uint *bits, uint more) { return atomic_or(bits, more); }
inline uint or_global(__global uint *bits, uint more) { return atomic_or(bits, more); }
inline void min_global(__global uint *to, uint value) { atomic_min(to, value); }
// A number that other work-items of the group write or read meanwhile.
inline uint read_shared(__global uint *at) { return atomic_or(at, 0u); }
inline void write_shared(__global uint *at, uint value) { atomic_xchg(at, value); }
// Replaces `expected` by `value`; returns what was there. Of memory that no other work-group uses at the time.
inline uint claim_global(__global uint *at, uint expected, uint value) { return atomic_cmpxchg(at, expected, value); }

// Work-groups run side by side, so that one waits while others work.
INLINED void prefetch_line(__global const void *at) { (void)at; }

// Cells of a level-1 cube are summed after all have been solved, by other work-items.
#define SUM_WHILE_SOLVING 0
// Work-items that share the sums of one level-1 cube.
#define WORK_ITEMS_A_SUM 4

// a / b rounded as IEEE 754 demands, which not every device does: an importance equal to the threshold must not exceed it, and
// a plane must come out flat. One step of correction; if that leaves the range of a float, the plain quotient.
inline float exact_quotient(float a, float b) {
    const float plain = a / b, corrected = fma(fma(-plain, b, a), 1.0f / b, plain);
    return isfinite(corrected) ? corrected : plain;
}

// LANES floats, integers and bit masks. Loads and stores are macros because OpenCL C 1.2 has no pointer to any address space.
typedef float real;
typedef int integer;
typedef uint mask_lanes;
#define LOAD_LANES(from) (*(from))
#define LOAD_MASK(from) (*(from))
#define STORE_LANES(value, to) (*(to) = (value))
#define LOAD_SAMPLES(from) ((float)*(from))
#define FIRST_LANE(value) (value)
#define AS_INT(value) as_int(value)
#define AS_REAL(value) as_float(value)
#define TO_REAL(value) (float)(value)
#define TO_INTEGER(value) (int)(value)
// `yes` if the condition holds, else `no`. A macro because the condition is a bool here and an integer vector on a CPU.
#define PICK(condition, yes, no) ((condition) ? (yes) : (no))

// Transposes LANES int4 from an array of structures to one vector a component.
inline void load_vec4s(const int4 *from, integer *x, integer *y, integer *z, integer *w) {
    *x = from->x;
    *y = from->y;
    *z = from->z;
    *w = from->w;
}

// Whether the condition holds in any lane.
inline bool any_lane(int condition) { return condition != 0; }
// a / b, as exact_quotient.
#define EXACT_QUOTIENT(a, b) exact_quotient(a, b)

// Loads a structure of 16 numbers for each lane, from the LANES indices `at` on.
inline void load_rows16(__global const float *from, const uint *at, real *rows) {
    for (uint i = 0; i < 16; i++) rows[i] = from[16 * (ulong)at[0] + i];
}

// How many of `a_count` values are among `b_count` others, which differ from each other.
inline uint count_common(__global const uint *a, uint a_count, __global const uint *b, uint b_count) {
    uint found = 0;
    for (uint i = 0; i < a_count; i++)
        for (uint k = 0; k < b_count; k++) found += a[i] == b[k];
    return found;
}

// Index of the first of these numbers that is `value`, which one of them is.
inline uint index_of(__global const uint *numbers, uint value) {
    uint i = 0;
    while (numbers[i] != value) i++;
    return i;
}

// On a CPU the index of the minimum of `count` numbers.
#define AMBIGUOUS (UINT_MAX - 1)
inline uint index_of_minimum(__global const uint *numbers, uint count, uint end) {
    (void)numbers, (void)count, (void)end;
    return AMBIGUOUS;
}

// Next free column of a batch of LANES columns: of the only one, known to the compiler, which keeps the batch in registers.
#define NEXT_COLUMN(batch) ((batch)->count = 1, 0)
#define MORE_COLUMNS 0

// Cells of ROWS_AT_ONCE rows of eight that one work-item looks at side by side, a bit each, a byte a row.
#define ROWS_AT_ONCE 1
typedef uint cell_bits;
// Eight bits from `shift` on of each row.
inline cell_bits load_cell_rows(__local const ushort *rows, uint shift) { return *rows >> shift & 0xffu; }
inline void store_cell_rows(__local uchar *rows, cell_bits bits) { *rows = (uchar)bits; }

// Storage of relaxation for the cells of a brick, as structures of arrays: neighbouring work-items read neighbouring numbers.
// Positions are x, y, z; offsets two in a word of 32 bits, x and y, z and length, for fewer atomic operations.
#define NO_SUM 512 // index of the sum that belongs to no cell: a brick has 512 cells
#define POSITIONS_CAPACITY 1536
#define OFFSET_SUMS_CAPACITY 1024
// In w: the index of the cell's sum, NO_SUM for cells of several sheets.
inline int4 load_position(__local const ushort *positions, __local const uint *multi_sheet_mask, uint cell) {
    const bool multi_sheet = multi_sheet_mask[cell >> 5] >> (cell & 31) & 1u;
    return (int4)(positions[cell], positions[512 + cell], positions[1024 + cell], multi_sheet ? NO_SUM : cell);
}
inline void store_position(__local ushort *positions, uint cell, ushort4 position) {
    positions[cell] = position.x;
    positions[512 + cell] = position.y;
    positions[1024 + cell] = position.z;
}
inline int4 load_offset_sum(__local const int *sums, uint cell) {
    const int2 packed = (int2)(sums[cell], sums[512 + cell]), low = convert_int2(as_short4(packed).xz);
    const int2 high = (packed - low) >> 16; // a low half below 0 has taken one from the high one
    return (int4)(low.x, high.x, low.y, high.y);
}
inline void clear_offset_sum(__local int *sums, uint cell) { sums[cell] = sums[512 + cell] = 0; }
inline void add_offset(__local int *sums, uint cell, int4 offset) {
    if (cell == NO_SUM) return;
    atomic_add(&sums[cell], offset.y * 65536 + offset.x);
    atomic_add(&sums[512 + cell], offset.w * 65536 + offset.z);
}

#endif
