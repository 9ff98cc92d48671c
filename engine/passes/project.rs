//! Projection: screen-space attributes of the visible Gaussians (EWA splatting), and their motion or their normals if a frame has
//! them. Culling runs the same projection before, for the visibility only.

use crate::error::Result;
use crate::frame::{Batch, FrameInputs, FrameVariant, LaunchSizes, Part, SceneView, ShStorage};
use crate::kernels::forward::{project, project_scenes, screen_motion, splat_surfaces};
use crate::scene::Projection;
use crate::vk::{Context, KernelSet, Recorder};

pub(crate) struct Project {
    sizes: LaunchSizes,
    scene: KernelSet<project::Interface>,
    batch: KernelSet<project_scenes::Interface>,
    motion: KernelSet<screen_motion::Interface>,
    surfaces: KernelSet<splat_surfaces::Interface>,
}

impl Project {
    pub fn new(context: &Context) -> Self {
        Self {
            sizes: LaunchSizes::new(context.limits()),
            scene: KernelSet::default(),
            batch: KernelSet::default(),
            motion: KernelSet::default(),
            surfaces: KernelSet::default(),
        }
    }

    /// Builds the missing kernels of a variant; `batches`: also that of batches.
    pub fn prepare(
        &mut self,
        context: &Context,
        sh_degree: u32,
        variant: FrameVariant,
        batches: bool,
    ) -> Result<()> {
        self.scene.prepare(context, self.spec(sh_degree, variant))?;
        if batches {
            self.batch.prepare(context, self.batch_spec(sh_degree, variant))?;
        }
        if variant.outputs.surface {
            self.surfaces.prepare(context, self.surfaces_spec(variant.projection))?;
        }
        motion_projections(variant)
            .try_for_each(|projections| self.motion.prepare(context, self.motion_spec(projections)))
    }

    fn spec(&self, sh_degree: u32, variant: FrameVariant) -> project::Spec {
        let FrameVariant {
            filter_3d,
            dropout,
            tinted,
            selection,
            z_record,
            projection,
            shutter,
            shared_order,
            sh_storage,
            distance_order,
            ..
        } = variant;
        project::Spec {
            workgroup_size: self.sizes.elementwise_workgroup,
            sh_degree,
            filter_3d,
            dropout,
            tinted,
            selection,
            z_record,
            projection: projection as u32,
            lenses: variant.has_lens(),
            sh_loops: self.sizes.tuning.sh_loops,
            shared_order,
            sh_storage: sh_storage as u32,
            distance_order,
            shutter,
        }
    }

    fn batch_spec(&self, sh_degree: u32, variant: FrameVariant) -> project_scenes::Spec {
        let FrameVariant { filter_3d, tinted, projection, shutter, shared_order, distance_order, .. } =
            variant;
        project_scenes::Spec {
            workgroup_size: self.sizes.elementwise_workgroup,
            sh_degree,
            filter_3d,
            tinted,
            projection: projection as u32,
            lenses: variant.has_lens(),
            sh_loops: self.sizes.tuning.sh_loops,
            shared_order,
            distance_order,
            shutter,
        }
    }

    fn motion_spec(&self, [now, previous]: [Projection; 2]) -> screen_motion::Spec {
        screen_motion::Spec {
            workgroup_size: self.sizes.elementwise_workgroup,
            projection: now as u32,
            previous_projection: previous as u32,
        }
    }

    fn surfaces_spec(&self, projection: Projection) -> splat_surfaces::Spec {
        splat_surfaces::Spec {
            workgroup_size: self.sizes.elementwise_workgroup,
            projection: projection as u32,
        }
    }

    /// Records the projection of all visible Gaussians.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        let (splats, [extent, antialias]) = (f.splats(), inputs.settings.modes());
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        let mut is_first = true;
        for batch in inputs.batches.list {
            if !std::mem::take(&mut is_first) {
                r.barrier();
            }
            self.record_batch(r, inputs, batch);
        }
        for part in inputs.parts() {
            let variant = inputs.variant().of_scene(part.scene.plan.sh_storage, part.settings);
            let Some(kernel) = r.kernel(&self.scene, &self.spec(part.sh_degree, variant)) else { return };
            let push = project::Push {
                first: part.first_in_frame,
                chunk_gaussians: part.scene.plan.chunk_gaussians,
                extent,
                antialias,
                splat_stride: splats.stride,
                first_of_scene: part.first_in_scene,
                shutter_turn,
                shutter_shift,
                shutter_rows,
            };
            let bind = project::Bind {
                parameters: &part.scene.chunks[part.chunk],
                visible_ranges: &f.visible_ranges,
                visible_list: &f.visible_list,
                mean2d_extent: splats.mean2d_extent,
                conic_opacity: splats.conic_opacity,
                color_inverse_depth: splats.color_inverse_depth,
                depth_keys: f.depth_sort_keys(&self.sizes)[0],
                footprints: splats.footprints,
                tile_lists: &f.tile_lists,
                // Without a selection the kernel does not read this binding.
                selection: part.settings.mask().unwrap_or(&f.visible_list),
                camera_block: &f.camera_block(part.block),
            };
            if !std::mem::take(&mut is_first) {
                r.barrier();
            }
            r.dispatch_indirect(kernel, &bind, &push, &f.range_arguments(&self.sizes, part.first_in_frame));
            self.record_splat_motions(r, inputs, &part);
            self.record_splat_surfaces(r, inputs, &part);
        }
    }

    /// Records the projection of a batch.
    fn record_batch(&self, r: &mut Recorder, inputs: &FrameInputs, batch: &Batch) {
        let first = &inputs.scenes[batch.first as usize];
        let spec =
            self.batch_spec(first.sh_degree, inputs.variant().of_scene(ShStorage::F32, first.settings));
        let Some(kernel) = r.kernel(&self.batch, &spec) else { return };
        let ([extent, antialias], f) = (inputs.settings.modes(), inputs.buffers);
        let [first_block, end_block] = batch.blocks(self.sizes.elementwise_workgroup);
        let splats = f.splats();
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        let push = project_scenes::Push {
            first_block,
            end_block,
            scenes: inputs.scenes.len() as u32,
            batch: batch.first,
            blocks: inputs.index_count().div_ceil(self.sizes.elementwise_workgroup),
            extent,
            antialias,
            splat_stride: splats.stride,
            shutter_turn,
            shutter_shift,
            shutter_rows,
        };
        let bind = project_scenes::Bind {
            parameters: &first.scene.chunks[0].whole(),
            block_offsets: &f.visible_blocks,
            visible_list: &f.visible_list,
            mean2d_extent: splats.mean2d_extent,
            conic_opacity: splats.conic_opacity,
            color_inverse_depth: splats.color_inverse_depth,
            depth_keys: f.depth_sort_keys(&self.sizes)[0],
            footprints: splats.footprints,
            tile_lists: &f.tile_lists,
            state: &f.state,
            scene_blocks: &inputs.camera_blocks(),
        };
        r.dispatch(kernel, &bind, &push, (end_block - first_block).into());
    }

    /// Records the motions of a part's visible Gaussians if the frame requests them. The projection neither reads nor writes
    /// these outputs, so no barrier is necessary between them.
    fn record_splat_motions(&self, r: &mut Recorder, inputs: &FrameInputs, part: &Part) {
        if !inputs.outputs.motion {
            return;
        }
        let (f, SceneView { camera, scale }) = (inputs.buffers, part.previous);
        let spec = self.motion_spec([inputs.camera.projection, camera.projection]);
        let Some(kernel) = r.kernel(&self.motion, &spec) else { return };
        let rows = camera.camera_from_world.transpose() * scale;
        let push = screen_motion::Push {
            first: part.first_in_frame,
            previous_row_x: rows.x_axis.to_array(),
            previous_row_y: rows.y_axis.to_array(),
            previous_row_z: rows.z_axis.to_array(),
            previous_translation: camera.translation.to_array(),
            previous_focal_px: [camera.fx, camera.fy],
            // Same offset as in the camera block.
            previous_center_px: [camera.cx - 0.5, camera.cy - 0.5],
        };
        let bind = screen_motion::Bind {
            parameters: &part.scene.chunks[part.chunk],
            visible_ranges: &f.visible_ranges,
            visible_list: &f.visible_list,
            motions: &f.motions,
            camera_block: &f.camera_block(part.block),
        };
        r.dispatch_indirect(kernel, &bind, &push, &f.range_arguments(&self.sizes, part.first_in_frame));
    }

    /// Records normals and slopes of a part's visible Gaussians if the frame has a surface, also without a barrier.
    fn record_splat_surfaces(&self, r: &mut Recorder, inputs: &FrameInputs, part: &Part) {
        if !inputs.outputs.surface {
            return;
        }
        let f = inputs.buffers;
        let Some(kernel) = r.kernel(&self.surfaces, &self.surfaces_spec(inputs.camera.projection)) else {
            return;
        };
        let bind = splat_surfaces::Bind {
            parameters: &part.scene.chunks[part.chunk],
            visible_ranges: &f.visible_ranges,
            visible_list: &f.visible_list,
            splat_surfaces: &f.splat_surfaces,
            camera_block: &f.camera_block(part.block),
        };
        let push = splat_surfaces::Push { first: part.first_in_frame };
        r.dispatch_indirect(kernel, &bind, &push, &f.range_arguments(&self.sizes, part.first_in_frame));
    }
}

/// Current and previous projections for which frames of a variant may need a kernel of motion. A reservation without other
/// projections has pinholes alone.
fn motion_projections(variant: FrameVariant) -> impl Iterator<Item = [Projection; 2]> {
    let known = [Projection::Perspective, Projection::Orthographic];
    let pairs = known.into_iter().flat_map(move |now| known.map(|before| [now, before]));
    let others = variant.projection != Projection::Perspective;
    pairs.filter(move |pair| variant.outputs.motion && (others || *pair == [Projection::Perspective; 2]))
}
