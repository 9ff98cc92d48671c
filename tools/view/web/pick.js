// A pixel's Gaussians, and the pivot under the pointer.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
const css = (color) => `rgb(${color.map((c) => Math.round(255 * Math.min(1, Math.max(0, c)))).join(' ')})`;

export class Picker {
    constructor(link, camera, frames, look, overlay) {
        Object.assign(this, { link, camera, frames, look, overlay, id: 0, waiting: new Map() });
        link.on('picked', (answer) => this.answer(answer));
        link.on('open', () => this.waiting.clear());
        find('picked-close').onclick = () => this.close();
    }

    ask(x, y, then) {
        const [width, height] = this.frames.size;
        const pixel = [Math.floor(x / innerWidth * width), Math.floor(y / innerHeight * height)];
        const id = ++this.id;
        this.waiting.set(id, then);
        this.link.send({ type: 'pick', id, camera: this.camera.message(width, height), look: { ...this.look(), mode: 'splats' }, pixel });
    }

    answer(answer) {
        const then = this.waiting.get(answer.id);
        this.waiting.delete(answer.id);
        then?.(answer);
    }

    pick(x, y) {
        this.overlay.pixel = [x, y];
        this.overlay.draw();
        this.ask(x, y, (answer) => this.show(answer));
    }

    /** Makes the point at a pixel the pivot. */
    pivot(x, y) {
        const { camera } = this;
        this.ask(x, y, ({ point }) => {
            if (point === null) return;
            camera.pivot = point;
            this.overlay.flash = performance.now();
            this.overlay.draw();
        });
    }

    show({ pixel, samples, color, transmittance, depth }) {
        find('picked').hidden = false;
        find('picked-where').textContent = texts.pixelAt(...pixel, samples.length);
        const swatch = Object.assign(document.createElement('i'), { className: 'swatch' });
        swatch.style.background = css(color);
        const before = depth === null ? null : (depth * this.unit).toPrecision(4);
        find('picked-sum').replaceChildren(swatch, texts.pixelSum(color.map((c) => c.toFixed(3)).join(' '), (100 * (1 - transmittance)).toFixed(1), before));
        const table = document.createElement('table');
        const head = table.createTHead().insertRow();
        for (const text of ['', ...texts.pixelColumns]) head.append(Object.assign(document.createElement('th'), { textContent: text }));
        const body = table.createTBody();
        for (const s of samples) {
            const row = body.insertRow();
            const mark = Object.assign(document.createElement('i'), { className: 'swatch' });
            mark.style.background = css(s.color);
            row.insertCell().append(mark);
            for (const text of [s.id, (s.depth * this.unit).toPrecision(4), s.alpha.toFixed(3), s.weight.toFixed(4), s.transmittance_left.toFixed(4)]) row.insertCell().textContent = text;
            row.cells[4].className = 'weight';
            row.cells[4].style.setProperty('--share', `${100 * s.weight}%`);
        }
        find('picked-table').replaceChildren(table);
        find('picked').scrollIntoView({ block: 'nearest' });
    }

    close() {
        find('picked').hidden = true;
        this.overlay.pixel = null;
        this.overlay.draw();
    }
}
