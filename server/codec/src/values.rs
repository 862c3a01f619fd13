//! Values of a field at the vertices of a chunk, behind its payloads. Normative: `PROTOCOL.md`, section 4.2.

/// Step of a vertex without a value.
const MISSING: u16 = u16::MAX;
/// Step of the high end of the range.
const LAST_STEP: u16 = MISSING - 1;
/// Bytes of the range.
const RANGE_BYTES: usize = 8;

/// A value on the wire. Two bytes are 0, because the vertex codec takes vertices of whole words; a constant plane takes no bytes.
#[repr(C)]
#[derive(Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
struct Word {
    step: u16,
    zero: u16,
}

/// Values as they are sent: in equal steps of a range of their own.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Values {
    low: f32,
    high: f32,
    steps: Vec<u16>,
}

impl Values {
    /// Rounds values to steps between the smallest and the largest. Values that are no finite numbers are missing. Whole numbers that differ
    /// by no more than there are steps, such as labels, stay exact.
    pub fn new(values: impl Iterator<Item = f32> + Clone) -> Self {
        let finite = values.clone().filter(|value| value.is_finite());
        let (low, mut high) = finite
            .clone()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        if low > high {
            return Self {
                low: 0.0,
                high: 0.0,
                steps: values.map(|_| MISSING).collect(),
            };
        }
        let steps = f64::from(LAST_STEP);
        let whole_end = (f64::from(low) + steps) as f32;
        if high <= whole_end
            && f64::from(whole_end) - f64::from(low) == steps
            && finite.clone().all(|x| x.fract() == 0.0)
        {
            high = whole_end;
        }
        let per_value = match high > low {
            true => steps / (f64::from(high) - f64::from(low)),
            false => 0.0,
        };
        let step = |value: f32| match value.is_finite() {
            true => ((f64::from(value) - f64::from(low)) * per_value).round() as u16,
            false => MISSING,
        };
        Self {
            low,
            high,
            steps: values.map(step).collect(),
        }
    }

    /// Returns the values in another order, which gives for each its number in this one.
    pub fn in_order(&self, order: &[u32]) -> Self {
        Self {
            steps: order.iter().map(|&number| self.steps[number as usize]).collect(),
            ..*self
        }
    }

    /// Returns the bytes behind the payloads.
    ///
    /// # Errors
    /// The vertex codec fails, which needs a fault of this program.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let words: Vec<Word> = self.steps.iter().map(|&step| Word { step, zero: 0 }).collect();
        let coded =
            meshopt::encode_vertex_buffer_level(&words, 2, Some(1)).map_err(|error| format!("values: {error}"))?;
        let mut bytes = Vec::with_capacity(RANGE_BYTES + coded.len());
        bytes.extend_from_slice(&self.low.to_le_bytes());
        bytes.extend_from_slice(&self.high.to_le_bytes());
        bytes.extend_from_slice(&coded);
        Ok(bytes)
    }

    /// Reads the bytes behind the payloads. Safe on any bytes.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(bytes: &[u8], vertices: usize) -> Result<Self, String> {
        let Some((range, coded)) = bytes.split_first_chunk::<RANGE_BYTES>() else {
            let found = bytes.len();
            return Err(format!("values in {found} bytes, expected 8 or more"));
        };
        let [low, high]: [f32; 2] = bytemuck::cast(*range);
        if !(low.is_finite() && high.is_finite() && low <= high) {
            return Err(format!(
                "values from {low} to {high}, expected finite numbers in ascending order"
            ));
        }
        let words: Vec<Word> =
            meshopt::decode_vertex_buffer(coded, vertices).map_err(|error| format!("values: {error}"))?;
        Ok(Self {
            low,
            high,
            steps: words.iter().map(|word| word.step).collect(),
        })
    }

    /// Returns the value of each vertex; NaN if it has none.
    pub fn to_vec(&self) -> Vec<f32> {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        let value = |&step: &u16| match step {
            MISSING => f32::NAN,
            step => (low + f64::from(step) / f64::from(LAST_STEP) * (high - low)) as f32,
        };
        self.steps.iter().map(value).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::Values;

    fn sent(values: &[f32]) -> Vec<f32> {
        let bytes = Values::new(values.iter().copied()).to_bytes().expect("encodes");
        Values::parse(&bytes, values.len()).expect("decodes").to_vec()
    }

    #[test]
    fn values_are_exact_to_a_step_of_their_range() {
        let values: Vec<f32> = (0..5000).map(|i| -3.0 + (i as f32 * 0.37).sin() * 250.0).collect();
        for (sent, value) in sent(&values).iter().zip(&values) {
            assert!(
                (sent - value).abs() <= 0.51 * 500.0 / 65534.0,
                "{sent}, expected {value}"
            );
        }
        assert_eq!(sent(&[2.5; 7]), [2.5; 7]);
        assert_eq!(sent(&[1e-40, f32::MAX, f32::MIN])[1..], [f32::MAX, f32::MIN]);
    }

    #[test]
    fn labels_are_exact() {
        let labels = [0.0, 2035.0, 17.0, -3.0, 1000.0, 65531.0];
        assert_eq!(sent(&labels), labels);
        let far = [16_000_000.0, 16_000_001.0, 16_065_534.0];
        assert_eq!(sent(&far), far);
    }

    #[test]
    fn what_is_missing_stays_missing() {
        let sent_values = sent(&[f32::NAN, 1.0, f32::INFINITY, 3.0]);
        assert!(sent_values[0].is_nan() && sent_values[2].is_nan());
        assert_eq!([sent_values[1], sent_values[3]], [1.0, 3.0]);
        assert!(sent(&[f32::NAN; 3]).iter().all(|value| value.is_nan()));
    }

    #[test]
    fn damaged_values_are_errors() {
        let bytes = Values::new([1.0, 2.0, 3.0].into_iter()).to_bytes().expect("encodes");
        for length in 0..bytes.len() {
            assert!(Values::parse(&bytes[..length], 3).is_err(), "{length} bytes");
        }
        let mut reversed = bytes.clone();
        reversed[..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
        let error = Values::parse(&reversed, 3).expect_err("no range");
        assert!(error.contains("values from inf"), "{error}");
    }
}
