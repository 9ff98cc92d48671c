//! For whom pictures are drawn.

/// Who looks: a page by its number, or its film.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Viewer {
    pub page: u64,
    pub films: bool,
}

/// For whom the next pictures are.
pub struct Audience<'a> {
    pub viewer: Viewer,
    /// Gaussians of a picture of a tree of tiles, at most; none: as the program was told.
    pub budget: Option<u64>,
    /// Who is still there.
    pub is_there: &'a dyn Fn(&Viewer) -> bool,
}
