//! A host's device, images and command buffers in C.

use super::*;
use ashsplat::ash::{self, vk, vk::Handle, vk::TaggedStructure};
use ashsplat::scene::{ClipY, HostView};
use ashsplat::vk::{
    Features, ForeignDevice, ForeignImage, HostAllocator, HostMemory, Image, ImageUse, MemoryKind,
    MemoryRequest, QueueLock,
};
use glam::Mat4;
use std::ffi::{CStr, c_void};
use std::ptr::NonNull;
use std::sync::Arc;

type Features12<'a> = vk::PhysicalDeviceVulkan12Features<'a>;
type Features13<'a> = vk::PhysicalDeviceVulkan13Features<'a>;

/// A view of a host's image.
pub struct AshsplatImage(pub(super) Image);

/// The features and extensions that a host has to enable, as readable text.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_requirements() -> *const c_char {
    static TEXT: std::sync::OnceLock<CString> = std::sync::OnceLock::new();
    TEXT.get_or_init(|| c_text(&Context::requirements().to_string())).as_ptr()
}

/// Sets the required features in the structs with which a host will create its device: VkPhysicalDeviceVulkan12Features and
/// VkPhysicalDeviceVulkan13Features, with their sType set. Other features stay as the host has set them.
///
/// # Safety
/// Both pointers are valid for such structs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_merge_features(
    vulkan12: *mut c_void,
    vulkan13: *mut c_void,
) -> AshsplatStatus {
    guarded!({
        let v12: &mut Features12<'_> = borrowed_mut(vulkan12.cast(), "vulkan12")?;
        let v13: &mut Features13<'_> = borrowed_mut(vulkan13.cast(), "vulkan13")?;
        check_type(v12.s_type, Features12::STRUCTURE_TYPE, "vulkan12")?;
        check_type(v13.s_type, Features13::STRUCTURE_TYPE, "vulkan13")?;
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
    guarded!({
        let host = read(host, "host")?;
        give(context, "context", || from_host(&host).map(AshsplatContext))
    })
}

/// Checks the type of a Vulkan struct.
fn check_type(found: vk::StructureType, wanted: vk::StructureType, field: &str) -> Result<()> {
    let problem = || format!("sType is {}, it must be {} ({wanted:?})", found.as_raw(), wanted.as_raw());
    if found == wanted { Ok(()) } else { Err(Error::argument(field, problem())) }
}

/// # Safety
/// Same as for [`ashsplat_context_from_foreign`].
unsafe fn from_host(host: &AshsplatForeignDevice) -> Result<Context> {
    let handle = |pointer: *mut c_void| pointer as u64;
    let required = [
        (host.get_instance_proc_addr, "get_instance_proc_addr"),
        (host.instance.cast_const(), "instance"),
        (host.device.cast_const(), "device"),
    ];
    if let Some((_, name)) = required.into_iter().find(|(pointer, _)| pointer.is_null()) {
        return Err(Error::argument(name, "the handle is null"));
    }
    // SAFETY: the function and both handles are the host's, as promised; the structs are of their types.
    unsafe {
        let load: vk::PFN_vkGetInstanceProcAddr = std::mem::transmute(host.get_instance_proc_addr);
        let entry = ash::StaticFn { get_instance_proc_addr: load };
        let instance = ash::Instance::load(&entry, vk::Instance::from_raw(handle(host.instance)));
        let device = ash::Device::load(instance.fp_v1_0(), vk::Device::from_raw(handle(host.device)));
        let v12: &Features12<'_> = borrowed(host.vulkan12_features.cast(), "vulkan12_features")?;
        let v13: &Features13<'_> = borrowed(host.vulkan13_features.cast(), "vulkan13_features")?;
        check_type(v12.s_type, Features12::STRUCTURE_TYPE, "vulkan12_features")?;
        check_type(v13.s_type, Features13::STRUCTURE_TYPE, "vulkan13_features")?;
        let features = Features {
            shader_maximal_reconvergence: host.shader_maximal_reconvergence != 0,
            shader_subgroup_uniform_control_flow: host.shader_subgroup_uniform_control_flow != 0,
            ..Features::of(v12, v13)
        };
        let names = slice(host.extensions, host.extension_count as usize, "extensions")?;
        if let Some(place) = names.iter().position(|name| name.is_null()) {
            return Err(Error::argument(format!("extensions[{place}]"), "the pointer is null"));
        }
        let extensions: Vec<&CStr> = names.iter().map(|&name| CStr::from_ptr(name)).collect();
        let allocator = read_if(host.allocator, "allocator")?.map(|it| Adapter::of(&it)).transpose()?;
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
            allocator: allocator.map(|adapter| Arc::new(adapter) as Arc<dyn HostAllocator>),
            pipeline_cache: vk::PipelineCache::from_raw(host.pipeline_cache),
        };
        Context::from_foreign(&foreign, &ContextOptions::default())
    }
}

/// A view of a host's image for kernels: `purpose` is an AshsplatImageUse. Messages and debuggers name it after the field of
/// AshsplatRecordedFrame: 'target', 'occluder' and so on.
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
    guarded!({
        let (context, host) = (borrowed(context, "context")?, read(host, "host")?);
        let purpose = one_of("purpose", purpose, &ImageUse::ALL)?;
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
        give(image, "image", || {
            Image::adopt(&context.0, purpose.field(), &foreign, purpose).map(AshsplatImage)
        })
    })
}

/// Declares that queues of another family own the image between recordings. A recording acquires it and releases it again.
/// The host records the matching barriers in a queue of that family, ordered by semaphores in all stages. Its barrier before
/// the recording goes from the layout of AshsplatHostImage.from to `layout`, and from that family to the context's. The one
/// after it goes back, from `layout` to `layout`. VK_IMAGE_LAYOUT_UNDEFINED discards the contents, without a barrier before.
/// With the context's own family, the host records neither, and a barrier after the recording is as AshsplatRelease says.
///
/// # Safety
/// `image` is alive, `layout` is valid for a write, or NULL: it receives the VkImageLayout.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_image_of_family(
    image: *mut AshsplatImage,
    queue_family: u32,
    layout: *mut i32,
) -> AshsplatStatus {
    guarded!({
        let image = borrowed_mut(image, "image")?;
        image.0 = image.0.clone().of_family(queue_family)?;
        put_if(layout, image.0.layout().as_raw());
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
/// backward. The world is right-handed, as the scenes are: matrices that together mirror the picture are refused. A host
/// with a left-handed world gives view * M, where M maps the scene's axes to its own, for example diag(1, 1, -1, 1).
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
    guarded!({
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
        put_if(mapping, depth.into());
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
    guarded!({
        let (renderer, f) = (borrowed_mut(renderer, "renderer")?, read(frame, "frame")?);
        check_room(release, "release")?;
        frames::record(renderer, (commands, slot), (&raw const f, 1), release)
    })
}

/// Records several frames in one slot, one after the other: views of the same moment, as for the eyes of a headset or a split screen.
/// Each goes into images: a layer of an array for each, or rectangles of one image. AshsplatReservation.views says how many there may be.
/// With `shared_sort`, eyes side by side are sorted once if their frames have the same `scenes` pointer. An image may be used by several
/// views: only the first one's `from` counts. The updates are those of the first frame. Otherwise as ashsplat_record for each.
///
/// # Safety
/// Same as for ashsplat_record, for each; `frames` has `frame_count` elements, `releases` as many for a write, or is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_record_views(
    renderer: *mut AshsplatRenderer,
    commands: *mut c_void,
    slot: u32,
    frames: *const AshsplatRecordedFrame,
    frame_count: u32,
    releases: *mut AshsplatRelease,
) -> AshsplatStatus {
    guarded!({
        let renderer = borrowed_mut(renderer, "renderer")?;
        check_room_of_all(releases, frame_count, "releases")?;
        frames::record(renderer, (commands, slot), (frames, frame_count), releases)
    })
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
    guarded!({
        let (i, p, d, family) = borrowed(context, "context")?.0.handles();
        let raw = [i.handle().as_raw(), p.as_raw(), d.handle().as_raw()];
        for (to, handle) in [instance, physical_device, device].into_iter().zip(raw) {
            put_if(to, handle as *mut c_void);
        }
        put_if(queue_family, family);
        Ok(())
    })
}

/// A request for a buffer's memory.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMemoryRequest {
    /// The buffer's name, for debugging; valid during the call.
    pub name: *const c_char,
    /// Bytes.
    pub bytes: u64,
    /// The piece begins at a multiple of this in its memory.
    pub alignment: u64,
    /// Bit i: memory type i is allowed.
    pub memory_types: u32,
    /// True if it must be mapped; otherwise it should be device-local.
    pub host_visible: bool,
}

/// A piece of device memory.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMemory {
    /// VkDeviceMemory.
    pub memory: u64,
    /// Byte offset of the piece in the memory object.
    pub offset: u64,
    /// Host address of the piece if it is mapped, otherwise NULL.
    pub mapped: *mut c_void,
    /// An identifier for the allocator's own use.
    pub id: u64,
}

/// A host's allocator, which provides the memory of all buffers. Functions that allocate or free call it, also from other
/// threads. Recording never allocates, but frees memory that only the slot's last frame used, unless ashsplat_slot_release
/// has done so.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatAllocator {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The first argument of both functions.
    pub user: *mut c_void,
    /// Allocates a piece; false when it cannot. Mapped memory has to be host-coherent.
    pub allocate: Option<
        unsafe extern "C" fn(
            user: *mut c_void,
            request: *const AshsplatMemoryRequest,
            memory: *mut AshsplatMemory,
        ) -> bool,
    >,
    /// Frees a piece that is not in use any more.
    pub free: Option<unsafe extern "C" fn(user: *mut c_void, memory: AshsplatMemory)>,
}

/// A host's allocator as the engine uses it.
struct Adapter {
    user: *mut c_void,
    allocate: unsafe extern "C" fn(*mut c_void, *const AshsplatMemoryRequest, *mut AshsplatMemory) -> bool,
    free: unsafe extern "C" fn(*mut c_void, AshsplatMemory),
}

// SAFETY: the allocator's owner promises that it may be called from any thread.
unsafe impl Send for Adapter {}
// SAFETY: as above.
unsafe impl Sync for Adapter {}

impl Adapter {
    /// # Safety
    /// The functions keep the contract of [`HostAllocator`] and of their own documentation, from any thread, as long as
    /// the adapter lives.
    unsafe fn of(allocator: &AshsplatAllocator) -> Result<Self> {
        let (Some(allocate), Some(free)) = (allocator.allocate, allocator.free) else {
            return Err(Error::argument("allocator", "a function is null"));
        };
        Ok(Self { user: allocator.user, allocate, free })
    }
}

// SAFETY: promised by the adapter's creator.
unsafe impl HostAllocator for Adapter {
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String> {
        let name = CString::new(request.name).unwrap_or_default();
        let needs = request.requirements;
        let request = AshsplatMemoryRequest {
            name: name.as_ptr(),
            bytes: needs.size,
            alignment: needs.alignment,
            memory_types: needs.memory_type_bits,
            host_visible: request.kind == MemoryKind::HostVisible,
        };
        let mut piece = AshsplatMemory { memory: 0, offset: 0, mapped: std::ptr::null_mut(), id: 0 };
        // SAFETY: the host's function with valid arguments; both pointers live through the call.
        let done = unsafe { (self.allocate)(self.user, &request, &mut piece) };
        if !done || piece.memory == 0 {
            return Err(format!("it has no {} bytes", needs.size));
        }
        Ok(HostMemory {
            memory: vk::DeviceMemory::from_raw(piece.memory),
            offset: piece.offset,
            mapped: NonNull::new(piece.mapped.cast()),
            id: piece.id,
        })
    }

    fn free(&self, memory: HostMemory) {
        let piece = AshsplatMemory {
            memory: memory.memory.as_raw(),
            offset: memory.offset,
            mapped: memory.mapped.map_or(std::ptr::null_mut(), |address| address.as_ptr().cast()),
            id: memory.id,
        };
        // SAFETY: a piece of this allocator that is no longer used.
        unsafe { (self.free)(self.user, piece) }
    }
}

/// A host's lock for its queue.
struct Lock {
    user: *mut c_void,
    lock: unsafe extern "C" fn(user: *mut c_void),
    unlock: unsafe extern "C" fn(user: *mut c_void),
}

// SAFETY: the host promises that its functions may be called from any thread.
unsafe impl Send for Lock {}
// SAFETY: as above.
unsafe impl Sync for Lock {}

impl Lock {
    /// The host's lock, if it has one.
    fn of(host: &AshsplatForeignDevice) -> Result<Option<Self>> {
        match (host.lock_queue, host.unlock_queue) {
            (Some(lock), Some(unlock)) => Ok(Some(Self { user: host.queue_user, lock, unlock })),
            (None, None) => Ok(None),
            (Some(_), None) => Err(Error::argument("unlock_queue", "is NULL, and lock_queue is not")),
            (None, Some(_)) => Err(Error::argument("lock_queue", "is NULL, and unlock_queue is not")),
        }
    }
}

// SAFETY: the host promises exclusive use of the queue between the two calls.
unsafe impl QueueLock for Lock {
    fn lock(&self) {
        // SAFETY: as promised.
        unsafe { (self.lock)(self.user) }
    }

    fn unlock(&self) {
        // SAFETY: as promised.
        unsafe { (self.unlock)(self.user) }
    }
}
