//! `.ksplat` files, built here as GaussianSplats3D writes them.

use super::files::{Folder, assert_one, assert_says, for_each_mutation, for_each_truncation, refusal};
use crate::common::splats::{Tolerance, assert_close, scene, tolerance};
use ashsplat::scene::Gaussians;
use ashsplat::scene::sh::sh_dc_to_rgb;
use ashsplat_files::splats::{self, Format, ReadOptions, WriteOptions};

/// Gaussians in each full bucket.
const BUCKET: usize = 256;
const BLOCK_SIZE: f32 = 64.0;

/// A number in half precision, rounded towards 0.
fn half(value: f32) -> [u8; 2] {
    let bits = value.to_bits();
    let magnitude = (bits >> 13 & 0x3_ffff).saturating_sub(112 << 10);
    ((bits >> 16 & 0x8000 | magnitude) as u16).to_le_bytes()
}

/// A section's header and content. The last Gaussians are in buckets of 3 and of the rest.
fn section(all: &Gaussians, level: usize) -> [Vec<u8>; 2] {
    let number = |value: f32| if level == 0 { value.to_le_bytes().to_vec() } else { half(value).to_vec() };
    let full = if level == 0 { 0 } else { (all.len() - 4) / BUCKET };
    let rest = all.len() - full * BUCKET;
    let lengths: &[usize] = if level == 0 { &[] } else { &[3, rest - 3] };
    let (mut centers, mut rows) = (Vec::new(), Vec::new());
    let mut ends: Vec<usize> = (1..=full).map(|bucket| bucket * BUCKET).collect();
    ends.extend([full * BUCKET + 3, all.len()]);
    let mut start = 0;
    for end in ends {
        let center = all.means[start];
        centers.extend(center.map(f32::to_le_bytes).concat());
        for i in start..end {
            for (mean, center) in all.means[i].into_iter().zip(center) {
                let steps = ((mean - center) / (BLOCK_SIZE / 2.0) * 32_767.0).round();
                match level {
                    0 => rows.extend(mean.to_le_bytes()),
                    _ => rows.extend(((steps + 32_767.0) as u16).to_le_bytes()),
                }
            }
            rows.extend(all.log_scales[i].iter().flat_map(|scale| number(scale.exp())));
            rows.extend(all.quats[i].iter().flat_map(|q| number(*q)));
            rows.extend(all.sh_of(i)[0].map(|dc| (255.0 * sh_dc_to_rgb(dc)).round() as u8));
            rows.push((255.0 * all.opacity(i)).round() as u8);
            for (first, end) in [(1, 4), (4, 9)].into_iter().take(all.sh_degree as usize) {
                for channel in 0..3 {
                    rows.extend(all.sh_of(i)[first..end].iter().flat_map(|sh| match level {
                        2 => vec![((sh[channel] + 1.0) / 2.0 * 255.0).round() as u8],
                        _ => number(sh[channel]),
                    }));
                }
            }
        }
        start = end;
    }
    let buckets = if level == 0 { 0 } else { full + lengths.len() };
    let mut head = vec![0; 1024];
    let fields =
        [all.len(), all.len(), BUCKET, buckets, 0, 12, 0, 0, full, lengths.len(), all.sh_degree as usize];
    head[..44].copy_from_slice(&fields.map(|field| (field as u32).to_le_bytes()).concat());
    head[16..20].copy_from_slice(&BLOCK_SIZE.to_le_bytes());
    centers.truncate(12 * buckets);
    let lengths = lengths.iter().flat_map(|length| (*length as u32).to_le_bytes());
    [head, lengths.chain(centers).chain(rows).collect()]
}

/// A file of these sections. SH values of bytes are between -1 and 1.
fn ksplat(sections: &[&Gaussians], level: usize) -> Vec<u8> {
    let count = sections.iter().map(|section| section.len()).sum::<usize>();
    let mut file = vec![0; 4096];
    let fields = [256, sections.len(), sections.len(), count, count, level].map(|field| field as u32);
    file[..24].copy_from_slice(&fields.map(u32::to_le_bytes).concat());
    file[36..44].copy_from_slice(&[-1.0_f32, 1.0].map(f32::to_le_bytes).concat());
    let sections: Vec<[Vec<u8>; 2]> = sections.iter().map(|all| section(all, level)).collect();
    file.extend(
        [0, 1]
            .map(|part| sections.iter().flat_map(|section| &section[part]).copied().collect::<Vec<u8>>())
            .concat(),
    );
    file
}

#[test]
fn ksplat_is_read_at_all_levels() {
    let folder = Folder::new();
    for (level, degree) in [0, 1, 2].into_iter().flat_map(|level| [(level, 0), (level, 1), (level, 2)]) {
        let [first, second] = [scene(40_000, degree), scene(700, 0)];
        let path = folder.put("scene.ksplat", ksplat(&[&first, &second], level));
        let read = splats::read(&path, &ReadOptions::default()).unwrap();
        assert_eq!((read.header.format, read.warnings.len()), (Format::Ksplat, 0));
        let mut expected = first;
        expected.append(&second.with_sh_degree(degree));
        let level_1 = tolerance(Format::Ksplat);
        let margin = match level {
            0 => Tolerance { mean: 0.0, log_scale: 1e-5, sh: 0.0, ..level_1 },
            1 => level_1,
            _ => Tolerance { sh: 1.0 / 255.0 + 1e-5, ..level_1 },
        };
        assert_close(&read.gaussians, &expected, &margin);
    }
}

#[test]
fn damaged_ksplat_is_refused() {
    let (folder, path) = Folder::with("scene.ksplat");
    let read = || splats::read(&path, &ReadOptions::default());
    let all = scene(20, 1);
    let bytes = ksplat(&[&all, &scene(9, 0)], 2);
    for_each_truncation(&path, &bytes, |_| drop(refusal(&path, read())));
    for_each_mutation(&path, &bytes, || match read() {
        Ok(read) => read.gaussians.check_shapes().unwrap(),
        Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
    });
    let good = ksplat(&[&all], 1);
    for (at, value, words) in [
        (1, 0, "version 0.0"),
        (20, 3, "level 3"),
        (6, 1, "the header says 65537 sections"),
        (16, 21, "the header says 21 Gaussians, the sections have 20"),
        (4096, 21, "section 0 makes no sense"),
        (4096 + 36, 1, "hold fewer Gaussians"),
        (4096 + 40, 4, "section 0 makes no sense"),
        (4096 + 7, 1, "section 0 ends at byte"),
    ] {
        let mut bytes = good.clone();
        bytes[at] = value;
        folder.put("scene.ksplat", bytes);
        assert_says(refusal(&path, read()), &[words]);
    }
    folder.put("scene.ksplat", [&good[..], &[0; 7]].concat());
    assert_one(&read().unwrap().warnings, &["7 bytes after the last section"]);
    let written = splats::write(&path, &all, &WriteOptions::default()).unwrap_err();
    assert_says(written.to_string(), &[".ksplat is not written", "one of .ply"]);
}
