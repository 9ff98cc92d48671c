//! Resources of a dispatch, and of a whole recording.

use super::buffer::Buffer;
use super::image::Image;
use super::memory::Block;
use super::pipeline::Pipeline;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Resources of a dispatch.
pub(super) struct Bound<'a> {
    pub(super) buffers: &'a [&'a Buffer],
    pub(super) images: &'a [&'a Image],
}

/// All resources of a recording.
pub(super) struct Kept {
    /// Unique id of this recording. Every block stores the id of the last recording that keeps it, which avoids searches.
    id: u64,
    pub(super) blocks: Vec<Arc<Block>>,
    pipelines: Vec<Arc<Pipeline>>,
    images: Vec<Image>,
}

impl Default for Kept {
    fn default() -> Self {
        Self { id: next_id(), blocks: Vec::new(), pipelines: Vec::new(), images: Vec::new() }
    }
}

fn next_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl Kept {
    pub(super) fn block(&mut self, block: &Arc<Block>) {
        // If two threads record with the same block, each may keep it more than once.
        if block.kept_by.swap(self.id, Ordering::Relaxed) != self.id {
            self.blocks.push(block.clone());
        }
    }

    pub(super) fn image(&mut self, image: &Image) {
        if !self.images.iter().rev().any(|i| i.id() == image.id()) {
            self.images.push(image.clone());
        }
    }

    /// Releases all resources, but keeps the lists' memory. Resources without another owner are destroyed.
    pub(super) fn clear(&mut self) {
        self.id = next_id();
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
