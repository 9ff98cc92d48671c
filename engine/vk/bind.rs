//! Binds the resources of a dispatch, by push descriptors or by a preallocated set.

use super::binding::{BindingInfo, BindingKind};
use super::binding_numbers::BUFFERS;
use super::buffer::Buffer;
use super::image::Image;
use super::pipeline::{MAX_BINDINGS, Pipeline};
use super::recorder::Recorder;
use super::resources::Bound;
use super::texels::{TexelFormat, TexelRange};
use crate::Result;
use ash::vk;
use std::sync::Arc;

/// Most images of one kernel.
const MAX_IMAGES: usize = 2;

impl Recorder {
    /// Binds the pipeline, its buffers, images and push constants. Returns false if this call or an earlier
    /// one has failed. Nothing may be dispatched then, and the end of the recording reports the error
    /// ([`Recorder::check`]).
    pub(super) fn prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bound<'_>, push: &[u8]) -> bool {
        if self.failed.is_none() {
            self.failed = self.try_prepare(pipeline, bound, push).err();
        }
        self.failed.is_none()
    }

    fn try_prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bound<'_>, push: &[u8]) -> Result<()> {
        assert!(pipeline.is_of(&self.inner), "kernel {} is of another context", pipeline.name);
        let mut buffers = [vk::DescriptorBufferInfo::default(); MAX_BINDINGS];
        let mut views = [vk::BufferView::null(); MAX_BINDINGS];
        let descriptors = buffers.iter_mut().zip(&mut views).zip(pipeline.bindings);
        for (((descriptor, view), info), buffer) in descriptors.zip(bound.buffers) {
            self.check_binding(pipeline, info, buffer);
            if let BindingKind::Texels(format) = info.kind {
                *view = self.texel_view(pipeline, info.name, buffer, format)?;
            }
            self.keep(buffer);
            let bytes = match info.kind {
                BindingKind::Uniform { bytes } => bytes.into(),
                _ => bound_bytes(buffer),
            };
            let offset = buffer.offset();
            *descriptor =
                vk::DescriptorBufferInfo::default().buffer(buffer.raw()).offset(offset).range(bytes);
        }
        let mut images = [vk::DescriptorImageInfo::default(); MAX_IMAGES];
        for ((descriptor, info), image) in images.iter_mut().zip(pipeline.images).zip(bound.images) {
            let (kernel, name) = (pipeline.name, image.name());
            assert!(image.purpose().kind() == info.kind, "{kernel}: image '{name}' is no {:?}", info.kind);
            self.keep_image(image);
            *descriptor = image.descriptor();
        }
        let mut writes = [vk::WriteDescriptorSet::default(); MAX_BINDINGS + MAX_IMAGES];
        let (first, rest) = writes.split_at_mut(bound.buffers.len());
        let descriptors = pipeline.bindings.iter().zip(&buffers).zip(&views);
        for (write, ((info, descriptor), view)) in first.iter_mut().zip(descriptors) {
            let empty = vk::WriteDescriptorSet::default().dst_binding(info.binding);
            let empty = empty.descriptor_type(info.kind.descriptor_type());
            *write = match info.kind {
                BindingKind::Texels(_) => empty.texel_buffer_view(std::slice::from_ref(view)),
                _ => empty.buffer_info(std::slice::from_ref(descriptor)),
            };
        }
        for ((write, info), descriptor) in rest.iter_mut().zip(pipeline.images).zip(&images) {
            *write = vk::WriteDescriptorSet::default()
                .dst_binding(info.binding)
                .descriptor_type(info.kind.descriptor_type())
                .image_info(std::slice::from_ref(descriptor));
        }
        let mut count = bound.buffers.len() + bound.images.len();
        let storage = pipeline.bindings.iter().position(|info| info.kind == BindingKind::Storage);
        if let (Some(_), Some(any)) = (&self.inner.shared_layouts, storage) {
            // No descriptor of an earlier use may remain in the set: see the module `descriptors`.
            let missing = |binding: &u32| pipeline.bindings.iter().all(|info| info.binding != *binding);
            for binding in (0..BUFFERS).filter(missing) {
                writes[count] = vk::WriteDescriptorSet::default()
                    .dst_binding(binding)
                    .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                    .buffer_info(&buffers[any..=any]);
                count += 1;
            }
        }
        self.kept.pipeline(pipeline);
        self.bind(pipeline, &mut writes[..count], push)
    }

    /// Keeps a buffer's memory alive for the recording. The buffer must belong to the recording's device.
    pub(super) fn keep(&mut self, buffer: &Buffer) {
        let block = buffer.block();
        assert!(block.is_of(&self.inner), "buffer '{}' is of another context", buffer.name());
        self.kept.block(block);
    }

    /// Same as [`Self::keep`], but for an image.
    pub(super) fn keep_image(&mut self, image: &Image) {
        assert!(image.is_of(&self.inner), "image '{}' is of another context", image.name());
        self.kept.image(image);
    }

    /// Panics for a buffer that cannot be bound.
    fn check_binding(&self, pipeline: &Pipeline, info: &BindingInfo, buffer: &Buffer) {
        let limits = &self.inner.limits;
        let (kernel, role, name, bytes) = (pipeline.name, info.name, buffer.name(), buffer.bytes());
        let (least, most, alignment) = match info.kind {
            BindingKind::Uniform { bytes } => (u64::from(bytes), u64::MAX, limits.uniform_alignment),
            _ => (1, limits.max_storage_buffer_range, limits.storage_alignment),
        };
        assert!(
            (least..=most).contains(&bytes),
            "{kernel}: '{name}' bound as '{role}' has {bytes} bytes, the limits are {least} and {most}"
        );
        assert!(
            buffer.offset().is_multiple_of(alignment),
            "{kernel}: '{name}' bound as '{role}' begins at {}, no multiple of {alignment}",
            buffer.offset()
        );
    }

    /// Returns a texel view of a buffer. Panics for a buffer that cannot be bound as texels.
    fn texel_view(
        &self,
        pipeline: &Pipeline,
        role: &str,
        buffer: &Buffer,
        format: TexelFormat,
    ) -> Result<vk::BufferView> {
        let limits = &self.inner.limits;
        let (kernel, name, offset, bytes) = (pipeline.name, buffer.name(), buffer.offset(), buffer.bytes());
        let texels = bytes / format.bytes();
        assert!(
            texels <= limits.max_texels && texels > 0 && offset.is_multiple_of(limits.texel_alignment),
            "{kernel}: '{name}' bound as '{role}' has {texels} texels at {offset}; at most {} at a multiple of {}",
            limits.max_texels,
            limits.texel_alignment
        );
        let block = buffer.block();
        block.texels.of(&self.inner.device, buffer.raw(), TexelRange { offset, bytes, format })
    }

    fn bind(
        &mut self,
        pipeline: &Pipeline,
        writes: &mut [vk::WriteDescriptorSet<'_>],
        push: &[u8],
    ) -> Result<()> {
        let set = match self.commands.descriptors() {
            Some(sets) if !writes.is_empty() => Some(sets.next(&self.inner, pipeline.handles.set_kind)?),
            _ => None,
        };
        let (raw, device, point) = (self.raw(), &self.inner.device, vk::PipelineBindPoint::COMPUTE);
        // SAFETY: recording state; pipeline, layout and descriptors belong together, and the recorder keeps all of
        // them until the execution is over; a set is written once in a recording, before it is bound. `push` has the
        // size that the layout was made with.
        unsafe {
            if self.bound != pipeline.handles.raw {
                device.cmd_bind_pipeline(raw, point, pipeline.handles.raw);
                self.bound = pipeline.handles.raw;
            }
            match (&self.inner.push_descriptor, set) {
                (Some(extension), _) if !writes.is_empty() => {
                    extension.cmd_push_descriptor_set(raw, point, pipeline.handles.layout, 0, writes);
                }
                (None, Some(set)) => {
                    writes.iter_mut().for_each(|write| write.dst_set = set);
                    device.update_descriptor_sets(writes, &[]);
                    device.cmd_bind_descriptor_sets(raw, point, pipeline.handles.layout, 0, &[set], &[]);
                }
                _ => {}
            }
            if !push.is_empty() {
                device.cmd_push_constants(
                    raw,
                    pipeline.handles.layout,
                    vk::ShaderStageFlags::COMPUTE,
                    0,
                    push,
                );
            }
        }
        Ok(())
    }
}

/// Returns the number of bound bytes.
#[cfg(not(feature = "testing"))]
fn bound_bytes(buffer: &Buffer) -> u64 {
    buffer.bytes()
}

/// Returns the number of bound bytes, including the guard band behind the buffer. Drivers drop writes outside the bound
/// range, so a shorter range would hide breaches.
#[cfg(feature = "testing")]
fn bound_bytes(buffer: &Buffer) -> u64 {
    buffer.bytes() + buffer.guard_behind()
}
