// What lies over the picture: where the photos were taken, the pivot, the axes, the pixel that was picked.

import { add, clamp, times } from './maths.js';

const AXES = [['x', '#ff6b6b'], ['y', '#69db7c'], ['z', '#74a9ff']];
/** A photo's size in the scene, share of the scene's radius. */
const FRUSTUM = 0.055;

export class Overlay {
    constructor(canvas, camera) {
        Object.assign(this, { canvas, camera, context: canvas.getContext('2d'), cameras: [], showsCameras: false, current: -1, pixel: null, box: null, flash: 0, spots: [] });
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
        if (this.showsCameras) this.cameras.forEach((entry, index) => this.frustum(entry.camera, index, width, height));
        if (this.box) this.edges(this.box, width, height);
        this.axes(width, height);
        this.marks(width, height);
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

    /** The box of the filter. */
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

    /** The photo whose sign is at a place, or -1. */
    cameraAt(x, y) {
        const near = this.spots.map((s) => ({ ...s, far: Math.hypot(s.x - x, s.y - y) })).filter((s) => s.far < 16);
        return near.sort((a, b) => a.far - b.far)[0]?.index ?? -1;
    }

    axes(width, height) {
        const { context: c, camera } = this;
        // Beside the tools and above the legend, where these take the corner.
        const low = height <= 600 && width > 760;
        const [x0, y0, arm] = [low ? 176 : 52, height - (low ? 136 : 92), 30];
        const drawn = AXES.map(([name, color], i) => ({ name, color, to: camera.rotation.map((row) => row[i]) }));
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
