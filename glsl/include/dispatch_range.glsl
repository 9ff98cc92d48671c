// Frames of very many instances are blended by several dispatches, each over the tiles whose instances begin in a range.
// Needs the push constants `first_instance` and `max_instances`.

// Whether this dispatch handles the tile with a range of instances.
bool in_dispatch_range(uvec2 range) {
    return range.x - first_instance < max_instances;
}
