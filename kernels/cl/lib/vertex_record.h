// Vertices of nodes as they are stored: quantised position, octahedral normal, error.
#ifndef ISOPEEL_VERTEX_RECORD_H
#define ISOPEEL_VERTEX_RECORD_H

#include "lib/precision.h"
#include "lib/layout.h"
#include "lib/octahedral.h"

#define MARGIN (1.0f / 32.0f) // distance of vertices from the faces of their cube: vertices of two cubes never coincide
#define NEWTON_STEPS 2        // towards the isosurface
#define SHEET_STEP 0.875f     // part of these steps that vertices of cells with several sheets take

// A coordinate in cells from the region's low corner, as VertexRecord holds it.
inline ushort to_lattice(float cells) { return (ushort)(uint)(cells * VERTEX_LATTICE + 0.5f); }

// `cells`: position from the region's low corner.
inline VertexRecord quantise_vertex(float3 cells, uint normal, float error) {
    VertexRecord p;
    p.position[0] = to_lattice(cells.x);
    p.position[1] = to_lattice(cells.y);
    p.position[2] = to_lattice(cells.z);
    p.normal = (ushort)normal;
    p.error = error;
    return p;
}

// `towards`: any vector along the gradient.
inline VertexRecord make_vertex_record(float3 cells, float3 towards, float error) {
    return quantise_vertex(cells, encode_octahedral8(-towards), error);
}

#endif
