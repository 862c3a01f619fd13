// construct: nodes of levels 0 to 5 with the sums of the paper's pyramid (algorithm, sections 2 and 3). Per isovalue.
// construct: one work-group a brick, levels 0 to 3; a work-item owns one level-1 cube.
// construct_top: one work-item a region, levels 4 and 5.

inline float feature_sample(__global const void *feature, uint type, float missing, ulong i) {
    float v;
    switch (type) {
        case 0: v = (float)((__global const uchar *)feature)[i]; break;
        case 1: v = (float)((__global const char *)feature)[i]; break;
        case 2: v = (float)((__global const ushort *)feature)[i]; break;
        case 3: v = (float)((__global const short *)feature)[i]; break;
        default: v = ((__global const float *)feature)[i];
    }
    return v == missing ? NAN : v;
}

// The user's feature at a cell's centre: the mean of its corners that are not missing.
inline float feature_of_cell(Grid grid, SLAB, uint kind, __global const void *feature, uint type, float missing,
                             int3 cell) {
    if (kind == FEATURE_NONE) return 0.0f;
    float sum = 0.0f, count = 0.0f;
    for (uint corner = 0; corner < 8; corner++) {
        const int3 p = cell + (int3)(corner & 1, corner >> 1 & 1, corner >> 2);
        const float v = kind == FEATURE_GRADIENT ? length(gradient_at(grid, SLAB_ARGS, p))
                                                 : feature_sample(feature, type, missing, sample_index(grid, z0, p));
        if (!isnan(v)) { sum += v; count += 1.0f; }
    }
    return count > 0.0f ? sum / count : 0.0f;
}

inline void add_moments(Moments *into, Moments m) {
    for (uint i = 0; i < 3; i++) into->g[i] += m.g[i];
    into->q += m.q;
    into->f += m.f;
    into->n += m.n;
}

inline Node make_node(Moments m, uint level, uint cell, uint signs, uint missing) {
    Node node;
    node.count = m.n;
    node.s = 0.0f;
    node.f = 0.0f;
    if (m.n > 0) {
        const float n = (float)m.n;
        const float3 mean = (float3)(m.g[0], m.g[1], m.g[2]) / n;
        const float variance = fmax(m.q / n - dot(mean, mean), 0.0f);
        node.s = variance / (1.0f + variance);
        node.f = m.f / n;
    }
    node.meta = node_code(level, cell) | signs << 16 | missing << 24;
    return node;
}

#define TILE(p) tile[((p).z * 9 + (p).y) * 9 + (p).x]

// Corner signs of a cube inside the brick, cut at the volume's last sample.
inline uint tile_signs(__local const float *tile, float iso, int3 low, int size, int3 last) {
    const int3 high = min(low + size, last);
    uint signs = 0;
    for (uint corner = 0; corner < 8; corner++) {
        const int3 p = (int3)(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y, corner & 4 ? high.z : low.z);
        signs |= (uint)(TILE(p) >= iso) << corner;
    }
    return signs;
}

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void construct(const Grid grid, SLAB, const float iso, const uint feature_kind, __global const void *feature,
               const uint feature_type, const float feature_missing, const uint first_brick,
               __global const Region *regions, __global const Brick *bricks, __constant uchar *cases,
               __global Node *nodes, __global Moments *brick_moments) {
    __local float tile[729];
    __local Moments ones[64], twos[8];
    const uint lid = get_local_id(0), index = first_brick + (uint)get_group_id(0);
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const uint brick_cell = brick->morton << 9;
    const int3 origin = convert_int3(region_origin(grid, region->region) + unmorton(brick_cell));
    const int3 last = clamp_sample(grid, origin + 8) - origin;
    for (uint i = lid; i < 729; i += 64) {
        const int3 p = (int3)((int)(i % 9), (int)(i / 9 % 9), (int)(i / 81));
        tile[i] = sample_at(grid, SLAB_ARGS, origin + min(p, last));
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    Moments sum = {{0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0};
    const uint word = brick->cells[lid >> 2], eight = word >> (8 * (lid & 3)) & 0xffu;
    const uint first_slot = region->slot_base + brick->base[0] + brick->prefix[lid >> 2]
        + popcount(word & ((1u << (8 * (lid & 3))) - 1));
    const float3 per_spacing = (float3)(0.25f / grid.spacing[0], 0.25f / grid.spacing[1], 0.25f / grid.spacing[2]);
    uint slot = first_slot;
    for (uint child = 0; child < 8; child++) {
        if (!(eight >> child & 1u)) continue;
        const uint cell = lid << 3 | child;
        const int3 p = convert_int3(unmorton(cell));
        float v[8];
        uint signs = 0;
        for (uint corner = 0; corner < 8; corner++) {
            v[corner] = TILE(p + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));
            signs |= (uint)(v[corner] >= iso) << corner;
        }
        float3 g = (float3)((v[1] + v[3] + v[5] + v[7]) - (v[0] + v[2] + v[4] + v[6]),
                            (v[2] + v[3] + v[6] + v[7]) - (v[0] + v[1] + v[4] + v[5]),
                            (v[4] + v[5] + v[6] + v[7]) - (v[0] + v[1] + v[2] + v[3])) * per_spacing;
        // Scaled first, so that neither huge nor tiny values leave the range of a float when squared.
        const float largest = fmax(fmax(fabs(g.x), fabs(g.y)), fabs(g.z));
        if (largest > 0.0f && !isinf(largest)) {
            g /= largest;
            g /= sqrt(dot(g, g));
        } else g = (float3)(0.0f);
        const uint n = cases[16 * signs];
        const float f = feature_of_cell(grid, SLAB_ARGS, feature_kind, feature, feature_type, feature_missing, origin + p);
        sum.g[0] += n * g.x;
        sum.g[1] += n * g.y;
        sum.g[2] += n * g.z;
        sum.q += n * dot(g, g);
        sum.f += n * f;
        sum.n += n;
        nodes[slot].count = n;
        nodes[slot].f = f;
        nodes[slot].meta = node_code(0, brick_cell | cell) | signs << 16;
        slot++;
    }
    ones[lid] = sum;
    if (eight) {
        const uint cell = lid << 3;
        const uint missing = brick->holes[lid >> 5] >> (lid & 31) & 1u;
        const Node node = make_node(sum, 1, brick_cell | cell,
                                    tile_signs(tile, iso, convert_int3(unmorton(cell)), 2, last), missing);
        nodes[region->slot_base + brick->base[1] + rank64(brick->twos[0], brick->twos[1], lid)] = node;
        for (uint i = first_slot; i < slot; i++) nodes[i].s = node.s;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    if (lid < 8) {
        Moments m = ones[8 * lid];
        for (uint i = 1; i < 8; i++) add_moments(&m, ones[8 * lid + i]);
        twos[lid] = m;
        if (brick->fours >> lid & 1u) {
            const uint cell = lid << 6;
            const uint missing = (brick->holes[lid >> 2] >> (8 * (lid & 3)) & 0xffu) != 0;
            nodes[region->slot_base + brick->base[2] + popcount(brick->fours & ((1u << lid) - 1))] =
                make_node(m, 2, brick_cell | cell, tile_signs(tile, iso, convert_int3(unmorton(cell)), 4, last), missing);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    if (lid == 0) {
        Moments m = twos[0];
        for (uint i = 1; i < 8; i++) add_moments(&m, twos[i]);
        brick_moments[index] = m;
        const uint missing = (brick->holes[0] | brick->holes[1]) != 0;
        nodes[region->slot_base + region->level_base[3] + index - region->brick_base] =
            make_node(m, 3, brick_cell, tile_signs(tile, iso, (int3)(0), 8, last), missing);
    }
}

// Corner signs of a cube from the volume, cut at its last sample.
inline uint cube_signs(Grid grid, SLAB, float iso, int3 low, int size) {
    uint signs = 0;
    for (uint corner = 0; corner < 8; corner++) {
        const int3 p = low + (int3)(corner & 1, corner >> 1 & 1, corner >> 2) * size;
        signs |= (uint)(sample_at(grid, SLAB_ARGS, clamp_sample(grid, p)) >= iso) << corner;
    }
    return signs;
}

__kernel void construct_top(const Grid grid, SLAB, const float iso, const uint first_region, const uint region_count,
                            __global const Region *regions, __global const Brick *bricks,
                            __global const Moments *brick_moments, __global Node *nodes,
                            __global uint *totals) {
    if (get_global_id(0) >= region_count) return;
    __global const Region *region = regions + first_region + get_global_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    Moments whole = {{0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0};
    uint index = region->brick_base, slot = region->slot_base + region->level_base[4];
    for (uint eight = 0; eight < 8; eight++) {
        const uint bits = region->brick_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu;
        if (!bits) continue;
        Moments sum = {{0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0};
        for (uint i = 0; i < popcount(bits); i++) add_moments(&sum, brick_moments[index++]);
        const uint cell = eight << 12;
        const uint missing = (region->missing_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu) != 0;
        nodes[slot++] = make_node(sum, 4, cell,
                                  cube_signs(grid, SLAB_ARGS, iso, origin + convert_int3(unmorton(cell)), 16), missing);
        add_moments(&whole, sum);
    }
    totals[first_region + get_global_id(0)] = whole.n;
    const uint missing = (region->missing_mask[0] | region->missing_mask[1]) != 0;
    nodes[slot] = make_node(whole, 5, 0, cube_signs(grid, SLAB_ARGS, iso, origin, 32), missing);
}
