//! The page's files, compiled into the program: the page loads nothing from elsewhere.

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$((concat!("/", $name), include_str!(concat!("web/", $name)))),*]
    };
}

const HTML: &str = "/index.html";

/// Path, contents.
const FILES: &[(&str, &str)] = files![
    "index.html",
    "style.css",
    "icon.svg",
    "main.js",
    "maths.js",
    "camera.js",
    "controls.js",
    "detail.js",
    "edit.js",
    "tape.js",
    "place.js",
    "link.js",
    "frames.js",
    "overlay.js",
    "filter.js",
    "stage.js",
    "panel.js",
    "photos.js",
    "pick.js",
    "film.js",
    "training.js",
];

/// Returns the MIME type and contents of the file at a path.
pub fn find(path: &str) -> Option<(&'static str, &'static str)> {
    let path = if path == "/" { HTML } else { path };
    let (name, text) = FILES.iter().find(|(name, _)| *name == path)?;
    let kind = match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    Some((kind, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every file that a page names is an asset.
    #[test]
    fn nothing_is_loaded_from_elsewhere() {
        for (name, text) in FILES {
            for start in ["from './", "import './", "href=\"", "src=\""] {
                for rest in text.split(start).skip(1) {
                    let target = rest.split(['\'', '"']).next().unwrap_or_default();
                    assert!(find(&format!("/{target}")).is_some(), "{name} names {target}");
                }
            }
            // Behind a proxy that serves the viewer below a path, an address from the root leads elsewhere.
            for start in ["=\"/", "`/", "fetch('/", "'POST', '/"] {
                assert!(!text.contains(start), "{name}: {start}");
            }
            let foreign = text.replace("http://www.w3.org/", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{name}");
        }
        assert!(find("/").is_some() && find("/nothing").is_none());
    }
}
