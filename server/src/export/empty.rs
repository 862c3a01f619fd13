//! Why a surface has no triangles.

use isopeel_extraction::{ExtractionStatistics, WorkError};
use isopeel_kernels::Histogram;
use isopeel_view::{FeatureName, View};
use isopeel_volumes::VolumeStep;

use crate::service::DeviceWorker;

/// Returns why the surface of a resolved view has no triangles; `None` if it has some.
///
/// # Errors
/// Errors of the device, which counts the field's values.
pub(crate) async fn why_empty(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    view: &View,
    statistics: &ExtractionStatistics,
) -> Result<Option<String>, WorkError> {
    if statistics.triangles > 0 {
        return Ok(None);
    }
    if let Some(why) = all_removed(statistics) {
        return Ok(Some(why));
    }
    let values = worker.histogram(volume, &view.field, &FeatureName::None);
    Ok(Some(no_crossing(view, &values.await?)))
}

/// Returns the reason if options of the request removed all triangles; `None` if the full surface has no triangles either.
fn all_removed(statistics: &ExtractionStatistics) -> Option<String> {
    match (statistics.full_triangles, statistics.removed_parts) {
        (0, Some(parts @ 1..)) => Some(format!(
            "nothing is left of the surface: all {parts} parts were removed"
        )),
        (full @ 1.., _) => Some(format!(
            "nothing is left of the surface's {full} triangles: expected topology preserve, or less decimation"
        )),
        _ => None,
    }
}

/// Returns why the field has no surface at the isovalue.
fn no_crossing(view: &View, histogram: &Histogram) -> String {
    let field = &view.field;
    let [low, high] = histogram.range;
    let Some(iso) = view.iso.map(isopeel_kernels::Isovalue::get) else {
        return format!("no surface: no sample of {field:?} has a value");
    };
    let no_surface = format!("no surface at isovalue {iso}");
    match &view.mask {
        _ if histogram.bins.iter().all(|&samples| samples == 0) => {
            format!("no surface: no sample of {field:?} has a value")
        }
        _ if low == high => format!("{no_surface}: all values of {field:?} are {low}"),
        // The same test as in the kernels: samples at the isovalue are inside.
        _ if iso <= low || iso > high => format!(
            "{no_surface}: values of {field:?} go from {low} to {high}, expected a number between them, such as {}",
            0.5 * low + 0.5 * high
        ),
        Some(mask) => format!("{no_surface} where {}", mask.as_str()),
        None => format!("{no_surface}: samples on both sides of it are parted by missing ones"),
    }
}

#[cfg(test)]
mod tests {
    use isopeel_view::Edit;

    use super::*;

    fn view(edit: &str) -> View {
        let edit: Edit = serde_json::from_str(edit).unwrap();
        View::plain(&["t1", "gm"]).apply(&edit, &["t1", "gm"]).unwrap()
    }

    fn histogram(range: [f32; 2], samples: u64) -> Histogram {
        Histogram {
            range,
            bins: vec![samples; 256],
        }
    }

    #[test]
    fn a_surface_that_crosses_nothing_says_why() {
        for (edit, range, expected) in [
            (
                r#"{"iso":300}"#,
                [0.0, 255.0],
                "no surface at isovalue 300: values of \"t1\" go from 0 to 255, expected a number between them, such as 127.5",
            ),
            (
                r#"{"iso":0,"mask":"gm>=3"}"#,
                [0.0, 255.0],
                "no surface at isovalue 0: values of \"t1\" go from 0 to 255, expected a number between them, such as 127.5",
            ),
            (
                r#"{"iso":9,"mask":"gm>=3"}"#,
                [0.0, 255.0],
                "no surface at isovalue 9 where gm>=3",
            ),
            (
                r#"{"iso":9}"#,
                [0.0, 255.0],
                "no surface at isovalue 9: samples on both sides of it are parted by missing ones",
            ),
            (
                r#"{"iso":9}"#,
                [7.0, 7.0],
                "no surface at isovalue 9: all values of \"t1\" are 7",
            ),
        ] {
            assert_eq!(no_crossing(&view(edit), &histogram(range, 9)), expected);
        }
        let none = "no surface: no sample of \"t1\" has a value";
        assert_eq!(no_crossing(&view(r#"{"iso":1}"#), &histogram([0.0; 2], 0)), none);
        assert_eq!(no_crossing(&view("{}"), &histogram([0.0; 2], 0)), none);
    }

    #[test]
    fn a_surface_of_which_nothing_is_left_says_what_took_it() {
        let of = |full_triangles, removed_parts| {
            all_removed(&ExtractionStatistics {
                full_triangles,
                removed_parts,
                ..ExtractionStatistics::default()
            })
        };
        assert_eq!(of(0, None), None);
        assert_eq!(of(0, Some(0)), None);
        let removed = of(0, Some(3)).unwrap();
        assert!(removed.ends_with("all 3 parts were removed"), "{removed}");
        let decimated = of(12, None).unwrap();
        assert!(
            decimated.starts_with("nothing is left of the surface's 12 triangles"),
            "{decimated}"
        );
    }
}
