//! A vertex tree read back from the device, in the twin's terms.

use super::tree::Planted;
use super::*;
use isopeel_kernels::layout;
use isopeel_kernels::testing::{TreeContents, node_importances, read_tree};
use isopeel_reference::octahedral;
use isopeel_reference::tree::{
    BlockId, BlockTree, FullMesh, Node, NodeId, Point, Tree, decode_max_move, last_level, vanishing_level,
};
use isopeel_reference::tree_cut::{Cutter, OfNodes};
use std::collections::{BTreeMap, BTreeSet};

/// The full dual mesh and its tree.
pub struct HostTree {
    pub mesh: FullMesh,
    pub tree: Tree,
    /// The node that each triangle collapses with, by the region that emits it.
    pub collapsed_by: BTreeMap<[u32; 3], Vec<Option<NodeId>>>,
    /// Unit normals of the nodes.
    pub normals: BTreeMap<NodeId, [f32; 3]>,
    /// The first node of each block.
    node_bases: BTreeMap<BlockId, u32>,
}

/// Which block each record of the device's tree is of: those of level 0 are of the active regions in their order, then come the blocks of
/// level 1 in linear order, then those of level 2, and so on; and the one at which parts vanish, if any do.
struct Records {
    blocks: Vec<BlockId>,
    /// The first node of each record; ascending.
    node_bases: Vec<u32>,
}

impl Records {
    fn new(grid: &Grid, regions: &[[u32; 3]], contents: &TreeContents) -> Self {
        let of_level = |level: u8| {
            let coords = regions.iter().map(|&region| BlockId::of_region(level, region).coords);
            let linear: BTreeSet<[u32; 3]> = coords.map(|[x, y, z]| [z, y, x]).collect();
            linear.into_iter().map(move |[z, y, x]| BlockId {
                level,
                coords: [x, y, z],
            })
        };
        let lowest = regions.iter().map(|&region| BlockId::of_region(0, region));
        let mut blocks: Vec<BlockId> = lowest.chain((1..=last_level(grid)).flat_map(of_level)).collect();
        if contents.regions.len() > blocks.len() {
            blocks.push(BlockId {
                level: vanishing_level(grid),
                coords: [0; 3],
            });
        }
        assert_eq!(contents.regions.len(), blocks.len(), "one record a block");
        let node_bases: Vec<u32> = contents.regions.iter().map(|record| record.node_base).collect();
        assert!(node_bases.is_sorted(), "nodes of lower levels first");
        Self { blocks, node_bases }
    }

    /// The node of a number; none for [`layout::NONE`].
    fn node(&self, number: u32) -> Option<NodeId> {
        if number == layout::NONE {
            return None;
        }
        // Blocks without nodes begin where the next one does.
        let record = self.node_bases.partition_point(|&base| base <= number) - 1;
        Some(NodeId {
            block: self.blocks[record],
            index: (number - self.node_bases[record]) as usize,
        })
    }
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
        let records = Records::new(&mesh.grid, &at, &contents);
        let blocks = records.blocks.iter().enumerate();
        let blocks = blocks.map(|(i, &id)| (id, block(&contents, &records, i))).collect();
        let parents = contents.point_parents.iter();
        let point_parents = parents.map(|&parent| records.node(parent)).collect();
        Self {
            mesh,
            tree: Tree { blocks, point_parents },
            collapsed_by: collapsed_by(&contents, &at, &records),
            normals: normals(&contents, &records),
            node_bases: records.blocks.into_iter().zip(records.node_bases).collect(),
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
        for (id, want) in cutter.importances(params) {
            let of_block = &read[self.node_bases[&id] as usize..][..want.len()];
            for (got, want) in of_block.iter().zip(want) {
                prop_assert!((got - want).abs() < 1e-4, "importance {}, expected {}", got, want);
            }
            got.insert(id, of_block.to_vec());
        }
        Ok(Some(got))
    }
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

fn collapsed_by(
    contents: &TreeContents,
    at: &[[u32; 3]],
    records: &Records,
) -> BTreeMap<[u32; 3], Vec<Option<NodeId>>> {
    let of_region = |mesh: &layout::RegionMesh| {
        let first = mesh.triangle_base as usize;
        let numbers = &contents.collapsed_by[first..first + mesh.triangles[0] as usize];
        numbers.iter().map(|&number| records.node(number)).collect()
    };
    at.iter().copied().zip(contents.meshes.iter().map(of_region)).collect()
}

fn normal(normal_s: u32) -> [f32; 3] {
    let [x, y, ..] = normal_s.to_le_bytes();
    octahedral::decode([x, y].map(|b| f32::from(b.cast_signed()) / 127.0))
}

fn normals(contents: &TreeContents, records: &Records) -> BTreeMap<NodeId, [f32; 3]> {
    let of_block = |(record, &block): (&layout::TreeRegion, &BlockId)| {
        let first = record.node_base as usize;
        let nodes = contents.nodes[first..first + record.nodes as usize].iter().enumerate();
        let of_node = move |(index, node): (usize, &layout::TreeNode)| (NodeId { block, index }, normal(node.normal_s));
        nodes.map(of_node).collect::<Vec<_>>()
    };
    contents
        .regions
        .iter()
        .zip(&records.blocks)
        .flat_map(of_block)
        .collect()
}

/// Position in the volume, and maximum movement. The position is packed from the block's low corner, in 2^level steps of the lattice.
fn position_and_move(node: &layout::TreeNode, block: BlockId) -> ([i32; 3], f32) {
    let [low, high] = node.position;
    let steps = [low & 0x1_ffff, low >> 17 | (high & 3) << 15, high >> 2 & 0x1_ffff];
    let corner = block.low_corner();
    let position = std::array::from_fn(|i| corner[i] + ((steps[i] as i32) << block.level));
    (position, decode_max_move(high >> 19 & 0x1ff))
}

/// Reads the nodes of a record.
fn block(contents: &TreeContents, records: &Records, index: usize) -> BlockTree {
    let record = &contents.regions[index];
    let node = |i: u32| {
        let number = (record.node_base + i) as usize;
        let (node, error) = (&contents.nodes[number], contents.node_errors[number]);
        assert_eq!(node.meta >> 6, record.region, "a region of the node's block");
        assert_eq!(
            node.position[1] >> 28,
            u32::from(records.blocks[index].level),
            "its level"
        );
        let (position, max_move) = position_and_move(node, records.blocks[index]);
        Node {
            parent: records.node(contents.node_parents[number]),
            position,
            error: error.abs(),
            removed: if error.is_sign_negative() { 1 } else { 2 },
            level: (node.meta & 7) as u8,
            on_border: node.meta >> 3 & 1 == 1,
            s: (node.normal_s >> 16) as f32 / 65535.0,
            f: node.f,
            max_move,
        }
    };
    BlockTree {
        nodes: (0..record.nodes).map(node).collect(),
        round_ends: contents.round_ends[index].iter().map(|&n| n as usize).collect(),
        area: record.area,
    }
}
