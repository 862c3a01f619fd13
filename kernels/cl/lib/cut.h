// A cut: the nodes of the pyramid and which of them are leaves.
#ifndef ISOPEEL_CUT_H
#define ISOPEEL_CUT_H

#include "lib/layout.h"

typedef struct {
    __global const uint *region_index; // compact index of each region of the volume, or NONE
    __global const Region *regions;
    __global const Brick *bricks;
    __global const Node *nodes;
    __global const uchar *state; // of each slot: level of the leaf that stands for it, or INTERNAL
} Cut;

#endif
