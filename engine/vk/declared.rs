//! Accesses that a recording's commands declare to the hazard checker.

use super::binding::BindingInfo;
use super::buffer::Buffer;
use super::hazard::Access;
use super::hazard::{HazardTracker, Use, undeclared_alias};
use super::image::Image;

/// Accesses of the current command, and earlier ones.
#[derive(Default)]
pub(super) struct Hazards {
    pub(super) tracker: HazardTracker,
    pub(super) uses: Vec<Use>,
    /// None: a hazard panics.
    #[cfg(feature = "testing")]
    pub(super) collected: Option<Vec<String>>,
}

impl Hazards {
    pub(super) fn add(&mut self, buffer: &Buffer, role: &'static str, access: Access) {
        let (block, buffer, bytes) =
            (buffer.block().id, buffer.static_name(), buffer.offset()..buffer.offset() + buffer.bytes());
        self.uses.push(Use { block, bytes, buffer, role, access, aliased: false });
    }

    pub(super) fn add_binding(&mut self, buffer: &Buffer, info: &BindingInfo) {
        self.add(buffer, info.name, info.access);
        if let Some(added) = self.uses.last_mut() {
            added.aliased = info.aliased;
        }
    }

    pub(super) fn add_image(&mut self, image: &Image, role: &'static str, access: Access) {
        let (block, buffer) = (image.id(), image.name());
        self.uses.push(Use { block, bytes: 0..1, buffer, role, access, aliased: false });
    }

    pub(super) fn commit(&mut self, command: &'static str) {
        let found = self.tracker.command(command, &self.uses);
        let alias = undeclared_alias(command, &self.uses);
        self.uses.clear();
        #[cfg(feature = "testing")]
        if let Some(collected) = &mut self.collected {
            collected.extend(found.iter().map(ToString::to_string));
            collected.extend(alias);
            return;
        }
        if let Some(alias) = alias {
            panic!("{alias}");
        }
        if let Some(hazard) = found.first() {
            panic!("{hazard}");
        }
    }
}
