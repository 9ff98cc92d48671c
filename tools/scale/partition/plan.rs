//! Draws cells, seams, margins, cameras and Gaussians from above, as SVG; from the side too, if cells lie one above
//! another.

use super::cameras::Shares;
use ashsplat::Result;
use ashsplat::scene::{Bounds, Cells, Gaussians, Seam, without_strays};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_program::blocks::Division;
use ashsplat_program::html::COLORS;
use ashsplat_program::html::escape;
use ashsplat_program::progress::{significant, thousands};
use glam::{Vec2, Vec3};
use std::fmt::Write;

/// The longer side of the drawing, pixels.
const SIDE: f32 = 900.0;
const MARGIN: f32 = 30.0;
/// Least width, for the line of text above.
const LEAST_WIDTH: f32 = 360.0;
/// Least length on paper of a unit vector that is drawn as a direction.
const LEAST_DIRECTION: f32 = 0.1;
/// Approximate number of Gaussians that are drawn.
const DOTS: usize = 4000;

/// Projection from world to paper.
struct Plan {
    /// Axes to the right and downwards.
    axes: [usize; 2],
    /// True if the second axis points upwards.
    upwards: bool,
    min: Vec2,
    scale: f32,
    size: Vec2,
}

impl Plan {
    fn new(around: Bounds, axes: [usize; 2], upwards: bool) -> Plan {
        let flat = |point: Vec3| Vec2::new(point[axes[0]], point[axes[1]]);
        let (min, extent) = (flat(around.min), flat(around.size()).max(Vec2::splat(1e-6)));
        let (min, extent) = (min - 0.05 * extent, 1.1 * extent);
        let scale = SIDE / extent.max_element();
        Plan { axes, upwards, min, scale, size: scale * extent }
    }

    /// Views along the axis nearest to the cameras' common up and, if cells lie one above another, from the side.
    fn of(gaussians: &Gaussians, cameras: &[NamedCamera], seams: &[Seam]) -> Vec<Plan> {
        let up: Vec3 = cameras.iter().map(|named| -named.camera.camera_from_world.row(1)).sum();
        let down = (0..3).max_by(|&a, &b| up[a].abs().total_cmp(&up[b].abs())).unwrap_or(1);
        let flat = [(down + 1) % 3, (down + 2) % 3];
        let seen: Vec<Vec3> = cameras.iter().map(|named| named.camera.position()).collect();
        let seen = without_strays(&seen, |position| *position).into_iter();
        let middle = gaussians.statistics().central_bounds;
        let corners = middle.into_iter().flat_map(|bounds| [bounds.min, bounds.max]);
        let around = Bounds::of(seen.chain(corners)).unwrap_or(Bounds { min: Vec3::ZERO, max: Vec3::ONE });
        let across = |axis: usize| seams.iter().filter(|seam| seam.axis == axis).count();
        // Right, down and into the paper are three axes in the order x, y, z, x. If the third looks up, one of them is
        // flipped.
        let mut plans = vec![Plan::new(around, flat, up[down] > 0.0)];
        if across(down) > 0 {
            // The axis with most seams goes to the right: along the other one, cells would hide each other.
            let right = flat.into_iter().max_by_key(|&axis| across(axis)).unwrap_or(flat[0]);
            plans.push(Plan::new(around, [right, down], up[down] > 0.0));
        }
        plans
    }

    fn flat(&self, point: Vec3) -> Vec2 {
        let flat = self.scale * (Vec2::new(point[self.axes[0]], point[self.axes[1]]) - self.min);
        if self.upwards { Vec2::new(flat.x, self.size.y - flat.y) } else { flat }
    }

    /// A direction on the paper; it is short if it points into the paper.
    fn direction(&self, of: Vec3) -> Vec2 {
        let [right, other] = self.axes.map(|axis| of[axis]);
        Vec2::new(right, if self.upwards { -other } else { other })
    }

    /// True if a point is on the paper.
    fn shows(&self, point: Vec3) -> bool {
        let flat = self.flat(point);
        flat.cmpge(Vec2::ZERO).all() && flat.cmple(self.size).all()
    }

    fn at(&self, point: Vec3) -> Vec2 {
        self.flat(point).clamp(Vec2::ZERO, self.size) + MARGIN
    }

    fn width(&self) -> f32 {
        (self.size.x + 2.0 * MARGIN).max(LEAST_WIDTH)
    }

    fn names(&self) -> String {
        let [right, other] = self.axes.map(|axis| ["x", "y", "z"][axis]);
        let way = if self.upwards { "upwards" } else { "downwards" };
        format!("{right} to the right, {other} {way}")
    }
}

/// Contents of the drawing.
struct Drawn<'a> {
    division: &'a Division,
    cells: Cells,
    seams: Vec<Seam>,
    gaussians: &'a Gaussians,
    cameras: &'a [NamedCamera],
    shares: &'a Shares,
}

/// Draws the division as SVG.
pub fn svg(
    division: &Division,
    gaussians: &Gaussians,
    cameras: &[NamedCamera],
    shares: &Shares,
) -> Result<String> {
    let cells = division.cells()?;
    let seams = cells.seams();
    let plans = Plan::of(gaussians, cameras, &seams);
    let drawn = Drawn { division, cells, seams, gaussians, cameras, shares };
    let width: f32 = plans.iter().map(Plan::width).sum();
    let height = plans.iter().map(|plan| plan.size.y + 2.0 * MARGIN).fold(0.0, f32::max);
    let bottom = height + 20.0 * division.blocks.len() as f32;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.1} {bottom:.1}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width:.1}\" height=\"{bottom:.1}\" fill=\"#ffffff\"/>\n"
    );
    let mut left = 0.0;
    for plan in &plans {
        let _ = writeln!(
            out,
            "<g transform=\"translate({left:.1} 0)\"><text x=\"{MARGIN}\" y=\"20\">{}; margin {}; lines: seams</text>",
            plan.names(),
            significant(division.margin)
        );
        drawn.on(plan, &mut out);
        out.push_str("</g>\n");
        left += plan.width();
    }
    for (index, block) in division.blocks.iter().enumerate() {
        let y = height + 20.0 * index as f32;
        let _ = writeln!(
            out,
            "<rect x=\"{MARGIN}\" y=\"{:.1}\" width=\"12\" height=\"12\" fill=\"{}\"/><text x=\"{}\" y=\"{:.1}\">block {}: {} \
             Gaussians, {} with the margin; {} photos, {} held out</text>",
            y - 10.0,
            color(index),
            MARGIN + 20.0,
            y,
            block.number,
            thousands(block.gaussians),
            thousands(block.trained),
            block.photos.len(),
            block.held_out.len()
        );
    }
    out.push_str("</svg>\n");
    Ok(out)
}

impl Drawn<'_> {
    fn on(&self, plan: &Plan, out: &mut String) {
        for (index, cell) in self.cells.bounds().iter().enumerate() {
            let (a, b) = (plan.at(cell.min), plan.at(cell.max));
            rectangle(out, a, b, &format!("fill=\"{}\" fill-opacity=\"0.13\"", color(index)));
        }
        let step = self.gaussians.len().div_ceil(DOTS).max(1);
        for (place, cell) in self.gaussians.means.iter().step_by(step).filter_map(|&mean| {
            let mean = Vec3::from_array(mean);
            plan.shows(mean).then(|| Some((plan.at(mean), self.cells.at(mean)?)))?
        }) {
            let _ = writeln!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"0.9\" fill=\"{}\"/>",
                place.x,
                place.y,
                color(cell)
            );
        }
        for seam in self.seams.iter().filter(|seam| plan.axes.contains(&seam.axis)) {
            let margin = Vec3::from_array(
                [0, 1, 2].map(|axis| if axis == seam.axis { self.division.margin_in_world() } else { 0.0 }),
            );
            let (a, b) = (plan.at(seam.bounds.min - margin), plan.at(seam.bounds.max + margin));
            rectangle(out, a, b, "fill=\"#000000\" fill-opacity=\"0.08\"");
            let (a, b) = (plan.at(seam.bounds.min), plan.at(seam.bounds.max));
            let style = "stroke=\"#222222\" stroke-width=\"1.5\"";
            let _ = writeln!(out, "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" {style}/>", a.x, a.y, b.x, b.y);
        }
        for (index, named) in self.cameras.iter().enumerate() {
            self.camera(plan, (index, named), out);
        }
    }

    fn camera(
        &self,
        plan: &Plan,
        (index, NamedCamera { name, camera }): (usize, &NamedCamera),
        out: &mut String,
    ) {
        let place = plan.at(camera.position());
        let look = plan.direction(camera.forward());
        let fill = self.shares.main_cell(index).map_or("#ffffff", color);
        let blocks = self.division.blocks.iter();
        let of: Vec<String> = blocks
            .filter(|block| block.photos.contains(name) || block.held_out.contains(name))
            .map(|block| block.number.to_string())
            .collect();
        // A camera that looks along the line of sight has no direction here.
        let (element, shape) = if look.length() < LEAST_DIRECTION {
            ("circle", format!("cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\"", place.x, place.y))
        } else {
            let look = look.normalize();
            let (tip, side) = (place + 9.0 * look, 3.5 * look.perp());
            let (a, b) = (place + side, place - side);
            let path =
                format!("d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\"", a.x, a.y, b.x, b.y, tip.x, tip.y);
            ("path", path)
        };
        let _ = writeln!(
            out,
            "<{element} {shape} fill=\"{fill}\" stroke=\"#222222\" stroke-width=\"0.6\"><title>{}: {}</title></{element}>",
            escape(name),
            of.join(", ")
        );
    }
}

fn color(block: usize) -> &'static str {
    COLORS[1 + block % (COLORS.len() - 1)]
}

fn rectangle(out: &mut String, a: Vec2, b: Vec2, style: &str) {
    let (min, size) = (a.min(b), (b - a).abs());
    let _ = writeln!(
        out,
        "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" {style}/>",
        min.x, min.y, size.x, size.y
    );
}
