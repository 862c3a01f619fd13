// construct: nodes of levels 0 to 5 with the sums of the paper's pyramid (algorithm, sections 2 and 3), each with the
// vertex, normal and error that the dual mesher takes from it (section 6). Per isovalue: edits of the cut read no sample.
// construct: one work-group a brick, levels 0 to 3; its
// work-items take its active cells 64 at a time, then each gathers one level-1 cube.
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

inline Moments no_moments() {
    Moments m = {{0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0};
    return m;
}

inline void add_moments(Moments *into, Moments m) {
    for (uint i = 0; i < 3; i++) into->g[i] += m.g[i];
    into->q += m.q;
    into->f += m.f;
    into->n += m.n;
}

inline Node make_node(Moments m, uint level, uint cell, uint signs, bool missing, bool safe) {
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
    node.meta = node_code(level, cell) | signs << 16 | (uint)missing << 24 | (uint)safe << 25;
    return node;
}

// The 3x3x3 samples of a cube at half its size, 27 bits x + 3 y + 9 z. Eight of them are its corners.
inline uint corner_signs(uint samples27) {
    uint signs = 0;
    for (uint corner = 0; corner < 8; corner++)
        signs |= (samples27 >> (2 * (corner & 1) + 6 * (corner >> 1 & 1) + 18 * (corner >> 2)) & 1u) << corner;
    return signs;
}

// Do the samples between the corners say nothing that the corners do not (algorithm, section 4)?
inline bool safe_signs(uint samples27) {
    const uint strides[3] = {1, 3, 9};
    for (uint axis = 0; axis < 3; axis++) {
        const uint a = strides[axis], b = strides[(axis + 1) % 3], c = strides[(axis + 2) % 3];
        for (uint i = 0; i < 4; i++) {
            // The four edges along the axis, and in i < 2 the two faces across it.
            const uint low = 2 * b * (i & 1) + 2 * c * (i >> 1);
            const uint middle = samples27 >> (low + a) & 1u;
            if (middle != (samples27 >> low & 1u) && middle != (samples27 >> (low + 2 * a) & 1u)) return false;
        }
        for (uint side = 0; side < 2; side++) {
            const uint corner = 2 * a * side;
            const uint centre = samples27 >> (corner + b + c) & 1u;
            const uint inside = (samples27 >> corner & 1u) + (samples27 >> (corner + 2 * b) & 1u)
                + (samples27 >> (corner + 2 * c) & 1u) + (samples27 >> (corner + 2 * b + 2 * c) & 1u);
            if (inside == (centre ? 0u : 4u)) return false;
        }
    }
    const uint signs = corner_signs(samples27);
    return signs != (samples27 >> 13 & 1u ? 0u : 255u) && sheet_count(SHEETS[signs]) == 1 && !JOINED[signs];
}

// The 27 samples of a cube inside the brick; rows of the tile go on beyond the volume with its last sample.
inline uint tile_samples27(__local const ushort *signs_of_row, int3 low, int half_size) {
    uint samples27 = 0;
    for (int i = 0; i < 9; i++) {
        const uint row = signs_of_row[(low.z + i / 3 * half_size) * 9 + low.y + i % 3 * half_size] >> low.x;
        samples27 |= ((row & 1u) | (row >> half_size & 1u) << 1 | (row >> (2 * half_size) & 1u) << 2) << (3 * i);
    }
    return samples27;
}

#define TILE(p) tile[((p).z * 9 + (p).y) * 9 + (p).x]

inline void tile_corners(__local const float *tile, int3 p, float *v) {
    for (uint corner = 0; corner < 8; corner++)
        v[corner] = TILE(p + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));
}

// Where and how the vertex of a cube lies. `low`, `high`: the cube in cells from the region's low corner;
// `origin`: the quadric's origin there. The field is read through FIELD(position, result).
#define PLACE_CUBE(q, level_value, low, high, origin, spacing, towards, result, FIELD)                                              \
    {                                                                                                                  \
        float3 x = clamp((origin) + quadric_minimum(q) / (spacing), (low) + MARGIN, (high) - MARGIN);                  \
        const float3 start = x;                                                                                        \
        float4 field;                                                                                                  \
        FIELD(x, field);                                                                                               \
        const float off = fabs(field.w - (level_value));                                                                         \
        for (uint newton = 0; newton < NEWTON_STEPS; newton++) {                                                       \
            x = clamp(x + newton_step(field, level_value, spacing), (low) + MARGIN, (high) - MARGIN);                          \
            FIELD(x, field);                                                                                           \
        }                                                                                                              \
        if (!(fabs(field.w - (level_value)) <= off)) x = start;                                                                  \
        result = make_placement(x, towards, quadric_error(q, (x - (origin)) * (spacing)));                             \
    }

// The vertex of one sheet of a cell with several, at `low` in cells from the region's low corner: the mean of its own
// crossings, moved towards the isosurface inside their box, which two sheets share at most a part of. It goes most of the way
// alone: where boxes touch, in a corner, two vertices might meet at its end.
inline Placement place_sheet(const float *v, float iso, uint signs, uint sheets, uint sheet, float3 low, float3 spacing) {
    float3 sum = (float3)(0.0f), least = (float3)(1.0f - MARGIN), most = (float3)(MARGIN);
    float count = 0.0f;
    for (uint edge = 0; edge < 12; edge++) {
        if (!edge_crosses(signs, edge) || edge_sheet(sheets, edge) != sheet) continue;
        const uint from = edge_low_corner(edge), to = from + (1u << (edge >> 2));
        float t = (iso - v[from]) / (v[to] - v[from]);
        t = isnan(t) ? 0.5f : clamp(t, 0.0f, 1.0f);
        const float3 p = convert_float3(edge_offset(edge)) + convert_float3(axis_step(edge >> 2)) * t;
        sum += p;
        count += 1.0f;
        least = fmin(least, p);
        most = fmax(most, p);
    }
    least = fmax(least, MARGIN);
    most = fmin(most, 1.0f - MARGIN);
    const float3 mean = clamp(sum / count, MARGIN, 1.0f - MARGIN);
    float3 x = mean;
    for (uint newton = 0; newton < NEWTON_STEPS; newton++)
        x = clamp(x + newton_step(trilinear(v, x), iso, spacing), least, most);
    x = mix(mean, x, SHEET_STEP);
    return make_placement(low + x, trilinear(v, x).xyz / spacing, 0.0f);
}

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void construct(const Grid grid, SLAB, const float iso, const uint feature_kind, __global const void *feature,
               const uint feature_type, const float feature_missing, const uint first_brick,
               __global const Region *regions, __global const Brick *bricks, __global const uint *case_facts,
               __global Node *nodes, __global Placement *placements, __global Moments *brick_moments,
               __global Quadric *brick_quadrics, __global uchar *brick_safe) {
    __local float tile[729]; // samples minus isovalue
    __local ushort signs_of_row[81];
    __local ushort list[512]; // active cells in Morton order
    __local float cells_in[INPUTS * CELLS], cells_out[OUTPUTS * CELLS];
    __local uint facts[64]; // of 256 cases a byte: triangles, sheets << 3, has a joined face << 6
    __local Moments ones[64], twos[8];
    __local Quadric one_quadrics[64], two_quadrics[8];
    __local uint extras_before[64];
    __local uint unsafe[3]; // level-1 and level-2 nodes that must not be merged
    const uint lid = get_local_id(0), index = first_brick + (uint)get_group_id(0);
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const uint brick_cell = brick->morton << 9;
    const int3 in_region = convert_int3(unmorton(brick_cell));
    const int3 origin = convert_int3(region_origin(grid, region->region)) + in_region;
    const int3 last = clamp_sample(grid, origin + 8) - origin; // of the brick
    for (uint row = lid; row < 81; row += 64) {
        const int y = min((int)(row % 9), last.y), z = min((int)(row / 9), last.z);
        const ulong base = sample_index(grid, z0, origin + (int3)(0, y, z));
        uint inside = 0;
        for (int x = 0; x < 9; x++) {
            const float v = (float)samples[base + min(x, last.x)];
            tile[9 * row + x] = v == grid.missing ? NAN : v - iso;
            inside |= (uint)(v >= iso && v != grid.missing) << x;
        }
        signs_of_row[row] = (ushort)inside;
    }
    facts[lid] = case_facts[lid];
    if (lid < 3) unsafe[lid] = 0;
    const uint word = brick->cells[lid >> 2], eight = word >> (8 * (lid & 3)) & 0xffu;
    const uint first_rank = brick->prefix[lid >> 2] + popcount(word & ((1u << (8 * (lid & 3))) - 1));
    const uint end_rank = first_rank + popcount(eight), cell_slots = region->slot_base + brick->base[0];
    for (uint rest = eight, at = first_rank; rest; rest &= rest - 1) list[at++] = (ushort)(lid << 3 | (31 - clz(rest & -rest)));
    barrier(CLK_LOCAL_MEM_FENCE);

    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float least = fmin(spacing.x, fmin(spacing.y, spacing.z));
    const float3 per_spacing = least / spacing; // gradients need their direction alone
    const float3 centre = convert_float3(in_region) + 4.0f; // quadrics of the brick count from here
    const uint count = brick->prefix[15] + popcount(brick->cells[15]);
    Moments sum = no_moments();
    Quadric total = no_quadric();
    for (uint first = 0; first < count; first += 64) {
        const int3 at = convert_int3(unmorton(list[min(first + lid, count - 1)]));
        __local const float *corner = &TILE(at);
        const float v[8] = {corner[0], corner[1], corner[9], corner[10], corner[81], corner[82], corner[90], corner[91]};
        for (uint i = 0; i < 8; i++) cells_in[(IN_CORNERS + i) * CELLS + lid] = v[i];
        cells_in[IN_LOW * CELLS + lid] = (float)at.x - 4.0f;
        cells_in[(IN_LOW + 1) * CELLS + lid] = (float)at.y - 4.0f;
        cells_in[(IN_LOW + 2) * CELLS + lid] = (float)at.z - 4.0f;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lid * LANES < min(count - first, (uint)CELLS)) solve_cells(cells_in, cells_out, lid * LANES, spacing, per_spacing);
        barrier(CLK_LOCAL_MEM_FENCE);

        if (first + lid < count) {
            const uint slot = cell_slots + first + lid, cell = list[first + lid];
            uint signs = 0;
            for (uint i = 0; i < 8; i++) signs |= (uint)(cells_in[i * CELLS + lid] >= 0.0f) << i;
            const uint fact = facts[signs >> 2] >> (8 * (signs & 3)) & 0xffu, n = fact & 7u;
            const float f = feature_of_cell(grid, SLAB_ARGS, feature_kind, feature, feature_type, feature_missing, origin + at);
            uint sheets = fact >> 3 & 7u;
            if (fact & 64u) sheets = sheet_count(cell_sheets(grid, SLAB_ARGS, iso, origin + at, signs));
            if (sheets > 1 || fact & 64u) atomic_or(&unsafe[cell >> 8], 1u << (cell >> 3 & 31));
            nodes[slot].count = n;
            nodes[slot].f = f;
            nodes[slot].meta = node_code(0, brick_cell | cell) | signs << 16 | (sheets - 1) << 26;
#define OUT(row) cells_out[(row) * CELLS + lid]
            const float3 x = (float3)(OUT(OUT_VERTEX), OUT(OUT_VERTEX + 1), OUT(OUT_VERTEX + 2));
            const float3 towards = (float3)(OUT(OUT_TOWARDS), OUT(OUT_TOWARDS + 1), OUT(OUT_TOWARDS + 2));
            placements[slot] = make_placement(convert_float3(in_region + at) + x, towards, OUT(OUT_ERROR));
            // What the cubes above sum up: the triangles weigh the moments.
            for (uint i = 0; i < 3; i++) OUT(OUT_SLOPE + i) *= (float)n;
            OUT(OUT_SLOPED) = OUT(OUT_SLOPED) > 0.0f ? (float)n : 0.0f;
            OUT(OUT_VERTEX) = (float)n * f;
            OUT(OUT_VERTEX + 1) = (float)n;
        }
        // Global too: nodes and vertices of cells are read, and of several sheets written again, by the owner of their cube.
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);

#undef OUT
        // Every work-item gathers what belongs to its level-1 cube.
        for (uint r = max(first_rank, first); r < min(end_rank, first + 64); r++) {
            __local const float *of = cells_out + r - first;
            for (uint j = 0; j < 3; j++) sum.g[j] += of[(OUT_SLOPE + j) * CELLS];
            sum.q += of[OUT_SLOPED * CELLS];
            sum.f += of[OUT_VERTEX * CELLS];
            sum.n += (uint)of[(OUT_VERTEX + 1) * CELLS];
            for (uint j = 0; j < 6; j++) total.a[j] += of[(OUT_QUADRIC + j) * CELLS];
            for (uint j = 0; j < 3; j++) {
                total.b[j] += of[(OUT_QUADRIC + 6 + j) * CELLS];
                total.m[j] += of[(OUT_QUADRIC + 10 + j) * CELLS];
            }
            total.c += of[(OUT_QUADRIC + 9) * CELLS];
            total.k += of[(OUT_QUADRIC + 13) * CELLS];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }

    uint extras = 0;
    for (uint i = first_rank; i < end_rank; i++) extras += meta_extras(nodes[cell_slots + i].meta);
    ones[lid] = sum;
    one_quadrics[lid] = total;
    extras_before[lid] = extras;
    if (eight) {
        const uint cell = lid << 3;
        const int3 p = convert_int3(unmorton(cell));
        const bool missing = brick->holes[lid >> 5] >> (lid & 31) & 1u;
        const uint samples27 = tile_samples27(signs_of_row, p, 1);
        // Read with an atomic: others set their bits of this word meanwhile.
        const bool safe = !(atomic_or(&unsafe[lid >> 5], 0u) >> (lid & 31) & 1u) && safe_signs(samples27);
        if (!safe) atomic_or(&unsafe[lid >> 5], 1u << (lid & 31));
        const Node node = make_node(sum, 1, brick_cell | cell, corner_signs(samples27), missing, safe);
        const uint at = region->slot_base + brick->base[1] + rank64(brick->twos[0], brick->twos[1], lid);
        nodes[at] = node;
        for (uint i = first_rank; i < end_rank; i++) nodes[cell_slots + i].s = node.s;
        const float3 low = convert_float3(in_region + p), high = convert_float3(in_region + min(p + 2, last));
        Placement place;
#define TILE_FIELD(x, field)                                                                                           \
    {                                                                                                                  \
        const float3 there = (x) - convert_float3(in_region);                                                          \
        const int3 from = min(convert_int3(there), last - 1);                                                          \
        float v[8];                                                                                                    \
        tile_corners(tile, from, v);                                                                                   \
        field = trilinear(v, there - convert_float3(from));                                                            \
    }
        PLACE_CUBE(total, 0.0f, low, high, centre, spacing, (float3)(sum.g[0], sum.g[1], sum.g[2]), place, TILE_FIELD)
        placements[at] = place;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // Extra sheets: the cells once more, those that have any.
    if (extras) {
        uint at = region->slot_base + brick->base[3];
        for (uint i = 0; i < lid; i++) at += extras_before[i];
        for (uint i = cell_slots + first_rank; i < cell_slots + end_rank; i++) {
            const Node node = nodes[i];
            const uint cell = code_cell(meta_code(node.meta), 0), signs = meta_signs(node.meta);
            const int3 p = convert_int3(unmorton(cell)) - in_region;
            const float3 low = convert_float3(in_region + p);
            if (!meta_extras(node.meta)) continue;
            float v[8];
            tile_corners(tile, p, v);
            const uint sheets = cell_sheets(grid, SLAB_ARGS, iso, origin + p, signs);
            placements[i] = place_sheet(v, 0.0f, signs, sheets, 0, low, spacing);
            for (uint sheet = 1; sheet < sheet_count(sheets); sheet++) {
                Node extra = node;
                extra.count = sheets;
                extra.meta = (node.meta & ~(3u << 26)) | sheet << 26;
                nodes[at] = extra;
                placements[at++] = place_sheet(v, 0.0f, signs, sheets, sheet, low, spacing);
            }
        }
    }

    if (lid < 8) {
        Moments m = ones[8 * lid];
        Quadric q = one_quadrics[8 * lid];
        for (uint i = 1; i < 8; i++) {
            add_moments(&m, ones[8 * lid + i]);
            add_quadric(&q, one_quadrics[8 * lid + i]);
        }
        twos[lid] = m;
        two_quadrics[lid] = q;
        if (brick->fours >> lid & 1u) {
            const uint cell = lid << 6;
            const int3 p = convert_int3(unmorton(cell));
            const bool missing = (brick->holes[lid >> 2] >> (8 * (lid & 3)) & 0xffu) != 0;
            const uint samples27 = tile_samples27(signs_of_row, p, 2);
            const bool merge = !(unsafe[lid >> 2] >> (8 * (lid & 3)) & 0xffu) && safe_signs(samples27);
            if (!merge) atomic_or(&unsafe[2], 1u);
            const uint at = region->slot_base + brick->base[2] + popcount(brick->fours & ((1u << lid) - 1));
            nodes[at] = make_node(m, 2, brick_cell | cell, corner_signs(samples27), missing, merge);
            const float3 low = convert_float3(in_region + p), high = convert_float3(in_region + min(p + 4, last));
            Placement place;
            PLACE_CUBE(q, 0.0f, low, high, centre, spacing, (float3)(m.g[0], m.g[1], m.g[2]), place, TILE_FIELD)
            placements[at] = place;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    if (lid == 0) {
        Moments m = twos[0];
        Quadric q = two_quadrics[0];
        for (uint i = 1; i < 8; i++) {
            add_moments(&m, twos[i]);
            add_quadric(&q, two_quadrics[i]);
        }
        brick_moments[index] = m;
        brick_quadrics[index] = q;
        const bool missing = (brick->holes[0] | brick->holes[1]) != 0;
        const uint samples27 = tile_samples27(signs_of_row, (int3)(0), 4);
        const bool merge = !unsafe[2] && safe_signs(samples27);
        brick_safe[index] = merge;
        const uint at = region->slot_base + region->level_base[3] + index - region->brick_base;
        nodes[at] = make_node(m, 3, brick_cell, corner_signs(samples27), missing, merge);
        const float3 low = convert_float3(in_region), high = convert_float3(in_region + last);
        Placement place;
        PLACE_CUBE(q, 0.0f, low, high, centre, spacing, (float3)(m.g[0], m.g[1], m.g[2]), place, TILE_FIELD)
        placements[at] = place;
    }
}

// The 27 samples of a cube from the volume, cut at its last sample.
inline uint cube_samples27(Grid grid, SLAB, float iso, int3 low, int half_size) {
    uint samples27 = 0;
    for (uint i = 0; i < 27; i++) {
        const int3 p = low + (int3)((int)(i % 3), (int)(i / 3 % 3), (int)(i / 9)) * half_size;
        samples27 |= (uint)(sample_at(grid, SLAB_ARGS, clamp_sample(grid, p)) >= iso) << i;
    }
    return samples27;
}

__kernel void construct_top(const Grid grid, SLAB, const float iso, const uint first_region, const uint region_count,
                            __global const Region *regions, __global const Brick *bricks,
                            __global const Moments *brick_moments, __global const Quadric *brick_quadrics,
                            __global const uchar *brick_safe, __global Node *nodes, __global Placement *placements,
                            __global uint *totals) {
    if (get_global_id(0) >= region_count) return;
    __global const Region *region = regions + first_region + get_global_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const int3 last = clamp_sample(grid, origin + 32) - origin;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]), centre = (float3)(16.0f);
#define VOLUME_FIELD(x, field)                                                                                         \
    {                                                                                                                  \
        const int3 from = min(convert_int3(x), last - 1);                                                              \
        float v[8];                                                                                                    \
        for (uint corner = 0; corner < 8; corner++)                                                                    \
            v[corner] = sample_at(grid, SLAB_ARGS, origin + from + (int3)(corner & 1, corner >> 1 & 1, corner >> 2));  \
        field = trilinear(v, (x) - convert_float3(from));                                                              \
    }
    Moments whole = no_moments();
    Quadric whole_quadric = no_quadric();
    bool whole_safe = true;
    uint index = region->brick_base, slot = region->slot_base + region->level_base[4];
    for (uint eight = 0; eight < 8; eight++) {
        const uint bits = region->brick_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu;
        if (!bits) continue;
        Moments sum = no_moments();
        Quadric q = no_quadric();
        bool safe = true;
        for (uint i = 0; i < popcount(bits); i++, index++) {
            add_moments(&sum, brick_moments[index]);
            const float3 brick_centre = convert_float3(unmorton(bricks[index].morton << 9)) + 4.0f;
            add_quadric(&q, shift_quadric(brick_quadrics[index], (centre - brick_centre) * spacing));
            // A brick without active cells, beside missing samples, forbids nothing.
            safe = safe && (brick_safe[index] || brick_moments[index].n == 0);
        }
        const uint cell = eight << 12;
        const int3 p = convert_int3(unmorton(cell));
        const bool missing = (region->missing_mask[eight >> 2] >> (8 * (eight & 3)) & 0xffu) != 0;
        const uint samples27 = cube_samples27(grid, SLAB_ARGS, iso, origin + p, 8);
        safe = safe && safe_signs(samples27);
        nodes[slot] = make_node(sum, 4, cell, corner_signs(samples27), missing, safe);
        const float3 low = convert_float3(p), high = convert_float3(min(p + 16, last));
        Placement place;
        PLACE_CUBE(q, iso, low, high, centre, spacing, (float3)(sum.g[0], sum.g[1], sum.g[2]), place, VOLUME_FIELD)
        placements[slot++] = place;
        add_moments(&whole, sum);
        add_quadric(&whole_quadric, q);
        whole_safe = whole_safe && safe;
    }
    totals[first_region + get_global_id(0)] = whole.n;
    const bool missing = (region->missing_mask[0] | region->missing_mask[1]) != 0;
    const uint samples27 = cube_samples27(grid, SLAB_ARGS, iso, origin, 16);
    nodes[slot] = make_node(whole, 5, 0, corner_signs(samples27), missing, whole_safe && safe_signs(samples27));
    Placement place;
    PLACE_CUBE(whole_quadric, iso, (float3)(0.0f), convert_float3(last), centre, spacing,
               (float3)(whole.g[0], whole.g[1], whole.g[2]), place, VOLUME_FIELD)
    placements[slot] = place;
}
