//! The resources of a dispatch, and of a whole recording.

use super::buffer::Buffer;
use super::image::Image;
use super::kernel::Pipeline;
use super::memory::Block;
use std::sync::Arc;

/// The resources of a dispatch.
pub(super) struct Bound<'a> {
    pub(super) buffers: &'a [&'a Buffer],
    pub(super) images: &'a [&'a Image],
}

/// All resources of a recording.
#[derive(Default)]
pub(super) struct Kept {
    pub(super) blocks: Vec<Arc<Block>>,
    pipelines: Vec<Arc<Pipeline>>,
    images: Vec<Image>,
}

impl Kept {
    pub(super) fn block(&mut self, block: &Arc<Block>) {
        if !self.blocks.iter().rev().any(|b| Arc::ptr_eq(b, block)) {
            self.blocks.push(block.clone());
        }
    }

    pub(super) fn image(&mut self, image: &Image) {
        if !self.images.iter().rev().any(|i| i.id() == image.id()) {
            self.images.push(image.clone());
        }
    }

    /// Releases all resources, and keeps the lists' own memory. Resources without another holder are
    /// destroyed.
    pub(super) fn clear(&mut self) {
        self.blocks.clear();
        self.pipelines.clear();
        self.images.clear();
    }

    pub(super) fn pipeline(&mut self, pipeline: &Arc<Pipeline>) {
        if !self.pipelines.iter().rev().any(|p| Arc::ptr_eq(p, pipeline)) {
            self.pipelines.push(pipeline.clone());
        }
    }
}
