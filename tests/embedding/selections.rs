//! Recoloured Gaussians of a scene, selected by the host's mask.

use crate::host::Host;
use crate::memory::HostBuffer;
use crate::scene_settings::{Stage, USUAL};
use crate::scenes::{appended, assert_nearly_equal};
use crate::stage::{
    assert_same, camera, cloud, guest, guest_of_small_bindings, options, owned, rendered, with_host,
};
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Buffer, Context};
use ashsplat::{
    DeviceScene, Error, Placed, RecordedFrame, RenderSettings, Renderer, Reservation, SceneSettings,
    Selection,
};

const RED: [f32; 3] = [1.0, 0.25, 0.0];

/// A mask in the host's memory.
fn mask(host: &Host, context: &Context, gaussians: usize) -> (HostBuffer, Buffer) {
    let bytes = 4 * gaussians.div_ceil(32) as u64;
    let own = HostBuffer::new(host, bytes).expect("memory");
    // SAFETY: the buffer is the host's, of this size, and outlives the view.
    let adopted = unsafe { Buffer::adopt(context, "mask", own.raw, 0, bytes) }.expect("adopted");
    (own, adopted)
}

/// Sets the bits of the selected Gaussians.
fn select(host: &Host, own: &HostBuffer, gaussians: usize, selected: impl Fn(usize) -> bool) {
    let mut words = vec![0u32; gaussians.div_ceil(32)];
    (0..gaussians).filter(|&i| selected(i)).for_each(|i| words[i / 32] |= 1 << (i % 32));
    own.write(host, bytemuck::cast_slice(&words)).expect("written");
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
        let (own, adopted) = mask(host, stage.renderer.context(), 300);
        let with = |share| SceneSettings {
            selection: Some(Selection { mask: &adopted, color: RED, share }),
            ..USUAL
        };
        let (camera, frame) = (stage.camera, stage.frame);
        let expected = |first: &Gaussians| owned(&appended(first, &parts[1]), &camera, &frame);
        // The mask changes from frame to frame.
        let some: [fn(usize) -> bool; 3] = [|i| i % 3 == 0, |i| i >= 290, |_| true];
        for selected in some {
            select(host, &own, 300, selected);
            for share in [0.25, 1.0] {
                let pixels = stage.pixels(&[with(share), USUAL]);
                assert_nearly_equal(&pixels, &expected(&mixed(&parts[0], share, selected)));
            }
        }
        // A share of 0, an empty mask and a hidden scene give the bits of a frame without a selection.
        assert_same(&stage.pixels(&[with(0.0), USUAL]), &expected(&parts[0]), [0.0; 3]);
        select(host, &own, 300, |_| false);
        assert_nearly_equal(&stage.pixels(&[with(1.0), USUAL]), &expected(&parts[0]));
        let hidden = SceneSettings { visible: false, ..with(1.0) };
        assert_same(&stage.pixels(&[hidden, USUAL]), &owned(&parts[1], &camera, &frame), [0.0; 3]);
        drop(stage);
        drop(adopted);
        own.destroy(host);
    });
}

/// One mask covers a scene whose parameters lie in several buffers.
#[test]
fn a_mask_goes_on_from_chunk_to_chunk() {
    with_host(&options(), |host| {
        let context = guest_of_small_bindings(host);
        let gaussians = flat(1500, 8);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        assert_eq!(scene.plan().chunks, 2);
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer
            .reserve(&Reservation { selection: true, ..Reservation::new(1500, 1, 64, 48) })
            .expect("memory");
        let (own, adopted) = mask(host, &context, 1500);
        let selected = |i: usize| i.is_multiple_of(5) || i > 1400;
        select(host, &own, 1500, selected);
        let selection = Some(Selection { mask: &adopted, color: RED, share: 0.5 });
        let placed = [Placed { settings: SceneSettings { selection, ..USUAL }, ..Placed::from(&scene) }];
        let (view, settings) = (camera(0.1, 64, 48), RenderSettings::default());
        let pixels = rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        assert_nearly_equal(&pixels, &owned(&mixed(&gaussians, 0.5, selected), &view, &settings));
        drop((renderer, scene, adopted, context));
        own.destroy(host);
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
        let (own, adopted) = mask(host, stage.renderer.context(), 100);
        let (elsewhere, foreign) = mask(host, &other, 100);
        let short = adopted.range(0, 12);
        let good = Selection { mask: &adopted, color: RED, share: 0.5 };
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
            (Selection { mask: &foreign, ..good }, "it belongs to another context"),
        ];
        for (selection, expected) in bad {
            let error = stage.refused(&[USUAL, with(selection)]);
            assert!(matches!(error, Error::Argument { .. }), "{error:?}");
            assert!(error.to_string().contains(expected), "{error} (expected {expected})");
        }
        let unreserved = none.renderer.context().clone();
        let (third, mask_of_none) = mask(host, &unreserved, 100);
        let error = none.refused(&[USUAL, with(Selection { mask: &mask_of_none, ..good })]).to_string();
        assert!(
            error.contains("Reservation::selection: not reserved, and scenes[1] has a selection"),
            "{error}"
        );
        drop((stage, none, adopted, short, foreign, mask_of_none, unreserved, other));
        [own, elsewhere, third].into_iter().for_each(|buffer| buffer.destroy(host));
    });
}
