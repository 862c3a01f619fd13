//! A pyramid read back from the device, in the twins' terms.

use super::*;
use isopeel_reference::dual::{Corner, border_position};
use isopeel_reference::octahedral;
use std::ops::Deref;

/// A pyramid read back, with what each slot stands for.
pub struct HostPyramid {
    contents: PyramidContents,
    /// Of each slot; of an extra sheet its cell.
    pub leaves: Vec<Leaf>,
    /// Slot of every node; of a cell the slot of its first sheet.
    pub slots: HashMap<Leaf, usize>,
}

impl Deref for HostPyramid {
    type Target = PyramidContents;
    fn deref(&self) -> &PyramidContents {
        &self.contents
    }
}

impl HostPyramid {
    pub fn read(engine: &Engine, pyramid: &Pyramid) -> Self {
        let contents = testing::read_pyramid(engine, pyramid).expect("read the pyramid");
        let (grid, regions, nodes) = (&contents.grid, &contents.regions, &contents.nodes);
        let (mut leaves, mut slots) = (Vec::new(), HashMap::default());
        for region in regions {
            assert_eq!(region.slot_base as usize, leaves.len());
            for i in 0..region.level_base[7] {
                let level = (0..6).rfind(|&l| region.level_base[l] <= i && i < region.level_base[6]);
                let code = nodes[leaves.len()].meta & 0xffff;
                let leaf = leaf_of_code(grid, region.region, code);
                if let Some(level) = level {
                    assert_eq!(usize::from(leaf.level), level, "code of slot {}", leaves.len());
                    assert_eq!(slots.insert(leaf, leaves.len()), None, "{leaf:?} has one slot");
                } else {
                    assert_eq!(leaf.level, 0, "an extra sheet is a cell's");
                }
                leaves.push(leaf);
            }
        }
        assert_eq!(leaves.len(), nodes.len());
        Self {
            contents,
            leaves,
            slots,
        }
    }

    /// Puts the device's numbers into the twin's nodes.
    pub fn fill(&self, twin: &mut Twin) {
        for (level, nodes) in twin.nodes.iter_mut().enumerate() {
            for (&cube, node) in nodes.iter_mut() {
                let own = self.nodes[self.slots[&Leaf {
                    level: level as u8,
                    cube,
                }]];
                (node.count, node.s, node.f) = (own.count, own.s, own.f);
            }
        }
    }

    pub fn is_extra(&self, slot: usize) -> bool {
        self.slots[&self.leaves[slot]] != slot
    }

    /// Any cut: every node that may stand for those below it does so with a chance that `seed` decides.
    pub fn random_state(&self, seed: u64, topology: Topology) -> Vec<u8> {
        let mut random = Random(seed);
        let chance: [f32; 6] = std::array::from_fn(|_| random.unit());
        let mut state = vec![255; self.nodes.len()];
        for level in (0..6u8).rev() {
            for (&leaf, &slot) in self.slots.iter().filter(|(l, _)| l.level == level) {
                let above = Leaf {
                    level: level + 1,
                    cube: leaf.cube.map(|c| c / 2),
                };
                let node = self.nodes[slot];
                let (missing, safe) = (node.meta >> 24 & 1 == 1, node.meta >> 25 & 1 == 1);
                let may = level == 0 || (!missing && (topology == Topology::Free || safe));
                // Not in the order of the map, which differs from run to run.
                let mut own = Random(seed ^ (slot as u64) << 20);
                state[slot] = match self.slots.get(&above).map_or(255, |&s| state[s]) {
                    255 if node.count > 0 && may && (level == 0 || own.unit() < chance[usize::from(level)]) => level,
                    covered => covered,
                };
            }
        }
        for slot in 0..state.len() {
            state[slot] = state[self.slots[&self.leaves[slot]]];
        }
        state
    }

    /// The twin's form of a cut.
    pub fn cut(&self, twin: &Twin, state: &[u8]) -> Cut {
        let mut cut = Cut::default();
        for &cell in twin.cells.keys() {
            let level = state[self.slots[&Leaf { level: 0, cube: cell }]];
            let leaf = Leaf {
                level,
                cube: cell.map(|c| c >> level),
            };
            cut.leaf_of.insert(cell, leaf);
            cut.leaves.insert(leaf, twin.nodes[usize::from(level)][&leaf.cube]);
        }
        cut
    }

    /// Slots whose vertex a cut has.
    pub fn vertices(&self, state: &[u8]) -> impl Iterator<Item = usize> {
        (0..self.nodes.len()).filter(|&slot| state[slot] == self.leaves[slot].level)
    }

    /// A slot's vertex as the twin names it.
    pub fn corner(&self, slot: usize) -> Corner {
        let sheet = if self.is_extra(slot) {
            (self.nodes[slot].meta >> 26 & 3) as u8
        } else {
            0
        };
        (self.leaves[slot], sheet, 0)
    }

    /// The volume's faces that a position lies on, bit 2 axis + side.
    pub fn faces_at(&self, p: [i64; 3]) -> u8 {
        let of_axis = |i: usize| {
            let last = i64::from(self.grid.dims[i] - 1) << 16;
            u8::from(p[i] == 0) << (2 * i) | u8::from(p[i] == last) << (2 * i + 1)
        };
        (0..3).map(of_axis).sum()
    }

    /// Whether a slot's cube ends at all of these faces.
    pub fn touches(&self, slot: usize, faces: u8) -> bool {
        let leaf = self.leaves[slot];
        (0..3).all(|i| {
            let low = leaf.cube[i] == 0;
            let high = (leaf.cube[i] + 1) << leaf.level >= self.grid.dims[i] - 1;
            (faces >> (2 * i) & 1 == 0 || low) && (faces >> (2 * i + 1) & 1 == 0 || high)
        })
    }

    /// Position of the border vertex of a slot, on the lattice of [`HostPyramid::position`].
    pub fn border_position(&self, slot: usize, faces: u8) -> [i64; 3] {
        let cells = self.position(slot).map(|x| x as f32 / 65536.0);
        let [x, y] = self.vertex_records[slot]
            .normal
            .to_le_bytes()
            .map(|b| f32::from(b.cast_signed()) / 127.0);
        let normal = octahedral::decode([x, y]);
        let (leaf, sheet, _) = self.corner(slot);
        let p = border_position(&self.grid, (leaf, sheet, faces), cells, normal);
        p.map(|x| (f64::from(x) * 65536.0).round() as i64)
    }

    /// Slots of a cut's vertices by leaf.
    pub fn by_leaf(&self, state: &[u8]) -> HashMap<Leaf, Vec<usize>> {
        let mut slots: HashMap<Leaf, Vec<usize>> = HashMap::default();
        for slot in self.vertices(state) {
            slots.entry(self.leaves[slot]).or_default().push(slot);
        }
        slots
    }

    /// The border vertex at a position inside its leaf: the one whose leaf's vertex would go there; a step of the lattice either
    /// way is rounding. Of a cell of several sheets the last two bits name the sheet. Seldom there are two that near each other,
    /// which a position cannot tell apart: the case is rejected.
    pub fn border_corner(&self, by_leaf: &HashMap<Leaf, Vec<usize>>, p: [i64; 3]) -> Result<Corner, TestCaseError> {
        let faces = self.faces_at(p);
        let cell: [u32; 3] = std::array::from_fn(|i| (p[i] >> 16).min(i64::from(self.grid.dims[i]) - 2) as u32);
        let is_there = |slot: &usize| {
            let q = self.border_position(*slot, faces);
            let (_, sheet, _) = self.corner(*slot);
            let several = self.nodes[*slot].meta >> 26 & 3 != 0;
            let is_near = |i: usize| {
                if several && faces >> (2 * i) & 3 == 0 {
                    p[i] >> 5 & 3 == i64::from(sheet) && (-64..128 + 64).contains(&(q[i] - (p[i] & !127)))
                } else {
                    (p[i] - q[i]).abs() <= 64
                }
            };
            faces != 0 && self.touches(*slot, faces) && (0..3).all(is_near)
        };
        let leaves = (0..6).filter_map(|level| {
            let cube = cell.map(|c| c >> level);
            by_leaf.get(&Leaf { level, cube })
        });
        let found: Vec<usize> = leaves.flatten().copied().filter(is_there).collect();
        prop_assert!(!found.is_empty(), "{:?} is a vertex of the cut or on its border", p);
        prop_assume!(found.len() == 1, "two border vertices at one position");
        let (leaf, sheet, _) = self.corner(found[0]);
        Ok((leaf, sheet, faces))
    }

    /// Position of the vertex of a slot, from the volume's first sample in 1/[`Vertex::LATTICE`] cell.
    pub fn position(&self, slot: usize) -> [i64; 3] {
        let region = self.leaves[slot].region();
        let at = self.vertex_records[slot].position;
        std::array::from_fn(|i| (i64::from(region[i]) << 21) + (i64::from(at[i]) << 5))
    }
}

/// Index of a region along each axis.
pub fn region_at(grid: &Grid, linear: u32) -> [u32; 3] {
    let [rx, ry, _] = grid.regions();
    [linear % rx, linear / rx % ry, linear / rx / ry]
}

/// The cell, cube or brick of a Morton number, up to five bits an axis.
pub fn unmorton(morton: u32) -> [u32; 3] {
    [0, 1, 2].map(|axis| (0..5).map(|i| (morton >> (3 * i + axis) & 1) << i).sum())
}

/// The node that a code in a region stands for: its Morton number behind a leading one.
fn leaf_of_code(grid: &Grid, region: u32, code: u32) -> Leaf {
    let bits = 31 - code.leading_zeros();
    assert_eq!(bits % 3, 0);
    let level = 5 - (bits / 3) as u8;
    let (at, within) = (region_at(grid, region), unmorton(code ^ 1 << bits));
    Leaf {
        level,
        cube: std::array::from_fn(|i| (at[i] << (5 - level)) + within[i]),
    }
}
