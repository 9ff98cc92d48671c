// Terms of the loss that shape surfaces: least coverage of a pixel with a surface; second difference of the inverse depth at
// which a bend has half of its greatest loss, and distance of a Gaussian from the surface, both relative to the depth.
const float SURFACE_COVERAGE = 0.5;
const float SURFACE_BEND = 0.02;
const float SURFACE_REACH = 0.05;
