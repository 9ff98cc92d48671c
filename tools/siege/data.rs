//! Generated data to train on and to show.

use crate::siege::Result;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// Number of photos in the small data set, and their size in pixels.
const VIEWS: u32 = 9;
const SIZE: [u32; 2] = [48, 32];
const FOCAL: f64 = 57.0;
/// Distance of the wall.
const DISTANCE: f64 = 2.5;

/// A COLMAP model of a coloured wall, photographed from nine positions; a formula gives every pixel.
pub fn write_small(folder: &Path) -> Result<()> {
    let (images, model) = (folder.join("images"), folder.join("sparse/0"));
    std::fs::create_dir_all(&images)?;
    std::fs::create_dir_all(&model)?;
    let [width, height] = SIZE;
    let lens = format!("1 PINHOLE {width} {height} {FOCAL} {FOCAL} {} {}\n", width / 2, height / 2);
    std::fs::write(model.join("cameras.txt"), lens)?;
    let mut poses = String::new();
    for view in 0..VIEWS {
        let eye = [f64::from(view) / f64::from(VIEWS - 1) - 0.5, 0.2 * f64::from(view % 3)];
        image::RgbImage::from_fn(width, height, |x, y| {
            let along =
                |pixel: u32, size: u32| (f64::from(pixel) + 0.5 - f64::from(size) / 2.0) * DISTANCE / FOCAL;
            image::Rgb(color(eye[0] + along(x, width), eye[1] + along(y, height)))
        })
        .save(images.join(format!("{view}.png")))?;
        writeln!(poses, "{} 1 0 0 0 {} {} {DISTANCE} 1 {view}.png\n", view + 1, -eye[0], -eye[1])?;
    }
    std::fs::write(model.join("images.txt"), poses)?;
    let mut points = String::new();
    for index in 0..400 {
        let [x, y] = [index % 20, index / 20].map(|place| f64::from(place) / 9.5 - 1.0);
        let [r, g, b] = color(x, y);
        writeln!(points, "{} {x} {y} 0 {r} {g} {b} 0.5", index + 1)?;
    }
    std::fs::write(model.join("points3D.txt"), points)?;
    Ok(())
}

fn color(x: f64, y: f64) -> [u8; 3] {
    let wave = |phase: f64| (127.5 + 120.0 * phase.sin()) as u8;
    [wave(5.0 * x), wave(4.0 * y + 1.0), wave(3.0 * (x + y))]
}

/// A data set of `count` square photos side by side, `size` pixels wide; on disk they are one file.
pub fn write_large(folder: &Path, count: u32, size: u32) -> Result<()> {
    let images = folder.join("images");
    std::fs::create_dir_all(&images)?;
    let first = images.join("0.png");
    image::RgbImage::from_pixel(size, size, image::Rgb([90, 120, 150])).save(&first)?;
    let names: Vec<String> = (0..count).map(|index| format!("images/{index}.png")).collect();
    for name in &names[1..] {
        std::fs::hard_link(&first, folder.join(name))?;
    }
    let frame = |(index, name): (usize, &String)| {
        let x = 0.1 * index as f64;
        let pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
        json!({ "file_path": name, "transform_matrix": pose })
    };
    let frames: Vec<Value> = names.iter().enumerate().map(frame).collect();
    let [focal, middle] = [f64::from(size), f64::from(size) / 2.0];
    let lens = json!({
        "w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": middle, "cy": middle, "frames": frames,
    });
    std::fs::write(folder.join("transforms.json"), lens.to_string())?;
    Ok(())
}
