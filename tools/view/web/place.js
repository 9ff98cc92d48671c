// The scene's place in new axes: turned, scaled, moved, levelled. Its Gaussians stay where they are; the page draws the grid of the new
// axes, and the command and the exported file move the scene into them.

import { add, cross, dot, looking, normalize, sub, times, turn } from './maths.js';
import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
const DEGREE = Math.PI / 180;
const AXES = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const apply = (rows, v) => rows.map((row) => dot(row, v));
const transposed = (rows) => [0, 1, 2].map((i) => rows.map((row) => row[i]));
/** Rounds to the digits of the fields, so that even a distant scene keeps its millimetres. */
export const rounded = (value) => Number(value.toPrecision(12));

/** Rotation about x, then y, then z by angles in degrees, like `convert --rotate`. */
function rotation(angles) {
    const about = (v) => angles.reduce((v, angle, axis) => turn(v, AXES[axis], angle * DEGREE), v);
    return transposed(AXES.map(about));
}

/** The angles of a rotation, degrees. */
function angles([[a, b], [d, e], [g, h, i]]) {
    const y = Math.asin(Math.min(1, Math.max(-1, -g)));
    const both = Math.abs(g) > 0.999999 ? [0, Math.atan2(-b, e)] : [Math.atan2(h, i), Math.atan2(d, a)];
    return [both[0], y, both[1]].map((angle) => Number((angle / DEGREE).toFixed(4)) + 0);
}

export class Place {
    constructor(camera, overlay, picker, panel, say) {
        Object.assign(this, { camera, overlay, picker, panel, say, frame: { origin: [0, 0, 0], unit: 1 }, points: [] });
        this.changed = () => {};
        this.inputs = Object.fromEntries(['turn', 'scale', 'move'].map((kind) => [kind, [...document.querySelectorAll(`#place [data-kind=${kind}]`)]]));
        for (const input of Object.values(this.inputs).flat()) input.onchange = () => this.read();
        find('place-reset').onclick = () => this.set({ turn: [0, 0, 0], scale: [1], move: [0, 0, 0] });
        find('place-grid').onchange = () => this.show();
        this.forget();
    }

    open(scene, first) {
        this.frame = scene.frame;
        this.allowed = !scene.empty && !scene.tree && scene.training === null;
        find('place').hidden = !this.allowed;
        if (!first) return;
        this.forget();
        find('place-grid').checked = false;
        this.show();
    }

    forget() {
        this.points.length = 0;
        Object.assign(this, { turn: [0, 0, 0], scale: [1], move: [0, 0, 0], rows: AXES });
    }

    /** Values of the fields; none unless all are numbers. */
    read() {
        const values = Object.fromEntries(Object.entries(this.inputs).map(([kind, inputs]) => [kind, inputs.map((input) => rounded(Number(input.value)))]));
        const sound = Object.values(values).flat().every(Number.isFinite) && values.scale[0] > 0;
        if (!sound) this.say(texts.badPlacement);
        this.set(sound ? values : {});
    }

    /** Takes new values. The view stays fixed to the grid, so that the scene moves; a scale changes the grid instead. */
    set(values) {
        const { camera } = this, before = { ...this, scale: values.scale ?? this.scale };
        Object.assign(this, values, { rows: rotation(values.turn ?? this.turn) });
        const turned = (v) => apply(transposed(this.rows), apply(before.rows, v));
        const moved = (place) => this.inScene(this.inAxes.call(before, place));
        const [position, pivot] = [moved(camera.position), moved(camera.pivot)];
        Object.assign(camera, { position, pivot, rotation: camera.rotation.map(turned), up: turned(camera.up) });
        find('place-grid').checked ||= !this.isIdentity;
        camera.touch();
        this.show();
    }

    /** Converts the scene's coordinates to the new axes, and back. */
    inAxes(place) {
        const source = add(this.frame.origin, times(place, this.frame.unit));
        return add(times(apply(this.rows, source), this.scale[0]), this.move);
    }

    inScene(place) {
        const source = apply(transposed(this.rows), times(sub(place, this.move), 1 / this.scale[0]));
        return times(sub(source, this.frame.origin), 1 / this.frame.unit);
    }

    /** The new axis nearest to the view's vertical. */
    get vertical() {
        const up = apply(this.rows, this.camera.up);
        const axis = up.reduce((best, value, i) => (Math.abs(value) > Math.abs(up[best]) ? i : best), 0);
        return times(AXES[axis], Math.sign(up[axis]) || 1);
    }

    /** Takes clicks on the floor; three of them level the scene, with the floor at height 0. */
    click(x, y) {
        this.picker.ask(x, y, ({ point }) => {
            if (!point) return this.say(texts.noFloor);
            this.points.push(point);
            if (this.points.length === 3) this.level(this.points.splice(0));
            this.show();
        });
    }

    level([a, b, c]) {
        let normal = normalize(cross(sub(b, a), sub(c, a)), null);
        if (!normal) return this.say(texts.noTriangle);
        if (dot(normal, this.camera.up) < 0) normal = times(normal, -1);
        const { vertical } = this, from = apply(this.rows, normal);
        const axis = cross(from, vertical), angle = Math.atan2(Math.hypot(...axis), dot(from, vertical));
        const level = (v) => turn(v, normalize(axis, vertical), angle);
        this.turn = angles(transposed(transposed(this.rows).map(level)));
        this.rows = rotation(this.turn);
        this.move = add(this.move, times(vertical, -dot(this.inAxes(a), vertical))).map(rounded);
        const { camera } = this;
        camera.up = apply(transposed(this.rows), vertical);
        camera.rotation = looking(camera.forward, camera.up);
        find('place-grid').checked = true;
        if (this.panel.on.level) this.panel.toggle('level');
        camera.touch();
    }

    get isIdentity() { return ![...this.turn, ...this.move].some(Boolean) && this.scale[0] === 1; }

    /** Options of `ashsplat convert`, or the same for an address. */
    get options() {
        return this.said(([name, value]) => ` --${name}=${value}`);
    }

    get query() {
        return this.said(([name, value]) => `&${name}=${value}`);
    }

    said(write) {
        const parts = [['rotate', this.turn], ['scale', this.scale], ['translate', this.move]];
        return parts.filter(([name, values]) => values.some((value) => value !== Number(name === 'scale'))).map(write).join('');
    }

    show() {
        for (const [kind, inputs] of Object.entries(this.inputs)) inputs.forEach((input, index) => { input.value = this[kind][index]; });
        find('place-reset').disabled = this.isIdentity;
        this.overlay.points = this.points;
        this.overlay.axis = this.rows;
        this.overlay.grid = find('place-grid').checked ? this.grid() : null;
        this.overlay.draw();
        this.changed();
    }

    /** Lines of the plane at height 0, in the scene's coordinates. */
    grid() {
        const { vertical } = this, around = this.inAxes(this.camera.pivot);
        const step = 10 ** Math.floor(Math.log10(this.camera.radius * this.frame.unit * this.scale[0]));
        const [u, v] = AXES.filter((axis) => !dot(axis, vertical));
        const middle = add(times(u, step * Math.round(dot(around, u) / step)), times(v, step * Math.round(dot(around, v) / step)));
        const line = (along, beside, at) => [-10, 10].map((end) => this.inScene(add(middle, add(times(along, end * step), times(beside, at * step)))));
        const all = Array.from({ length: 21 }, (_, index) => index - 10);
        return all.flatMap((at) => [line(u, v, at), line(v, u, at)]);
    }
}
