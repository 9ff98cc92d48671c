//! Files: PLY, COLMAP, photographs.
