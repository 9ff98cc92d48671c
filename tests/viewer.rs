//! `ashsplat view` and `train --view`, with a client that acts like the page, without a browser.

mod cuts;
mod films;
mod frames;
mod http;
mod lights;
mod opening;
mod shapes;
mod sibr;
mod siege;
mod training;
mod trees;
#[allow(dead_code)]
mod window;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use ashsplat::scene::Camera;
use ashsplat_files::splats::{self, WriteOptions};
use serde_json::{Value, json};
use tungstenite::Message;

use crate::cli::text;
pub use crate::program::page::*;
