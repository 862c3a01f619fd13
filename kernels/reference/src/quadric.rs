//! Where the dual mesher puts a vertex, and how far that is from the surface it stands for (algorithm, section 6). In
//! f64, so that a device is measured against better arithmetic than its own.

use std::collections::{BTreeMap, BTreeSet};

use crate::sheets::cell_sheets;
use crate::{Field, Leaf, Pyramid, boxes, construct, offset};
use isopeel_kernels::tables::{cube, sheets::Sheets};

/// Pull towards the mean of the crossings, of each of them.
const MEAN_WEIGHT: f64 = 0.05;
/// Vertices stay this far inside their cube, in cells.
const MARGIN: f64 = 1.0 / 32.0;
const NEWTON_STEPS: usize = 2;
/// Of the way to the isosurface that the vertex of one of several sheets goes.
const SHEET_STEP: f64 = 0.875;
/// Part of the mean gap between a cell's polygons and the crossings in their middle that its vertex makes good.
const RELAX: f64 = 0.7;
/// Cells along the side of a brick, whose inner edges alone count for that.
const BRICK: u32 = 8;

/// A point or direction.
pub type Vector = [f64; 3];

pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Scaled to length 1; zero where that is not possible.
fn unit(v: Vector) -> Vector {
    let length = dot(v, v).sqrt();
    if length > 0.0 && length.is_finite() {
        v.map(|x| x / length)
    } else {
        [0.0; 3]
    }
}

/// Sums over crossings, in world units.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quadric {
    nn: [[f64; 3]; 3],
    np: Vector,
    pp: f64,
    sum: Vector,
    /// How many crossings.
    pub crossings: f64,
}

impl Quadric {
    /// A crossing at `p` with unit normal `n`.
    pub fn add(&mut self, p: Vector, n: Vector) {
        let d = dot(n, p);
        for i in 0..3 {
            (0..3).for_each(|j| self.nn[i][j] += n[i] * n[j]);
            self.np[i] += n[i] * d;
            self.sum[i] += p[i];
        }
        self.pp += d * d;
        self.crossings += 1.0;
    }

    /// All crossings of another.
    pub fn join(&mut self, other: &Self) {
        for i in 0..3 {
            (0..3).for_each(|j| self.nn[i][j] += other.nn[i][j]);
            self.np[i] += other.np[i];
            self.sum[i] += other.sum[i];
        }
        self.pp += other.pp;
        self.crossings += other.crossings;
    }

    /// Mean of the crossings.
    pub fn mean(&self) -> Vector {
        self.sum.map(|x| x / self.crossings)
    }

    fn times(&self, x: Vector) -> Vector {
        std::array::from_fn(|i| dot(self.nn[i], x))
    }

    /// The point that fits all planes best, pulled towards the mean: Cramer's rule on `(A + w) (x − mean) = b − A mean`.
    pub fn minimum(&self) -> Vector {
        let (mean, weight) = (self.mean(), MEAN_WEIGHT * self.crossings);
        let at_mean = self.times(mean);
        let right: Vector = std::array::from_fn(|i| self.np[i] - at_mean[i]);
        let mut a = self.nn;
        (0..3).for_each(|i| a[i][i] += weight);
        let det = |m: [[f64; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        let whole = det(a);
        std::array::from_fn(|column| {
            let mut replaced = a;
            (0..3).for_each(|row| replaced[row][column] = right[row]);
            mean[column] + det(replaced) / whole
        })
    }

    /// Root mean square distance of `x` to the planes.
    pub fn error(&self, x: Vector) -> f64 {
        let value = dot(x, self.times(x)) - 2.0 * dot(self.np, x) + self.pp;
        (value / self.crossings).max(0.0).sqrt()
    }
}

/// A vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// In cells from the volume's first sample.
    pub position: Vector,
    /// Along the gradient, any length.
    pub towards: Vector,
    /// Root mean square distance to the planes of the crossings it stands for, world units.
    pub error: f64,
    /// Where the position may come out otherwise by rounding alone: far where a Newton step jumps between cells.
    pub spread: f64,
}

/// Gradient per cell and value of the trilinear interpolant of eight corners.
fn trilinear(v: [f64; 8], t: Vector) -> (Vector, f64) {
    let weight = |corner: usize, skip: usize| -> f64 {
        let up = cube::corner_offset(corner);
        (0..3)
            .filter(|&i| i != skip)
            .map(|i| if up[i] == 1 { t[i] } else { 1.0 - t[i] })
            .product()
    };
    let gradient = std::array::from_fn(|axis| {
        (0..8)
            .map(|c| v[c] * weight(c, axis) * if c >> axis & 1 == 1 { 1.0 } else { -1.0 })
            .sum()
    });
    (gradient, (0..8).map(|c| v[c] * weight(c, 3)).sum())
}

pub(crate) fn corners(field: &Field, cell: [u32; 3]) -> [f64; 8] {
    field.cell_corners(cell).map(f64::from)
}

/// Gradient per cell and value of the volume at `x`, in cells.
pub(crate) fn field_at(field: &Field, x: Vector) -> (Vector, f64) {
    let cell = cell_at(field, x);
    trilinear(corners(field, cell), std::array::from_fn(|i| x[i] - f64::from(cell[i])))
}

/// The cell that holds `x`, in cells, or the one next to it.
pub(crate) fn cell_at(field: &Field, x: Vector) -> [u32; 3] {
    std::array::from_fn(|i| (x[i] as u32).min(field.grid.dims[i] - 2))
}

/// Where an edge of a cell crosses the isovalue, from the cell's low corner.
pub(crate) fn crossing(v: [f64; 8], iso: f32, edge: usize) -> Vector {
    let [low, high] = cube::edge_corners(edge);
    let t = (f64::from(iso) - v[low]) / (v[high] - v[low]);
    let mut at = cube::corner_offset(low).map(|c| c as f64);
    at[cube::edge_axis(edge)] += if t.is_nan() { 0.5 } else { t.clamp(0.0, 1.0) };
    at
}

/// Sums over the crossings of one sheet of a cell.
fn sheet_quadric(field: &Field, iso: f32, cell: [u32; 3], sheets: &Sheets, sheet: u8) -> Quadric {
    let (v, spacing) = (corners(field, cell), field.grid.spacing.map(f64::from));
    let mut q = Quadric::default();
    for edge in (0..12).filter(|&e| sheets.of_edge[e] == sheet) {
        let at = crossing(v, iso, edge);
        let (g, _) = trilinear(v, at);
        let p = std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i]);
        q.add(p, unit(std::array::from_fn(|i| g[i] / spacing[i])));
    }
    q
}

/// How a Newton step is kept short: at most one cell along each axis.
#[derive(Clone, Copy, PartialEq)]
enum Short {
    /// Shortened in its direction.
    Scaled,
    /// Cut at each axis for itself: cells, which it hardly leaves.
    Clamped,
}

fn newton_step((gradient, value): (Vector, f64), iso: f64, spacing: Vector, short: Short) -> Vector {
    let g: Vector = std::array::from_fn(|i| gradient[i] / spacing[i]);
    let length2 = dot(g, g);
    let step: Vector = std::array::from_fn(|i| (iso - value) / length2 * g[i] / spacing[i]);
    if step.iter().any(|s| !s.is_finite()) {
        return [0.0; 3];
    }
    if short == Short::Clamped {
        return step.map(|s| s.clamp(-1.0, 1.0));
    }
    let longest = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
    step.map(|s| if longest > 1.0 { s / longest } else { s })
}

/// A start and the Newton steps from it: where they end, unless they lead away, and the gradient seen last.
fn descend(
    field: &Field,
    iso: f32,
    start: Vector,
    short: Short,
    inside: impl Fn(Vector) -> Vector,
) -> (Vector, Vector) {
    let (iso, spacing) = (f64::from(iso), field.grid.spacing.map(f64::from));
    let start = inside(start);
    let (mut x, mut seen) = (start, field_at(field, start));
    let off = (seen.1 - iso).abs();
    for _ in 0..NEWTON_STEPS {
        let step = newton_step(seen, iso, spacing, short);
        x = inside(std::array::from_fn(|i| x[i] + step[i]));
        seen = field_at(field, x);
    }
    let better = (seen.1 - iso).abs() <= off;
    (
        if better { x } else { start },
        std::array::from_fn(|i| seen.0[i] / spacing[i]),
    )
}

/// How far apart the ends of a way may lie that begins near `start`, at the corners of a small box.
fn spread(start: Vector, reach: f64, way: impl Fn(Vector) -> Vector) -> f64 {
    let end = way(start);
    let apart = |nudge| {
        let up = cube::corner_offset(nudge);
        let other = way(std::array::from_fn(|i| start[i] + reach * (up[i] as f64 - 0.5) * 1e-3));
        (0..3).map(|i| (other[i] - end[i]).abs()).fold(0.0, f64::max)
    };
    (0..8).map(apart).fold(0.0, f64::max)
}

/// The vertex of one sheet of a cell with several: the mean of its own crossings, moved most of the way to the isosurface
/// inside their box. At its end two vertices might meet.
fn place_sheet(field: &Field, iso: f32, cell: [u32; 3], sheets: &Sheets, sheet: u8) -> Placement {
    let (v, spacing) = (corners(field, cell), field.grid.spacing.map(f64::from));
    let q = sheet_quadric(field, iso, cell, sheets, sheet);
    let (mut least, mut most) = ([1.0 - MARGIN; 3], [MARGIN; 3]);
    for edge in (0..12).filter(|&e| sheets.of_edge[e] == sheet) {
        let p = crossing(v, iso, edge);
        least = std::array::from_fn(|i| least[i].min(p[i]).max(MARGIN));
        most = std::array::from_fn(|i| most[i].max(p[i]).min(1.0 - MARGIN));
    }
    let mean: Vector = std::array::from_fn(|i| {
        let low = f64::from(cell[i]);
        (q.mean()[i] / spacing[i] - low).clamp(MARGIN, 1.0 - MARGIN)
    });
    let way = |start: Vector| {
        let mut x = start;
        for _ in 0..NEWTON_STEPS {
            let step = newton_step(trilinear(v, x), f64::from(iso), spacing, Short::Scaled);
            x = std::array::from_fn(|i| (x[i] + step[i]).clamp(least[i], most[i]));
        }
        std::array::from_fn(|i| mean[i] + SHEET_STEP * (x[i] - mean[i]))
    };
    let at = way(mean);
    Placement {
        position: std::array::from_fn(|i| f64::from(cell[i]) + at[i]),
        towards: std::array::from_fn(|i| trilinear(v, at).0[i] / spacing[i]),
        error: q.error(std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i])),
        spread: spread(mean, 1.0, way),
    }
}

/// The vertex of the cube from `low` to `high` (samples): the quadric's best point, moved onto the isosurface.
fn place(field: &Field, iso: f32, q: &Quadric, [low, high]: [[u32; 3]; 2], short: Short) -> Placement {
    let spacing = field.grid.spacing.map(f64::from);
    let inside = |x: Vector| -> Vector {
        std::array::from_fn(|i| x[i].clamp(f64::from(low[i]) + MARGIN, f64::from(high[i]) - MARGIN))
    };
    let best = q.minimum();
    let start: Vector = std::array::from_fn(|i| best[i] / spacing[i]);
    let (position, towards) = descend(field, iso, start, short, inside);
    let reach = f64::from((0..3).map(|i| high[i] - low[i]).max().unwrap_or(1));
    let spread = spread(start, reach, |from| descend(field, iso, from, short, inside).0);
    let world = std::array::from_fn(|i| position[i] * spacing[i]);
    Placement {
        position,
        towards,
        error: q.error(world),
        spread,
    }
}

/// What the dual mesher and the guards know of every node.
#[derive(Clone, Debug, Default)]
pub struct Vertices {
    /// Sheets of every active cell.
    pub sheets: BTreeMap<[u32; 3], Sheets>,
    /// A vertex for every node; for a cell one for each sheet.
    pub placements: BTreeMap<(Leaf, u8), Placement>,
    /// Nodes that are safe to merge (algorithm, section 4).
    pub safe: BTreeSet<Leaf>,
}

/// Whether the signs between the corners of a cube say nothing that the corners do not, and its surface is one disk that
/// meets no face twice. A sign is that of the sample at `p` half sizes, `p` in 0..3 along each axis.
fn safe_signs(sign: impl Fn([u32; 3]) -> bool) -> bool {
    let between = boxes([0; 3], [3; 3]).filter(|p| p.contains(&1)).all(|p| {
        // A midpoint of an edge, face or cube is compared with the corners of that edge, face or cube.
        let low = p.map(|c| if c == 1 { 0 } else { c });
        let high = p.map(|c| if c == 1 { 2 } else { c });
        boxes(low, offset(high, [1; 3]))
            .filter(|c| !c.contains(&1))
            .any(|c| sign(c) == sign(p))
    });
    let signs = (0..8).fold(0, |bits, b| {
        bits | u8::from(sign(cube::corner_offset(b).map(|c| 2 * c as u32))) << b
    });
    let sheets = Sheets::trace(signs, 0);
    between && sheets.count == 1 && sheets.joined_faces() == 0
}

/// From the polygon around an edge of a cell to the crossing in its middle, along the polygon's normal, world units; and how
/// far that may be off as its corners may. `None`: the edge is on the side of its brick, or samples are missing.
fn gap(field: &Field, iso: f32, vertices: &Vertices, cell: [u32; 3], edge: usize) -> Option<(Vector, f64)> {
    let (spacing, axis) = (field.grid.spacing.map(f64::from), cube::edge_axis(edge));
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut low = cell;
    low[b] += edge as u32 & 1;
    low[c] += edge as u32 >> 1 & 1;
    let brick = low.map(|x| x / BRICK);
    if brick != cell.map(|x| x / BRICK) || low[b].is_multiple_of(BRICK) || low[c].is_multiple_of(BRICK) {
        return None;
    }
    let (mut corners_at, mut spread) = ([[0.0; 3]; 4], 0.0f64);
    for (k, corner) in corners_at.iter_mut().enumerate() {
        let mut of = low;
        of[b] -= k as u32 & 1;
        of[c] -= k as u32 >> 1;
        let sheet = vertices.sheets.get(&of)?.of_edge[4 * axis + k];
        let place = &vertices.placements[&(Leaf { level: 0, cube: of }, sheet)];
        *corner = std::array::from_fn(|i| place.position[i] * spacing[i]);
        spread = spread.max(place.spread);
    }
    let at = crossing(corners(field, low), iso, 4 * axis);
    let off: Vector = std::array::from_fn(|i| {
        (f64::from(low[i]) + at[i]) * spacing[i] - corners_at.iter().map(|x| x[i]).sum::<f64>() / 4.0
    });
    let across =
        |from: usize, to: usize| -> Vector { std::array::from_fn(|i| corners_at[to][i] - corners_at[from][i]) };
    let ([ax, ay, az], [bx, by, bz]) = (across(0, 3), across(1, 2));
    let normal = unit([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]);
    let height = dot(normal, off);
    Some((normal.map(|n| n * height), spread))
}

/// Moves the vertices of cells with one sheet so that the polygons between them meet the surface.
fn relax(field: &Field, iso: f32, vertices: &mut Vertices) {
    let spacing = field.grid.spacing.map(f64::from);
    let mut moved = Vec::new();
    for (&cell, sheets) in vertices.sheets.iter().filter(|(_, sheets)| sheets.count == 1) {
        let crossed: Vec<usize> = (0..12).filter(|&e| sheets.of_edge[e] == 0).collect();
        let (mut sum, mut spread) = ([0.0; 3], 0.0f64);
        for (gap, of) in crossed.iter().filter_map(|&e| gap(field, iso, vertices, cell, e)) {
            (0..3).for_each(|i| sum[i] += gap[i]);
            spread = spread.max(of);
        }
        let mut vertex = vertices.placements[&(Leaf { level: 0, cube: cell }, 0)];
        vertex.position = std::array::from_fn(|i| {
            let step = RELAX / crossed.len() as f64 * sum[i] / spacing[i];
            let low = f64::from(cell[i]);
            (vertex.position[i] + step).clamp(low + MARGIN, low + 1.0 - MARGIN)
        });
        vertex.spread += 2.0 * spread;
        moved.push((cell, vertex));
    }
    for (cube, vertex) in moved {
        vertices.placements.insert((Leaf { level: 0, cube }, 0), vertex);
    }
}

/// Places every vertex.
pub fn vertices(field: &Field, pyramid: &Pyramid, iso: f32) -> Vertices {
    let mut result = Vertices::default();
    let mut quadrics: BTreeMap<[u32; 3], Quadric> = BTreeMap::new();
    let mut gradients: BTreeMap<[u32; 3], Vector> = BTreeMap::new();
    for (&cell, of) in &pyramid.cells {
        let leaf = Leaf { level: 0, cube: cell };
        let sheets = cell_sheets(field, iso, cell, of.signs);
        let mut total = Quadric::default();
        for sheet in 0..sheets.count {
            let q = sheet_quadric(field, iso, cell, &sheets, sheet);
            total.join(&q);
            let vertex = if sheets.count == 1 {
                place(field, iso, &q, [cell, offset(cell, [1; 3])], Short::Clamped)
            } else {
                place_sheet(field, iso, cell, &sheets, sheet)
            };
            result.placements.insert((leaf, sheet), vertex);
        }
        if sheets.count == 1 && sheets.joined_faces() == 0 {
            result.safe.insert(leaf);
        }
        result.sheets.insert(cell, sheets);
        quadrics.insert(cell, total);
        gradients.insert(
            cell,
            construct::normalised(of.g).map(|g| f64::from(g) * f64::from(of.n)),
        );
    }
    relax(field, iso, &mut result);
    for level in 1..=5u8 {
        let (mut coarse, mut sums) = (BTreeMap::<_, Quadric>::new(), BTreeMap::<_, Vector>::new());
        for (cube, q) in &quadrics {
            coarse.entry(cube.map(|c| c / 2)).or_default().join(q);
            let sum = sums.entry(cube.map(|c| c / 2)).or_default();
            (0..3).for_each(|i| sum[i] += gradients[cube][i]);
        }
        for (&cube, q) in &coarse {
            let leaf = Leaf { level, cube };
            let samples = field.cube_samples(usize::from(level), cube);
            let vertex = Placement {
                towards: sums[&cube],
                ..place(field, iso, q, samples, Short::Scaled)
            };
            result.placements.insert((leaf, 0), vertex);
            let half = 1 << (level - 1);
            let sign = |p: [u32; 3]| {
                field.at(std::array::from_fn(|i| {
                    (samples[0][i] + p[i] * half).min(samples[1][i])
                })) >= iso
            };
            let children = (0..8).map(|b| Leaf {
                level: level - 1,
                cube: offset(cube.map(|c| 2 * c), cube::corner_offset(b).map(|d| d as u32)),
            });
            let mut active = children.filter(|c| quadrics.contains_key(&c.cube));
            if active.all(|c| result.safe.contains(&c)) && safe_signs(sign) {
                result.safe.insert(leaf);
            }
        }
        (quadrics, gradients) = (coarse, sums);
    }
    result
}
