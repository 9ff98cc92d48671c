//! The page's files, compiled into the program: the page loads nothing from elsewhere.

macro_rules! files {
    ($($name:literal: $kind:literal),* $(,)?) => {
        &[$((concat!("/", $name), $kind, include_str!(concat!("web/", $name)))),*]
    };
}

const HTML: &str = "/index.html";

/// Path, MIME type, contents.
const FILES: &[(&str, &str, &str)] = files! {
    "index.html": "text/html; charset=utf-8",
    "style.css": "text/css; charset=utf-8",
    "icon.svg": "image/svg+xml",
    "main.js": "text/javascript; charset=utf-8",
    "maths.js": "text/javascript; charset=utf-8",
    "camera.js": "text/javascript; charset=utf-8",
    "controls.js": "text/javascript; charset=utf-8",
    "detail.js": "text/javascript; charset=utf-8",
    "link.js": "text/javascript; charset=utf-8",
    "frames.js": "text/javascript; charset=utf-8",
    "overlay.js": "text/javascript; charset=utf-8",
    "filter.js": "text/javascript; charset=utf-8",
    "stage.js": "text/javascript; charset=utf-8",
    "panel.js": "text/javascript; charset=utf-8",
    "photos.js": "text/javascript; charset=utf-8",
    "pick.js": "text/javascript; charset=utf-8",
    "film.js": "text/javascript; charset=utf-8",
    "training.js": "text/javascript; charset=utf-8",
};

/// Returns the MIME type and contents of the file at a path.
pub fn find(path: &str) -> Option<(&'static str, &'static str)> {
    let path = if path == "/" { HTML } else { path };
    FILES.iter().find(|(name, ..)| *name == path).map(|&(_, kind, text)| (kind, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every file that a page names is an asset.
    #[test]
    fn nothing_is_loaded_from_elsewhere() {
        for (name, _, text) in FILES {
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
