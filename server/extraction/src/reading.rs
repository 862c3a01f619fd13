//! Reads fields in the pieces in which they are sent to the device.

use isopeel_kernels::{DeviceKind, Samples};
use isopeel_view::Mask;
use isopeel_volumes::{Field, FileLocation, FileStamp, PIECE_SAMPLES, ReadError, ReadProgress, VolumeStep};

use super::keys::{VolumeKey, values_inside};
use super::{WorkError, fields};

/// Number of copies in memory of a field that is not sent in pieces: the samples as read, as masked or padded, and as sent to the device.
const WHOLE_COPIES: u64 = 3;
/// Number of pieces in memory: one is being read, one waits, and one is being sent to the device.
const HELD_PIECES: u64 = 3;

/// The next samples of a field, and the value of missing ones, which is the same in all pieces.
pub struct Piece {
    /// The samples.
    pub samples: Samples,
    /// Value of missing samples, if there is one.
    pub missing: Option<f32>,
}

/// Returns the bytes of the host's memory that a field takes while it is read. Includes the samples on the device if the device uses the
/// host's memory.
///
/// # Errors
/// There is no such field.
pub fn bytes_while_read(volume: &VolumeStep, key: &VolumeKey, device: DeviceKind) -> Result<u64, WorkError> {
    let samples = volume.dataset().geometry.sample_count();
    let samples_on_host = if key.padded || key.mask.is_some() {
        // The inputs of a computed field are in memory too.
        let inputs =
            fields::parse_expression(volume.dataset(), &key.field).map_or(0, |parsed| parsed.fields.len() as u64);
        samples.saturating_mul(WHOLE_COPIES + inputs)
    } else {
        samples.min(HELD_PIECES * PIECE_SAMPLES as u64)
    };
    let samples_on_device = if device == DeviceKind::Cpu { samples } else { 0 };
    Ok((samples_on_host.saturating_add(samples_on_device)).saturating_mul(key.sample_bytes(volume)? as u64))
}

/// Maximum number of files whose stamps are compared before and after reading a time step.
const MAX_STAMPS: usize = 4096;

/// Returns the files from which a field and its mask are read, with their stamps.
fn stamps(volume: &VolumeStep, key: &VolumeKey) -> Vec<(FileLocation, Option<FileStamp>)> {
    let field = key.field_of(volume).ok();
    let labels = key.mask_of(volume).ok().flatten().map(|(_, labels)| labels);
    let inputs = field
        .into_iter()
        .chain(labels)
        .flat_map(|field| field.source.inputs(volume.step()));
    let inputs = inputs.take(MAX_STAMPS);
    inputs
        .map(|location| {
            let stamp = location.stamp();
            (location, stamp)
        })
        .collect()
}

/// Reads a field and hands its samples on, until `sink` returns false.
///
/// # Errors
/// [`WorkError::Unreadable`], with `can_retry` if a file was written or replaced meanwhile: then the caller may read once more.
pub fn read(
    volume: &VolumeStep,
    key: &VolumeKey,
    progress: &ReadProgress,
    sink: &mut dyn FnMut(Piece) -> bool,
) -> Result<(), WorkError> {
    let before = stamps(volume, key);
    let read = read_samples(volume, key, progress, sink);
    // A file that is half written can often not be read, so read errors are checked too.
    if !matches!(read, Ok(()) | Err(WorkError::Unreadable(_))) {
        return read;
    }
    match before.iter().find(|(location, stamp)| location.stamp() != *stamp) {
        None => read,
        Some((location, _)) => {
            let why = "the file was written or replaced while it was read: try again when it is complete";
            Err(WorkError::Unreadable(ReadError {
                can_retry: true,
                ..ReadError::new(location.path(), "data", why)
            }))
        }
    }
}

/// As [`read`], without a check whether the files change meanwhile. A padded field is read as a whole, because the value of the padding
/// must be below the field's minimum. A masked field is read as a whole, because no sample inside may have the value of missing samples.
fn read_samples(
    volume: &VolumeStep,
    key: &VolumeKey,
    progress: &ReadProgress,
    sink: &mut dyn FnMut(Piece) -> bool,
) -> Result<(), WorkError> {
    let (Ok(field), Ok(mask)) = (key.field_of(volume), key.mask_of(volume)) else {
        return Ok(());
    };
    // The sink refuses a piece if the device failed or had no space. The owner of the sink reports that.
    let mut send = |samples, missing| {
        if !sink(Piece { samples, missing }) {
            progress.cancel();
        }
        Ok(())
    };
    if !key.padded && mask.is_none() {
        let mut send_piece = |samples| send(samples, field.missing);
        return Ok(field
            .source
            .read_pieces(volume.step(), progress, PIECE_SAMPLES, &mut send_piece)?);
    }
    // Reads both files concurrently.
    let (samples, inside) = rayon::join(
        || field.source.read(volume.step(), progress),
        || mask.map(|(mask, labels)| samples_inside(&mask, &labels, volume.step())),
    );
    let samples = samples?;
    let parsed = fields::parse_expression(volume.dataset(), &key.field);
    // Every sample has a distance, or none has.
    if parsed.is_some_and(|parsed| parsed.is_distance) && samples.get(0).is_nan() {
        return Err(WorkError::Edit(key.no_sample_inside_error()));
    }
    let (samples, missing) = match inside.transpose()? {
        Some(inside) => samples.masked(field.missing, |i| inside.get(i) == Some(&true)),
        None => (samples, field.missing),
    };
    let samples = if key.padded {
        samples.padded(volume.dataset().geometry.dims, missing).0
    } else {
        samples
    };
    Ok(send(samples, missing)?)
}

/// Returns for each sample whether it is inside a mask. `labels`: the mask's field.
fn samples_inside(mask: &Mask, labels: &Field, step: u32) -> Result<Vec<bool>, WorkError> {
    let values = labels.source.load(step)?;
    let inside = values_inside(mask, labels);
    let is_inside = |value| Some(value) != labels.missing && inside.holds(value);
    Ok((0..values.len()).map(|i| is_inside(values.get(i))).collect())
}
