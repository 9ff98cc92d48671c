//! Memory from the host's allocator, through an adapter for the crate `gpu-allocator`.

use crate::allocator::Adapter;
use crate::stage::*;
use ashsplat::vk::{HostAllocator, HostMemory, MemoryRequest};
use std::sync::Arc;

/// An allocator without any memory.
struct Exhausted;

// SAFETY: it never gives out any memory.
unsafe impl HostAllocator for Exhausted {
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String> {
        Err(format!("the budget has no {} bytes left", request.requirements.size))
    }

    fn free(&self, _: HostMemory) {}
}

fn context(host: &Host, allocator: Arc<dyn HostAllocator>) -> Context {
    let foreign = ForeignDevice { allocator: Some(allocator), ..host.foreign() };
    // SAFETY: as in `guest`.
    unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.expect("a context")
}

#[test]
fn all_memory_comes_from_the_hosts_allocator() {
    with_host(&options(), |host| {
        let adapter = Arc::new(Adapter::new(host).expect("an allocator"));
        let context = context(host, adapter.clone());
        let (gaussians, camera) = (cloud(400, 2), camera(0.3, 96, 64));
        let scene = uploaded(&context, &gaussians);
        let mut renderer = reserved(&context, &Reservation { slots: 2, ..Reservation::new(400, 1, 96, 64) });
        let blocks = adapter.pieces();
        assert!(blocks >= 5, "{blocks} pieces for a scene and two slots");
        let placed = [Placed::from(&scene)];
        for _ in 0..3 {
            let frame = frame_of(&placed, &camera);
            assert_drawn(host, &mut renderer, &frame, &gaussians);
            assert_eq!(adapter.pieces(), blocks);
        }
        assert!(report_of(&mut renderer, 0).visible > 100);
        drop((renderer, scene, context));
        assert_eq!(adapter.pieces(), 0, "everything was given back");
    });
}

#[test]
fn a_hosts_allocator_may_refuse() {
    with_host(&options(), |host| {
        let context = context(host, Arc::new(Exhausted));
        let error = DeviceScene::upload(&context, &cloud(10, 1), 0).err().expect("refused").to_string();
        assert!(error.contains("the budget has no") && error.contains("scene"), "{error}");
    });
}
