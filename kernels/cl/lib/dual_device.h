// What dual does differently on a CPU, which works on a brick with one work-item, and on a GPU. The one place that chooses.
#ifndef ISOPEEL_DUAL_DEVICE_H
#define ISOPEEL_DUAL_DEVICE_H

// Everything that the two files include: an include in the file that is not chosen would be lost to later ones.
#include "lib/batch.h"
#include "lib/bits.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/emit_polygons.h"
#include "lib/ghosts.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/vertices.h"

#if BRICK_GROUP == 1
#include "lib/dual_cpu.h"
#else
#include "lib/dual_gpu.h"
#endif

#endif
