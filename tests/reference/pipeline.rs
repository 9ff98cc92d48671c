//! The twins together: a whole frame and its gradient.

use super::blend::{Pixel, blend};
use super::blend_backward::{PixelGradient, blend_backward};
use super::project::project;
use super::project_backward::{pose_gradient, project_backward};
use super::types::{Gaussian, Gradient, Splat, SplatGradient, TILE, View};
use super::{lists, sort};

pub struct Frame {
    /// Per Gaussian, `None` when culled.
    pub splats: Vec<Option<Splat>>,
    /// Per Gaussian, tiles touched.
    pub tiles_touched: Vec<u32>,
    /// Per tile, its Gaussians front to back.
    pub lists: Vec<Vec<u32>>,
    pub pixels: Vec<Pixel>,
}

pub struct FrameGradient {
    /// Gradients of the splats, per Gaussian.
    pub splats: Vec<SplatGradient>,
    /// Gradients of the parameters, per Gaussian; zeros when culled.
    pub parameters: Vec<Gradient>,
    /// dL/dδ of the pose exp(δ^) T at δ = 0, (ν, ω).
    pub pose: [f64; 6],
}

pub fn render(gaussians: &[Gaussian], view: &View) -> Frame {
    let kept = |(index, g)| if view.drawn.drops(index) { None } else { project(g, view) };
    let splats: Vec<Option<Splat>> = gaussians.iter().enumerate().map(kept).collect();
    let mut instances = lists::expand(&splats, view);
    let tiles_touched = tiles_touched(&instances, gaussians.len());
    sort::sort_by_tile_and_depth(&mut instances);
    let tile_ids: Vec<u32> = instances.iter().map(|instance| instance.tile).collect();
    let tile_count = view.tiles()[0] * view.tiles()[1];
    let lists: Vec<Vec<u32>> = lists::ranges(&tile_ids, tile_count)
        .into_iter()
        .map(|[begin, end]| {
            instances[begin as usize..end as usize].iter().map(|instance| instance.gaussian).collect()
        })
        .collect();
    let by_tile: Vec<Vec<&Splat>> = lists.iter().map(|list| splats_of(&splats, list)).collect();
    let pixels =
        pixels_of(view).map(|pixel| blend(&by_tile[tile_of(view, pixel)], pixel, view.background)).collect();
    Frame { splats, tiles_touched, lists, pixels }
}

/// The gradient of Σ pixel · d_pixel.
pub fn backward(
    gaussians: &[Gaussian],
    view: &View,
    frame: &Frame,
    d_pixels: &[PixelGradient],
) -> FrameGradient {
    let mut splats = vec![SplatGradient::default(); gaussians.len()];
    let by_tile: Vec<Vec<&Splat>> = frame.lists.iter().map(|list| splats_of(&frame.splats, list)).collect();
    let mut sums: Vec<Vec<SplatGradient>> =
        frame.lists.iter().map(|list| vec![SplatGradient::default(); list.len()]).collect();
    for (pixel, d_pixel) in pixels_of(view).zip(d_pixels) {
        let tile = tile_of(view, pixel);
        blend_backward(&by_tile[tile], pixel, view.background, *d_pixel, &mut sums[tile]);
    }
    for (list, sums) in frame.lists.iter().zip(&sums) {
        for (&gaussian, sum) in list.iter().zip(sums) {
            splats[gaussian as usize].add(sum);
        }
    }
    let parameters = gaussians
        .iter()
        .enumerate()
        .map(|(index, gaussian)| match frame.splats[index] {
            Some(_) => project_backward(gaussian, view, &splats[index]),
            None => Gradient { sh: vec![[0.0; 3]; gaussian.sh.len()], ..Gradient::default() },
        })
        .collect();
    let mut pose = [0.0; 6];
    for ((gaussian, splat), d) in gaussians.iter().zip(&frame.splats).zip(&splats) {
        if splat.is_some() {
            let own = pose_gradient(gaussian, view, d);
            (0..6).for_each(|i| pose[i] += own[i]);
        }
    }
    FrameGradient { splats, parameters, pose }
}

impl SplatGradient {
    pub fn add(&mut self, other: &SplatGradient) {
        for i in 0..2 {
            self.mean2d_px[i] += other.mean2d_px[i];
            self.absolute_px[i] += other.absolute_px[i];
        }
        for i in 0..3 {
            self.conic[i] += other.conic[i];
            self.color[i] += other.color[i];
        }
        self.opacity += other.opacity;
        self.inverse_depth += other.inverse_depth;
    }
}

pub fn pixels_of(view: &View) -> impl Iterator<Item = [u32; 2]> + use<> {
    let [width, height] = view.size_px;
    (0..height).flat_map(move |y| (0..width).map(move |x| [x, y]))
}

pub fn tile_of(view: &View, pixel: [u32; 2]) -> usize {
    ((pixel[1] / TILE) * view.tiles()[0] + pixel[0] / TILE) as usize
}

fn splats_of<'a>(splats: &'a [Option<Splat>], list: &[u32]) -> Vec<&'a Splat> {
    list.iter().map(|&g| splats[g as usize].as_ref().expect("only visible Gaussians are listed")).collect()
}

fn tiles_touched(instances: &[lists::Instance], gaussians: usize) -> Vec<u32> {
    let mut touched = vec![0; gaussians];
    for instance in instances {
        touched[instance.gaussian as usize] += 1;
    }
    touched
}
