//! ParaView collections (`.pvd`), which list the files of a volume's time steps with their times.

use std::collections::HashSet;
use std::io;
use std::path::Path;

use isopeel_volumes::Dataset;

use crate::cli::output::write_whole;

/// The files of the time steps of a volume.
pub(super) struct Series {
    /// Name of the collection file, without extension.
    name: String,
    /// Time and file name of each step. The time is the number of the step if the dataset has no times.
    times: Vec<(f64, String)>,
}

impl Series {
    /// Creates the series of a volume from pairs of time step and file name.
    pub(super) fn new(name: String, dataset: &Dataset, files: impl Iterator<Item = (u32, String)>) -> Self {
        let time = |step| {
            let known = dataset.times.as_ref().and_then(|times| times.value(step));
            known.filter(|time| time.is_finite()).unwrap_or(step.into())
        };
        let times = files.map(|(step, file)| (time(step), file)).collect();
        Self { name, times }
    }

    /// Writes `NAME.pvd` into `folder`. The collection lists only files in `existing`. Writes nothing if these are fewer than two.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn write(&self, folder: &Path, existing: &HashSet<&str>) -> io::Result<()> {
        let steps: Vec<_> = self
            .times
            .iter()
            .filter(|(_, file)| existing.contains(file.as_str()))
            .collect();
        if steps.len() < 2 {
            return Ok(());
        }
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
        );
        for (time, file) in steps {
            // No need to escape: `safe_name` has replaced all characters that are special in XML.
            text += &format!("<DataSet timestep=\"{time}\" group=\"\" part=\"0\" file=\"{file}\"/>\n");
        }
        text += "</Collection>\n</VTKFile>\n";
        write_whole(&folder.join(format!("{}.pvd", self.name)), text.as_bytes())
    }
}
