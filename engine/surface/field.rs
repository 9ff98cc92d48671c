//! A field of signed distances on the device.

use super::blocks::{FieldBlocks, FieldSettings, check_view, visible_blocks};
use super::cubes::cube_cases;
use super::mesh::Mesh;
use super::pinholes::PinholeView;
use crate::error::{Error, Result};
use crate::frame::{LaunchSizes, RenderSettings, buffer_set, to_u32};
use crate::kernels::constants::{CUBE_WORDS, FIELD_VOXELS};
use crate::kernels::surface::{count_triangles, count_vertices, integrate, place_triangles, place_vertices};
use crate::passes::scan::{Scan, ScanBuffers, Workgroups};
use crate::render::Renderer;
use crate::vk::{Buffer, Context, Kernel, MemoryKind, Recorder};

/// Word of the number of voxels, and of the sum of their counts.
const VOXELS: u32 = 0;
const TOTAL: u32 = 1;

buffer_set! {
    struct FieldBuffers(blocks: u64, scan: &Scan) {
        let voxels = blocks * u64::from(FIELD_VOXELS);
    }
    /// Per block: its place.
    blocks as "field_blocks": blocks * 16;
    /// Per block that a view shows: its place and index.
    visible_blocks: blocks * 16;
    /// Per block: the eight blocks from it on.
    neighbours: blocks * 32;
    /// Per voxel: see field.glsl.
    distances: voxels * 8;
    /// Per voxel: see integrate.comp.
    colors: voxels * 8;
    /// Per voxel: number of its vertices, then of its triangles.
    counts: voxels * 4;
    /// Per voxel: its first vertex.
    vertex_firsts: voxels * 4;
    /// Per voxel: its first triangle.
    triangle_firsts: voxels * 4;
    /// Scratch of the prefix sums.
    scan_blocks: scan.block_words(voxels) * 4;
    /// Words `VOXELS` and `TOTAL`.
    totals: 8;
    /// See cubes.rs.
    cubes: 256 * u64::from(CUBE_WORDS) * 4;
}

/// A field of signed distances to the surfaces of some views, positive in front of them, and its colours.
///
/// # Examples
/// ```no_run
/// use ashsplat::surface::{DistanceField, FieldBlocks, FieldSettings, Mesh, PinholeView, Pinholes};
/// use ashsplat::{Camera, RenderSettings, Renderer, SurfaceDepth};
///
/// fn mesh_of(renderer: &mut Renderer, cameras: &[Camera]) -> ashsplat::Result<Mesh> {
///     let settings = RenderSettings { surface: Some(SurfaceDepth::Front), ..RenderSettings::default() };
///     let mut blocks = FieldBlocks::new(renderer.context(), FieldSettings::new(0.01, 10.0))?;
///     let pinholes = |camera: &Camera| Pinholes::new(&camera.photo_lens(), None).views(camera, None);
///     let views: Vec<PinholeView> = cameras.iter().flat_map(pinholes).collect();
///     for view in &views {
///         blocks.add(view, &renderer.render(&view.camera, &settings)?.surface.unwrap_or_default())?;
///     }
///     let field = DistanceField::new(renderer.context(), &blocks)?;
///     for view in &views {
///         field.integrate(renderer, view, &settings)?;
///     }
///     field.mesh()
/// }
/// ```
pub struct DistanceField {
    context: Context,
    settings: FieldSettings,
    places: Vec<[i32; 3]>,
    voxels: u32,
    workgroup_size: u32,
    buffers: FieldBuffers,
    scan: Scan,
    integrate: Kernel<integrate::Interface>,
    count_vertices: Kernel<count_vertices::Interface>,
    place_vertices: Kernel<place_vertices::Interface>,
    count_triangles: Kernel<count_triangles::Interface>,
    place_triangles: Kernel<place_triangles::Interface>,
}

impl DistanceField {
    /// Allocates the voxels of these blocks, which no view has seen yet.
    pub fn new(context: &Context, blocks: &FieldBlocks) -> Result<Self> {
        if blocks.is_empty() {
            return Err(Error::argument("blocks", "there are none: no view shows a surface"));
        }
        let (places, neighbours) = blocks.sorted();
        let voxels = to_u32(places.len() as u64 * u64::from(FIELD_VOXELS))?;
        let workgroup_size = LaunchSizes::new(context.limits()).elementwise_workgroup;
        let scan = Scan::new(context)?;
        let requests = FieldBuffers::requests(places.len() as u64, &scan);
        let buffers =
            FieldBuffers::from_allocated(context.allocate("field", &requests, MemoryKind::Device)?);
        let words: Vec<[i32; 4]> = places.iter().map(|&[x, y, z]| [x, y, z, 0]).collect();
        context.upload(&buffers.blocks, bytemuck::cast_slice(&words))?;
        context.upload(&buffers.neighbours, bytemuck::cast_slice(&neighbours))?;
        context.upload(&buffers.cubes, bytemuck::cast_slice(&cube_cases()))?;
        context.upload(&buffers.totals, bytemuck::cast_slice(&[voxels, 0]))?;
        context.run("clear field", |r| {
            r.fill(&buffers.distances, 0);
            r.fill(&buffers.colors, 0);
        })?;
        Ok(Self {
            context: context.clone(),
            settings: blocks.settings,
            places,
            voxels,
            workgroup_size,
            buffers,
            scan,
            integrate: Kernel::new(context, &integrate::Spec { workgroup_size })?,
            count_vertices: Kernel::new(context, &count_vertices::Spec { workgroup_size })?,
            place_vertices: Kernel::new(context, &place_vertices::Spec { workgroup_size })?,
            count_triangles: Kernel::new(context, &count_triangles::Spec { workgroup_size })?,
            place_triangles: Kernel::new(context, &place_triangles::Spec { workgroup_size })?,
        })
    }

    /// Renders the renderer's scene in a view, and adds the depths and colours of the pixels that count to the field. Without
    /// [`RenderSettings::surface`], depths are medians.
    ///
    /// # Errors
    /// Same as [`Renderer::render`]; [`Error::Argument`] for a camera that is no pinhole, or counts of another size.
    pub fn integrate(
        &self,
        renderer: &mut Renderer,
        view: &PinholeView,
        settings: &RenderSettings,
    ) -> Result<()> {
        check_view(view)?;
        let camera = &view.camera;
        let frame = renderer.draw_surface(camera, settings)?;
        if let Some(counts) = &view.counts {
            let mut surfaces: Vec<[f32; 4]> = self.read(&frame.surfaces, counts.len() as u64)?;
            surfaces
                .iter_mut()
                .zip(counts)
                .filter(|(_, counts)| !**counts)
                .for_each(|(surface, _)| surface[3] = 0.0);
            self.context.upload(&frame.surfaces, bytemuck::cast_slice(&surfaces))?;
        }
        let visible = visible_blocks(&self.places, &self.settings, camera);
        let voxels = visible.len() as u32 * FIELD_VOXELS;
        self.context.upload(&self.buffers.visible_blocks, bytemuck::cast_slice(&visible))?;
        let rows = camera.camera_from_world.transpose();
        let FieldSettings { voxel, truncation, max_depth, .. } = self.settings;
        let push = integrate::Push {
            row_x: rows.x_axis.to_array(),
            row_y: rows.y_axis.to_array(),
            row_z: rows.z_axis.to_array(),
            translation: camera.translation.to_array(),
            focal_px: [camera.fx, camera.fy],
            center_px: [camera.cx, camera.cy],
            image_width: camera.width,
            image_height: camera.height,
            voxels,
            voxel_size: voxel,
            truncation,
            max_depth,
        };
        let FieldBuffers { visible_blocks, distances, colors, .. } = &self.buffers;
        let bind = integrate::Bind {
            visible_blocks,
            surfaces: &frame.surfaces,
            accumulated: &frame.accumulated,
            distances,
            colors,
        };
        let groups = self.groups(voxels);
        let run = |r: &mut Recorder| r.dispatch(&self.integrate, &bind, &push, groups);
        self.context.run("integrate", run).map(drop)
    }

    /// Returns the surface of distance 0 by marching cubes. Empty if there is none.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for a mesh whose vertices or triangles exceed a buffer; memory or device failures.
    pub fn mesh(&self) -> Result<Mesh> {
        let FieldBuffers { blocks, neighbours, distances, colors, counts, .. } = &self.buffers;
        let FieldBuffers { vertex_firsts, triangle_firsts, cubes, .. } = &self.buffers;
        let FieldSettings { voxel: voxel_size, least_views, .. } = self.settings;
        let groups = self.groups(self.voxels);
        macro_rules! push {
            ($kernel:ident) => {
                $kernel::Push { voxels: self.voxels, voxel_size, least_views }
            };
        }
        let vertices = self.scanned(vertex_firsts, |r| {
            let bind = count_vertices::Bind { neighbours, distances, counts };
            r.dispatch(&self.count_vertices, &bind, &push!(count_vertices), groups);
        })?;
        let triangles = self.scanned(triangle_firsts, |r| {
            let bind = count_triangles::Bind { neighbours, distances, cubes, counts };
            r.dispatch(&self.count_triangles, &bind, &push!(count_triangles), groups);
        })?;
        let requests =
            [("positions", vertices * 12), ("vertex_colors", vertices * 4), ("triangles", triangles * 12)];
        let mesh = self.context.allocate("mesh", &requests, MemoryKind::Device)?;
        self.context.run("mesh", |r| {
            let bind = place_vertices::Bind {
                neighbours,
                distances,
                blocks,
                colors,
                firsts: vertex_firsts,
                positions: &mesh[0],
                vertex_colors: &mesh[1],
            };
            r.dispatch(&self.place_vertices, &bind, &push!(place_vertices), groups);
            let bind = place_triangles::Bind {
                neighbours,
                distances,
                cubes,
                vertex_firsts,
                triangle_firsts,
                triangles: &mesh[2],
            };
            r.dispatch(&self.place_triangles, &bind, &push!(place_triangles), groups);
        })?;
        let colors: Vec<[u8; 4]> = self.read(&mesh[1], vertices)?;
        Ok(Mesh {
            positions: self.read(&mesh[0], vertices)?,
            colors: colors.into_iter().map(|[r, g, b, _]| [r, g, b]).collect(),
            triangles: self.read(&mesh[2], triangles)?,
        })
    }

    fn groups(&self, voxels: u32) -> u64 {
        voxels.div_ceil(self.workgroup_size).into()
    }

    /// Counts by `count`, writes the prefix sums, and returns the total.
    fn scanned(&self, prefix: &Buffer, count: impl FnOnce(&mut Recorder)) -> Result<u64> {
        let FieldBuffers { counts, totals, scan_blocks, .. } = &self.buffers;
        self.context.run("count", |r| {
            count(r);
            r.barrier();
            let buffers = ScanBuffers {
                counts: totals,
                count_index: VOXELS,
                total_index: TOTAL,
                values: counts,
                prefix,
                block_sums: scan_blocks,
            };
            self.scan.record(r, &buffers, Workgroups::Elements(self.voxels.into()));
        })?;
        Ok(self.read::<u32>(totals, 2)?[TOTAL as usize].into())
    }

    fn read<T: bytemuck::Pod>(&self, buffer: &Buffer, count: u64) -> Result<Vec<T>> {
        let bytes = count * size_of::<T>() as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        Ok(bytemuck::pod_collect_to_vec(&self.context.download(&buffer.range(0, bytes))?))
    }
}
