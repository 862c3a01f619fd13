//! Adaptive binary range coder. It codes bits, each with a model of the probability of a 1. The decoder mirrors the encoder, so the
//! sequence of coded values is programmed once for both ([`Coder`]). Normative: `PROTOCOL.md`, section 4.1.

/// Bits of precision of a probability when a range is divided.
const PROBABILITY_BITS: u32 = 12;
/// Lowest probability of either bit, in units of 1/2¹².
const MIN_PROBABILITY: u32 = 16;
/// If a range is below this value, it is extended by another byte.
const MIN_RANGE: u32 = 1 << 24;
/// Number of bits after which the learning rate of a model stays constant.
const MAX_SEEN: u8 = 100;

/// Model of the probability of a 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct BitModel {
    /// Probability of a 1, in units of 1/2¹⁶.
    probability: u16,
    /// Number of bits that were coded, up to [`MAX_SEEN`].
    seen: u8,
}

impl Default for BitModel {
    fn default() -> Self {
        Self {
            probability: 1 << 15,
            seen: 0,
        }
    }
}

impl BitModel {
    /// Returns the part of a range that stands for a 1.
    fn bound(self, range: u32) -> u32 {
        let probability = u32::from(self.probability) >> (16 - PROBABILITY_BITS);
        let max = (1 << PROBABILITY_BITS) - MIN_PROBABILITY;
        (range >> PROBABILITY_BITS) * probability.clamp(MIN_PROBABILITY, max)
    }

    /// Adapts the probability to a bit. The rate is about the reciprocal of the number of bits: high at first, because chunks are short.
    fn update(&mut self, bit: bool) {
        let rate = (2 << 16) / (2 * u32::from(self.seen) + 5);
        self.seen = (self.seen + 1).min(MAX_SEEN);
        let change = |distance: u16| ((u32::from(distance) * rate) >> 16) as u16;
        if bit {
            self.probability += change(u16::MAX - self.probability);
        } else {
            self.probability -= change(self.probability);
        }
    }
}

/// An encoder or a decoder. An encoder writes the given values and returns them. A decoder ignores the given values, and returns the values
/// that it reads.
pub(super) trait Coder {
    /// Codes a bit with a model.
    fn bit(&mut self, model: &mut BitModel, bit: bool) -> bool;
    /// Codes the `bits` low bits of a value, the highest first. 0 and 1 are equally probable.
    fn raw(&mut self, bits: u32, value: u32) -> u32;
    /// Whether more bytes were read than the payload has. Always false for an encoder.
    fn is_exhausted(&self) -> bool;
}

/// Coder that writes a payload.
pub(super) struct Encoder {
    /// The low end of the range; bit 32 is a carry.
    low: u64,
    /// The size of the range.
    range: u32,
    /// The last byte that a carry may change and that is not 0xff.
    pending: u8,
    /// Number of bytes of 0xff that follow the pending byte.
    ones: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    pub fn new() -> Self {
        Self {
            low: 0,
            range: u32::MAX,
            pending: 0,
            ones: 0,
            bytes: Vec::new(),
        }
    }

    /// Completes the payload and returns it.
    pub fn finish(mut self) -> Vec<u8> {
        for _ in 0..5 {
            self.shift();
        }
        // Drops the first byte, which is always 0, because it is the initial pending byte.
        self.bytes.split_off(1)
    }

    /// Extends the range until it is large enough for the next bit.
    fn normalise(&mut self) {
        while self.range < MIN_RANGE {
            self.range <<= 8;
            self.shift();
        }
    }

    /// Shifts `low` by a byte. Writes the pending bytes, unless a carry can still change them.
    fn shift(&mut self) {
        const CARRY: u64 = 1 << 32;
        if self.low < 0xff00_0000 || self.low >= CARRY {
            let carry = (self.low >> 32) as u8;
            self.bytes.push(self.pending.wrapping_add(carry));
            let ones = std::iter::repeat_n(0xff_u8.wrapping_add(carry), self.ones as usize);
            self.bytes.extend(ones);
            (self.pending, self.ones) = ((self.low >> 24) as u8, 0);
        } else {
            self.ones += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }
}

impl Coder for Encoder {
    fn bit(&mut self, model: &mut BitModel, bit: bool) -> bool {
        let bound = model.bound(self.range);
        if bit {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        model.update(bit);
        self.normalise();
        bit
    }

    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        for bit in (0..bits).rev() {
            self.range >>= 1;
            if value >> bit & 1 == 1 {
                self.low += u64::from(self.range);
            }
            self.normalise();
        }
        value
    }

    fn is_exhausted(&self) -> bool {
        false
    }
}

/// Coder that reads a payload. Beyond the end of the payload it reads zeros.
pub(super) struct Decoder<'a> {
    /// The payload's value relative to the low end of the range.
    code: u32,
    /// The size of the range.
    range: u32,
    payload: &'a [u8],
    /// Number of bytes that were read.
    position: usize,
}

impl<'a> Decoder<'a> {
    pub fn new(payload: &'a [u8]) -> Self {
        let mut decoder = Self {
            code: 0,
            range: u32::MAX,
            payload,
            position: 0,
        };
        for _ in 0..4 {
            decoder.take_byte();
        }
        decoder
    }

    /// Whether exactly the whole payload was read.
    pub fn is_at_end(&self) -> bool {
        self.position == self.payload.len()
    }

    fn take_byte(&mut self) {
        let byte = self.payload.get(self.position).copied().unwrap_or_default();
        self.position += 1;
        self.code = self.code << 8 | u32::from(byte);
    }

    fn normalise(&mut self) {
        while self.range < MIN_RANGE {
            self.range <<= 8;
            self.take_byte();
        }
    }
}

impl Coder for Decoder<'_> {
    fn bit(&mut self, model: &mut BitModel, _: bool) -> bool {
        let bound = model.bound(self.range);
        let bit = self.code < bound;
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        model.update(bit);
        self.normalise();
        bit
    }

    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        let mut value = 0;
        for _ in 0..bits {
            self.range >>= 1;
            let bit = self.code >= self.range;
            if bit {
                self.code -= self.range;
            }
            value = value << 1 | u32::from(bit);
            self.normalise();
        }
        value
    }

    fn is_exhausted(&self) -> bool {
        self.position > self.payload.len()
    }
}

/// Model of whole numbers. It has models for the number of bits of the magnitude, for the sign, and for the two bits below the highest.
/// Further bits are coded without a model.
pub(super) struct NumberModel {
    contexts: Vec<NumberContext>,
    /// Models of the two bits below the highest, by the number of bits of the magnitude. The models of the second bit depend on the first.
    below_highest: [[BitModel; 3]; MAX_LENGTH + 1],
}

/// Maximum bits of a magnitude.
const MAX_LENGTH: usize = 20;

#[derive(Clone, Copy, Default)]
struct NumberContext {
    /// Whether the magnitude has more bits than the index.
    is_longer: [BitModel; MAX_LENGTH],
    is_negative: BitModel,
}

impl NumberModel {
    pub fn new(contexts: usize) -> Self {
        Self {
            contexts: vec![NumberContext::default(); contexts],
            below_highest: Default::default(),
        }
    }

    /// Codes a number whose magnitude is less than 2²⁰.
    pub fn code(&mut self, coder: &mut impl Coder, context: usize, value: i32) -> i32 {
        let context = &mut self.contexts[context];
        let (given, given_length) = (value.unsigned_abs(), length(value));
        let mut length = 0;
        while length < MAX_LENGTH && coder.bit(&mut context.is_longer[length], length < given_length) {
            length += 1;
        }
        if length == 0 {
            return 0;
        }
        let is_negative = coder.bit(&mut context.is_negative, value < 0);
        let models = &mut self.below_highest[length];
        let (mut magnitude, mut below) = (1, length as u32 - 1);
        let mut model = 0;
        while below > 0 && model < 3 {
            below -= 1;
            let bit = coder.bit(&mut models[model], given >> below & 1 == 1);
            magnitude = magnitude << 1 | i32::from(bit);
            model = 2 * model + 1 + usize::from(bit);
        }
        let low = coder.raw(below, given & ((1 << below) - 1));
        magnitude = magnitude << below | low as i32;
        if is_negative { -magnitude } else { magnitude }
    }
}

/// Returns the number of bits of a magnitude.
pub(super) fn length(value: i32) -> usize {
    (u32::BITS - value.unsigned_abs().leading_zeros()) as usize
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn bits_and_numbers_come_back(
            numbers in prop::collection::vec((0..3_usize, any::<i32>(), 0..32_u32), 0..400),
            skew in 0..100_u32,
        ) {
            let numbers: Vec<_> = numbers.iter().map(|&(context, value, shift)| {
                (context, (value >> shift).clamp(-(1 << 20) + 1, (1 << 20) - 1))
            }).collect();
            let bits: Vec<bool> = numbers.iter().map(|(_, value)| value.unsigned_abs() % 100 < skew).collect();
            let run = |coder: &mut dyn FnMut(usize, i32, bool) -> (i32, bool)| -> Vec<(i32, bool)> {
                numbers.iter().zip(&bits).map(|(&(context, value), &bit)| coder(context, value, bit)).collect()
            };
            let expected: Vec<_> = numbers.iter().zip(&bits).map(|(&(_, value), &bit)| (value, bit)).collect();
            let (mut encoder, mut model, mut bit_model) = (Encoder::new(), NumberModel::new(3), BitModel::default());
            run(&mut |context, value, bit| (model.code(&mut encoder, context, value), encoder.bit(&mut bit_model, bit)));
            let payload = encoder.finish();
            let (mut decoder, mut model, mut bit_model) = (Decoder::new(&payload), NumberModel::new(3), BitModel::default());
            let found = run(&mut |context, _, _| (model.code(&mut decoder, context, 0), decoder.bit(&mut bit_model, false)));
            prop_assert_eq!(found, expected);
            prop_assert!(decoder.is_at_end() && !decoder.is_exhausted());
        }
    }

    #[test]
    fn probable_bits_take_little() {
        let (mut encoder, mut model) = (Encoder::new(), BitModel::default());
        for n in 0..8000 {
            encoder.bit(&mut model, n % 100 == 0);
        }
        let bytes = encoder.finish().len();
        // The entropy is 81 bytes.
        assert!(bytes < 95, "{bytes} bytes");
    }

    #[test]
    fn carries_reach_bytes_that_wait() {
        // The highest values of raw bits keep the low end next to a carry.
        for length in 1..200 {
            let mut encoder = Encoder::new();
            for n in 0..length {
                encoder.raw(7, if n + 1 == length { 0 } else { 127 });
            }
            let payload = encoder.finish();
            let mut decoder = Decoder::new(&payload);
            let found: Vec<u32> = (0..length).map(|_| decoder.raw(7, 0)).collect();
            assert!(found[..length - 1].iter().all(|&value| value == 127) && found[length - 1] == 0);
            assert!(decoder.is_at_end());
        }
    }
}
