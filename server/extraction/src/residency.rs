//! A cache with a budget. It is written by hand, because libraries bound the number of entries or evict on insertion. Here the bytes of the
//! next entry must be free before the entry is made.

use std::hash::Hash;

/// Least-recently-used cache: values by key, each with a cost. The entries are a list, the most recently used last. With at most some
/// thousand entries and a few look-ups a job, a list is fast enough.
pub struct Lru<K, V> {
    entries: Vec<(K, u64, V)>,
    budget: u64,
    /// Number of most recently used entries that stay even above the budget.
    min_entries: usize,
}

impl<K: Eq + Hash, V> Lru<K, V> {
    /// Creates a cache of entries with a total cost of at most `budget`.
    pub fn new(budget: u64) -> Self {
        Self {
            entries: Vec::new(),
            budget,
            min_entries: 1,
        }
    }

    /// Returns the cache with another limit: the `min_entries` most recently used entries stay even if they cost more than the budget.
    pub fn keeping(self, min_entries: usize) -> Self {
        Self { min_entries, ..self }
    }

    /// Returns the maximum cost of all entries together.
    pub fn budget(&self) -> u64 {
        self.budget
    }

    /// Returns the cost of all entries together.
    pub fn cost(&self) -> u64 {
        self.entries.iter().map(|entry| entry.1).sum()
    }

    /// Returns a value without marking it as used.
    pub fn peek(&self, key: &K) -> Option<&V> {
        self.entries.iter().find(|entry| entry.0 == *key).map(|entry| &entry.2)
    }

    /// Returns a value, and marks it as used.
    pub fn get(&mut self, key: &K) -> Option<&V> {
        let index = self.entries.iter().position(|entry| entry.0 == *key)?;
        let end = self.entries.len();
        self.entries[index..end].rotate_left(1);
        self.entries.last().map(|entry| &entry.2)
    }

    /// Evicts the least recently used entries for which `may_evict` returns true, until `cost` fits into the budget
    /// beside the remaining entries.
    pub fn evict_for(&mut self, cost: u64, may_evict: impl Fn(&K) -> bool) {
        let mut total: u64 = self.entries.iter().map(|entry| entry.1).sum();
        // `entries` counts the new entry too.
        let (budget, mut entries) = (self.budget, self.entries.len() + 1);
        self.entries.retain(|(key, bytes, _)| {
            let is_evicted = total.saturating_add(cost) > budget && entries > self.min_entries && may_evict(key);
            if is_evicted {
                total -= bytes;
                entries -= 1;
            }
            !is_evicted
        });
    }

    /// Evicts the least recently used entries for which `may_evict` returns true, until `cost` is freed.
    pub fn free(&mut self, cost: u64, may_evict: impl Fn(&K) -> bool) {
        let mut freed = 0;
        self.entries.retain(|(key, bytes, _)| {
            let is_evicted = freed < cost && may_evict(key);
            freed += if is_evicted { *bytes } else { 0 };
            !is_evicted
        });
    }

    /// Inserts or replaces an entry as the most recently used, and evicts others until it fits. An entry above the budget stays too,
    /// together with the other most recently used entries that always stay.
    pub fn insert(&mut self, key: K, cost: u64, value: V) {
        self.entries.retain(|entry| entry.0 != key);
        self.evict_for(cost, |_| true);
        self.add(key, cost, value);
    }

    /// As [`Lru::insert`], but evicts nothing. The caller makes space with [`Lru::evict_for`] first.
    pub fn add(&mut self, key: K, cost: u64, value: V) {
        self.entries.retain(|entry| entry.0 != key);
        self.entries.push((key, cost, value));
    }

    /// Drops the entries that `keep` rejects.
    pub fn retain(&mut self, keep: impl Fn(&K) -> bool) {
        self.entries.retain(|entry| keep(&entry.0));
    }

    /// Returns each entry's key and cost, the least recently used first.
    pub fn costs(&self) -> impl Iterator<Item = (&K, u64)> {
        self.entries.iter().map(|entry| (&entry.0, entry.1))
    }

    /// Returns the number of entries.
    pub fn entries(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::Lru;

    #[test]
    fn what_was_used_longest_ago_goes_first() {
        let mut lru = Lru::new(10);
        lru.insert('a', 4, 1);
        lru.insert('b', 4, 2);
        assert_eq!(lru.get(&'a'), Some(&1));
        lru.insert('c', 4, 3);
        assert_eq!(lru.peek(&'b'), None);
        assert_eq!((lru.peek(&'a'), lru.peek(&'c')), (Some(&1), Some(&3)));
    }

    #[test]
    fn peeking_is_not_using() {
        let mut lru = Lru::new(2);
        lru.insert('a', 1, 1);
        lru.insert('b', 1, 2);
        lru.peek(&'a');
        lru.insert('c', 1, 3);
        assert_eq!(lru.peek(&'a'), None);
    }

    #[test]
    fn what_may_not_go_stays() {
        let mut lru = Lru::new(10);
        lru.insert('a', 4, 1);
        lru.insert('b', 4, 2);
        lru.evict_for(6, |key| *key != 'a');
        assert_eq!((lru.peek(&'a'), lru.peek(&'b')), (Some(&1), None));
    }

    #[test]
    fn freeing_drops_no_more_than_it_has_to() {
        let mut lru = Lru::new(10);
        for key in ['a', 'b', 'c', 'd'] {
            lru.insert(key, 2, key);
        }
        lru.free(3, |key| *key != 'b');
        assert_eq!(lru.costs().map(|(key, _)| *key).collect::<Vec<_>>(), ['b', 'd']);
        lru.free(0, |_| true);
        assert_eq!(lru.entries(), 2);
    }

    #[test]
    fn replacing_frees_the_old_cost_first() {
        let mut lru = Lru::new(10);
        lru.insert('a', 5, 1);
        lru.insert('b', 5, 2);
        lru.insert('b', 5, 3);
        assert_eq!((lru.peek(&'a'), lru.peek(&'b')), (Some(&1), Some(&3)));
    }

    #[test]
    fn what_is_larger_than_the_budget_stays_alone() {
        let mut lru = Lru::new(10);
        lru.insert('a', 1, 1);
        lru.insert('b', 99, 2);
        assert_eq!((lru.entries(), lru.peek(&'b')), (1, Some(&2)));
    }

    #[test]
    fn what_was_used_last_stays_whatever_it_costs() {
        let mut lru = Lru::new(0);
        lru.insert('a', 1, 1);
        assert_eq!(lru.get(&'a'), Some(&1));
        let mut lru = Lru::new(10).keeping(2);
        lru.insert('a', 8, 1);
        lru.insert('b', 8, 2);
        assert_eq!((lru.peek(&'a'), lru.peek(&'b')), (Some(&1), Some(&2)));
        lru.get(&'a');
        lru.insert('c', 8, 3);
        assert_eq!(
            (lru.peek(&'a'), lru.peek(&'b'), lru.peek(&'c')),
            (Some(&1), None, Some(&3))
        );
    }
}
