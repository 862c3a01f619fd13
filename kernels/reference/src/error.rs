//! How far a dual mesh is from the surface it stands for (docs/algorithm.md#67-stated-error), in f64, by maps where the device
//! follows linked lists.
//!
//! Distances are ranges: where the field hardly has a slope, or has another beyond the next face of a cell, rounding decides
//! which end of the range a device finds.

use std::collections::BTreeMap;

use crate::quadric::{Vector, dot};
use crate::trilinear::{cell_at, corners, crossing, field_at};
use crate::{Cut, Field, Leaf, boxes, offset};
use isopeel_kernels::SurfaceError;
use isopeel_kernels::tables::cube;
use isopeel_kernels::tables::sheets::Sheets;

/// A vertex of a cut: a leaf, and which of its sheets.
pub type Sheet = (Leaf, u8);

/// A triangle of the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Region whose mesh has it.
    pub region: [u32; 3],
    /// Vertices of the cut at its corners; of a border vertex the one that it was moved from.
    pub sheets: [Sheet; 3],
    /// Its corners, world units.
    pub corners: [Vector; 3],
}

/// A mesh with what it was made from.
pub struct MeasuredMesh<'a> {
    /// The cut.
    pub cut: &'a Cut,
    /// Sheets of every active cell.
    pub sheets: &'a BTreeMap<[u32; 3], Sheets>,
    /// Where every vertex of the cut lies, world units.
    pub vertices: &'a BTreeMap<Sheet, Vector>,
    /// The mesh.
    pub triangles: &'a [Triangle],
}

/// Minimum and maximum.
type Range = [f64; 2];

#[derive(Clone, Copy, Default)]
struct Distances {
    sum2: Range,
    count: f64,
    max: Range,
}

impl Distances {
    fn add(&mut self, distance: Range) {
        self.join(&Self {
            sum2: distance.map(|d| d * d),
            count: 1.0,
            max: distance,
        });
    }

    fn join(&mut self, more: &Self) {
        for i in 0..2 {
            self.sum2[i] += more.sum2[i];
            self.max[i] = self.max[i].max(more.max[i]);
        }
        self.count += more.count;
    }
}

/// Distances of crossings to the mesh, and of centres of triangles to the surface.
type Both = [Distances; 2];

/// The minimum and the maximum error that may be stated.
pub type Stated = [SurfaceError; 2];

fn stated(both: &Both) -> Stated {
    let mean2 = |d: &Distances, i: usize| if d.count > 0.0 { d.sum2[i] / d.count } else { 0.0 };
    [0, 1].map(|i| SurfaceError {
        rms: ((mean2(&both[0], i) + mean2(&both[1], i)) / 2.0).sqrt() as f32,
        max: both[0].max[i].max(both[1].max[i]) as f32,
    })
}

fn minus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// Distance of a point to a triangle: the nearest of its points by its weights at the corners, where all are positive, or
/// else on a side.
fn triangle_distance(p: Vector, [a, b, c]: [Vector; 3]) -> f64 {
    let side = |a: Vector, b: Vector| {
        let (along, to) = (minus(b, a), minus(p, a));
        let whole = dot(along, along);
        let t = if whole > 0.0 {
            (dot(to, along) / whole).clamp(0.0, 1.0)
        } else {
            0.0
        };
        length(std::array::from_fn(|i| to[i] - t * along[i]))
    };
    let sides = side(a, b).min(side(b, c)).min(side(c, a));
    // Least squares in the plane of u and v.
    let (u, v, to) = (minus(b, a), minus(c, a), minus(p, a));
    let (uu, uv, vv, ut, vt) = (dot(u, u), dot(u, v), dot(v, v), dot(u, to), dot(v, to));
    let whole = uu * vv - uv * uv;
    let (s, t) = ((ut * vv - vt * uv) / whole, (vt * uu - ut * uv) / whole);
    if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
        sides.min(length(std::array::from_fn(|i| to[i] - s * u[i] - t * v[i])))
    } else {
        sides
    }
}

/// What rounding may change: a position by so many cells, a value by this part of the largest difference beside it.
const ROUNDING: f64 = 1e-5;

/// How far a point is from the surface by the slope of the field there, and NaN where nothing can be said.
fn by_slope(field: &Field, iso: f32, p: Vector) -> Range {
    let spacing = field.grid.spacing.map(f64::from);
    let off = |v: f64| (v - f64::from(iso)).abs();
    // The point itself and its surroundings, in cells.
    let aside = |side: usize| std::array::from_fn(|i| if side >> i & 1 == 1 { ROUNDING } else { -ROUNDING });
    let nudges = (0..8).map(aside).chain([[0.0; 3]]);
    let positions: Vec<Vector> = nudges
        .map(|nudge| std::array::from_fn(|i| p[i] / spacing[i] + nudge[i]))
        .collect();
    let fields: Vec<(Vector, f64)> = positions.iter().map(|&x| field_at(field, x)).collect();
    let range = |of: &dyn Fn(&(Vector, f64)) -> f64| {
        let wider = |range: Range, v: f64| [range[0].min(v), range[1].max(v)];
        fields.iter().map(of).fold([f64::INFINITY, 0.0], wider)
    };
    let offs = range(&|(_, value)| off(*value));
    let slopes = range(&|(gradient, _)| length(std::array::from_fn(|i| gradient[i] / spacing[i])));
    let beside = positions.iter().flat_map(|&x| corners(field, cell_at(field, x)));
    let rounded = ROUNDING * beside.map(off).fold(0.0, f64::max);
    let tilted = rounded / spacing.into_iter().fold(f64::INFINITY, f64::min);
    let unknown = fields.iter().filter(|(_, value)| value.is_nan()).count();
    let minimum = (offs[0] - rounded).max(0.0) / (slopes[1] + tilted);
    match unknown {
        0 => [minimum, (offs[1] + rounded) / (slopes[0] - tilted).max(0.0)],
        n if n == positions.len() => [f64::NAN; 2],
        _ => [minimum, f64::INFINITY],
    }
}

/// A mesh by the vertices of its cut.
struct Measure<'a> {
    field: &'a Field,
    iso: f32,
    mesh: &'a MeasuredMesh<'a>,
    /// Triangles around each vertex that has some.
    around: BTreeMap<Sheet, Vec<[Vector; 3]>>,
    /// Of vertices without triangles, the distance to the nearest that has some.
    detached: BTreeMap<Sheet, f64>,
}

impl<'a> Measure<'a> {
    fn new(field: &'a Field, iso: f32, mesh: &'a MeasuredMesh<'a>) -> Self {
        let mut around: BTreeMap<Sheet, Vec<[Vector; 3]>> = BTreeMap::new();
        for triangle in mesh.triangles {
            for sheet in triangle.sheets {
                around.entry(sheet).or_default().push(triangle.corners);
            }
        }
        Self {
            field,
            iso,
            mesh,
            around,
            detached: BTreeMap::new(),
        }
    }

    /// From a vertex without triangles to the nearest that has some, of its region if there is one.
    fn to_nearest(&self, sheet: &Sheet) -> f64 {
        let to = |other: &Sheet| length(minus(self.mesh.vertices[sheet], self.mesh.vertices[other]));
        let in_region = |other: &&Sheet| other.0.region() == sheet.0.region();
        let nearest = self
            .around
            .keys()
            .filter(in_region)
            .map(to)
            .fold(f64::INFINITY, f64::min);
        if nearest.is_finite() {
            nearest
        } else {
            self.around.keys().map(to).fold(f64::INFINITY, f64::min)
        }
    }

    /// Distance of a crossing to the triangles around the vertex that stands for it.
    fn crossing_distance(&mut self, p: Vector, vertex: Sheet) -> f64 {
        if let Some(triangles) = self.around.get(&vertex) {
            let distances = triangles.iter().map(|t| triangle_distance(p, *t));
            return distances.fold(f64::INFINITY, f64::min);
        }
        let detached = match self.detached.get(&vertex) {
            Some(&known) => known,
            None => self.to_nearest(&vertex),
        };
        self.detached.insert(vertex, detached);
        length(minus(p, self.mesh.vertices[&vertex])) + detached
    }

    /// Distance of a triangle's centre to the surface, by the field at the centre or over one of its vertices.
    fn centre_distance(&self, triangle: &Triangle) -> Range {
        let diagonal = length(self.field.grid.spacing.map(f64::from));
        let [a, b, c] = triangle.corners;
        let centre: Vector = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0);
        let by_vertex = |sheet: &Sheet| {
            let vertex = self.mesh.vertices[sheet];
            let cube = diagonal * f64::from(1u32 << sheet.0.level);
            by_slope(self.field, self.iso, vertex).map(|off| length(minus(vertex, centre)) + off.min(cube))
        };
        let nearest = |a: Range, b: Range| [a[0].min(b[0]), a[1].min(b[1])];
        let by_centre = by_slope(self.field, self.iso, centre);
        triangle.sheets.iter().map(by_vertex).fold(by_centre, nearest)
    }
}

/// Whether samples are missing in a region or on its border.
fn has_gaps(field: &Field, region: [u32; 3]) -> bool {
    let low = region.map(|r| 32 * r);
    let high = std::array::from_fn(|i| (low[i] + 33).min(field.grid.dims[i]));
    boxes(low, high).any(|p| field.at(p).is_nan())
}

/// Error of every region that has crossings or triangles, and of the whole surface.
pub fn errors(field: &Field, iso: f32, mesh: &MeasuredMesh<'_>) -> (BTreeMap<[u32; 3], Stated>, Stated) {
    let spacing = field.grid.spacing.map(f64::from);
    let mut measure = Measure::new(field, iso, mesh);
    let mut regions: BTreeMap<[u32; 3], Both> = BTreeMap::new();
    let mut gaps: BTreeMap<[u32; 3], bool> = BTreeMap::new();
    for (&cell, leaf) in &mesh.cut.leaf_of {
        let region = cell.map(|c| c / 32);
        let gaps = *gaps.entry(region).or_insert_with(|| has_gaps(field, region));
        let v = field.cell_corners(cell).map(f64::from);
        let sheets = mesh.sheets[&cell].of_edge;
        for edge in (0..12).filter(|&e| sheets[e] != cube::NONE) {
            // Each crossing once: by the cell at whose low corner it is, or where that may be missing by all cells around it.
            let [start, _] = cube::edge_corners(edge);
            let low = offset(cell, cube::corner_offset(start).map(|c| c as u32));
            if edge % 4 != 0 && !gaps && (0..3).all(|i| low[i] + 1 < field.grid.dims[i]) {
                continue;
            }
            let at = crossing(v, iso, edge);
            let p = std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i]);
            let vertex = (*leaf, if leaf.level == 0 { sheets[edge] } else { 0 });
            let distance = measure.crossing_distance(p, vertex);
            regions.entry(region).or_default()[0].add([distance; 2]);
        }
    }
    for triangle in mesh.triangles {
        let distance = measure.centre_distance(triangle);
        regions.entry(triangle.region).or_default()[1].add(distance);
    }
    let mut whole = Both::default();
    for both in regions.values() {
        (0..2).for_each(|i| whole[i].join(&both[i]));
    }
    let by_region = regions.iter().map(|(at, both)| (*at, stated(both))).collect();
    (by_region, stated(&whole))
}
