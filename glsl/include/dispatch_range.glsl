// Frames with very many instances are blended by several dispatches. Each handles the tiles whose first instance lies in its
// range.
// Needs the push constants `first_instance` and `max_instances`.

// True if this dispatch handles the tile with this range of instances.
bool in_dispatch_range(uvec2 range) {
    return range.x - first_instance < max_instances;
}
