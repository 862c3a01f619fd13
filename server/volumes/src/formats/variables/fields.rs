//! Makes fields of a variable whose grid is known, one a channel.

use std::sync::Arc;

use super::super::super::stored::{Begin, StoredSamples};
use super::super::super::{Field, FileLocation, Findings, Geometry, ReadError, Source};
use super::super::header::Channels;
use super::file::Variable;
use super::layout::Layout;
use super::source::VariableSource;
use super::values::Values;

/// Makes the fields of a variable, one a channel.
pub(super) fn fields_of(
    location: &FileLocation,
    channels: Channels,
    variable: &Variable,
    geometry: &Geometry,
    layout: &Layout,
) -> Result<Vec<Field>, ReadError> {
    let fail = |why: String| ReadError::new(location.path(), &variable.path, why);
    let stored = variable.stored.clone().map_err(fail)?;
    let values = Values::of(variable, stored).map_err(fail)?;
    let unit = variable.text("units").filter(|&unit| unit != "1").map(str::to_owned);
    let samples = ChannelSamples::new(location, variable, &values, geometry, layout)?;
    let field = |(channel, name): (u32, String)| Field {
        name,
        stored_type: stored.name().to_owned(),
        sample_type: values.sample_type(),
        missing: values.missing(),
        unit: unit.clone(),
        labels: Vec::new(),
        declares_labels: false,
        source: samples.source(channel, values.missing()),
    };
    let names = match channels {
        Channels::Fields(names) => names,
        Channels::Luminance => Vec::new(),
    };
    Ok((0..).zip(names).map(field).collect())
}

/// The samples of a variable's channels.
enum ChannelSamples {
    /// Contiguous in the file; channels are this many samples apart.
    Plain(StoredSamples, u64),
    Decoded(VariableSource),
}

impl ChannelSamples {
    fn new(
        location: &FileLocation,
        variable: &Variable,
        values: &Values,
        geometry: &Geometry,
        layout: &Layout,
    ) -> Result<Self, ReadError> {
        if let Some(plain) = plain_samples(location, variable, values, geometry, layout)? {
            return Ok(plain);
        }
        Ok(Self::Decoded(VariableSource {
            location: location.clone(),
            file_bytes: location.open()?.len(),
            layout: layout.clone(),
            channel: 0,
            findings: Findings::default(),
            values: values.clone(),
            variable: variable.clone(),
        }))
    }

    fn source(&self, channel: u32, missing: Option<f32>) -> Arc<dyn Source> {
        let findings = match self {
            Self::Plain(samples, _) => samples.findings.of_another_field(),
            Self::Decoded(_) => Findings::default(),
        };
        findings.set_missing(missing);
        match self {
            Self::Plain(samples, distance) => Arc::new(StoredSamples {
                first: u64::from(channel) * distance,
                findings,
                ..samples.clone()
            }),
            Self::Decoded(source) => Arc::new(VariableSource {
                channel,
                findings,
                ..source.clone()
            }),
        }
    }
}

/// Describes contiguous samples, if each step is in the order of the grid.
fn plain_samples(
    location: &FileLocation,
    variable: &Variable,
    values: &Values,
    geometry: &Geometry,
    layout: &Layout,
) -> Result<Option<ChannelSamples>, ReadError> {
    let plain = variable.plain.filter(|_| !values.needs_nan());
    let Some(((begin, endian), (strides, distance))) = plain.zip(layout.strides()) else {
        return Ok(None);
    };
    let samples = StoredSamples::new(
        location,
        Begin::At(begin),
        values.stored,
        geometry,
        layout.steps,
        &variable.path,
    )?;
    let samples = samples.with_channels(layout.channels, &variable.path)?;
    // Something else may follow in the file. If the size overflows, `u64::MAX` is taken as the end, which the check refuses.
    let bytes = samples.array_samples().checked_mul(values.stored.bytes());
    let samples = StoredSamples {
        end: bytes.and_then(|bytes| begin.checked_add(bytes)).or(Some(u64::MAX)),
        endian,
        scale: values.scale,
        strides,
        ..samples
    };
    samples.check(&variable.path)?;
    Ok(samples.interleave().map(|_| ChannelSamples::Plain(samples, distance)))
}
