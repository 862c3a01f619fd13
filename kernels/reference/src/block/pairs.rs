//! A round's choice of pairs: clusters that are each other's best neighbour and may merge.

use std::collections::{BTreeSet, VecDeque};

use super::Block;
use super::pair_test::by_cost;
use crate::cluster::{Vector, add, cross, dot, edge_hash, merge, penalty, subtract};

/// Triangles around a cluster that merges.
const MAX_FAN: usize = 60;
/// Cosine of the angle by which a triangle may turn.
const MIN_TURN: f32 = 0.5;
/// The same of penalised pairs.
const MIN_PENALISED_TURN: f32 = 0.0;

/// What becomes of a pair that both clusters have chosen.
enum Verdict {
    Merges,
    /// It costs more from now on, and both choose again.
    IsPenalised,
    /// Both choose again, without it.
    IsRefused,
}

impl Block {
    /// Pairs of clusters that are each other's best neighbour and pass the pair test; the smaller number first, ascending.
    pub(super) fn find_pairs(&mut self) -> Vec<[usize; 2]> {
        let pairs = self.choose_pairs();
        // The pair test compares the costs with which pairs were chosen.
        let mut failed = self.failed_pairs(&pairs);
        let rings = self.merged_rings(&pairs);
        let excluded = self.excluded_pairs(&rings);
        for pair in self.folding_pairs(&rings) {
            failed.insert(pair[0]);
            if !self.is_soft {
                self.aside.insert(pair);
            } else if !excluded.contains(&pair) {
                self.penalise(pair);
            }
        }
        failed.extend(excluded.iter().map(|pair| pair[0]));
        self.aside.extend(excluded);
        let changed: BTreeSet<usize> = pairs
            .iter()
            .flatten()
            .flat_map(|&at| self.neighbours(at).into_iter().chain([at]))
            .collect();
        self.refused.retain(|pair| !pair.iter().any(|at| changed.contains(at)));
        pairs.into_iter().filter(|pair| !failed.contains(&pair[0])).collect()
    }

    /// Pairs of clusters that are each other's best neighbour and may merge. A pair is tested once both have chosen each other. If it may
    /// not merge, both choose again, and the pair is excluded until a cluster around them merges. If it becomes penalised, both choose again with
    /// its new cost.
    fn choose_pairs(&mut self) -> Vec<[usize; 2]> {
        let mut candidates = vec![VecDeque::new(); self.clusters.len()];
        for &at in &self.alive {
            candidates[at] = self.candidates(at);
        }
        let mut pairs = BTreeSet::new();
        let mut chosen_again = self.alive.clone();
        while let Some(at) = chosen_again.pop() {
            let Some(&other) = candidates[at].front() else { continue };
            let pair = [at.min(other), at.max(other)];
            if candidates[other].front() != Some(&at) || pairs.contains(&pair) {
                continue;
            }
            match self.verdict(pair) {
                Verdict::Merges => {
                    pairs.insert(pair);
                    continue;
                }
                Verdict::IsPenalised => self.penalise(pair),
                Verdict::IsRefused => drop(self.refused.insert(pair)),
            }
            for cluster in pair {
                candidates[cluster] = self.candidates(cluster);
                chosen_again.push(cluster);
            }
        }
        pairs.into_iter().collect()
    }

    fn verdict(&self, pair: [usize; 2]) -> Verdict {
        if !self.keeps_topology(pair) {
            return Verdict::IsRefused;
        }
        let is_penalised = self.penalised.contains_key(&pair);
        let min_turn = if is_penalised { MIN_PENALISED_TURN } else { MIN_TURN };
        if !self.turns_triangles(pair, min_turn) {
            Verdict::Merges
        } else if self.is_soft && !is_penalised && !self.turns_triangles(pair, MIN_PENALISED_TURN) {
            Verdict::IsPenalised
        } else {
            Verdict::IsRefused
        }
    }

    /// Whether merging keeps the topology (the link condition).
    fn keeps_topology(&self, [a, b]: [usize; 2]) -> bool {
        let [first, second] = [a, b].map(|i| &self.clusters[i]);
        let [around_first, around_second] = [a, b].map(|i| self.fans[i].len());
        if around_first > MAX_FAN || around_second > MAX_FAN {
            return false;
        }
        let both_on_border = first.on_border && second.on_border;
        // On the border the edge between them has to lie on it as well.
        if both_on_border && self.fans[a].iter().filter(|t| t.contains(&b)).count() != 1 {
            return false;
        }
        let of_second = self.neighbours(b);
        let common = self
            .neighbours(a)
            .into_iter()
            .filter(|v| *v != b && of_second.contains(v));
        if common.count() != if both_on_border { 1 } else { 2 } {
            return false;
        }
        // A tetrahedron, or a triangle alone.
        let smallest = if both_on_border { 1 } else { 3 };
        !(around_first == smallest && around_second == smallest)
    }

    /// Whether merging turns a triangle around a pair by an angle of a smaller cosine.
    fn turns_triangles(&self, [a, b]: [usize; 2], min_cosine: f32) -> bool {
        let to = add(self.position(a), merge(&self.clusters[a], &self.clusters[b]).to);
        self.turns_triangle(a, b, to, min_cosine) || self.turns_triangle(b, a, to, min_cosine)
    }

    /// Whether a triangle around a cluster, except those with `other`, turns too far if the cluster moves to `to`.
    fn turns_triangle(&self, at: usize, other: usize, to: Vector, min_cosine: f32) -> bool {
        let from = self.position(at);
        self.fans[at].iter().filter(|t| !t.contains(&other)).any(|&[p, q]| {
            let [at_p, at_q] = [self.position(p), self.position(q)];
            let [before, after] = [from, to].map(|x| cross(subtract(at_p, x), subtract(at_q, x)));
            let turn = dot(before, after);
            turn < 0.0 || turn * turn < min_cosine * min_cosine * dot(before, before) * dot(after, after)
        })
    }

    /// The neighbours with which a cluster may merge by their costs, the minimum cost first; for equal costs the smaller hash decides.
    fn candidates(&self, at: usize) -> VecDeque<usize> {
        if self.clusters[at].is_locked {
            return VecDeque::new();
        }
        let mut candidates = Vec::new();
        for other in self.neighbours(at).into_iter().filter(|&v| self.is_own(v)) {
            let (a, b) = (at.min(other), at.max(other));
            let cost = self.cost(a, b);
            if cost < f32::INFINITY && !self.aside.contains(&[a, b]) && !self.refused.contains(&[a, b]) {
                candidates.push((cost, edge_hash(a, b), other));
            }
        }
        candidates.sort_unstable_by(|x, y| by_cost(x.0, y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        candidates.into_iter().map(|(_, _, other)| other).collect()
    }

    /// Cost of merging two clusters. At soft levels its lowest bit says whether the pair is penalised.
    pub(super) fn cost(&self, a: usize, b: usize) -> f32 {
        let pair = [a.min(b), a.max(b)];
        if let Some(&cost) = self.penalised.get(&pair) {
            return cost;
        }
        let [first, second] = pair.map(|i| &self.clusters[i]);
        let cost = merge(first, second).cost;
        if self.is_soft {
            f32::from_bits(cost.abs().to_bits() & !1)
        } else {
            cost
        }
    }

    /// Lets a pair turn and fold triangles further, at a higher cost.
    fn penalise(&mut self, pair: [usize; 2]) {
        let [first, second] = pair.map(|i| &self.clusters[i]);
        let cost = self.cost(pair[0], pair[1]) + penalty(first, second);
        self.penalised.insert(pair, f32::from_bits(cost.to_bits() | 1));
    }
}
