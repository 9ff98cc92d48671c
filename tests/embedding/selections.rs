//! Recoloured Gaussians of a scene, selected by the host's mask.

use crate::scene_settings::{Stage, USUAL};
use crate::scenes::{appended, assert_nearly_equal};
use crate::stage::*;

const RED: [f32; 3] = [1.0, 0.25, 0.0];

struct Mask<'a> {
    buffer: Buffer,
    own: Staging<'a>,
}

impl<'a> Mask<'a> {
    fn new(host: &'a Host, context: &Context, gaussians: usize) -> Self {
        let bytes = 4 * gaussians.div_ceil(32) as u64;
        let own = Staging::new(host, bytes);
        Self { buffer: own.adopt(context, "mask", 0, bytes), own }
    }

    fn select(&self, gaussians: usize, selected: impl Fn(usize) -> bool) {
        let mut words = vec![0u32; gaussians.div_ceil(32)];
        (0..gaussians).filter(|&i| selected(i)).for_each(|i| words[i / 32] |= 1 << (i % 32));
        self.own.write(bytemuck::cast_slice(&words));
    }
}

/// Mixes the selected Gaussians' colours on the host. Colours do not depend on the view.
fn mixed(gaussians: &Gaussians, share: f32, selected: impl Fn(usize) -> bool) -> Gaussians {
    let (mut mixed, c0) = (gaussians.clone(), 0.282_094_79);
    for (_, sh) in mixed.sh.chunks_mut(4).enumerate().filter(|(i, _)| selected(*i)) {
        let own = |k: usize| (1.0 - share) * (c0 * sh[0][k] + 0.5) + share * RED[k];
        sh[0] = [0, 1, 2].map(|k| (own(k) - 0.5) / c0);
    }
    mixed
}

fn flat(count: usize, seed: u32) -> Gaussians {
    let mut flat = cloud(count, seed);
    flat.sh.chunks_mut(4).for_each(|sh| sh[1..].fill([0.0; 3]));
    flat
}

#[test]
fn a_selection_has_another_colour() {
    with_host(&options(), |host| {
        let parts = [flat(300, 1), cloud(280, 2)];
        let selection = |wanted| Reservation { selection: true, tint: true, cut_outs: 1, ..wanted };
        let mut stage = Stage::new(host, &[&parts[0], &parts[1]], &selection);
        let mask = Mask::new(host, stage.renderer.context(), 300);
        let with = |share| SceneSettings {
            selection: Some(Selection { mask: &mask.buffer, color: RED, share }),
            ..USUAL
        };
        let (camera, frame) = (stage.camera, stage.frame);
        let expected = |first: &Gaussians| owned(&appended(first, &parts[1]), &camera, &frame);
        // The mask changes from frame to frame.
        let some: [fn(usize) -> bool; 3] = [|i| i % 3 == 0, |i| i >= 290, |_| true];
        for selected in some {
            mask.select(300, selected);
            for share in [0.25, 1.0] {
                let pixels = stage.pixels(&[with(share), USUAL]);
                assert_nearly_equal(&pixels, &expected(&mixed(&parts[0], share, selected)));
            }
        }
        // A share of 0, an empty mask and a hidden scene give the bits of a frame without a selection.
        stage.assert_drawn(&[with(0.0), USUAL], &appended(&parts[0], &parts[1]));
        mask.select(300, |_| false);
        assert_nearly_equal(&stage.pixels(&[with(1.0), USUAL]), &expected(&parts[0]));
        let hidden = SceneSettings { visible: false, ..with(1.0) };
        stage.assert_drawn(&[hidden, USUAL], &parts[1]);
    });
}

/// One mask covers a scene whose parameters lie in several buffers.
#[test]
fn a_mask_continues_from_chunk_to_chunk() {
    with_host(&options(), |host| {
        let context = guest_of_small_bindings(host);
        let gaussians = flat(1500, 8);
        let scene = uploaded(&context, &gaussians);
        assert_eq!(scene.plan().chunks, 2);
        let mut renderer =
            reserved(&context, &Reservation { selection: true, ..Reservation::new(1500, 1, 64, 48) });
        let mask = Mask::new(host, &context, 1500);
        let selected = |i: usize| i.is_multiple_of(5) || i > 1400;
        mask.select(1500, selected);
        let selection = Some(Selection { mask: &mask.buffer, color: RED, share: 0.5 });
        let placed = [Placed { settings: SceneSettings { selection, ..USUAL }, ..Placed::from(&scene) }];
        let view = camera(0.1, 64, 48);
        let pixels = rendered(host, &mut renderer, &frame_of(&placed, &view));
        assert_nearly_equal(&pixels, &owned(&mixed(&gaussians, 0.5, selected), &view, &SETTINGS));
    });
}

#[test]
fn bad_selections_are_refused_by_name() {
    with_host(&options(), |host| {
        let part = cloud(100, 1);
        let mut stage =
            Stage::new(host, &[&part, &part], &|wanted| Reservation { selection: true, ..wanted });
        let mut none = Stage::new(host, &[&part, &part], &|wanted| wanted);
        let other = guest(host);
        let mask = Mask::new(host, stage.renderer.context(), 100);
        let foreign = Mask::new(host, &other, 100);
        let short = mask.buffer.range(0, 12);
        let good = Selection { mask: &mask.buffer, color: RED, share: 0.5 };
        let with = |selection| SceneSettings { selection: Some(selection), ..USUAL };
        let bad = [
            (
                Selection { color: [f32::NAN; 3], ..good },
                "scenes[1].settings.selection.color: [NaN, NaN, NaN]",
            ),
            (Selection { color: [0.0, -1.0, 0.0], ..good }, "each may be 0 to 65504"),
            (
                Selection { share: 1.5, ..good },
                "scenes[1].settings.selection.share: 1.5 is not between 0 and 1",
            ),
            (Selection { share: f32::NAN, ..good }, "selection.share: NaN"),
            (
                Selection { mask: &short, ..good },
                "scenes[1].settings.selection.mask (buffer 'mask'): has 12 bytes, 100 Gaussians take 16",
            ),
            (Selection { mask: &foreign.buffer, ..good }, "it belongs to another context"),
        ];
        for (selection, expected) in bad {
            stage.assert_refused(&[USUAL, with(selection)], expected);
        }
        let unreserved = Mask::new(host, none.renderer.context(), 100);
        let error = none.refused(&[USUAL, with(Selection { mask: &unreserved.buffer, ..good })]).to_string();
        assert!(
            error.contains("Reservation::selection: not reserved, and scenes[1] has a selection"),
            "{error}"
        );
    });
}
