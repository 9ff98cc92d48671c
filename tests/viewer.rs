//! `ashsplat view` and `train --view`, with a client that acts like the page, without a browser.

mod cuts;
mod edits;
mod films;
mod frames;
mod http;
mod opening;
mod shapes;
mod training;
mod trees;
#[allow(dead_code)]
use crate::cli::{TestFolder, point_cloud, text, wait_until, write_dataset};
use crate::common::engine::renderer;
pub use crate::program::page::*;
use ashsplat::scene::{Camera, WorldFrame};
use ashsplat::{Gaussians, RenderSettings};
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::{Photo, cameras_json};
use glam::Vec3;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// A viewer of a ball, and its folder.
fn view_ball(count: usize, more: &[&str]) -> (TestFolder, Server) {
    let place = TestFolder::empty();
    let server = Server::view(&write_ball(&place.at(""), count), more);
    (place, server)
}

/// Picture that the library renders, RGB.
fn rendered(gaussians: &Gaussians, camera: &Camera, settings: &RenderSettings) -> Vec<u8> {
    let mut renderer = renderer();
    renderer.upload(gaussians).expect("uploaded");
    let frame = renderer.render(camera, settings).expect("a frame");
    Photo::from_f32(frame.width, frame.height, &frame.color).expect("a picture").rgb
}

fn json_body(server: &Server, path: &str) -> Value {
    serde_json::from_slice(&server.get(path, &[]).2).expect("JSON")
}

fn mean_difference(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
}
