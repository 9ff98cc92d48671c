//! A tiny engine that draws a wooden crate and lends ashsplat its command buffer: how to embed.
//!
//!     cargo run --release --example embed -- FOLDER
//!
//! `guest.rs` is the part that a host engine writes; the other files are what it has already. It lights and blends in linear
//! light, with a tone curve at the end, as engines do.

#![allow(unsafe_code)]

mod allocator;
mod guest;
mod host;
mod memory;
mod messages;
mod passes;

use std::path::PathBuf;
use std::process::ExitCode;

fn main() -> ExitCode {
    let folder = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("."), PathBuf::from);
    let validation = ashsplat::vk::validation_available();
    let options = host::HostOptions { validation, ..Default::default() };
    let drawn = std::fs::create_dir_all(&folder)
        .map_err(|error| format!("{}: {error}", folder.display()).into())
        .and_then(|()| guest::pictures(&folder, &options));
    match drawn {
        Ok(report) => {
            println!("{}", ashsplat::vk::Context::requirements());
            report.iter().for_each(|line| println!("{line}"));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}
