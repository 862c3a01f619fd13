// What differs between a CPU, which runs a brick in one work-item, and a GPU, which runs it in BRICK_GROUP of them.
#ifndef ISOPEEL_DEVICE_H
#define ISOPEEL_DEVICE_H

// A function whose call on a CPU would wait for copies of its arguments, of `grid` first of all. Compilers for a GPU inline anyway.
#if BRICK_GROUP == 1
#define INLINED inline __attribute__((always_inline))
#else
#define INLINED inline
#endif

// Before a loop that a work-item of many goes through once or twice: unrolled, it would only push the rest of a large kernel out
// of a GPU's cache of instructions.
#if BRICK_GROUP == 1
#define ROLLED
#else
#define ROLLED _Pragma("unroll 1")
#endif

// Adds to a number that the work-items of a brick share, and answers what it was before.
#if BRICK_GROUP == 1
#define ADD_LOCAL(to, value) ((*(to) += (value)) - (value))
#else
#define ADD_LOCAL(to, value) atomic_add(to, value)
#endif

#endif
