//! USD text as other programs write it.

use super::files::{Folder, assert_one, assert_says, refusal};
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat_files::splats::{self, Format, ReadOptions, Scene};

fn read(folder: &Folder, text: &str) -> ashsplat::Result<Scene> {
    splats::read(folder.put("scene.usda", text), &ReadOptions::default())
}

#[track_caller]
fn assert_near(value: impl Into<f64>, expected: f64) {
    let value = value.into();
    assert!((value - expected).abs() < 1e-5, "{value} instead of {expected}");
}

/// Two prims below transforms, among prims that draw nothing.
const SCENE: &str = r#"#usda 1.0
(
    doc = """A "scene" ) of # two"""
    upAxis = "Z"
    customLayerData = { string note = "upAxis = \"Y\"" }
)
# def Nothing "here" {
over "Elsewhere" ( references = @other.usda@</P> ) { def ParticleField3DGaussianSplat "No" { } }
def Xform "World" (
    kind = "component"
) {
    double3 xformOp:translate = (0, 0, 10)
    float3 xformOp:rotateXYZ = (0, 0, 90)
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    variantSet "look" = { "a" { def Scope "Inside" { } } }

    def ParticleField3DGaussianSplat "Half" (active = true)
    {
        custom string note
        point3h[] positionsh = [(1, 0, 0), (0, 1, 0),] ( interpolation = "vertex" )
        float3[] scales = [(1, 2, 3), (4, 5, 6)]
        float3[] scales.timeSamples = { 0: [(9, 9, 9)], 1: [] }
        half[] opacitiesh = [.25, 1e-1]
        uniform int radiance:sphericalHarmonicsDegree = 1
        half3[] radiance:sphericalHarmonicsCoefficientsh = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 3),
            (4, 4, 4), (5, 5, 5), (6, 6, 6), (7, 7, 7)]
        rel material:binding = </World/Material>
    }
    def ParticleField3DGaussianSplat "Plain" { point3f[] positions = [(0, 0, 1)]; float[] opacities = [] }
}
"#;

#[test]
fn usda_of_others_is_placed_by_its_transforms() {
    let folder = Folder::new();
    let scene = read(&folder, SCENE).unwrap();
    let all = &scene.gaussians;
    assert_eq!((scene.header.format, all.len(), all.sh_degree), (Format::Usda, 3, 1));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    // In the stage they lie at (0, 2, 10), (-2, 0, 10) and (0, 0, 12), where z is up; here y is down and z forward.
    let expected = [[0.0, -10.0, -2.0], [2.0, -10.0, 0.0], [0.0, -12.0, 0.0]];
    for (mean, expected) in all.means.iter().zip(expected) {
        let mean = scene.frame.source(glam::Vec3::from_array(*mean)).to_array();
        (0..3).for_each(|axis| assert_near(mean[axis], expected[axis]));
    }
    assert_near(all.log_scales[1][2], 12_f64.ln());
    assert_near(all.opacity(0), 0.25);
    assert!(all.opacity(2) > 0.999_999);
    assert_near(all.log_scales[2][0], 2_f64.ln());
    assert_near(all.sh_of(2)[0][1], f64::from(rgb_to_sh_dc(0.5)));
    assert_eq!(all.sh_of(1)[0], [4.0; 3]);
}

#[test]
fn odd_usda_gets_a_line_or_is_refused() {
    let folder = Folder::new();
    let prim = |body: &str| format!("#usda 1.0\ndef ParticleField3DGaussianSplat \"P\"\n{{\n{body}\n}}\n");
    let positions = "point3f[] positions = [(0, 0, 1), (0, 0, 2)]\n";
    let long = read(&folder, &prim(&format!("{positions}float[] opacities = [1, 1, 1]"))).unwrap();
    assert_one(&long.warnings, &["prim P: opacities has 3 numbers, of which 2 are read"]);
    let shown = prim(positions);
    for hidden in [
        shown.replace("\"P\"", "\"H\" (active = false)"),
        shown.replace('{', "{ token visibility = \"invisible\""),
    ] {
        let hidden = hidden.replace("#usda 1.0", "").replace("\"P\"", "\"H\"");
        let both = read(&folder, &format!("\u{feff}{shown}{hidden}")).unwrap();
        assert_one(&both.warnings, &["prim H: is inactive or invisible, and not read"]);
        assert_eq!(both.gaussians.len(), 2);
    }
    let moving = read(&folder, &prim("point3f[] positions.timeSamples = { 0: [(0, 0, 1)] }")).unwrap();
    assert_one(&moving.warnings, &["prim P: has no positions; values over time are not read"]);
    let degree = "uniform int radiance:sphericalHarmonicsDegree = 4\n";
    let sh = format!("float3[] radiance:sphericalHarmonicsCoefficients = [{}]", "(1, 1, 1), ".repeat(50));
    let high = read(&folder, &prim(&format!("{positions}{degree}{sh}"))).unwrap();
    assert_one(&high.warnings, &["SH of degree 4 are cut to 3"]);
    assert_eq!(high.gaussians.sh_degree, 3);
    let op = |op: &str, value: &str| {
        prim(&format!("{positions}double3 {op} = {value}\nuniform token[] xformOpOrder = [\"{op}\"]"))
    };
    let deep = prim(positions).replace('{', &"{ def \"a\" {".repeat(10_000));
    for (text, words) in [
        (SCENE.replace("#usda", "PXR-USDC"), &["does not begin with #usda", "usdcat"][..]),
        (SCENE.replace(" }\n}\n", " }\n"), &["ends inside"]),
        (SCENE.to_owned() + "}", &["closes one that is not open"]),
        (SCENE[..SCENE.len() / 2].to_owned(), &["ends inside"]),
        (deep, &["ends inside"]),
        ("#usda 1.0\ndef Mesh \"P\" { }".into(), &["has no prim of ParticleField3DGaussianSplat"]),
        (prim("point3f[] positions = [(0, x, 1)]"), &["positions: \"x\" is no number"]),
        (prim(&format!("{positions}float[] opacities = [1, 7]")), &["write opacities, not their logits"]),
        (prim("point3f[] positions = [(0, 1)]"), &["positions has 2 numbers, not three for each"]),
        (prim("uniform int radiance:sphericalHarmonicsDegree = -1"), &["makes no sense"]),
        (op("xformOp:rotateZYX", "(0, 0, 1)"), &["prim P: xformOp:rotateZYX is not read"]),
        (op("xformOp:scale", "(1, 2, 1)"), &["is more than rotation"]),
        (op("xformOp:translate", "(1, x, 2, 3)"), &["xformOp:translate is not read"]),
        (prim(&format!("{positions}float[] opacities = [1]")), &["opacities has 1 numbers instead of 2"]),
    ] {
        let refused = read(&folder, &text);
        assert_says(refusal(&folder.join("scene.usda"), refused), words);
    }
}
