//! Edits of a scene: which of its Gaussians are selected, hidden or deleted, with undo. No file changes; a page exports the result.

use super::protocol::{Edit, Region, SelectionOp};
use ashsplat::scene::{Camera, Gaussians, NEAR_PLANE};
use ashsplat::{Error, Result};
use glam::Vec3;
use serde_json::{Value, json};
use std::collections::VecDeque;

/// Most points of a lasso or a brush stroke.
const MAX_POINTS: usize = 1024;
/// Largest radius of a brush, pixels.
const LARGEST_BRUSH: f32 = 512.0;
/// Farthest point from the picture's corner, pixels: products of two stay exact enough.
const FARTHEST_POINT: f32 = 65536.0;
/// Most edits that can be undone. Each takes a bit per Gaussian.
const MAX_STEPS: usize = 64;

/// States of a Gaussian, at most one at a time.
const SELECTED: u8 = 1;
const HIDDEN: u8 = 2;
const DELETED: u8 = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GaussianSet {
    /// All that are neither hidden nor deleted.
    #[default]
    Visible,
    Selection,
}

pub struct Edits {
    all: Gaussians,
    states: Vec<u8>,
    done: VecDeque<Step>,
    undone: Vec<Step>,
    revision: u64,
    /// Figures for the pages: numbers of Gaussians that are `selected`, `hidden` and `deleted`, steps to `undo` and `redo`, and the
    /// `revision`, a number that each edit raises.
    pub figures: Value,
}

/// An edit that can be undone: these bits of these Gaussians' states were flipped.
struct Step {
    bits: u8,
    /// A bit per Gaussian.
    changed: Vec<u32>,
}

impl Edits {
    pub fn of(all: Gaussians) -> Edits {
        let states = vec![0; all.len()];
        Edits { all, states, done: VecDeque::new(), undone: Vec::new(), revision: 0, figures: Value::Null }
    }

    /// Applies an edit. True if other Gaussians are drawn than before.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid region, and if there is nothing to hide, show, delete, undo or redo.
    pub fn apply(&mut self, edit: &Edit) -> Result<bool> {
        let redraws = self.act(edit)?;
        self.revision += 1;
        self.figures = json!({
            "selected": self.count(SELECTED), "hidden": self.hidden(), "deleted": self.count(DELETED),
            "undo": self.done.len(), "redo": self.undone.len(), "revision": self.revision,
        });
        Ok(redraws)
    }

    /// Takes back the edit that was applied last.
    pub fn take_back(&mut self, edit: &Edit) -> Result<()> {
        self.apply(if matches!(edit, Edit::Undo) { &Edit::Redo } else { &Edit::Undo }).map(drop)
    }

    pub fn hidden(&self) -> usize {
        self.count(HIDDEN)
    }

    fn count(&self, state: u8) -> usize {
        self.states.iter().filter(|own| **own == state).count()
    }

    fn act(&mut self, edit: &Edit) -> Result<bool> {
        let none = |what: &str| Error::argument("edit", format!("nothing is {what}"));
        match edit {
            Edit::Select { region, how, cut } => {
                let cut = cut.cut();
                cut.check()?;
                let (limits, contains) = (cut.limits(), region.test()?);
                let flips = |all: &Gaussians, index: usize, state: u8| {
                    let inside =
                        || limits.keeps(all, index) && contains(index, Vec3::from_array(all.means[index]));
                    match (state, how) {
                        (0, SelectionOp::Remove) => false,
                        (SELECTED, SelectionOp::Add) => false,
                        (SELECTED, SelectionOp::Set) => !inside(),
                        (0 | SELECTED, _) => inside(),
                        _ => false,
                    }
                };
                self.flip(SELECTED, flips);
                Ok(false)
            }
            Edit::Hide | Edit::Delete => {
                let other = if matches!(edit, Edit::Hide) { HIDDEN } else { DELETED };
                let flipped = self.flip(SELECTED | other, |_, _, state| state == SELECTED);
                if flipped { Ok(true) } else { Err(none("selected")) }
            }
            Edit::Show => {
                let flipped = self.flip(HIDDEN, |_, _, state| state == HIDDEN);
                if flipped { Ok(true) } else { Err(none("hidden")) }
            }
            Edit::Undo => {
                let step = self.done.pop_back().ok_or_else(|| none("left to undo"))?;
                let redraws = self.repeat(&step);
                self.undone.push(step);
                Ok(redraws)
            }
            Edit::Redo => {
                let step = self.undone.pop().ok_or_else(|| none("left to redo"))?;
                let redraws = self.repeat(&step);
                self.done.push_back(step);
                Ok(redraws)
            }
        }
    }

    /// Flips bits of the Gaussians for which `flips` is true (all, index, state). False if there are none.
    fn flip(&mut self, bits: u8, flips: impl Fn(&Gaussians, usize, u8) -> bool) -> bool {
        let mut changed = vec![0u32; self.states.len().div_ceil(32)];
        for (index, &state) in self.states.iter().enumerate() {
            changed[index / 32] |= u32::from(flips(&self.all, index, state)) << (index % 32);
        }
        if changed.iter().all(|word| *word == 0) {
            return false;
        }
        let step = Step { bits, changed };
        self.repeat(&step);
        self.undone.clear();
        self.done.push_back(step);
        if self.done.len() > MAX_STEPS {
            self.done.pop_front();
        }
        true
    }

    /// Flips a step's bits, which does or undoes it. True if other Gaussians are drawn than before.
    fn repeat(&mut self, step: &Step) -> bool {
        for (index, state) in self.states.iter_mut().enumerate() {
            if step.changed[index / 32] >> (index % 32) & 1 != 0 {
                *state ^= step.bits;
            }
        }
        step.bits & (HIDDEN | DELETED) != 0
    }

    /// Indices of the Gaussians that are drawn, in their order.
    pub fn drawn(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.states.len()).filter(|&index| self.states[index] & (HIDDEN | DELETED) == 0)
    }

    /// A bit per drawn Gaussian: selected or not. None without a selection.
    pub fn mask(&self) -> Option<Vec<u32>> {
        let mut mask = Vec::new();
        for (place, index) in self.drawn().enumerate() {
            mask.resize(place / 32 + 1, 0u32);
            mask[place / 32] |= u32::from(self.states[index] == SELECTED) << (place % 32);
        }
        mask.iter().any(|word| *word != 0).then_some(mask)
    }

    /// # Errors
    /// [`Error::Argument`] for a selection of nothing.
    pub fn part(&self, part: GaussianSet) -> Result<Gaussians> {
        let of_part = |index: &usize| part == GaussianSet::Visible || self.states[*index] == SELECTED;
        let indices: Vec<usize> = self.drawn().filter(of_part).collect();
        if indices.is_empty() && part == GaussianSet::Selection {
            return Err(Error::argument("part", "nothing is selected"));
        }
        Ok(self.all.select(&indices))
    }
}

impl Region {
    /// Checks the region. The answer says whether a Gaussian of an index and a mean lies inside.
    fn test(&self) -> Result<Box<dyn Fn(usize, Vec3) -> bool>> {
        let bad = |field: &str, problem: String| Err(Error::argument(format!("region.{field}"), problem));
        let (camera, points, radius) = match self {
            Region::All => return Ok(Box::new(|_, _| true)),
            Region::Range { first, count } => {
                let range = *first..first.saturating_add(*count);
                return Ok(Box::new(move |index, _| range.contains(&index)));
            }
            Region::Sphere { center, radius } => {
                let (center, radius) = (Vec3::from_array(*center), *radius);
                if !(center.is_finite() && radius.is_finite() && radius > 0.0) {
                    return bad("sphere", "has no finite centre or no positive radius".into());
                }
                return Ok(Box::new(move |_, mean| mean.distance_squared(center) <= radius * radius));
            }
            Region::Lasso { camera, points } => (camera, points, None),
            Region::Brush { camera, points, radius } => (camera, points, Some(*radius)),
        };
        let camera = camera.camera()?;
        if points.is_empty() || points.len() > MAX_POINTS {
            return bad("points", format!("{} of them; 1 to {MAX_POINTS} are taken", points.len()));
        }
        // False for NaN.
        let is_near = |point: &[f32; 2]| point.iter().all(|value| value.abs() <= FARTHEST_POINT);
        if !points.iter().all(is_near) {
            return bad("points", format!("must lie within {FARTHEST_POINT} pixels"));
        }
        if let Some(radius) = radius
            && !(radius > 0.0 && radius <= LARGEST_BRUSH)
        {
            return bad("radius", format!("{radius} is not above 0 and at most {LARGEST_BRUSH} pixels"));
        }
        let mut stencil = Stencil::new(&camera);
        match radius {
            None => stencil.fill(points),
            Some(radius) => stencil.stroke(points, radius),
        }
        Ok(Box::new(move |_, mean| {
            let (x, y, depth) = camera.project(mean);
            depth > NEAR_PLANE && stencil.has(x, y)
        }))
    }
}

/// Marked pixels of a picture: a mean is then tested in constant time, whatever the number of points.
struct Stencil {
    width: usize,
    height: usize,
    marked: Vec<bool>,
}

impl Stencil {
    fn new(camera: &Camera) -> Stencil {
        let (width, height) = (camera.width as usize, camera.height as usize);
        Stencil { width, height, marked: vec![false; width * height] }
    }

    fn has(&self, x: f32, y: f32) -> bool {
        // False for NaN.
        let inside = (0.0..self.width as f32).contains(&x) && (0.0..self.height as f32).contains(&y);
        inside && self.marked[y as usize * self.width + x as usize]
    }

    /// Rows with centres from `low` to `high`.
    fn rows(&self, low: f32, high: f32) -> std::ops::Range<usize> {
        first_center(low, self.height)..first_center(high, self.height)
    }

    /// Marks the pixels of a row with centres from `from` to `to`.
    fn mark(&mut self, row: usize, from: f32, to: f32) {
        let (first, end) = (first_center(from, self.width), first_center(to, self.width));
        self.marked[row * self.width + first.min(end)..row * self.width + end].fill(true);
    }

    /// Marks the pixels with centres inside a polygon (even-odd).
    fn fill(&mut self, corners: &[[f32; 2]]) {
        let heights = || corners.iter().map(|corner| corner[1]);
        let (low, high) = (heights().fold(f32::INFINITY, f32::min), heights().fold(0.0, f32::max));
        let next = corners.iter().cycle().skip(1);
        let sides: Vec<_> = corners.iter().zip(next).collect();
        for row in self.rows(low, high) {
            let y = row as f32 + 0.5;
            let crossed = sides.iter().filter(|(a, b)| (a[1] <= y) != (b[1] <= y));
            let mut crossings: Vec<f32> =
                crossed.map(|(a, b)| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])).collect();
            crossings.sort_unstable_by(f32::total_cmp);
            for pair in crossings.chunks_exact(2) {
                self.mark(row, pair[0], pair[1]);
            }
        }
    }

    /// Marks the pixels with centres at most `radius` from a line.
    fn stroke(&mut self, points: &[[f32; 2]], radius: f32) {
        for &[x, y] in points {
            for row in self.rows(y - radius, y + radius) {
                let up = row as f32 + 0.5 - y;
                let half = (radius * radius - up * up).max(0.0).sqrt();
                self.mark(row, x - half, x + half);
            }
        }
        for pair in points.windows(2) {
            let [[ax, ay], [bx, by]] = [pair[0], pair[1]];
            let length = (bx - ax).hypot(by - ay);
            if length > 0.0 {
                let (x, y) = ((by - ay) / length * radius, (ax - bx) / length * radius);
                self.fill(&[[ax + x, ay + y], [bx + x, by + y], [bx - x, by - y], [ax - x, ay - y]]);
            }
        }
    }
}

/// The first of `count` pixels whose centre is not before a place.
fn first_center(place: f32, count: usize) -> usize {
    // The cast clamps.
    ((place - 0.5).ceil() as usize).min(count)
}
