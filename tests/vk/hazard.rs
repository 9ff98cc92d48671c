//! The hazard checker's bookkeeping, without a device.

use ashsplat::vk::Access::{self, Read, ReadWrite, Write};
use ashsplat::vk::hazard::{Hazard, HazardTracker, Use, undeclared_alias};
use std::ops::Range;

fn touch(block: u64, bytes: Range<u64>, access: Access) -> Use {
    Use { block, bytes, buffer: "keys", role: "sorted_keys", access, aliased: false }
}

/// The hazards between two commands that touch the same bytes.
fn between(first: Access, second: Access) -> Vec<Hazard> {
    let mut tracker = HazardTracker::new();
    assert!(tracker.command("count", &[touch(1, 0..64, first)]).is_empty());
    tracker.command("scatter", &[touch(1, 0..64, second)])
}

#[test]
fn each_kind_of_hazard_is_found() {
    let kind = |first, second| between(first, second).first().map(Hazard::kind);
    assert_eq!(kind(Write, Read), Some("read after write"));
    assert_eq!(kind(Read, Write), Some("write after read"));
    assert_eq!(kind(Write, Write), Some("write after write"));
    assert_eq!(kind(Read, ReadWrite), Some("write after read"));
    assert_eq!(kind(ReadWrite, Read), Some("read after write"));
    assert_eq!(kind(ReadWrite, ReadWrite), Some("read and write after write"));
    assert_eq!(kind(Read, Read), None);
}

#[test]
fn the_message_names_both_commands_the_buffer_and_both_accesses() {
    let message = between(Write, ReadWrite)[0].to_string();
    for part in ["'scatter' reads and writes", "'count' writes", "'keys'", "'sorted_keys'", "64 bytes"] {
        assert!(message.contains(part), "{part} is missing: {message}");
    }
}

#[test]
fn a_barrier_orders_everything_before_it() {
    let mut tracker = HazardTracker::new();
    tracker.command("a", &[touch(1, 0..64, Write)]);
    tracker.barrier();
    assert!(tracker.command("b", &[touch(1, 0..64, ReadWrite)]).is_empty());
    assert_eq!(tracker.command("c", &[touch(1, 0..64, Read)]).len(), 1, "and nothing after it");
}

#[test]
fn only_bytes_in_common_of_one_block_conflict() {
    let mut tracker = HazardTracker::new();
    tracker.command("a", &[touch(1, 0..64, Write)]);
    assert!(tracker.command("b", &[touch(1, 64..128, Write)]).is_empty(), "neighbours");
    assert!(tracker.command("c", &[touch(2, 0..64, Write)]).is_empty(), "another block");
    assert_eq!(tracker.command("d", &[touch(1, 63..64, Read)]).len(), 1, "the last byte");
}

#[test]
fn a_command_may_read_and_write_its_own_buffers() {
    let mut tracker = HazardTracker::new();
    let own = [touch(1, 0..64, Read), touch(1, 0..64, Write), touch(1, 0..64, ReadWrite)];
    assert!(tracker.command("adam", &own).is_empty());
}

#[test]
fn an_earlier_read_does_not_hide_an_earlier_write() {
    let mut tracker = HazardTracker::new();
    tracker.command("a", &[touch(1, 0..64, Write)]);
    tracker.barrier();
    tracker.command("b", &[touch(1, 0..64, Read)]);
    tracker.command("c", &[touch(1, 32..64, Read)]);
    let hazards = tracker.command("d", &[touch(1, 48..52, Write)]);
    assert_eq!(hazards.len(), 1);
    assert_eq!(hazards[0].first.0, "b");
}

/// A command may read and write memory through one binding. Through two, the shader must declare it.
#[test]
fn one_memory_by_two_bindings_is_declared_in_the_shader() {
    let check = |a: Use, b: Use| undeclared_alias("adam", &[touch(1, 0..64, ReadWrite), a, b]);
    let said = check(touch(2, 0..64, Read), touch(2, 32..96, Write)).expect("an alias");
    assert!(said.contains("'adam'") && said.contains("'keys' as 'sorted_keys'"), "{said}");
    assert_eq!(check(touch(2, 0..64, Read), touch(2, 0..64, Read)), None, "nothing is written");
    assert_eq!(check(touch(2, 0..64, Write), touch(2, 0..64, Write)), None, "nothing is read elsewhere");
    assert_eq!(check(touch(2, 0..64, Write), touch(2, 64..128, Write)), None, "neighbours");
    let aliased = |access| Use { aliased: true, ..touch(2, 0..64, access) };
    assert_eq!(check(aliased(Read), aliased(Write)), None);
    assert!(check(aliased(Read), touch(2, 0..64, Write)).is_some(), "both are to be declared");
}
