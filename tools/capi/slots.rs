//! Frames in flight, in C.

use super::*;
use ashsplat::Reservation;
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::vk::Buffer;

/// Allocates frame slots and builds all kernels that frames of this kind need. Replaces the previous slots,
/// whose command buffers must have finished.
///
/// # Safety
/// `renderer` and `wanted` are alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_reserve(
    renderer: *mut AshsplatRenderer,
    wanted: *const AshsplatReservation,
) -> AshsplatStatus {
    guarded!({
        let (renderer, wanted) = (borrowed_mut(renderer, "renderer")?, read(wanted, "wanted")?);
        renderer.0.reserve(&wanted.checked()?)
    })
}

/// Same as ashsplat_reserve, but while frames are in flight, without waiting. Every slot changes to the new memory at its
/// next recording, with images_only also at its release; until then both memories exist. The numbers of slots and of views
/// stay. The new reservation replaces the earlier one: a smaller one gives memory back.
///
/// # Safety
/// `renderer` and `wanted` are alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_grow(
    renderer: *mut AshsplatRenderer,
    wanted: *const AshsplatReservation,
) -> AshsplatStatus {
    guarded!({
        let (renderer, wanted) = (borrowed_mut(renderer, "renderer")?, read(wanted, "wanted")?);
        renderer.0.grow(&wanted.checked()?)
    })
}

/// Enlarges a reservation to what a frame needed, with half as many instances again; unchanged if the frame fitted. For
/// ashsplat_grow or ashsplat_reserve. `grown` may be `reservation`.
///
/// # Safety
/// `reservation` and `report` are valid, `grown` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_reservation_grown(
    reservation: *const AshsplatReservation,
    report: *const AshsplatSlotReport,
    grown: *mut AshsplatReservation,
) -> AshsplatStatus {
    guarded!({
        let (reservation, report) = (read(reservation, "reservation")?, read(report, "report")?);
        let Reservation { instances, blend_passes, .. } = reservation.checked()?.grown(&(&report).into());
        write(grown, "grown", AshsplatReservation { instances, blend_passes, ..reservation })
    })
}

/// Bytes of the block that a reservation takes: ashsplat_reserve_in. Allocates nothing.
///
/// # Safety
/// `renderer` and `wanted` are alive, `bytes` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_reservation_bytes(
    renderer: *const AshsplatRenderer,
    wanted: *const AshsplatReservation,
    bytes: *mut u64,
) -> AshsplatStatus {
    guarded!({
        let (renderer, wanted) = (borrowed(renderer, "renderer")?, read(wanted, "wanted")?);
        put(bytes, "bytes", renderer.0.reservation_bytes(&wanted.checked()?)?)
    })
}

/// Same as ashsplat_reserve, or with `grow` as ashsplat_grow, with all memory of the device in one buffer of the host's.
/// Besides it, each slot takes 36 bytes for each view that the host can read, and `staging_bytes`.
///
/// # Safety
/// `renderer`, `wanted` and `block` are alive. The buffer is of the context's device, bound to memory, has the usages
/// STORAGE_BUFFER, UNIFORM_BUFFER, INDIRECT_BUFFER, TRANSFER_SRC and TRANSFER_DST, no other user, and lives until all slots
/// use another reservation or the renderer is freed, and their frames have finished.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_reserve_in(
    renderer: *mut AshsplatRenderer,
    wanted: *const AshsplatReservation,
    block: *const AshsplatHostBuffer,
    grow: bool,
) -> AshsplatStatus {
    guarded!({
        let renderer = &mut borrowed_mut(renderer, "renderer")?.0;
        let (wanted, block) = (read(wanted, "wanted")?.checked()?, borrowed(block, "block")?);
        let raw = vk::Buffer::from_raw(block.buffer);
        let block = Buffer::adopt(renderer.context(), "frame slots", raw, block.offset, block.bytes)?;
        if grow { renderer.grow_in(&wanted, &block) } else { renderer.reserve_in(&wanted, &block) }
    })
}

/// The report of a slot's last frame, once it has finished. Never waits, except on llvmpipe, where reading
/// the time waits.
///
/// # Safety
/// `renderer` is alive, `report` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_report(
    renderer: *mut AshsplatRenderer,
    slot: u32,
    report: *mut AshsplatSlotReport,
) -> AshsplatStatus {
    guarded!({
        let made = borrowed_mut(renderer, "renderer")?.0.slot_report(slot)?;
        write(report, "report", made.map(AshsplatSlotReport::from).unwrap_or_default())
    })
}

/// The VkBuffer that a frame without target fills, and the byte offset in it: premultiplied red, green, blue
/// (display-encoded, as trained) and transmittance of each pixel, row by row, as floats. Usable as a storage buffer and a source of
/// transfers, until the renderer reserves again or, after ashsplat_grow, the slot is recorded again. The host may use it after the
/// frame, behind a barrier from AshsplatRelease's stages and accesses, until the slot is recorded again. A host that reads it in
/// other stages than compute and transfer, in a later command buffer, must wait for those stages before the next
/// recording.
///
/// # Safety
/// `renderer` is alive, `buffer` and `offset` are valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_pixels(
    renderer: *mut AshsplatRenderer,
    slot: u32,
    buffer: *mut u64,
    offset: *mut u64,
) -> AshsplatStatus {
    guarded!({ locate(&borrowed_mut(renderer, "renderer")?.0.slot_pixels(slot)?, buffer, offset) })
}

/// The VkBuffer with the sum of weights / z (AshsplatRenderSettings), and the byte offset in it: a float for
/// each pixel, row by row.
///
/// # Safety
/// Same as for ashsplat_slot_pixels.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_inverse_depth(
    renderer: *mut AshsplatRenderer,
    slot: u32,
    buffer: *mut u64,
    offset: *mut u64,
) -> AshsplatStatus {
    guarded!({ locate(&borrowed_mut(renderer, "renderer")?.0.slot_inverse_depth(slot)?, buffer, offset) })
}

/// # Safety
/// Both pointers are null or valid for a write.
unsafe fn locate(found: &Buffer, buffer: *mut u64, offset: *mut u64) -> Result<()> {
    let (raw, bytes) = found.handle();
    // SAFETY: as promised.
    unsafe {
        put(buffer, "buffer", raw.as_raw())?;
        put(offset, "offset", bytes)
    }
}

/// Says whether the last frame of a slot has finished. Commands that the host has recorded after it may
/// still run. Never waits.
///
/// # Safety
/// `renderer` is alive, `finished` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_finished(
    renderer: *mut AshsplatRenderer,
    slot: u32,
    finished: *mut bool,
) -> AshsplatStatus {
    guarded!({ put(finished, "finished", borrowed_mut(renderer, "renderer")?.0.slot_finished(slot)?) })
}

/// Releases what the last frame of a slot used. Scenes and views that were freed meanwhile are destroyed now
/// instead of at the slot's next recording.
///
/// # Safety
/// `renderer` is alive; the frame's command buffer has finished: its fence was waited for.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_release(renderer: *mut AshsplatRenderer, slot: u32) -> AshsplatStatus {
    guarded!({ borrowed_mut(renderer, "renderer")?.0.release_slot(slot) })
}

/// Forgets the last recording of a slot, whose command buffer was thrown away.
///
/// # Safety
/// `renderer` is alive; the command buffer was not submitted and never will be, or its execution has
/// finished.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_slot_discard(renderer: *mut AshsplatRenderer, slot: u32) -> AshsplatStatus {
    guarded!({
        borrowed_mut(renderer, "renderer")?.0.slot_recording(slot)?.discard();
        Ok(())
    })
}
