//! Spherical harmonics: orthonormal basis, rotations and mirrors.

use ashsplat::scene::sh::{basis, color, rgb_to_sh_dc, sh_dc_to_rgb};
use ashsplat::scene::sh_rotation::{ShRotation, mirror_signs};
use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;

#[test]
fn the_basis_is_orthonormal() {
    // A Fibonacci lattice integrates polynomials on the sphere almost exactly.
    let count = 20_000;
    let mut products = [[0.0; 16]; 16];
    for i in 0..count {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let azimuth = std::f64::consts::PI * (3.0 - 5f64.sqrt()) * i as f64;
        let radius = (1.0 - z * z).sqrt();
        let y = basis([radius * azimuth.cos(), radius * azimuth.sin(), z]);
        for (row, a) in products.iter_mut().zip(y) {
            row.iter_mut()
                .zip(y)
                .for_each(|(sum, b)| *sum += a * b * 4.0 * std::f64::consts::PI / count as f64);
        }
    }
    for (i, row) in products.iter().enumerate() {
        for (j, product) in row.iter().enumerate() {
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((product - expected).abs() < 1e-3, "<{i}|{j}> = {product}");
        }
    }
}

#[test]
fn signs_are_those_of_the_reference() {
    let y = basis([0.36, 0.48, 0.8]);
    // Y1-1, Y10, Y11 are -y, z, -x; Y2-2 is xy; Y3-3 is negative here.
    assert!(y[1] < 0.0 && y[2] > 0.0 && y[3] < 0.0 && y[4] > 0.0 && y[5] < 0.0 && y[9] < 0.0);
}

#[test]
fn colours() {
    assert_eq!(rgb_to_sh_dc(0.5), 0.0);
    for rgb in [0.0, 0.25, 1.0] {
        assert!((sh_dc_to_rgb(rgb_to_sh_dc(rgb)) - rgb).abs() < 1e-6);
    }
    let mut sh = vec![[0.0; 3]; 16];
    sh[0] = [rgb_to_sh_dc(0.2), rgb_to_sh_dc(0.6), -100.0];
    sh[2][0] = 1.0;
    let at = |degree| color(&sh, degree, [0.0, 0.0, 1.0]);
    assert!((at(0)[0] - 0.2).abs() < 1e-6 && (at(0)[1] - 0.6).abs() < 1e-6 && at(0)[2] == 0.0);
    assert!((at(1)[0] - (0.2 + 0.488_602_5)).abs() < 1e-6 && at(3) == at(1));
}

/// Value of 16 coefficients in a direction.
fn value(sh: &[f64; 16], direction: DVec3) -> f64 {
    basis(direction.to_array()).iter().zip(sh).map(|(basis, c)| basis * c).sum()
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
