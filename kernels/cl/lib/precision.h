// Floating-point rules of every kernel. Every file that computes with floats includes this one first.
//
// Products and sums are not contracted to fused multiply-adds, so that results do not depend on the compiler: comparisons with
// the isovalue and positions that two regions share must be bit-identical everywhere. Functions whose results only place
// vertices allow contraction for themselves, by the same pragma at the start of their body.
#ifndef ISOPEEL_PRECISION_H
#define ISOPEEL_PRECISION_H

#pragma OPENCL FP_CONTRACT OFF

#endif
