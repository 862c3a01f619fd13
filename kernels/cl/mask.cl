// mask: a field whose samples are missing if their label, a sample of another field, is not in the mask. A work-item takes LANES samples.
// In: samples and labels of any types, ranges of labels. Out: samples of a type that has the value of missing ones.

#include "lib/precision.h"
#include "lib/any_samples.h"
#include "lib/args.h"
#include "lib/constants.h"
#include "lib/device.h"
#include "lib/layout.h"

// `count` samples from the one of number LAUNCH_BLOCK * `first` on.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void mask(const MaskArgs args, __global const void *samples, __global const void *labels, __global const float2 *ranges, __global void *out) {
    const ulong begin = (ulong)args.first * LAUNCH_BLOCK, end = begin + args.count, at = begin + (ulong)get_global_id(0) * LANES;
    if (at >= end) return;
    const real value = load_any(samples, args.samples_type, at, end), label = load_any(labels, args.labels_type, at, end);
    integer is_inside = label != label;
    for (uint i = 0; i < args.ranges; i++) is_inside = is_inside | ((label >= ranges[i].x) & (label <= ranges[i].y));
    if (args.is_complement) is_inside = !is_inside;
    // A label that is missing is outside.
    is_inside = is_inside & (label == label) & (label != args.missing_label);
    store_any(PICK(is_inside, value, args.missing), out, args.out_type, at, end);
}
