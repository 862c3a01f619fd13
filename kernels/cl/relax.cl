// relax: vertices of cells, moved so that the polygons between them meet the surface. A vertex on the surface is right for
// its cell alone: a polygon joins four of them across the kinks that the interpolant has at faces of cells, and passes the
// crossing of the edge in its middle on the inner side. Each vertex makes good a part of what its polygons miss. Runs once an
// isovalue; one work-group a brick, whose inner edges alone count: a vertex beside another brick moves a little less, and
// no brick waits for its neighbours.

#define RELAX 0.7f // part of the mean gap that is made good: neighbours move too, so all of it would be too much

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void relax(const Grid grid, SLAB, const float iso, const uint first_brick, __global const Region *regions,
           __global const Brick *bricks, __global const Node *nodes, __global Placement *placements) {
    __local float gaps[3 * 3 * 512]; // from polygon to crossing, x y z, of the edges at every active cell's low corner
    const uint lid = get_local_id(0), index = first_brick + (uint)get_group_id(0);
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const int3 in_region = convert_int3(unmorton(brick->morton << 9));
    const int3 origin = convert_int3(region_origin(grid, region->region)) + in_region;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const uint first = region->slot_base + brick->base[0], count = brick->prefix[15] + popcount(brick->cells[15]);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const uint meta = nodes[first + i].meta, cell = code_cell(meta_code(meta), 0) & 511;
        const int3 at = convert_int3(unmorton(cell));
        for (uint axis = 0; axis < 3; axis++) {
            const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
            float3 corner[4], gap = (float3)(0.0f);
            bool inner = edge_crosses(meta_signs(meta), 4 * axis) && all(at - b - c >= 0);
            for (uint k = 0; k < 4 && inner; k++) {
                const int3 around = at - b * (int)(k & 1) - c * (int)(k >> 1);
                const uint slot = find_in_brick(region, bricks, index, 0, morton(convert_uint3(around)));
                inner = slot != NONE; // else samples are missing
                if (!inner) break;
                const Placement place = placements[sheet_in_brick(region, brick, nodes, slot, 4 * axis + k)];
                corner[k] = (float3)(place.position[0], place.position[1], place.position[2]);
            }
            if (inner) {
                const float low = sample_at(grid, SLAB_ARGS, origin + at);
                const float high = sample_at(grid, SLAB_ARGS, origin + at + axis_step(axis));
                const float t = (float)crossing(iso, low, high) / 65536.0f;
                const float3 p = convert_float3(in_region + at) + convert_float3(axis_step(axis)) * t;
                const float3 middle = (corner[0] + corner[1] + corner[2] + corner[3]) / (4.0f * PLACEMENT_LATTICE);
                const float3 normal = unit(cross((corner[3] - corner[0]) * spacing, (corner[2] - corner[1]) * spacing));
                gap = dot(normal, (p - middle) * spacing) * normal;
            }
            gaps[3 * (3 * cell + axis)] = gap.x;
            gaps[3 * (3 * cell + axis) + 1] = gap.y;
            gaps[3 * (3 * cell + axis) + 2] = gap.z;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const uint meta = nodes[first + i].meta;
        // Of several sheets each stays where it is, apart from the others.
        if (meta_extras(meta)) continue;
        const int3 at = convert_int3(unmorton(code_cell(meta_code(meta), 0) & 511));
        const uint crossed = crossed_edges(meta_signs(meta));
        float3 sum = (float3)(0.0f);
        for (uint rest = crossed; rest; rest &= rest - 1) {
            const uint edge = lowest_bit(rest);
            const int3 low = at + edge_offset(edge);
            if (any(low > 7)) continue;
            const uint cell = morton(convert_uint3(low));
            if (!is_cell_active(brick, cell)) continue;
            __local const float *gap = gaps + 3 * (3 * cell + (edge >> 2));
            sum += (float3)(gap[0], gap[1], gap[2]);
        }
        __global Placement *place = placements + first + i;
        const float3 from = (float3)(place->position[0], place->position[1], place->position[2]) / PLACEMENT_LATTICE;
        const float3 lowest = convert_float3(in_region + at) + MARGIN, step = RELAX / (float)popcount(crossed) * sum / spacing;
        const float3 to = rint(clamp(from + step, lowest, lowest + (1.0f - 2.0f * MARGIN)) * PLACEMENT_LATTICE);
        place->position[0] = (ushort)to.x;
        place->position[1] = (ushort)to.y;
        place->position[2] = (ushort)to.z;
    }
}
