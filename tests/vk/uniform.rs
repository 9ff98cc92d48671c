//! Uniform blocks: their layout on both sides, their buffers, and the barrier after their writes.

use super::{allocate, assert_hazard_is_reported, run};
use crate::common;
use ashsplat::frame::CAMERA_BLOCK_BYTES;
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::forward::cull;
use ashsplat::vk::{Access, BindingKind, Buffer, Context, ContextOptions, Kernel, KernelInterface, Recorder};

struct Culling {
    buffers: [Buffer; 4],
    kernel: Kernel<cull::Interface>,
}

impl Culling {
    fn new(context: &Context) -> Self {
        let requests =
            [("parameters", 4096), ("flags", 256), ("counts", 256), ("blocks", 2 * CAMERA_BLOCK_BYTES)];
        Self {
            buffers: allocate(context, requests),
            kernel: Kernel::new(context, &cull::Spec::for_device(context.limits())).expect("a kernel"),
        }
    }

    fn record(&self, r: &mut Recorder, camera_block: &Buffer) {
        let [parameters, visible_flags, block_counts, blocks] = &self.buffers;
        r.update(blocks, &vec![0; blocks.bytes() as usize]);
        r.barrier();
        let bind = cull::Bind { parameters, visible_flags, block_counts, cut_outs: parameters, camera_block };
        r.dispatch(&self.kernel, &bind, &cull::Push::default(), 1);
    }

    fn blocks(&self) -> &Buffer {
        &self.buffers[3]
    }
}

#[test]
fn uniform_blocks_are_mirrored_and_have_room_for_more() {
    let block = cull::Interface::BINDINGS.last().expect("buffers");
    assert_eq!((block.name, block.access), ("camera_block", Access::Read));
    let bytes = size_of::<CameraBlock>();
    assert_eq!(block.kind, BindingKind::Uniform { bytes: bytes as u32 });
    assert!(bytes + 16 <= CAMERA_BLOCK_BYTES as usize, "{bytes} of {CAMERA_BLOCK_BYTES} bytes are taken");
    let limits = common::context().limits();
    assert!(CAMERA_BLOCK_BYTES.is_multiple_of(limits.uniform_alignment));
    assert!(CAMERA_BLOCK_BYTES <= limits.max_uniform_range.into());
}

#[test]
fn uniform_blocks_are_bound_with_and_without_push_descriptors() {
    for push_descriptors in [true, false] {
        let options = ContextOptions { push_descriptors, ..common::options() };
        let context = Context::new(&options).expect("a context");
        let culling = Culling::new(&context);
        run(&context, |r| {
            culling.record(r, &culling.blocks().range(CAMERA_BLOCK_BYTES, CAMERA_BLOCK_BYTES));
        });
        common::assert_silent(&context);
    }
}

#[test]
fn uniform_blocks_are_read_behind_a_barrier() {
    let context = common::context();
    let culling = Culling::new(context);
    let mut recorder = context.begin("never submitted").expect("a recorder");
    recorder.collect_hazards();
    recorder.omit_barrier(0);
    culling.record(&mut recorder, culling.blocks());
    let hazards = recorder.hazards();
    assert!(hazards[0].contains("read after write") && hazards[0].contains("'camera_block'"), "{hazards:?}");
}

#[test]
fn uniform_blocks_behind_no_barrier_are_seen_by_the_validation_layer() {
    assert_hazard_is_reported(|context| {
        let culling = Culling::new(context);
        run(context, |r| {
            r.omit_barrier(0);
            culling.record(r, culling.blocks());
        });
    });
}

/// Culls with a part of the buffer's first block.
fn cull_with(range: fn(u64) -> (u64, u64)) {
    let context = common::context();
    let culling = Culling::new(context);
    let mut recorder = context.begin("never submitted").expect("a recorder");
    let (offset, bytes) = range(context.limits().uniform_alignment);
    culling.record(&mut recorder, &culling.blocks().range(offset, bytes));
}

#[test]
#[should_panic(expected = "'blocks' bound as 'camera_block' has 64 bytes, the limits are")]
fn uniform_blocks_larger_than_their_buffer_are_refused() {
    cull_with(|_| (0, 64));
}

/// No device allows an alignment of less than 4.
#[test]
#[should_panic(expected = "'blocks' bound as 'camera_block' begins at")]
fn uniform_blocks_at_a_misaligned_offset_are_refused() {
    cull_with(|alignment| (alignment / 2, CAMERA_BLOCK_BYTES));
}
