//! Rotating and mirroring spherical harmonics: a turned direction must show the previous colour.

use ashsplat::scene::sh;
use ashsplat::scene::sh_rotation::{ShRotation, mirror_signs};
use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;

/// Value of 16 coefficients in a direction.
fn value(sh: &[f64; 16], direction: DVec3) -> f64 {
    sh::basis(direction.to_array()).iter().zip(sh).map(|(basis, c)| basis * c).sum()
}

fn rotated(rotation: DMat3, coefficients: &[f64; 16]) -> [f64; 16] {
    let mut sh = coefficients.map(|c| [c as f32, 0.0, -c as f32]);
    ShRotation::new(rotation).apply(&mut sh);
    sh.map(|c| {
        assert_eq!(c[0], -c[2]);
        f64::from(c[0])
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]
    #[test]
    fn turned_coefficients_look_the_same_from_turned_directions(
        quat in prop::array::uniform4(-1.0..1.0f64),
        coefficients in prop::collection::vec(-2.0..2.0f64, 16),
        direction in prop::array::uniform3(-1.0..1.0f64),
    ) {
        prop_assume!(quat.iter().map(|q| q * q).sum::<f64>() > 1e-3);
        prop_assume!(DVec3::from_array(direction).length() > 1e-2);
        let rotation = DMat3::from_quat(DQuat::from_array(quat).normalize());
        // Rounded to float32.
        let coefficients: [f64; 16] = std::array::from_fn(|i| f64::from(coefficients[i] as f32));
        let direction = DVec3::from_array(direction).normalize();
        let turned = rotated(rotation, &coefficients);
        let (before, after) = (value(&coefficients, direction), value(&turned, rotation * direction));
        prop_assert!((before - after).abs() < 3e-6, "{before} {after}");
    }

    #[test]
    fn mirrored_coefficients_look_the_same_from_mirrored_directions(
        coefficients in prop::collection::vec(-2.0..2.0f64, 16),
        direction in prop::array::uniform3(-1.0..1.0f64),
        axes in prop::array::uniform3(any::<bool>()),
    ) {
        prop_assume!(DVec3::from_array(direction).length() > 1e-2);
        let signs = axes.map(|mirrored| if mirrored { -1.0 } else { 1.0 });
        let factors = mirror_signs(signs);
        let direction = DVec3::from_array(direction).normalize();
        let coefficients: [f64; 16] = std::array::from_fn(|i| coefficients[i]);
        let mirrored: [f64; 16] = std::array::from_fn(|i| coefficients[i] * f64::from(factors[i]));
        let after = value(&mirrored, direction * DVec3::from_array(signs));
        prop_assert!((value(&coefficients, direction) - after).abs() < 1e-12);
    }
}

#[test]
fn no_rotation_changes_nothing_and_two_half_turns_neither() {
    let coefficients: [f64; 16] = std::array::from_fn(|i| f64::from(i as u8) - 7.25);
    assert_eq!(rotated(DMat3::IDENTITY, &coefficients), coefficients);
    let half_turn = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    assert_eq!(rotated(half_turn, &rotated(half_turn, &coefficients)), coefficients);
    // A half turn is two mirrors: signs only.
    let signs = mirror_signs([-1.0, -1.0, 1.0]);
    assert_eq!(
        rotated(half_turn, &coefficients),
        std::array::from_fn(|i| f64::from(signs[i]) * coefficients[i])
    );
}

/// Lower degrees have fewer coefficients, which turn alike.
#[test]
fn lower_degrees_are_a_part_of_the_higher() {
    let rotation = ShRotation::new(DMat3::from_rotation_x(0.7) * DMat3::from_rotation_z(-2.1));
    let mut whole: Vec<[f32; 3]> = (0..16).map(|i| [i as f32, 1.0, -0.5 * i as f32]).collect();
    let parts = [1, 4, 9].map(|count| {
        let mut part = whole[..count].to_vec();
        rotation.apply(&mut part);
        part
    });
    rotation.apply(&mut whole);
    for part in parts {
        assert_eq!(part, whole[..part.len()]);
    }
}
