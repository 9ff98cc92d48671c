//! Spherical harmonics: orthonormal basis and derivatives.

use ashsplat::scene::sh::{basis, basis_gradient, color, rgb_to_sh_dc, sh_dc_to_rgb};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn the_gradient_equals_finite_differences() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let point = [(); 3].map(|()| random.random_range(-1.5..1.5));
        let gradient = basis_gradient(point);
        for axis in 0..3 {
            let step = 1e-5;
            let [mut before, mut after] = [point; 2];
            before[axis] -= step;
            after[axis] += step;
            let (before, after) = (basis(before), basis(after));
            for function in 0..16 {
                let numeric = (after[function] - before[function]) / (2.0 * step);
                let error = (numeric - gradient[function][axis]).abs();
                assert!(error < 1e-8, "function {function}, axis {axis}: {error}");
            }
        }
    }
}

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
