// dual_emit's way from polygons to a batch of triangles, and the vertices that go with them.
#ifndef ISOPEEL_EMIT_POLYGONS_H
#define ISOPEEL_EMIT_POLYGONS_H

#include "lib/batch.h"
#include "lib/cell_values.h"
#include "lib/cube.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/ghosts.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/scan.h"
#include "lib/vertices.h"

// The corners' order is counter-clockwise seen from the edge's high end, which is right when that end is outside.
inline uint flips_winding(uint signs, uint edge) { return !(signs >> edge_low_corner(edge) & 1u); }

// The node of a slot, with the values of a vertex at `at`, from the low corner of the part's region.
INLINED Node vertex_node(Grid grid, const Cut *cut, const Part *part, uint slot, int3 at) {
    const Node node = cut->nodes[slot];
    if (code_level(meta_code(node.meta)) == 0) return node;
    const int3 in_volume = at + part->origin * (int)VERTEX_LATTICE;
    return with_values_at(grid, cut->region_index, cut->regions, cut->bricks, cut->nodes, node, in_volume);
}

// Writes the vertex of a slot of the part's region, if it is used.
INLINED void write_vertex(Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh, __global const uchar *used, uint slot) {
    if (!used[slot]) return;
    const VertexRecord record = mesh->records[slot];
    int3 at = (int3)(record.position[0], record.position[1], record.position[2]);
    if (mesh->params.cap)
        at = lattice_position(grid, mesh->params, record, part->origin) - part->origin * (int)VERTEX_LATTICE;
    mesh->out[mesh->compact_index[slot]] = make_vertex(mesh->params, vertex_node(grid, cut, part, slot, at), record.normal, at);
}

// Writes the vertices of the part's own leaves. Its nodes of all levels and its extra sheets are numbered through, so that many
// work-items take few steps.
INLINED void write_own_vertices(Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh, __global const uchar *used) {
    if (part->covered || mesh->points.wanted) return;
    __global const Region *region = cut->regions + part->region;
    const Slots a = part_slots(*part, region, cut->bricks, part->finest);
    const Slots b = part_slots(*part, region, cut->bricks, part->finest + 1);
    const Slots c = part_slots(*part, region, cut->bricks, 2), d = part_slots(*part, region, cut->bricks, 3);
    const Slots e = part_slots(*part, region, cut->bricks, EXTRA_SHEETS);
    const uint end_a = a.count, end_b = end_a + b.count, end_c = end_b + c.count, end_d = end_c + d.count, end_e = end_d + e.count;
    for (uint i = get_local_id(0); i < end_e; i += BRICK_GROUP) {
        const uint slot = region->slot_base
            + (i < end_a ? a.first + i : i < end_b ? b.first + i - end_a : i < end_c ? c.first + i - end_b
               : i < end_d ? d.first + i - end_c : e.first + i - end_d);
        write_vertex(grid, cut, part, mesh, used, slot);
    }
}

// Position of a corner's vertex from the low corner of the part's region. `is_own`: the leaf is one of that region.
INLINED int3 corner_on_lattice(Grid grid, const Cut *cut, const Part *part, CutParams params, VertexRecord record, uint slot,
                             uint region, uint faces) {
    const int3 origin = region == part->region ? part->origin : convert_int3(region_origin(grid, cut->regions[region].region));
    return (faces ? border_position(grid, cut->nodes[slot], record, faces, origin) : lattice_position(grid, params, record, origin))
        - part->origin * (int)VERTEX_LATTICE;
}

// Number of a corner's vertex among the points of the vertex tree. Writes the position of one on the volume's faces, `at` from the
// low corner of the part's region.
INLINED uint corner_point(Grid grid, const Cut *cut, const Part *part, const PointNumbers *numbers, uint slot, uint region,
                          uint faces, int3 at) {
    __global const Region *home = cut->regions + region;
    if (!faces) return cell_point(home, slot);
    const int3 origin = convert_int3(region_origin(grid, home->region));
    const uint bit = ghost_bit(grid, cut->regions, cut->nodes, origin, region, slot, faces);
    const uint word = region * HALO_WORDS + (bit >> 5);
    const uint before = numbers->border_base[word] + popcount(numbers->borders[word] & ((1u << (bit & 31)) - 1));
    const uint point = numbers->tree_regions[region].border_base + before;
    numbers->points[point] = (int4)(at + part->origin * (int)VERTEX_LATTICE, (int)slot);
    return point;
}

// Adds a polygon to a batch, and writes the vertices of its ghosts and on the border. `first`: see Batch.
INLINED void add_polygon(Batch *batch, Grid grid, const Cut *cut, const Part *part, const MeshVertices *mesh,
                         const Polygon *polygon, uint flip_winding, uint first) {
    const uint column = NEXT_COLUMN(batch);
    for (uint k = 0; k < 4; k++) {
        if (k >= polygon->count) break;
        const uint slot = polygon->slot[k], region = polygon->region[k], faces = polygon->faces[k];
        const VertexRecord record = mesh->records[slot];
        const int3 at = corner_on_lattice(grid, cut, part, mesh->params, record, slot, region, faces);
        const bool is_own = region == part->region && !faces;
        const uint index = mesh->points.wanted ? corner_point(grid, cut, part, &mesh->points, slot, region, faces, at)
            : is_own ? mesh->compact_index[slot]
            : write_ghost(mesh, part->region, slot, vertex_node(grid, cut, part, slot, at),
                          ghost_bit(grid, cut->regions, cut->nodes, part->origin, region, slot, faces), at);
        batch->position_normal[k * LANES + column] = (int4)(at, (int)record.normal);
        batch->index_slot[k * LANES + column] = (uint2)(index, slot | (faces ? ON_BORDER : 0));
    }
    batch->first[column] = first;
    batch->count_flags[column] = polygon->count | flip_winding << 3;
}

// Fills the list with edges around which the part's leaves emit polygons, as many as it holds; returns the new length.
INLINED uint list_emitted_edges(Grid grid, const Cut *cut, const Part *part, LeafWalk *walk, __global const uint *emitted_edges,
                                __global const uint *brick_triangles, uint listed, __local ushort *list, __local uint *scratch) {
    __global const Region *region = cut->regions + part->region;
    const uint lid = get_local_id(0);
    while (walk->level < walk->end_level && listed + 12 * BRICK_GROUP <= EDGE_LIST_CAPACITY) {
        if (walk->begin >= walk->slots.count || brick_triangles[part->counts + walk->level - part->finest] == 0) {
            next_level(walk, *part, region, cut->bricks);
            continue;
        }
        const uint i = walk->begin + lid, own = region->slot_base + walk->slots.first + i;
        const bool is_leaf = i < walk->slots.count && (part->plain || cut->state[own] == walk->level);
        walk->begin += BRICK_GROUP;
        uint edges = 0, total;
        if (is_leaf && !part->plain) edges = emitted_edges[own];
        else if (is_leaf) {
            const uint meta = cut->nodes[own].meta, crossed = crossed_edges(meta_signs(meta));
            const int3 low = part->origin + convert_int3(unmorton(code_cell(meta_code(meta), walk->level)));
            edges = is_inside(grid, low) ? crossed & EDGES_OWN : crossed;
        }
        uint at = listed + scan_group(scratch, popcount(edges), &total);
        for (uint rest = edges; rest; rest &= rest - 1) list[at++] = edge_entry(walk->level, i, lowest_bit(rest));
        listed += total;
    }
    return listed;
}

// Emits the polygons of the listed edges in order. `first_triangle`: of each level, as in dual_emit; `done`: triangles so far.
INLINED void emit_listed(Batch *batch, Grid grid, const Cut *cut, __local const LeafHalo *halo, const Part *part,
                         const MeshVertices *mesh, const TriangleOutput *out, __local const uint *first_triangle, uint *done,
                         __local const ushort *list, uint listed, __local uint *scratch) {
    __global const Region *region = cut->regions + part->region;
    const uint lid = get_local_id(0);
    for (uint at = 0; at < listed; at += BRICK_GROUP) {
        Polygon polygon;
        polygon.count = 0;
        uint flip_winding = 0, first = 0, total;
        if (at + lid < listed) {
            const uint entry = list[at + lid], level = entry_level(entry), edge = entry_edge(entry);
            const uint slot = entry_slot(entry, *part, region, cut->bricks), meta = cut->nodes[slot].meta;
            const int3 low = part->origin + convert_int3(unmorton(code_cell(meta_code(meta), level)));
            polygon = find_polygon(grid, cut, halo, part, slot, level, low, edge);
            flip_winding = flips_winding(meta_signs(meta), edge);
            first = first_triangle[level] + *done;
        }
        uint before = 2 * lid;
        if (part->all_quads) total = 2 * min(listed - at, (uint)BRICK_GROUP);
        else before = scan_group(scratch, polygon.count ? polygon.count - 2 : 0, &total);
        if (polygon.count) add_polygon(batch, grid, cut, part, mesh, &polygon, flip_winding, 3 * (first + before));
        if (batch->count == LANES) emit_batch(batch, out);
        *done += total;
    }
}

#endif
