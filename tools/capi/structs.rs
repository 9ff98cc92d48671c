//! Structs that hosts fill, and how they grow.
//!
//! Each begins with its size in the header of the host's compilation. `ASHSPLAT_INIT` sets it together with the defaults. With
//! an older header a host has a smaller struct: the missing fields get their defaults. With a newer header it has a larger
//! struct, whose surplus bytes must be zero. So later fields have the default 0, and no padding precedes them. Such a struct is
//! never part of another one. In an array, all have the size of the first. A size below the first header's means that it was
//! not set; the error says how to set it.

use super::scratch::{List, Scratch};
use super::{
    AshsplatAlignment, AshsplatAllocator, AshsplatCamera, AshsplatCutOut, AshsplatDemand,
    AshsplatDepthTarget, AshsplatForeignDevice, AshsplatForeignImage, AshsplatGaussians, AshsplatGradients,
    AshsplatMaintenance, AshsplatMotionTarget, AshsplatOccluder, AshsplatPickTarget, AshsplatPlaced,
    AshsplatPose, AshsplatRecordedFrame, AshsplatRelease, AshsplatRenderSettings, AshsplatReservation,
    AshsplatScenePlan, AshsplatSceneSettings, AshsplatSlotReport, AshsplatStep, AshsplatTarget, AshsplatTile,
    AshsplatTrainView, AshsplatUpdate,
};
use ashsplat::{Error, Result};
use std::mem::{MaybeUninit, offset_of, size_of};

/// A struct that begins with its size.
///
/// # Safety
/// The first field is `struct_size: u32` of `#[repr(C)]`. The others are numbers, booleans, pointers, optional functions, and
/// structs of these.
pub(super) unsafe trait Grows: Copy + Default {
    /// Name in C.
    const NAME: &'static str;
    /// Size in the first header.
    const FIRST: usize;
}

/// Fields with defaults other than zero, and their values as written in the source. `ASHSPLAT_INIT` is generated from them.
pub type Defaults = (&'static str, &'static [(&'static str, &'static str)]);

/// End of a field that begins at `begin`.
const fn end<T, F>(begin: usize, _: fn(&T) -> &F) -> usize {
    begin + size_of::<F>()
}

/// For each struct: its name, its last field in the first header, and its last field now. No padding may follow the last one,
/// since the next field begins at today's size. Then the defaults other than zero.
macro_rules! structs {
    ($($name:ident, $first:ident..$last:ident, { $($field:ident: $value:expr),* };)*) => {
        $(
            $(
                const _: () = assert!(
                    offset_of!($name, $field) <= offset_of!($name, $first),
                    "a later field's default is 0: an older library takes nothing else for unset"
                );
            )*

            const _: () = assert!(
                offset_of!($name, struct_size) == 0
                    && end::<$name, _>(offset_of!($name, $last), |it| &it.$last) == size_of::<$name>(),
                "padding at the end"
            );

            // SAFETY: the type's definition shows it.
            unsafe impl Grows for $name {
                const NAME: &'static str = stringify!($name);
                const FIRST: usize = end::<$name, _>(offset_of!($name, $first), |it| &it.$first);
            }

            impl Default for $name {
                fn default() -> Self {
                    // SAFETY: zero is valid for all fields.
                    let mut it: Self = unsafe { MaybeUninit::zeroed().assume_init() };
                    it.struct_size = size_of::<Self>() as u32;
                    $(it.$field = $value;)*
                    it
                }
            }
        )*

        /// All structs with a size.
        #[doc(hidden)]
        pub const STRUCTS: &[Defaults] =
            &[$((stringify!($name), &[$((stringify!($field), stringify!($value))),*])),*];
    };
}

/// Rows of the identity rotation.
pub(super) const UPRIGHT: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

structs! {
    // Same as Alignment::default.
    AshsplatAlignment, lambda_dssim..lambda_dssim, { steps: 100, lr: 2e-3, lambda_dssim: 2e-1 };
    AshsplatAllocator, free..free, {};
    AshsplatCamera, height..projection, { camera_from_world: UPRIGHT };
    AshsplatCutOut, scale..scale, { scene_from_volume: UPRIGHT, scale: 1.0 };
    AshsplatDemand, border..border, {};
    AshsplatDepthTarget, to..to, {};
    AshsplatForeignDevice, pipeline_cache..shader_subgroup_uniform_control_flow, {};
    AshsplatForeignImage, image..image, { samples: 1 };
    AshsplatGaussians, sh..sh, {};
    AshsplatGradients, pose..pose, {};
    AshsplatMaintenance, skipped..skipped, {};
    AshsplatMotionTarget, to..to, {};
    AshsplatOccluder, mapping..mapping, {};
    AshsplatPickTarget, to..to, {};
    AshsplatPlaced, scale..previous_pose, { world_from_object: UPRIGHT, scale: 1.0 };
    AshsplatPose, scale..scale, { world_from_object: UPRIGHT, scale: 1.0 };
    AshsplatRecordedFrame, motion..motion, {};
    AshsplatRelease, motion..motion, {};
    AshsplatRenderSettings, scale_modifier..filter_3d, { sh_degree: 3, scale_modifier: 1.0 };
    AshsplatReservation, staging_bytes..filter_3d, { slots: 1, queues: 1, scenes: 1 };
    AshsplatScenePlan, chunk_bytes..chunk_bytes, {};
    AshsplatSceneSettings, selection_share..selection_share, {
        visible: true, tint: [1.0, 1.0, 1.0], opacity: 1.0, sh_degree: 3, selection_color: [1.0, 1.0, 1.0], selection_share: 0.5
    };
    AshsplatSlotReport, visible..entries_per_pass, {};
    AshsplatStep, view..view, {};
    AshsplatTarget, to..to, { exposure: 1.0 };
    AshsplatTile, max..max, {};
    AshsplatTrainView, rgb..camera_id, {};
    AshsplatUpdate, gaussians..gaussians, {};
}

/// Largest plausible size: a larger one is uninitialised memory.
const LARGEST: usize = 4096;

/// Prefixes an error's argument with its outer argument.
pub(super) fn within(outer: impl std::fmt::Display) -> impl FnOnce(Error) -> Error {
    move |error| match error {
        Error::Argument { what, problem } => Error::argument(format!("{outer}.{what}"), problem),
        other => other,
    }
}

/// Replaces an error's argument by the caller's name for it.
pub(super) fn named(name: impl std::fmt::Display) -> impl FnOnce(Error) -> Error {
    move |error| match error {
        Error::Argument { problem, .. } => Error::argument(name.to_string(), problem),
        other => other,
    }
}

/// Appends an index to an error's argument.
fn element(index: usize) -> impl FnOnce(Error) -> Error {
    move |error| match error {
        Error::Argument { what, problem } => Error::argument(format!("{what}[{index}]"), problem),
        other => other,
    }
}

/// Returns the size that a host's struct claims.
///
/// # Safety
/// The pointer is valid for reading a number.
unsafe fn size_of_hosts<T: Grows>(pointer: *const T, what: &str) -> Result<usize> {
    // SAFETY: as promised; the number is the first field.
    let size = unsafe { pointer.cast::<u32>().read_unaligned() } as usize;
    let (name, own) = (T::NAME, size_of::<T>());
    match size {
        0 => {
            let problem = format!("struct_size is 0: begin with ASHSPLAT_INIT({name})");
            Err(Error::argument(what, problem))
        }
        _ if (T::FIRST..=LARGEST).contains(&size) && size.is_multiple_of(4) => Ok(size),
        _ => {
            let problem =
                format!("struct_size is {size}, {name} has {own}: begin with ASHSPLAT_INIT({name})");
            Err(Error::argument(what, problem))
        }
    }
}

/// Reads a host's struct, of any header's size.
///
/// # Safety
/// The pointer is null or valid for as many bytes as the struct claims.
pub(super) unsafe fn read<T: Grows>(pointer: *const T, what: &str) -> Result<T> {
    if pointer.is_null() {
        return Err(Error::argument(what, "the pointer is null"));
    }
    let (mut it, own) = (T::default(), size_of::<T>());
    // SAFETY: as promised; all bytes of the host's fields are valid values.
    unsafe {
        let size = size_of_hosts(pointer, what)?;
        let bytes = pointer.cast::<MaybeUninit<u8>>();
        std::ptr::copy_nonoverlapping(bytes, (&raw mut it).cast(), size.min(own));
        (&raw mut it).cast::<u32>().write(own as u32);
        if size > own {
            let tail = std::slice::from_raw_parts(pointer.cast::<u8>().add(own), size - own);
            if let Some(place) = tail.iter().position(|byte| *byte != 0) {
                let problem = format!(
                    "struct_size is {size}, this version knows {own} bytes of {}, and what the host has set at byte {} is \
                     unknown to it: use a newer library",
                    T::NAME,
                    own + place
                );
                return Err(Error::argument(what, problem));
            }
        }
    }
    Ok(it)
}

/// Same as [`read`], but the pointer may be null.
///
/// # Safety
/// Same as for [`read`].
pub(super) unsafe fn read_if<T: Grows>(pointer: *const T, what: &str) -> Result<Option<T>> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(None) } else { unsafe { read(pointer, what) }.map(Some) }
}

/// Reads a host's array, whose elements have the size of the first.
///
/// # Safety
/// The pointer is valid for `count` structs of that size, or the count is 0.
pub(super) unsafe fn read_all<T: Grows>(pointer: *const T, count: u32, what: &str) -> Result<Vec<T>> {
    let mut all = Vec::new();
    // SAFETY: as promised.
    unsafe { read_into(&mut all, Vec::reserve, (pointer, count), what) }.map(|()| all)
}

/// Same as [`read_all`], but in reused memory.
///
/// # Safety
/// Same as for [`read_all`].
pub(super) unsafe fn read_all_in<'b, T: Grows>(
    scratch: &'b Scratch,
    pointer: *const T,
    count: u32,
    what: &str,
) -> Result<List<'b, T>> {
    let mut all = List::new_in(scratch);
    // SAFETY: as promised.
    unsafe { read_into(&mut all, List::reserve, (pointer, count), what) }.map(|()| all)
}

/// # Safety
/// Same as for [`read_all`].
unsafe fn read_into<T: Grows, L: Extend<T>>(
    all: &mut L,
    reserve: impl Fn(&mut L, usize),
    (pointer, count): (*const T, u32),
    what: &str,
) -> Result<()> {
    if count == 0 {
        return Ok(());
    }
    if pointer.is_null() {
        return Err(Error::argument(what, "the pointer is null"));
    }
    reserve(all, count as usize);
    // SAFETY: as promised.
    unsafe {
        // Only errors need names.
        let stride = size_of_hosts(pointer, what).map_err(element(0))?;
        for index in 0..count as usize {
            let at = pointer.byte_add(index * stride);
            let size = at.cast::<u32>().read_unaligned() as usize;
            if size != stride && size != 0 {
                let problem = format!("struct_size is {size}, that of {what}[0] is {stride}");
                return Err(Error::argument(format!("{what}[{index}]"), problem));
            }
            all.extend([read(at, what).map_err(element(index))?]);
        }
    }
    Ok(())
}

/// Writes a value into a host's struct, as far as its size reaches.
///
/// # Safety
/// The pointer is null or valid for as many bytes as the struct claims.
pub(super) unsafe fn write<T: Grows>(pointer: *mut T, what: &str, value: T) -> Result<()> {
    if pointer.is_null() {
        return Err(Error::argument(what, "the pointer is null"));
    }
    // SAFETY: as promised; the host's size stays.
    unsafe {
        let size = size_of_hosts(pointer, what)?.min(size_of::<T>());
        let from = (&raw const value).cast::<MaybeUninit<u8>>();
        std::ptr::copy_nonoverlapping(from.add(4), pointer.cast::<MaybeUninit<u8>>().add(4), size - 4);
    }
    Ok(())
}

/// Same as [`write`], but the pointer may be null.
///
/// # Safety
/// Same as for [`write`].
pub(super) unsafe fn write_if<T: Grows>(pointer: *mut T, what: &str, value: T) -> Result<()> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(()) } else { unsafe { write(pointer, what, value) } }
}

/// Same as [`write`], but for an array, which may be null.
///
/// # Safety
/// The pointer is null or valid for `values.len()` structs of the first one's size.
pub(super) unsafe fn write_all_if<T: Grows>(pointer: *mut T, what: &str, values: &[T]) -> Result<()> {
    if pointer.is_null() || values.is_empty() {
        return Ok(());
    }
    // SAFETY: as promised.
    unsafe {
        let stride = size_of_hosts(pointer, what)?;
        let mut all = values.iter().enumerate();
        all.try_for_each(|(index, value)| write(pointer.byte_add(index * stride), what, *value))
    }
}

/// Checks that a struct can be written, before the work that makes its value.
///
/// # Safety
/// Same as for [`write`].
pub(super) unsafe fn check_room<T: Grows>(pointer: *mut T, what: &str) -> Result<()> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(()) } else { unsafe { size_of_hosts(pointer, what) }.map(drop) }
}

/// Same as [`check_room`], but for an array.
///
/// # Safety
/// Same as for [`write_all_if`].
pub(super) unsafe fn check_room_of_all<T: Grows>(pointer: *mut T, count: u32, what: &str) -> Result<()> {
    if pointer.is_null() || count == 0 {
        return Ok(());
    }
    // SAFETY: as promised.
    unsafe {
        let stride = size_of_hosts(pointer, what).map_err(element(0))?;
        (1..count as usize).try_for_each(|index| {
            let size = pointer.byte_add(index * stride).cast::<u32>().read_unaligned() as usize;
            match size == stride {
                true => Ok(()),
                false => {
                    let problem = format!("struct_size is {size}, that of {what}[0] is {stride}");
                    Err(Error::argument(format!("{what}[{index}]"), problem))
                }
            }
        })
    }
}
