// The camera that the page moves: x right, y down, z forward, as the engine's.

import { add, clamp, dot, length, looking, normalize, orthonormal, quaternion, rows, slerp, sub, times, turn } from './maths.js';

/** Smallest angle between view and pole, radians. */
const POLE = 0.02;
/** The engine draws nothing nearer than this, world units. */
const NEAR = 0.2;
/** Widest angle of view that is taken over from a lens, radians. */
const WIDEST = 1.4;

export class Camera {
    constructor() {
        this.position = [0, 0, -3];
        this.rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        this.fovY = 0.9;
        this.pivot = [0, 0, 0];
        this.up = [0, -1, 0];
        /** Length of a stride, world units. */
        this.radius = 3;
        /** A photo's camera, while the view is exactly the photo's. */
        this.lens = null;
        /** Shares of the page that tools and panel cover. The view is centred in the rest. */
        this.covered = { left: 0, right: 0, top: 0, bottom: 0 };
        this.changed = () => {};
    }

    get right() { return this.rotation[0]; }
    get down() { return this.rotation[1]; }
    get forward() { return this.rotation[2]; }
    get distance() { return Math.max(1e-4, length(sub(this.pivot, this.position))); }

    touch() {
        this.lens = null;
        this.rotation = orthonormal(this.rotation);
        this.changed();
    }

    /** Takes a camera's pose. With `photo`, its lens is kept until the view changes. */
    take(camera, photo = false) {
        this.rotation = camera.rotation;
        this.position = times(this.toWorld(camera.translation), -1);
        this.fovY = 2 * Math.atan(0.5 * camera.height / camera.fy);
        // Fisheyes and panoramas show more than a pinhole should.
        if (camera.lens) this.fovY = Math.min(this.fovY, WIDEST);
        // Turning continues around the axis' nearest point to the old pivot.
        const ahead = dot(sub(this.pivot, this.position), this.forward);
        this.pivot = add(this.position, times(this.forward, ahead > 0.05 * this.radius ? ahead : this.radius));
        // A panorama cannot lie within a picture of another shape.
        this.lens = photo && camera.lens?.projection !== 'equirectangular' ? camera : null;
        this.changed();
    }

    toWorld(v) {
        const [x, y, z] = this.rotation;
        return add(add(times(x, v[0]), times(y, v[1])), times(z, v[2]));
    }

    toCamera(world) {
        const p = sub(world, this.position);
        return this.rotation.map((row) => dot(row, p));
    }

    /** Turns around the pivot: `yaw` about up, `pitch` about the camera's right. */
    orbit(yaw, pitch) {
        this.turnAbout(this.pivot, yaw, pitch);
    }

    /** Turns around the camera's own position. */
    look(yaw, pitch) {
        this.turnAbout(this.position, yaw, pitch);
        this.pivot = add(this.position, times(this.forward, this.distance));
    }

    turnAbout(center, yaw, pitch) {
        const above = Math.acos(clamp(dot(this.forward, this.up), -1, 1));
        pitch = clamp(pitch, POLE - (Math.PI - above), above - POLE);
        const spin = (v) => turn(turn(v, this.right, pitch), this.up, yaw);
        const arm = spin(sub(this.position, center));
        this.rotation = this.rotation.map(spin);
        this.position = add(center, arm);
        this.touch();
    }

    /** Shifts by pixels of a picture of this height: the pivot follows the pointer. */
    pan(x, y, height) {
        const scale = 2 * this.distance * Math.tan(0.5 * this.fovY) / height;
        const move = add(times(this.right, -x * scale), times(this.down, -y * scale));
        this.position = add(this.position, move);
        this.pivot = add(this.pivot, move);
        this.touch();
    }

    /** Scales the distance to the pivot by a factor. */
    dolly(factor) {
        const arm = times(sub(this.position, this.pivot), clamp(factor, 0.2, 5));
        this.position = add(this.pivot, length(arm) < 1e-3 * this.radius ? times(normalize(arm, this.forward), 1e-3 * this.radius) : arm);
        this.touch();
    }

    /** Moves along the camera's axes, world units. */
    fly(v) {
        const move = this.toWorld(v);
        this.position = add(this.position, move);
        this.pivot = add(this.pivot, move);
        this.touch();
    }

    face(point) {
        this.pivot = point;
        this.rotation = looking(sub(point, this.position), this.up);
        this.touch();
    }

    key() {
        return { position: this.position, rotation: this.rotation, fov_y: this.fovY };
    }

    takeKey(key) {
        this.position = key.position;
        this.rotation = key.rotation;
        this.fovY = key.fov_y;
        this.pivot = add(this.position, times(this.forward, this.distance));
        this.touch();
    }

    /** The view as the fragment of an address, in the file's coordinates: position, pivot, quaternion, field of view. */
    link({ origin, unit }) {
        const inFile = (place) => add(origin, times(place, unit));
        const numbers = [...inFile(this.position), ...inFile(this.pivot), ...quaternion(this.rotation), this.fovY];
        return `#view=${numbers.map((value) => Number(value.toPrecision(10))).join(',')}`;
    }

    /** Takes the view from such a fragment; false if it has none. */
    takeLink(text, { origin, unit }) {
        const numbers = text.startsWith('#view=') ? text.slice(6).split(',').map(Number) : [];
        const [fov] = numbers.slice(10), turned = Math.hypot(...numbers.slice(6, 10));
        if (numbers.length !== 11 || !numbers.every(Number.isFinite) || turned < 0.5 || !(fov > 0.01 && fov < 3)) return false;
        const inScene = (place) => times(sub(place, origin), 1 / unit);
        this.position = inScene(numbers.slice(0, 3));
        this.pivot = inScene(numbers.slice(3, 6));
        this.rotation = rows(numbers.slice(6, 10).map((value) => value / turned));
        this.fovY = fov;
        this.touch();
        return true;
    }

    /** Scale and corner (pixels) of the photo within a picture of this size. */
    frame(width, height) {
        const { width: w, height: h } = this.lens, free = this.free(width, height);
        const scale = Math.min(free.width / w, free.height / h);
        return { scale, x: free.x - 0.5 * w * scale, y: free.y - 0.5 * h * scale, width: w * scale, height: h * scale };
    }

    /** Middle and size of the uncovered part of a picture of this size. */
    free(width, height) {
        const { left, right, top, bottom } = this.covered;
        return { x: 0.5 * width * (1 + left - right), y: 0.5 * height * (1 + top - bottom), width: width * (1 - left - right), height: height * (1 - top - bottom) };
    }

    /** Moves back until a box fits into the uncovered part, and makes its middle the pivot. */
    fit([low, high], width, height) {
        const { fx, fy } = this.message(width, height), free = this.free(width, height);
        this.pivot = times(add(low, high), 0.5);
        const half = times(sub(high, low), 0.5);
        const corners = Array.from({ length: 8 }, (_, bits) => half.map((value, axis) => (bits >> axis & 1 ? value : -value)));
        const far = corners.map((corner) => {
            const [x, y, z] = this.rotation.map((row) => dot(row, corner));
            return Math.max(2 * fx * Math.abs(x) / free.width, 2 * fy * Math.abs(y) / free.height, NEAR) - z;
        });
        this.position = sub(this.pivot, times(this.forward, 1.04 * Math.max(...far)));
        this.touch();
    }

    /** The engine's camera for a picture of this size. */
    message(width, height) {
        const common = { rotation: this.rotation, translation: this.rotation.map((row) => -dot(row, this.position)), width, height };
        if (this.lens) {
            const { scale, x, y } = this.frame(width, height);
            const { fx, fy, cx, cy } = this.lens;
            return { ...common, fx: fx * scale, fy: fy * scale, cx: x + cx * scale, cy: y + cy * scale, lens: this.lens.lens };
        }
        const f = 0.5 * height / Math.tan(0.5 * this.fovY);
        const { x, y } = this.free(width, height);
        return { ...common, fx: f, fy: f, cx: x, cy: y };
    }

    /** Pixel of a point; null behind the camera, and for a lens that bends lines. */
    project(world, width, height) {
        if (this.lens?.lens) return null;
        const [x, y, z] = this.toCamera(world);
        if (z < 1e-3) return null;
        const { fx, fy, cx, cy } = this.message(width, height);
        return [fx * x / z + cx, fy * y / z + cy];
    }
}

/** View between the keys of a path, as in the engine's films: Catmull-Rom positions, shortest rotations. */
export function between(keys, at, closed) {
    const n = keys.length, spans = closed ? n : n - 1;
    const span = Math.min(Math.floor(at * spans), spans - 1), t = at * spans - span;
    const index = (offset) => closed ? (span + offset + n) % n : clamp(span + offset, 0, n - 1);
    const [a, b, c, d] = [-1, 0, 1, 2].map((offset) => keys[index(offset)].position);
    const position = a.map((_, i) => 0.5 * (2 * b[i] + (c[i] - a[i]) * t + (2 * a[i] - 5 * b[i] + 4 * c[i] - d[i]) * t * t
        + (3 * b[i] - a[i] - 3 * c[i] + d[i]) * t * t * t));
    const [from, to] = [keys[index(0)], keys[index(1)]];
    return {
        position,
        rotation: rows(slerp(quaternion(from.rotation), quaternion(to.rotation), t)),
        fov_y: from.fov_y + t * (to.fov_y - from.fov_y)
    };
}
