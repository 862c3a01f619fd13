//! Limits for JPEG images, shared by the formats that contain such images.

/// Maximum scans of an image. Encoders write one scan a component, or some ten for a progressive image. Decoding a scan takes as long as
/// decoding all samples, however few bytes it has.
const MAX_SCANS: usize = 100;
/// Maximum coefficients that are kept for a progressive image, of 2 bytes each.
const MAX_COEFFICIENTS: u64 = 1 << 25;

/// Refuses an image of more scans than encoders write.
pub(super) fn check_scans(encoded: &[u8]) -> Result<(), String> {
    // Within a scan, 0xff is followed by 0 or by a restart marker. A preview in the header is counted, too.
    const SCAN: [u8; 2] = [0xff, 0xda];
    let scans = encoded.windows(SCAN.len()).filter(|bytes| *bytes == SCAN).count();
    if scans > MAX_SCANS {
        return Err(format!("a JPEG of {scans} scans, expected {MAX_SCANS} at most"));
    }
    Ok(())
}

/// Refuses a progressive image whose coefficients would take too much memory: they are kept until the last scan.
pub(super) fn check_progressive(width: u16, height: u16, channels: u32) -> Result<(), String> {
    /// Maximum samples along each side of a unit that is encoded together.
    const UNIT: u64 = 32;
    let [columns, rows] = [width, height].map(|n| u64::from(n).next_multiple_of(UNIT));
    let coefficients = columns * rows * u64::from(channels);
    if coefficients > MAX_COEFFICIENTS {
        return Err(format!(
            "a progressive JPEG of {coefficients} coefficients, expected {MAX_COEFFICIENTS} at most"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_counted() {
        let scans = |count: usize| [0xff, 0xff, 0xda, 0, 8, 0xff, 0].repeat(count);
        assert_eq!(check_scans(&scans(MAX_SCANS)), Ok(()));
        let error = check_scans(&scans(MAX_SCANS + 1)).unwrap_err();
        assert!(error.contains("101 scans, expected 100 at most"), "{error}");
    }

    #[test]
    fn padding_counts_as_coefficients() {
        assert_eq!(check_progressive(4096, 8192, 1), Ok(()));
        assert!(check_progressive(4096, 8193, 1).is_err());
        assert!(check_progressive(4096, 4096, 3).is_err());
        assert!(check_progressive(1, 65_535, 16).is_ok());
        assert!(check_progressive(33, 65_535, 16).is_err());
    }
}
