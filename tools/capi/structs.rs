//! Structs that hosts fill, and how they grow.
//!
//! Each begins with its size in the header of the host's compilation. `ASHSPLAT_INIT` sets it together with the defaults. With
//! an older header a host has a smaller struct: the missing fields get their defaults. With a newer header it has a larger
//! struct, whose surplus bytes must be zero. So later fields have the default 0, and no padding precedes them. Such a struct is
//! never part of another one. In an array, all have the size of the first. A size below the first header's means that it was
//! not set; the error says how to set it.

use super::*;
use std::mem::{MaybeUninit, offset_of, size_of};

/// A struct whose listed fields are those of the same names of another one.
macro_rules! same_fields {
    ($from:ident => $Into:ident { $($field:ident),* $(,)? } with { $($others:tt)* }) => {
        $Into { $($field: $from.$field,)* $($others)* }
    };
}
pub(super) use same_fields;

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

            // SAFETY: the listed types have only such fields, `struct_size` first.
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
    AshsplatCamera, height..shutter_shift, { camera_from_world: UPRIGHT };
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
    AshsplatRecordedFrame, motion..surface, {};
    AshsplatRelease, motion..surface, {};
    AshsplatRenderSettings, scale_modifier..distance_order, { sh_degree: 3, scale_modifier: 1.0 };
    AshsplatReservation, staging_bytes..distance_order, { slots: 1, queues: 1, scenes: 1 };
    AshsplatScenePlan, chunk_bytes..chunk_bytes, {};
    AshsplatSceneSettings, selection_share..selection_share, {
        visible: true, tint: [1.0, 1.0, 1.0], opacity: 1.0, sh_degree: 3, selection_color: [1.0, 1.0, 1.0], selection_share: 0.5
    };
    AshsplatSlotReport, visible..entries_per_pass, {};
    AshsplatStep, view..view, {};
    AshsplatSurfaceTarget, to..to, {};
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
    check_pointer(pointer, what)?;
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

/// Same as [`read`], with the same promise, but the pointer may be null.
pub(super) unsafe fn read_if<T: Grows>(pointer: *const T, what: &str) -> Result<Option<T>> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(None) } else { unsafe { read(pointer, what) }.map(Some) }
}

/// Reads the elements of a host's array, which have the size of the first.
///
/// # Safety
/// The pointer is valid for `count` structs of that size as long as the iterator lives, or the count is 0.
pub(super) unsafe fn read_all<T: Grows>(
    pointer: *const T,
    count: u32,
    what: &str,
) -> Result<impl Iterator<Item = Result<T>>> {
    // SAFETY: as promised.
    let stride = unsafe { stride_of_hosts(pointer, count, what)? };
    Ok((0..count as usize).map(move |index| {
        // SAFETY: as promised.
        unsafe {
            let at = pointer.byte_add(index * stride);
            // A size of 0 has an error of its own.
            if at.cast::<u32>().read_unaligned() != 0 {
                check_stride(pointer, index, stride, what)?;
            }
            read(at, what).map_err(element(index))
        }
    }))
}

/// Returns the size that the first element of a host's array claims, or 0 if there is none.
///
/// # Safety
/// The pointer is null or valid for reading a number, or the count is 0.
unsafe fn stride_of_hosts<T: Grows>(pointer: *const T, count: u32, what: &str) -> Result<usize> {
    if count == 0 {
        return Ok(0);
    }
    check_pointer(pointer, what)?;
    // SAFETY: as promised.
    unsafe { size_of_hosts(pointer, what).map_err(element(0)) }
}

/// Checks that an element of a host's array has the size of the first one.
///
/// # Safety
/// The elements up to this one are valid.
unsafe fn check_stride<T>(pointer: *const T, index: usize, stride: usize, what: &str) -> Result<()> {
    // SAFETY: as promised.
    let size = unsafe { pointer.byte_add(index * stride).cast::<u32>().read_unaligned() } as usize;
    if size == stride {
        return Ok(());
    }
    let problem = format!("struct_size is {size}, that of {what}[0] is {stride}");
    Err(Error::argument(what, problem)).map_err(element(index))
}

/// Writes a value into a host's struct, as far as its size reaches.
///
/// # Safety
/// The pointer is null or valid for as many bytes as the struct claims.
pub(super) unsafe fn write<T: Grows>(pointer: *mut T, what: &str, value: T) -> Result<()> {
    check_pointer(pointer, what)?;
    // SAFETY: as promised; the host's size stays.
    unsafe {
        let size = size_of_hosts(pointer, what)?.min(size_of::<T>());
        let from = (&raw const value).cast::<MaybeUninit<u8>>();
        std::ptr::copy_nonoverlapping(from.add(4), pointer.cast::<MaybeUninit<u8>>().add(4), size - 4);
    }
    Ok(())
}

/// Writes values into a host's array, or nothing if the pointer is null.
///
/// # Safety
/// The pointer is null or valid for `values.len()` structs of the first one's size.
pub(super) unsafe fn write_if<T: Grows>(pointer: *mut T, what: &str, values: &[T]) -> Result<()> {
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

/// Checks that a struct can be written, before the work that makes its value. The promise is that of [`write`].
pub(super) unsafe fn check_room<T: Grows>(pointer: *mut T, what: &str) -> Result<()> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(()) } else { unsafe { size_of_hosts(pointer, what) }.map(drop) }
}

/// Same as [`check_room`], but for an array as in [`write_if`].
pub(super) unsafe fn check_room_of_all<T: Grows>(pointer: *mut T, count: u32, what: &str) -> Result<()> {
    if pointer.is_null() {
        return Ok(());
    }
    // SAFETY: as promised.
    unsafe {
        let stride = stride_of_hosts(pointer, count, what)?;
        (1..count as usize).try_for_each(|index| check_stride(pointer, index, stride, what))
    }
}
