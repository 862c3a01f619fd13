//! Collections of ParaView (`.pvd`): the files of a volume's time steps with their times.

use std::collections::HashSet;
use std::io;
use std::path::Path;

use isopeel_volumes::Dataset;

use crate::cli::output::write_whole;

/// The time steps of a volume.
pub(super) struct Series {
    name: String,
    /// Each with its file.
    times: Vec<(f64, String)>,
}

impl Series {
    /// A volume's files by their time steps.
    pub(super) fn new(name: String, dataset: &Dataset, files: impl Iterator<Item = (u32, String)>) -> Self {
        let time = |step| {
            let known = dataset.times.as_ref().and_then(|times| times.value(step));
            known.filter(|time| time.is_finite()).unwrap_or(step.into())
        };
        let times = files.map(|(step, file)| (time(step), file)).collect();
        Self { name, times }
    }

    /// Writes the collection of those files that were made; none, if there are fewer than two.
    pub(super) fn write(&self, folder: &Path, made: &HashSet<&str>) -> io::Result<()> {
        let steps: Vec<_> = self
            .times
            .iter()
            .filter(|(_, file)| made.contains(file.as_str()))
            .collect();
        if steps.len() < 2 {
            return Ok(());
        }
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
        );
        for (time, file) in steps {
            // Names of files are safe in XML.
            text += &format!("<DataSet timestep=\"{time}\" group=\"\" part=\"0\" file=\"{file}\"/>\n");
        }
        text += "</Collection>\n</VTKFile>\n";
        write_whole(&folder.join(format!("{}.pvd", self.name)), text.as_bytes())
    }
}
