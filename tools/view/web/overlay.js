// Drawn over the picture: the photos' cameras, the pivot, the axes, the picked pixel.

import { add, clamp, dot, times } from './maths.js';

const AXES = [['x', '#ff6b6b'], ['y', '#69db7c'], ['z', '#74a9ff']];
/** A photo's size in the scene, share of the scene's radius. */
const FRUSTUM = 0.055;

export class Overlay {
    constructor(canvas, camera) {
        Object.assign(this, { canvas, camera, context: canvas.getContext('2d'), cameras: [], showsCameras: false, current: -1, pixel: null, box: null, shape: null, tape: null, grid: null, points: [], axis: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], flash: 0, spots: [] });
    }

    draw() {
        if (this.pending) return;
        this.pending = requestAnimationFrame(() => { this.pending = 0; this.paint(); });
    }

    paint() {
        const { canvas, context: c } = this, ratio = devicePixelRatio || 1;
        const [width, height] = [innerWidth, innerHeight];
        if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
            [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
        }
        c.setTransform(ratio, 0, 0, ratio, 0, 0);
        c.clearRect(0, 0, width, height);
        this.spots = [];
        if (this.grid) this.lines(this.grid, width, height);
        if (this.showsCameras) this.cameras.forEach((entry, index) => this.frustum(entry.camera, index, width, height));
        if (this.box) this.edges(this.box, width, height);
        this.axes(width, height);
        this.marks(width, height);
        if (this.points.length) this.measure({ points: this.points }, width, height);
        if (this.tape) this.measure(this.tape, width, height);
        if (this.shape) this.stroke(this.shape);
    }

    /** Draws the tape with its length in the middle. */
    measure({ points, text }, width, height) {
        const { context: c, camera } = this;
        const ends = points.map((point) => camera.project(point, width, height)).filter(Boolean);
        for (const [color, thick] of [['#000a', 4], ['#ffd43b', 2]]) {
            c.strokeStyle = c.fillStyle = color;
            c.lineWidth = thick;
            c.beginPath();
            ends.forEach((end) => c.lineTo(...end));
            c.stroke();
            for (const end of ends) { c.beginPath(); c.arc(...end, 2 + thick, 0, 2 * Math.PI); c.fill(); }
        }
        if (ends.length < 2 || !text) return;
        const [x, y] = [0, 1].map((axis) => (ends[0][axis] + ends[1][axis]) / 2);
        c.font = '600 13px system-ui, sans-serif';
        c.textAlign = 'center';
        c.textBaseline = 'middle';
        const wide = c.measureText(text).width / 2 + 7;
        c.fillStyle = '#000c';
        c.beginPath(); c.roundRect(x - wide, y - 11, 2 * wide, 22, 6); c.fill();
        c.fillStyle = '#ffd43b';
        c.fillText(text, x, y + 0.5);
    }

    /** Draws the shape of a tool in use: a lasso, a brush stroke with its radius, or a circle. */
    stroke({ points, circle, radius }) {
        const { context: c } = this;
        c.beginPath();
        if (circle) c.arc(...circle, radius, 0, 2 * Math.PI);
        else points.forEach((point) => c.lineTo(...point));
        if (!circle && radius) {
            c.lineCap = c.lineJoin = 'round';
            c.lineWidth = 2 * radius;
            c.strokeStyle = '#f0883e66';
            if (points.length === 1) c.lineTo(points[0][0] + 0.01, points[0][1]);
        } else {
            c.fillStyle = '#f0883e22';
            c.fill();
            c.lineWidth = 1.5;
            c.strokeStyle = '#f0883e';
        }
        c.stroke();
    }

    frustum(photo, index, width, height) {
        const { context: c, camera } = this, size = FRUSTUM * camera.radius;
        const world = (v) => {
            const [x, y, z] = photo.rotation;
            const d = v.map((value, i) => value - photo.translation[i]);
            return add(add(times(x, d[0]), times(y, d[1])), times(z, d[2]));
        };
        // Fisheyes and panoramas are shown as wide as others.
        const slope = (p, c, f) => clamp((p - c) / f, -1, 1) * size;
        const corner = (px, py) => world([slope(px, photo.cx, photo.fx), slope(py, photo.cy, photo.fy), size]);
        const points = [world([0, 0, 0]), corner(0, 0), corner(photo.width, 0), corner(photo.width, photo.height), corner(0, photo.height)]
            .map((p) => camera.project(p, width, height));
        if (points.some((p) => p === null)) return;
        const [eye, ...corners] = points;
        c.beginPath();
        corners.forEach((p, i) => {
            c.moveTo(...eye); c.lineTo(...p); c.lineTo(...corners[(i + 1) % 4]);
        });
        c.lineWidth = index === this.current ? 2 : 1;
        c.strokeStyle = index === this.current ? '#f0883e' : '#ffffff99';
        c.stroke();
        const middle = [0, 1].map((k) => corners.reduce((sum, p) => sum + p[k], 0) / 4);
        this.spots.push({ index, x: middle[0], y: middle[1] });
    }

    /** Draws lines of the scene, as far as they are in front of the camera. */
    lines(lines, width, height) {
        const { context: c, camera } = this, near = 1e-2 * camera.radius;
        c.beginPath();
        for (const ends of lines) {
            const [a, b] = ends.map((end) => camera.toCamera(end)[2]);
            if (Math.max(a, b) <= near) continue;
            const between = (share) => add(times(ends[0], 1 - share), times(ends[1], share)), cut = between((a - near) / (a - b));
            const shown = [a < near ? cut : ends[0], b < near ? cut : ends[1]].map((end) => camera.project(end, width, height));
            if (!shown.every(Boolean)) continue;
            c.moveTo(...shown[0]);
            c.lineTo(...shown[1]);
        }
        c.strokeStyle = '#ffffff40';
        c.lineWidth = 1;
        c.stroke();
    }

    /** Draws the box of the filter. */
    edges(box, width, height) {
        const { context: c, camera } = this;
        const corner = (bits) => camera.project([0, 1, 2].map((axis) => box[bits >> axis & 1][axis]), width, height);
        c.beginPath();
        for (let bits = 0; bits < 8; ++bits) for (const axis of [0, 1, 2]) {
            const [from, to] = [corner(bits), corner(bits | 1 << axis)];
            if (bits >> axis & 1 || !from || !to) continue;
            c.moveTo(...from); c.lineTo(...to);
        }
        c.strokeStyle = '#f0883ecc';
        c.lineWidth = 1.25;
        c.stroke();
    }

    /** The photo whose mark is near a pixel, or -1. */
    cameraAt(x, y) {
        const near = this.spots.map((s) => ({ ...s, far: Math.hypot(s.x - x, s.y - y) })).filter((s) => s.far < 16);
        return near.sort((a, b) => a.far - b.far)[0]?.index ?? -1;
    }

    axes(width, height) {
        const { context: c, camera } = this;
        // The axes lie beside the tools and above the legend on screens where these take the corner.
        const low = height <= 780 && width > 760;
        const [x0, y0, arm] = [low ? 176 : 52, height - (low ? 136 : 92), 30];
        const drawn = AXES.map(([name, color], i) => ({ name, color, to: camera.rotation.map((row) => dot(row, this.axis[i])) }));
        drawn.sort((a, b) => b.to[2] - a.to[2]);
        c.font = '600 10px system-ui, sans-serif';
        c.textAlign = 'center';
        c.textBaseline = 'middle';
        for (const { name, color, to } of drawn) {
            const [x, y] = [x0 + to[0] * arm, y0 + to[1] * arm];
            c.globalAlpha = to[2] > 0.1 ? 0.55 : 1;
            c.strokeStyle = c.fillStyle = color;
            c.lineWidth = 2;
            c.beginPath(); c.moveTo(x0, y0); c.lineTo(x, y); c.stroke();
            c.beginPath(); c.arc(x, y, 7, 0, 2 * Math.PI); c.fill();
            c.fillStyle = '#10131a';
            c.fillText(name, x, y + 0.5);
        }
        c.globalAlpha = 1;
    }

    marks(width, height) {
        const { context: c, camera } = this;
        const age = (performance.now() - this.flash) / 1200;
        const pivot = age < 1 ? camera.project(camera.pivot, width, height) : null;
        if (pivot) {
            c.globalAlpha = 1 - age;
            c.strokeStyle = '#f0883e';
            c.lineWidth = 2;
            c.beginPath(); c.arc(...pivot, 9 + 14 * (1 - age) ** 3, 0, 2 * Math.PI); c.stroke();
            c.beginPath(); c.arc(...pivot, 3, 0, 2 * Math.PI); c.stroke();
            c.globalAlpha = 1;
            this.draw();
        }
        if (this.pixel) {
            const [x, y] = this.pixel;
            for (const [color, width] of [['#000a', 4], ['#fff', 1.5]]) {
                c.strokeStyle = color;
                c.lineWidth = width;
                c.beginPath();
                for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { c.moveTo(x + 4 * dx, y + 4 * dy); c.lineTo(x + 11 * dx, y + 11 * dy); }
                c.stroke();
            }
        }
    }
}
