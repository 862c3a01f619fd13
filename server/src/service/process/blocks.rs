//! Memory for the arrays of messages, which is used again for later messages.

use std::sync::{Arc, Mutex};

use bytes::Bytes;
use isopeel_extraction::lock;
use rayon::prelude::*;

use super::shared_memory::resident_slot_bytes;

/// Number of blocks for arrays that a receiver keeps for the next messages.
const KEPT_BLOCKS: usize = 2;

/// Arrays of more bytes are copied by several processors.
pub(super) const PARALLEL_BYTES: usize = 1 << 20;

/// Bytes that one task copies out of shared memory.
const PIECE_BYTES: usize = 256 << 10;

/// Blocks of memory for arrays that are not in use.
#[derive(Clone, Default)]
pub(super) struct Blocks(Arc<Mutex<Vec<Vec<u64>>>>);

/// A block with arrays. Dropping it returns its memory.
struct Block {
    words: Vec<u64>,
    length: usize,
    blocks: Blocks,
}

impl AsRef<[u8]> for Block {
    fn as_ref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.length]
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        let words = std::mem::take(&mut self.words);
        let mut kept = lock(&self.blocks.0);
        if kept.len() < KEPT_BLOCKS && words.len() <= resident_slot_bytes() / 8 {
            kept.push(words);
        }
    }
}

impl Blocks {
    /// Copies bytes to a block: many of them by all processors.
    pub(super) fn copy(&self, bytes: &[u8]) -> Bytes {
        if bytes.is_empty() {
            return Bytes::new();
        }
        let needed = bytes.len().div_ceil(8);
        let mut kept = lock(&self.0);
        let found = kept
            .iter()
            .position(|words| words.len() >= needed)
            .or(kept.len().checked_sub(1));
        let words = found
            .map(|index| kept.swap_remove(index))
            .filter(|words| words.len() >= needed);
        drop(kept);
        // Zeroed pages of the system, which the processors that copy touch first.
        let mut words = words.unwrap_or_else(|| bytemuck::zeroed_vec(needed));
        let target = &mut bytemuck::cast_slice_mut::<u64, u8>(&mut words)[..bytes.len()];
        if bytes.len() < PARALLEL_BYTES {
            target.copy_from_slice(bytes);
        } else {
            let pieces = target.par_chunks_mut(PIECE_BYTES).zip(bytes.par_chunks(PIECE_BYTES));
            pieces.for_each(|(target, bytes)| target.copy_from_slice(bytes));
        }
        Bytes::from_owner(Block {
            words,
            length: bytes.len(),
            blocks: self.clone(),
        })
    }
}
