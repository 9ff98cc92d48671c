//! The viewer for whom pictures are drawn.

/// A page by its number, or its film.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Viewer {
    pub page: u64,
    pub films: bool,
}

/// The viewer of the next pictures.
pub struct Audience<'a> {
    pub viewer: Viewer,
    /// Most Gaussians of a picture of a tree of tiles. None: the program's own setting.
    pub budget: Option<u64>,
    /// True if that viewer is still connected.
    pub is_there: &'a dyn Fn(&Viewer) -> bool,
}
