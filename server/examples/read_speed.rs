//! How fast files are read: `read_speed PATH...` prints a line of JSON for each, with the bytes of a time step in memory and the
//! shortest of five times in seconds. For `tests/scripts/read_speed.py`. As for a device, a piece at a time, each of which is freed.

use std::path::Path;
use std::time::Instant;

use isopeel_volumes::{PIECE_SAMPLES, ReadError, ReadProgress, Samples, open_dataset};

const RUNS: usize = 5;

fn main() -> Result<(), ReadError> {
    for path in std::env::args().skip(1) {
        let dataset = open_dataset(Path::new(&path))?;
        let field = &dataset.fields[0];
        let bytes = dataset.geometry.sample_count() * field.sample_type.bytes() as u64;
        let mut seconds = f64::INFINITY;
        for _ in 0..RUNS {
            let (start, mut samples) = (Instant::now(), 0);
            let mut sink = |piece: Samples| {
                samples += piece.len() as u64;
                Ok(())
            };
            let source = &field.source;
            source.read_pieces(0, &ReadProgress::default(), PIECE_SAMPLES, &mut sink)?;
            seconds = seconds.min(start.elapsed().as_secs_f64());
            assert_eq!(samples, dataset.geometry.sample_count());
        }
        let line = serde_json::json!({"path": path, "bytes": bytes, "seconds": seconds});
        println!("{line}");
    }
    Ok(())
}
