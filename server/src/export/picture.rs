//! A plane of samples as a grey picture.

use isopeel_kernels::{SampleType, Samples};

use isopeel_extraction::Slice;

/// Parameters for drawing a slice.
pub(super) struct Picture {
    /// Samples in each row, and number of rows.
    pub dims: [u32; 2],
    /// Value of missing samples.
    pub missing: Option<f32>,
    /// Difference between the values of white and black, in units of the field.
    pub window: f32,
    /// Value of middle grey.
    pub level: f32,
}

impl Picture {
    /// Returns grey and alpha as bytes; both are 0 if the sample is missing.
    fn pixel(&self, value: f32) -> [u8; 2] {
        if value.is_nan() || Some(value) == self.missing {
            return [0, 0];
        }
        // The window is 0 if the field has only one value.
        let brightness = if self.window > 0.0 {
            (f64::from(value) - f64::from(self.level)) / f64::from(self.window) + 0.5
        } else {
            0.5
        };
        [(brightness.clamp(0.0, 1.0) * 255.0).round() as u8, 255]
    }

    /// Returns the slice as a PNG file.
    pub fn png(&self, slice: &Slice) -> Result<Vec<u8>, png::EncodingError> {
        let samples = samples_of(slice);
        let pixels: Vec<u8> = (0..samples.len()).flat_map(|i| self.pixel(samples.get(i))).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.dims[0], self.dims[1]);
        encoder.set_color(png::ColorType::GrayscaleAlpha);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&pixels)?;
        writer.finish()?;
        Ok(file)
    }
}

/// Converts the bytes of a slice to samples of its type.
pub(super) fn samples_of(slice: &Slice) -> Samples {
    let bytes = &slice.bytes;
    match slice.sample_type {
        SampleType::U8 => Samples::U8(bytes.clone()),
        SampleType::I8 => Samples::I8(bytes.iter().map(|byte| byte.cast_signed()).collect()),
        SampleType::U16 => Samples::U16(bytemuck::pod_collect_to_vec(bytes)),
        SampleType::I16 => Samples::I16(bytemuck::pod_collect_to_vec(bytes)),
        SampleType::F32 => Samples::F32(bytemuck::pod_collect_to_vec(bytes)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(window: f32, level: f32) -> Picture {
        Picture {
            dims: [3, 2],
            missing: Some(-1.0),
            window,
            level,
        }
    }

    #[test]
    fn window_and_level_say_what_is_black_and_white() {
        let drawn = picture(100.0, 50.0);
        for (value, grey) in [
            (0.0, 0),
            (-40.0, 0),
            (50.0, 128),
            (100.0, 255),
            (1e30, 255),
            (f32::INFINITY, 255),
        ] {
            assert_eq!(drawn.pixel(value), [grey, 255], "{value}");
        }
        assert_eq!(drawn.pixel(-1.0), [0, 0], "missing");
        assert_eq!(drawn.pixel(f32::NAN), [0, 0]);
        assert_eq!(picture(0.0, 7.0).pixel(7.0), [128, 255], "a field of one value");
        assert_eq!(picture(f32::MAX, 0.0).pixel(f32::MAX), [255, 255]);
    }

    #[test]
    fn pictures_can_be_read_again() {
        let slice = Slice {
            sample_type: SampleType::I16,
            bytes: [0i16, 50, 100, -1, 25, 75]
                .into_iter()
                .flat_map(i16::to_le_bytes)
                .collect(),
        };
        assert_eq!(samples_of(&slice).get(3), -1.0);
        let file = picture(100.0, 50.0).png(&slice).expect("a picture");
        let mut reader = png::Decoder::new(std::io::Cursor::new(file))
            .read_info()
            .expect("a PNG file");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let frame = reader.next_frame(&mut pixels).expect("a frame");
        assert_eq!(
            (frame.width, frame.height, frame.color_type),
            (3, 2, png::ColorType::GrayscaleAlpha)
        );
        assert_eq!(pixels, [0, 255, 128, 255, 255, 255, 0, 0, 64, 255, 191, 255]);
    }
}
