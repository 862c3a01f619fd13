//! Formats numbers as decimal text with a fixed number of digits. The standard library computes the shortest text of a number, which takes
//! ten times as long as the rest of writing a vertex.

use std::io::Write;

/// Maximum rounding error, as a fraction of the smallest spacing.
const PRECISION: f64 = 1e-5;
/// Maximum number of digits after the decimal point. 10 to this power fits into 64 bits.
const MAX_DIGITS: usize = 18;
/// Whole numbers below this limit are exact in 64-bit floats.
const EXACT: f64 = 9e15;

/// Format of numbers with a fixed number of digits after the decimal point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Decimals {
    digits: usize,
    /// 10 to the power of `digits`.
    scale: f64,
    /// Whether more than [`MAX_DIGITS`] digits were requested. Then numbers are written with an exponent instead.
    is_exponential: bool,
}

impl Decimals {
    /// Uses `digits` digits after the decimal point. With more than [`MAX_DIGITS`], numbers are written exactly, with an exponent.
    pub(crate) fn new(digits: usize) -> Self {
        let is_exponential = digits > MAX_DIGITS;
        let digits = digits.min(MAX_DIGITS);
        Self {
            digits,
            scale: 10f64.powi(digits as i32),
            is_exponential,
        }
    }

    /// Uses as many digits as necessary for positions on a grid with this smallest spacing. Rounding moves them by less than [`PRECISION`]
    /// times the spacing.
    pub(crate) fn of_spacing(spacing: f64) -> Self {
        let digits = -(spacing * PRECISION).log10().floor();
        Self::new(if digits.is_finite() {
            digits.max(0.0) as usize
        } else {
            0
        })
    }

    /// Returns the number that a reader parses from the text of `number`.
    pub(crate) fn rounded(self, number: f64) -> f64 {
        let scaled = (number * self.scale).round();
        if scaled.abs() >= EXACT || self.is_exponential {
            return number;
        }
        scaled / self.scale
    }

    /// Appends the text of a number. A number that is too large for 64 bits is written exactly, with an exponent.
    pub(crate) fn push(self, text: &mut Vec<u8>, number: f64) {
        let scaled = (number * self.scale).round();
        if scaled.abs() >= EXACT || self.is_exponential {
            // Cannot fail, because the target is a vector.
            let _ = write!(text, "{number:e}");
            return;
        }
        if scaled < 0.0 {
            text.push(b'-');
        }
        let (scaled, unit) = (scaled.abs() as u64, self.scale as u64);
        push_whole(text, scaled / unit);
        if self.digits > 0 {
            text.push(b'.');
            let first = text.len();
            text.resize(first + self.digits, b'0');
            let mut rest = scaled % unit;
            for digit in text[first..].iter_mut().rev() {
                *digit = b'0' + (rest % 10) as u8;
                rest /= 10;
            }
        }
    }
}

/// Appends the text of a whole number.
pub(crate) fn push_whole(text: &mut Vec<u8>, number: u64) {
    text.extend_from_slice(itoa::Buffer::new().format(number).as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(decimals: Decimals, number: f64) -> String {
        let mut text = Vec::new();
        decimals.push(&mut text, number);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn numbers_have_the_digits_that_their_spacing_needs() {
        assert_eq!(text(Decimals::new(3), -1.5), "-1.500");
        assert_eq!(text(Decimals::new(3), 0.0004), "0.000");
        assert_eq!(text(Decimals::new(0), 7.6), "8");
        assert_eq!(text(Decimals::new(2), -0.999), "-1.00");
        // Cells of 5 cm at UTM coordinates.
        assert_eq!(text(Decimals::of_spacing(0.05), 4_649_776.224_712_3), "4649776.2247123");
        assert_eq!(text(Decimals::of_spacing(1e30), 2.5e31), "2.5e31");
    }

    #[test]
    fn rounding_is_below_a_hundred_thousandth_of_the_spacing() {
        for exponent in -30..=30 {
            let spacing = 10f64.powi(exponent) * 1.7;
            for cells in [0.0, 0.3, -17.25, 511.987_654_321, 80_000.123_456] {
                let number = cells * spacing;
                let read: f64 = text(Decimals::of_spacing(spacing), number).parse().unwrap();
                assert!((read - number).abs() <= 1e-5 * spacing, "{number}: {read}");
            }
        }
    }
}
