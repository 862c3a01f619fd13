//! LZF, the fast filter of h5py (<http://oldhome.schmorp.de/marc/liblzf.html>): runs of literal bytes, and copies of earlier ones.

use hdf5_reader::error::{Error, Result};

/// The filter's number in HDF5's registry.
pub const FILTER: u16 = 32000;

/// Decodes a chunk. A copy of 3 bytes makes at most 264 bytes.
pub fn decode(data: &[u8]) -> Result<Vec<u8>> {
    decode_bytes(data).ok_or_else(|| Error::DecompressionError("lzf: the chunk is cut off or damaged".into()))
}

fn decode_bytes(mut data: &[u8]) -> Option<Vec<u8>> {
    let mut decoded = Vec::new();
    while let Some((&control, rest)) = data.split_first() {
        data = rest;
        let control = usize::from(control);
        if control < 32 {
            let (literals, rest) = data.split_at_checked(control + 1)?;
            decoded.extend_from_slice(literals);
            data = rest;
            continue;
        }
        let mut length = control >> 5;
        if length == 7 {
            let (&more, rest) = data.split_first()?;
            length += usize::from(more);
            data = rest;
        }
        let (&low, rest) = data.split_first()?;
        data = rest;
        let distance = (control & 31) << 8 | usize::from(low);
        let start = decoded.len().checked_sub(distance + 1)?;
        // Byte by byte: a copy may overlap its own output.
        for at in start..start + length + 2 {
            decoded.push(decoded[at]);
        }
    }
    Some(decoded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_may_overlap_themselves() {
        // "ab" literally, then 9 + 2 bytes from 2 back; then one byte.
        assert_eq!(
            decode(&[1, b'a', b'b', 7 << 5, 2, 1, 0, b'!']).unwrap(),
            b"ababababababa!"
        );
        assert_eq!(decode(&[0, 5, 3 << 5, 0]).unwrap(), [5; 6]);
    }

    #[test]
    fn what_is_cut_off_or_points_before_the_start_is_refused() {
        for bytes in [&[3, 1][..], &[1 << 5], &[1 << 5, 0], &[7 << 5], &[0, 5, 1 << 5, 1]] {
            assert!(decode(bytes).is_err(), "{bytes:?}");
        }
    }
}
