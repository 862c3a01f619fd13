//! Files whose names differ in a number: the time steps of fields.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use isopeel_kernels::Samples;

use super::findings::merging_steps;
use super::location::stem;
use super::{
    Field, FileLocation, LabelRanks, Notices, OpenedFile, ReadError, ReadProgress, Sink, Source, TimeAxis, only_piece,
};

/// Files with the same name, by their numbers.
type Steps = BTreeMap<u64, (FileLocation, OpenedFile)>;

/// Splits a file's stem into name, last number and its digits: `wind`, 7 and 3 for `wind_007.nrrd`.
fn split(path: &Path) -> Option<(String, u64, usize)> {
    let stem = stem(path);
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |i| {
        // A number begins behind the character, which may have several bytes.
        i + stem[i..].chars().next().map_or(1, char::len_utf8)
    });
    let number = stem[start..end].parse().ok()?;
    let separators = ['-', '_', '.', ' '];
    let parts = [&stem[..start], &stem[end..]].map(|part| part.trim_matches(separators));
    let name = parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>();
    Some((name.join("-"), number, end - start))
}

/// Whether these files are time steps by their names: each belongs to a sequence of at least three numbers, or of two that are
/// written with the same two or more digits. `t1` and `t2` are two images of a patient.
pub(super) fn are_steps(files: &[(FileLocation, OpenedFile)]) -> bool {
    let mut widths: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    let mut seen = BTreeSet::new();
    for (location, _) in files {
        let Some((name, number, width)) = split(location.path()) else {
            return false;
        };
        if !seen.insert((name.clone(), number)) {
            return false;
        }
        widths.entry(name).or_default().push(width);
    }
    let is_sequence = |widths: &Vec<usize>| widths.len() > 2 || matches!(widths[..], [a, b] if a == b && a > 1);
    !files.is_empty() && widths.values().all(is_sequence)
}

/// Returns one file for each name, whose fields have the time steps of all. The files must satisfy [`are_steps`].
///
/// # Errors
/// Which two files do not fit, and in what.
pub(super) fn steps_of(files: Vec<(FileLocation, OpenedFile)>) -> Result<Vec<(FileLocation, OpenedFile)>, ReadError> {
    let mut sequences: BTreeMap<String, Steps> = BTreeMap::new();
    for file in files {
        if let Some((name, number, _)) = split(file.0.path()) {
            sequences.entry(name).or_default().insert(number, file);
        }
    }
    for steps in sequences.values() {
        for (name, others) in &sequences {
            if let Some((number, (location, _))) = steps.iter().find(|(number, _)| !others.contains_key(number)) {
                let why = format!("there is no file {number} of {name:?}, expected the same numbers of each name");
                return Err(ReadError::new(location.path(), "time steps", why));
            }
        }
    }
    let joined = sequences
        .into_iter()
        .filter_map(|(name, steps)| join(&name, steps).transpose());
    joined.collect()
}

/// Joins the files of one name. `name`: that of the files without their number. `None` if there are no files.
fn join(name: &str, steps: Steps) -> Result<Option<(FileLocation, OpenedFile)>, ReadError> {
    let numbers: Vec<u64> = steps.keys().copied().collect();
    let files: Vec<_> = steps.into_values().collect();
    let Some((location, first)) = files.first() else {
        return Ok(None);
    };
    let location = location.clone();
    // If the only field of a file has the file's name, it gets the name without the number.
    let is_numbered = !name.is_empty() && first.fields.len() == 1 && first.fields[0].name == location.stem();
    let digits = split(location.path()).map_or(1, |(.., digits)| digits);
    let mut file = join_steps(files, TimeAxis::numbers(&numbers, digits))?;
    if is_numbered {
        name.clone_into(&mut file.fields[0].name);
    }
    Ok(Some((location, file)))
}

/// Joins files of one step each to one file with all steps. `files` must not be empty.
///
/// # Errors
/// Which file does not fit the first one, and in what.
pub(super) fn join_steps(
    files: Vec<(FileLocation, OpenedFile)>,
    times: Option<TimeAxis>,
) -> Result<OpenedFile, ReadError> {
    let mut first = files[0].1.clone();
    let mut sources: Vec<Vec<Arc<dyn Source>>> = vec![Vec::new(); first.fields.len()];
    let steps = u32::try_from(files.len()).unwrap_or(u32::MAX);
    for (location, file) in files {
        check(&location, &file, &first)?;
        first.notices.extend(file.notices);
        // Axes keep their description only if all steps have the same.
        first.axes.take_if(|axes| file.axes.as_ref() != Some(axes));
        for (source, field) in sources.iter_mut().zip(file.fields) {
            source.push(field.source);
        }
    }
    let fields = first.fields.into_iter().zip(sources).map(|(field, sources)| Field {
        source: Arc::new(StepFiles(sources)),
        ..field
    });
    Ok(OpenedFile {
        steps,
        times: times.filter(|_| steps > 1),
        fields: fields.collect(),
        ..first
    })
}

/// Checks that a file fits the first one, as a step of the same fields.
fn check(location: &FileLocation, file: &OpenedFile, first: &OpenedFile) -> Result<(), ReadError> {
    let fail = |what: &str, why: String| Err(ReadError::new(location.path(), what, why));
    if file.steps != 1 {
        return fail(
            "time steps",
            format!("{}, expected one in each file of a sequence", file.steps),
        );
    }
    if !file.geometry.matches(&first.geometry) || !file.matches_positions(first) {
        let show = |file: &OpenedFile| {
            let g = &file.geometry;
            format!("{:?} samples, spacing {:?}, origin {:?}", g.dims, g.spacing, g.origin)
        };
        return fail(
            "geometry",
            format!("{}, expected that of the first step: {}", show(file), show(first)),
        );
    }
    let is_alone = first.fields.len() == 1;
    let same = |a: &Field, b: &Field| {
        (is_alone || a.name == b.name) && a.sample_type == b.sample_type && a.missing == b.missing && a.unit == b.unit
    };
    if file.fields.len() != first.fields.len() || !file.fields.iter().zip(&first.fields).all(|(a, b)| same(a, b)) {
        let show = |file: &OpenedFile| {
            let fields = file
                .fields
                .iter()
                .map(|f| format!("{} ({})", f.name, f.sample_type.name()));
            fields.collect::<Vec<_>>().join(", ")
        };
        return fail(
            "fields",
            format!("{}, expected those of the first step: {}", show(file), show(first)),
        );
    }
    Ok(())
}

/// A source whose steps are the only steps of these.
#[derive(Debug)]
struct StepFiles(Vec<Arc<dyn Source>>);

impl Source for StepFiles {
    fn stored_bytes(&self) -> u64 {
        self.0.iter().map(|source| source.stored_bytes()).max().unwrap_or(0)
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        self.0
            .get(step as usize)
            .map_or_else(Vec::new, |source| source.inputs(0))
    }

    fn notices(&self) -> Notices {
        let mut notices = Notices::default();
        self.0.iter().for_each(|source| notices.extend(source.notices()));
        notices
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        // Several files have no ranks.
        self.0.first()?.ranks()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        match self.0.get(step as usize) {
            Some(_) => only_piece(|sink| self.read_pieces(step, progress, usize::MAX, sink)),
            None => {
                let why = format!("{step}, expected less than {}", self.0.len());
                Err(ReadError::new(Path::new("numbered files"), "step", why))
            }
        }
    }

    fn read_pieces(
        &self,
        step: u32,
        progress: &ReadProgress,
        piece: usize,
        sink: &mut Sink<'_>,
    ) -> Result<(), ReadError> {
        match self.0.get(step as usize) {
            // Ranks of labels would differ from file to file.
            Some(source) => match source.read_pieces(0, progress, piece, sink) {
                Err(error) if error.can_retry && self.0.len() > 1 => Err(merging_steps(&error.path)),
                read => read,
            },
            None => self.read(step, progress).map(drop),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_number_counts() {
        let name = |name: &str| split(Path::new(name));
        assert_eq!(name("wind_007.nrrd"), Some(("wind".into(), 7, 3)));
        assert_eq!(name("run2-t10.vti"), Some(("run2-t".into(), 10, 2)));
        assert_eq!(name("0004.nii.gz"), Some((String::new(), 4, 4)));
        assert_eq!(name("step 3 wind.raw"), Some(("step-wind".into(), 3, 1)));
        assert_eq!(name("größe12.npy"), Some(("größe".into(), 12, 2)));
        assert_eq!(name("head.npy"), None);
        assert_eq!(name("99999999999999999999999.npy"), None);
    }
}
