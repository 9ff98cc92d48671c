//! Blending, in two forms.

use super::blend_forms::Blending;
use super::{FrameInputs, RenderSettings, SceneSettings};
use crate::error::Result;
use crate::kernels::forward::{blend, blend_shared};
use crate::plan::{LaunchSizes, tile_grid};
use crate::vk::{Context, Kernel, Limits, Recorder};

/// The variant of a frame's kernels: what is blended in addition to colours, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlendVariant {
    /// The sum of weights / z, or of weights * z with `linear_depth`.
    pub inverse_depth: bool,
    /// See `inverse_depth`.
    pub linear_depth: bool,
    /// Splats farther away than the frame's depth limits do not count.
    pub depth_limit: bool,
    /// The picture is stored in the layout of the backward pass.
    pub backward: bool,
    /// Splats may be steeper than [`DILATION_PX2`](crate::kernels::constants::DILATION_PX2) leaves them, as
    /// ellipsoids are. The products of INCREMENTAL_EXP would underflow (glsl/include/blending.glsl).
    pub steep: bool,
    /// Gaussians have a 3D filter: this concerns culling and projection.
    pub filter_3d: bool,
    /// Some Gaussians are left out at random: as `filter_3d`.
    pub dropout: bool,
    /// A scene has a tint or an opacity ([`SceneSettings`]): as `filter_3d`.
    pub tinted: bool,
    /// A scene has cut-outs: this concerns culling.
    pub cut_outs: bool,
    /// A scene has a selection: this concerns projection.
    pub selection: bool,
    /// The splats' records have z in place of 1/z, so that the sum of weights * z is differentiable; `linear_depth` is not:
    /// this concerns projection.
    pub z_record: bool,
}

impl BlendVariant {
    /// That of a frame of one scene, in a buffer of its own.
    pub fn of(settings: &RenderSettings, backward: bool) -> Self {
        Self {
            inverse_depth: settings.inverse_depth,
            backward,
            steep: settings.is_steep(),
            filter_3d: settings.filter_3d,
            dropout: settings.dropout.is_some(),
            z_record: settings.has_z_record(),
            ..Self::default()
        }
    }

    /// That of one of a frame's scenes.
    pub(crate) fn of_scene(self, scene: &SceneSettings) -> Self {
        Self {
            tinted: scene.is_tinted(),
            cut_outs: scene.cut_out_count() > 0,
            selection: scene.mask().is_some(),
            ..self
        }
    }

    fn of_shape(self) -> usize {
        usize::from(self.filter_3d) | usize::from(self.dropout) << 1 | usize::from(self.tinted) << 2
    }

    /// The place of its kernel of culling.
    pub(super) fn of_cull(self) -> usize {
        self.of_shape() | usize::from(self.cut_outs) << 3
    }

    /// The place of its kernels of projection.
    pub(super) fn of_project(self) -> usize {
        self.of_shape() | usize::from(self.z_record) << 3 | usize::from(self.selection) << 4
    }

    fn strips(self, sizes: &LaunchSizes) -> bool {
        self.backward && sizes.strips
    }

    fn index(self, sizes: &LaunchSizes) -> usize {
        usize::from(self.inverse_depth)
            | usize::from(self.linear_depth) << 1
            | usize::from(self.depth_limit) << 2
            | usize::from(self.strips(sizes)) << 3
            | usize::from(self.steep && sizes.incremental_exp) << 4
    }
}

/// The blending kernels by variant, built on first use.
pub(super) struct Blend {
    blending: Blending,
    regions: [Option<Kernel<blend::Interface>>; 32],
    shared: [Option<Kernel<blend_shared::Interface>>; 32],
}

/// The buffers of blend_io.glsl, for both forms of the kernel.
macro_rules! blend_bind {
    ($kernel:ident, $inputs:expr, $sizes:expr) => {{
        let frame = $inputs.frame;
        let splats = frame.splats();
        $kernel::Bind {
            tile_ranges: &frame.tile_ranges,
            sorted_visible: frame.sorted_visible($sizes, $inputs.capacity.backward, $inputs.camera),
            mean2d_extent: splats.mean2d_extent,
            conic_opacity: splats.conic_opacity,
            color_inverse_depth: splats.color_inverse_depth,
            accumulated: &frame.accumulated,
            inverse_depth: &frame.inverse_depth,
            last_entries: &frame.last_entries,
            state: &frame.state,
            // Without a limit it is not read, but must be bound.
            depth_limits: $inputs.depth_limits.unwrap_or(&frame.tile_ranges),
            composited: &frame.composited,
        }
    }};
}

impl Blend {
    pub fn new(limits: &Limits) -> Self {
        Self {
            blending: Blending::of_device(limits),
            regions: Default::default(),
            shared: Default::default(),
        }
    }

    pub fn blending(&self) -> Blending {
        self.blending
    }

    pub fn choose(&mut self, blending: Blending) -> bool {
        std::mem::replace(&mut self.blending, blending) != blending
    }

    pub fn prepare(&mut self, context: &Context, sizes: &LaunchSizes, wanted: BlendVariant) -> Result<()> {
        let BlendVariant { inverse_depth, linear_depth, depth_limit, steep, .. } = wanted;
        let (variant, strips) = (wanted.index(sizes), wanted.strips(sizes));
        let (subgroup_size, broadcast) = (context.limits().subgroup_size, context.limits().broadcasts);
        let LaunchSizes { tile, tile_shared, region_height, incremental_exp, regions_per_subgroup, .. } =
            *sizes;
        let incremental_exp = incremental_exp && !steep;
        match self.blending {
            Blending::Regions if self.regions[variant].is_none() => {
                let spec = blend::Spec {
                    workgroup_size: tile / regions_per_subgroup,
                    subgroup_size,
                    inverse_depth,
                    depth_limit,
                    linear_depth,
                    incremental_exp,
                    regions_per_subgroup,
                    count_hits: false,
                    strips,
                    region_height,
                    broadcast,
                };
                self.regions[variant] = Some(Kernel::new(context, &spec)?);
            }
            Blending::SharedMemory if self.shared[variant].is_none() => {
                let spec = blend_shared::Spec {
                    workgroup_size: tile_shared,
                    subgroup_size,
                    inverse_depth,
                    depth_limit,
                    linear_depth,
                    incremental_exp,
                    count_hits: false,
                    strips,
                };
                self.shared[variant] = Some(Kernel::new(context, &spec)?);
            }
            _ => {}
        }
        Ok(())
    }

    pub fn is_prepared(&self, sizes: &LaunchSizes, wanted: BlendVariant) -> bool {
        let variant = wanted.index(sizes);
        match self.blending {
            Blending::Regions => self.regions[variant].is_some(),
            Blending::SharedMemory => self.shared[variant].is_some(),
        }
    }

    /// Records the blending: colour and transmittance of each pixel.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, sizes: &LaunchSizes) {
        let variant = inputs.blend_variant().index(sizes);
        match (self.blending, &self.regions[variant], &self.shared[variant]) {
            (Blending::Regions, Some(kernel), _) => {
                record_passes(r, inputs, sizes, |r, push, tiles| {
                    r.dispatch(kernel, &blend_bind!(blend, inputs, sizes), &bytemuck::cast(push), tiles);
                });
            }
            (Blending::SharedMemory, _, Some(kernel)) => {
                record_passes(r, inputs, sizes, |r, push, tiles| {
                    r.dispatch(kernel, &blend_bind!(blend_shared, inputs, sizes), &push, tiles);
                });
            }
            _ => panic!("Forward::prepare was not called for {:?}", inputs.blend_variant()),
        }
    }
}

/// Records the blending of all tiles, forward or backward. Very long tiles need several passes, and each pass
/// has enough dispatches to bound the work of one. `dispatch` receives the push constants of blend_io.glsl,
/// which the kernels have in common, and the number of tiles.
pub(crate) fn record_passes(
    r: &mut Recorder,
    inputs: &FrameInputs,
    sizes: &LaunchSizes,
    dispatch: impl Fn(&mut Recorder, blend_shared::Push, u64),
) {
    let (columns, rows) = tile_grid(inputs.camera.width, inputs.camera.height);
    let passes = inputs.capacity.blend_passes;
    // The host knows the capacity only, not the number of instances.
    let parts = sizes.blend_dispatches(inputs.capacity.instances, 1);
    for (part, pass) in (0..parts).flat_map(|part| (0..passes).map(move |pass| (part, pass))) {
        if part + pass > 0 {
            r.barrier();
        }
        let first_instance = part * sizes.instances_per_dispatch;
        let push = blend_shared::Push {
            image_width: inputs.camera.width,
            image_height: inputs.camera.height,
            tiles_per_row: columns,
            tile_count: columns * rows,
            first_entry: pass.saturating_mul(sizes.entries_per_pass),
            max_entries: sizes.entries_per_pass,
            first_instance,
            // Empty tiles may begin after the last instance.
            max_instances: if part + 1 == parts {
                u32::MAX - first_instance
            } else {
                sizes.instances_per_dispatch
            },
            tile_row_interleave: sizes.tile_row_interleave,
            last_pass: (pass + 1 == passes).into(),
            splat_stride: inputs.frame.splats().stride,
            background: inputs.settings.background,
        };
        dispatch(r, push, u64::from(columns) * u64::from(rows));
    }
}
