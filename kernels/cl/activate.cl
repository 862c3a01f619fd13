// activate: which bricks an isovalue touches (docs/algorithm.md#10-memory-layout-on-the-device).
// In: minimum and maximum of every brick. Out: 64 bits a region, bricks in Morton order. One work-group a region, one work-item a
// brick.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void activate(const float iso, __global const float2 *table, __global uint *masks) {
    __local uint mask[2];
    const uint lid = get_local_id(0);
    if (lid < 2) mask[lid] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    const float2 range = table[get_global_id(0)];
    if (range.x < iso && range.y >= iso) atomic_or(&mask[lid >> 5], 1u << (lid & 31));
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid < 2) masks[2 * get_group_id(0) + lid] = mask[lid];
}
