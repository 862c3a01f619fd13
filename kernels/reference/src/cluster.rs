//! Clusters of the vertex tree's points: their quadrics, and the position and cost of a merge of two clusters
//! (docs/algorithm.md#7-vertex-tree). In f32 and in the device's order of operations, because the last bit decides which pairs merge.

use crate::tree::TreeLeaf;

/// A point or direction, world units.
pub(crate) type Vector = [f32; 3];

pub(crate) fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn subtract(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Weight of the pull towards the mean of a merged cluster's points, in parts of its area.
const PULL: f32 = 0.003;
/// Cost of an edge's squared length.
const LENGTH_COST: f32 = 1e-6;
/// Share of the second moment of two clusters that a penalised merge costs.
const PENALTY: f32 = 0.125;
/// Keeps divisions by an area finite.
const MIN_AREA: f32 = 1e-30;

/// Sums over planes, each weighted by an area, from the cluster's own position. The matrix `a`: xx, xy, xz, yy, yz, zz.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Quadric {
    a: [f32; 6],
    b: Vector,
    /// Summed squared distance of the own position.
    pub(crate) c: f32,
    m: Vector,
    /// The area.
    pub(crate) k: f32,
}

impl Quadric {
    /// Adds a plane through the own position; the square of the normal's length counts.
    pub(crate) fn add_plane(&mut self, [x, y, z]: Vector, weight: f32) {
        let products = [(x, x), (x, y), (x, z), (y, y), (y, z), (z, z)];
        for (sum, (p, q)) in self.a.iter_mut().zip(products) {
            *sum += weight * p * q;
        }
    }

    fn join(&mut self, other: &Self) {
        for i in 0..6 {
            self.a[i] += other.a[i];
        }
        self.b = add(self.b, other.b);
        self.m = add(self.m, other.m);
        self.c += other.c;
        self.k += other.k;
    }

    fn times(&self, x: Vector) -> Vector {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        [dot([xx, xy, xz], x), dot([xy, yy, yz], x), dot([xz, yz, zz], x)]
    }

    /// The sums over the same planes, from a position moved by `by`.
    pub(crate) fn shifted(&self, by: Vector) -> Self {
        let at = self.times(by);
        Self {
            c: self.c + (dot(by, at) - 2.0 * dot(by, self.b)),
            b: subtract(self.b, at),
            m: subtract(self.m, by.map(|x| self.k * x)),
            ..*self
        }
    }

    /// Summed squared distance of `x`.
    fn sum(&self, x: Vector) -> f32 {
        (dot(x, self.times(x)) - 2.0 * dot(self.b, x) + self.c).max(0.0)
    }

    /// The minimum of the sum, with a pull towards the mean: `(A + w 1) x = b − A mean` from the mean on, by L D Lᵀ factors.
    fn minimum(&self) -> Vector {
        let per_area = 1.0 / self.k.max(MIN_AREA);
        let mean = self.m.map(|x| x * per_area);
        let w = (PULL * self.k).max(MIN_AREA);
        let r = subtract(self.b, self.times(mean));
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let d0 = 1.0 / (xx + w);
        let (l10, l20) = (xy * d0, xz * d0);
        let d1 = 1.0 / (yy + w - l10 * xy).max(w);
        let a21 = yz - l20 * xy;
        let l21 = a21 * d1;
        let d2 = 1.0 / (zz + w - l20 * xz - l21 * a21).max(w);
        let y1 = r[1] - l10 * r[0];
        let y2 = r[2] - l20 * r[0] - l21 * y1;
        let z = y2 * d2;
        let y = y1 * d1 - l21 * z;
        add(mean, [r[0] * d0 - l10 * y - l20 * z, y, z])
    }
}

/// Points that have merged.
#[derive(Clone, Debug)]
pub(crate) struct Cluster {
    pub(crate) quadric: Quadric,
    /// World units from the block's low corner.
    pub(crate) position: Vector,
    /// In the volume, 1/[`crate::tree::LATTICE`] cell.
    pub(crate) lattice_position: [i32; 3],
    /// Low and high cell of its points, in units of 2^level cells.
    pub(crate) cells: [[u32; 3]; 2],
    /// Faces of the volume that it lies on, which it may not leave: at the low and the high end of each axis.
    pub(crate) faces: [[bool; 2]; 3],
    /// On the surface's border on the volume's faces.
    pub(crate) on_border: bool,
    /// Does not merge in this block, nor in any block above it.
    pub(crate) is_locked: bool,
    /// Sums of s and f by area.
    pub(crate) features: [f32; 2],
    /// Its node, or the point itself.
    pub(crate) leaf: TreeLeaf,
}

/// Two clusters as one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Merge {
    /// From the first one's position.
    pub(crate) quadric: Quadric,
    /// From there to the merged position.
    pub(crate) to: Vector,
    /// Infinite if the two may not merge.
    pub(crate) cost: f32,
}

/// The faces of the volume that either of two clusters lies on.
pub(crate) fn join_faces(a: &Cluster, b: &Cluster) -> [[bool; 2]; 3] {
    std::array::from_fn(|axis| std::array::from_fn(|side| a.faces[axis][side] || b.faces[axis][side]))
}

/// Merges two clusters; `a` is the one of the smaller number, so that either side gets the same bits.
pub(crate) fn merge(a: &Cluster, b: &Cluster) -> Merge {
    let faces = join_faces(a, b);
    let between = subtract(b.position, a.position);
    let mut quadric = b.quadric.shifted(between.map(|x| -x));
    quadric.join(&a.quadric);
    let to = if a.faces == b.faces {
        let minimum = quadric.minimum();
        std::array::from_fn(|i| if faces[i] == [false; 2] { minimum[i] } else { 0.0 })
    } else if faces == a.faces {
        [0.0; 3]
    } else {
        between
    };
    // If one of them lies on faces that the other does not, it has to lie on all of the other's.
    let may_merge = !a.is_locked && !b.is_locked && (faces == a.faces || faces == b.faces);
    let more = quadric.sum(to) - a.quadric.c - b.quadric.c;
    let cost = more + LENGTH_COST * dot(between, between) * quadric.k;
    Merge {
        quadric,
        to,
        cost: if may_merge { cost.max(0.0) } else { f32::INFINITY },
    }
}

/// The penalty of a penalised merge: a share of the second moment of the two clusters about the merged position. `a` is the one of the smaller
/// number.
pub(crate) fn penalty(a: &Cluster, b: &Cluster) -> f32 {
    let merged = add(a.position, merge(a, b).to);
    let [from_first, from_second] = [a, b].map(|cluster| subtract(merged, cluster.position));
    PENALTY * (a.quadric.k * dot(from_first, from_first) + b.quadric.k * dot(from_second, from_second))
}

/// Order of edges of equal cost, by the numbers of their ends in the block.
pub(crate) fn edge_hash(a: usize, b: usize) -> u32 {
    let h = (a as u32).wrapping_mul(0x9e37_79b1) ^ (b as u32).wrapping_mul(0x85eb_ca6b);
    let h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    h ^ h >> 12
}
