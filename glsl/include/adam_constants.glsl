// Constants of Adam over poses, exposures and lens effects: decay rates, one minus each, rounded once, and the epsilon of PyTorch.

const float ADAM_BETA_1 = 0.9;
const float ADAM_BETA_2 = 0.999;
const float ADAM_ONE_MINUS_BETA_1 = 0.1;
const float ADAM_ONE_MINUS_BETA_2 = 0.001;
const float ADAM_EPSILON = 1e-8;
