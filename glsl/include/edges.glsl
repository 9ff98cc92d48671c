// Words of the ranges of edges and weights (densify/edge_response.comp, densify/sum_weights.comp). The smallest value v is
// stored as the largest ~v, so that all words start at 0.
const uint RANGE_EDGE_LOW = 0;
const uint RANGE_EDGE_HIGH = 1;
const uint RANGE_WEIGHT_LOW = 2;
const uint RANGE_WEIGHT_HIGH = 3;
