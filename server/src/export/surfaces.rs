//! The surfaces of a file. The view of each surface combines the request for the file with the options of the surface.

use std::collections::HashMap;
use std::sync::Arc;

use isopeel_mesh::mesh::Material;
use isopeel_view::{Edit, EditError, View};
use isopeel_volumes::{Dataset, VolumeStep};
use serde_json::Value;

use super::{FileOptions, FileRequest, SurfaceOptions};

/// Maximum number of surfaces in a file. All their meshes are in memory at once.
const MAX_FILE_SURFACES: usize = 64;

/// Volumes of single surfaces that are not the volume of the file, by their names in the request.
pub type OtherVolumes = HashMap<String, Arc<Dataset>>;

/// A surface of a file, with all of its options checked and resolved.
#[derive(Clone, Debug)]
pub struct FileSurface {
    /// Volume and time step.
    pub volume: VolumeStep,
    /// View, with every value that the request sets.
    pub view: View,
    /// The request for this surface alone.
    pub request: FileRequest,
    /// Name of the surface in the file, if the request has one.
    pub name: Option<String>,
    /// Colour and opacity.
    pub material: Material,
}

impl FileSurface {
    /// Returns the names of the fields whose values the file holds at the vertices of this surface.
    pub fn values(&self) -> &[String] {
        let options = &self.request.options;
        if options.format.holds_values() {
            &options.field_values
        } else {
            &[]
        }
    }
}

impl FileRequest {
    /// Returns the names of the other volumes that surfaces use.
    pub fn other_volumes(&self) -> impl Iterator<Item = &str> {
        let surfaces = self.options.surfaces.iter();
        surfaces.filter_map(|surface| surface.look.volume.as_deref())
    }

    /// Returns the time steps that surfaces use, one for each surface.
    pub fn steps(&self) -> impl Iterator<Item = u32> {
        let surfaces = self.options.surfaces.iter();
        // A request without `surfaces` has one surface, at the step of the request.
        let single = self.options.surfaces.is_empty().then_some(self.step);
        surfaces
            .map(|surface| surface.look.step.unwrap_or(self.step))
            .chain(single)
    }

    /// Returns the surfaces of the file, at least one.
    ///
    /// # Errors
    /// A value out of its range, a volume, time step or field that does not exist, or more surfaces than the format holds.
    pub fn surfaces(&self, volume: &VolumeStep, others: &OtherVolumes) -> Result<Vec<FileSurface>, EditError> {
        let surfaces = &self.options.surfaces;
        if surfaces.is_empty() {
            return Ok(vec![FileSurface {
                volume: volume.clone(),
                view: self.view(volume.dataset())?,
                request: self.clone(),
                name: None,
                material: Material::default(),
            }]);
        }
        self.check_surfaces()?;
        surfaces
            .iter()
            .map(|surface| self.surface(surface, volume, others))
            .collect()
    }

    /// Checks the values that do not depend on volumes: the number of surfaces, and their looks.
    pub(super) fn check_surfaces(&self) -> Result<(), EditError> {
        let refuse = |why| Err(EditError { field: "surfaces", why });
        let surfaces = &self.options.surfaces;
        if surfaces.len() > MAX_FILE_SURFACES {
            return refuse(format!(
                "{} surfaces, expected at most {MAX_FILE_SURFACES}",
                surfaces.len()
            ));
        }
        if surfaces.len() > 1 && !self.options.format.holds_several() {
            let title = self.options.format.title();
            return refuse(format!(
                "{} surfaces in a {title}, expected one, or a GLB, 3MF, OBJ, USDZ or precomputed",
                surfaces.len()
            ));
        }
        surfaces
            .iter()
            .try_for_each(|surface| surface.look.material().map(|_| ()))
    }

    /// Returns one surface of the file. Options that the surface does not set are those of the file.
    fn surface(
        &self,
        surface: &SurfaceOptions,
        volume: &VolumeStep,
        others: &OtherVolumes,
    ) -> Result<FileSurface, EditError> {
        let SurfaceOptions { look, edit } = surface;
        let refused = |why: String| EditError { field: "surfaces", why };
        let dataset = match &look.volume {
            None => volume.dataset(),
            Some(name) => others.get(name).ok_or_else(|| {
                refused(format!(
                    "volume {name:?}, expected surfaces of {:?} alone here",
                    volume.dataset().id
                ))
            })?,
        };
        let step = look.step.unwrap_or(self.step);
        let volume = VolumeStep::new(Arc::clone(dataset), step).map_err(|error| refused(error.to_string()))?;
        // A surface's own isovalue or label replaces the isovalue or label of the file.
        let (has_own_label, has_own_iso) = (look.label.is_some(), edit.iso.is_some());
        let label = look
            .label
            .clone()
            .or_else(|| self.options.label.clone().filter(|_| !has_own_iso));
        let mut complete_edit = overlay(&self.edit, edit);
        if has_own_label && !has_own_iso {
            complete_edit.iso = None;
        }
        let request = FileRequest {
            step,
            options: FileOptions {
                // Label smoothing does not apply to surfaces at isovalues.
                label_smoothing: label.as_ref().map_or(0.0, |_| self.options.label_smoothing),
                label,
                surfaces: Vec::new(),
                ..self.options.clone()
            },
            edit: complete_edit,
        };
        Ok(FileSurface {
            view: request.view(volume.dataset())?,
            volume,
            request,
            name: look.name.clone(),
            material: look.material()?,
        })
    }
}

/// Returns `edit` with all values that `over` sets replaced. As in edits of a view, a quality criterion replaces all others, and a new
/// feature drops the range of the old feature.
fn overlay(edit: &Edit, over: &Edit) -> Edit {
    let mut edit = edit.clone();
    if over.beta.is_some() || over.error.is_some() || over.triangles.is_some() || over.bytes.is_some() {
        (edit.beta, edit.error, edit.triangles, edit.bytes) = (None, None, None, None);
    }
    if over.feature.is_some() {
        edit.feature_range = None;
    }
    let values = |edit: &Edit| serde_json::to_value(edit).unwrap_or_default();
    let mut all = values(&edit);
    if let (Value::Object(all), Value::Object(over)) = (&mut all, values(over)) {
        all.extend(over);
    }
    // Cannot fail, because all values come from edits.
    serde_json::from_value(all).unwrap_or_else(|_| over.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isopeel_volumes::testing;

    fn volume(id: &str) -> VolumeStep {
        VolumeStep::new(Arc::new(testing::dataset(id, [4; 3], &["t1", "gm"])), 0).unwrap()
    }

    fn surfaces(request: &str) -> Result<Vec<FileSurface>, EditError> {
        let request: FileRequest = serde_json::from_str(request).unwrap();
        let others = HashMap::from([("other".to_owned(), Arc::clone(volume("other").dataset()))]);
        request.surfaces(&volume("head"), &others)
    }

    #[test]
    fn each_surface_has_its_own_values_over_those_of_the_file() {
        let found = surfaces(
            r##"{"format":"glb","iso":3,"error":"0.1vx","surfaces":[
            {"name":"skin","color":"#ff8000","opacity":0.5},{"iso":7,"mask":"gm==2"},{"label":"5"},{"volume":"other","field":"gm"}]}"##,
        )
        .unwrap();
        let isos: Vec<_> = found
            .iter()
            .map(|surface| surface.view.iso.map(isopeel_kernels::Isovalue::get))
            .collect();
        assert_eq!(isos, [Some(3.0), Some(7.0), Some(0.5), Some(3.0)]);
        assert!(found.iter().all(|surface| surface.view.error.is_some()));
        assert_eq!(found[0].name.as_deref(), Some("skin"));
        let material = found[0].material;
        assert_eq!((material.color, material.opacity), (Some([255, 128, 0]), 0.5));
        assert!(found[1].view.mask.is_some() && found[2].view.mask.is_none());
        assert_eq!(found[3].volume.dataset().id, "other");
        assert_eq!(found[3].view.field, "gm");
        assert_eq!(surfaces(r#"{"format":"ply","iso":3}"#).unwrap().len(), 1);
    }

    #[test]
    fn what_is_wrong_for_any_volume_is_found_without_one() {
        let checked = |request: &str| {
            let request: FileRequest = serde_json::from_str(request).unwrap();
            request.check_alone().map_err(|error| error.to_string())
        };
        assert_eq!(
            checked(r#"{"format":"glb","field":"gm","feature":"t1","mask":"labels==3"}"#),
            Ok(())
        );
        for (request, expected) in [
            (r#"{"format":"glb","alpha":2}"#, "alpha: 2, expected 0 to 1"),
            (r#"{"format":"glb","unit":"stone"}"#, "unit: \"stone\""),
            (
                r#"{"format":"ply","compress":"zlib"}"#,
                "compress: zlib of a PLY, expected a VTP or 3MF",
            ),
            (
                r#"{"format":"ply","surfaces":[{},{}]}"#,
                "surfaces: 2 surfaces in a PLY",
            ),
            (
                r#"{"format":"glb","clean":true,"compress":"meshopt"}"#,
                "clean: beside compress meshopt",
            ),
            (r#"{"format":"glb","clean":true,"bytes":9}"#, "clean: beside bytes"),
            (
                r#"{"format":"glb","clean":true,"measure":9}"#,
                "measure: a bound beside clean",
            ),
        ] {
            let error = checked(request).unwrap_err();
            assert!(error.starts_with(expected), "{request}: {error}");
        }
    }

    #[test]
    fn the_quality_of_a_surface_and_its_feature_replace_those_of_the_file() {
        let found = surfaces(
            r#"{"format":"glb","iso":3,"beta":0.1,"feature":"gm","featureRange":[0,2],"surfaces":[
            {},{"error":"0.1vx"},{"triangles":500,"feature":"gradient-magnitude"}]}"#,
        )
        .unwrap();
        let edits: Vec<_> = found.iter().map(|surface| &surface.request.edit).collect();
        assert!(edits[0].beta.is_some() && edits[0].feature_range == Some([0.0, 2.0]));
        assert!(edits[1].beta.is_none() && edits[1].error.is_some() && edits[1].feature_range.is_some());
        assert!(edits[2].beta.is_none() && edits[2].triangles.is_some() && edits[2].feature_range.is_none());
    }

    #[test]
    fn what_is_wrong_with_a_surface_is_named() {
        for (options, expected) in [
            (
                r#""ply","surfaces":[{"iso":1},{"iso":2}]"#,
                "surfaces: 2 surfaces in a PLY, expected one",
            ),
            (
                r#""glb","surfaces":[{"volume":"third"}]"#,
                "surfaces: volume \"third\", expected surfaces of \"head\" alone",
            ),
            (
                r#""glb","surfaces":[{"step":3}]"#,
                "surfaces: step 3 of volume \"head\", expected 0 to 0",
            ),
            (
                r#""glb","surfaces":[{"color":"red"}]"#,
                "surfaces: color \"red\", expected #rrggbb",
            ),
            (
                r#""glb","surfaces":[{"opacity":2}]"#,
                "surfaces: opacity 2, expected 0 to 1",
            ),
            (r#""glb","surfaces":[{"alpha":2}]"#, "alpha: 2, expected 0 to 1"),
            (r#""glb","surfaces":[{"iso":1,"label":"3"}]"#, "label: \"3\" beside iso"),
            (r#""glb","labelSmoothing":0.8"#, "labelSmoothing: 0.8 without label"),
            (
                r#""glb","label":"3","labelSmoothing":11"#,
                "labelSmoothing: 11, expected 0, or 0.1 to 10",
            ),
        ] {
            let error = surfaces(&format!("{{\"format\":{options}}}")).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{options}: {error}");
        }
        let many = format!("{{\"format\":\"glb\",\"surfaces\":[{}{{}}]}}", "{},".repeat(64));
        let error = surfaces(&many).unwrap_err().to_string();
        assert_eq!(error, "surfaces: 65 surfaces, expected at most 64");
        let unknown = serde_json::from_str::<FileRequest>(r#"{"format":"glb","surfaces":[{"isovalue":1}]}"#);
        assert!(unknown.unwrap_err().to_string().contains("unknown field `isovalue`"));
    }
}
