//! Quadrics: sums over planes, whose minimum is a vertex of the dual mesher (docs/algorithm.md#61-crossings-and-quadrics). In
//! f64, so that a device is measured against better arithmetic than its own.

/// Weight of the pull of a cell's vertex towards the mean of its crossings, for each of them.
pub const CELL_PULL: f64 = 0.05;
/// The same of a cube of level 1 or above.
pub const CUBE_PULL: f64 = 0.01;

/// A point or direction.
pub type Vector = [f64; 3];

pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Scaled to length 1; zero if that is not possible.
pub(crate) fn unit(v: Vector) -> Vector {
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
    pub fn minimum(&self, pull: f64) -> Vector {
        let (mean, weight) = (self.mean(), pull * self.crossings);
        let at_mean = self.times(mean);
        let right: Vector = std::array::from_fn(|i| self.np[i] - at_mean[i]);
        let mut a = self.nn;
        (0..3).for_each(|i| a[i][i] += weight);
        let determinant = |m: [[f64; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        let whole = determinant(a);
        std::array::from_fn(|column| {
            let mut replaced = a;
            (0..3).for_each(|row| replaced[row][column] = right[row]);
            mean[column] + determinant(replaced) / whole
        })
    }

    /// Root mean square distance of `x` to the planes.
    pub fn error(&self, x: Vector) -> f64 {
        let value = dot(x, self.times(x)) - 2.0 * dot(self.np, x) + self.pp;
        (value / self.crossings).max(0.0).sqrt()
    }
}
