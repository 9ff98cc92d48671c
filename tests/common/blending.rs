//! The two blending kernels over tile lists.

use super::frame::Lists;
use super::gpu::Gpu;
use ashsplat::frame::tuning::Backend;
use ashsplat::frame::{Outputs, Strips};
use ashsplat::kernels::backward::{blend_backward, blend_backward_subgroup_per_tile};
use ashsplat::kernels::forward::{blend, blend_auxiliary, blend_shared, blend_shared_auxiliary};
use ashsplat::vk::{Buffer, Context};

pub struct Blended {
    pub accumulated: Buffer,
    /// Three planes; only written in strips.
    pub composited: Buffer,
    pub depth_sums: Buffer,
    pub last_entries: Buffer,
}

pub struct SlotSums {
    /// 1, dx, dy, dx², dx·dy, dy², r, g, b, inverse depth. With WEIGHTS, the weight takes the place of b.
    pub sums: Vec<[f64; 10]>,
    /// Sum over pixels of |dL/d(mean2d)|.
    pub absolute: Vec<[f64; 2]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OtherSums {
    None,
    /// ABSOLUTE: also the absolute gradients.
    Absolute,
    /// WEIGHTS: only the weights.
    Weights,
}

/// Compares the outputs of two forms of blending: exactly on CPUs, within `error` on GPUs. A GPU's compiler may fuse
/// sums of products in one kernel only.
pub fn assert_same(context: &Context, a: &[f32], b: &[f32], (what, error): (&str, f32)) {
    let same = |(a, b): (&f32, &f32)| {
        a.to_bits() == b.to_bits()
            || (context.limits().tuning.backend == Backend::Gpu && (a - b).abs() <= error * (1.0 + b.abs()))
    };
    assert!(a.len() == b.len() && a.iter().zip(b).all(same), "{what} differ");
}

/// Compares the outputs of two variants of a kernel: exactly on CPUs, elsewhere within this share of the largest
/// value.
pub fn assert_alike(context: &Context, a: &[f32], b: &[f32], (what, share): (&str, f32)) {
    let exact = context.description().kind == "CPU";
    let bound = share * b.iter().fold(0.0_f32, |max, x| max.max(x.abs()));
    let same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || (!exact && (a - b).abs() <= bound);
    assert!(a.len() == b.len() && a.iter().zip(b).all(same), "{what} differ");
}

fn region_height(gpu: &Gpu, form: Form) -> u32 {
    (if form.low_regions { 4 } else { 8 }).max(gpu.subgroup() / 8)
}

/// Invocations of a workgroup of one tile.
fn workgroup(gpu: &Gpu, form: Form) -> u32 {
    gpu.subgroup() * 32 / region_height(gpu, form)
}

/// Runs the passes of a kernel, with a workgroup too many. `$more` are fields of a pass's push constants that only
/// this kernel has.
macro_rules! run_passes {
    (
        $gpu:expr, $lists:expr, $form:expr, $kernel:ident, $spec:expr, $bind:expr,
        |$pass:ident| { $($more:ident: $value:expr,)* }
    ) => {{
        let (lists, max_entries) = ($lists, $form.entries_per_pass);
        let [tiles_per_row, rows] = lists.view.tiles();
        let pushes = dispatches(lists, $form).map(|($pass, [first_instance, max_instances])| $kernel::Push {
            image_width: lists.view.size_px[0],
            image_height: lists.view.size_px[1],
            tiles_per_row,
            tile_count: tiles_per_row * rows,
            first_entry: $pass * max_entries,
            max_entries,
            first_instance,
            max_instances,
            tile_row_interleave: ROW_STRANDS,
            splat_stride: 1,
            background: lists.view.background.map(|x| x as f32),
            whole_width: 0,
            $($more: $value,)*
        });
        let workgroups = u64::from(tiles_per_row * rows) + 1;
        $gpu.dispatch_each::<$kernel::Interface>(&$spec, &$bind, pushes, workgroups);
    }};
}

/// Runs a blending kernel over lists, with at most `$form.entries_per_pass` entries of each tile per pass.
macro_rules! blend_lists {
    (
        $gpu:expr, $lists:expr, $kernel:ident, $spec:expr, $form:expr, $limits:expr
        $(, $auxiliary:ident: $buffer:expr)*
    ) => {{
        let (gpu, lists) = ($gpu, $lists);
        let pixels = lists.view.pixels();
        let blended = Blended {
            accumulated: gpu.untouched::<[f32; 4]>("accumulated", pixels),
            composited: gpu.untouched::<[f32; 3]>("composited", strips_of(lists).values() as usize),
            depth_sums: gpu.untouched::<f32>("depth_sums", pixels),
            last_entries: gpu.untouched::<u32>("last_entries", pixels),
        };
        let bind = $kernel::Bind {
            tile_ranges: &lists.tile_ranges,
            sorted_visible: &lists.sorted_visible,
            mean2d_extent: &lists.frame.mean2d_extent,
            conic_opacity: &lists.frame.conic_opacity,
            color_inverse_depth: &lists.frame.color_inverse_depth,
            accumulated: &blended.accumulated,
            composited: &blended.composited,
            depth_sums: &blended.depth_sums,
            last_entries: &blended.last_entries,
            state: &lists.state,
            depth_limits: $limits.unwrap_or(&lists.tile_ranges),
            $($auxiliary: $buffer,)*
        };
        run_passes!(gpu, lists, $form, $kernel, $spec, bind, |pass| {
            last_pass: u32::from(pass + 1 == passes(lists, $form)),
        });
        blended
    }};
}

#[derive(Clone, Copy, Debug)]
pub struct Form {
    pub inverse_depth: bool,
    /// DISTANCE_ORDER: lists need not be in the order of z.
    pub distance_order: bool,
    /// INCREMENTAL_EXP: each opacity of a column follows from the one above.
    pub incremental_exp: bool,
    /// REGIONS_PER_SUBGROUP: regions of a subgroup.
    pub parts: u32,
    pub entries_per_pass: u32,
    /// Number of passes; None for as many as the longest list needs.
    pub passes: Option<u32>,
    /// REGION_HEIGHT 4 instead of 8 (if the subgroup is no higher), and BROADCAST.
    pub low_regions: bool,
    /// SHARED_SPLATS.
    pub shares: bool,
    /// Invocations per tile of the kernels `blend_shared*`; None for the others.
    pub by_workgroup: Option<u32>,
    /// STRIPS: pictures and gradients are planes in strips.
    pub strips: bool,
    pub sums: OtherSums,
}

pub fn strips_of(lists: &Lists) -> Strips {
    let [width, height] = lists.view.size_px;
    Strips { width, height }
}

/// True if kernels can work in strips: a lane then has four or eight rows of a column.
pub fn has_strips(gpu: &Gpu) -> bool {
    gpu.subgroup() <= 16
}

/// Inverse depth, one pass, incremental exponentials.
pub const CHAINED: Form = Form {
    inverse_depth: true,
    distance_order: false,
    incremental_exp: true,
    parts: 1,
    entries_per_pass: u32::MAX,
    passes: None,
    low_regions: false,
    shares: false,
    by_workgroup: None,
    strips: false,
    sums: OtherSums::None,
};
pub const UNCHAINED: Form = Form { incremental_exp: false, ..CHAINED };
pub const LOW: Form = Form { low_regions: true, ..UNCHAINED };
pub const SHARED: Form = Form { shares: true, ..UNCHAINED };
pub const IN_STRIPS: Form = Form { strips: true, ..CHAINED };

/// Forms to test: all on a device; on the slower interpreter only those that GPUs use.
pub fn forms(gpu: &Gpu) -> Vec<Form> {
    let in_strips = if has_strips(gpu) { vec![IN_STRIPS] } else { Vec::new() };
    match gpu.is_interpreted() {
        true => vec![LOW, SHARED],
        false => [vec![UNCHAINED, CHAINED, LOW, SHARED], in_strips].concat(),
    }
}

/// Blends lists by `forward/blend` or `forward/blend_shared`.
pub fn forward(gpu: &Gpu, lists: &Lists, form: Form) -> Blended {
    forward_limited(gpu, lists, form, false, None)
}

/// Same as [`forward`], but with depth limits (1/z per pixel), and with the sum of weights * z if asked for.
pub fn forward_limited(
    gpu: &Gpu,
    lists: &Lists,
    form: Form,
    linear_depth: bool,
    limits: Option<&Buffer>,
) -> Blended {
    let Form { inverse_depth, distance_order, incremental_exp, parts, strips, .. } = form;
    let (subgroup_size, depth_limit, count_hits) = (gpu.subgroup(), limits.is_some(), false);
    if let Some(workgroup_size) = form.by_workgroup {
        let spec = blend_shared::Spec {
            last_entries: true,
            workgroup_size,
            subgroup_size,
            inverse_depth,
            depth_limit,
            linear_depth,
            incremental_exp,
            count_hits,
            strips,
            distance_order,
            lenses: false,
        };
        return blend_lists!(gpu, lists, blend_shared, spec, form, limits);
    }
    let spec = blend::Spec {
        last_entries: true,
        workgroup_size: workgroup(gpu, form) / parts,
        subgroup_size,
        inverse_depth,
        depth_limit,
        linear_depth,
        incremental_exp,
        regions_per_subgroup: parts,
        count_hits,
        strips,
        region_height: region_height(gpu, form),
        broadcast: form.low_regions,
        shared_splats: form.shares,
        distance_order,
        lenses: false,
    };
    blend_lists!(gpu, lists, blend, spec, form, limits)
}

pub struct Auxiliary {
    pub blended: Blended,
    /// Value per pixel: 1 + place in the list, and the bits of the weight.
    pub picks: Buffer,
    /// Value per pixel: sum of weights * motions.
    pub motion_sums: Buffer,
    /// Value per pixel: sum of weights * normals, and the median depth.
    pub surfaces: Buffer,
}

/// Bits of a half float with the value of a float that has one.
fn half_bits(x: f32) -> u16 {
    let bits = x.to_bits();
    let exponent = (bits >> 23 & 255).saturating_sub(112) << 10;
    (bits >> 16 & 0x8000 | if x == 0.0 { 0 } else { exponent | bits >> 13 & 1023 }) as u16
}

/// Blends lists by `forward/blend_auxiliary` or `forward/blend_shared_auxiliary`. Writes the outputs that are asked for. A splat of the
/// motion (x, y) has the normal (x, y, x - y), and (x, y) / 1024 as the slope of its depth.
pub fn forward_auxiliary(
    gpu: &Gpu,
    lists: &Lists,
    form: Form,
    motions: &[[f32; 2]],
    Outputs { pick, motion, surface }: Outputs,
) -> Auxiliary {
    let Form { inverse_depth, incremental_exp, parts, .. } = form;
    let pixels = lists.view.pixels();
    let picks = gpu.untouched::<[u32; 2]>("picks", pixels);
    let motion_sums = gpu.untouched::<[f32; 2]>("motion_sums", pixels);
    let surfaces = gpu.untouched::<[f32; 4]>("surfaces", pixels);
    let half = |x: f32| u32::from(half_bits(x / 1024.0));
    let own = |&[x, y]: &[f32; 2]| [x, y, x - y, f32::from_bits(half(x) | half(y) << 16)];
    let splat_surfaces: Vec<[f32; 4]> = motions.iter().map(own).collect();
    let (motions, splat_surfaces) =
        (gpu.buffer("motions", motions), gpu.buffer("splat_surfaces", &splat_surfaces));
    let (subgroup_size, limits) = (gpu.subgroup(), None::<&Buffer>);
    let blended = match form.by_workgroup {
        None => {
            let spec = blend_auxiliary::Spec {
                workgroup_size: workgroup(gpu, form) / parts,
                subgroup_size,
                inverse_depth,
                incremental_exp,
                regions_per_subgroup: parts,
                region_height: region_height(gpu, form),
                broadcast: form.low_regions,
                shared_splats: form.shares,
                pick,
                motion,
                surface,
                ..blend_auxiliary::Spec::default()
            };
            blend_lists!(
                gpu, lists, blend_auxiliary, spec, form, limits,
                picks: &picks, motions: &motions, motion_sums: &motion_sums, splat_surfaces: &splat_surfaces,
                surfaces: &surfaces
            )
        }
        Some(workgroup_size) => {
            let spec = blend_shared_auxiliary::Spec {
                workgroup_size,
                subgroup_size,
                inverse_depth,
                incremental_exp,
                pick,
                motion,
                surface,
                ..blend_shared_auxiliary::Spec::default()
            };
            blend_lists!(
                gpu, lists, blend_shared_auxiliary, spec, form, limits,
                picks: &picks, motions: &motions, motion_sums: &motion_sums, splat_surfaces: &splat_surfaces,
                surfaces: &surfaces
            )
        }
    };
    Auxiliary { blended, picks, motion_sums, surfaces }
}

macro_rules! backward_of_lists {
    (
        $kernel:ident, $gpu:expr, $lists:expr, $blended:expr, $gradient:expr, $form:expr, $workgroup_size:expr
        $(, $region_height:ident)?
    ) => {{
        let (gpu, lists, blended) = ($gpu, $lists, $blended);
        let Form { inverse_depth, incremental_exp, strips, sums, .. } = $form;
        let (workgroup_size, subgroup_size) = ($workgroup_size, gpu.subgroup());
        let count_hits = false;
        let spec = $kernel::Spec {
            workgroup_size,
            subgroup_size,
            inverse_depth,
            incremental_exp,
            count_hits,
            strips,
            absolute: sums == OtherSums::Absolute,
            weights: sums == OtherSums::Weights,
            lenses: false,
            $($region_height: region_height(gpu, $form), broadcast: $form.low_regions,)?
        };
        let (pixels, instances) = (lists.view.pixels(), lists.instances.len());
        let image_gradient = match $gradient {
            Some(gradient) if strips => {
                gpu.buffer("image_gradient", &strips_of(lists).planes(gradient.iter().copied()))
            }
            Some(gradient) => gpu.buffer("image_gradient", gradient),
            None => gpu.zeros::<[f32; 4]>("image_gradient", strips_of(lists).values() as usize),
        };
        let backward_state = gpu.untouched::<[f32; 2]>("backward_state", pixels);
        let [instance_gradients_a, instance_gradients_b] = ["instance_gradients_a", "instance_gradients_b"]
            .map(|name| gpu.untouched::<[f32; 4]>(name, instances));
        let [instance_gradients_c, instance_gradients_d] = ["instance_gradients_c", "instance_gradients_d"]
            .map(|name| gpu.untouched::<[f32; 2]>(name, instances));
        let bind = $kernel::Bind {
            tile_ranges: &lists.tile_ranges,
            sorted_visible: &lists.sorted_visible,
            sorted_instances: &lists.sorted_instances,
            mean2d_extent: &lists.frame.mean2d_extent,
            conic_opacity: &lists.frame.conic_opacity,
            color_inverse_depth: &lists.frame.color_inverse_depth,
            rendered: if strips { &blended.composited } else { &blended.accumulated },
            depth_sums: &blended.depth_sums,
            last_entries: &blended.last_entries,
            image_gradient: &image_gradient,
            backward_state: &backward_state,
            instance_gradients_a: &instance_gradients_a,
            instance_gradients_b: &instance_gradients_b,
            instance_gradients_c: &instance_gradients_c,
            instance_gradients_d: &instance_gradients_d,
            state: &lists.state,
        };
        run_passes!(gpu, lists, $form, $kernel, spec, bind, |pass| {});
        let (a, b) = (
            gpu.read::<[f32; 4]>(&instance_gradients_a, instances),
            gpu.read::<[f32; 4]>(&instance_gradients_b, instances),
        );
        let c = gpu.read::<[f32; 2]>(&instance_gradients_c, instances);
        let sums = (0..instances)
            .map(|instance| {
                let all = [a[instance].as_slice(), &b[instance], &c[instance]].concat();
                std::array::from_fn(|k| f64::from(all[k]))
            })
            .collect();
        let d = gpu.read::<[f32; 2]>(&instance_gradients_d, instances);
        SlotSums { sums, absolute: d.into_iter().map(|sum| sum.map(f64::from)).collect() }
    }};
}

/// Sums each instance's gradients by `backward/blend_backward`; `gradient` is per pixel (r, g, b, inverse depth).
pub fn backward(
    gpu: &Gpu,
    lists: &Lists,
    blended: &Blended,
    gradient: Option<&[[f32; 4]]>,
    form: Form,
) -> SlotSums {
    let size = workgroup(gpu, form);
    backward_of_lists!(blend_backward, gpu, lists, blended, gradient, form, size, region_height)
}

/// Same as [`backward`], but by `backward/blend_backward_subgroup_per_tile`.
pub fn backward_alone(
    gpu: &Gpu,
    lists: &Lists,
    blended: &Blended,
    gradient: Option<&[[f32; 4]]>,
    form: Form,
) -> SlotSums {
    backward_of_lists!(blend_backward_subgroup_per_tile, gpu, lists, blended, gradient, form, gpu.subgroup())
}

/// Number of strands that the rows of tiles are dealt to.
const ROW_STRANDS: u32 = 4;

fn passes(lists: &Lists, form: Form) -> u32 {
    let longest = lists.lists.iter().map(Vec::len).max().unwrap_or(0) as u32;
    form.passes.unwrap_or_else(|| longest.div_ceil(form.entries_per_pass).max(1))
}

/// Passes, each once for the tiles that begin in the first half of the instances and once for the others.
fn dispatches(lists: &Lists, form: Form) -> impl Iterator<Item = (u32, [u32; 2])> {
    let half = lists.instances.len() as u32 / 2;
    let parts = [[0, half], [half, u32::MAX - half]];
    (0..passes(lists, form)).flat_map(move |pass| parts.map(|part| (pass, part)))
}
