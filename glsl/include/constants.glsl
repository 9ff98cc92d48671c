// Constants that shaders and host share: build.rs mirrors each line into `ashsplat::kernels::constants`.

// Side of a tile in pixels (paper, section 6).
const uint TILE_SIZE = 16;

// Thresholds of the reference implementation, all as float32.
const float NEAR_PLANE = 0.2;
// Bits of the depth keys: those of a depth less those of NEAR_PLANE. Depths above 6.8e37 share the last key.
const uint DEPTH_KEY_BITS = 30;
const float DILATION_PX2 = 0.3;
const float ALPHA_MAX = 0.99;
const float ALPHA_MIN = 0.00392156862745098;
const float TRANSMITTANCE_MIN = 1e-4;
const float ANTIALIAS_MIN_RATIO = 2.5e-5;
const float QUAT_NORM_MIN = 1e-12;
// Minimum opacity of Gaussians drawn as ellipsoids.
const float ELLIPSOID_LEAST_OPACITY = 0.2;

// Largest colour of a tinted scene: the largest half float.
const float TINTED_COLOR_MAX = 65504.0;

// Replaces the Gaussian and the scene if nothing is picked.
const uint NOT_PICKED = 0xFFFFFFFF;
// Largest motion along an axis, px: the largest half float.
const float MOTION_MAX = 65504.0;

// Cut-outs: shapes, the term that marks removal, and the number of vec4 per cut-out.
const uint CUT_OUT_BOX = 0;
const uint CUT_OUT_ELLIPSOID = 1;
const uint CUT_OUT_HALF_SPACE = 2;
const uint CUT_OUT_REMOVES = 4;
const uint CUT_OUT_PLANES = 4;

// Bits of antialiasing: opacities are compensated for the dilation (Mip-Splatting's 2D filter); gradients treat the
// compensation as a constant.
const uint ANTIALIAS_COMPENSATED = 1;
const uint ANTIALIAS_DETACHED = 2;

// Projections of a camera: through its centre, along parallel rays, or through a lens (lens.glsl).
const uint PROJECTION_PERSPECTIVE = 0;
const uint PROJECTION_ORTHOGRAPHIC = 1;
#ifdef LENSES
const uint PROJECTION_BROWN = 2;
const uint PROJECTION_FOV = 3;
const uint PROJECTION_DIVISION = 4;
const uint PROJECTION_EUCM = 5;
const uint PROJECTION_FISHEYE = 6;
const uint PROJECTION_THIN_PRISM_FISHEYE = 7;
const uint PROJECTION_EQUIRECTANGULAR = 8;
// Sums of a lens's gradient: two focal lengths, the principal point, twelve words (lens_gradient.glsl), and the means (world). Two zeros
// pad the sums to whole vec3.
const uint LENS_SUMS = 21;
#endif

// Extent modes: methods of finding a Gaussian's tiles.
const uint EXTENT_EXACT = 0;
const uint EXTENT_REFERENCE = 1;

// Parameters of a Gaussian as vec4 planes, in rows of PLANE_ROW Gaussians. Planes that are read together lie together, row by
// row, for all Gaussians: the geometry planes, and the planes of each SH degree (planes.glsl). A row is one cache line of a
// GPU, so accesses coalesce. A processor prefetches few streams of memory. With one stream per plane the optimiser would read
// 45 streams. This layout also fetches no bytes of unused SH degrees.
const uint PLANE_ROW = 8;
const uint PLANE_MEAN_OPACITY = 0;
const uint PLANE_QUAT = 1;
const uint PLANE_LOG_SCALE = 2;
const uint PLANE_SH = 3;
// Planes of spherical harmonics for degrees 0 to 3: ceil(3 (d + 1)^2 / 4).
const uint SH_PLANES_0 = 1;
const uint SH_PLANES_1 = 3;
const uint SH_PLANES_2 = 7;
const uint SH_PLANES_3 = 12;
// The same with halves, two planes in one.
const uint HALF_SH_PLANES_0 = 1;
const uint HALF_SH_PLANES_1 = 2;
const uint HALF_SH_PLANES_2 = 4;
const uint HALF_SH_PLANES_3 = 6;

// Attributes of a visible Gaussian, each a vec4 (splat_record.glsl).
const uint SPLAT_MEAN2D_EXTENT = 0;
const uint SPLAT_CONIC_OPACITY = 1;
const uint SPLAT_COLOR_INVERSE_DEPTH = 2;
const uint SPLAT_FOOTPRINT = 3;
const uint SPLAT_PLANES = 4;

// Gradient planes of a visible Gaussian: plane p of visible Gaussian i lies at p * stride + i.
const uint GRADIENT_MEAN_OPACITY = 0;
const uint GRADIENT_QUAT = 1;
const uint GRADIENT_LOG_SCALE = 2;
const uint GRADIENT_COLOR = 3;
const uint GRADIENT_PLANES = 4;

// Words of the frame state.
const uint STATE_VISIBLE_NEEDED = 0;
const uint STATE_VISIBLE = 1;
// Number of visible Gaussians of the first scene. They come first, and only they have gradients.
const uint STATE_FIRST_SCENE_VISIBLE = 2;
// Words from here on are separate for each of several views with one order.
const uint STATE_INSTANCES_NEEDED = 3;
const uint STATE_INSTANCES = 4;
const uint STATE_LONGEST_TILE = 5;
const uint STATE_NON_FINITE = 6;
const uint STATE_OVERFLOW = 7;
// With COUNT_HITS: number of Gaussians blended over 8 x 4 pixels, forward and backward.
const uint STATE_BLEND_HITS = 8;
const uint STATE_BLEND_BACKWARD_HITS = 9;
const uint STATE_WORDS = 10;

// Indirect dispatch arguments, 16 bytes apart.
const uint ARGUMENTS_VISIBLE = 0;
const uint ARGUMENTS_VISIBLE_SORT = 1;
const uint ARGUMENTS_VISIBLE_SCAN = 2;
const uint ARGUMENTS_INSTANCES = 3;
const uint ARGUMENTS_INSTANCES_SORT = 4;
const uint ARGUMENTS_INSTANCES_EXPAND = 5;
const uint ARGUMENTS_COUNT = 6;

// Radix sort: maximum number of bins of one digit.
const uint SORT_BINS = 256;
#ifdef SORT_ROWS
// Groups of a sort's blocks: most groups, and fewest blocks of a group if there are several.
const uint SORT_GROUPS = 64;
const uint SORT_GROUP_BLOCKS = 16;
#endif

// Words from one scene's camera block to the next (scene_blocks.glsl).
const uint CAMERA_BLOCK_WORDS = 64;
// Marks a scene outside batches.
const uint NO_BATCH = 0xFFFFFFFF;

// Marks a Gaussian that is not visible in this frame.
const uint NOT_VISIBLE = 0xFFFFFFFF;

// Bits of a position on the Z-order curve by which densification orders Gaussians: ten per axis.
const uint ZORDER_BITS = 30;

// Densification divides the scales of a split Gaussian's halves by this.
const float SPLIT_FACTOR = 1.6;
// Sum of gradient norms of a Gaussian outside a block's core: its mean over views is below every threshold.
const float OUTSIDE_STATISTIC = -3e38;
// A split along the longest axis (long_axis.glsl): the share d, and the children's share of the opacity.
const float LONG_AXIS_SHARE = 0.45;
const float LONG_AXIS_OPACITY = 0.6;
// Kind of a row of the new set at densification.
const uint KIND_KEPT = 0;
const uint KIND_CLONE = 1;
const uint KIND_SPLIT_0 = 2;
const uint KIND_SPLIT_1 = 3;
// Source of a row: Gaussian | kind << KIND_SHIFT.
const uint KIND_SHIFT = 30;

// Work of gather.comp on a plane: copies it, copies moments, or makes the plane of means or scales; or copies rows to their own
// places.
const uint GATHER_COPIES = 0;
const uint GATHER_MOMENTS = 1;
const uint GATHER_MEAN_OPACITY = 2;
const uint GATHER_LOG_SCALE = 3;
const uint GATHER_PLACES = 4;
// Relocation (3DGS-MCMC): maximum number of Gaussians that share an opacity, including the source; limits of that opacity.
const uint RELOCATION_MOST = 51;
const float RELOCATION_LEAST_OPACITY = 0.005;
const float RELOCATION_MOST_OPACITY = 0.99999988;

// A draw without replacement (draw_keys.comp): its weights, the key of Gaussians that cannot be drawn, and words of its totals.
const uint CHANCE_IMPORTANCE = 0;
const uint CHANCE_STATISTIC = 1;
const uint CHANCE_EQUAL = 2;
const uint NOT_DRAWN = 0xFFFFFFFF;
const uint TOTAL_GAUSSIANS = 0;
const uint TOTAL_CANDIDATES = 1;
const uint TOTAL_DRAWN = 2;

// Number of rows in a strip: see strips.glsl.
const uint STRIP_ROWS = 8;

// Number of sums per (tile, Gaussian) instance in the backward pass: six moments, three colours, inverse depth; also with the
// absolute gradient of the 2D mean.
const uint INSTANCE_SUMS = 10;
const uint ABSOLUTE_SUMS = 12;

// Number of workgroups, and so of partial sums, of a loss term that is a mean over Gaussians.
const uint TERM_PARTIALS = 256;

// Minimum value of an inverse-depth map at which a pixel does not count.
const float MAP_NOTHING = 1e30;

// Minimum divisor of an expected depth, a sum of weights (gsplat).
const float COVERAGE_MIN = 1e-10;

// Arithmetic benchmark: number of independent chains per invocation, and of steps per chain and round.
const uint MULTIPLY_ADD_CHAINS = 8;
const uint MULTIPLY_ADD_STEPS = 4;

#ifdef FIELD
// Distance field: voxels along a block's side, voxels of a block, the mark of a missing block, and words of each case of a cube.
const uint FIELD_SIDE = 8;
const uint FIELD_VOXELS = 512;
const uint NO_BLOCK = 0xFFFFFFFF;
const uint CUBE_WORDS = 8;
#endif

// Background of the splats in a host's image: a colour, none (premultiplied colour), or the image.
const uint COMPOSE_BACKGROUND = 0;
const uint COMPOSE_PREMULTIPLIED = 1;
const uint COMPOSE_OVER = 2;
// Encoding of a composed image: values as trained; linear light; linear light into texels that the format encodes for display.
const uint COMPOSE_AS_TRAINED = 0;
const uint COMPOSE_LINEAR = 1;
const uint COMPOSE_LINEAR_IN_SRGB = 2;
