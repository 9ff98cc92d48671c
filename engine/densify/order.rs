//! Sorts the new set along a space-filling curve, so that Gaussians in the same views are close in memory.

use super::{Densify, DensifyBuffers};
use crate::forward::SceneBuffers;
use crate::kernels::constants::ZORDER_BITS;
use crate::kernels::densify::zorder;
use crate::plan::{LaunchSizes, blocks};
use crate::scan::Workgroups;
use crate::sort::{SortBuffers, Values};
use crate::vk::{Buffer, Recorder};
use glam::Vec3;

/// Frame of the curve: see zorder.comp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// Mean position of the cameras, world.
    pub center: Vec3,
    /// Extent of the scene, world units; positive.
    pub extent: f32,
}

/// Scratch of the sort along a curve.
#[derive(Clone)]
pub struct OrderBuffers {
    /// Position of each row on the curve; sorting scratch.
    pub keys: [Buffer; 2],
    /// Like [`DensifyBuffers::sources`].
    pub sources: Buffer,
    /// Sorting scratch: counts per digit and block, and per digit and run.
    pub histogram: Buffer,
    /// Sorting scratch: keys per digit.
    pub digit_totals: Buffer,
}

impl OrderBuffers {
    /// Names and bytes, in the order of the fields, for `rows` rows.
    pub fn requests(sizes: &LaunchSizes, rows: u32) -> [(&'static str, u64); 5] {
        let words = u64::from(rows) * 4;
        [
            ("zorder_keys_a", words),
            ("zorder_keys_b", words),
            ("ordered_sources", words),
            ("zorder_histogram", sizes.sort_histogram_words(rows.into(), ZORDER_BITS) * 4),
            ("zorder_digit_totals", (1 << sizes.sort_digit_bits()) * 4),
        ]
    }

    /// Assigns the buffers that were allocated for [`OrderBuffers::requests`].
    ///
    /// # Panics
    /// If the number of buffers differs.
    pub fn from_allocated(buffers: Vec<Buffer>) -> Self {
        let Ok([a, b, sources, histogram, digit_totals]) = <[Buffer; 5]>::try_from(buffers) else {
            panic!("one buffer per request")
        };
        Self { keys: [a, b], sources, histogram, digit_totals }
    }
}

impl Densify {
    /// Records the sort of `rows` sources of [`Densify::record_scatter_sources`] and returns the buffer with the result. A
    /// barrier must precede it; it ends with one. Rows in the same cell of the curve keep their order.
    pub fn record_order<'a>(
        &self,
        r: &mut Recorder,
        set: (&SceneBuffers, u32),
        buffers: &'a DensifyBuffers,
        order: &'a OrderBuffers,
        curve: &Curve,
    ) -> &'a Buffer {
        self.record_order_of(r, set, (&buffers.sources, &buffers.totals), order, curve)
    }

    /// Same as [`Densify::record_order`], but for sources that others have written. The fourth word of `totals` is scratch.
    pub fn record_order_of<'a>(
        &self,
        r: &mut Recorder,
        (scene, rows): (&SceneBuffers, u32),
        (unordered, totals): (&'a Buffer, &Buffer),
        order: &'a OrderBuffers,
        curve: &Curve,
    ) -> &'a Buffer {
        let sources = [unordered, &order.sources];
        r.scope("order", |r| {
            r.fill(&totals.range(DensifyBuffers::ROWS * 4, 4), rows);
            for range in scene.plan.ranges(scene.count) {
                if range.chunk > 0 {
                    r.barrier();
                }
                let bind = zorder::Bind {
                    sources: sources[0],
                    parameters: &scene.chunks[range.chunk],
                    keys: &order.keys[0],
                };
                let push = zorder::Push {
                    first: range.first,
                    count: range.count,
                    rows,
                    center: curve.center.to_array(),
                    extent: curve.extent,
                };
                r.dispatch(
                    &self.zorder,
                    &bind,
                    &push,
                    blocks(rows.into(), self.sizes.elementwise_workgroup.into()),
                );
            }
            r.barrier();
            let pairs = SortBuffers {
                counts: totals,
                count_index: DensifyBuffers::ROWS as u32,
                keys: [&order.keys[0], &order.keys[1]],
                values: sources,
                histogram: &order.histogram,
                digit_totals: &order.digit_totals,
            };
            let elements = Workgroups::Elements(rows.into());
            let end = self.sort.record(r, &pairs, Values::Given, ZORDER_BITS, elements);
            r.barrier();
            sources[end]
        })
    }
}
