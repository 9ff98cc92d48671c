//! State of instances and devices, and helpers for the arguments of the layer's functions.

use super::machine::Machine;
use super::submissions::Submissions;
use ash::vk::{self, Handle};
use std::collections::{BTreeMap, HashMap};
use std::ffi::c_void;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

pub type Callbacks<'a> = *const vk::AllocationCallbacks<'a>;

/// Copies the loader's table into a dispatchable object of the driver.
pub type SetLoaderData = unsafe extern "system" fn(vk::Device, *mut c_void) -> vk::Result;

/// States keyed by the loader's table, with which all dispatchable objects of an instance or a device begin.
pub struct Table<T>(RwLock<BTreeMap<usize, Arc<T>>>);

pub static INSTANCES: Table<InstanceState> = Table(RwLock::new(BTreeMap::new()));
pub static DEVICES: Table<DeviceState> = Table(RwLock::new(BTreeMap::new()));

fn key<H: Handle>(handle: H) -> usize {
    // SAFETY: a dispatchable handle is the address of an object that begins with the loader's table.
    unsafe { *(handle.as_raw() as usize as *const usize) }
}

impl<T> Table<T> {
    fn add(&self, handle: impl Handle, state: T) {
        let mut states = self.0.write().unwrap_or_else(PoisonError::into_inner);
        states.insert(key(handle), Arc::new(state));
    }

    pub fn remove(&self, handle: impl Handle) -> Option<Arc<T>> {
        self.0.write().unwrap_or_else(PoisonError::into_inner).remove(&key(handle))
    }

    fn find(&self, handle: impl Handle) -> Arc<T> {
        let states = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let found = states.get(&key(handle));
        let Some(found) = found else { panic!("an object that was not made through this layer") };
        found.clone()
    }
}

/// An instance with the next layer's functions.
pub struct InstanceState {
    pub instance: vk::Instance,
    pub machine: &'static Machine,
    pub next: vk::PFN_vkGetInstanceProcAddr,
    pub functions: ash::InstanceFnV1_0,
    pub v11: ash::InstanceFnV1_1,
    pub surface: ash::khr::surface::InstanceFn,
}

impl InstanceState {
    pub fn add(instance: vk::Instance, next: vk::PFN_vkGetInstanceProcAddr) {
        // SAFETY: the next layer's function and its instance.
        let load = |name: &std::ffi::CStr| unsafe { pointer(next(instance, name.as_ptr())) };
        let state = Self {
            instance,
            machine: Machine::requested(),
            next,
            functions: ash::InstanceFnV1_0::load(load),
            v11: ash::InstanceFnV1_1::load(load),
            surface: ash::khr::surface::InstanceFn::load(load),
        };
        INSTANCES.add(instance, state);
    }

    /// State of an instance or a physical device.
    pub fn of<H: Handle>(handle: H) -> Arc<Self> {
        INSTANCES.find(handle)
    }
}

fn pointer(function: vk::PFN_vkVoidFunction) -> *const c_void {
    function.map_or(std::ptr::null(), |function| function as *const c_void)
}

/// A device with the next layer's functions.
pub struct DeviceState {
    pub device: vk::Device,
    pub physical: vk::PhysicalDevice,
    pub machine: &'static Machine,
    pub next: vk::PFN_vkGetDeviceProcAddr,
    pub v10: ash::DeviceFnV1_0,
    pub v11: ash::DeviceFnV1_1,
    pub v12: ash::DeviceFnV1_2,
    pub v13: ash::DeviceFnV1_3,
    pub debug: ash::ext::debug_utils::DeviceFn,
    pub swapchain: ash::khr::swapchain::DeviceFn,
    /// Allocations: type, heap and bytes of each.
    memory: Mutex<HashMap<u64, (u32, u32, u64)>>,
    submissions: Mutex<Submissions>,
}

impl DeviceState {
    pub fn add(
        device: vk::Device,
        physical: vk::PhysicalDevice,
        instance: &InstanceState,
        next: vk::PFN_vkGetDeviceProcAddr,
        set_loader_data: Option<SetLoaderData>,
    ) {
        // SAFETY: the next layer's function and its device.
        let load = |name: &std::ffi::CStr| unsafe { pointer(next(device, name.as_ptr())) };
        let v10 = ash::DeviceFnV1_0::load(load);
        let mut queue = vk::Queue::null();
        // SAFETY: the device was made with one queue of this family. The layer sets the loader's table, as the loader does for
        // a program's queues.
        unsafe {
            (v10.get_device_queue)(device, 0, 0, &raw mut queue);
            if let Some(set) = set_loader_data {
                let _ = set(device, queue.as_raw() as usize as *mut c_void);
            }
        }
        let state = Self {
            device,
            physical,
            machine: instance.machine,
            next,
            v10,
            v11: ash::DeviceFnV1_1::load(load),
            v12: ash::DeviceFnV1_2::load(load),
            v13: ash::DeviceFnV1_3::load(load),
            debug: ash::ext::debug_utils::DeviceFn::load(load),
            swapchain: ash::khr::swapchain::DeviceFn::load(load),
            memory: Mutex::default(),
            submissions: Mutex::new(Submissions { queue, ..Submissions::default() }),
        };
        DEVICES.add(device, state);
    }

    /// State of a device, a command buffer or a queue.
    pub fn of<H: Handle>(handle: H) -> Arc<Self> {
        DEVICES.find(handle)
    }

    pub fn submissions(&self) -> MutexGuard<'_, Submissions> {
        self.submissions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn memory(&self) -> MutexGuard<'_, HashMap<u64, (u32, u32, u64)>> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Bytes in use in a heap, over all devices of a physical device.
pub fn heap_usage(physical: vk::PhysicalDevice, heap: u32) -> u64 {
    let devices = DEVICES.0.read().unwrap_or_else(PoisonError::into_inner);
    let devices = devices.values().filter(|device| device.physical == physical);
    let used = |device: &Arc<DeviceState>| -> u64 {
        device.memory().values().filter(|(_, of, _)| *of == heap).map(|(_, _, bytes)| bytes).sum()
    };
    devices.map(used).sum()
}

/// The caller's struct of this type in a chain, if any; null without one.
pub unsafe fn in_chain<T: vk::TaggedStructure>(chain: *const c_void) -> *mut T {
    let mut next = chain.cast_mut().cast::<vk::BaseOutStructure<'_>>();
    // SAFETY: every struct of a chain begins with its kind and the next pointer.
    while let Some(found) = unsafe { next.as_ref() } {
        if found.s_type == T::STRUCTURE_TYPE {
            break;
        }
        next = found.p_next;
    }
    next.cast()
}

pub unsafe fn slice<'a, T>(pointer: *const T, count: u32) -> &'a [T] {
    // SAFETY: the caller's array has `count` elements; if there are none, the pointer may be null.
    if count == 0 { &[] } else { unsafe { std::slice::from_raw_parts(pointer, count as usize) } }
}

/// Defines functions that do something and pass their arguments on. A row has the function's name and arguments, the driver's function,
/// and what is done with the device's state.
macro_rules! passed_on {
    ($($name:ident($object:ident: $Object:ty $(, $argument:ident: $kind:ty)*) $(-> $result:ty)?, $version:ident.$next:ident, |$state:ident| $before:expr;)*) => {$(
        pub unsafe extern "system" fn $name($object: $Object $(, $argument: $kind)*) $(-> $result)? {
            let $state = DeviceState::of($object);
            // SAFETY: the caller's arguments.
            unsafe {
                $before;
                ($state.$version.$next)($object $(, $argument)*)
            }
        }
    )*};
}
pub(super) use passed_on;
