// What construct does differently on a CPU, which works on a brick with one work-item, and on a GPU. The one place that chooses.
#ifndef ISOPEEL_CONSTRUCT_DEVICE_H
#define ISOPEEL_CONSTRUCT_DEVICE_H

// Everything that the two files include: an include in the file that is not chosen would be lost to later ones.
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

#if BRICK_GROUP == 1
#include "lib/construct_cpu.h"
#else
#include "lib/construct_gpu.h"
#endif

#endif
