// Selecting Gaussians with lasso, brush and sphere; hiding, deleting, undo. The program keeps the states of all Gaussians for all
// pages, and each frame has their counts.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
/** Most points of a stroke; the program accepts little more. */
const MOST_POINTS = 1000;
/** Smallest step of a stroke, CSS pixels. */
const STEP = 3;
/** How a new region changes the selection: Shift adds, Alt removes. */
const how = (event) => (event.shiftKey ? 'add' : event.altKey ? 'remove' : document.querySelector('[name=how]:checked').value);
const COMMANDS = ['hide', 'show', 'delete', 'undo', 'redo'];

export class Edit {
    constructor(link, camera, frames, picker, overlay, filter) {
        Object.assign(this, { link, camera, frames, picker, overlay, filter, allowed: false });
        for (const op of COMMANDS) find(`edit-${op}`).onclick = () => this.send(op);
        find('select-all').onclick = () => this.select({ kind: 'all' }, 'set');
        // Deselects Gaussians that the cut hides too.
        find('select-none').onclick = () => this.send('select', { region: { kind: 'all' }, how: 'remove' });
        find('select-invert').onclick = () => this.select({ kind: 'all' }, 'toggle');
        find('brush-size').oninput = () => this.showSize();
        overlay.canvas.addEventListener('pointerleave', () => this.hover(null));
        this.showSize();
    }

    open(scene) {
        this.run = scene.run;
        this.allowed = !scene.empty && !scene.tree && scene.training === null;
        find('edit').hidden = !this.allowed;
        for (const tool of ['lasso', 'brush', 'sphere']) find(tool).hidden = !this.allowed;
        let first = 0;
        find('edit-scenes').replaceChildren(...scene.scenes.map(({ name, count }) => {
            const region = { kind: 'range', first, count };
            first += count;
            return Object.assign(document.createElement('button'), { textContent: name, title: texts.selectScene(name, count), onclick: (event) => this.select(region, how(event)) });
        }));
        this.showFrame({ edits: null });
    }

    send(op, more = {}) {
        if (this.allowed) this.link.send({ type: 'edit', run: this.run, op, ...more });
    }

    select(region, how) {
        this.send('select', { region, how, cut: this.filter.cut });
    }

    get size() { return Number(find('brush-size').value); }

    showSize() {
        find('brush-size').parentElement.querySelector('output').textContent = texts.pixels(this.size);
    }

    /** Shows the brush's ring under the pointer. */
    hover(place) {
        this.overlay.shape = place && { circle: place, radius: this.size };
        this.overlay.draw();
    }

    /** Begins a stroke of a tool, which follows the pointer until release. Shift adds, Alt removes. */
    begin(tool, x, y, event) {
        return tool === 'sphere' ? this.sphere(x, y, how(event)) : this.stroke(tool, x, y, how(event));
    }

    stroke(tool, x, y, how) {
        let points = [[x, y]];
        const radius = tool === 'brush' ? this.size : 0;
        const show = () => {
            this.overlay.shape = { points, radius };
            this.overlay.draw();
        };
        show();
        return {
            move: (x, y) => {
                const [a, b] = points.at(-1);
                if (Math.hypot(x - a, y - b) < STEP) return;
                points.push([x, y]);
                if (points.length > MOST_POINTS) points = points.filter((_, index) => index % 2 === 0);
                show();
            },
            end: () => {
                this.hover(null);
                const [camera, scale] = this.view();
                const region = { kind: tool, camera, points: points.map(([x, y]) => [x * scale, y * scale]) };
                this.select(radius ? { ...region, radius: radius * scale } : region, how);
            },
            cancel: () => this.hover(null)
        };
    }

    /** Selects a sphere around the surface under the pointer; dragging sets the radius. */
    sphere(x, y, how) {
        let to = [x, y], answered = false, ended = false, depth = null, center = null;
        const pixels = () => Math.hypot(to[0] - x, to[1] - y);
        const show = () => {
            this.overlay.shape = { circle: [x, y], radius: Math.max(pixels(), 2) };
            this.overlay.draw();
        };
        const finish = () => {
            this.hover(null);
            if (!center) return this.link.emit('note', { message: texts.noSurface });
            const [camera, scale] = this.view();
            const radius = pixels() * scale * depth / camera.fy;
            if (radius > 0) this.select({ kind: 'sphere', center, radius }, how);
        };
        this.picker.ask(x, y, (picked) => {
            ({ point: center, depth } = picked);
            answered = true;
            if (ended) finish();
        });
        show();
        return {
            move: (x, y) => { to = [x, y]; show(); },
            end: () => { ended = true; if (answered) finish(); },
            cancel: () => this.hover(null)
        };
    }

    /** The camera of the picture, and its pixels per CSS pixel. */
    view() {
        const [width, height] = this.frames.size;
        return [this.camera.message(width, height), width / innerWidth];
    }

    showFrame({ edits }) {
        const { selected, hidden, deleted, undo, redo } = edits ?? { selected: 0, hidden: 0, deleted: 0, undo: 0, redo: 0 };
        find('edit-count').textContent = texts.edits(selected, hidden, deleted);
        const possible = { hide: selected, show: hidden, delete: selected, undo, redo };
        for (const op of COMMANDS) find(`edit-${op}`).disabled = !possible[op];
        find('select-none').disabled = !selected;
        const part = find('export-part');
        part.options[1].disabled = !selected;
        if (!selected) part.selectedIndex = 0;
    }
}
