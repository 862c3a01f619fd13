//! Fields that are computed from other fields: an expression over them, the distance to the samples for which an expression holds, or a
//! smoothed expression.
//!
//! The module `computed` computes expressions and distances on the device. This module computes fields on the host: smoothed fields, padded
//! or masked fields, and other fields whose samples the host needs.

mod distances;
mod smoothing;

use std::sync::Arc;

use isopeel_kernels::{Expression, SampleType, Samples};
use isopeel_view::FieldExpression;
use isopeel_volumes::{Dataset, Field, FileLocation, LengthUnit, Notices, ReadError, ReadProgress, Source};
use rayon::prelude::*;

use self::distances::distances;
use self::smoothing::smoothed;

/// Number of samples that a task of the thread pool computes.
const TASK_SAMPLES: usize = 1 << 16;

/// Source of a field that is computed from others.
#[derive(Clone, Debug)]
struct ComputedSource {
    expression: Expression,
    /// Text of the expression.
    text: String,
    /// The fields in the expression, in the order of its variables.
    fields: Vec<Field>,
    /// For a field of distances to the samples for which the expression is not 0: positions of the samples along the axes, in world units.
    positions: Option<Box<[Vec<f64>; 3]>>,
    /// For a smoothed field: the standard deviation of the Gaussian in samples.
    smoothing: Option<f32>,
    dims: [u32; 3],
}

/// Parses an expression over a dataset's fields. `None` if the text is no expression, or is the name of a field.
pub fn parse_expression(dataset: &Dataset, text: &str) -> Option<FieldExpression> {
    if dataset.field(text).is_some() {
        return None;
    }
    let rank = |name: &str, number: i128| Some(dataset.field(name)?.source.ranks()?.position(number));
    FieldExpression::parse_by(text, &dataset.field_names(), "field", &rank).ok()
}

/// Returns the field of this name, or the one that an expression over a dataset's fields gives.
pub fn field_or_computed(dataset: &Dataset, name: &str) -> Option<Field> {
    dataset.field(name).cloned().or_else(|| computed_field(dataset, name))
}

/// Returns the field that an expression over a dataset's fields gives. `None` if the text is no expression, or is the name of a field.
pub fn computed_field(dataset: &Dataset, text: &str) -> Option<Field> {
    let parsed = parse_expression(dataset, text)?;
    let fields: Vec<Field> = parsed
        .fields
        .iter()
        .map(|name| dataset.field(name).cloned())
        .collect::<Option<_>>()?;
    let units: Vec<_> = fields.iter().map(|field| field.unit.as_deref()).collect();
    let length_unit = dataset
        .geometry
        .unit
        .map(LengthUnit::symbol)
        .filter(|_| parsed.is_distance);
    let unit = parsed.unit(&units).or(length_unit).map(str::to_owned);
    let source = ComputedSource {
        expression: parsed.expression,
        text: text.to_owned(),
        fields,
        // Without padding, because distances are computed at the samples of the dataset.
        positions: parsed.is_distance.then(|| Box::new(dataset.positions(false))),
        smoothing: parsed.smoothing,
        dims: dataset.geometry.dims,
    };
    Some(Field {
        name: text.to_owned(),
        stored_type: "computed".to_owned(),
        sample_type: SampleType::F32,
        missing: None,
        unit,
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(source),
    })
}

impl ComputedSource {
    /// Returns the expression for samples that were read. Reading may have replaced labels by their ranks. So the expression is parsed
    /// again, with ranks in place of label constants.
    fn ranked_expression(&self) -> Expression {
        let by_name = |name: &str| self.fields.iter().find(|field| field.name == name);
        let rank = |name: &str, number: i128| Some(by_name(name)?.source.ranks()?.position(number));
        let names: Vec<&str> = self.fields.iter().map(|field| field.name.as_str()).collect();
        let parsed = FieldExpression::parse_by(&self.text, &names, "field", &rank);
        parsed.map_or_else(|_| self.expression.clone(), |parsed| parsed.expression)
    }
}

impl Source for ComputedSource {
    fn stored_bytes(&self) -> u64 {
        self.fields.iter().map(|field| field.source.stored_bytes()).sum()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        let fields = self.fields.iter();
        fields.flat_map(|field| field.source.inputs(step)).collect()
    }

    fn notices(&self) -> Notices {
        let mut notices = Notices::default();
        let fields = self.fields.iter();
        fields.for_each(|field| notices.extend(field.source.notices()));
        notices
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let read = |field: &Field| Ok((field.source.read(step, progress)?, field.missing));
        let fields = self.fields.iter().map(read).collect::<Result<Vec<_>, ReadError>>()?;
        let count = fields.first().map_or(0, |(samples, _)| samples.len());
        let expression = self.ranked_expression();
        let mut values = vec![0.0; count];
        values
            .par_chunks_mut(TASK_SAMPLES)
            .enumerate()
            .for_each(|(task, values)| {
                let mut variables = vec![0.0; fields.len()];
                for (i, value) in (task * TASK_SAMPLES..).zip(values) {
                    for (variable, (samples, missing)) in variables.iter_mut().zip(&fields) {
                        let sample = samples.get(i);
                        *variable = if Some(sample) == *missing { f32::NAN } else { sample };
                    }
                    *value = expression.value(&variables);
                }
            });
        Ok(Samples::F32(match (&self.positions, self.smoothing) {
            (None, None) => values,
            (None, Some(sigma)) => smoothed(self.dims, values, sigma),
            // If no sample is inside, there are no distances, so all samples are missing.
            (Some(positions), _) => distances(positions, values).unwrap_or_else(|| vec![f32::NAN; count]),
        }))
    }
}
