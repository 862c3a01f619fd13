//! The meshes between the levels of the vertex tree: what remains in the blocks of one level is the mesh of the next one
//! (docs/algorithm.md#7-vertex-tree).

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::block::Block;
use crate::cluster::{Cluster, Quadric};
use crate::tree::{BlockId, FullMesh, Point, TreeLeaf, last_level};

/// The clusters that a block begins with.
#[derive(Clone, Debug, Default)]
pub(crate) struct Members {
    /// Their numbers in the level, in the order of those in the block.
    pub(crate) clusters: Vec<usize>,
    /// Number of points of the full mesh in the block.
    pub(crate) points: u64,
}

/// The clusters at the start of a level, and the triangles between them.
pub(crate) struct LevelMesh<'a> {
    pub(crate) mesh: &'a FullMesh,
    pub(crate) level: u8,
    pub(crate) clusters: Vec<Cluster>,
    /// Coordinates of the block of each cluster.
    pub(crate) block_of: Vec<[u32; 3]>,
    /// By coordinates of the block.
    pub(crate) members: BTreeMap<[u32; 3], Members>,
    /// The triangles that each block owns, corners by number.
    pub(crate) triangles: BTreeMap<[u32; 3], Vec<[usize; 3]>>,
}

/// The cluster of a point. Its block derives what depends on the triangles around the point.
fn lone_cluster(number: usize, point: &Point) -> Cluster {
    Cluster {
        quadric: Quadric::default(),
        position: [0.0; 3],
        lattice_position: point.position,
        cells: [point.cell; 2],
        faces: [[false; 2]; 3],
        on_border: point.on_border,
        is_locked: false,
        features: [point.s, point.f],
        leaf: TreeLeaf::Point(number),
    }
}

/// Order of blocks by their parents, then by linear index: z slowest.
fn rising_order(coords: [u32; 3]) -> [[u32; 3]; 2] {
    let [x, y, z] = coords;
    [[z >> 1, y >> 1, x >> 1], [z, y, x]]
}

impl<'a> LevelMesh<'a> {
    /// The full mesh as that of level 0: each point is a cluster.
    pub(crate) fn of_points(mesh: &'a FullMesh) -> Self {
        let mut members: BTreeMap<[u32; 3], Members> = BTreeMap::new();
        for &region in mesh.triangles.keys() {
            members.insert(region, Members::default());
        }
        for (number, point) in mesh.points.iter().enumerate() {
            let of_region = members.entry(point.region).or_default();
            of_region.clusters.push(number);
            of_region.points += 1;
        }
        Self {
            mesh,
            level: 0,
            clusters: (mesh.points.iter().enumerate())
                .map(|(number, point)| lone_cluster(number, point))
                .collect(),
            block_of: mesh.points.iter().map(|point| point.region).collect(),
            members,
            triangles: mesh.triangles.clone(),
        }
    }

    /// Whether there is no level above.
    pub(crate) fn is_last(&self) -> bool {
        self.level == last_level(&self.mesh.grid)
    }

    /// Runs the rounds of all blocks.
    pub(crate) fn build_blocks(&self) -> Vec<Block> {
        let members: Vec<_> = self.members.iter().collect();
        let build = |&(&coords, members): &(&[u32; 3], &Members)| {
            let level = self.level;
            let mut block = Block::new(self, BlockId { level, coords }, members);
            block.build();
            block
        };
        members.par_iter().map(build).collect()
    }

    /// The mesh of the next level: the clusters that remain in the blocks of this one, and the triangles that have three different ones.
    pub(crate) fn rise(&self, blocks: &[Block]) -> Self {
        let mut above = Self {
            mesh: self.mesh,
            level: self.level + 1,
            clusters: Vec::new(),
            block_of: Vec::new(),
            members: BTreeMap::new(),
            triangles: BTreeMap::new(),
        };
        // The number that each cluster of this level has in the next one.
        let mut risen = vec![0; self.clusters.len()];
        let mut children: Vec<&Block> = blocks.iter().collect();
        children.sort_by_key(|block| rising_order(block.id.coords));
        for block in children {
            let members = &self.members[&block.id.coords];
            if members.points > 0 {
                above.add_child(block, members, &mut risen);
            }
        }
        let mut owners: Vec<_> = self.triangles.iter().collect();
        owners.sort_by_key(|(coords, _)| rising_order(**coords));
        for (coords, triangles) in owners {
            let left = triangles.iter().map(|t| t.map(|c| risen[c]));
            let left = left.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
            above.triangles.entry(coords.map(|c| c >> 1)).or_default().extend(left);
        }
        above
    }

    /// Adds the remaining clusters of a block of the level below. `members`: those that the block began with; `risen`: of each cluster of
    /// that level its number in this one.
    fn add_child(&mut self, child: &Block, members: &Members, risen: &mut [usize]) {
        let coords = child.id.coords.map(|c| c >> 1);
        let own = self.members.entry(coords).or_default();
        own.points += members.points;
        let mut numbers = vec![0; members.clusters.len()];
        for at in child.left() {
            let mut cluster = child.clusters[at].clone();
            cluster.cells = cluster.cells.map(|cell| cell.map(|c| c >> 1));
            numbers[at] = self.clusters.len();
            own.clusters.push(self.clusters.len());
            self.clusters.push(cluster);
            self.block_of.push(coords);
        }
        for (&number, &root) in members.clusters.iter().zip(&child.roots) {
            risen[number] = numbers[root];
        }
    }
}
