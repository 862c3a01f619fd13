//! A vertex tree read back from the device, in the twin's terms.

use super::tree::Planted;
use super::*;
use isopeel_kernels::layout;
use isopeel_kernels::testing::{TreeContents, node_importances, read_tree};
use isopeel_reference::octahedral;
use isopeel_reference::tree::{BlockTree, FullMesh, LATTICE, Node, NodeId, Point, Tree};
use isopeel_reference::tree_cut::{Cutter, OfNodes};
use std::collections::BTreeMap;

/// The full dual mesh and its tree.
pub struct HostTree {
    pub mesh: FullMesh,
    pub tree: Tree,
    /// The node that each triangle collapses with, by the region that emits it.
    pub collapsed_by: BTreeMap<[u32; 3], Vec<Option<NodeId>>>,
    /// Unit normals of the nodes.
    pub normals: BTreeMap<NodeId, [f32; 3]>,
    /// The first node of each region.
    node_bases: BTreeMap<[u32; 3], u32>,
}

impl HostTree {
    pub fn read(engine: &Engine, planted: &Planted) -> Self {
        let host = HostPyramid::read(engine, &planted.pyramid);
        let contents = read_tree(engine, &planted.tree).expect("read the tree");
        let at: Vec<[u32; 3]> = host.regions.iter().map(|r| region_at(&host.grid, r.region)).collect();
        let triangles = contents.meshes.iter().map(|mesh| {
            let [first, count] = [mesh.triangle_base, mesh.triangles[0]].map(|n| 3 * n as usize);
            let corners = contents.corners[first..first + count].chunks_exact(3);
            corners.map(|t| [t[0], t[1], t[2]].map(|c| c as usize)).collect()
        });
        let mesh = FullMesh {
            grid: host.grid,
            cap: planted.params.cap,
            points: points(&host, &contents),
            triangles: at.iter().copied().zip(triangles).collect(),
        };
        let blocks = (0..at.len()).map(|i| (at[i], block(&contents, i, at[i]))).collect();
        let node_bases: BTreeMap<[u32; 3], u32> = at
            .iter()
            .copied()
            .zip(contents.regions.iter().map(|r| r.node_base))
            .collect();
        let parents = contents.point_parents.iter().zip(&mesh.points);
        let point_parents = parents
            .map(|(&parent, point)| index_in(node_bases[&point.region], parent))
            .collect();
        Self {
            mesh,
            tree: Tree { blocks, point_parents },
            collapsed_by: collapsed_by(&contents, &at),
            normals: normals(&contents, &at),
            node_bases,
        }
    }

    /// The device's importances, which are near the twin's. Which nodes are merged depends on their last bits.
    pub fn importances(
        &self,
        engine: &Engine,
        planted: &Planted,
        cutter: &Cutter<'_>,
        params: &CutParams,
    ) -> Result<Option<OfNodes>, TestCaseError> {
        let Planted {
            loaded, pyramid, tree, ..
        } = planted;
        let read = node_importances(engine, &loaded.volume, pyramid, tree, params).expect("importances");
        let Some(read) = read else { return Ok(None) };
        let mut got = OfNodes::new();
        for (coords, want) in cutter.importances(params) {
            let of_region = &read[self.node_bases[&coords] as usize..][..want.len()];
            for (got, want) in of_region.iter().zip(want) {
                prop_assert!((got - want).abs() < 1e-4, "importance {}, expected {}", got, want);
            }
            got.insert(coords, of_region.to_vec());
        }
        Ok(Some(got))
    }
}

fn index_in(base: u32, node: u32) -> Option<usize> {
    (node != layout::NONE).then(|| (node - base) as usize)
}

fn points(host: &HostPyramid, contents: &TreeContents) -> Vec<Point> {
    let point = |(i, &[x, y, z, slot]): (usize, &[i32; 4])| {
        let (slot, cell) = (slot as usize, host.leaves[slot as usize]);
        assert_eq!(cell.level, 0, "points are of cells");
        Point {
            position: [x, y, z],
            cell: cell.cube,
            region: cell.region(),
            on_border: i >= contents.cell_points as usize,
            s: host.nodes[slot].s,
            f: host.nodes[slot].f,
        }
    };
    contents.points.iter().enumerate().map(point).collect()
}

fn collapsed_by(contents: &TreeContents, at: &[[u32; 3]]) -> BTreeMap<[u32; 3], Vec<Option<NodeId>>> {
    let node = |&number: &u32| {
        let region = contents.nodes.get(number as usize)?.meta >> 6;
        let base = contents.regions[region as usize].node_base;
        Some((at[region as usize], (number - base) as usize))
    };
    let of_region = |mesh: &layout::RegionMesh| {
        let first = mesh.triangle_base as usize;
        let numbers = &contents.collapsed_by[first..first + mesh.triangles[0] as usize];
        numbers.iter().map(node).collect()
    };
    at.iter().copied().zip(contents.meshes.iter().map(of_region)).collect()
}

fn normal(normal_s: u32) -> [f32; 3] {
    let [x, y, ..] = normal_s.to_le_bytes();
    octahedral::decode([x, y].map(|b| f32::from(b.cast_signed()) / 127.0))
}

fn normals(contents: &TreeContents, at: &[[u32; 3]]) -> BTreeMap<NodeId, [f32; 3]> {
    let of_region = |(region, &at): (&layout::TreeRegion, &[u32; 3])| {
        let first = region.node_base as usize;
        let nodes = contents.nodes[first..first + region.nodes as usize].iter().enumerate();
        nodes
            .map(move |(i, node)| ((at, i), normal(node.normal_s)))
            .collect::<Vec<_>>()
    };
    contents.regions.iter().zip(at).flat_map(of_region).collect()
}

fn block(contents: &TreeContents, index: usize, at: [u32; 3]) -> BlockTree {
    let region = &contents.regions[index];
    let node = |i: u32| {
        let node = &contents.nodes[(region.node_base + i) as usize];
        let error = contents.node_errors[(region.node_base + i) as usize];
        assert_eq!((node.meta >> 6) as usize, index, "the node's region");
        let [low, high] = node.position;
        let from_low = [low & 0x1_ffff, low >> 17 | (high & 3) << 15, high >> 2];
        Node {
            parent: index_in(region.node_base, contents.node_parents[(region.node_base + i) as usize]),
            position: std::array::from_fn(|i| at[i] as i32 * 32 * LATTICE + from_low[i] as i32),
            error: error.abs(),
            removed: if error.is_sign_negative() { 1 } else { 2 },
            level: (node.meta & 7) as u8,
            on_border: node.meta >> 3 & 1 == 1,
            s: (node.normal_s >> 16) as f32 / 65535.0,
            f: node.f,
        }
    };
    BlockTree {
        nodes: (0..region.nodes).map(node).collect(),
        round_ends: contents.round_ends[index].iter().map(|&n| n as usize).collect(),
        area: region.area,
    }
}
