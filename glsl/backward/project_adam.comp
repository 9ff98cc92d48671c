// Backward pass of the projection and Adam's step in one (project_backward.comp, adam.comp): the gradients of a visible Gaussian
// are not stored, and its parameters are read once. The same formulas give the same bits. Gaussians outside the view are
// left to adam.comp with UNSEEN.
//
// invocation, subgroup: as project_backward.comp
// in: as project_backward.comp, without absolute gradients
// in/out: parameters, moments_1, moments_2 (PerGaussian planes), each bound a second time for reads; statistics as
//     project_backward.comp; state[STATE_NON_FINITE] as adam.comp. If the frame overflowed, nothing changes
// shared: none; subgroup sizes 4 to 128
#version 460
#define ADAM
#include "project_backward.comp"
