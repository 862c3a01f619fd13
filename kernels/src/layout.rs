//! Rust's side of `cl/lib/layout.h`: every struct that host and device exchange. The fields are documented there;
//! `device_tests.rs` compares sizes and offsets on the real driver.

use bytemuck::{Pod, Zeroable};

pub use crate::constants::NONE;

macro_rules! layout {
    ($($(#[$doc:meta])* $name:ident { $($field:ident: $kind:ty),* $(,)? })*) => {
        $(
            $(#[$doc])*
            #[repr(C)]
            #[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
            #[allow(missing_docs, reason = "fields are documented in cl/lib/layout.h")]
            pub struct $name { $(pub $field: $kind),* }
        )*

        /// Name, fields, size and field offsets of every struct.
        #[cfg(test)]
        pub(crate) fn structs() -> Vec<(&'static str, Vec<&'static str>, Vec<usize>)> {
            vec![$((
                stringify!($name),
                vec![$(stringify!($field)),*],
                vec![size_of::<$name>(), $(std::mem::offset_of!($name, $field)),*],
            )),*]
        }
    };
}

layout! {
    /// Extent of the volume.
    Grid { dims: [u32; 3], regions: [u32; 3], spacing: [f32; 3], missing: f32 }
    /// An active region.
    Region {
        region: u32, brick_base: u32, brick_mask: [u32; 2], missing_mask: [u32; 2], slot_base: u32, point_base: u32,
        level_base: [u32; 8],
    }
    /// An active brick.
    Brick {
        cells: [u32; 16], cells_before: [u16; 16], level1_mask: [u32; 2], level1_missing: [u32; 2], level2_mask: u32,
        level_base: [u32; 4], extra_sheets: u32, quad_count: u32, region: u32, morton: u32,
    }
    /// A node of the pyramid.
    Node { count: u32, s: f32, f: f32, meta: u32 }
    /// The vertex of a node.
    VertexRecord { position: [u16; 3], normal: u16, error: f32 }
    /// Sums over crossings below a cube.
    Quadric { a: [f32; 6], b: [f32; 3], c: f32, m: [f32; 3], k: f32 }
    /// Sums over the active cells below a cube.
    Moments { g: [f32; 3], q: f32, f: f32, n: u32 }
    /// What the cut depends on.
    CutParams {
        alpha: f32, threshold: f32, by_error: u32, feature_lo: f32, feature_span: f32, max_level: u32, prefix: u32, fills: u32,
        points: u32, interests: u32, max_error: f32, preserve: u32, cap: u32,
    }
    /// A region of interest.
    Interest { centre: [f32; 3], rows: [f32; 9], importance: f32, is_cube: u32 }
    /// Counts of a region's mesh, and the start of its vertices and triangles.
    RegionMesh { vertices: u32, triangles: [u32; 6], distinct_vertices: u32, vertex_base: u32, triangle_base: u32 }
    /// A vertex while the mesh is made.
    WorkVertex { position: [i32; 3], key: u32 }
    /// A vertex as it leaves the device; the same bytes as [`crate::Vertex`].
    Vertex { position: [i32; 3], normal: u32, attributes: u32 }
    /// Ranges of the vertex tree in a block: a region, or a block of a level above.
    TreeRegion {
        border_base: u32, border_points: u32, triangle_count: u32, triangle_base: u32, cluster_base: u32, node_base: u32, nodes: u32,
        rounds: u32, beside_count: u32, beside_base: u32, area: f32, points: u32, region: u32, above: u32, clusters: u32, idle: u32, fresh: u32,
        is_done: u32,
    }
    /// A cluster of points while the vertex tree is built.
    TreeCluster { quadric: Quadric, ring_first: u32, ring_count: u32 }
    /// Data of a cluster's points that nodes need.
    TreeMembers { normal: [f32; 3], s: f32, f: f32, node: u32, extent: u32, changes: u32 }
    /// A merge of two clusters of points.
    TreeNode { position: [u32; 2], normal_s: u32, f: f32, meta: u32 }
    /// Sums over a block's leaves of a cut of the vertex tree.
    TreeCutRegion { leaves: [u32; 6], error2: f32, worst: f32 }
    /// Sums over the removed parts in a region, and the area of the remaining ones.
    TreePartSum { parts: u32, triangles: u32, full_triangles: u32, area_left: f32 }
    /// Some cells or triangles of a region.
    ErrorTask { region: u32, first: u32, count: u32 }
    /// Distances of a task.
    ErrorSum { sum2: f32, weight: f32, max: f32 }
    /// Sums over the leaves of a region.
    RegionCut { leaves: [u32; 6], undecided: [u32; 6], lost_cubes: u32, error2: f32, worst: f32, weight: u32 }
    /// The active cell whose vertex is nearest to a position.
    ProbedCell { slots: [u32; 6], region: u32, point: u32, distance: f32, s: f32, f: f32, blended: f32, importance: f32 }
    /// Totals of the marching-cubes mesher.
    Counters { unpatched_vertices: u32, vertices: u32 }
}

impl Region {
    /// Vertices of the full dual mesh in the region, one per cell and one per extra sheet, not including those on the volume's faces.
    pub(crate) fn cell_points(&self) -> u32 {
        self.level_base[1] + self.level_base[7] - self.level_base[6]
    }
}
