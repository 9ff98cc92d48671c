//! A host's device, images and command buffers in C.

use super::allocator::Adapter;
use super::queue_lock::Lock;
use super::structs::{check_room, check_room_of_all, read, read_if, write};
use super::{
    AshsplatCamera, AshsplatContext, AshsplatDepthMapping, AshsplatForeignDevice, AshsplatForeignImage,
    AshsplatHostImage, AshsplatRecordedFrame, AshsplatRelease, AshsplatRenderer, AshsplatStatus, borrowed,
    borrowed_mut, give, guarded, recorded_frames, settings, slice, take,
};
use ashsplat::ash::{self, vk, vk::Handle};
use ashsplat::scene::{ClipY, HostView};
use ashsplat::vk::{
    Context, ContextOptions, Features, ForeignDevice, ForeignImage, HostAllocator, Image, ImageUse, QueueLock,
};
use ashsplat::{Error, HostImage, Result};
use glam::Mat4;
use std::ffi::{CStr, c_char, c_void};
use std::sync::Arc;

/// A view of a host's image.
pub struct AshsplatImage(Image);

/// The features and extensions that a host has to enable, as readable text.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_requirements() -> *const c_char {
    static TEXT: std::sync::OnceLock<std::ffi::CString> = std::sync::OnceLock::new();
    let text =
        TEXT.get_or_init(|| std::ffi::CString::new(Context::requirements().to_string()).unwrap_or_default());
    text.as_ptr()
}

/// Turns on the required features in the structs with which a host will create its device, and does not
/// change the others: VkPhysicalDeviceVulkan12Features and VkPhysicalDeviceVulkan13Features, with their sType set. What the host
/// needs besides it turns on in them itself.
///
/// # Safety
/// Both pointers are valid for such structs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_merge_features(
    vulkan12: *mut c_void,
    vulkan13: *mut c_void,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let v12: &mut vk::PhysicalDeviceVulkan12Features<'_> = borrowed_mut(vulkan12.cast(), "vulkan12")?;
        let v13: &mut vk::PhysicalDeviceVulkan13Features<'_> = borrowed_mut(vulkan13.cast(), "vulkan13")?;
        check_type(v12.s_type, vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, "vulkan12")?;
        check_type(v13.s_type, vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES, "vulkan13")?;
        Context::requirements().features.merge_into(v12, v13);
        Ok(())
    })
}

/// A context on a host's device. It never destroys objects of the host. Only the given queue is waited for,
/// and only by functions that submit.
///
/// # Safety
/// - the instance and the device are alive, were created for Vulkan 1.3 or later, and outlive the context and
///   all that is made from it;
/// - the device was created from the physical device, with the queue family, the features and the extensions;
/// - a queue, if given, is one of the device and of that family, and has no other user during a call that
///   submits, or only under `lock_queue`;
/// - `lock_queue` and `unlock_queue` may be called from any thread, with `queue_user`, until everything made from the
///   context is freed: scenes, images and renderers with their slots too;
/// - the functions of an allocator may be called from any thread until everything made from the context is
///   freed, and return memory as requested, without another user;
/// - `context` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_context_from_foreign(
    host: *const AshsplatForeignDevice,
    context: *mut *mut AshsplatContext,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let host = read(host, "host")?;
        give(context, "context", || from_host(&host).map(AshsplatContext))
    })
}

fn null_name(place: usize) -> Error {
    Error::argument(format!("extensions[{place}]"), "the pointer is null")
}

/// Checks the type of a Vulkan struct.
fn check_type(found: vk::StructureType, wanted: vk::StructureType, field: &str) -> Result<()> {
    let problem = || format!("sType is {}, it must be {} ({wanted:?})", found.as_raw(), wanted.as_raw());
    if found == wanted { Ok(()) } else { Err(Error::argument(field, problem())) }
}

/// # Safety
/// Same as for [`ashsplat_context_from_foreign`].
unsafe fn from_host(host: &AshsplatForeignDevice) -> Result<Context> {
    let null = |what: &str| Error::argument(what, "the handle is null");
    let handle = |pointer: *mut c_void| pointer as u64;
    if host.get_instance_proc_addr.is_null() {
        return Err(null("get_instance_proc_addr"));
    }
    let (instance, device) =
        (vk::Instance::from_raw(handle(host.instance)), vk::Device::from_raw(handle(host.device)));
    if instance == vk::Instance::null() {
        return Err(null("instance"));
    }
    if device == vk::Device::null() {
        return Err(null("device"));
    }
    // SAFETY: the function and both handles are the host's, as promised; the structs are of their types.
    unsafe {
        let load: vk::PFN_vkGetInstanceProcAddr = std::mem::transmute(host.get_instance_proc_addr);
        let entry = ash::StaticFn { get_instance_proc_addr: load };
        let instance = ash::Instance::load(&entry, instance);
        let device = ash::Device::load(instance.fp_v1_0(), device);
        let v12: &vk::PhysicalDeviceVulkan12Features<'_> =
            borrowed(host.vulkan12_features.cast(), "vulkan12_features")?;
        let v13: &vk::PhysicalDeviceVulkan13Features<'_> =
            borrowed(host.vulkan13_features.cast(), "vulkan13_features")?;
        check_type(v12.s_type, vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, "vulkan12_features")?;
        check_type(v13.s_type, vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES, "vulkan13_features")?;
        let features = Features::of(v12, v13);
        let features = Features {
            shader_maximal_reconvergence: host.shader_maximal_reconvergence != 0,
            shader_subgroup_uniform_control_flow: host.shader_subgroup_uniform_control_flow != 0,
            ..features
        };
        let names = slice(host.extensions, host.extension_count as usize, "extensions")?;
        if let Some(place) = names.iter().position(|name| name.is_null()) {
            return Err(null_name(place));
        }
        let extensions: Vec<&CStr> = names.iter().map(|&name| CStr::from_ptr(name)).collect();
        let allocator = read_if(host.allocator, "allocator")?;
        let allocator = allocator.map(|allocator| Adapter::new(&allocator)).transpose()?;
        let allocator = allocator.map(|adapter| Arc::new(adapter) as Arc<dyn HostAllocator>);
        let foreign = ForeignDevice {
            instance: &instance,
            physical_device: vk::PhysicalDevice::from_raw(handle(host.physical_device)),
            device: &device,
            queue_family: host.queue_family,
            queue: (!host.queue.is_null()).then(|| vk::Queue::from_raw(handle(host.queue))),
            queue_lock: Lock::of(host)?.map(|lock| Arc::new(lock) as Arc<dyn QueueLock>),
            features,
            extensions: &extensions,
            debug_utils: host.debug_utils,
            allocator,
            pipeline_cache: vk::PipelineCache::from_raw(host.pipeline_cache),
        };
        Context::from_foreign(&foreign, &ContextOptions::default())
    }
}

/// A view of a host's image for kernels: `purpose` is an AshsplatImageUse. Messages and debuggers call it after that: 'target',
/// 'occluder', 'depth', 'pick' or 'motion'.
///
/// # Safety
/// The image is of the context's device, is what `host` says, is bound to memory, and outlives the view and
/// the execution of all recordings that use it; `image` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_image_adopt(
    context: *const AshsplatContext,
    host: *const AshsplatForeignImage,
    purpose: u32,
    image: *mut *mut AshsplatImage,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (context, host) = (borrowed(context, "context")?, read(host, "host")?);
        let purpose = settings::one_of("purpose", purpose, &IMAGE_USES)?;
        let foreign = ForeignImage {
            image: vk::Image::from_raw(host.image),
            format: vk::Format::from_raw(host.format),
            usage: vk::ImageUsageFlags::from_raw(host.usage),
            size: [host.width, host.height],
            mip_level: host.mip_level,
            layer: host.layer,
            flags: vk::ImageCreateFlags::from_raw(host.flags),
            samples: vk::SampleCountFlags::from_raw(host.samples),
        };
        let name = image_name(purpose);
        give(image, "image", || Image::adopt(&context.0, name, &foreign, purpose).map(AshsplatImage))
    })
}

/// Purposes in the order of their numbers in C.
const IMAGE_USES: [ImageUse; 5] =
    [ImageUse::Target, ImageUse::Occluder, ImageUse::Depth, ImageUse::Pick, ImageUse::Motion];

/// Name of an image in messages and debuggers: the frame's field that it is for.
fn image_name(purpose: ImageUse) -> &'static str {
    match purpose {
        ImageUse::Target => "target",
        ImageUse::Occluder => "occluder",
        ImageUse::Depth => "depth",
        ImageUse::Pick => "pick",
        ImageUse::Motion => "motion",
    }
}

/// Says that queues of another family own the image between recordings. A recording acquires it from them and releases it to them; the
/// host records the other halves in a queue of that family, ordered by semaphores in all stages. Before the recording: a barrier from the
/// layout of AshsplatHostImage.from to `layout`, from that family to the context's. Behind it: one from `layout` to `layout`, back. From
/// VK_IMAGE_LAYOUT_UNDEFINED the contents are discarded, and there is no barrier before. With the context's own family the image is as
/// without this call: there are no other halves, the host does not change the layout before, and a barrier behind is as AshsplatRelease
/// says.
///
/// # Safety
/// `image` is alive, `layout` is valid for a write, or NULL: it receives the VkImageLayout.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_image_of_family(
    image: *mut AshsplatImage,
    queue_family: u32,
    layout: *mut i32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let image = borrowed_mut(image, "image")?;
        image.0 = image.0.clone().of_family(queue_family)?;
        if let Some(to) = layout.as_mut() {
            *to = image.0.layout().as_raw();
        }
        Ok(())
    })
}

/// Frees a view. Slots keep it as long as their recordings use it, and the host's image must live until they
/// have released it: ashsplat_slot_release.
///
/// # Safety
/// `image` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_image_free(image: *mut AshsplatImage) {
    // SAFETY: as promised.
    unsafe { take(image) }
}

/// Converts a host's matrices to a camera and a depth mapping. Both matrices are column-major, clip =
/// projection * view * world, depth from 0 to 1, standard or reversed. `clip_y_up`: clip space's +y is at the
/// top of the picture (Direct3D's way, or a viewport of negative height). View space may be right- or left-handed, its z forward or
/// backward. The world is right-handed, as the scenes are: matrices that together mirror the picture are refused. A host with a
/// left-handed world gives view * M, with M what takes the scene's axes to its own, diag(1, 1, -1, 1) say.
///
/// # Safety
/// Both matrices have 16 floats; `camera` and `mapping` are valid for a write, or `mapping` is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_camera_from_matrices(
    view_from_world: *const f32,
    clip_from_view: *const f32,
    clip_y_up: bool,
    width: u32,
    height: u32,
    camera: *mut AshsplatCamera,
    mapping: *mut AshsplatDepthMapping,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let host = HostView {
            view_from_world: Mat4::from_cols_slice(slice(view_from_world, 16, "view_from_world")?),
            clip_from_view: Mat4::from_cols_slice(slice(clip_from_view, 16, "clip_from_view")?),
            clip_y: if clip_y_up { ClipY::Up } else { ClipY::Down },
            width,
            height,
        };
        let (found, depth) = host.camera().map_err(|error| match error {
            Error::Argument { what, problem } => {
                Error::argument(what.replace("clip_y", "clip_y_up"), problem.replace("clip_y", "clip_y_up"))
            }
            other => other,
        })?;
        write(camera, "camera", found.into())?;
        if let Some(mapping) = mapping.as_mut() {
            *mapping = depth.into();
        }
        Ok(())
    })
}

/// Records a frame into a VkCommandBuffer. It never submits, waits, allocates, maps or reads back. Errors of
/// the frame are reported before anything is recorded. The slot is in flight until the device has executed
/// the frame.
///
/// # Safety
/// - `commands` is of the context's device and queue family, in the recording state, outside of a render
///   pass; it is submitted at most once before it is recorded again;
/// - before the slot is recorded again or released, and before the renderer reserves again or is freed, the
///   execution of the whole command buffer has finished: its fence was waited for; or the slot is discarded.
///   ashsplat_slot_finished is not enough. Scenes and views of images may be freed earlier: the slot keeps
///   the ones that it uses;
/// - the host assumes afterwards that the command buffer's compute pipeline, descriptor sets and push
///   constants have changed;
/// - the host synchronises accesses of other queues by semaphores; images of another queue family were
///   released there and acquired here;
/// - `frame` is valid with all that it points to, `release` for a write, or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_record(
    renderer: *mut AshsplatRenderer,
    commands: *mut c_void,
    slot: u32,
    frame: *const AshsplatRecordedFrame,
    release: *mut AshsplatRelease,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (renderer, f) = (borrowed_mut(renderer, "renderer")?, read(frame, "frame")?);
        check_room(release, "release")?;
        recorded_frames::record(renderer, (commands, slot), (&raw const f, 1), release)
    })
}

/// Records several frames in one slot, one after the other: views of the same moment, as for the eyes of a headset or a split screen.
/// Each goes into images: a layer of an array for each, or rectangles of one image. AshsplatReservation.views says how many there may be.
/// With `shared_sort`, eyes side by side are sorted once if their frames have the same `scenes` pointer. An image may be used by several
/// views: only the first one's `from` counts. The updates are those of the first frame. Otherwise as ashsplat_record for each.
///
/// # Safety
/// As ashsplat_record, for each; `frames` has `frame_count` elements, `releases` as many for a write, or is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_record_views(
    renderer: *mut AshsplatRenderer,
    commands: *mut c_void,
    slot: u32,
    frames: *const AshsplatRecordedFrame,
    frame_count: u32,
    releases: *mut AshsplatRelease,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let renderer = borrowed_mut(renderer, "renderer")?;
        check_room_of_all(releases, frame_count, "releases")?;
        recorded_frames::record(renderer, (commands, slot), (frames, frame_count), releases)
    })
}

/// Converts a host's image.
///
/// # Safety
/// Its view is null or alive.
pub(super) unsafe fn used<'a>(host: &AshsplatHostImage, what: &str) -> Result<HostImage<'a>> {
    // SAFETY: as promised.
    let image = unsafe { borrowed(host.image, what)? };
    Ok(HostImage { image: &image.0, from: host.from.into(), offset: host.offset })
}

/// The device of a context, for a host that lets this library open one: each pointer may be NULL.
///
/// # Safety
/// `context` is alive; the pointers are NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_context_handles(
    context: *const AshsplatContext,
    instance: *mut *mut c_void,
    physical_device: *mut *mut c_void,
    device: *mut *mut c_void,
    queue_family: *mut u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (i, p, d, family) = borrowed(context, "context")?.0.handles();
        let raw = [i.handle().as_raw(), p.as_raw(), d.handle().as_raw()];
        for (to, handle) in [instance, physical_device, device].into_iter().zip(raw) {
            if let Some(to) = to.as_mut() {
                *to = handle as *mut c_void;
            }
        }
        if let Some(to) = queue_family.as_mut() {
            *to = family;
        }
        Ok(())
    })
}
