//! A session in a group: the member in control broadcasts its views, and the others follow.

use data_encoding::HEXLOWER;
use isopeel_codec::chunk::{Coding, reads_values};

use super::super::backend::Backend;
use super::super::groups::{GroupError, GroupEvent, Leader, Scene};
use super::Session;
use super::open_volume::OpeningPhase;
use super::outbox::Newest;
use super::pending::{BudgetEdit, PendingStep};
use crate::access::{Occupant, Role};
use crate::wire::group::{Pose, Resume, check_name};
use crate::wire::messages::{ClientMessage, ServerMessage};

/// Random bytes of a group's id, which is all that a viewer with the role `view` needs to follow. The leader's key has as many.
const ID_BYTES: usize = 16;

impl<B: Backend> Session<B> {
    /// Handles a message that changes the surfaces shown. Refuses it from members without control.
    pub(super) fn on_change(&mut self, message: ClientMessage) {
        if self.member.as_ref().is_some_and(|member| !member.has_control()) {
            return self.refuse(GroupError::NotInControl);
        }
        match message {
            ClientMessage::Open { volume, step, codings } => {
                self.use_codings(&codings);
                self.on_open(&volume, step);
            }
            ClientMessage::Step { step } => self.on_step(step),
            ClientMessage::Edit(message) => self.on_edit(message.surface, &message.edit),
            ClientMessage::Remove { .. } if !self.who.may(Role::Edit) => self.refuse_edit(),
            ClientMessage::Remove { surface } => self.on_remove(surface),
            _ => {}
        }
        self.lead_or_follow();
    }

    /// Handles a message about the group itself.
    pub(super) fn on_group_message(&mut self, message: ClientMessage) {
        match message {
            ClientMessage::Lead { .. } | ClientMessage::AskControl { .. } if !self.who.may(Role::Edit) => {
                self.refuse_edit()
            }
            ClientMessage::Lead { resume: None, .. } => self.on_lead(),
            ClientMessage::Lead {
                resume: Some(resume),
                codings,
            } => {
                self.choose_coding(&codings);
                self.on_resume(resume);
            }
            ClientMessage::Join { group, name, codings } => {
                self.choose_coding(&codings);
                self.on_join(&group, name);
            }
            ClientMessage::Leave {} => self.leave("you have left it"),
            ClientMessage::Pose(pose) => self.on_pose(pose),
            ClientMessage::AskControl { asks } => match &self.member {
                Some(member) => member.request_control(asks),
                None => self.refuse(GroupError::NoMember),
            },
            ClientMessage::GiveControl { to } => {
                let member = self.member.as_ref().ok_or(GroupError::NoMember);
                if let Err(error) = member.and_then(|member| member.give_control(to)) {
                    self.refuse(error);
                }
            }
            _ => {}
        }
    }

    /// Chooses the coding from those that the client can read. If the client lists none, the coding stays as it was.
    fn choose_coding(&mut self, codings: &[String]) {
        if !codings.is_empty() {
            self.use_codings(codings);
        }
    }

    fn use_codings(&mut self, codings: &[String]) {
        self.coding = Coding::asked_for(codings);
        self.reads_values = reads_values(codings);
    }

    fn refuse(&mut self, error: GroupError) {
        self.send_error(error.code(), error.to_string(), true);
    }

    fn on_lead(&mut self) {
        if self.opened.is_none() {
            return self.send_error("not-open", "no volume is open, expected `open` first", true);
        }
        let (mut id, mut key) = ([0; ID_BYTES], [0; ID_BYTES]);
        if getrandom::fill(&mut id).and(getrandom::fill(&mut key)).is_err() {
            return self.send_error("busy", "the system has no random numbers", true);
        }
        // A viewer is in one group at a time, so it leaves the one before.
        self.leave_quietly();
        let leader = self.leader(HEXLOWER.encode(&key));
        match self.common.groups.lead(HEXLOWER.encode(&id), leader) {
            Ok(member) => {
                self.member = Some(member);
                self.lead_or_follow();
            }
            Err(error) => self.refuse(error),
        }
    }

    /// Returns this viewer as the leader of a group.
    fn leader(&self, key: String) -> Leader {
        Leader {
            who: Occupant::from(&self.who),
            key,
        }
    }

    /// Resumes the lead of a group that the viewer has led on another connection.
    fn on_resume(&mut self, Resume { group, key }: Resume) {
        self.leave_quietly();
        match self.common.groups.resume(&group, &self.leader(key)) {
            Ok(member) => {
                self.member = Some(member);
                self.lead_or_follow();
            }
            Err(error) => self.refuse(error),
        }
    }

    /// Leaves the viewer's group, if there is one, without a message to the client.
    fn leave_quietly(&mut self) {
        if let Some(member) = self.member.take() {
            member.leave();
        }
    }

    fn on_join(&mut self, group: &str, name: Option<String>) {
        if let Some(Err(why)) = name.as_deref().map(check_name) {
            return self.send_error("bad-message", why, true);
        }
        self.leave_quietly();
        match self.common.groups.join(group, name, self.who.may(Role::Edit)) {
            Ok(member) => {
                self.member = Some(member);
                self.send_members();
                self.lead_or_follow();
            }
            Err(error) => self.refuse(error),
        }
    }

    fn leave(&mut self, reason: &str) {
        for kind in [Newest::Group, Newest::Led, Newest::Posed] {
            self.outbox.drop_newest(kind);
        }
        match self.member.take() {
            Some(member) => {
                member.leave();
                self.send(&ServerMessage::Left { reason: reason.into() });
            }
            None => self.refuse(GroupError::NoMember),
        }
    }

    fn on_pose(&mut self, pose: Pose) {
        if let Err(why) = pose.check() {
            return self.send_error("bad-message", why, true);
        }
        match self.member.as_ref().map(|member| member.broadcast_pose(pose)) {
            Some(Ok(())) => {}
            Some(Err(error)) => self.refuse(error),
            None => self.refuse(GroupError::NoMember),
        }
    }

    pub(super) fn on_group_event(&mut self, event: GroupEvent) {
        match event {
            GroupEvent::Scene => self.lead_or_follow(),
            GroupEvent::Camera => self.make_way_for_camera(),
            GroupEvent::Members => self.send_members(),
            GroupEvent::Pose(pose) => {
                let message = ServerMessage::Posed { pose: (*pose).clone() };
                self.outbox.push_newest(Newest::Posed, message.to_json());
            }
            GroupEvent::Ended(reason) => self.leave(reason),
        }
    }

    fn send_members(&mut self) {
        if let Some(member) = &self.member {
            self.outbox
                .push_newest(Newest::Group, member.members_message().to_json());
        }
    }

    /// Broadcasts this session's views if this member has control; otherwise follows the member in control.
    pub(super) fn lead_or_follow(&mut self) {
        let Some(member) = &mut self.member else { return };
        if let Some(scene) = member.scene() {
            self.outbox.push_newest(Newest::Led, scene.message().to_owned());
            return self.follow(&scene);
        }
        let Some(opened) = &self.opened else { return };
        // While the volume is being opened, its isovalue is not known.
        if member.has_control() && opened.phase == OpeningPhase::Open {
            member.broadcast_camera(self.camera.clone());
            let surfaces = opened.surfaces().filter(|(_, surface)| surface.last_edit > 0);
            let surfaces = surfaces
                .map(|(number, surface)| (number, surface.view.clone()))
                .collect();
            member.broadcast_scene(Scene::new(opened.volume.clone(), surfaces));
        }
    }

    /// Applies the views of the member in control. The viewer needs no role for that, but must be allowed to see the volume.
    fn follow(&mut self, scene: &Scene) {
        let open = self.opened.as_ref();
        let is_same_volume = open.is_some_and(|opened| opened.volume.dataset().key() == scene.volume.dataset().key());
        let is_open = open.is_some_and(|opened| opened.phase == OpeningPhase::Open);
        let is_same_step = open.is_some_and(|opened| opened.volume.key() == scene.volume.key());
        match (is_same_volume, is_same_step) {
            (true, true) => {}
            (true, false) if is_open => self.bring_step_into_force(PendingStep {
                volume: scene.volume.clone(),
                cancelled_after: None,
            }),
            // A volume that this viewer could not open is not tried again.
            _ if open.is_none() && self.tried.as_ref() == Some(&scene.volume.key()) => return,
            _ => {
                self.tried = Some(scene.volume.key());
                self.open_led(&scene.volume);
            }
        }
        // Drop pending edits and time steps that this viewer requested before it followed.
        if let Some(opened) = &mut self.opened {
            opened.stepping = None;
            opened.surfaces_mut().for_each(|(_, surface)| surface.pending = None);
        }
        // The surfaces are applied once the volume is open.
        if self
            .opened
            .as_ref()
            .is_none_or(|opened| opened.phase != OpeningPhase::Open)
        {
            return;
        }
        self.follow_surfaces(scene);
    }

    /// Makes this session's surfaces equal to those of a scene of the open volume.
    fn follow_surfaces(&mut self, scene: &Scene) {
        for (number, view) in &scene.surfaces {
            let Some(opened) = &self.opened else { return };
            let was_edited = opened.surface(*number).is_some_and(|surface| surface.last_edit > 0);
            if !was_edited || opened.view_of(*number) != *view {
                self.begin_edit();
                let edit = self.edits;
                let budget_edit = view.budget.map(|budget| BudgetEdit { budget, edit });
                self.come_into_force(*number, view.clone(), budget_edit, edit, true);
            }
        }
        let Some(opened) = &self.opened else { return };
        let is_gone = |number: &u8| scene.surfaces.iter().all(|(shown, _)| shown != number);
        let edited = opened.surfaces().filter(|(_, surface)| surface.last_edit > 0);
        let gone: Vec<u8> = edited.map(|(number, _)| number).filter(is_gone).collect();
        for number in gone {
            self.on_remove(u32::from(number));
        }
    }
}
