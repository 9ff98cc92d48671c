//! Selection, hiding, deletion and undo on the page.

use super::training::Training;
use super::*;

const COUNT: usize = 900;

fn edit(page: &mut Page, message: Value) {
    let mut message = message;
    message["type"] = "edit".into();
    message["run"] = page.greeting["run"].clone();
    page.send(&message);
}

/// Selects, and returns the counts that the next frame has.
fn select(page: &mut Page, region: Value, how: &str) -> Value {
    edit(page, json!({ "op": "select", "region": region, "how": how }));
    counts(page)
}

fn counts(page: &mut Page) -> Value {
    page.look(&camera(0.3), &json!({ "quality": 0 })).header["edits"].clone()
}

/// Indices of the ball's Gaussians for which `inside` is true.
fn among(inside: impl Fn(Vec3) -> bool) -> Vec<usize> {
    let means = ball(COUNT).means;
    (0..COUNT).filter(|&index| inside(Vec3::from_array(means[index]))).collect()
}

fn exported(server: &Server, query: &str) -> Gaussians {
    let place = TestFolder::empty();
    let (code, _, body) = server.get(&format!("/export/part.ply{query}"), &[]);
    assert_eq!(code, 200, "{}", String::from_utf8_lossy(&body));
    place.write("part.ply", &body);
    place.gaussians("part.ply")
}

/// Each tool selects the Gaussians whose means lie in its region. The export of the selection has exactly these.
#[test]
fn viewer_selects_with_lasso_brush_and_sphere() {
    let (_place, server) = view_ball(COUNT, &[]);
    let mut page = server.page();
    let camera = camera(0.3);
    let at = |mean: Vec3| camera.project(mean);
    let message = message(&camera);
    let triangle = [[20.0, 10.0], [80.0, 14.0], [40.0, 60.0f32]];
    let in_triangle = |x: f32, y: f32| {
        // The stencil tests the centres of pixels.
        let [x, y] = [x, y].map(|v| v.floor() + 0.5);
        let side = |a: [f32; 2], b: [f32; 2]| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0.0;
        let [a, b, c] = triangle;
        side(a, b) == side(b, c) && side(b, c) == side(c, a)
    };
    let near_line = |x: f32, y: f32| {
        let [x, y] = [x, y].map(|v| v.floor() + 0.5);
        let along = ((x - 30.0) / 30.0).clamp(0.0, 1.0);
        (x - 30.0 - 30.0 * along).hypot(y - 32.0) <= 6.0
    };
    let center = Vec3::new(0.3, 0.0, 0.0);
    let cases = [
        (
            json!({ "kind": "lasso", "camera": message, "points": triangle }),
            among(|mean| in_triangle(at(mean).0, at(mean).1)),
        ),
        (
            json!({ "kind": "brush", "camera": message, "points": [[30, 32], [60, 32]], "radius": 6 }),
            among(|mean| near_line(at(mean).0, at(mean).1)),
        ),
        (
            json!({ "kind": "sphere", "center": center.to_array(), "radius": 0.7 }),
            among(|mean| mean.distance(center) <= 0.7),
        ),
    ];
    for (region, expected) in &cases {
        assert!((20..COUNT - 20).contains(&expected.len()), "{region}: {}", expected.len());
        assert_eq!(select(&mut page, region.clone(), "set")["selected"], expected.len(), "{region}");
        assert!(exported(&server, "?part=selection") == ball(COUNT).select(expected), "{region}");
    }
    // Regions are united, subtracted and exchanged; a page's cut bounds what it selects.
    let [(lasso, in_lasso), (brush, in_brush), _] = cases;
    let united = among(|mean| in_triangle(at(mean).0, at(mean).1) || near_line(at(mean).0, at(mean).1)).len();
    select(&mut page, lasso, "set");
    assert_eq!(select(&mut page, brush.clone(), "add")["selected"], united);
    assert_eq!(select(&mut page, brush, "remove")["selected"], united - in_brush.len());
    let both = in_lasso.len() + in_brush.len() - united;
    let all = json!({ "kind": "all" });
    assert_eq!(select(&mut page, all.clone(), "toggle")["selected"], COUNT - (in_lasso.len() - both));
    edit(
        &mut page,
        json!({ "op": "select", "region": all, "how": "set", "cut": { "low": [0, null, null] } }),
    );
    assert_eq!(counts(&mut page)["selected"], among(|mean| mean.x >= 0.0).len());
}

/// The picture is that of the remaining Gaussians, to the bit, and so is the exported file. All pages see the same.
#[test]
fn viewer_hides_and_deletes_with_undo() {
    let (_place, server) = view_ball(COUNT, &[]);
    let (mut page, mut other) = (server.page(), server.page());
    let camera = camera(0.3);
    let drawn = |page: &mut Page| page.look(&camera, &json!({ "quality": 0 })).rgb();
    let expected =
        |indices: &[usize]| rendered(&ball(COUNT).select(indices), &camera, &RenderSettings::default());
    let whole = drawn(&mut page);
    let ball_of = |x: f32| json!({ "kind": "sphere", "center": [x, 0, 0], "radius": 0.7 });
    let outside = |x: f32, mean: Vec3| mean.distance(Vec3::new(x, 0.0, 0.0)) > 0.7;
    let (without_right, left_alone) =
        (among(|mean| outside(0.6, mean)), among(|mean| outside(0.6, mean) && outside(-0.6, mean)));
    select(&mut page, ball_of(0.6), "set");
    // The selection has its colour only where a page asks for it: not in screenshots and films.
    assert!(drawn(&mut page) == whole);
    let marked = page.look(&camera, &json!({ "quality": 0, "selection": true })).rgb();
    assert!(mean_difference(&marked, &whole) > 0.3);
    let mut tinted = ball(COUNT);
    let coefficients = tinted.sh.len() / COUNT;
    for index in (0..COUNT).filter(|index| !without_right.contains(index)) {
        for (place, sh) in tinted.sh[index * coefficients..][..coefficients].iter_mut().enumerate() {
            for (value, channel) in sh.iter_mut().zip([1.0, 0.45, 0.0]) {
                *value *= 0.35;
                // The constant of the spherical harmonics.
                *value += if place == 0 { 0.65 * (channel - 0.5) / 0.282_094_8 } else { 0.0 };
            }
        }
    }
    let tinted = rendered(&tinted, &camera, &RenderSettings::default());
    assert!(mean_difference(&marked, &tinted) < 0.5, "{}", mean_difference(&marked, &tinted));
    edit(&mut page, json!({ "op": "delete" }));
    assert!(drawn(&mut page) == expected(&without_right) && drawn(&mut other) == expected(&without_right));
    select(&mut other, ball_of(-0.6), "set");
    edit(&mut other, json!({ "op": "hide" }));
    counts(&mut other);
    assert!(drawn(&mut page) == expected(&left_alone));
    assert!(exported(&server, "") == ball(COUNT).select(&left_alone));
    let (deleted, hidden) = (COUNT - without_right.len(), without_right.len() - left_alone.len());
    let figures =
        json!({ "selected": 0, "hidden": hidden, "deleted": deleted, "undo": 4, "redo": 0, "revision": 4 });
    assert_eq!(counts(&mut page), figures);
    // Pixels list the scene's own indices.
    page.send(&json!({ "type": "pick", "id": 1, "camera": message(&camera), "pixel": [48, 32] }));
    let picked = page.wait_for("picked");
    let samples = picked["samples"].as_array().expect("samples");
    let ids: Vec<usize> = samples.iter().map(|s| s["id"].as_u64().expect("a number") as usize).collect();
    assert!(!ids.is_empty() && ids.iter().all(|id| left_alone.contains(id)), "{ids:?}");
    edit(&mut page, json!({ "op": "show" }));
    assert!(drawn(&mut page) == expected(&without_right));
    for _ in 0..5 {
        edit(&mut page, json!({ "op": "undo" }));
        counts(&mut page);
    }
    assert!(drawn(&mut page) == whole && counts(&mut page)["redo"] == 5);
    for _ in 0..2 {
        edit(&mut page, json!({ "op": "redo" }));
    }
    assert!(drawn(&mut page) == expected(&without_right));
}

/// A wrong edit, and one too many, gets one error and changes nothing.
#[test]
fn viewer_bounds_edits() {
    let (_place, server) = view_ball(100, &[]);
    let mut page = server.page();
    let camera = message(&camera(0.0));
    let lasso = |points: Value| json!({ "kind": "lasso", "camera": camera, "points": points });
    let brush =
        |radius: Value| json!({ "kind": "brush", "camera": camera, "points": [[1, 1]], "radius": radius });
    for (region, said) in [
        (lasso(json!([])), "1 to 1024"),
        (lasso(json!(vec![[1, 1]; 1025])), "1 to 1024"),
        (lasso(json!([[1e30, 1], [2, 2], [3, 3]])), "within 65536 pixels"),
        (lasso(json!([[1, 1, 1]])), "not understood"),
        (brush(json!(0)), "region.radius"),
        (brush(json!(513)), "region.radius"),
        (json!({ "kind": "sphere", "center": [0, 0, 0], "radius": -1 }), "region.sphere"),
        (json!({ "kind": "cone" }), "not understood"),
    ] {
        edit(&mut page, json!({ "op": "select", "region": region, "how": "set" }));
        let problem = page.wait_for_problem();
        assert!(problem.contains(said), "{region}: {problem}");
    }
    for op in ["hide", "show", "delete", "undo", "redo"] {
        edit(&mut page, json!({ "op": op }));
        let problem = page.wait_for_problem();
        assert!(problem.contains("nothing is"), "{op}: {problem}");
    }
    page.send(&json!({ "type": "edit", "run": "another", "op": "undo" }));
    assert!(page.wait_for_problem().contains("the scene has changed"));
    assert_eq!(server.get("/export/a.ply?part=selection", &[]).0, 422);
    assert_eq!(server.get("/export/a.ply?part=all", &[]).0, 400);
    // The last 64 edits can be undone.
    for _ in 0..35 {
        select(&mut page, json!({ "kind": "all" }), "set");
        select(&mut page, json!({ "kind": "all" }), "remove");
    }
    assert_eq!(counts(&mut page)["undo"], 64);
    // All may be deleted: pictures are empty then.
    select(&mut page, json!({ "kind": "all" }), "set");
    edit(&mut page, json!({ "op": "delete" }));
    assert!(page.look(&super::camera(0.0), &json!({ "quality": 0 })).rgb().iter().all(|value| *value == 0));
    // A training's Gaussians change by themselves.
    let training = Training::endless();
    let mut page = training.server.page();
    edit(&mut page, json!({ "op": "undo" }));
    assert!(page.wait_for_problem().contains("no training"));
}
