// Storages of a scene's SH coefficients, as frame::ShStorage has them. In bytes a plane has the base colour as floats and a step,
// and the next ones have a byte per float of the coefficients, those of the base colour unused: a signed number of steps.
#define SH_STORAGES
const uint SH_HALVES = 1;
const uint SH_BYTES = 2;
