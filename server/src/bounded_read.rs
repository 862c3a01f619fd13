//! Reads of limited length.

use std::io::{self, Read};

/// Reads all bytes of `from`. Returns `None` if there are more than `limit`, of which one more is read.
///
/// # Errors
/// Errors of `from`.
pub fn read_bounded(from: impl Read, limit: usize) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    from.take(limit as u64 + 1).read_to_end(&mut bytes)?;
    Ok(Some(bytes).filter(|bytes| bytes.len() <= limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_byte_more_than_the_limit_is_accepted() {
        assert_eq!(read_bounded(&b"abc"[..], 3).unwrap(), Some(b"abc".to_vec()));
        assert_eq!(read_bounded(&b"abcd"[..], 3).unwrap(), None);
    }
}
