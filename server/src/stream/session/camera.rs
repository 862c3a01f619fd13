//! Cuts that follow the viewer's camera.
//!
//! A camera is no edit. It takes effect when nothing else of the connection is waited for: then each surface that follows it and is a cut of
//! the vertex tree gets a generation of its own, which replaces the regions that differ. Cameras that come meanwhile replace each other. An
//! edit ends such a generation at once.

use isopeel_extraction::Shown;
use isopeel_view::CameraJson;

use super::super::backend::Backend;
use super::Session;
use super::generation::Generation;
use super::surface::SurfaceSession;

impl<B: Backend> Session<B> {
    /// Handles the message `camera`.
    pub(super) fn on_camera(&mut self, camera: Option<CameraJson>) {
        if let Some(Err(error)) = camera.as_ref().map(CameraJson::check) {
            return self.send_error("bad-message", error.to_string(), true);
        }
        self.camera = camera;
        self.stopped_camera = None;
        self.broadcast_camera();
        self.make_way_for_camera();
    }

    /// Postpones work at rest for surfaces that were made for another camera.
    pub(super) fn make_way_for_camera(&mut self) {
        let camera = self.camera_in_force();
        let Some(opened) = &mut self.opened else { return };
        for (_, surface) in opened.surfaces_mut() {
            if surface.has_to_follow(camera.as_ref())
                && let Some(rest) = surface.rest_mut()
            {
                rest.postpone();
            }
        }
    }

    /// Tells followers the camera, if this member has control.
    pub(super) fn broadcast_camera(&self) {
        if let Some(member) = &self.member {
            member.broadcast_camera(self.camera.clone());
        }
    }

    /// Returns the camera for which surfaces are made: the viewer's own, or else that of the member in control whom the viewer follows.
    pub(super) fn camera_in_force(&self) -> Option<CameraJson> {
        let own = || self.camera.clone();
        own().or_else(|| self.member.as_ref()?.led_camera())
    }

    /// Begins a generation of each surface that was made for another camera, if nothing else is waited for.
    pub(super) fn follow_camera(&mut self) {
        let camera = self.camera_in_force();
        let is_stopped = self.stopped_camera.as_ref() == Some(&camera);
        let Some(opened) = &mut self.opened else { return };
        if is_stopped || opened.is_awaited() || self.questions.is_asked() {
            return;
        }
        let before = self.last_generation;
        // All members of a group share one step, whatever cut each of them holds.
        let shares_step = self.member.is_some();
        for (number, surface) in opened.surfaces_mut() {
            if surface.has_to_follow(camera.as_ref()) {
                self.last_generation += 1;
                surface.begin_for_camera(number, self.last_generation, camera.clone(), (self.jobs, shares_step));
            }
        }
        if self.last_generation > before {
            self.questions.drop_annotation();
            self.outbox.drop_annotations();
        }
    }
}

impl SurfaceSession {
    /// Whether the client holds a cut of the vertex tree that was made for another camera than this one.
    fn has_to_follow(&self, camera: Option<&CameraJson>) -> bool {
        // Without a key, an edit is in force of which no surface was asked for.
        let (Some(held), Some(_)) = (&self.shown, &self.key) else {
            return false;
        };
        let is_tree_cut = held.view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
        is_tree_cut && self.failed.is_none() && held.view.follows_camera() && held.view.camera.as_deref() != camera
    }

    /// Begins a generation of the view in force for another camera. The surface changes in one step. `shares_step`: whether others who hold
    /// other cuts are to be sent the same step, which is the whole surface then.
    fn begin_for_camera(
        &mut self,
        surface: u8,
        number: u32,
        camera: Option<CameraJson>,
        (jobs, shares_step): (u64, bool),
    ) {
        let Some(key) = self.key.clone() else { return };
        let view = self.view_for(camera);
        let shown = match self.shown.as_ref().map(|held| held.shown_for(&key, &view)) {
            Some(Shown::Cut(id)) if !shares_step => Shown::AlikeCut(id),
            _ => Shown::Alike,
        };
        self.begin_generation(Generation::for_camera(surface, number, view, key, shown), jobs);
    }
}
