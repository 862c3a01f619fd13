// Points of the surface in a cell: the crossings of lines along the axes. On a line the trilinear interpolant is linear, so the crossings are
// exact. The number of lines along an axis that cross a patch of the surface is proportional to the patch's projected area: if each crossing is
// weighted by the component of the unit normal along its line, the weights of all three axes add up to the patch's area (Cauchy and Crofton).
#ifndef ISOPEEL_CELL_LINES_H
#define ISOPEEL_CELL_LINES_H

#include "lib/precision.h"
#include "lib/layout.h"
#include "lib/samples.h"
#include "lib/trilinear.h"

// Lines of a cell along each axis. The first two measure area: they go through the face at (a, a) and (1 - a, 1 - a) or at (a, 1 - a) and
// (1 - a, a), alternating like a checkerboard. The distance of a mesh with one vertex a cell is nearly periodic in cells, so that two suffice,
// with a = 1/4; squares of distances that grow along the face, as at the border of a surface, have the right mean with Gauss's a = 0.211. ACROSS
// is between: both are right within a twentieth. The other lines have no area and count for the maximum alone. They lie beside the edge at the
// cell's low corner, because the interpolant has its kinks and the surface its thin spikes there; in the volume's last cells, and if samples are
// missing in all cells, beside all four edges.
#define LINES_OF_AXIS 6u
#define INNER_LINES 2u
#define INSET 0.0625f
#define ACROSS 0.22f

// A cell: its low corner, the samples at its corners less the isovalue, and the axes along which it lies in the padding of a capped volume.
typedef struct {
    float v[8];
    int3 low;
    uint padded;      // a bit for each axis
    uint padded_high; // a bit for each axis: at its far end
    uint last;        // a bit for each axis along which it is the last cell without padding
    float3 spacing;
} CellOfLines;

inline float component_of(float3 v, uint axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

INLINED CellOfLines load_cell_of_lines(Grid grid, SLAB, float iso, uint cap, int3 low) {
    CellOfLines cell;
    cell.low = low;
    cell.spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    for (uint corner = 0; corner < 8; corner++)
        cell.v[corner] = sample_at(grid, SLAB_ARGS, low + (int3)(corner & 1, corner >> 1 & 1, corner >> 2)) - iso;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    cell.padded_high = cap ? (uint)(low.x == last.x) | (uint)(low.y == last.y) << 1 | (uint)(low.z == last.z) << 2 : 0;
    const int3 end = last - (int)cap;
    cell.last = (uint)(low.x == end.x) | (uint)(low.y == end.y) << 1 | (uint)(low.z == end.z) << 2;
    cell.padded = cap ? cell.padded_high | (uint)(low.x == 0) | (uint)(low.y == 0) << 1 | (uint)(low.z == 0) << 2 : 0;
    return cell;
}

// The interpolant on a face of the cell, at the far end of an axis or at its near one; `s`, `t`: along the axes that follow.
inline float value_on_face(const float *v, uint axis, uint far, float s, float t) {
    const uint base = far << axis, second = 1u << (axis + 1) % 3, third = 1u << (axis + 2) % 3;
    return mix(mix(v[base], v[base + second], s), mix(v[base + third], v[base + second + third], s), t);
}

// The crossing of a line and the surface: position in world units (xyz), and the area that it represents (w), which is negative if the line
// does not cross the surface. In the padding of a capped volume the surface is on the volume's face.
INLINED float4 cross_line(const CellOfLines *cell, uint axis, uint line) {
    const uint second = (axis + 1) % 3, third = (axis + 2) % 3;
    const float4 none = (float4)(-1.0f);
    if (cell->padded & (1u << second | 1u << third)) return none;
    const bool inner = line < INNER_LINES, other_diagonal = (cell->low.x + cell->low.y + cell->low.z) & 1;
    const uint far = (line & 1u) << second | (line >> 1 & 1u) << third;
    if (!inner && (far & ~cell->last)) return none;
    const float s = inner ? (line ? 1.0f - ACROSS : ACROSS) : (far >> second & 1u) ? 1.0f - INSET : INSET;
    const float t = inner ? (other_diagonal ? 1.0f - s : s) : (far >> third & 1u) ? 1.0f - INSET : INSET;
    const float face = inner ? component_of(cell->spacing, second) * component_of(cell->spacing, third) : 0.0f;
    const float from = value_on_face(cell->v, axis, 0, s, t), to = value_on_face(cell->v, axis, 1, s, t);
    float along = from / (from - to), area = face;
    if (cell->padded >> axis & 1u) {
        const bool high = cell->padded_high >> axis & 1u;
        if (!((high ? from : to) >= 0.0f)) return none;
        along = high ? 0.0f : 1.0f;
    } else if ((from >= 0.0f) == (to >= 0.0f)) return none;
    const float3 at = axis == 0 ? (float3)(along, s, t) : axis == 1 ? (float3)(t, along, s) : (float3)(s, t, along);
    if (inner && !(cell->padded >> axis & 1u)) {
        const float3 gradient = trilinear(cell->v, at).xyz / cell->spacing;
        area *= fabs(component_of(gradient, axis)) / length(gradient);
    }
    return (float4)((convert_float3(cell->low) + at) * cell->spacing, area);
}

#endif
