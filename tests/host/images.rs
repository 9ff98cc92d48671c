//! Photographs: colour types, sizes, damage.

use super::files::{Folder, assert_says, for_each_truncation, names, refusal};
use ashsplat_files::images::photo_size;
use ashsplat_files::{Photo, PhotoFileFormat, Resolution};
use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb, Rgba};
use std::path::Path;

const BLACK: [f32; 3] = [0.0; 3];

fn gradient(width: u32, height: u32) -> Photo {
    let pixel = |i: u32| [(i % width * 3) as u8, (i / width * 5) as u8, 77];
    Photo { width, height, rgb: (0..width * height).flat_map(pixel).collect() }
}

fn error(path: &Path) -> String {
    refusal(path, Photo::read(path, BLACK))
}

#[test]
fn png_round_trip() {
    let (folder, path) = Folder::with("a.png");
    let photo = gradient(17, 9);
    photo.write_png(&path).unwrap();
    assert_eq!(Photo::read(&path, BLACK).unwrap(), photo);
    assert_eq!(photo_size(&path).unwrap(), (17, 9));
    assert_eq!(names(&folder), ["a.png"]);
    let bad = Photo { width: 18, ..photo };
    assert!(bad.write_png(&path).is_err() && bad.scaled_to(3, 3).is_err());
}

#[test]
fn every_colour_type_is_read() {
    let (_folder, path) = Folder::with("a.png");
    let white = [1.0; 3];
    let cases: [(DynamicImage, [f32; 3], [u8; 3]); 9] = [
        (ImageBuffer::from_pixel(2, 2, Luma([40u8])).into(), BLACK, [40; 3]),
        (ImageBuffer::from_pixel(2, 2, Luma([40u16 * 257])).into(), BLACK, [40; 3]),
        (ImageBuffer::from_pixel(2, 2, Rgb([257u16, 2 * 257, 65535])).into(), BLACK, [1, 2, 255]),
        (ImageBuffer::from_pixel(2, 2, Rgba([10u8, 20, 30, 255])).into(), white, [10, 20, 30]),
        (ImageBuffer::from_pixel(2, 2, Rgba([10u8, 20, 30, 0])).into(), white, [255; 3]),
        (ImageBuffer::from_pixel(2, 2, Rgba([10u8, 20, 30, 0])).into(), BLACK, [0; 3]),
        (ImageBuffer::from_pixel(2, 2, Rgba([100u8, 0, 200, 51])).into(), [1.0, 0.5, 0.0], [224, 102, 40]),
        (ImageBuffer::from_pixel(2, 2, LumaA([100u8, 51])).into(), white, [224; 3]),
        (ImageBuffer::from_pixel(2, 2, Rgba([100u16 * 257, 0, 0, 51 * 257])).into(), BLACK, [20, 0, 0]),
    ];
    for (index, (image, background, expected)) in cases.into_iter().enumerate() {
        image.save(&path).unwrap();
        let photo = Photo::read(&path, background).unwrap();
        assert_eq!(photo.rgb, expected.repeat(4), "case {index}");
    }
}

pub(super) fn png_chunk(kind: &[u8], data: &[u8]) -> Vec<u8> {
    let mut crc = flate2::Crc::new();
    crc.update(&[kind, data].concat());
    [&(data.len() as u32).to_be_bytes(), kind, data, &crc.sum().to_be_bytes()].concat()
}

/// A PNG of 2×1 pixels with a palette and transparency.
fn with_palette(palette: &[u8], interlaced: bool) -> Vec<u8> {
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| png.extend(png_chunk(kind, data));
    chunk(b"IHDR", &[0, 0, 0, 2, 0, 0, 0, 1, 8, 3, 0, 0, u8::from(interlaced)]);
    chunk(b"PLTE", palette);
    chunk(b"tRNS", &[255, 51]);
    // One stored block: no filter, indices 0 and 1; then the Adler-32 checksum.
    chunk(b"IDAT", &[0x78, 0x01, 1, 3, 0, 0xfc, 0xff, 0, 0, 1, 0, 4, 0, 2]);
    chunk(b"IEND", b"");
    png
}

/// Opaque red, and half transparent blue.
#[test]
fn palettes_are_read() {
    let (_folder, path) = Folder::with("a.png");
    std::fs::write(&path, with_palette(&[255, 0, 0, 0, 0, 255], false)).unwrap();
    assert_eq!(Photo::read(&path, [1.0; 3]).unwrap().rgb, [255, 0, 0, 204, 204, 255]);
}

/// Found by fuzzing: the decoder does not check the palette's size.
#[test]
fn damaged_palettes_are_refused() {
    let (_folder, path) = Folder::with("a.png");
    for length in [1, 2, 5, 3 * 257, 3 * 300 + 1] {
        for interlaced in [false, true] {
            std::fs::write(&path, with_palette(&vec![9; length], interlaced)).unwrap();
            let message = error(&path);
            // The decoder itself refuses those without a whole entry.
            assert!(["palette", "PLTE"].iter().any(|word| message.contains(word)), "{length}: {message}");
        }
    }
}

#[test]
fn jpeg_is_read_whatever_its_name() {
    let (folder, path) = Folder::with("a.jpg");
    let photo = gradient(40, 30);
    let image = image::RgbImage::from_raw(40, 30, photo.rgb.clone()).unwrap();
    image.save(&path).unwrap();
    let misnamed = folder.join("a.png");
    std::fs::copy(&path, &misnamed).unwrap();
    let read = Photo::read(&misnamed, BLACK).unwrap();
    assert_eq!(read, Photo::read(&path, BLACK).unwrap());
    let worst = read.rgb.iter().zip(&photo.rgb).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst < Some(40), "{worst:?}");
}

#[test]
fn no_truncation_is_accepted() {
    let folder = Folder::new();
    for name in ["a.jpg", "a.png"] {
        let path = folder.join(name);
        let photo = gradient(24, 16);
        image::RgbImage::from_raw(24, 16, photo.rgb.clone()).unwrap().save(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for_each_truncation(&path, &bytes, |length| match Photo::read(&path, BLACK) {
            Err(_) => drop(error(&path)),
            // A PNG without its last, empty chunk has all its pixels.
            Ok(read) => {
                assert!(name == "a.png" && length + 16 > bytes.len() && read == photo, "{name} {length}")
            }
        });
    }
}

#[test]
fn sizes_that_the_file_cannot_hold_are_refused() {
    let (_folder, path) = Folder::with("a.png");
    gradient(4, 4).write_png(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for (side, words) in [
        (100_000u32, ""),
        (40_000, "claims 40000x40000 pixels in"),
        (20_000, "claims 20000x20000 pixels in"),
        (0, ""),
    ] {
        let mut claim = bytes.clone();
        claim[16..20].copy_from_slice(&side.to_be_bytes());
        claim[20..24].copy_from_slice(&side.to_be_bytes());
        // Either the checksum or the size may fail first; both must be refused fast.
        let header = png_chunk(b"IHDR", &claim[16..29]);
        claim[8..33].copy_from_slice(&header);
        std::fs::write(&path, &claim).unwrap();
        assert_says(error(&path), &[words]);
    }
}

/// A JPEG's size may follow metadata of any length.
#[test]
fn sizes_behind_long_metadata_are_read() {
    let (_folder, path) = Folder::with("a.jpg");
    let mut bytes = Vec::new();
    let picture = image::RgbImage::from_pixel(24, 16, Rgb([90, 60, 30]));
    image::codecs::jpeg::JpegEncoder::new(&mut bytes).encode_image(&picture).unwrap();
    for segments in [0, 1, 3, 4, 5, 40] {
        let mut file = bytes[..2].to_vec();
        (0..segments).for_each(|_| {
            file.extend([0xff, 0xe5, 0xff, 0xff]);
            file.extend([7; 65_533]);
        });
        file.extend(&bytes[2..]);
        std::fs::write(&path, file).unwrap();
        assert_eq!(photo_size(&path).unwrap(), (24, 16), "{segments}");
        assert_eq!(Photo::read(&path, BLACK).unwrap().width, 24);
    }
}

#[test]
fn what_is_no_picture_is_named() {
    let (folder, path) = Folder::with("a.jpg");
    for (bytes, words) in [
        (&b""[..], "is empty"),
        (b"GIF89a", "is not a JPEG or PNG"),
        (b"version https://git-lfs", "git lfs pull"),
        (b"<html>", "is a web page"),
        (b"\xff\xd8\xff", "cannot be decoded"),
        (b"\x89PNG\r\n\x1a\n", "cannot be decoded"),
        (b"\0\0\0\x24ftypheic\0\0\0\0", "HEIC photo"),
        (b"\0\0\0\x20ftypavif\0\0\0\0", "AVIF"),
        (b"\0\0\0\x14ftypqt  \0\0\0\0", "is a video"),
        (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
        (b"II*\0\x08\0\0\0", "TIFF or a raw photo"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert_says(error(&path), &[words]);
    }
    assert!(error(&folder.join("none.png")).contains("(os error 2)"));
}

#[test]
fn resolutions_follow_the_reference() {
    use Resolution::{Auto, Factor, Width};
    for (resolution, from, to) in [
        (Auto, (1600, 900), (1600, 900)),
        (Auto, (1601, 900), (1600, 899)),
        (Auto, (5187, 3361), (1600, 1036)),
        (Factor(1), (5187, 3361), (5187, 3361)),
        (Factor(2), (133, 237), (66, 118)),
        (Factor(2), (135, 239), (68, 120)),
        (Factor(4), (5187, 3361), (1297, 840)),
        (Factor(8), (3, 1), (1, 1)),
        (Width(800), (1600, 900), (800, 450)),
        (Width(100), (133, 237), (100, 178)),
        (Width(10), (1000, 3), (10, 1)),
    ] {
        assert_eq!(resolution.apply(from.0, from.1), to, "{resolution:?} of {from:?}");
    }
    for (text, expected) in [
        ("-1", Auto),
        ("auto", Auto),
        ("1", Factor(1)),
        ("8", Factor(8)),
        ("640", Width(640)),
        ("65535", Width(65535)),
    ] {
        let parsed: Resolution = text.parse().unwrap();
        assert_eq!(parsed, expected);
        assert_eq!(parsed.to_string().parse::<Resolution>().unwrap(), expected);
    }
    for text in ["", "0", "3", "-2", "1.5", "65536", "99999999999999999999", "x"] {
        assert!(text.parse::<Resolution>().unwrap_err().to_string().starts_with("resolution: "), "{text}");
    }
}

#[test]
fn scaling_keeps_flat_pictures_and_the_mean() {
    let flat = Photo { width: 33, height: 21, rgb: [9, 100, 250].repeat(33 * 21) };
    let scaled = flat.clone().scaled_to(16, 10).unwrap();
    assert_eq!((scaled.width, scaled.height), (16, 10));
    assert_eq!(scaled.rgb, [9, 100, 250].repeat(160));
    assert_eq!(flat.clone().scaled_to(33, 21).unwrap(), flat);
    assert!(flat.clone().scaled_to(0, 4).is_err() && flat.scaled_to(4, 70_000).is_err());
    let mean = |photo: &Photo| photo.rgb.iter().map(|&v| f64::from(v)).sum::<f64>() / photo.rgb.len() as f64;
    let noise: Vec<u8> = (0..3 * 64 * 64u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let noise = Photo { width: 64, height: 64, rgb: noise };
    let eighth = noise.clone().scaled_to(8, 8).unwrap();
    assert!((mean(&noise) - mean(&eighth)).abs() < 3.0);
    // The whole area counts, so noise averages out.
    assert!(eighth.rgb.iter().all(|v| v.abs_diff(127) < 60), "{:?}", eighth.rgb);
    // The first pixel's centre moves from 0.5 to 0.25 of the new size: no shift.
    let ramp = Photo { width: 64, height: 1, rgb: (0..64u8).flat_map(|x| [x * 4; 3]).collect() };
    let half = ramp.scaled_to(32, 1).unwrap();
    for x in 4..28 {
        assert!(half.rgb[3 * x].abs_diff((8 * x + 2) as u8) <= 1, "{x}: {}", half.rgb[3 * x]);
    }
}

#[test]
fn floats() {
    let photo = gradient(5, 4);
    assert_eq!(Photo::from_f32(5, 4, &photo.to_f32()).unwrap(), photo);
    let clamped = Photo::from_f32(1, 1, &[[-1.0, 2.0, f32::NAN]]).unwrap();
    assert_eq!(clamped.rgb, [0, 255, 0]);
    assert!(Photo::from_f32(2, 1, &[[0.0; 3]]).is_err());
}
