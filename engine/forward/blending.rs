//! Blending, in two forms.

use super::{FrameInputs, RenderSettings, SceneSettings};
use crate::error::Result;
use crate::kernels::forward::{
    blend, blend_auxiliary, blend_shared, blend_shared_auxiliary, cull, cull_scenes, project, project_scenes,
};
use crate::plan::{LaunchSizes, tile_grid};
use crate::scene::Camera;
use crate::vk::{Context, KernelSet, Limits, Recorder};

/// Form of the blending kernel: the picture is the same, the cost depends on the device. The pictures agree to the bit if the
/// driver's compiler fuses sums of products alike in both kernels, as llvmpipe's does. `precise` arithmetic decides which
/// Gaussians count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blending {
    /// Each subgroup culls against its own region of the tile and passes Gaussians on by shuffles or broadcasts. It is the
    /// faster form on all measured devices.
    #[default]
    Regions,
    /// The paper's form: batches in shared memory, and every invocation loops over the whole batch.
    SharedMemory,
}

impl Blending {
    /// Both forms.
    pub const ALL: [Self; 2] = [Self::Regions, Self::SharedMemory];
}

/// Variant of a frame's kernels: additional outputs of blending, and properties of the Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlendVariant {
    /// Blends the sum of weights / z, or of weights * z with `linear_depth`.
    pub inverse_depth: bool,
    /// See `inverse_depth`.
    pub linear_depth: bool,
    /// Splats beyond the frame's depth limits do not count.
    pub depth_limit: bool,
    /// The picture is stored in the layout of the backward pass.
    pub backward: bool,
    /// Splats may be steeper than [`DILATION_PX2`](crate::kernels::constants::DILATION_PX2) allows, like those of ellipsoids.
    /// The products of INCREMENTAL_EXP would underflow (glsl/include/blending.glsl).
    pub steep: bool,
    /// Gaussians have a 3D filter. Affects culling and projection.
    pub filter_3d: bool,
    /// Random Gaussians are omitted. Affects culling and projection.
    pub dropout: bool,
    /// A scene has a tint or an opacity ([`SceneSettings`]). Affects culling and projection.
    pub tinted: bool,
    /// A scene has cut-outs. Affects culling.
    pub cut_outs: bool,
    /// A scene has a selection. Affects projection.
    pub selection: bool,
    /// The splats' records have z in place of 1/z, so that the sum of weights * z is differentiable, unlike with
    /// `linear_depth`. Affects projection.
    pub z_record: bool,
    /// Stores the Gaussian of the largest weight for each pixel.
    pub pick: bool,
    /// Blends the sum of weights * motions.
    pub motion: bool,
    /// The camera's rays are parallel ([`Projection::Orthographic`](crate::scene::Projection::Orthographic)). Affects culling
    /// and projection.
    pub orthographic: bool,
    /// Views share one order. Culling adds to the visible Gaussians of earlier views, and projection omits those that its view
    /// does not show.
    pub shared_order: bool,
}

impl BlendVariant {
    /// Returns the variant of a pinhole's frame of one scene, in a buffer of its own.
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

    /// Returns the variant of one of a frame's scenes.
    pub(crate) fn of_scene(self, scene: &SceneSettings) -> Self {
        let [tinted, cut_outs, selection] = scene.kinds();
        Self { tinted, cut_outs, selection, ..self }
    }

    /// Returns the variant with a camera.
    pub(crate) fn of_camera(self, camera: &Camera) -> Self {
        Self { orthographic: camera.is_orthographic(), ..self }
    }

    pub(super) fn cull_spec(self, sizes: &LaunchSizes, subgroup_size: u32) -> cull::Spec {
        let Self { filter_3d, dropout, tinted, cut_outs, orthographic, shared_order: adds, .. } = self;
        let workgroup_size = sizes.elementwise_workgroup;
        cull::Spec { workgroup_size, subgroup_size, filter_3d, dropout, tinted, cut_outs, orthographic, adds }
    }

    pub(super) fn project_spec(self, sizes: &LaunchSizes, sh_degree: u32) -> project::Spec {
        let Self { filter_3d, dropout, tinted, selection, z_record, orthographic, shared_order, .. } = self;
        project::Spec {
            workgroup_size: sizes.elementwise_workgroup,
            sh_degree,
            filter_3d,
            dropout,
            tinted,
            selection,
            z_record,
            orthographic,
            sh_loops: sizes.sh_loops,
            may_be_unseen: shared_order,
        }
    }

    /// True if batches support the variant.
    pub(super) fn may_be_batched(self) -> bool {
        !(self.dropout || self.selection || self.z_record || self.backward)
    }

    pub(super) fn cull_scenes_spec(self, sizes: &LaunchSizes, subgroup_size: u32) -> cull_scenes::Spec {
        let Self { filter_3d, tinted, cut_outs, orthographic, shared_order: adds, .. } = self;
        let workgroup_size = sizes.elementwise_workgroup;
        cull_scenes::Spec { workgroup_size, subgroup_size, filter_3d, tinted, cut_outs, orthographic, adds }
    }

    pub(super) fn project_scenes_spec(self, sizes: &LaunchSizes, sh_degree: u32) -> project_scenes::Spec {
        let Self { filter_3d, tinted, orthographic, shared_order, .. } = self;
        project_scenes::Spec {
            workgroup_size: sizes.elementwise_workgroup,
            sh_degree,
            filter_3d,
            tinted,
            orthographic,
            sh_loops: sizes.sh_loops,
            may_be_unseen: shared_order,
        }
    }

    fn strips(self, sizes: &LaunchSizes) -> bool {
        self.backward && sizes.strips
    }
}

/// Kernels of blending.
pub(super) struct Blend {
    blending: Blending,
    broadcast: bool,
    shared_splats: bool,
    regions: KernelSet<blend::Interface>,
    shared: KernelSet<blend_shared::Interface>,
    regions_auxiliary: KernelSet<blend_auxiliary::Interface>,
    shared_auxiliary: KernelSet<blend_shared_auxiliary::Interface>,
}

/// Key of a blending kernel. Kernels of frames with picks or motions have further outputs.
enum BlendKey {
    Regions(blend::Spec),
    Shared(blend_shared::Spec),
    RegionsAuxiliary(blend_auxiliary::Spec),
    SharedAuxiliary(blend_shared_auxiliary::Spec),
}

/// Buffers of blend_io.glsl, for all kernels; and those of blend_auxiliary.glsl, which must be bound even if they are not used.
macro_rules! blend_bind {
    ($kernel:ident, $inputs:expr, $sizes:expr $(, $auxiliary:ident)?) => {{
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
            // Without a limit the kernel does not read this binding.
            depth_limits: $inputs.depth_limits.unwrap_or(&frame.tile_ranges),
            composited: &frame.composited,
            $(
                picks: $auxiliary.picks.map_or(&frame.last_entries, |own| own.picks),
                motions: $auxiliary.motion.map_or(&frame.tile_ranges, |own| own.motions),
                motion_sums: $auxiliary.motion.map_or(&frame.last_entries, |own| own.sums),
            )?
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

    pub fn blending(&self) -> Blending {
        self.blending
    }

    pub fn choose(&mut self, blending: Blending) -> bool {
        std::mem::replace(&mut self.blending, blending) != blending
    }

    fn key(&self, sizes: &LaunchSizes, variant: BlendVariant) -> BlendKey {
        let BlendVariant { inverse_depth, linear_depth, depth_limit, steep, pick, motion, .. } = variant;
        let Self { broadcast, shared_splats, .. } = *self;
        let LaunchSizes { tile_shared, incremental_exp, regions_per_subgroup, .. } = *sizes;
        let (incremental_exp, strips) = (incremental_exp && !steep, variant.strips(sizes));
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
                    $($auxiliary,)*
                }
            };
        }
        match (self.blending, pick || motion) {
            (Blending::Regions, false) => BlendKey::Regions(regions!(blend, sizes.blend)),
            (Blending::SharedMemory, false) => BlendKey::Shared(shared!(blend_shared)),
            (Blending::Regions, true) => {
                BlendKey::RegionsAuxiliary(regions!(blend_auxiliary, sizes.blend_auxiliary, pick, motion))
            }
            (Blending::SharedMemory, true) => {
                BlendKey::SharedAuxiliary(shared!(blend_shared_auxiliary, pick, motion))
            }
        }
    }

    pub fn prepare(&mut self, context: &Context, sizes: &LaunchSizes, variant: BlendVariant) -> Result<()> {
        match self.key(sizes, variant) {
            BlendKey::Regions(spec) => self.regions.prepare(context, spec),
            BlendKey::Shared(spec) => self.shared.prepare(context, spec),
            BlendKey::RegionsAuxiliary(spec) => self.regions_auxiliary.prepare(context, spec),
            BlendKey::SharedAuxiliary(spec) => self.shared_auxiliary.prepare(context, spec),
        }
    }

    pub fn is_prepared(&self, sizes: &LaunchSizes, variant: BlendVariant) -> bool {
        match self.key(sizes, variant) {
            BlendKey::Regions(spec) => self.regions.contains(&spec),
            BlendKey::Shared(spec) => self.shared.contains(&spec),
            BlendKey::RegionsAuxiliary(spec) => self.regions_auxiliary.contains(&spec),
            BlendKey::SharedAuxiliary(spec) => self.shared_auxiliary.contains(&spec),
        }
    }

    /// Records the blending: colour and transmittance of each pixel.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, sizes: &LaunchSizes) {
        let auxiliary = inputs.auxiliary;
        macro_rules! passes {
            ($kernels:ident, $spec:expr, $kernel:ident $(, $auxiliary:ident)?) => {{
                let Some(kernel) = self.$kernels.get(r, $spec) else { return };
                record_passes(r, inputs, sizes, |r, push, tiles| {
                    let bind = blend_bind!($kernel, inputs, sizes $(, $auxiliary)?);
                    r.dispatch(kernel, &bind, &bytemuck::cast(push), tiles);
                });
            }};
        }
        match &self.key(sizes, inputs.blend_variant()) {
            BlendKey::Regions(spec) => passes!(regions, spec, blend),
            BlendKey::Shared(spec) => passes!(shared, spec, blend_shared),
            BlendKey::RegionsAuxiliary(spec) => passes!(regions_auxiliary, spec, blend_auxiliary, auxiliary),
            BlendKey::SharedAuxiliary(spec) => {
                passes!(shared_auxiliary, spec, blend_shared_auxiliary, auxiliary);
            }
        }
    }
}

/// Records the blending of all tiles, forward or backward. Very long tiles need several passes, and each pass has enough
/// dispatches to bound the work of one. `dispatch` receives the push constants of blend_io.glsl, which the kernels share, and
/// the number of tiles.
pub(crate) fn record_passes(
    r: &mut Recorder,
    inputs: &FrameInputs,
    sizes: &LaunchSizes,
    dispatch: impl Fn(&mut Recorder, blend_shared::Push, u64),
) {
    let (columns, rows) = tile_grid(inputs.camera.width, inputs.camera.height);
    let passes = inputs.capacity.blend_passes;
    // The host only knows the capacity, not the number of instances.
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
