//! For benches: volumes generated from formulas, and a device's own speed.

use crate::SampleType;

/// A formula. Its values are of the order of −2 to 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Eight plane waves and white noise. The noise is 1 % at a period of 256 samples and less at longer periods, so that its size in
    /// samples, and its share of wrong signs, stays the same. Isovalue 0.5.
    Sin,
    /// Eight other plane waves with uniform noise, of a quarter more surface. Isovalue 0.5.
    Waves,
    /// The Marschner-Lobb signal, smooth. Isovalue 0.5.
    MarschnerLobb,
    /// Two gyroids of different period. Isovalue 0.1.
    Gyroid,
    /// Balls of radius 40 samples; the given number of them along every axis. Isovalue 0.
    Spheres(u32),
}

impl Shape {
    /// Number of the shape in `cl/generate.cl`, and the number of balls along every axis.
    pub(crate) fn numbers(self) -> (u32, u32) {
        match self {
            Self::Sin => (0, 1),
            Self::Waves => (1, 1),
            Self::MarschnerLobb => (2, 1),
            Self::Gyroid => (3, 1),
            Self::Spheres(count) => (4, count.max(1)),
        }
    }

    /// The isovalue of the shape, scaled as samples of that type are stored; for integer types it is between two integers.
    pub fn isovalue(self, sample_type: SampleType) -> f32 {
        let value = match self {
            Self::Sin | Self::Waves | Self::MarschnerLobb => 0.5,
            Self::Gyroid => 0.1,
            Self::Spheres(_) => 0.0,
        };
        let [factor, offset] = stored(sample_type);
        let value = value * factor + offset;
        if sample_type == SampleType::F32 {
            value
        } else {
            value.floor() + 0.5
        }
    }
}

/// Factor and offset that bring −2 to 2 into a sample type's range.
pub(crate) fn stored(sample_type: SampleType) -> [f32; 2] {
    match sample_type {
        SampleType::U8 => [63.75, 127.5],
        SampleType::I8 => [63.75, -0.5],
        SampleType::U16 => [16383.75, 32767.5],
        SampleType::I16 => [16383.75, -0.5],
        SampleType::F32 => [1.0, 0.0],
    }
}

/// A volume to be generated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Synthetic {
    /// The formula.
    pub shape: Shape,
    /// Samples after which waves repeat or the signal ends; above 1. Spheres have none.
    pub period: f32,
    /// The outermost samples are below every surface, so that all surfaces are closed.
    pub closed: bool,
}

/// Speed of a device's basic operations: copies and launches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceSpeed {
    /// Bytes read plus bytes written a second by copies from buffer to buffer, by the device's events.
    pub copy_bytes_per_second: f64,
    /// Size of the copied buffer in bytes.
    pub copied_bytes: u64,
    /// Seconds per launch of an empty kernel, without waiting between launches.
    pub launch_seconds: f64,
    /// Seconds to launch an empty kernel and wait for its end.
    pub launch_and_wait_seconds: f64,
}
