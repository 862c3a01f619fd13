//! Chunks in shards: finds the file of a chunk, and its place in that file
//! (<https://github.com/google/neuroglancer/blob/master/src/datasource/precomputed/sharded.md>).

use serde::Deserialize;

/// Maximum bits of the numbers of shards and minishards: more than any volume that is read has chunks.
const MAX_BITS: u32 = 40;

/// Distribution of chunks over shards.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Sharding {
    #[serde(rename = "@type")]
    kind: String,
    preshift_bits: u32,
    hash: String,
    minishard_bits: u32,
    shard_bits: u32,
    #[serde(default)]
    minishard_index_encoding: Option<String>,
    #[serde(default)]
    data_encoding: Option<String>,
}

/// Shard and minishard in which a chunk is looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Minishard {
    pub(super) shard: u64,
    pub(super) number: u64,
}

/// Position of a chunk in its shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    id: u64,
    /// Offset from the beginning of the file.
    pub(super) start: u64,
    pub(super) bytes: u64,
}

impl Sharding {
    pub(super) fn check(&self) -> Result<(), String> {
        if self.kind != "neuroglancer_uint64_sharded_v1" {
            return Err(format!(
                "@type {:?}, expected neuroglancer_uint64_sharded_v1",
                self.kind
            ));
        }
        if !matches!(self.hash.as_str(), "identity" | "murmurhash3_x86_128") {
            return Err(format!(
                "hash {:?}, expected identity or murmurhash3_x86_128",
                self.hash
            ));
        }
        let bits = [self.preshift_bits, self.minishard_bits, self.shard_bits];
        if bits.iter().any(|&bits| bits > MAX_BITS) || self.minishard_bits + self.shard_bits > 63 {
            let why = "expected 40 at most of preshift_bits, minishard_bits and shard_bits, and 63 of the latter two together";
            return Err(format!("{bits:?} bits, {why}"));
        }
        for encoding in [&self.minishard_index_encoding, &self.data_encoding] {
            match encoding.as_deref() {
                None | Some("raw" | "gzip") => {}
                Some(other) => return Err(format!("encoding {other:?}, expected raw or gzip")),
            }
        }
        Ok(())
    }

    /// Whether indices are compressed.
    pub(super) fn has_packed_index(&self) -> bool {
        self.minishard_index_encoding.as_deref() == Some("gzip")
    }

    /// Returns the bytes of the index at the beginning of a shard.
    pub(super) fn index_bytes(&self) -> u64 {
        16 << self.minishard_bits
    }

    pub(super) fn minishard(&self, id: u64) -> Minishard {
        let shifted = id >> self.preshift_bits;
        let hashed = match self.hash.as_str() {
            "identity" => shifted,
            _ => murmurhash3_x86_128(shifted),
        };
        Minishard {
            shard: hashed >> self.minishard_bits & ((1 << self.shard_bits) - 1),
            number: hashed & ((1 << self.minishard_bits) - 1),
        }
    }

    /// Returns the name of a shard's file.
    pub(super) fn file(&self, shard: u64) -> String {
        format!("{shard:0width$x}.shard", width = self.shard_bits.div_ceil(4) as usize)
    }

    /// Parses the decoded index of a minishard: its chunks by their numbers.
    pub(super) fn entries(&self, index: &[u8]) -> Result<Vec<Entry>, String> {
        if !index.len().is_multiple_of(24) {
            return Err(format!("an index of {} bytes, expected 24 for each chunk", index.len()));
        }
        let count = index.len() / 24;
        let number = |row: usize, i: usize| {
            let at = 8 * (row * count + i);
            u64::from_le_bytes(std::array::from_fn(|byte| index[at + byte]))
        };
        let (mut id, mut end) = (0u64, self.index_bytes());
        let mut entries = Vec::with_capacity(count);
        for i in 0..count {
            // The numbers of chunks are stored as differences, and so are their positions; sums are modulo 2^64.
            id = id.wrapping_add(number(0, i));
            let (start, bytes) = (end.wrapping_add(number(1, i)), number(2, i));
            end = start.wrapping_add(bytes);
            entries.push(Entry { id, start, bytes });
        }
        entries.sort_unstable_by_key(|entry| entry.id);
        Ok(entries)
    }
}

/// Finds the entry of a chunk. The entries must be sorted by number.
pub(super) fn find(entries: &[Entry], id: u64) -> Option<Entry> {
    let at = entries.binary_search_by_key(&id, |entry| entry.id).ok()?;
    Some(entries[at])
}

/// Returns the number of a chunk: the bits of its position interleaved, without bits that are 0 for all positions of the grid.
pub(super) fn compressed_morton(at: [u64; 3], grid: [u64; 3]) -> u64 {
    let (mut code, mut next) = (0, 0);
    for bit in 0..64 {
        for axis in 0..3 {
            if 1u64 << bit < grid[axis] {
                code |= (at[axis] >> bit & 1) << next;
                next += 1;
            }
        }
    }
    code
}

/// Returns the low 64 bits of MurmurHash3_x86_128 of eight bytes, seed 0 (Austin Appleby, public domain).
fn murmurhash3_x86_128(key: u64) -> u64 {
    fn mix(mut h: u32) -> u32 {
        h ^= h >> 16;
        h = h.wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^ h >> 16
    }
    // Eight bytes are less than a block of 16: they are the tail, for the first two of four lanes.
    let (low, high) = (key as u32, (key >> 32) as u32);
    let mut h1 = low.wrapping_mul(0x239b_961b).rotate_left(15).wrapping_mul(0xab0e_9789);
    let mut h2 = high.wrapping_mul(0xab0e_9789).rotate_left(16).wrapping_mul(0x38b3_4ae5);
    let (mut h3, mut h4) = (0u32, 0u32);
    for h in [&mut h1, &mut h2, &mut h3, &mut h4] {
        *h ^= 8;
    }
    let spread = |h1: &mut u32, h2: &mut u32, h3: &mut u32, h4: &mut u32| {
        *h1 = h1.wrapping_add(*h2).wrapping_add(*h3).wrapping_add(*h4);
        for h in [h2, h3, h4] {
            *h = h.wrapping_add(*h1);
        }
    };
    spread(&mut h1, &mut h2, &mut h3, &mut h4);
    (h1, h2, h3, h4) = (mix(h1), mix(h2), mix(h3), mix(h4));
    spread(&mut h1, &mut h2, &mut h3, &mut h4);
    u64::from(h1) | u64::from(h2) << 32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values by mmh3 5.3 of Python: `mmh3.hash_bytes(n.to_bytes(8, "little"), x64arch=False)[:8]`.
    #[test]
    fn hashes_are_those_of_another_program() {
        for (key, hash) in HASHES {
            assert_eq!(murmurhash3_x86_128(key), hash, "{key}");
        }
    }

    const HASHES: [(u64, u64); 5] = [
        (0x0, 0x4772_b084_e028_ae41),
        (0x1, 0xe8bd_67d6_16d4_ce9a),
        (0x7, 0xdd7c_2bae_7398_2156),
        (0x0123_4567_89ab_cdef, 0x7080_3626_4c10_9d93),
        (0xffff_ffff_ffff_ffff, 0x574f_66bd_212b_5d1a),
    ];

    #[test]
    fn bits_that_no_position_has_are_left_out() {
        assert_eq!(compressed_morton([1, 1, 1], [2, 2, 2]), 7);
        // Only the second bit of x.
        assert_eq!(compressed_morton([2, 1, 0], [4, 2, 1]), 0b110);
        assert_eq!(compressed_morton([0, 0, 5], [1, 1, 6]), 5);
        let all: std::collections::BTreeSet<u64> = (0..5 * 3 * 6)
            .map(|i| compressed_morton([i % 5, i / 5 % 3, i / 15], [5, 3, 6]))
            .collect();
        assert_eq!(all.len(), 90);
    }
}
