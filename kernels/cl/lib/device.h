// What differs between a CPU and a GPU, chosen here and nowhere else: both files define the same names. Neither includes others.
#ifndef ISOPEEL_DEVICE_H
#define ISOPEEL_DEVICE_H

#if BRICK_GROUP == 1
#include "lib/device_cpu.h"
#else
#include "lib/device_gpu.h"
#endif

#endif
