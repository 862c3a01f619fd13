//! Floats of HDF5 that are longer than doubles.

use hdf5_reader::ByteOrder;

/// A float that is longer than a double, as C's `long double` on several processors; openPMD-api writes positions so.
pub(super) struct LongFloat {
    pub(super) bytes: usize,
    order: ByteOrder,
    /// First bit and count of bits of the exponent; the mantissa's follow.
    exponent: [u32; 2],
    mantissa: [u32; 2],
    sign: u32,
    bias: i32,
    /// Whether the leading digit, which is 1, is stored.
    has_first_digit: bool,
}

impl LongFloat {
    /// Parses a type as in the file; see `check_float` in `hdf5`.
    pub(super) fn parse(encoded: &[u8], order: ByteOrder) -> Option<Self> {
        let &[
            _,
            flags,
            sign,
            _,
            bytes,
            0,
            0,
            0,
            _,
            _,
            _,
            _,
            exponent,
            bits,
            mantissa,
            digits,
            b0,
            b1,
            b2,
            b3,
            ..,
        ] = encoded
        else {
            return None;
        };
        let fits = |at: u8, count: u8| u32::from(at) + u32::from(count) <= 8 * u32::from(bytes) && count > 0;
        let is_known = (10..=16).contains(&bytes)
            && digits < 128
            && fits(exponent, bits)
            && fits(mantissa, digits)
            && fits(sign, 1)
            && bits < 31;
        is_known.then_some(Self {
            bytes: bytes.into(),
            order,
            exponent: [exponent.into(), bits.into()],
            mantissa: [mantissa.into(), digits.into()],
            sign: sign.into(),
            bias: i32::from_le_bytes([b0, b1, b2, b3]),
            has_first_digit: flags & 0x30 != 0x20,
        })
    }

    pub(super) fn value(&self, bytes: &[u8]) -> f64 {
        let shift = |all: u128, byte: &u8| all << 8 | u128::from(*byte);
        let all = match self.order {
            ByteOrder::LittleEndian => bytes.iter().rev().fold(0, shift),
            ByteOrder::BigEndian => bytes.iter().fold(0, shift),
        };
        let part = |[first, count]: [u32; 2]| (all >> first) & ((1u128 << count) - 1);
        let (exponent, mantissa) = (part(self.exponent) as i32, part(self.mantissa));
        let [_, digits] = self.mantissa;
        let fraction = mantissa as f64 / 2f64.powi(digits as i32 - i32::from(self.has_first_digit));
        let size = match exponent {
            0 => 0.0,
            _ if exponent as u128 == (1u128 << self.exponent[1]) - 1 => f64::NAN,
            _ => {
                (fraction + f64::from(u8::from(!self.has_first_digit))) * 2f64.powi(exponent.saturating_sub(self.bias))
            }
        };
        if all >> self.sign & 1 == 1 { -size } else { size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_doubles_are_numbers() {
        // Of 80 bits in 16 bytes, as x86 has them, and of 128 bits.
        let extended = [
            0x31, 0x10, 79, 0, 16, 0, 0, 0, 0, 0, 80, 0, 64, 15, 0, 64, 0xff, 0x3f, 0, 0,
        ];
        let kind = LongFloat::parse(&extended, ByteOrder::LittleEndian).expect("a type");
        let mut half = [0; 16];
        (half[7], half[8], half[9]) = (0x80, 0xfe, 0xbf);
        assert_eq!(kind.value(&half), -0.5);
        assert_eq!(kind.value(&[0; 16]), 0.0);
        let quad = [
            0x31, 0x20, 127, 0, 16, 0, 0, 0, 0, 0, 128, 0, 112, 15, 0, 112, 0xff, 0x3f, 0, 0,
        ];
        let kind = LongFloat::parse(&quad, ByteOrder::BigEndian).expect("a type");
        let mut three = [0; 16];
        (three[0], three[1], three[2]) = (0x40, 0x00, 0x80);
        assert_eq!(kind.value(&three), 3.0);
        assert!(LongFloat::parse(&[0; 20], ByteOrder::BigEndian).is_none());
    }
}
