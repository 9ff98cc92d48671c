//! A page's cut of the scene, and the same cut as options of `ashsplat convert`.

use ashsplat::RenderSettings;
use ashsplat::scene::{Bounds, Cut, WorldFrame};
use glam::Vec3;
use serde::Deserialize;

/// A page's cut as JSON: see [`Cut`].
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct CutMessage {
    pub min_opacity: Option<f32>,
    pub min_density: Option<f32>,
    /// Sides of the box; none for an open side.
    pub low: [Option<f32>; 3],
    pub high: [Option<f32>; 3],
}

impl CutMessage {
    pub fn cut(&self) -> Cut {
        let boxed = self.low.iter().chain(&self.high).any(Option::is_some);
        let side = |values: [Option<f32>; 3], none: f32| Vec3::from_array(values.map(|v| v.unwrap_or(none)));
        let bounds = Bounds::between(side(self.low, f32::NEG_INFINITY), side(self.high, f32::INFINITY));
        Cut {
            min_opacity: self.min_opacity.unwrap_or_default(),
            min_density: self.min_density.unwrap_or_default(),
            bounds: boxed.then_some(bounds),
        }
    }
}

/// Options of `ashsplat convert` that make the same cut and keep the same SH degree. In the default frame, `convert` parses the
/// numbers to the same bits.
pub fn options(settings: &RenderSettings, frame: &WorldFrame) -> String {
    let Cut { min_opacity, min_density, bounds } = settings.cut;
    // The decimal number that single precision prints.
    let decimal = |v: f32| v.to_string().parse::<f64>().unwrap_or_else(|_| v.into());
    let mut terms = Vec::new();
    if let Some(degree) = settings.sh_degree {
        terms.push(format!("--sh-degree {degree}"));
    }
    if min_opacity > 0.0 {
        terms.push(format!("--min-opacity {min_opacity}"));
    }
    if min_density > 0.0 {
        terms.push(format!("--min-density {}", min_density / frame.unit as f32));
    }
    if let Some(Bounds { min, max }) = bounds {
        let source = |axis: usize, v: f32| (frame.origin[axis] + frame.unit * decimal(v)).to_string();
        let corner = |corner: Vec3| [0, 1, 2].map(|axis| source(axis, corner[axis]));
        let sides = [corner(min), corner(max)].concat();
        terms.push(format!("--crop-box={}", sides.join(",")));
    }
    terms.join(" ")
}

/// The same cut as an address's query: `min_opacity=X&min_density=X&low=X,X,X&high=X,X,X&sh_degree=N`. An open side is empty.
pub fn query(settings: &RenderSettings) -> String {
    let Cut { min_opacity, min_density, bounds } = settings.cut;
    let mut terms = vec![format!("min_opacity={min_opacity}&min_density={min_density}")];
    if let Some(Bounds { min, max }) = bounds {
        let side = |v: &f32| if v.is_finite() { v.to_string() } else { String::new() };
        let sides = |corner: Vec3| corner.to_array().iter().map(side).collect::<Vec<_>>().join(",");
        terms.push(format!("low={}&high={}", sides(min), sides(max)));
    }
    terms.extend(settings.sh_degree.map(|degree| format!("sh_degree={degree}")));
    terms.join("&")
}
