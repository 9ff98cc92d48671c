//! `report.html` of a training.

use super::training::trained;
use super::*;

fn report(model: &Path) -> String {
    std::fs::read_to_string(model.join("report.html")).expect("the report")
}

/// The page is complete and loads nothing from elsewhere.
#[test]
fn report_is_whole_and_needs_nothing_else() {
    let page = report(&trained().model);
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for address in ["http:", "https:", "//cdn", "@import", "<link"] {
        assert!(!page.contains(address), "{address}");
    }
    let addresses = page.matches(" src=\"").count();
    assert_eq!(addresses, 6, "photo, render and error of two views");
    assert_eq!(page.matches(" src=\"data:image/jpeg;base64,/9j/").count(), addresses);
    for title in ["Curves", "Contact sheet", "Views", "Gaussians", "Kernels", "Device memory", "Settings"] {
        assert!(page.contains(&format!("<h2>{title}</h2>")), "{title}");
    }
    assert!(page.contains("LPIPS is not computed"));
    assert!(
        page.contains("backward/blend_backward") && page.contains("optimizer/adam"),
        "kernels were timed"
    );
    assert!(page.contains("<tr class=\"own\"><td class=\"name\">iterations</td><td>30</td></tr>"));
    assert!(page.contains("<tr><td class=\"name\">lambda_dssim</td>"), "a default is not bold");
    // The same figures as in the results, with the worst view first.
    let results = std::fs::read_to_string(trained().model.join("per_view.json")).expect("results");
    let results: serde_json::Value = serde_json::from_str(&results).expect("JSON");
    let views = results["ours_30"]["PSNR"].as_object().expect("views");
    let mut psnrs: Vec<f64> = views.values().filter_map(serde_json::Value::as_f64).collect();
    psnrs.sort_by(f64::total_cmp);
    let places: Vec<usize> =
        psnrs.iter().map(|psnr| page.find(&format!("</b> {psnr:.2} dB")).expect("in the sheet")).collect();
    assert!(places.is_sorted(), "{psnrs:?}");
    assert_eq!(page.matches("<span class=\"badge\">30 iterations</span>").count(), 1);
}

/// Charts are valid JSON, with one entry per iteration of a short run.
#[test]
fn report_has_the_curves_of_all_iterations() {
    let page = report(&trained().model);
    let data: Vec<Vec<(f64, f64, u32, String)>> = page
        .split("<script type=\"application/json\">")
        .skip(1)
        .map(|part| serde_json::from_str(part.split("</script>").next().expect("an end")).expect("JSON"))
        .collect();
    let lengths: Vec<usize> = data.iter().map(Vec::len).collect();
    // The PSNR is measured at tests, and in between as often as its share of the time allows.
    let [loss, psnr, gaussians, speed] = lengths[..] else { panic!("{lengths:?}") };
    assert_eq!([loss, gaussians, speed], [30; 3]);
    assert!((2..=30).contains(&psnr), "{psnr}");
    assert_eq!((data[0][0].2, data[0][29].2), (1, 30));
    let measured: Vec<u32> = data[1].iter().map(|(.., iteration, _)| *iteration).collect();
    assert!(measured.is_sorted() && [10, 30].iter().all(|tested| measured.contains(tested)), "{measured:?}");
    assert!(data.iter().flatten().all(|(x, y, ..)| (0.0..=560.0).contains(x) && (0.0..=220.0).contains(y)));
}
