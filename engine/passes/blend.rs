//! Blending, in two forms.

use crate::error::Result;
use crate::frame::{Blending, FrameInputs, FrameVariant, LaunchSizes, Outputs, SurfaceDepth, tile_grid};
use crate::kernels::forward::{blend, blend_auxiliary, blend_shared, blend_shared_auxiliary};
use crate::vk::{Context, KernelSet, Limits, Recorder};

pub(crate) struct Blend {
    /// Form of blending.
    pub blending: Blending,
    broadcast: bool,
    shared_splats: bool,
    regions: KernelSet<blend::Interface>,
    shared: KernelSet<blend_shared::Interface>,
    regions_auxiliary: KernelSet<blend_auxiliary::Interface>,
    shared_auxiliary: KernelSet<blend_shared_auxiliary::Interface>,
}

/// Key of a blending kernel. Frames with outputs besides the picture have kernels of their own.
enum BlendKey {
    Regions(blend::Spec),
    Shared(blend_shared::Spec),
    RegionsAuxiliary(blend_auxiliary::Spec),
    SharedAuxiliary(blend_shared_auxiliary::Spec),
}

/// Buffers of blend_io.glsl, for all kernels; and those of blend_auxiliary.glsl, which must be bound even if they are not used.
macro_rules! blend_bind {
    ($kernel:ident, $inputs:expr $(, $auxiliary:ident)*) => {{
        let frame = $inputs.buffers;
        let splats = frame.splats();
        $kernel::Bind {
            tile_ranges: &frame.tile_ranges,
            sorted_visible: frame.sorted_visible($inputs.keeps_instances()),
            mean2d_extent: splats.mean2d_extent,
            conic_opacity: splats.conic_opacity,
            color_inverse_depth: splats.color_inverse_depth,
            accumulated: &frame.accumulated,
            depth_sums: &frame.depth_sums,
            last_entries: &frame.last_entries,
            state: &frame.state,
            // Without a limit the kernel does not read this binding.
            depth_limits: $inputs.depth_limits.unwrap_or(&frame.tile_ranges),
            composited: &frame.composited,
            $($auxiliary: &frame.$auxiliary,)*
        }
    }};
}

impl Blend {
    pub fn new(limits: &Limits) -> Self {
        Self {
            blending: Blending::default(),
            broadcast: limits.broadcasts,
            shared_splats: limits.tuning.shared_splats,
            regions: KernelSet::default(),
            shared: KernelSet::default(),
            regions_auxiliary: KernelSet::default(),
            shared_auxiliary: KernelSet::default(),
        }
    }

    fn key(&self, sizes: &LaunchSizes, variant: FrameVariant) -> BlendKey {
        // The kernels' LINEAR_DEPTH is the expected depth. `RenderSettings::linear_depth` stores z in the splats' records instead.
        let FrameVariant {
            inverse_depth,
            expected_depth: linear_depth,
            depth_limit,
            steep,
            outputs,
            surface_depth,
            ..
        } = variant;
        let last_entries = variant.backward || variant.last_entries;
        let distance_order = variant.distance_order && depth_limit;
        let Self { broadcast, shared_splats, .. } = *self;
        let LaunchSizes { tile_shared, regions_per_subgroup, tuning, .. } = *sizes;
        let (incremental_exp, strips) = (tuning.incremental_exp && !steep, variant.backward && sizes.strips);
        let Outputs { pick, motion, surface } = outputs;
        // Kernels without surfaces do not depend on it.
        let surface_transmittance =
            if surface { surface_depth } else { SurfaceDepth::default() }.transmittance();
        let lenses = variant.projection.has_seam();
        // Only the overrides of a context set it.
        let count_hits = false;
        macro_rules! regions {
            ($kernel:ident, $shape:expr $(, $auxiliary:ident)*) => {
                $kernel::Spec {
                    workgroup_size: $shape.tile / regions_per_subgroup,
                    subgroup_size: $shape.lanes,
                    inverse_depth,
                    depth_limit,
                    linear_depth,
                    incremental_exp,
                    regions_per_subgroup,
                    count_hits,
                    strips,
                    region_height: $shape.region_height,
                    broadcast,
                    shared_splats,
                    last_entries,
                    distance_order,
                    lenses,
                    $($auxiliary,)*
                }
            };
        }
        macro_rules! shared {
            ($kernel:ident $(, $auxiliary:ident)*) => {
                $kernel::Spec {
                    workgroup_size: tile_shared,
                    subgroup_size: sizes.blend.lanes,
                    inverse_depth,
                    depth_limit,
                    linear_depth,
                    incremental_exp,
                    count_hits,
                    strips,
                    last_entries,
                    distance_order,
                    lenses,
                    $($auxiliary,)*
                }
            };
        }
        match (self.blending, outputs.any()) {
            (Blending::Regions, false) => BlendKey::Regions(regions!(blend, sizes.blend)),
            (Blending::SharedMemory, false) => BlendKey::Shared(shared!(blend_shared)),
            (Blending::Regions, true) => BlendKey::RegionsAuxiliary(regions!(
                blend_auxiliary,
                sizes.blend_heavy,
                pick,
                motion,
                surface,
                surface_transmittance
            )),
            (Blending::SharedMemory, true) => BlendKey::SharedAuxiliary(shared!(
                blend_shared_auxiliary,
                pick,
                motion,
                surface,
                surface_transmittance
            )),
        }
    }

    pub fn prepare(&mut self, context: &Context, sizes: &LaunchSizes, variant: FrameVariant) -> Result<()> {
        match self.key(sizes, variant) {
            BlendKey::Regions(spec) => self.regions.prepare(context, spec),
            BlendKey::Shared(spec) => self.shared.prepare(context, spec),
            BlendKey::RegionsAuxiliary(spec) => self.regions_auxiliary.prepare(context, spec),
            BlendKey::SharedAuxiliary(spec) => self.shared_auxiliary.prepare(context, spec),
        }
    }

    /// Records the blending: colour and transmittance of each pixel.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, sizes: &LaunchSizes) {
        macro_rules! passes {
            ($kernels:ident, $spec:expr, $kernel:ident $(, $auxiliary:ident)*) => {{
                let Some(kernel) = r.kernel(&self.$kernels, $spec) else { return };
                record_passes(r, inputs, sizes, |r, push, tiles| {
                    let bind = blend_bind!($kernel, inputs $(, $auxiliary)*);
                    r.dispatch(kernel, &bind, &bytemuck::cast(push), tiles);
                });
            }};
        }
        macro_rules! auxiliary_passes {
            ($kernels:ident, $spec:expr, $kernel:ident) => {
                passes!($kernels, $spec, $kernel, picks, motions, motion_sums, splat_surfaces, surfaces)
            };
        }
        match &self.key(sizes, inputs.variant()) {
            BlendKey::Regions(spec) => passes!(regions, spec, blend),
            BlendKey::Shared(spec) => passes!(shared, spec, blend_shared),
            BlendKey::RegionsAuxiliary(spec) => auxiliary_passes!(regions_auxiliary, spec, blend_auxiliary),
            BlendKey::SharedAuxiliary(spec) => {
                auxiliary_passes!(shared_auxiliary, spec, blend_shared_auxiliary);
            }
        }
    }
}

/// Records the blending of all tiles, forward or backward. Each dispatch takes a range of instances, to
/// bound its work; within a range, very long tiles take several passes. `dispatch` receives the push constants of blend_io.glsl,
/// which the kernels share, and the number of tiles.
pub(crate) fn record_passes(
    r: &mut Recorder,
    inputs: &FrameInputs,
    sizes: &LaunchSizes,
    dispatch: impl Fn(&mut Recorder, blend_shared::Push, u64),
) {
    let (columns, rows) = tile_grid(inputs.camera.width, inputs.camera.height);
    let passes = inputs.capacity.blend_passes;
    // The host only knows the capacity, not the number of instances.
    let ranges = sizes.blend_ranges(inputs.capacity.instances);
    for (range, pass) in (0..ranges).flat_map(|range| (0..passes).map(move |pass| (range, pass))) {
        if range + pass > 0 {
            r.barrier();
        }
        let first_instance = range * sizes.instances_per_dispatch;
        let push = blend_shared::Push {
            image_width: inputs.camera.width,
            image_height: inputs.camera.height,
            tiles_per_row: columns,
            tile_count: columns * rows,
            first_entry: pass.saturating_mul(sizes.entries_per_pass),
            max_entries: sizes.entries_per_pass,
            first_instance,
            // Empty tiles may begin after the last instance.
            max_instances: if range + 1 == ranges {
                u32::MAX - first_instance
            } else {
                sizes.instances_per_dispatch
            },
            tile_row_interleave: sizes.tuning.tile_row_interleave,
            last_pass: (pass + 1 == passes).into(),
            splat_stride: inputs.buffers.splats().stride,
            background: inputs.settings.background,
            whole_width: inputs.camera.whole().width,
        };
        dispatch(r, push, u64::from(columns) * u64::from(rows));
    }
}
