//! Constants that host and device share. They are defined here; `cl/lib/constants.h` is generated from them.

/// Declares the constants and the text of `constants.h`.
macro_rules! constants {
    ($($(#[doc = $doc:literal])* $name:ident: $kind:ident = $value:expr;)*) => {
        $($(#[doc = $doc])* #[allow(dead_code, reason = "some are used in cl/ alone")] pub const $name: $kind = $value;)*

        /// The text of `cl/lib/constants.h`.
        #[cfg(test)]
        pub(crate) fn header() -> String {
            let mut text = String::new();
            $(
                $(text += &format!("//{}\n", $doc);)*
                text += &format!("#define {} {}\n", stringify!($name), Literal::literal(&$name));
            )*
            text
        }
    };
}

/// A value as OpenCL C writes it.
#[cfg(test)]
trait Literal {
    fn literal(&self) -> String;
}

#[cfg(test)]
impl Literal for u32 {
    fn literal(&self) -> String {
        format!("{self}u")
    }
}

#[cfg(test)]
impl Literal for f32 {
    fn literal(&self) -> String {
        format!("{self:?}f")
    }
}

constants! {
    /// Index of a region, brick or node that does not exist.
    NONE: u32 = u32::MAX;
    /// What `dual_emit` writes for corners: indices of vertices.
    CORNERS_INDICES: u32 = 0;
    /// Also their slots.
    CORNERS_SLOTS: u32 = 1;
    /// Numbers of the vertex tree's points instead.
    CORNERS_POINTS: u32 = 2;
    /// Cut state of a node whose descendants hold the leaves.
    INTERNAL: u32 = 255;

    /// Feature that the importance blends with smoothness: none.
    FEATURE_NONE: u32 = 0;
    /// Feature: a field on the same grid.
    FEATURE_FIELD: u32 = 1;
    /// Feature: the magnitude of the field's own gradient.
    FEATURE_GRADIENT: u32 = 2;
    /// Feature: computed by `derive` before; the nodes have it, and what a histogram is made of are its values.
    FEATURE_STORED: u32 = 3;
    /// Feature of `derive`: mean curvature of the isosurface.
    FEATURE_MEAN_CURVATURE: u32 = 4;
    /// Feature of `derive`: Gaussian curvature of the isosurface.
    FEATURE_GAUSSIAN_CURVATURE: u32 = 5;
    /// Feature of `derive`: variance of the samples around.
    FEATURE_LOCAL_VARIANCE: u32 = 6;
    /// Feature of `derive`, of three fields: magnitude of the vector.
    FEATURE_VECTOR_MAGNITUDE: u32 = 7;
    /// Feature of `derive`, of three fields: divergence.
    FEATURE_DIVERGENCE: u32 = 8;
    /// Feature of `derive`, of three fields: magnitude of the vorticity.
    FEATURE_VORTICITY: u32 = 9;
    /// Feature of `derive`, of three fields: Q-criterion.
    FEATURE_Q_CRITERION: u32 = 10;
    /// Feature of `derive`, of three fields: lambda-2.
    FEATURE_LAMBDA_2: u32 = 11;
    /// Feature of `derive`, of three fields: helicity.
    FEATURE_HELICITY: u32 = 12;
    /// Maximum fields of an expression.
    EXPRESSION_FIELDS: u32 = 8;
    /// Maximum operations of an expression.
    EXPRESSION_OPERATIONS: u32 = 64;
    /// Launches of `evaluate` and `mask` begin at multiples of this number of samples.
    LAUNCH_BLOCK: u32 = 1024;
    /// Operation of `evaluate`: a number.
    OPERATION_NUMBER: u32 = 0;
    /// Operation of `evaluate`: the sample of a field.
    OPERATION_FIELD: u32 = 1;
    /// Operation of `evaluate`: both of two conditions hold. A condition is 1 or 0.
    OPERATION_AND: u32 = 2;
    /// Operation of `evaluate`: one of two conditions holds, or both.
    OPERATION_OR: u32 = 3;
    /// Operation of `evaluate`: a condition does not hold.
    OPERATION_NOT: u32 = 4;
    /// Operation of `evaluate`: the first number if a condition holds, else the second one.
    OPERATION_SELECT: u32 = 5;
    /// Operations of `evaluate` from here on are functions and comparisons, whose cases are in `cl/lib/operations.h`.
    OPERATION_FUNCTIONS: u32 = 8;
    /// Floats of a block of `derive` in local memory: 11^3 samples, and what the last lanes read behind them.
    DERIVE_BLOCK: u32 = 1360;
    /// Floats of the tables of `cl/lib/steps.h`, with uneven axes.
    STEP_TABLES: u32 = 188;

    /// Sample type of a feature's field: 8-bit unsigned.
    TYPE_U8: u32 = 0;
    /// Sample type of a feature's field: 8-bit signed.
    TYPE_I8: u32 = 1;
    /// Sample type of a feature's field: 16-bit unsigned.
    TYPE_U16: u32 = 2;
    /// Sample type of a feature's field: 16-bit signed.
    TYPE_I16: u32 = 3;
    /// Sample type of a feature's field: 32-bit float.
    TYPE_F32: u32 = 4;

    /// Steps of a stored vertex position per cell.
    VERTEX_LATTICE: f32 = 2048.0;

    /// Columns of `construct`'s array of cubes: at most 64 + 8 + 1 cubes of levels 1 to 3 in a brick, padded.
    CUBES: u32 = 80;
    /// Rows of `construct`'s array of cubes.
    CUBE_ROWS: u32 = 26;

    /// Rounds of merges in which a block of the vertex tree is built at most.
    TREE_ROUNDS: u32 = 64;
    /// Level of the vertex tree's nodes of larger cubes, too.
    MAX_CUBE_LEVEL: u32 = 5;
    /// Flag of a node that is on the surface's border on the volume's faces.
    NODE_BORDER: u32 = 8;
    /// The same of a cluster.
    CLUSTER_BORDER: u32 = 8;
    /// Flag beside a node's error or key, in its sign bit: the merge removes one triangle instead of two.
    KEY_SINGLE: u32 = 0x8000_0000;
    /// Bins of `fit`, with one for what lies before them and one for what lies behind.
    FIT_BINS: u32 = 2562;

    /// Words of a region's bit mask over its halo of cells: 34^3 - 32^3 cells, four sheets each, 32 bits a word.
    HALO_WORDS: u32 = (34 * 34 * 34 - 32 * 32 * 32) * 4 / 32;
}
