//! A host's device, images and command buffers in C.

use super::allocator::Adapter;
use super::structs::{check_room, read, read_all, read_if, within, write, write_if};
use super::{
    AshsplatCamera, AshsplatContext, AshsplatDepthMapping, AshsplatDepthTarget, AshsplatForeignDevice,
    AshsplatForeignImage, AshsplatHostImage, AshsplatOccluder, AshsplatPose, AshsplatRecordedFrame,
    AshsplatRelease, AshsplatRenderer, AshsplatStatus, auxiliary, borrowed, borrowed_mut, frames, give,
    guarded, scene_settings, scenes, settings, slice, take,
};
use ashsplat::ash::{self, vk, vk::Handle};
use ashsplat::scene::{ClipY, HostView};
use ashsplat::vk::{
    Context, ContextOptions, Features, ForeignDevice, ForeignImage, HostAllocator, Image, ImageUse,
};
use ashsplat::{
    DepthTarget, Error, HostImage, Occluder, Placed, RecordedFrame, RenderSettings, Result, Target,
};
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
/// change the others: VkPhysicalDeviceVulkan12Features and VkPhysicalDeviceVulkan13Features.
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
        let v12 = borrowed_mut(vulkan12.cast(), "vulkan12")?;
        let v13 = borrowed_mut(vulkan13.cast(), "vulkan13")?;
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
///   submits;
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

/// # Safety
/// As [`ashsplat_context_from_foreign`].
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
        let features = Features::of(
            borrowed(host.vulkan12_features.cast(), "vulkan12_features")?,
            borrowed(host.vulkan13_features.cast(), "vulkan13_features")?,
        );
        let names = slice(host.extensions, host.extension_count as usize, "extensions")?;
        let extensions: Vec<&CStr> =
            names.iter().filter(|name| !name.is_null()).map(|&name| CStr::from_ptr(name)).collect();
        let allocator = read_if(host.allocator, "allocator")?;
        let allocator = allocator.map(|allocator| Adapter::new(&allocator)).transpose()?;
        let allocator = allocator.map(|adapter| Arc::new(adapter) as Arc<dyn HostAllocator>);
        let foreign = ForeignDevice {
            instance: &instance,
            physical_device: vk::PhysicalDevice::from_raw(handle(host.physical_device)),
            device: &device,
            queue_family: host.queue_family,
            queue: (!host.queue.is_null()).then(|| vk::Queue::from_raw(handle(host.queue))),
            features,
            extensions: &extensions,
            debug_utils: host.debug_utils,
            allocator,
            pipeline_cache: vk::PipelineCache::from_raw(host.pipeline_cache),
        };
        Context::from_foreign(&foreign, &ContextOptions::default())
    }
}

/// A view of a host's image for kernels: `purpose` is an AshsplatImageUse.
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
        let uses = [("target", ImageUse::Storage), ("depth", ImageUse::Sampled)];
        let (name, purpose) = settings::one_of("purpose", purpose, &uses)?;
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
        give(image, "image", || Image::adopt(&context.0, name, &foreign, purpose).map(AshsplatImage))
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
/// top of the picture.
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
        let (found, depth) = host.camera()?;
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
        let placed = read_all(f.scenes, f.scene_count, "scenes")?;
        let pointees = scene_settings::pointees(&placed, renderer.0.context())?;
        let mut scenes = Vec::with_capacity(placed.len());
        for (place, (placed, own)) in placed.iter().zip(&pointees).enumerate() {
            let scene = borrowed(placed.scene, "scene");
            let scene = &scene.map_err(within(format_args!("scenes[{place}]")))?.scene;
            let previous_pose = read_if(placed.previous_pose, "previous_pose");
            let previous_pose = previous_pose.map_err(within(format_args!("scenes[{place}]")))?;
            scenes.push(Placed {
                settings: scene_settings::of(own),
                previous_pose: previous_pose.as_ref().map(AshsplatPose::pose),
                ..Placed::at(scene, placed.pose())
            });
        }
        let copied = scenes::copied(&read_all(f.updates, f.update_count, "updates")?)?;
        let updates = scenes::updates(&copied);
        let camera = read(f.camera, "camera")?.known()?;
        let settings = read_if(f.settings, "settings")?;
        let settings = settings.map_or(Ok(RenderSettings::default()), |settings| settings.checked())?;
        let mut recorded =
            RecordedFrame { updates: &updates, ..RecordedFrame::new(&scenes, &camera, &settings) };
        if let Some(target) = read_if(f.target, "target")? {
            recorded.target = Target::Image {
                to: used(&target.to, "target.to.image")?,
                behind: frames::behind(target.behind, target.background)?,
                encoding: frames::encoding(target.encoding, target.exposure)?,
            };
        }
        if let Some(AshsplatOccluder { depth, mapping, .. }) = read_if(f.occluder, "occluder")? {
            let depth = used(&depth, "occluder.depth.image")?;
            recorded.occluder = Some(Occluder { depth, mapping: mapping.into() });
        }
        if let Some(AshsplatDepthTarget { to, min_weight, empty, .. }) = read_if(f.depth, "depth")? {
            recorded.depth = Some(DepthTarget { to: used(&to, "depth.to.image")?, min_weight, empty });
        }
        let motion = auxiliary::Motion::read(f.motion)?;
        recorded.pick = auxiliary::pick(f.pick)?;
        recorded.motion = motion.as_ref().map(|motion| motion.target()).transpose()?;
        let commands = vk::CommandBuffer::from_raw(commands as u64);
        let commands = renderer.0.context().adopt_commands(commands)?;
        let left = renderer.0.record(commands, slot, &recorded).map_err(in_c)?;
        write_if(release, "release", (&left).into())
    })
}

/// A host's image as the library has it.
///
/// # Safety
/// Its view is null or alive.
pub(super) unsafe fn used<'a>(host: &AshsplatHostImage, what: &str) -> Result<HostImage<'a>> {
    // SAFETY: as promised.
    let image = unsafe { borrowed(host.image, what)? };
    Ok(HostImage { image: &image.0, from: host.from.into(), offset: host.offset })
}

/// An error of a frame with the names of ashsplat_record's parameters; the fields have the same in both languages.
fn in_c(error: Error) -> Error {
    let Error::Argument { what, problem } = error else { return error };
    let (field, rest) = what.split_at(what.find(" (").unwrap_or(what.len()));
    let name = match field {
        "command buffer" => "commands",
        "frame slot" => "slot",
        other => other,
    };
    Error::Argument { what: format!("{name}{rest}"), problem }
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
