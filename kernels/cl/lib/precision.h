// Floating-point rules: no contraction of products and sums unless a function allows it, so that results do not depend on the
// compiler. Every file that computes includes this one first.
#ifndef ISOPEEL_PRECISION_H
#define ISOPEEL_PRECISION_H

#pragma OPENCL FP_CONTRACT OFF

// a / b as IEEE 754 rounds it, which some devices do not: an importance that equals the threshold must not tip over it, and a
// plane must come out flat. One step of correction; where that leaves the range of a float, the plain quotient, as on a CPU.
inline float exact_quotient(float a, float b) {
#if BRICK_GROUP == 1
    return a / b;
#endif
    const float plain = a / b, corrected = fma(fma(-plain, b, a), 1.0f / b, plain);
    return isfinite(corrected) ? corrected : plain;
}

#endif
