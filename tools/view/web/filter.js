// What is left out of the scene: faint Gaussians, fog, what lies outside a box. The program cuts on its device as it draws;
// each frame says which command makes the same cut of the file.

import { download } from './frames.js';

const find = (id) => document.getElementById(id);
const AXES = ['x', 'y', 'z'];
/** The floaters' slider goes from this share of the median density to all of it. */
const LEAST_SHARE = 1e-4;
/** Steps of a side of the box. */
const STEPS = 400;
/** Milliseconds that a cut stays as it is before its Gaussians are counted: that takes longer than a frame. */
const REST_MS = 400;

/** A number of few digits, as the program has it. */
const rounded = (value) => Math.fround(Number(value.toPrecision(4)));

export class Filter {
    /** `say` tells people something. */
    constructor(overlay, say) {
        Object.assign(this, { overlay, say, off: false, median: 1, ranges: null, shown: null });
        this.changed = () => {};
        for (const id of ['min-opacity', 'floaters']) find(id).oninput = () => this.act();
        this.sides = [...document.querySelectorAll('#filter .side')].map((row) => [...row.querySelectorAll('input')]);
        this.sides.forEach((pair, axis) => pair.forEach((input, end) => {
            Object.assign(input, { min: 0, max: STEPS, step: 1, value: end * STEPS });
            input.oninput = () => this.drag(axis, end);
        }));
        find('filter-reset').onclick = () => this.reset();
        find('command-copy').onclick = () => this.copy();
        find('export-part').onchange = () => this.showCommand();
        find('export-save').onclick = () => this.save(find('export-format').value);
        this.show();
    }

    open(scene, first) {
        // No frame has shown this one yet: its export waits for that.
        if (scene.run !== this.scene?.run) this.shown = null;
        this.scene = scene;
        find('filter').hidden = scene.empty;
        // Only a part of a tree is ever there: it is neither counted nor saved.
        find('exports').hidden = Boolean(scene.tree);
        if (first) find('export-format').replaceChildren(...scene.formats.map((format) => new Option(format.slice(1), format)));
        this.median = scene.densities?.[3] || 1;
        this.ranges = scene.central_bounds && this.rangesOf(scene);
        if (first) this.reset();
        this.show();
    }

    /** What the sliders of an axis span: the middle of the scene and as much to either side, as far as there is anything. */
    rangesOf({ bounds: [low, high], central_bounds: [from, to] }) {
        return AXES.map((_, i) => {
            const size = Math.max(to[i] - from[i], 1e-6);
            const [a, b] = [Math.max(low[i], from[i] - size), Math.min(high[i], to[i] + size)];
            return b > a ? [a, b] : [a - 0.5, a + 0.5];
        });
    }

    /** The box that the sliders span; none for a scene without one. */
    get whole() { return this.ranges && [0, 1].map((end) => this.ranges.map((range) => range[end])); }

    /** A slider at its end leaves the side open. */
    side(axis, end) {
        const at = Number(this.sides[axis][end].value);
        if (!this.ranges || at === end * STEPS) return null;
        const [low, high] = this.ranges[axis];
        return rounded(low + (high - low) * at / STEPS);
    }

    /** As the program takes it. */
    get cut() {
        if (this.off) return {};
        const opacity = Number(find('min-opacity').value), share = this.share;
        return {
            min_opacity: opacity ? rounded(opacity) : null,
            min_density: share ? rounded(this.median * share) : null,
            low: AXES.map((_, axis) => this.side(axis, 0)),
            high: AXES.map((_, axis) => this.side(axis, 1))
        };
    }

    /** Of the median density; 0 for none. */
    get share() {
        const at = Number(find('floaters').value) / 100;
        return at && LEAST_SHARE ** (1 - at);
    }

    get active() {
        const all = (pair) => Number(pair[0].value) === 0 && Number(pair[1].value) === STEPS;
        return Number(find('min-opacity').value) > 0 || this.share > 0 || !this.sides.every(all);
    }

    drag(axis, end) {
        const [from, to] = this.sides[axis], gap = 4;
        if (Number(to.value) - Number(from.value) < gap) {
            if (end === 0) from.value = Math.max(0, Number(to.value) - gap);
            else to.value = Math.min(STEPS, Number(from.value) + gap);
        }
        this.act();
    }

    act() {
        this.off = false;
        this.show();
        this.changed();
    }

    reset() {
        find('min-opacity').value = find('floaters').value = 0;
        this.sides.forEach((pair) => pair.forEach((input, end) => { input.value = end * STEPS; }));
        this.act();
    }

    /** Off, to compare, and on again. */
    toggle() {
        if (!this.active) return;
        this.off = !this.off;
        this.show();
        this.changed();
    }

    show() {
        const text = (id, words) => { find(id).parentElement.querySelector('output').textContent = words; };
        const opacity = Number(find('min-opacity').value), { share } = this;
        text('min-opacity', opacity ? opacity.toFixed(2) : 'all');
        text('floaters', share ? `${Number((100 * share).toPrecision(2))} %` : 'shown');
        this.sides.forEach(([from, to]) => {
            const bar = from.parentElement.querySelector('i');
            Object.assign(bar.style, { left: `${100 * from.value / STEPS}%`, right: `${100 - 100 * to.value / STEPS}%` });
            // The one that has room comes to lie above.
            from.style.zIndex = Number(from.value) > STEPS / 2 ? 2 : 1;
        });
        const sides = AXES.map((name, axis) => {
            const [low, high] = [0, 1].map((end) => this.side(axis, end));
            if (low === null && high === null) return '';
            const { origin, unit } = this.scene.frame;
            const source = (value) => String(origin[axis] + short(unit * value));
            return `${name} ${low === null ? '' : `${source(low)} `}…${high === null ? '' : ` ${source(high)}`}`;
        }).filter(Boolean);
        find('box-text').hidden = !sides.length;
        find('box-text').textContent = sides.join(', ');
        find('filter-reset').hidden = !this.active;
        find('filter').classList.toggle('off', this.off);
        this.overlay.box = sides.length && !this.off ? this.corners() : null;
        this.overlay.draw();
    }

    corners() {
        return [0, 1].map((end) => AXES.map((_, axis) => this.side(axis, end) ?? this.ranges[axis][end]));
    }

    /** A frame says what it shows. */
    showFrame({ convert, export: address, edits }) {
        Object.assign(this, { shown: address, convert });
        // What was selected by hand, no command repeats.
        this.edited = Boolean(edits?.hidden || edits?.deleted);
        this.showCommand();
        const { tree, run } = this.scene ?? {};
        this.count(convert && !tree ? `${address}&run=${run}&revision=${edits?.revision ?? 0}` : null);
    }

    /** The command that makes the same file: the cut, and the scene's new place. */
    showCommand() {
        const options = `${this.convert ?? ''}${this.placement.options}`.trim();
        const command = options && this.scene?.convert && !this.edited && !find('export-part').value ? `${this.scene.convert} ${options}` : '';
        find('command').hidden = !command;
        if (find('command-text').textContent === command) return;
        // Lines end between words, not within options.
        const words = command.split(' ').map((word) => Object.assign(document.createElement('span'), { textContent: word }));
        find('command-text').replaceChildren(...words.flatMap((word, index) => (index ? [' ', word] : [word])));
    }

    /** Says how many Gaussians a cut leaves, once it rests; null for none. */
    count(address) {
        if (address === this.counted) return;
        this.counted = address;
        clearTimeout(this.timer);
        find('cut-count').hidden = true;
        if (address !== null) this.timer = setTimeout(() => this.ask(address), REST_MS);
    }

    async ask(address) {
        const answer = await fetch(`count?${address}`).catch(() => null);
        if (address !== this.counted) return;
        // Busy with exports: later.
        if (answer?.status === 503) this.timer = setTimeout(() => this.ask(address), 5 * REST_MS);
        if (!answer?.ok) return;
        const { kept, of } = await answer.json();
        if (address !== this.counted) return;
        find('cut-count').textContent = `${kept.toLocaleString('en')} of ${of.toLocaleString('en')} Gaussians stay`;
        find('cut-count').hidden = false;
    }

    async copy() {
        const box = find('command-text');
        try {
            await navigator.clipboard.writeText(box.textContent);
            this.say('copied');
        } catch {
            // Where the browser gives no clipboard, it is marked to be copied by hand.
            getSelection().selectAllChildren(box);
        }
    }

    /** The file is made of what was shown last, and saved by the browser as it comes. */
    async save(format) {
        if (this.shown === null || !this.scene || this.scene.empty) return;
        const part = find('export-part').value;
        const mark = part ? '_selection' : this.edited || !find('command').hidden ? '_cut' : '';
        const name = `${this.scene.stem}${mark}${format}`, query = `${this.shown}${this.placement.query}${part && `&part=${part}`}`;
        const answer = await fetch(`count?${query}&format=${format.slice(1)}`).catch(() => null);
        if (!answer?.ok) return this.say(answer ? (await answer.text()).trim().replace(/^\d+: /, '') : 'no answer: has the viewer ended?');
        const { losses } = await answer.json();
        download(`export/${encodeURIComponent(name)}?${query}`, name);
        this.say([`${name} is made; the browser saves it as it comes`, ...losses].join('; '));
    }
}

const short = (value) => Number(value.toPrecision(3));
