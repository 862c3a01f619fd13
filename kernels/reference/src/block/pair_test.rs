//! The tests of a round's pairs together, before they merge.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use super::{Block, Fan};
use crate::cluster::{Vector, add, cross, dot, merge, subtract};

/// Minus the cosine between the normals of two triangles that share an edge, around a cluster that has merged.
const MAX_FOLD: f32 = 0.8;

/// What is around a pair if all pairs merge.
pub(super) struct MergedRing {
    pair: [usize; 2],
    is_open: bool,
    /// Counter-clockwise, each with its position.
    corners: Vec<(usize, Vector)>,
    /// Position of the merged cluster.
    centre: Vector,
}

impl MergedRing {
    fn folds(&self) -> bool {
        let mut corners = self.corners.clone();
        if !self.is_open {
            corners.extend_from_within(..2.min(corners.len()));
        }
        let normals: Vec<Vector> = corners
            .windows(2)
            .map(|pair| cross(subtract(pair[0].1, self.centre), subtract(pair[1].1, self.centre)))
            .collect();
        normals.windows(2).any(|pair| folds_back(pair[0], pair[1]))
    }
}

impl Block {
    /// The corners around each pair if all pairs merge: in its ring, neighbours merged, each with its position.
    pub(super) fn merged_rings(&self, pairs: &[[usize; 2]]) -> Vec<MergedRing> {
        let merged: BTreeMap<usize, (usize, Vector)> = pairs
            .iter()
            .flat_map(|&[a, b]| {
                let [first, second] = [a, b].map(|i| &self.clusters[i]);
                let position = add(first.position, merge(first, second).to);
                [a, b].map(|i| (i, (a, position)))
            })
            .collect();
        let after = |v: usize| merged.get(&v).copied().unwrap_or((v, self.position(v)));
        let ring = |&[a, b]: &[usize; 2]| {
            let is_open = self.clusters[a].on_border || self.clusters[b].on_border;
            let mut corners: Vec<_> = self.joined_ring(a, b, is_open).into_iter().map(after).collect();
            corners.dedup_by_key(|corner| corner.0);
            if !is_open && corners.len() > 1 && corners[0].0 == corners[corners.len() - 1].0 {
                corners.pop();
            }
            MergedRing {
                pair: [a, b],
                is_open,
                corners,
                centre: after(a).1,
            }
        };
        pairs.iter().map(ring).collect()
    }

    /// Pairs, except penalised ones, that fold the surface if all pairs merge: around the merged cluster, one triangle folds back over the next.
    pub(super) fn folding_pairs(&self, rings: &[MergedRing]) -> Vec<[usize; 2]> {
        let tested = rings.iter().filter(|ring| !self.penalised.contains_key(&ring.pair));
        tested.filter(|ring| ring.folds()).map(|ring| ring.pair).collect()
    }

    /// Pairs that would meet other blocks along more than one line, or could be left with fewer than three neighbours once these have merged.
    pub(super) fn excluded_pairs(&self, rings: &[MergedRing]) -> Vec<[usize; 2]> {
        let is_excluded = |ring: &&MergedRing| {
            let others: Vec<bool> = ring.corners.iter().map(|corner| !self.is_own(corner.0)).collect();
            let before_first = !ring.is_open && others.last().copied().unwrap_or(false);
            let before = [before_first].into_iter().chain(others.iter().copied());
            let lines = before.zip(&others).filter(|&(before, &other)| other && !before).count();
            let own = others.iter().filter(|&&other| !other).count();
            lines > 1 || (!ring.is_open && own + lines < 3)
        };
        rings.iter().filter(is_excluded).map(|ring| ring.pair).collect()
    }

    /// The ring around two neighbours, counter-clockwise; on the border from one end to the other.
    fn joined_ring(&self, a: usize, b: usize, is_open: bool) -> Vec<usize> {
        let steps: BTreeMap<usize, usize> = [(a, b), (b, a)]
            .into_iter()
            .flat_map(|(own, other)| self.fans[own].iter().filter(move |t| !t.contains(&other)))
            .map(|&[p, q]| (p, q))
            .collect();
        let is_end = |p: &&usize| !is_open || steps.values().all(|q| q != *p);
        let start = steps.keys().find(is_end).copied();
        let mut ring: Vec<usize> = std::iter::successors(start, |p| steps.get(p).copied())
            .take(steps.len() + 1)
            .collect();
        if !is_open {
            ring.truncate(steps.len());
        }
        ring
    }

    /// The pair test: first clusters of pairs that would keep too few triangles, would close the border, or would meet another pair along
    /// more than one line and cost more than that.
    pub(super) fn failed_pairs(&self, pairs: &[[usize; 2]]) -> BTreeSet<usize> {
        let second_to_first: BTreeMap<usize, usize> = pairs.iter().map(|&[a, b]| (b, a)).collect();
        let costs: BTreeMap<usize, f32> = pairs.iter().map(|&[a, b]| (a, self.cost(a, b))).collect();
        let merged = |v: usize| second_to_first.get(&v).copied().unwrap_or(v);
        let mut failed = BTreeSet::new();
        for &[a, b] in pairs {
            let all: Fan = [a, b]
                .iter()
                .flat_map(|&i| &self.fans[i])
                .map(|t| t.map(merged))
                .collect();
            let left: Fan = all
                .iter()
                .copied()
                .filter(|&[p, q]| p != a && q != a && p != q)
                .collect();
            let on_border = self.clusters[a].on_border || self.clusters[b].on_border;
            // On the border one triangle is enough, but the border may not close.
            let ring = self.joined_ring(a, b, on_border);
            let is_closed = ring.first().map(|&v| merged(v)) == ring.last().map(|&v| merged(v));
            if if on_border { is_closed } else { left.len() < 3 } {
                failed.insert(a);
            }
            for other in all.iter().map(|t| t[0]).filter(|v| *v != a && costs.contains_key(v)) {
                let lines = [0, 1].map(|side| left.iter().filter(|t| t[side] == other).count());
                if lines.into_iter().max() > Some(1) {
                    let order = by_cost(costs[&a], costs[&other]).then(a.cmp(&other));
                    failed.insert(if order == Ordering::Greater { a } else { other });
                }
            }
        }
        failed
    }
}

/// Whether one of two triangles that share an edge folds back over the other. `a`, `b`: their normals.
fn folds_back(a: Vector, b: Vector) -> bool {
    let product = dot(a, b);
    product < 0.0 && product * product > MAX_FOLD * MAX_FOLD * dot(a, a) * dot(b, b)
}

/// Order of costs: finite numbers; a zero may have either sign.
pub(super) fn by_cost(x: f32, y: f32) -> Ordering {
    x.partial_cmp(&y).unwrap_or(Ordering::Equal)
}
