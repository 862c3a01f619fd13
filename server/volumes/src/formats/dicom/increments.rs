//! Differences between the frames of an image of nuclear medicine: `FrameIncrementPointer` names vectors with a number for each frame
//! (part 3, C.8.4.8).

use super::data_set::{DataSet, Fault, Tag, name, tag};

/// Slice and time of each frame, as counting numbers. `None` if all frames have the same.
#[derive(Debug, Default)]
pub struct Increments {
    pub slices: Option<Vec<f64>>,
    pub times: Option<Vec<f64>>,
}

/// Vectors of times. Frames may differ in one of them.
const TIMES: [Tag; 3] = [tag::TIME_SLOTS, tag::INTERVALS, tag::TIME_SLICES];
/// If frames differ in one of these, they are no slices of one volume.
const OTHERS: [Tag; 5] = [
    tag::ENERGY_WINDOWS,
    tag::DETECTOR_NUMBERS,
    tag::PHASES,
    tag::ROTATIONS,
    tag::ANGULAR_VIEWS,
];

impl Increments {
    /// Reads the vectors of a file of `count` frames.
    pub fn of(set: &DataSet, count: u32) -> Result<Self, Fault> {
        let pointer = set.shorts(tag::FRAME_INCREMENT).unwrap_or_default();
        let named: Vec<Tag> = pointer
            .chunks_exact(2)
            .map(|tag| (tag[0] as u32) << 16 | tag[1] as u32)
            .collect();
        let differing = |tag: Tag| -> Result<Option<Vec<f64>>, Fault> {
            let numbers = if named.contains(&tag) { set.shorts(tag) } else { None };
            match numbers {
                Some(numbers) if numbers.len() != count as usize => {
                    let why = format!("{} numbers, expected one for each of {count} frames", numbers.len());
                    Err(Fault::of(tag, why))
                }
                numbers => Ok(numbers.filter(|numbers| numbers.iter().any(|number| *number != numbers[0]))),
            }
        };
        let mut found = Self {
            slices: differing(tag::SLICES)?,
            times: None,
        };
        for tag in TIMES {
            let times = differing(tag)?;
            if times.is_some() && found.times.is_some() {
                return Err(Fault::of(
                    tag,
                    "frames differ in it and in another time, expected one of them",
                ));
            }
            found.times = found.times.or(times);
        }
        for tag in OTHERS {
            if differing(tag)?.is_some() {
                let why = format!("frames differ in {}, expected slices and times", name(tag));
                return Err(Fault::of(tag::FRAME_INCREMENT, why));
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shorts(numbers: &[u16]) -> Vec<u8> {
        numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
    }

    fn pointing_at(vectors: &[(Tag, &[u16])]) -> DataSet {
        let mut set = DataSet::default();
        let pointer: Vec<u16> = vectors
            .iter()
            .flat_map(|(tag, _)| [(tag >> 16) as u16, (tag & 0xffff) as u16])
            .collect();
        set.values.insert(tag::FRAME_INCREMENT, shorts(&pointer));
        for (tag, numbers) in vectors {
            set.values.insert(*tag, shorts(numbers));
        }
        set
    }

    #[test]
    fn gated_frames_have_slices_and_times() {
        let set = pointing_at(&[
            (tag::INTERVALS, &[1, 1, 1, 1]),
            (tag::TIME_SLOTS, &[1, 1, 2, 2]),
            (tag::SLICES, &[2, 1, 2, 1]),
        ]);
        let found = Increments::of(&set, 4).unwrap();
        assert_eq!(found.slices, Some(vec![2.0, 1.0, 2.0, 1.0]));
        assert_eq!(found.times, Some(vec![1.0, 1.0, 2.0, 2.0]));
        assert_eq!(Increments::of(&set, 3).unwrap_err().field, "SliceVector");
        let none = Increments::of(&DataSet::default(), 4).unwrap();
        assert_eq!((none.slices, none.times), (None, None));
    }

    #[test]
    fn frames_that_differ_in_something_else_are_refused() {
        let set = pointing_at(&[(tag::ROTATIONS, &[1, 2]), (tag::SLICES, &[1, 1])]);
        assert!(Increments::of(&set, 2).unwrap_err().why.contains("RotationVector"));
        let set = pointing_at(&[(tag::INTERVALS, &[1, 2]), (tag::TIME_SLOTS, &[2, 1])]);
        assert_eq!(Increments::of(&set, 2).unwrap_err().field, "RRIntervalVector");
        let same = pointing_at(&[(tag::ENERGY_WINDOWS, &[1, 1]), (tag::SLICES, &[1, 2])]);
        assert!(Increments::of(&same, 2).is_ok());
    }
}
