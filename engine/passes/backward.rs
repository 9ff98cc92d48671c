//! The backward pass: from dL/dpixel to dL/d(every parameter), exact and in one fixed order of summation.
//!
//! There are no atomics. Each (tile, Gaussian) instance has its own storage at its index before the tile
//! sort, and the instances of one Gaussian are contiguous there. The tile's workgroup writes the instance's
//! sums, and project_backward adds a Gaussian's instances in order. The same inputs on the same device give
//! the same bits.

use crate::error::Result;
use crate::frame::{
    BlendShape, FrameInputs, FrameVariant, LENS_SUM_BYTES, LaunchSizes, POSE_SUM_BYTES, first_lens_sum,
};
use crate::kernels::backward::{
    blend_backward, blend_backward_subgroup_per_tile, expand_gradients, project_backward,
};
use crate::passes::blend::record_passes;
use crate::vk::{Buffer, Context, KernelSet, Recorder};

/// The kernels of the backward pass.
pub struct Backward {
    context: Context,
    sizes: LaunchSizes,
    /// One subgroup per region of a tile.
    blend_regions: KernelSet<blend_backward::Interface>,
    /// One subgroup per tile.
    blend_tiles: KernelSet<blend_backward_subgroup_per_tile::Interface>,
    project: KernelSet<project_backward::Interface>,
    expand: KernelSet<expand_gradients::Interface>,
}

/// Sums of the backward blending per (tile, Gaussian) instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sums {
    /// Sums for the gradients of all parameters.
    Gradients,
    /// The same, and the absolute gradients of the 2D mean.
    Absolute,
    /// Only the Gaussian's weights.
    Weights,
}

/// Outputs of the backward pass besides the gradients of all parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackwardForm {
    /// Statistics of the absolute gradients of the 2D means: norms of (W/2 Σ|g_x|, H/2 Σ|g_y|), with g = dL/d(2D mean in pixels)
    /// of each pixel alone (AbsGS, Ye et al. 2024). Needs a frame with
    /// [`FrameCapacity::absolute`](crate::frame::FrameCapacity::absolute).
    pub absolute: bool,
    /// Sums from which [`PoseGradient`](crate::passes::poses::PoseGradient) computes the gradient of the camera's pose. The scene
    /// must have the scale 1, and the frame [`FrameCapacity::camera_sums`](crate::frame::FrameCapacity::camera_sums).
    pub pose: bool,
    /// Sums from which [`LensGradient`](crate::passes::lens::LensGradient) computes the gradient of the lens. The camera must have
    /// one, and the frame the same sums.
    pub lens: bool,
}

impl BackwardForm {
    fn sums(self) -> Sums {
        if self.absolute { Sums::Absolute } else { Sums::Gradients }
    }
}

/// Densification statistics per Gaussian: sum of NDC gradient norms, number of views.
#[derive(Clone, Copy)]
pub struct Statistics<'a> {
    /// vec2 per Gaussian.
    pub buffer: &'a Buffer,
    /// True if the pass updates it.
    pub accumulate: bool,
}

/// Buffers and push constants of the backward blending, which both kernels share (blend_gradient.glsl).
macro_rules! blend_backward_arguments {
    ($kernel:ident, $backward:expr, $inputs:expr, $gradient:expr, $pass:expr) => {{
        let (sizes, f) = (&$backward.sizes, $inputs.buffers);
        let splats = f.splats();
        let bind = $kernel::Bind {
            tile_ranges: &f.tile_ranges,
            sorted_visible: f.sorted_visible($inputs.keeps_instances()),
            sorted_instances: &f.sorted_instances,
            mean2d_extent: splats.mean2d_extent,
            conic_opacity: splats.conic_opacity,
            color_inverse_depth: splats.color_inverse_depth,
            rendered: f.rendered(sizes),
            depth_sums: &f.depth_sums,
            last_entries: &f.last_entries,
            image_gradient: $gradient,
            backward_state: &f.backward_state,
            instance_gradients_a: &f.instance_gradients_a,
            instance_gradients_b: &f.instance_gradients_b,
            instance_gradients_c: &f.instance_gradients_c,
            instance_gradients_d: f.absolute_gradients($inputs.capacity.absolute),
            state: &f.state,
        };
        let push = $kernel::Push {
            image_width: $pass.image_width,
            image_height: $pass.image_height,
            tiles_per_row: $pass.tiles_per_row,
            tile_count: $pass.tile_count,
            first_entry: $pass.first_entry,
            max_entries: $pass.max_entries,
            first_instance: $pass.first_instance,
            max_instances: $pass.max_instances,
            tile_row_interleave: $pass.tile_row_interleave,
            background: $inputs.settings.background,
            splat_stride: $pass.splat_stride,
            whole_width: $pass.whole_width,
        };
        (bind, push)
    }};
}

impl Backward {
    /// Creates an instance without kernels; [`Backward::prepare`] builds them.
    pub fn new(context: &Context) -> Self {
        Self {
            context: context.clone(),
            sizes: LaunchSizes::new(context.limits()),
            blend_regions: KernelSet::default(),
            blend_tiles: KernelSet::default(),
            project: KernelSet::default(),
            expand: KernelSet::default(),
        }
    }

    /// Builds the missing kernels for an SH degree, a variant and a form.
    pub fn prepare(&mut self, sh_degree: u32, variant: FrameVariant, form: BackwardForm) -> Result<()> {
        self.prepare_blend(form.sums(), variant)?;
        self.project.prepare(&self.context, self.project_spec(sh_degree, variant, form))
    }

    /// Builds the kernel of [`Backward::record_weights`] for a variant, if it is missing.
    pub fn prepare_weights(&mut self, variant: FrameVariant) -> Result<()> {
        self.prepare_blend(Sums::Weights, variant)
    }

    fn prepare_blend(&mut self, sums: Sums, variant: FrameVariant) -> Result<()> {
        match self.sizes.blend_backward_subgroup_per_tile {
            true => self.blend_tiles.prepare(&self.context, self.blend_tiles_spec(sums, variant)),
            false => self.blend_regions.prepare(&self.context, self.blend_regions_spec(sums, variant)),
        }
    }

    fn blend_regions_spec(&self, sums: Sums, variant: FrameVariant) -> blend_backward::Spec {
        let BlendShape { lanes: subgroup_size, region_height, tile } = self.sizes.blend_heavy;
        blend_backward::Spec {
            workgroup_size: tile,
            subgroup_size,
            inverse_depth: variant.inverse_depth,
            incremental_exp: self.sizes.tuning.incremental_exp && !variant.steep,
            count_hits: false,
            strips: self.sizes.strips,
            absolute: sums == Sums::Absolute,
            weights: sums == Sums::Weights,
            region_height,
            broadcast: self.context.limits().broadcasts,
            lenses: variant.projection.has_seam(),
        }
    }

    fn blend_tiles_spec(&self, sums: Sums, variant: FrameVariant) -> blend_backward_subgroup_per_tile::Spec {
        let subgroup_size = self.sizes.blend_heavy.lanes;
        blend_backward_subgroup_per_tile::Spec {
            workgroup_size: subgroup_size,
            subgroup_size,
            inverse_depth: variant.inverse_depth,
            incremental_exp: self.sizes.tuning.incremental_exp && !variant.steep,
            count_hits: false,
            strips: self.sizes.strips,
            absolute: sums == Sums::Absolute,
            weights: sums == Sums::Weights,
            lenses: variant.projection.has_seam(),
        }
    }

    fn project_spec(
        &self,
        sh_degree: u32,
        variant: FrameVariant,
        BackwardForm { absolute, pose: pose_gradient, lens: lens_gradient }: BackwardForm,
    ) -> project_backward::Spec {
        let FrameVariant {
            filter_3d, own_dilation, dropout, z_record, sh_storage, projection, shutter, ..
        } = variant;
        project_backward::Spec {
            // The indirect dispatch over the visible Gaussians counts blocks of the elementwise workgroup's size.
            workgroup_size: self.sizes.elementwise_workgroup,
            subgroup_size: self.context.limits().heavy_subgroup_size,
            sh_degree,
            filter_3d,
            own_dilation,
            dropout,
            z_record,
            sh_storage: sh_storage as u32,
            absolute,
            pose_gradient,
            lens_gradient,
            projection: projection as u32,
            lenses: variant.has_lens(),
            sh_loops: self.sizes.tuning.sh_loops,
            shutter,
            ..project_backward::Spec::default()
        }
    }

    /// Builds the kernel of [`Backward::record_expand_gradients`].
    pub fn prepare_expand(&mut self, sh_degree: u32, variant: FrameVariant) -> Result<()> {
        self.expand.prepare(&self.context, self.expand_spec(sh_degree, variant))
    }

    fn expand_spec(&self, sh_degree: u32, variant: FrameVariant) -> expand_gradients::Spec {
        let (workgroup_size, sh_loops) = (self.sizes.elementwise_workgroup, self.sizes.tuning.sh_loops);
        let (projection, lenses) = variant.direction_form();
        expand_gradients::Spec { workgroup_size, sh_degree, sh_loops, projection, lenses }
    }

    /// Records the backward pass of the frame in the same buffers, from `image_gradient` to `inputs.buffers.gradients`.
    ///
    /// `image_gradient` has the device's native layout: per pixel dL/d(r, g, b, inverse depth), row by row. Devices that use
    /// [`Strips`] have three planes, or four with [`inverse_depth`](crate::RenderSettings::inverse_depth).
    /// [`LayoutConverter::record_gradient`](crate::passes::pixels::LayoutConverter::record_gradient) converts it from rows, which are the same
    /// on all devices. Without inverse depth, the caller may pass `inputs.buffers.image_gradient`. `form` must have been prepared.
    ///
    /// # Panics
    /// If `form` asks for the gradient of a camera, and the frame has no sums for it.
    ///
    /// [`Strips`]: crate::frame::Strips
    pub fn record(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        image_gradient: &Buffer,
        statistics: Statistics,
        form: BackwardForm,
    ) {
        let sums = inputs.buffers.camera_sums(inputs.capacity);
        assert!(
            inputs.capacity.camera_sums || !(form.pose || form.lens),
            "the frame has sums for its camera"
        );
        if form.lens {
            // Blocks without a visible Gaussian write no sum.
            let first = 12 * u64::from(first_lens_sum(inputs.capacity));
            let blocks = self.sizes.groups(inputs.scene().count);
            r.fill(&sums.range(first, blocks * LENS_SUM_BYTES), 0);
        }
        if form.pose {
            // Subgroups without a visible Gaussian write no sum.
            let subgroups = inputs.scene().count.div_ceil(self.context.limits().heavy_subgroup_size);
            r.fill(&sums.range(0, u64::from(subgroups) * POSE_SUM_BYTES), 0);
        }
        if inputs.hidden_by.is_some() {
            // Instances of hidden tiles are not blended, and their gradients are 0.
            let f = inputs.buffers;
            let sums = [&f.instance_gradients_a, &f.instance_gradients_b, &f.instance_gradients_c];
            let absolute = form.absolute.then(|| f.absolute_gradients(true));
            sums.into_iter().chain(absolute).for_each(|sums| r.fill(sums, 0));
            r.barrier();
        }
        r.scope("blend backward", |r| self.record_blend(r, inputs, image_gradient, form.sums()));
        r.barrier();
        r.scope("project backward", |r| self.record_project(r, inputs, statistics, form));
    }

    /// Records the weights of the Gaussians in the frame of the same buffers. A weight is the sum over the tile's pixels of e α
    /// T, with `image_gradient` = (e, …) per pixel in the native layout. It becomes the first word of each entry of
    /// `inputs.buffers.instance_gradients_c`, per instance before the tile sort. The frame must be without inverse depth.
    pub fn record_weights(&self, r: &mut Recorder, inputs: &FrameInputs, image_gradient: &Buffer) {
        r.scope("blend weights", |r| self.record_blend(r, inputs, image_gradient, Sums::Weights));
    }

    fn record_blend(&self, r: &mut Recorder, inputs: &FrameInputs, image_gradient: &Buffer, sums: Sums) {
        let variant = inputs.variant();
        macro_rules! passes {
            ($kernels:ident, $spec:expr, $kernel:ident) => {{
                let Some(kernel) = r.kernel(&self.$kernels, $spec) else { return };
                record_passes(r, inputs, &self.sizes, |r, pass, tiles| {
                    let (bind, push) = blend_backward_arguments!($kernel, self, inputs, image_gradient, pass);
                    r.dispatch(kernel, &bind, &push, tiles);
                });
            }};
        }
        match self.sizes.blend_backward_subgroup_per_tile {
            true => {
                let spec = self.blend_tiles_spec(sums, variant);
                passes!(blend_tiles, &spec, blend_backward_subgroup_per_tile);
            }
            false => passes!(blend_regions, &self.blend_regions_spec(sums, variant), blend_backward),
        }
    }

    fn record_project(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        statistics: Statistics,
        form: BackwardForm,
    ) {
        let (f, scene) = (inputs.buffers, inputs.scene());
        let spec = self.project_spec(inputs.sh_degree(), inputs.trained_variant(), form);
        let Some(kernel) = r.kernel(&self.project, &spec) else { return };
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        scene.record_chunks(r, |r, range, parameters| {
            let push = project_backward::Push {
                first: range.first,
                chunk_gaussians: scene.plan.chunk_gaussians,
                antialias: inputs.settings.antialias_bits(),
                splat_stride: f.splats().stride,
                gradient_stride: inputs.capacity.visible,
                accumulate: statistics.accumulate.into(),
                first_lens_sum: first_lens_sum(inputs.capacity),
                shutter_turn,
                shutter_shift,
                shutter_rows,
            };
            let bind = project_backward::Bind {
                parameters,
                state: &f.state,
                visible_ranges: &f.visible_ranges,
                visible_list: &f.visible_list,
                footprints: f.splats().footprints,
                first_instances: &f.first_instances,
                conic_opacity: f.splats().conic_opacity,
                instance_gradients_a: &f.instance_gradients_a,
                instance_gradients_b: &f.instance_gradients_b,
                instance_gradients_c: &f.instance_gradients_c,
                instance_gradients_d: f.absolute_gradients(inputs.capacity.absolute),
                gradients: &f.gradients,
                statistics: statistics.buffer,
                pose_sums: f.camera_sums(inputs.capacity),
                camera_block: &f.camera_block(0),
            };
            r.dispatch_indirect(kernel, &bind, &push, &f.range_arguments(&self.sizes, range.first));
        });
    }

    /// Records the conversion of `inputs.buffers.gradients` to gradients of all parameters of all Gaussians, in the layout of the
    /// scene's planes, and of the 2D means in pixels.
    pub fn record_expand_gradients(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        parameter_gradients: &[Buffer],
        mean2d_gradients: &Buffer,
    ) {
        let (f, scene) = (inputs.buffers, inputs.scene());
        let spec = self.expand_spec(inputs.sh_degree(), inputs.variant());
        let Some(kernel) = r.kernel(&self.expand, &spec) else { return };
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        scene.record_chunks(r, |r, range, parameters| {
            let bind = expand_gradients::Bind {
                parameters,
                visible_index: &f.visible_index,
                gradients: &f.gradients,
                parameter_gradients: &parameter_gradients[range.chunk],
                mean2d_gradients,
                camera_block: &f.camera_block(0),
            };
            let push = expand_gradients::Push {
                camera_position: inputs.camera.position().to_array(),
                first: range.first,
                count: range.count,
                gradient_stride: inputs.capacity.visible,
                chunk_gaussians: scene.plan.chunk_gaussians,
                planes: scene.plan.planes,
                shutter_turn,
                shutter_shift,
                shutter_rows,
            };
            r.dispatch(kernel, &bind, &push, self.sizes.groups(range.count));
        });
    }
}
