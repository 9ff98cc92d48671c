//! Photographs: decoded by rows where possible, and detected if truncated.

use super::memory::peak_mib;
use super::{alone, assert_linear};
use crate::HostMemory;
use crate::images::{Photo, PhotoFileFormat, Request, read_as};
use image::DynamicImage;
use image::imageops::{FilterType, resize};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::io::Write;
use std::path::Path;

fn noise(index: u32) -> u8 {
    (index.wrapping_mul(2_654_435_761) >> 23) as u8
}

/// A picture with random values of r, g, b and alpha.
fn picture(width: u32, height: u32) -> DynamicImage {
    let values = (0..4 * width * height).map(noise).collect();
    DynamicImage::from(image::RgbaImage::from_raw(width, height, values).unwrap())
}

/// Scaling during decoding gives the bits of the crate `image` for the whole picture, in every colour type.
#[test]
fn rows_have_the_bits_of_whole_photos() {
    let (_turn, _folder, path) = alone("a.png");
    let memory = HostMemory::default();
    let small = picture(5, 1);
    let all = picture(61, 47);
    let kinds: [(&str, DynamicImage); 11] = [
        ("png", all.to_luma8().into()),
        ("png", all.to_luma_alpha8().into()),
        ("png", all.to_rgb8().into()),
        ("png", all.clone()),
        ("png", all.to_luma16().into()),
        ("png", all.to_luma_alpha16().into()),
        ("png", all.to_rgb16().into()),
        ("png", all.to_rgba16().into()),
        ("jpeg", all.to_rgb8().into()),
        ("jpeg", all.to_luma8().into()),
        ("png", small.to_rgb8().into()),
    ];
    for (index, (kind, image)) in kinds.into_iter().enumerate() {
        image.save_with_format(&path, image::ImageFormat::from_extension(kind).unwrap()).unwrap();
        let plain = Request::plain(Some([0.3, 0.6, 1.0]), &memory);
        let whole = read_as(&path, &plain).unwrap();
        if kind == "png" && !image.color().has_alpha() {
            assert_eq!(whole.photo.rgb, image.to_rgb8().into_raw(), "kind {index}");
        }
        assert_eq!(whole.alpha.is_some(), image.color().has_alpha());
        let size = (image.width(), image.height());
        let rgb = image::RgbImage::from_raw(size.0, size.1, whole.photo.rgb.clone()).unwrap();
        for (width, height) in [(61, 47), (30, 23), (7, 5), (100, 80), (1, 70), (122, 1), (1, 1)] {
            let request = Request { scaled: Some((width, height)), size: Some(size), ..plain };
            let scaled = read_as(&path, &request).unwrap();
            let expected = resize(&rgb, width, height, FilterType::CatmullRom).into_raw();
            assert!(scaled.photo.rgb == expected, "{index}, {width}x{height}");
            assert!(scaled.alpha == whole.alpha);
            assert_eq!(whole.photo.clone().scaled_to(width, height).unwrap(), scaled.photo);
        }
    }
}

/// Scaling down a large PNG keeps only a few rows in memory, within the forecast.
#[test]
fn large_photos_that_are_scaled_down_take_little_memory() {
    let (_turn, _folder, path) = alone("a.png");
    let (width, height) = (6000, 4000);
    let rgb = (0..width * height).flat_map(|i| [(i % width / 24) as u8, (i / width / 16) as u8, 9]).collect();
    Photo { width, height, rgb }.write_png(&path).unwrap();
    let memory = HostMemory::new(6 << 20);
    let plain = Request::plain(Some([0.0; 3]), &memory);
    assert!(read_as(&path, &plain).is_err());
    let read = |scaled| read_as(&path, &Request { scaled: Some(scaled), ..plain }).unwrap().photo;
    read((60, 40));
    // The whole picture has 69 MiB.
    let peak = peak_mib(|| assert_eq!(read((600, 400)).rgb.len(), 720_000));
    assert!(peak <= 6, "{peak} MiB");
}

fn jpeg(width: u16, height: u16, kind: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 90);
    encoder.set_sampling_factor(if kind == "4:2:0" { SamplingFactor::F_2_2 } else { SamplingFactor::F_1_1 });
    encoder.set_optimized_huffman_tables(kind == "own tables");
    if kind == "restarts" {
        encoder.set_restart_interval(3);
    }
    encoder.set_progressive(kind == "passes");
    let grey = kind == "grey";
    let pixels = u32::from(width) * u32::from(height);
    let values: Vec<u8> = (0..if grey { pixels } else { 3 * pixels }).map(noise).collect();
    encoder.encode(&values, width, height, if grey { ColorType::Luma } else { ColorType::Rgb }).unwrap();
    bytes
}

fn is_read(path: &Path, bytes: &[u8]) -> bool {
    std::fs::write(path, bytes).unwrap();
    is_whole(path)
}

fn is_whole(path: &Path) -> bool {
    let read = Photo::read(path, [0.0; 3]).map_err(|error| error.to_string());
    assert!(
        read.as_ref().is_ok_and(|photo| !photo.rgb.is_empty())
            || read.unwrap_err().contains("cannot be decoded")
    );
    Photo::read(path, [0.0; 3]).is_ok()
}

/// Whole and scaled down, in every form; width and height grow in turn.
#[test]
fn photos_of_every_form() {
    for kind in ["png", "plain", "4:2:0", "own tables", "restarts", "grey", "passes"] {
        for scaled in [None, Some((40, 30))] {
            let write = |folder: &Path, size: usize| {
                let (width, height) = (2 * size as u32, 100);
                let path = folder.join("a");
                if kind == "png" {
                    let rgb = (0..3 * width * height).map(noise).collect();
                    return Photo { width, height, rgb }.write_png(path).unwrap();
                }
                std::fs::write(path, jpeg(width as u16, height as u16, kind)).unwrap();
            };
            let memory = HostMemory::default();
            assert_linear(200, write, |folder| {
                let request = Request { scaled, ..Request::plain(Some([0.0; 3]), &memory) };
                read_as(&folder.join("a"), &request).unwrap();
            });
        }
    }
}

/// Empty segments, fill bytes, and bytes between segments.
#[test]
fn jpegs_of_many_parts() {
    let comment = [0xff, 0xfe, 0, 3, 7];
    let parts: [&[u8]; 3] = [&comment, &[0xff], &[7]];
    for part in parts {
        let write = |folder: &Path, size: usize| {
            let whole = jpeg(16, 16, "plain");
            // Inserted after the first segment.
            let (start, rest) = whole.split_at(4 + usize::from(u16::from_be_bytes([whole[4], whole[5]])));
            std::fs::write(folder.join("a.jpg"), [start, &part.repeat(size), rest].concat()).unwrap();
        };
        // Accepted or refused, as the decoder decides.
        assert_linear(20_000, write, |folder| {
            is_whole(&folder.join("a.jpg"));
        });
    }
}

/// Each pass covers the whole picture, so the work for many passes would be quadratic.
#[test]
fn jpegs_of_many_passes_are_refused() {
    let (_turn, _folder, path) = alone("a.jpg");
    let whole = jpeg(64, 64, "passes");
    let scan = whole.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap();
    let (before, last) = whole[..whole.len() - 2].split_at(scan);
    let of = |passes: usize| [before, &last.repeat(passes), &[0xff, 0xd9]].concat();
    assert!(is_read(&path, &of(2)));
    assert!(!is_read(&path, &of(200)));
}

/// Ignored chunks, and data of one byte each.
#[test]
fn pngs_of_many_chunks() {
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = flate2::Crc::new();
        crc.update(&[kind, data].concat());
        [&(data.len() as u32).to_be_bytes(), &kind[..], data, &crc.sum().to_be_bytes()].concat()
    };
    let header = |width: u32, height: u32| {
        let size = [width.to_be_bytes(), height.to_be_bytes()].concat();
        [b"\x89PNG\r\n\x1a\n", &chunk(b"IHDR", &[&size[..], &[8, 0, 0, 0, 0]].concat())[..]].concat()
    };
    let packed = |data: &[u8]| {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::none());
        encoder.write_all(data).unwrap();
        encoder.finish().unwrap()
    };
    let texts = |size: usize| {
        let data = chunk(b"IDAT", &packed(&[0; 9 * 8]));
        [header(8, 8), chunk(b"tEXt", b"a\0b").repeat(size), data, chunk(b"IEND", b"")].concat()
    };
    let small = |size: usize| {
        let rows: Vec<u8> = packed(&vec![0; 9 * size]).iter().flat_map(|&b| chunk(b"IDAT", &[b])).collect();
        [header(8, size as u32), rows, chunk(b"IEND", b"")].concat()
    };
    for png in [&texts as &dyn Fn(usize) -> Vec<u8>, &small] {
        let write = |folder: &Path, size: usize| std::fs::write(folder.join("a.png"), png(size)).unwrap();
        assert_linear(2000, write, |folder| {
            Photo::read(folder.join("a.png"), [0.0; 3]).unwrap();
        });
    }
}

/// An end marker after half of the data does not make it complete: an aborted transfer may write one.
#[test]
fn jpegs_cut_short_before_an_end_marker_are_found() {
    let (_turn, _folder, path) = alone("a.jpg");
    for kind in ["plain", "4:2:0", "own tables", "restarts", "grey", "passes"] {
        for (width, height) in [(8, 8), (33, 17), (96, 64)] {
            let whole = jpeg(width, height, kind);
            assert!(is_read(&path, &whole), "{kind} {width}x{height}");
            // Cameras leave a preview behind the end.
            assert!(is_read(&path, &[&whole[..], b"\0\0\0 a preview"].concat()), "{kind}");
            let scan = whole.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap();
            let data = scan + 2 + usize::from(u16::from_be_bytes([whole[scan + 2], whole[scan + 3]]));
            let end = whole.len() - 2;
            // Some bits of the last byte may be padding.
            let cuts = (data..end - 1).step_by(1 + (end - data) / 60).chain([end - 2, end - 3]);
            for cut in cuts.filter(|&cut| cut >= data && whole[cut - 1] != 0xff) {
                let short = [&whole[..cut], &[0xff, 0xd9]].concat();
                assert!(!is_read(&path, &short), "{kind} {width}x{height}: {cut} of {end}");
            }
        }
    }
}
