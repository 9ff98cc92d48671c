// A tape between two points of the scene, each on the surface under a click.

import { length, sub } from './maths.js';
import { rounded } from './place.js';
import { texts } from './texts.js';

const find = (id) => document.getElementById(id);

export class Tape {
    constructor(picker, overlay, place, say) {
        Object.assign(this, { picker, overlay, place, say, points: [] });
        find('tape-clear').onclick = () => this.clear();
        const known = this.known = find('tape-known').querySelector('input');
        known.onchange = () => {
            const { measured } = this, length = Number(known.value);
            if (measured && length > 0) place.set({ scale: [rounded(place.scale[0] * length / measured)] });
        };
    }

    click(x, y) {
        this.picker.ask(x, y, ({ point }) => {
            if (!point) return this.say(texts.noTapeEnd);
            this.points = this.points.length === 1 ? [this.points[0], point] : [point];
            this.show();
            find('measure').scrollIntoView({ block: 'nearest' });
        });
    }

    clear() {
        this.points = [];
        this.show();
    }

    /** Distance of the two points, in units of the placed scene; null without both. */
    get measured() {
        const [a, b] = this.points;
        return b ? length(sub(b, a)) * this.place.frame.unit * this.place.scale[0] : null;
    }

    show() {
        const { points, measured } = this;
        find('measure').hidden = !points.length;
        find('tape-known').hidden = measured === null || !this.place.allowed;
        this.known.value = '';
        find('tape-length').textContent = measured === null ? texts.otherEnd : texts.tapeLength(Number(measured.toPrecision(5)));
        this.overlay.tape = points.length ? { points, text: measured === null ? '' : String(Number(measured.toPrecision(4))) } : null;
        this.overlay.draw();
    }
}
